"""The scene that every wheel's library draws, and its picture by NumPy alone, in double precision.

The package's own body walks: each of its 12,700 vertices is an elongated, half transparent Gaussian. `draw.cpp` reads
the file that `write_scene` writes.
"""

from __future__ import annotations

import ctypes
import dataclasses
import struct
from pathlib import Path

import numpy as np

from gavatar_runtime import native_library as nl
from gavatar_runtime.geometry import kinematics
from gavatar_runtime.render.rasterizers import numpy as reference
from gavatar_runtime.splatting_rule import TRANSMITTANCE_STOP
from gavatar_runtime.values.camera import Camera, look_at
from gavatar_runtime.values.gaussians import Gaussians

ROOT = Path(__file__).resolve().parents[2]
BODY = ROOT / "gavatar" / "data" / "body" / "gavatar_body_smplh.npz"
SLOTS, SIZE, BACKGROUND = 4, 512, (1.0, 1.0, 1.0)
BENT = {1: (-0.5, 0, 0), 2: (0.4, 0, 0), 4: (0.3, 0, 0), 5: (0.6, 0, 0), 16: (0.4, 0, -1.1), 17: (-0.4, 0, 1.1)}


@dataclasses.dataclass
class Scene:
    """rest: (N, 3) points, skinned by weight and index (N, 4) with transforms (J, 3, 4). gaussians: their means at
    rest. upstream: (H, W, 3) gradient by the picture."""

    rest: np.ndarray
    index: np.ndarray
    weight: np.ndarray
    transforms: np.ndarray
    gaussians: Gaussians
    camera: Camera
    upstream: np.ndarray


def make_scene() -> Scene:
    """The same one at every call."""
    with np.load(BODY) as body:
        rest, weights, parents = body["v_template"], body["weights"], body["kintree_table"][0].astype(np.int64)
        joints = (body["J_regressor"] @ rest).astype(np.float64)
    parents[0] = -1
    index = np.argsort(-weights, 1, kind="stable")[:, :SLOTS].astype(np.int32)
    weight = np.take_along_axis(weights, index, 1)
    weight = (weight / weight.sum(1, keepdims=True)).astype(np.float32)
    pose = np.zeros((len(parents), 3))
    for joint, angle in BENT.items():
        pose[joint] = angle
    world = kinematics.joint_transforms(pose, joints, parents)
    transforms = kinematics.skinning_transforms(world, joints)[:, :3].astype(np.float32)
    rng = np.random.default_rng(0)
    count = len(rest)
    colors = 0.5 + 0.5 * np.sin(np.stack([3 * rest[:, 0], 9 * rest[:, 1], 5 * rest[:, 2]], 1) + np.array([0, 2, 4]))
    fields = (rest, rng.uniform(0.004, 0.014, (count, 3)), colors, rng.uniform(0.3, 1, count))
    gaussians = Gaussians(*(x.astype(np.float32) for x in (*fields, rng.normal(size=(count, 4)))))
    middle = (rest.max(0) + rest.min(0)) / 2
    view = look_at(middle + np.array([1.2, 0.4, 2.4]), middle)
    camera = Camera(SIZE, SIZE, 640.0, 640.0, SIZE / 2, SIZE / 2, view)
    upstream = rng.normal(size=(SIZE, SIZE, 3)).astype(np.float32)
    return Scene(rest, index, weight, transforms, gaussians, camera, upstream)


def picture_by_numpy(scene: Scene) -> np.ndarray:
    """(H, W, 3) float64: the plain reference of skinning and of the splatting rule."""
    means = kinematics.skin(scene.rest.astype(np.float64), scene.index, scene.weight, scene.transforms)
    moved = dataclasses.replace(scene.gaussians, means=means)
    splats = reference.project(moved, scene.camera, np.float64)
    tiles = reference.tile_lists(splats, scene.camera)
    return reference.blend(splats, *tiles, scene.camera, BACKGROUND).color


def write_scene(scene: Scene, path: Path) -> None:
    """Write the file that draw.cpp reads."""
    options = nl.OptionsStruct(
        background=(ctypes.c_float * 3)(*BACKGROUND), transmittance_stop=TRANSMITTANCE_STOP, keep=1
    )
    g = scene.gaussians
    arrays = (
        scene.rest, scene.weight, scene.transforms, g.scales, g.colors, g.opacities, g.quaternions, scene.upstream,
        scene.index,
    )  # fmt: skip
    with open(path, "wb") as file:
        file.write(struct.pack("<4i", len(g), SLOTS, len(scene.transforms), 0))
        file.write(bytes(nl.camera_struct(scene.camera)) + bytes(options))
        for array in arrays:
            file.write(np.ascontiguousarray(array).tobytes())


def read_drawn(scene: Scene, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """What draw.cpp wrote: the picture (H, W, 3), and all gradients one after another."""
    values = np.fromfile(path, np.float32)
    pixels, count = scene.camera.width * scene.camera.height, len(scene.gaussians)
    if len(values) != 5 * pixels + 17 * count:
        raise ValueError(f"{path} has {len(values)} numbers, {5 * pixels + 17 * count} belong there")
    return values[: 3 * pixels].reshape(scene.camera.height, scene.camera.width, 3), values[5 * pixels + 3 * count :]


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """dB, of values in [0, 1]."""
    error = float(np.mean((a.astype(np.float64) - b) ** 2))
    return float("inf") if error == 0 else -10 * float(np.log10(error))
