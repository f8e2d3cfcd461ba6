"""An avatar as one .glb: its skeleton, skin and animations, evaluated by a reader of our tests' own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from gltf_reader import ReadGlb, read_glb
from make_bundle import SCALE, make_bundle, manifest, members, still
from tiered_members import write_tiered

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import pack_arrays, write_bundle
from gavatar_runtime.cli.convert import main
from gavatar_runtime.conversions import convert
from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.formats.bounded import arrays_of_npz
from gavatar_runtime.motions import read_motion
from gavatar_runtime.values.motion import Motion

# What a file may be off: float32 of matrices, quaternions and weights over a body of two metres and ten joints in a
# row, 2e-6 m; the wanted result itself is of float32.
CLOSE = 5e-6  # metres


def wild(frames: int = 6, seed: int = 0, name: str = "wild") -> Motion:
    """Every joint turned anyhow, by up to pi and beyond, somewhere in the room."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(0, 1.5, (frames, 52, 3)).astype(np.float32)
    return Motion(poses, rng.normal(0, 2, (frames, 3)).astype(np.float32), 24.0, name=name)


def written(bundle, folder, motions, **options) -> tuple[ReadGlb, tuple[str, ...]]:
    notes = convert(bundle, folder / "a.glb", motions=motions, **options)
    return read_glb((folder / "a.glb").read_bytes()), notes


def check_motion(file: ReadGlb, avatar: Avatar, motion: Motion) -> None:
    fitted = avatar.fit(motion)[0]
    for frame in range(len(fitted)):
        wanted = avatar.gaussians(*fitted.at(frame)).means
        got = file.skinned(motion.name, np.float32(frame / motion.fps))
        np.testing.assert_allclose(got, wanted, atol=CLOSE, rtol=0)


def test_the_skinned_points_are_where_the_avatar_has_them(static, tmp_path):
    motions = [wild(), read_motion("wave").taken(slice(0, 90, 30)), read_motion("turn").taken(slice(0, 180, 45))]
    file, notes = written(static, tmp_path, motions)
    assert notes == ()
    assert list(file.animations()) == ["wild", "wave", "turn"]
    for motion in motions:
        check_motion(file, Avatar(static), motion)


def test_of_a_moving_look_the_baked_one_is_kept_and_said(tmp_path):
    bundle = write_tiered(tmp_path / "a.gavatar")
    file, notes = written(bundle, tmp_path, [wild()])
    assert notes == ("the file holds one look for all poses: what follows the pose is left out",)
    check_motion(file, Avatar(bundle, tier="baked"), wild())
    wanted = Avatar(bundle, tier="baked").gaussians(np.zeros((52, 3)))
    arrays = file.primitive()
    colors = 0.5 + 0.28209479 * arrays["KHR_gaussian_splatting:SH_DEGREE_0_COEF_0"]
    np.testing.assert_allclose(colors, wanted.colors, atol=1e-6)  # float32
    np.testing.assert_array_equal(arrays["KHR_gaussian_splatting:SCALE"], np.repeat(wanted.scales[:, None], 3, 1))
    same, notes = written(bundle, tmp_path, [wild()], tier="baked")
    assert notes == ()
    assert same.document == file.document


def test_between_frames_joints_turn_the_short_way(static, tmp_path):
    """Two frames whose axis-angles are almost a turn apart, and whose rotations are almost the same."""
    motion = still(2)
    motion.poses[0, 16], motion.poses[1, 16] = (0, 0, np.pi - 0.1), (0, 0, -np.pi + 0.1)
    file, _ = written(static, tmp_path, [motion])
    middle = still(1)
    middle.poses[0, 16] = (0, 0, np.pi)
    wanted = Avatar(static).gaussians(*Avatar(static).fit(middle)[0].at(0)).means
    np.testing.assert_allclose(file.skinned("still", 0.5 / 30), wanted, atol=CLOSE, rtol=0)


def test_nodes_are_the_joints_at_ease_and_those_that_stay_have_no_track(static, tmp_path):
    avatar = Avatar(static)
    motion = still(4)
    motion.poses[:, 20, 1] = (0, 0.1, 0.2, 0.3)  # one wrist
    file, _ = written(static, tmp_path, [motion])
    nodes = file.document["nodes"]
    assert [node["name"] for node in nodes[:-1]] == list(avatar.joint_names)
    for joint, parent in enumerate(avatar.surface.parents):
        holders = [i for i, node in enumerate(nodes) if joint in node.get("children", ())]
        assert holders == ([parent] if parent >= 0 else [])
    eased = read_motion("wave")  # its legs stand at ease
    fitted = avatar.fit(eased)[0]
    (animation,) = file.document["animations"]
    turned = {c["target"]["node"] for c in animation["channels"] if c["target"]["path"] == "rotation"}
    keys = {
        c["target"]["node"]: file.document["accessors"][animation["samplers"][c["sampler"]]["output"]]["count"]
        for c in animation["channels"]
    }
    assert keys[20] == 4
    assert {count for joint, count in keys.items() if joint != 20} == {1}  # elsewhere than at ease, and still
    legs = [avatar.joint_names.index(name) for name in ("left_knee", "right_knee")]
    assert not (set(legs) & turned and (fitted.poses[0, legs] == 0).all())


@pytest.mark.parametrize("frames", [1, 2])
def test_a_motion_of_one_frame_is_one_key(frames, static, tmp_path):
    file, _ = written(static, tmp_path, [wild(frames)])
    (animation,) = file.document["animations"]
    counts = {file.document["accessors"][s["input"]]["count"] for s in animation["samplers"]}
    assert counts == {frames}
    check_motion(file, Avatar(static), wild(frames))


def test_motions_of_one_name_are_told_apart(static, tmp_path):
    file, _ = written(static, tmp_path, [wild(2), wild(2, seed=1)])
    assert list(file.animations()) == ["wild", "wild_2"]
    check_motion(file, Avatar(static), dataclasses.replace(wild(2, seed=1), name="wild_2"))


def many_jointed(folder, joints: int = 6):
    """Whose points follow six joints each, the lightest by a hundredth."""
    made = members(40)
    arrays = arrays_of_npz(made["surface.npz"])
    rng = np.random.default_rng(0)
    index = np.stack([rng.permutation(20)[:joints] for _ in range(40)])
    arrays["gaussians_joint_index"] = index.astype(np.uint8)
    weights = np.array([0.5, 0.2, 0.15, 0.1, 0.04, 0.01])[:joints]
    arrays["gaussians_joint_weight"] = np.tile(weights / weights.sum(), (40, 1)).astype(np.float32)
    write_bundle(folder / "b.gavatar", manifest(40), made | {"surface.npz": pack_arrays(arrays)})
    return folder / "b.gavatar"


def test_more_than_four_joints_are_two_sets_or_the_heaviest_four(tmp_path):
    bundle = many_jointed(tmp_path)
    file, notes = written(bundle, tmp_path, [wild()])
    assert notes == (
        "40 of 40 points follow more than 4 joints: for a viewer that reads no more, give the option joints=4",
    )
    check_motion(file, Avatar(bundle), wild())
    file, notes = written(bundle, tmp_path, [wild()], options={"joints": 4})
    assert notes == ("40 of 40 points follow more than 4 joints: the lightest are left out",)
    arrays = file.primitive()
    assert [name for name in arrays if name.startswith("JOINTS")] == ["JOINTS_0"]
    np.testing.assert_allclose(arrays["WEIGHTS_0"], np.tile(np.array([50, 20, 15, 10]) / 95, (40, 1)), rtol=1e-6)
    with pytest.raises(WrongValue, match="`joints=3`: give a multiple of 4"):
        written(bundle, tmp_path, [wild()], options={"joints": 3})


def test_weights_sum_to_one_and_joints_without_weight_are_zero(static, tmp_path):
    arrays = written(static, tmp_path, [wild(1)])[0].primitive()
    weights, joints = arrays["WEIGHTS_0"], arrays["JOINTS_0"]
    np.testing.assert_allclose(weights.sum(1), 1, atol=2e-7)  # what the validator allows a set of four
    assert (np.diff(weights, axis=1) <= 0).all()
    assert (joints[weights == 0] == 0).all()


def test_fewer_gaussians(static, tmp_path):
    file, _ = written(static, tmp_path, [wild(1)], gaussians=50)
    everything, _ = written(static, tmp_path, [wild(1)])
    assert len(file.primitive()["POSITION"]) == 50
    rows = {tuple(row) for row in everything.primitive()["POSITION"]}
    assert {tuple(row) for row in file.primitive()["POSITION"]} <= rows
    assert (file.primitive()["KHR_gaussian_splatting:SCALE"] >= 0.012 - 1e-9).all()


def test_one_gaussian(tmp_path):
    bundle = make_bundle(tmp_path / "one.gavatar", 1)
    file, _ = written(bundle, tmp_path, [wild()])
    check_motion(file, Avatar(bundle), wild())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tier": "blendshape"}, "`tier=blendshape` follows the pose, and a glTF file holds one look"),
        ({"tier": "full"}, "`tier=full`: without its networks blendshape or baked of this bundle can be played"),
        ({"motions": [still(0)]}, "motion 'still' has no frames"),
        ({"gaussians": 0}, "`gaussians=0`: give a whole number from 1 up"),
        ({"options": {"bones": 4}}, "conversion 'glb' has no option 'bones'"),
    ],
)
def test_what_cannot_be_is_one_sentence_and_no_file(change, message, tmp_path):
    bundle = write_tiered(tmp_path / "a.gavatar")
    with pytest.raises(UserError, match=message):
        convert(bundle, tmp_path / "out" / "a.glb", **{"motions": [wild()], **change})
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


def test_a_look_that_needs_networks_is_refused(dynamic, tmp_path):
    with pytest.raises(WrongValue, match="holds no tier that plays without its networks"):
        convert(dynamic, tmp_path / "a.glb")


def test_by_the_command(static, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main([str(static), str(tmp_path / "a.glb"), "--motions", "wave", "--set", "joints=4"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.endswith("MB, motions wave\n")
    assert list(read_glb((tmp_path / "a.glb").read_bytes()).animations()) == ["wave"]


def test_splats_are_as_large_as_the_training_images_showed_them(tmp_path):
    write_bundle(tmp_path / "b.gavatar", dataclasses.replace(manifest(9), training={"pixel_m": 0.009}), members(9))
    scales = written(tmp_path / "b.gavatar", tmp_path, [wild(1)])[0].primitive()["KHR_gaussian_splatting:SCALE"]
    np.testing.assert_allclose(scales, np.sqrt(SCALE**2 + 0.3 * 0.009**2), rtol=1e-6)  # float32
