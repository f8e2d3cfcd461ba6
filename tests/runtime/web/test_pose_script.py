"""The page's arithmetic of poses, run by node, held to the player's."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from player_script import joints_of, run

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.geometry.kinematics import joint_transforms, skinning_transforms
from gavatar_runtime.motions import read_motion
from gavatar_runtime.tiers.blendshape import Coefficients
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.web.look import StillLook, read_look

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from tiered_members import write_tiered

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="no node here")

CLOSE = 1e-5  # float32 sums of a few hundred numbers near 1


@pytest.fixture(scope="module")
def look(tmp_path_factory) -> StillLook:
    return read_look(Avatar(read_bundle(write_tiered(tmp_path_factory.mktemp("node") / "t.gavatar")), tier=None))


def poses() -> np.ndarray:
    """(T, 52, 3): at rest, random, tiny, and joints turned by pi and by more."""
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(52, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.stack(
        [np.zeros((52, 3)), rng.normal(0, 0.5, (52, 3)), axes * 1e-9, axes * np.pi, axes * 7, axes * 2 * np.pi]
    )


def test_transforms_are_the_players(look, tmp_path):
    trans = np.random.default_rng(1).normal(size=(6, 3))
    got = run(
        tmp_path,
        "const s = new Skeleton(given.joints); return given.poses.map((p, k) =>"
        "Array.from(s.transforms(matricesFromAxisAngle(p), given.trans[k])));",
        joints=joints_of(look),
        poses=[p.ravel().tolist() for p in poses()], trans=trans.tolist(),
    )  # fmt: skip
    inverse = np.concatenate([look.inverse, np.tile([[[0.0, 0, 0, 1]]], (52, 1, 1))], 1)
    for k, pose in enumerate(poses()):
        A = skinning_transforms(joint_transforms(pose, look.rest, look.parents), look.rest) @ inverse
        A[:, :3, 3] += trans[k]
        assert np.abs(np.reshape(got[k], (52, 3, 4)) - A[:, :3]).max() < CLOSE, k


def test_weights_of_the_look_are_the_players(look, tmp_path):
    assert look.residual is not None
    rng = np.random.default_rng(3)
    arrays = dict(look.residual)
    arrays["direct"] = rng.normal(0, 0.1, arrays["direct"].shape).astype(np.float32)
    arrays["turn"] = rng.normal(0, 0.1, arrays["turn"].shape).astype(np.float32)
    arrays["owners"] = np.array([0, 15], np.uint8)
    ours = Coefficients(arrays, look.parents, "here")
    some = np.concatenate([poses() * scale for scale in (1, 0.2, 0.05)])
    given = {n: a for n, a in arrays.items() if n not in ("part", "basis")}
    got = run(
        tmp_path,
        "const s = new Skeleton(given.joints), c = new Coefficients(given.arrays); return given.poses.map((p) => {"
        "const local = matricesFromAxisAngle(p); s.transforms(local); return Array.from(c.of(local, s.world)); });",
        joints=joints_of(look),
        arrays=given, poses=[p.ravel().tolist() for p in some],
    )  # fmt: skip
    wanted = np.stack([ours(pose.astype(np.float32)).ravel() for pose in some])
    assert np.ptp(wanted) > 0.1
    assert np.abs(np.array(got) - wanted).max() < CLOSE


def test_between_frames_is_the_players(tmp_path):
    rng = np.random.default_rng(4)
    motion = Motion(rng.normal(0, 1, (4, 5, 3)).astype(np.float32), rng.normal(size=(4, 3)).astype(np.float32), 10.0)
    times = [-1.0, 0.0, 0.03, 0.05, 0.1, 0.299, 0.3, 5.0]
    got = run(
        tmp_path,
        "const m = new Motion({ ...given, joints: 5, poses: Float32Array.from(given.poses),"
        "trans: Float32Array.from(given.trans) });"
        "return given.times.map((t) => { const { pose, trans } = m.at(t);"
        "return [...matricesFromAxisAngle(pose), ...trans]; });",
        name="m", fps=10, poses=motion.poses, trans=motion.trans, times=times,
    )  # fmt: skip
    from gavatar_runtime.geometry.rotations import matrix_from_axis_angle

    for time, row in zip(times, got, strict=True):
        pose, trans, _ = motion.at_time(time)
        assert np.abs(np.array(row) - np.concatenate([matrix_from_axis_angle(pose).ravel(), trans])).max() < CLOSE


@pytest.mark.parametrize("z_up", [False, True])
def test_a_dropped_file_is_what_the_player_reads(look, tmp_path, z_up):
    rng = np.random.default_rng(5)
    given = rng.normal(0, 0.3, (4, 156))
    given[:, :3] = [np.pi / 2, 0, 0] if z_up else [0.1, 0.2, 0]
    trans = rng.normal(size=(4, 3))
    np.savez_compressed(tmp_path / "m.npz", poses=given, trans=trans, mocap_framerate=60.0)
    read = read_motion(tmp_path / "m.npz")
    data = (tmp_path / "m.npz").read_bytes()
    got = run(
        tmp_path,
        "const file = { name: 'm.npz', arrayBuffer: async () => Uint8Array.from(given.data).buffer };"
        "const m = await readMotionFile(file, given.body, Float32Array.from(given.relaxed));"
        "return [m.fps, Array.from(m.poses), Array.from(m.trans)];",
        data=list(data), body={"names": look.joint_names}, relaxed=look.relaxed,
    )  # fmt: skip
    assert got[0] == read.fps
    assert np.abs(np.reshape(got[1], read.poses.shape) - read.poses).max() < CLOSE
    assert np.abs(np.reshape(got[2], read.trans.shape) - read.trans).max() < CLOSE


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [("m.bvh", b"HIERARCHY", "no joints of the SMPL family"), ("m.npz", b"", "no whole .npz"),
     ("m.npz", b"PK" * 99, "no whole .npz"),
     ("m.fbx", b"x", "gavatar-motion convert")],
)  # fmt: skip
def test_what_the_page_cannot_read_is_one_sentence(look, tmp_path, name, data, said):
    got = run(
        tmp_path,
        "const file = { name: given.name, arrayBuffer: async () => Uint8Array.from(given.data).buffer };"
        "return readMotionFile(file, { names: [] }, []).then(() => '', (error) => error.message);",
        name=name, data=list(data),
    )  # fmt: skip
    assert said in got
    assert name in got


def test_the_sort_is_far_to_near(look, tmp_path):
    """In chunks, of Gaussians that one to six of eight joints move, and that are cut off by a limit."""
    rng = np.random.default_rng(6)
    points = rng.normal(size=(500, 3)).astype(np.float32)
    weights = np.zeros((500, 8), np.uint8)
    for row in weights:
        used = rng.integers(1, 7)
        row[:used] = np.sort(rng.multinomial(255 - used, np.ones(used) / used) + 1)[::-1]
    joints, rows = rng.integers(0, 20, (500, 8)), rng.normal(size=(20, 4)).astype(np.float32)
    rows[:, 3] += 2
    got = run(
        tmp_path,
        "globalThis.self = { postMessage: (m) => { self.told = m; } }; sorterThread();"
        "for (const [a, b] of [[0, 3], [3, 300], [300, 500]]) self.onmessage({ data: { start: a, slots: 8,"
        "points: Float32Array.from(given.points.slice(a, b).flat()), joints: Uint8Array.from(given.joints.slice(a, b)"
        ".flat()), weights: Uint8Array.from(given.weights.slice(a, b).flat()) } });"
        "const rows = Float32Array.from(given.rows.flat());"
        "self.onmessage({ data: { rows, limit: 400, near: 0.01, ticket: 1 } });"
        "return [self.told.seen, Array.from(self.told.order)];",
        points=points.tolist(), weights=weights.tolist(), joints=joints.tolist(), rows=rows.tolist(),
    )  # fmt: skip
    of_joints = np.einsum("jc,nc->nj", rows.astype(np.float64), np.c_[points, np.ones(500)])
    depth = (np.take_along_axis(of_joints, joints, 1) * weights / 255).sum(1)[:400]
    seen = depth > 0.01
    assert got[0] == seen.sum()
    assert sorted(got[1][: got[0]]) == np.flatnonzero(seen).tolist()
    steps = np.diff(depth[got[1][: got[0]]])
    assert steps.max() <= np.ptp(depth[seen]) / 65535 + 1e-6  # of 16-bit keys
