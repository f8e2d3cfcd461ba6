"""Rest poses of BVH: OFFSETs that draw nobody, first frames, and what anatomy tells."""

from __future__ import annotations

import numpy as np
import places
import pytest
from bvh_rigs import NEXT, directions, random_angles, scrambled, write_bvh, write_parsed
from make_bundle import free_body

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.bvh_file import read_bvh
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.motions import read_motion
from gavatar_runtime.values.skeletons import SMPLH


def test_offsets_that_draw_no_person_are_understood_by_the_first_frame(tmp_path):
    angles = random_angles(6)
    angles[0] = 0  # the first frame stands in the rest pose
    root = np.stack([np.linspace(0, 50, 6), np.full(6, 95.0), np.zeros(6)], 1)
    write_bvh(tmp_path / "plain.bvh", angles, root)
    write_parsed(tmp_path / "odd.bvh", scrambled(read_bvh(tmp_path / "plain.bvh")))
    expected = read_motion(tmp_path / "plain.bvh")
    odd = read_motion(tmp_path / "odd.bvh", rest="first-frame")
    # 1e-5 rad: nine digits of degrees through thirty products
    there, here = (matrix_from_axis_angle(m.poses.astype(float)) for m in (expected, odd))
    np.testing.assert_allclose(here, there, atol=1e-5)
    np.testing.assert_allclose(odd.trans, expected.trans, atol=1e-5)
    drawn = read_motion(tmp_path / "odd.bvh", rest="offsets")
    assert np.abs(matrix_from_axis_angle(drawn.poses.astype(float)) - there).max() > 0.5
    plain = read_motion(tmp_path / "plain.bvh", rest="first-frame")
    np.testing.assert_allclose(plain.poses, expected.poses, atol=1e-6)
    with pytest.raises(UserError, match="rest=second: choose from auto, offsets, first-frame, anatomy"):
        read_motion(tmp_path / "plain.bvh", rest="second")


@pytest.mark.shared
@pytest.mark.parametrize("name", ["dab", "jumping", "jumping_jacks", "wave_hello", "zombie"])
def test_the_first_frame_of_the_shared_clips_may_be_their_rest_pose(name, tmp_path):
    path = places.SHARED / "motions" / f"{name}.bvh"
    if not path.exists():
        pytest.skip(f"{path} is absent")
    offsets, first = read_motion(path), read_motion(path, rest="first-frame")
    middle = [SMPLH.index(n) for n in ("spine1", "spine2", "spine3", "neck", "head")]
    # 1e-6: the person stands at rest in the first frame
    assert np.abs(matrix_from_axis_angle(first.poses[0, middle].astype(float)) - np.eye(3)).max() < 1e-6
    body = free_body()
    _, rest = body.shaped(None)
    limbs = [joint_transforms(m.poses.astype(np.float64), rest, body.parents)[..., :3, 3] for m in (offsets, first)]
    # whatever the rest pose, limbs point where the rig's do; who stands at rest faces +z, so the heading may differ
    pairs = [(SMPLH.index(f"{s}_{a}"), SMPLH.index(f"{s}_{b}")) for s in ("left", "right") for a, b in NEXT.items()]
    mine, theirs = (np.concatenate([directions(places, *pair) for pair in pairs]) for places in limbs)
    U, _, Vt = np.linalg.svd(theirs.T @ mine)
    turn = U @ Vt
    np.testing.assert_allclose(turn, np.round(turn), atol=1e-3)  # a quarter, a half or no turn ...
    assert turn[1, 1] == pytest.approx(1, abs=1e-5)  # ... about the vertical
    angle = np.degrees(np.arccos(np.clip((theirs * (mine @ turn.T)).sum(-1), -1, 1)))
    assert angle.max() < 0.1  # float32 axis-angle
    # the odd twin of the clip, whose OFFSETs draw nothing, is read as the same motion
    write_parsed(tmp_path / "odd.bvh", scrambled(read_bvh(path)))
    odd = read_motion(tmp_path / "odd.bvh", rest="first-frame")
    there, here = (matrix_from_axis_angle(m.poses.astype(float)) for m in (first, odd))
    np.testing.assert_allclose(here, there, atol=1e-4)  # nine digits of degrees through sixty products
    np.testing.assert_allclose(odd.trans, first.trans, atol=1e-4)
