"""Captures in other people's layouts, read in place: where the body falls in the images, splits, faults."""

from __future__ import annotations

import dataclasses
import json
import pickle
import shutil

import cv2
import foreign_captures as write
import numpy as np
import pytest
import torch
from tiny_capture import SMALL, demo, write_tiny_capture

from gavatar.capture.capture import View, read_capture
from gavatar.capture.check import check_capture
from gavatar.capture.opening import open_capture
from gavatar.cli.prepare import main as prepare
from gavatar.registry import CAPTURES, load_plugins
from gavatar_plugins.captures.instantavatar import PUBLISHED, InstantAvatarCapture, InstantAvatarOptions
from gavatar_plugins.captures.neuman import _splits as neuman_splits
from gavatar_plugins.captures.zju import ZjuCapture, ZjuOptions
from gavatar_runtime.errors import UserError

load_plugins()

LAYOUTS = {
    "instantavatar": ("instantavatar", write.instantavatar),
    "instantavatar, NeuMan": ("instantavatar", lambda f: write.instantavatar(f, npy=False, thetas=False)),
    "upstream": ("upstream", write.upstream),
    "upstream, moving camera": ("upstream", lambda f: write.upstream(f, moving=True)),
    "upstream, SMPL-X": ("upstream", lambda f: write.upstream(f, joints=55)),
    "zju": ("zju", write.zju),
    "zju, params": ("zju", lambda f: write.zju(f, params="params")),
    "neuman": ("neuman", write.neuman),
}


@pytest.fixture(params=LAYOUTS)
def layout(request, tmp_path):
    folder = tmp_path / "person"
    folder.mkdir()
    name, writer = LAYOUTS[request.param]
    return name, folder, writer(folder)


def test_the_body_falls_where_the_data_sets_own_reader_puts_it(layout):
    name, folder, expected = layout
    before = sorted(p for p in folder.rglob("*"))
    capture = open_capture(folder).placed(expected["body"])
    capture.check()
    seen = {view for views in capture.splits.values() for view in views}
    assert {(v.camera, v.frame) for v in seen} == set(expected["pixels"])
    motion = capture.motion
    for view in seen:
        posed, _ = expected["body"].posed(
            motion.poses[view.frame].astype(float), motion.betas, motion.trans[view.frame]
        )
        pixels = capture.camera(view).project(posed)[:, :2]
        # 2e-3 pixels: poses of a float32 motion, radians near pi, over a metre at a focal length of 60
        np.testing.assert_allclose(pixels, expected["pixels"][view.camera, view.frame], atol=2e-3, err_msg=str(view))
    assert sorted(p for p in folder.rglob("*")) == before  # nothing is written or copied
    assert CAPTURES[name].factory.recognises(folder)


def test_the_person_stands_upright_in_the_world(layout):
    _, folder, expected = layout
    capture = open_capture(folder).placed(expected["body"])
    from gavatar_runtime.geometry.rotations import matrix_from_axis_angle

    up = matrix_from_axis_angle(capture.motion.poses[:, 0].astype(float))[:, 1, 1]
    assert up.mean() > 0.9


def test_masks_are_the_person_and_nothing_else(layout):
    _, folder, expected = layout
    capture = open_capture(folder)
    color, alpha = capture.load(capture.views("train")[0])
    np.testing.assert_array_equal(alpha > 0.5, expected["person"])
    assert set(np.unique(alpha)) == {0.0, 1.0}
    assert color[~expected["person"]].max() == 0


def test_a_sound_capture_passes_the_check_and_each_layout_is_recognised_alone(layout, capsys):
    name, folder, _ = layout
    found = check_capture(folder)
    assert (found.format, found.faults) == (name, [])
    recognising = [c.name for c in CAPTURES if c.factory.recognises(folder)]
    assert recognising == [name]
    with pytest.raises(SystemExit) as done:
        prepare(["--check", str(folder)])
    assert done.value.code == 0
    assert "nothing is wrong" in capsys.readouterr().out


def test_on_a_body_of_another_family_the_pelvis_stays_and_the_shape_is_left_out(tmp_path):
    from make_bundle import free_body

    expected = write.instantavatar(tmp_path)
    own, free = open_capture(tmp_path).placed(expected["body"]), open_capture(tmp_path).placed(free_body())
    assert free.motion.betas is None
    assert own.motion.betas.shape == (10,)
    mean = np.array([0, -0.23, 0.03])  # of SMPL, where the capture's own body has another random one
    rest = free_body().shaped(None)[1][0]
    turn = np.diag([1, -1, -1])
    transl = np.load(tmp_path / "poses.npz")["transl"]
    np.testing.assert_allclose(free.motion.trans + rest, (transl + mean) @ turn, atol=1e-5)
    np.testing.assert_array_equal(free.motion.poses, own.motion.poses)
    smplx = dataclasses.replace(expected["body"], name="smplx")
    assert open_capture(tmp_path).placed(smplx).motion.betas is None  # SMPL's shapes are not SMPL-X's


# splits


def test_published_splits_of_people_snapshot_are_taken_by_the_folders_name(tmp_path):
    folder = tmp_path / "male-3-casual"
    folder.mkdir()
    write.instantavatar(folder, frames=470)
    capture = open_capture(folder)
    assert capture.gender == "male"
    splits = capture.splits
    assert [v.frame for v in splits["train"]] == list(range(0, 456, 4))  # 114 frames: start 0, end 455, skip 4
    assert [v.frame for v in splits["val"]] == [456]
    assert [v.frame for v in splits["test"]] == [456, 460, 464, 468]


def test_every_published_split_is_a_range_of_frames():
    for name, ranges in PUBLISHED.items():
        assert len(ranges) == 3, name
        assert all(first <= last and step > 0 for first, last, step in ranges), name


def test_a_sequence_may_be_named_and_an_unknown_one_lists_the_known(tmp_path):
    write.instantavatar(tmp_path, frames=45)
    capture = InstantAvatarCapture(InstantAvatarOptions(sequence="seattle")).read(tmp_path)
    assert [v.frame for v in capture.splits["train"]] == list(range(42))
    with pytest.raises(UserError, match=r"sequence=tacoma has no published splits.*seattle"):
        InstantAvatarCapture(InstantAvatarOptions(sequence="tacoma")).read(tmp_path)
    with pytest.raises(UserError, match="split 'test' of male-3-casual"):
        InstantAvatarCapture(InstantAvatarOptions(sequence="male-3-casual")).read(tmp_path)


def test_refined_poses_of_a_split_replace_the_estimates(tmp_path):
    folder = tmp_path / "seattle"
    folder.mkdir()
    write.instantavatar(folder, frames=45)
    (folder / "poses").mkdir()
    rng = np.random.default_rng(0)
    poses = rng.normal(0, 0.1, (42, 72)) + np.eye(72)[0] * np.pi
    np.savez(folder / "poses/anim_nerf_train.npz", betas=np.ones((1, 10)), transl=np.full((42, 3), 2.0),
             global_orient=poses[:, :3], body_pose=poses[:, 3:])  # fmt: skip
    source = open_capture(folder).placement.source
    np.testing.assert_allclose(source.poses[:42].reshape(42, 72), poses.astype(np.float32))
    np.testing.assert_array_equal(source.betas, np.ones(10))
    assert not np.allclose(source.trans[42:], 2)
    (folder / "poses.npz").unlink()
    assert np.isfinite(open_capture(folder).motion.poses).all()
    (folder / "poses/anim_nerf_train.npz").unlink()
    with pytest.raises(UserError, match=r"poses\.npz is missing, and so is poses_optimized"):
        open_capture(folder)


def test_refined_poses_may_hold_more_rows_than_the_split_and_masks_pictures_beside_the_arrays(tmp_path):
    write.instantavatar(tmp_path, frames=12)
    (tmp_path / "poses").mkdir()
    poses = np.random.default_rng(0).normal(0, 0.1, (15, 72)) + np.eye(72)[0] * np.pi
    np.savez(tmp_path / "poses/anim_nerf_train.npz", betas=np.ones((1, 10)), transl=np.full((15, 3), 2.0),
             global_orient=poses[:, :3], body_pose=poses[:, 3:])  # fmt: skip
    for i in range(12):
        cv2.imwrite(str(tmp_path / f"masks/mask_{i:04d}.png"), np.zeros((48, 64), np.uint8))
    capture = open_capture(tmp_path)
    train = [view.frame for view in capture.splits["train"]]
    np.testing.assert_allclose(capture.placement.source.poses[train].reshape(11, 72), poses[:11].astype(np.float32))
    assert capture.mask_path(capture.views("train")[0]).suffix == ".npy"
    assert check_capture(tmp_path).faults == []


def test_names_of_upstreams_frames_end_at_the_first_dot(tmp_path):
    write.upstream(tmp_path, moving=True)
    for folder in ("images", "masks"):
        for path in (tmp_path / "train" / folder).iterdir():
            path.rename(path.with_name(f"{path.stem}.{folder}.png"))
    assert check_capture(tmp_path).faults == []


def test_neumans_masks_may_be_arrays_and_its_splits_are_rounded_as_its_authors_do(tmp_path):
    expected = write.neuman(tmp_path)
    for path in sorted((tmp_path / "segmentations").iterdir()):
        np.save(f"{path}.npy", cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
        path.unlink()
    capture = open_capture(tmp_path)
    view = capture.views("train")[0]
    assert capture.mask_path(view).name == "00000.png.npy"
    np.testing.assert_array_equal(capture.load(view)[1] > 0.5, expected["person"])
    assert check_capture(tmp_path).faults == []
    names = [f"{i:05d}.png" for i in range(1245)]
    splits = neuman_splits(tmp_path, names)
    held = list(range(1245))[2::4]  # int(1 / 249 * 1245) is 4, not 5
    assert sorted(v.frame for s in ("test", "val") for v in splits[s]) == held


def test_zju_cameras_and_frames_are_chosen_as_published(tmp_path):
    write.zju(tmp_path, frames=9, cameras=8)
    capture = ZjuCapture(ZjuOptions(first=2, frames=3, step=2)).read(tmp_path)
    assert {v.camera for v in capture.splits["train"]} == {"0", "6"}  # of 0, 6, 12, 18 those that there are
    assert {v.camera for v in capture.splits["novel_view"]} == {"1", "2", "3", "4", "5", "7"}
    assert len(capture.splits["train"]) == 6
    # frames 2, 4, 6 train; 7 comes after
    assert capture.image_path(View("0", 1)).name == "000004.jpg"
    assert capture.image_path(capture.splits["novel_pose"][0]).name == "000007.jpg"
    with pytest.raises(UserError, match="cameras 0 to 7, not 9"):
        ZjuCapture(ZjuOptions(cameras="1,9")).read(tmp_path)
    with pytest.raises(UserError, match="give numbers"):
        ZjuCapture(ZjuOptions(cameras="a")).read(tmp_path)


def test_lens_distortion_is_taken_out_of_image_and_mask(tmp_path):
    lens = [-0.3, 0.1, 0.0, 0.0, 0.0]
    write.zju(tmp_path, lens=lens)
    capture = open_capture(tmp_path)
    view = capture.views("train")[0]
    point = np.array([[[8.0, 6.0]]], np.float32)  # pixel centres; where it lies in the straight image
    there = cv2.undistortPoints(point, write.K, np.array(lens), P=write.K)[0, 0]
    for path in (capture.image_path(view), capture.mask_path(view)):
        image = np.zeros((write.HEIGHT, write.WIDTH), np.uint8)
        image[6, 8] = 255
        cv2.imwrite(str(path.with_suffix(".png")), image)
        if path.suffix == ".jpg":
            path.with_suffix(".png").rename(path)  # OpenCV tells a format by its content
    image, mask = capture.read(view)
    for pixels in (image[..., 0], mask):
        weight = pixels.astype(float)
        centre = [
            (weight * np.arange(n)[s]).sum() / weight.sum()
            for n, s in ((64, (None, slice(None))), (48, (slice(None), None)))
        ]
        np.testing.assert_allclose(centre, there, atol=0.5)  # one pixel, interpolated over its neighbours


def test_neuman_splits_come_from_its_files_or_by_its_rule(tmp_path):
    write.neuman(tmp_path)
    splits = open_capture(tmp_path).splits
    # 12 images: two are held out, 6 apart from the fourth on; the first half tests
    assert {s: [v.frame for v in views] for s, views in splits.items()} == {
        "train": [0, 1, 2, 4, 5, 6, 7, 8, 10, 11], "test": [3], "val": [9],
    }  # fmt: skip
    for split, names in (("train", "00000.png\n00002.png\n"), ("test", "00001.png\n"), ("val", "00003.png\n")):
        (tmp_path / f"{split}_split.txt").write_text(names)
    splits = open_capture(tmp_path).splits
    assert {s: [v.frame for v in views] for s, views in splits.items()} == {"train": [0, 2], "val": [3], "test": [1]}


# faults


def npz(path, **changes):
    with np.load(path) as file:
        arrays = {k: v for k, v in (dict(file) | changes).items() if v is not None}
    np.savez(path, **arrays)


def npy(path, change):
    content = np.load(path, allow_pickle=True).item()
    change(content)
    np.save(path, content, allow_pickle=True)


def pth(path, **changes):
    content = torch.load(path, weights_only=True) | changes
    torch.save({k: v for k, v in content.items() if v is not None}, path)


FAULTS = {
    "instantavatar": {
        "no K": (lambda f: npz(f / "cameras.npz", intrinsic=None), "cameras.npz", "'intrinsic' is missing"),
        "K of 2x2": (lambda f: npz(f / "cameras.npz", intrinsic=np.eye(2)), "cameras.npz", "intrinsic has shape"),
        "NaN": (lambda f: npz(f / "cameras.npz", extrinsic=np.full((4, 4), np.nan)), "cameras.npz", "extrinsic"),
        "a shear": (lambda f: npz(f / "cameras.npz", extrinsic=np.eye(4) * 2), "cameras.npz", "rigid"),
        "no poses": (lambda f: (f / "poses.npz").unlink(), "poses.npz", "missing"),
        "too few poses": (lambda f: npz(f / "poses.npz", thetas=np.ones((3, 72)), transl=np.ones((3, 3))), "poses.npz", "3"),  # noqa: E501
        "NaN poses": (lambda f: npz(f / "poses.npz", thetas=np.full((12, 72), np.nan)), "poses.npz", "thetas"),
        "no shape": (lambda f: npz(f / "poses.npz", betas=None), "poses.npz", "betas"),
        "no masks": (lambda f: shutil.rmtree(f / "masks"), "masks", "missing"),
        "a mask less": (lambda f: (f / "masks/mask_0003.npy").unlink(), "masks", "11 masks"),
        "a pickled mask": (lambda f: np.save(f / "masks/mask_0000.npy", np.array([{}], object)), "mask_0000.npy", "plain"),  # noqa: E501
        "an image of another size": (
            lambda f: cv2.imwrite(str(f / "images/image_0000.png"), np.zeros((5, 6, 3), np.uint8)), "0000.png", "6x5",
        ),
        "an empty mask": (lambda f: np.save(f / "masks/mask_0000.npy", np.zeros((48, 64), np.uint8)), "mask_0000", "person"),  # noqa: E501
    },
    "upstream": {
        "no camera": (lambda f: (f / "train/cam_parms.npz").unlink(), "cam_parms.npz", "missing"),
        "no poses": (lambda f: (f / "test/smpl_parms.pth").unlink(), "smpl_parms.pth", "does not exist"),
        "no body_pose": (lambda f: pth(f / "train/smpl_parms.pth", body_pose=None), "smpl_parms.pth", "missing"),
        "no shape": (lambda f: pth(f / "train/smpl_parms.pth", beta=None), "smpl_parms.pth", "beta"),
        "too few poses": (
            lambda f: pth(f / "train/smpl_parms.pth", body_pose=torch.ones(2, 72), trans=torch.ones(2, 3)), "smpl_parms.pth", "4",  # noqa: E501
        ),
        "a mask less": (lambda f: (f / "train/masks/00000001.png").unlink(), "00000001.png", "missing"),
        "damaged": (lambda f: (f / "train/smpl_parms.pth").write_bytes(b"PK"), "smpl_parms.pth", "zip"),
    },
    "zju": {
        "no cams": (lambda f: npy(f / "annots.npy", lambda c: c.pop("cams")), "annots.npy", "cams"),
        "no T": (lambda f: npy(f / "annots.npy", lambda c: c["cams"].pop("T")), "annots.npy", "'T' is missing"),
        "R of a camera": (
            lambda f: npy(f / "annots.npy", lambda c: c["cams"]["R"].__setitem__(1, np.ones((3, 3)))), "annots.npy", "camera 1",  # noqa: E501
        ),
        "no ims": (lambda f: npy(f / "annots.npy", lambda c: c.pop("ims")), "annots.npy", "ims"),
        "an image outside": (
            lambda f: npy(f / "annots.npy", lambda c: c["ims"][0].update(ims=["/etc/x", "a", "b"])), "annots.npy", "outside",  # noqa: E501
        ),
        "no params": (lambda f: shutil.rmtree(f / "new_params"), "params", "missing"),
        "params of a frame": (lambda f: (f / "new_params/2.npy").unlink(), "2.npy", "missing"),
        "no Rh": (lambda f: npy(f / "new_params/1.npy", lambda c: c.pop("Rh")), "1.npy", "'Rh' is missing"),
        "poses of 69": (lambda f: npy(f / "new_params/1.npy", lambda c: c.update(poses=np.zeros(69))), "1.npy", "poses"),  # noqa: E501
        "a mask less": (lambda f: (f / "mask_cihp/Camera_B1/000001.png").unlink(), "000001.png", "missing"),
    },
    "neuman": {
        "no cameras": (lambda f: (f / "sparse/cameras.txt").unlink(), "cameras.txt", "missing"),
        "a fisheye": (lambda f: (f / "sparse/cameras.txt").write_text("1 FISHEYE 3 3 1 1\n"), "cameras.txt", "OPENCV"),
        "no images": (lambda f: (f / "sparse/images.txt").write_text("# none\n"), "images.txt", "no image"),
        "an alignment less": (lambda f: npy(f / "alignments.npy", lambda c: c.pop("00003.png")), "alignments.npy", "00003"),  # noqa: E501
        "a flat alignment": (
            lambda f: npy(f / "alignments.npy", lambda c: c.update({"00003.png": np.zeros((4, 3))})), "alignments.npy", "scale",  # noqa: E501
        ),
        "no poses": (lambda f: (f / "smpl_output_romp.pkl").unlink(), "smpl_output_romp.pkl", "missing"),
        "a foreign split": (lambda f: (f / "train_split.txt").write_text("x.png\n"), "train_split.txt", "x.png"),
        "a mask less": (lambda f: (f / "segmentations/00000.png").unlink(), "00000.png", "missing"),
    },
}  # fmt: skip


@pytest.mark.parametrize(("layout", "fault"), [(layout, fault) for layout in FAULTS for fault in FAULTS[layout]])
def test_each_fault_is_one_sentence_with_file_and_field(tmp_path, layout, fault):
    getattr(write, layout)(tmp_path)
    breaks, *words = FAULTS[layout][fault]
    breaks(tmp_path)
    faults = check_capture(tmp_path, {"name": layout}).faults
    assert len(faults) == 1, faults
    assert "\n" not in faults[0]
    for word in words:
        assert word in faults[0]


def _break_poses(folder):
    """Four faults in one poses file: two frames of thetas, all of betas, one frame of transl, the shape of nothing."""
    with np.load(folder / "poses.npz") as file:
        arrays = dict(file)
    arrays["thetas"][[2, 5]] = np.nan
    arrays["transl"][3] = np.inf
    arrays["betas"] = np.array([["x"]])
    np.savez(folder / "poses.npz", **arrays)


def _many_in_annots(content):
    cams = content["cams"]
    cams["K"] = [np.eye(2), *cams["K"][1:]]
    cams["T"] = [cams["T"][0], np.full((3, 1), np.nan), cams["T"][2]]
    cams["R"] = [*cams["R"][:2], 2 * np.eye(3)]
    cams["D"] = [*cams["D"][:2], np.zeros(3)]
    content["ims"][1] = {"ims": ["a.jpg"]}
    content["ims"][3] = {"ims": ["/etc/x.jpg", "../y.jpg", "z.jpg"]}


def _lines_of(path, changes):
    lines = path.read_text().splitlines()
    for number, change in changes.items():
        lines[number - 1] = change(lines[number - 1])
    path.write_text("\n".join(lines) + "\n")


def _neuman_poses(folder):
    content = pickle.loads((folder / "smpl_output_romp.pkl").read_bytes())
    content[1]["pose"][[1, 4]] = np.nan
    content[1]["betas"] = content[1]["betas"][:5]
    (folder / "smpl_output_romp.pkl").write_bytes(pickle.dumps(content))


def _moving_cameras(folder):
    both = {"intrinsic": np.eye(2), "extrinsic": 2 * np.eye(4)}
    for i, change in enumerate(({"intrinsic": np.zeros((3, 3))}, {"extrinsic": None}, both)):
        npz(folder / f"train/cam_parms/{i:08d}.npz", **change)


SEVERAL = {
    "poses of a file": ("instantavatar", write.instantavatar, _break_poses, (
        "thetas holds NaN or infinite values at frames 2, 5", "transl holds NaN or infinite values at frame 3",
        "betas holds <U1 values")),
    "camera": ("instantavatar", write.instantavatar, lambda f: npz(
        f / "cameras.npz", intrinsic=np.eye(2), extrinsic=np.full((4, 4), np.nan), width=0, height=-1), (
        "intrinsic has shape", "extrinsic holds NaN", "width must be positive", "height must be positive")),
    "fields of the camera": ("instantavatar", write.instantavatar, lambda f: npz(
        f / "cameras.npz", intrinsic=None, height=None), ("'intrinsic' is missing", "'height' is missing")),
    "refined poses": ("instantavatar", lambda f: write.instantavatar(f, frames=12), lambda f: [
        (f / "poses").mkdir(exist_ok=True), np.savez(f / "poses/train.npz", poses=np.ones((3, 72)), betas=np.ones(10)),
        np.savez(f / "poses/test.npz", poses=np.full((1, 72), np.nan), betas=np.ones(10))], (
        "train.npz has poses of 3 frames", "test.npz: poses holds NaN")),
    "smpl_parms": ("upstream", write.upstream, lambda f: pth(
        f / "train/smpl_parms.pth", body_pose=torch.tensor([0.0, np.nan, 0, np.nan])[:, None].repeat(1, 72),
        trans=torch.ones(3, 3), beta=torch.full((1, 10), np.inf)), (
        "body_pose holds NaN or infinite values at frames 1, 3", "betas holds NaN",
        "trans has shape (3, 3), expected (4, 3)")),
    "cameras of frames": ("upstream", lambda f: write.upstream(f, moving=True), _moving_cameras, (
        "00000000.npz: intrinsic: focal", "00000001.npz: field 'extrinsic'", "00000002.npz: intrinsic has shape",
        "00000002.npz: extrinsic is no rigid motion")),
    "annots": ("zju", write.zju, lambda f: npy(f / "annots.npy", _many_in_annots), (
        "K of camera 0 has shape", "T of camera 1 holds NaN", "R of camera 2 is no rigid motion", "D of camera 2 has",
        "frame 1 must list 3", "'/etc/x.jpg'", "'../y.jpg'")),
    "fields of annots": ("zju", write.zju, lambda f: npy(f / "annots.npy", lambda c: [c["cams"].pop(k) for k in "DT"]),
        ("'D' is missing", "'T' is missing")),
    "params": ("zju", write.zju, lambda f: [
        npy(f / "new_params/0.npy", lambda c: [c.pop("Rh"), c.pop("shapes")]), (f / "new_params/1.npy").unlink(),
        npy(f / "new_params/3.npy", lambda c: c.update(poses=np.zeros(69), Th=np.full(3, np.nan)))], (
        "0.npy: field 'Rh'", "0.npy: field 'shapes'", "1.npy is missing", "3.npy: poses has shape", "3.npy: Th holds")),
    "alignments": ("neuman", write.neuman, lambda f: npy(f / "alignments.npy", lambda c: [
        c.pop("00001.png"), c.update({"00003.png": np.zeros((4, 3)), "00005.png": np.full((4, 3), np.nan)})]), (
        "no alignment of image '00001.png'", "00003.png is no turn", "00005.png holds NaN")),
    "lines of COLMAP": ("neuman", write.neuman, lambda f: _lines_of(f / "sparse/images.txt", {
        2: lambda line: line.replace(line.split()[1], "x"), 6: lambda line: line.replace(" 1 0", " 9 0"),
        8: lambda line: " ".join([*line.split()[:5], "nan", *line.split()[6:]])}), (
        "line 2: a number", "line 6: camera 9", "line 8: a number")),
    "SMPL fit": ("neuman", write.neuman, _neuman_poses, (
        "pose holds NaN or infinite values at frames 1, 4", "betas has 5 frames")),
    "splits": ("neuman", write.neuman, lambda f: [(f / "train_split.txt").write_text("00000.png\nx.png\ny.png\n"),
        (f / "test_split.txt").write_text("z.png\n")], ("'x.png'", "'y.png'", "'z.png'")),
}  # fmt: skip


@pytest.mark.parametrize("case", SEVERAL)
def test_several_faults_of_one_file_are_each_named(tmp_path, case):
    layout, writer, breaks, words = SEVERAL[case]
    writer(tmp_path)
    breaks(tmp_path)
    faults = check_capture(tmp_path, {"name": layout}).faults
    assert len(faults) == len(words), faults
    for word in words:
        assert sum(word in fault for fault in faults) == 1, (word, faults)
    assert all("\n" not in fault for fault in faults)
    # training stops at the first of them
    with pytest.raises(UserError) as raised:
        open_capture(tmp_path, {"name": layout})
    assert any(word in str(raised.value) for word in words)


def test_many_faults_of_a_kind_are_counted_after_the_twentieth(tmp_path):
    write.zju(tmp_path, frames=40)
    for i in range(5, 40):
        npy(tmp_path / f"new_params/{i}.npy", lambda c: c.pop("Rh"))
    faults = check_capture(tmp_path).faults
    assert len(faults) == 21
    assert faults[-1] == f"and 15 more files of {tmp_path / 'new_params'} are faulty"
    write.upstream(tmp_path / "up", counts=(60, 2))
    content = torch.load(tmp_path / "up/train/smpl_parms.pth", weights_only=True)
    content["body_pose"][::2] = np.nan
    torch.save(content, tmp_path / "up/train/smpl_parms.pth")
    for path in sorted((tmp_path / "up/test/masks").iterdir()):
        path.unlink()
    fault = next(f for f in check_capture(tmp_path / "up").faults if "body_pose" in f)
    assert fault.endswith(f"at frames {', '.join(map(str, range(0, 40, 2)))} and 10 more")


def test_images_that_are_missing_are_counted_by_folder(tmp_path):
    write.upstream(tmp_path, counts=(30, 2))
    for path in (tmp_path / "train/masks").iterdir():
        path.unlink()
    (tmp_path / "train/masks/00000000.png").write_bytes((tmp_path / "train/images/00000000.png").read_bytes())
    faults = check_capture(tmp_path).faults
    assert len(faults) == 21
    assert faults[-1] == f"and 9 more files of {tmp_path / 'train/masks'} are missing"


def test_several_faults_of_gavatars_own_files_are_each_named(tmp_path):
    tiny = write_tiny_capture(tmp_path / "tiny")
    with np.load(tiny / "body.npz") as file:
        arrays = dict(file)
    arrays["poses"][[0, 2, 3]] = np.nan
    arrays["trans"] = np.ones((2, 3))
    arrays["mocap_framerate"] = np.float64(-1)
    arrays["betas"] = np.array([np.nan])
    np.savez(tiny / "body.npz", **arrays)
    cameras = json.loads((tiny / "cameras.json").read_text())
    cameras["cam0"] |= {"fx": "wide", "cy": None, "world_to_camera": [[1]]}
    (tiny / "cameras.json").write_text(json.dumps(cameras))
    faults = check_capture(tiny).faults
    for word in (
        "poses holds NaN or infinite values at frames 0, 2, 3", "mocap_framerate must be", "betas holds NaN",
        "trans has shape", "fx is of the wrong type", "cy is of the wrong type", "world_to_camera must be",
    ):  # fmt: skip
        assert sum(word in fault for fault in faults) == 1, (word, faults)
    assert len(faults) == 7


def test_the_check_names_all_faults_and_exits_with_two(tmp_path, capsys):
    write.upstream(tmp_path)
    (tmp_path / "train/cam_parms.npz").unlink()
    (tmp_path / "test/smpl_parms.pth").unlink()
    shutil.rmtree(tmp_path / "train/masks")
    with pytest.raises(SystemExit) as done:
        prepare(["--check", str(tmp_path)])
    out = capsys.readouterr().out
    assert done.value.code == 2
    assert "3 faults" in out
    for word in ("cam_parms.npz", "test/smpl_parms.pth", "train/masks"):
        assert word in out


def test_the_check_names_all_faults_of_gavatars_own_layout(tmp_path):
    tiny = write_tiny_capture(tmp_path / "tiny")
    (tiny / "images/cam0/000002.jpg").unlink()
    (tiny / "masks/cam0/000003.png").write_bytes(b"no")
    cv2.imwrite(str(tiny / "masks/cam0/000001.png"), np.zeros((10, 20), np.uint8))
    faults = check_capture(tiny).faults
    assert len(faults) == 3
    for word in ("000002.png is missing", "000003.png cannot be read", "000001.png is 20x10"):
        assert any(word in fault for fault in faults)
    cameras = json.loads((tiny / "cameras.json").read_text())
    cameras |= {"cam1": cameras["cam0"] | {"fx": -1}, "cam2": {}}
    (tiny / "cameras.json").write_text(json.dumps(cameras))
    (tiny / "body.npz").write_bytes(b"")
    info = json.loads((tiny / "capture.json").read_text()) | {"background": "blue"}
    (tiny / "capture.json").write_text(json.dumps(info))
    faults = check_capture(tiny).faults
    for word in ("camera 'cam1'", "camera 'cam2'", "body.npz", "background"):
        assert any(word in fault for fault in faults), (word, faults)


@pytest.mark.parametrize("layout", ["zju", "neuman"])
def test_a_hostile_pickle_in_a_capture_is_refused_and_runs_nothing(tmp_path, layout):
    getattr(write, layout)(tmp_path)

    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "exploded"), "w"))

    file = {"zju": "annots.npy", "neuman": "alignments.npy"}[layout]
    np.save(tmp_path / file, {"cams": Bomb()}, allow_pickle=True)
    with pytest.raises(UserError, match=f"{file}.*nothing ran"):
        open_capture(tmp_path)
    assert not (tmp_path / "exploded").exists()


def test_a_folder_of_no_layout_lists_their_signs(tmp_path):
    with pytest.raises(UserError, match=r"capture\.json.*cameras\.npz.*alignments\.npy.*smpl_parms\.pth.*annots\.npy"):
        open_capture(tmp_path)


def test_gavatars_own_capture_is_not_moved_by_a_body():
    from make_bundle import free_body

    capture = read_capture(demo())
    assert capture.placed(free_body()) is capture


def test_training_takes_a_foreign_capture_with_a_moving_camera(tmp_path):
    from gavatar.config import compose_config
    from gavatar.training.run import open_run, train

    folder = tmp_path / "person"
    folder.mkdir()
    write.upstream(folder, moving=True)
    small = [setting for setting in SMALL if not setting.startswith("encoder")]
    config = compose_config([f"capture={folder}", "encoder=none", *small])
    train(config, tmp_path / "run")
    run = open_run(tmp_path / "run")
    assert run.capture.body_model == "smpl"
    assert len(run.motion) == 6
