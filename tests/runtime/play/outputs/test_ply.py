"""Gaussians as .ply, read back by the package `plyfile`."""

from __future__ import annotations

import dataclasses
import errno
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plyfile import PlyData
from splats import HALF_TURN_Z, Read, covariances, read_ply, some

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import matrix_from_quaternion
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.play.outputs import FrameFormat, open_output, save_gaussians
from gavatar_runtime.play.player import play_gaussians
from gavatar_runtime.render.rasterizers.numpy import NumpyRasterizer
from gavatar_runtime.values.gaussians import Gaussians

ORDER = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)  # fmt: skip


def read(path: Path) -> Read:
    """What 3DGS makes of a file, turned back into a world whose y is up."""
    return read_ply(path).turned(HALF_TURN_Z)


def test_the_layout_is_that_of_the_authors_files(tmp_path):
    save_gaussians(tmp_path / "a.ply", some())
    content = (tmp_path / "a.ply").read_bytes()
    lines = content.split(b"end_header\n")[0].decode("ascii").splitlines()
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 7"]
    assert lines[3:] == [f"property float {name}" for name in ORDER]
    assert len(content) == content.index(b"end_header\n") + len(b"end_header\n") + 7 * 17 * 4
    file = PlyData.read(str(tmp_path / "a.ply"))
    assert (file.byte_order, file.text, [e.name for e in file.elements]) == ("<", False, ["vertex"])
    assert all(np.asarray(file["vertex"][name]).tolist() == [0] * 7 for name in ("nx", "ny", "nz"))


# 1e-6 relative, 1e-7 absolute: what float32 keeps of a number, of its logarithm and of half of it
CLOSE = {"rtol": 2e-6, "atol": 2e-7}


@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(0, 20),
    seed=st.integers(0, 2**16),
    dtype=st.sampled_from([np.float16, np.float32, np.float64]),
    opaque=st.booleans(),
)
def test_round_gaussians_come_back(tmp_path_factory, count, seed, dtype, opaque):
    path = tmp_path_factory.mktemp("ply") / "a.ply"
    opacities = None if opaque else np.random.default_rng(seed).uniform(0.01, 0.99, count)
    given = some(count, seed, dtype, opacities=opacities)
    save_gaussians(path, given)
    got = read(path)
    assert len(got.means) == count
    np.testing.assert_allclose(got.means, given.means, **CLOSE)
    np.testing.assert_allclose(got.colors, given.colors, **CLOSE)
    np.testing.assert_allclose(got.scales, np.repeat(given.scales[:, None], 3, 1), **CLOSE)
    # 1e-6: opacity 1 is written as so much less
    np.testing.assert_allclose(got.opacities, np.ones(count) if opaque else given.opacities, atol=1.1e-6, rtol=2e-6)


@pytest.mark.parametrize("turned", [False, True])
def test_long_gaussians_keep_their_axes(tmp_path, turned):
    rng = np.random.default_rng(1)
    quaternions = rng.normal(0, 1, (9, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    given = some(9, scales=rng.uniform(0.001, 0.1, (9, 3)), quaternions=quaternions if turned else None)
    save_gaussians(tmp_path / "a.ply", given)
    got = read(tmp_path / "a.ply")
    wanted = covariances(given.scales, matrix_from_quaternion(quaternions) if turned else None)
    np.testing.assert_allclose(covariances(got.scales, got.rotations), wanted, rtol=1e-5, atol=1e-8)  # float32, squared


@pytest.mark.parametrize("opacity", [0.0, 1e-9, 0.5, 1 - 1e-9, 1.0])
def test_opacities_at_the_ends_are_finite(tmp_path, opacity):
    save_gaussians(tmp_path / "a.ply", some(1, opacities=[opacity]))
    logit = np.asarray(PlyData.read(str(tmp_path / "a.ply"))["vertex"]["opacity"])
    assert np.isfinite(logit).all()
    assert read(tmp_path / "a.ply").opacities[0] == pytest.approx(opacity, abs=1.1e-6)


def test_a_scale_of_zero_is_a_micrometre(tmp_path):
    save_gaussians(tmp_path / "a.ply", some(2, scales=[0.0, 1e-12]))
    np.testing.assert_allclose(read(tmp_path / "a.ply").scales, 1e-6, rtol=2e-6)


def test_colours_beyond_the_display_are_kept(tmp_path):
    given = some(2, colors=[[-0.5, 0, 1], [2, 1, 0.5]])
    save_gaussians(tmp_path / "a.ply", given)
    np.testing.assert_allclose(read(tmp_path / "a.ply").colors, given.colors, **CLOSE)


@pytest.mark.parametrize(
    "faulty",
    [
        {"means": np.nan},
        {"means": np.inf},
        {"means": 1e300},
        {"colors": np.nan},
        {"scales": -1.0},
        {"opacities": np.nan},
    ],
)
def test_what_rasterizers_ignore_is_left_out_with_a_note(tmp_path, faulty):
    given = some(4, dtype=np.float64, opacities=np.full(4, 0.5))
    ((name, value),) = faulty.items()
    getattr(given, name)[2] = value
    notes = save_gaussians(tmp_path / "a.ply", given)
    assert notes == (f"{tmp_path / 'a.ply'}: 1 Gaussians are left out, whose numbers are not finite",)
    np.testing.assert_allclose(read(tmp_path / "a.ply").means, given.means[[0, 1, 3]], **CLOSE)


# from an avatar


@pytest.fixture
def avatar(dynamic):
    return Avatar(dynamic)


@pytest.fixture
def motion():
    poses = np.random.default_rng(0).normal(0, 0.2, (3, 52, 3)).astype(np.float32)
    from make_bundle import still

    return dataclasses.replace(still(3), poses=poses, trans=np.float32([[0, 0, 0], [0.1, 0, 0], [0.2, 0.5, -1]]))


def test_one_file_holds_the_first_frame_and_says_so(avatar, motion, tmp_path):
    output = open_output(tmp_path / "a.ply", FrameFormat(30))
    assert len(play_gaussians(avatar, motion, output)) == 1
    each = tmp_path / "a" / "%06d.ply"
    assert output.notes == [f"{tmp_path / 'a.ply'} holds the first of 3 frames; {each} would hold each in a file"]
    wanted = avatar.gaussians(*motion.at(0))
    np.testing.assert_allclose(read(tmp_path / "a.ply").means, wanted.means, **CLOSE)
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_one_file_a_frame(avatar, motion, tmp_path):
    output = open_output(tmp_path / "wave" / "frame_%04d.ply", FrameFormat(30))
    assert len(play_gaussians(avatar, motion, output)) == 3
    assert output.notes == []
    assert sorted(path.name for path in (tmp_path / "wave").iterdir()) == [f"frame_{i:04d}.ply" for i in range(3)]
    for frame in range(3):
        wanted, got = avatar.gaussians(*motion.at(frame)), read(tmp_path / "wave" / f"frame_{frame:04d}.ply")
        np.testing.assert_allclose(got.means, wanted.means, **CLOSE)
        np.testing.assert_allclose(got.colors, wanted.colors, **CLOSE)
        np.testing.assert_allclose(got.scales[:, 0], wanted.scales, **CLOSE)


def test_the_person_stands_on_their_head_in_the_file_and_upright_after_half_a_turn(avatar, motion, tmp_path):
    save_gaussians(tmp_path / "a.ply", avatar.gaussians(*motion.at(0)))
    y = np.asarray(PlyData.read(str(tmp_path / "a.ply"))["vertex"]["y"])
    wanted = avatar.gaussians(*motion.at(0)).means[:, 1]
    np.testing.assert_allclose(-y, wanted, **CLOSE)


def test_drawn_from_the_file_it_is_the_same_picture(avatar, motion, tmp_path):
    given = avatar.gaussians(*motion.at(0))
    save_gaussians(tmp_path / "a.ply", given)
    got = read(tmp_path / "a.ply")
    camera = frame_motion(avatar, motion, 96, 96)
    drawn = NumpyRasterizer().render(Gaussians(got.means, got.scales[:, 0], got.colors, got.opacities), camera)
    wanted = NumpyRasterizer().render(given, camera)
    # one byte step is 4e-3: rounded numbers of float32, and opacity that is 1e-6 less
    np.testing.assert_allclose(drawn.color, wanted.color, atol=1e-4)
    assert wanted.alpha.max() > 0.5


@pytest.mark.parametrize("name", ["a.ply", "f/%d.ply"])
def test_a_disk_that_is_full_is_named_and_leaves_nothing(avatar, motion, tmp_path, monkeypatch, name):
    def write(path, content):
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    output = open_output(tmp_path / name, FrameFormat(30))
    monkeypatch.setattr(Path, "write_bytes", write)
    with pytest.raises(UserError, match=rf"{name} could not be written: {os.strerror(errno.ENOSPC)}"):
        play_gaussians(avatar, motion, output)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_known_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    for name in ("a.ply", "f/%d.ply"):
        with pytest.raises(UserError, match="cannot be written"):
            open_output(tmp_path / "file" / name, FrameFormat(30))


def test_no_frame_is_no_file(tmp_path):
    output = open_output(tmp_path / "a.ply", FrameFormat(30))
    assert output.choose(0) == []
    with pytest.raises(UserError, match=r"a\.ply: there is no frame to write"):
        output.close()
    output.discard()
    assert list(tmp_path.iterdir()) == []
