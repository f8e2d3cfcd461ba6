"""Which frames and images of other people's captures train and test, and what their file names and lenses mean."""

from __future__ import annotations

import cv2
import foreign_captures as write
import numpy as np
import pytest

from gavatar.capture.capture import View
from gavatar.capture.check import check_capture
from gavatar.capture.opening import open_capture
from gavatar.registry import load_plugins
from gavatar_plugins.captures.instantavatar import PUBLISHED, InstantAvatarCapture, InstantAvatarOptions
from gavatar_plugins.captures.zju import ZjuCapture, ZjuOptions
from gavatar_runtime.errors import UserError

load_plugins()


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
    np.savez(tmp_path / "poses/anim_nerf_train.npz", betas=np.ones((1, 10)), transl=np.tile([0, 0.2, 4.0], (15, 1)),
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
    (tmp_path / "long").mkdir()
    write.neuman(tmp_path / "long", frames=1245)
    splits = open_capture(tmp_path / "long").splits
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
