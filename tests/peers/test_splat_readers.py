"""Files of Gaussians through other projects' readers: what they say, within what each format rounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from node_packages import node_package, run_node
from splats import HALF_TURN_X, HALF_TURN_Z, Read, from_stored, long_ones, read_ply, some

from gavatar_runtime.geometry.rotations import matrix_from_quaternion
from gavatar_runtime.play.outputs import save_gaussians
from gavatar_runtime.values.gaussians import Gaussians

SPLAT_TRANSFORM = ("@playcanvas/splat-transform", "2.7.1")  # the last that node 20 runs: 3.0 asks for node 22
UPRIGHT = np.eye(3)


@dataclasses.dataclass(frozen=True)
class Rounding:
    """Half a step of what a format stores. mean: metres. scale: of its logarithm. color, opacity: of one. part: of each
    stored component of a quaternion. last: how much less than 1 the largest opacity is."""

    mean: Callable[[Gaussians], np.ndarray] | float
    scale: Callable[[Gaussians], float] | float
    color: Callable[[Gaussians], float] | float
    opacity: float
    part: float
    last: float = 1e-6


def _sog_mean(g: Gaussians) -> np.ndarray:
    logs = np.log1p(np.abs(g.means)) * np.sign(g.means)
    return (logs.max(0) - logs.min(0)) / 65535 / 2 * (1 + np.abs(g.means))


def _even(values: np.ndarray) -> float:
    return float(values.max() - values.min()) / 255 / 2


ROUNDING = {
    # a .ply holds float32; opacity 1 is clamped
    "ply": Rounding(0.0, 0.0, 0.0, 0.0, 0.0, 1.1e-6),
    # bytes; of rotations readers have two laws, u / 128 - 1 and 2 u / 255 - 1, which differ by half a step
    # gaussforge keeps logits within 10, 4.54e-5 from 1
    "splat": Rounding(0.0, 0.0, 0.5 / 255, 0.5 / 255, 1.0 / 128, 4.6e-5),
    # 4096ths of a metre; sixteenths; 255ths of what is 0.15 / C0 times the colour; 9 bits for sqrt(1/2); 254 at most
    "spz": Rounding(0.5 / 4096, 0.5 / 16, 0.5 / 255 / 0.15 * 0.2820948, 0.5 / 255, 0.5 / 511 / np.sqrt(2), 1 / 255),
    "sog": Rounding(
        _sog_mean, lambda g: _even(np.log(g.scales)), lambda g: _even(g.colors), 0.5 / 255, 1 / 255 / np.sqrt(2)
    ),
}
# In the worst case the error of a turn, in radians, by that of a stored part of its quaternion: the largest part, at
# least 1/2, follows from three others: |dq| <= sqrt(3 + 3^2) part, an angle of twice that.
TURN = 2 * np.sqrt(12)


def by_plyfile(path: Path, factory) -> Read:
    return read_ply(path).turned(HALF_TURN_Z)


def by_gsply(path: Path, factory) -> Read:
    gsply = pytest.importorskip("gsply")
    data = gsply.plyread(str(path)) if path.suffix == ".ply" else gsply.read_spz(str(path))
    read = from_stored(data.means, data.scales, data.sh0, data.opacities, data.quats)
    # it calls what it gives "PLY" and turns what it reads from an .spz by half a turn about x, as Niantic's tools do
    return read.turned(HALF_TURN_Z if path.suffix == ".ply" else UPRIGHT)


def by_gaussforge(path: Path, factory) -> Read:
    forge = pytest.importorskip("gaussforge").GaussForge()
    answer = forge.convert(path.read_bytes(), path.suffix[1:], "ply")
    assert "error" not in answer, answer
    out = path.with_suffix(".forged.ply")
    out.write_bytes(answer["data"])
    return read_ply(out).turned(UPRIGHT if path.suffix == ".spz" else HALF_TURN_Z)  # it turns nothing


def by_splat_transform(path: Path, factory) -> Read:
    program = node_package(factory, *SPLAT_TRANSFORM) / "bin" / "cli.mjs"
    out = path.with_suffix(".transformed.ply")
    run_node(program, "-q", "-w", path, out)
    # a .spz is y-up to it, and a .ply y-down: it leads from one to the other by half a turn about x
    return read_ply(out).turned(HALF_TURN_X if path.suffix == ".spz" else HALF_TURN_Z)


READERS = {
    "plyfile": (by_plyfile, ("ply",)),
    "gsply": (by_gsply, ("ply", "spz")),
    "gaussforge": (by_gaussforge, ("ply", "splat", "spz", "sog")),
    "splat-transform": (by_splat_transform, ("ply", "splat", "spz", "sog")),
}
PAIRS = [(reader, suffix) for reader, (_, suffixes) in READERS.items() for suffix in suffixes]
pairs = pytest.mark.parametrize(("reader", "suffix"), PAIRS)


def given_and_got(reader, suffix, gaussians, folder, factory) -> tuple[Gaussians, Read]:
    path = folder / f"a.{suffix}"
    assert save_gaussians(path, gaussians) == ()
    got = READERS[reader][0](path, factory)
    assert len(got.means) == len(gaussians)
    return gaussians, got


def compare(given: Gaussians, got: Read, rounding: Rounding) -> None:
    step = {f.name: getattr(rounding, f.name) for f in dataclasses.fields(rounding)}
    step = {name: value(given) if callable(value) else value for name, value in step.items()}
    # beyond the format's own rounding: float32 of ours and of theirs, a few units in the last place
    assert (np.abs(got.means - given.means) <= step["mean"] + 3e-6).all()
    scales = np.broadcast_to(given.scales.reshape(len(given), -1), got.scales.shape)
    assert np.abs(np.log(got.scales) - np.log(scales)).max() <= step["scale"] + 3e-6
    assert np.abs(got.colors - given.colors).max() <= step["color"] + 3e-6
    opacities = np.ones(len(given)) if given.opacities is None else given.opacities
    assert np.abs(got.opacities - opacities).max() <= max(step["opacity"], step["last"]) + 3e-6
    none = np.tile(np.eye(3), (len(given), 1, 1))
    turns = none if given.quaternions is None else matrix_from_quaternion(given.quaternions)
    signs = np.sign(np.einsum("nab,nab->nb", got.rotations, turns))  # an axis may point either way
    # |R1 - R2| of an angle is at most 2 sqrt(2) sin(angle / 2) in the norm, so no entry is off by more
    assert np.abs(got.rotations * signs[:, None] - turns).max() <= np.sqrt(2) * (TURN * step["part"]) + 3e-6


@pairs
def test_round_opaque_gaussians(reader, suffix, tmp_path, tmp_path_factory):
    given, got = given_and_got(reader, suffix, some(200), tmp_path, tmp_path_factory)
    got.rotations = np.tile(np.eye(3), (len(given), 1, 1))  # of round ones they are no part of the picture
    compare(given, got, ROUNDING[suffix])


@pairs
def test_long_translucent_gaussians(reader, suffix, tmp_path, tmp_path_factory):
    compare(*given_and_got(reader, suffix, long_ones(200), tmp_path, tmp_path_factory), ROUNDING[suffix])


@pairs
def test_one_gaussian(reader, suffix, tmp_path, tmp_path_factory):
    compare(*given_and_got(reader, suffix, long_ones(1), tmp_path, tmp_path_factory), ROUNDING[suffix])


@pairs
def test_opacity_one_and_scale_zero_are_finite_to_them(reader, suffix, tmp_path, tmp_path_factory):
    given = some(3, scales=[0.0, 0.01, 0.0], opacities=[1.0, 0.0, 1.0])
    got = given_and_got(reader, suffix, given, tmp_path, tmp_path_factory)[1]
    for field in dataclasses.fields(got):
        assert np.isfinite(getattr(got, field.name)).all()
    np.testing.assert_allclose(got.opacities, given.opacities, atol=ROUNDING[suffix].last + 3e-6)
    assert (got.scales[[0, 2]] < 1e-4).all()  # of the format with the largest least, .spz, 45 micrometres
