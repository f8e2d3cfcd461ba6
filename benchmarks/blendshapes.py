"""What expressions and live pose blendshapes cost a player: bytes in the bundle, milliseconds a frame.

python benchmarks/blendshapes.py

On random directions in the official models' numbers of vertices, joints and coefficients, with the points of an atlas
of 512 x 512 texels; a fifth of SMPL-X's points lie in the face.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from make_bundle import free_body, surface_of

from gavatar_runtime.avatar.expression import Expression
from gavatar_runtime.avatar.pose_blendshapes import PoseBlendshapes, Turns
from gavatar_runtime.bundle import pack_arrays

MODELS = {"SMPL": (6890, 24, 202_700, 0), "SMPL-X": (10475, 55, 191_600, 10)}  # vertices, joints, points, expressions
BODY_JOINTS = 22


def milliseconds(work, repeats: int = 20) -> float:
    """Median of some calls, after two that warm up."""
    times = []
    for _ in range(repeats + 2):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times[2:]))


def surface(points: int, joints: int):
    """The free body's surface with so many points, its joint numbers below `joints`."""
    one = surface_of(free_body(), 4000, 512)
    rows = np.arange(points) % len(one)
    arrays = {name: getattr(one, name)[rows] for name in ("points", "joint_index", "joint_weight")}
    arrays["joint_index"] = np.minimum(arrays["joint_index"], joints - 1)
    A = np.tile(np.eye(4), (joints, 1, 1))
    A[: min(joints, 52)] = one.A_canonical[: min(joints, 52)]
    return dataclasses.replace(one, **arrays, A_canonical=A)


def measure(name: str, vertices: int, joints: int, points: int, expressions: int) -> None:
    """Print the lines of one model."""
    rng = np.random.default_rng(0)
    posedirs = rng.normal(0, 1e-3, (vertices, 3, 9 * (joints - 1))).astype(np.float32)
    corners = rng.integers(0, vertices, (points, 3))
    corners.sort(0)  # neighbours in the atlas are neighbours on the mesh
    made = PoseBlendshapes.of(posedirs, np.zeros((joints, 3)), corners, np.full((points, 3), 1 / 3))
    skin = surface(points, joints)
    turns = Turns.of(skin)
    whole = rng.normal(0, 0.3, (joints, 3)).astype(np.float32)
    body = whole * (np.arange(joints) < BODY_JOINTS)[:, None]
    size = len(pack_arrays(made.to_arrays())) / 1e6
    some, all_of_them = (milliseconds(lambda pose=pose: made.offsets(pose, turns)) for pose in (body, whole))
    print(f"{name}: pose blendshapes of {points} points: {size:.1f} MB; {some:.1f} ms a frame in a motion of "
          f"{BODY_JOINTS} joints, {all_of_them:.1f} ms in one of {joints}")  # fmt: skip
    if expressions:
        rows = np.arange(points // 5, dtype=np.int32)
        directions = rng.normal(0, 1e-3, (len(rows), 3, expressions)).astype(np.float32)
        face = Expression(rows, directions, np.zeros((joints, 3, expressions), np.float32))
        values = rng.normal(0, 1, expressions).astype(np.float32)
        size = len(pack_arrays(face.to_arrays())) / 1e6
        cost = milliseconds(lambda: face.points(skin.points, values))
        print(f"{name}: {expressions} expressions of {len(rows)} points: {size:.1f} MB; {cost:.2f} ms a frame")


if __name__ == "__main__":
    for name, numbers in MODELS.items():
        measure(name, *numbers)
