"""Our .glb through Khronos's validator and trimesh."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from make_bundle import make_bundle, still
from node_packages import node_package, run_node
from splats import long_ones, some

from gavatar_runtime.conversions import convert
from gavatar_runtime.play.outputs import save_gaussians
from gavatar_runtime.play.outputs.glb import linear_light

VALIDATOR = ("gltf-validator", "2.0.0-dev.3.10")
CHECK = """
const [folder, file] = process.argv.slice(1);
require(folder).validateBytes(new Uint8Array(require('fs').readFileSync(file)), {maxIssues: 0})
  .then((report) => console.log(JSON.stringify(report)));
"""
EXTENSION = "KHR_gaussian_splatting"


def complaints(path: Path, factory) -> list[tuple[int, str, str]]:
    """(severity, code, where) of all that it reports; 0 is an error, 1 a warning, 2 a hint."""
    folder = node_package(factory, *VALIDATOR)
    report = json.loads(run_node("-e", CHECK, folder, path))
    return [(m["severity"], m["code"], m["pointer"].rpartition("/")[2]) for m in report["issues"]["messages"]]


def plain(path: Path) -> Path:
    """The same file with the extension's attributes under names that the application may choose, which the validator
    checks like any others."""
    content = path.read_bytes()
    renamed = content.replace(f'"{EXTENSION}:'.encode(), b'"_' + b"X" * len(EXTENSION))
    assert renamed != content
    out = path.with_name("plain.glb")
    out.write_bytes(renamed)
    return out


def make_static(folder: Path) -> Path:
    save_gaussians(folder / "a.glb", long_ones(50))
    return folder / "a.glb"


def make_skinned(folder: Path) -> Path:
    motions = [still(1, name="one"), "wave", "turn"]
    convert(make_bundle(folder / "a.gavatar"), folder / "a.glb", motions=motions)
    return folder / "a.glb"


@pytest.mark.parametrize("make", [make_static, make_skinned])
def test_the_validator_complains_of_nothing_but_that_it_does_not_know_the_extension(make, tmp_path, tmp_path_factory):
    path = make(tmp_path)
    unknown = (2, "UNSUPPORTED_EXTENSION", "0")
    names = {f"{EXTENSION}:{name}" for name in ("ROTATION", "SCALE", "OPACITY", "SH_DEGREE_0_COEF_0")}
    assert set(complaints(path, tmp_path_factory)) == {
        unknown, *((0, "MESH_PRIMITIVE_INVALID_ATTRIBUTE", name) for name in names),
    }  # fmt: skip
    assert complaints(plain(path), tmp_path_factory) == [unknown]


def test_the_validator_is_one_that_complains(tmp_path, tmp_path_factory):
    content = make_static(tmp_path).read_bytes()
    (tmp_path / "b.glb").write_bytes(content.replace(b'"VEC3"', b'"VEC2"', 1))
    assert [c for c in complaints(tmp_path / "b.glb", tmp_path_factory) if c[0] == 0]


def test_a_file_without_gaussians_is_valid(tmp_path, tmp_path_factory):
    save_gaussians(tmp_path / "a.glb", some(0))
    assert [c for c in complaints(tmp_path / "a.glb", tmp_path_factory) if c[0] < 2] == []


def test_trimesh_sees_points_in_linear_light(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    given = some(30)
    save_gaussians(tmp_path / "a.glb", given)
    (cloud,) = trimesh.load(tmp_path / "a.glb").geometry.values()
    np.testing.assert_allclose(cloud.vertices, given.means, atol=1e-6)
    # it keeps bytes, cut off
    np.testing.assert_allclose(np.asarray(cloud.colors)[:, :3] / 255, linear_light(given.colors), atol=1 / 255)
