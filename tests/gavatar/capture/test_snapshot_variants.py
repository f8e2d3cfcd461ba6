"""People-Snapshot's and GaussianAvatar's layouts as people really have them: poses that do not count as the images do,
under other names and shapes, masks of other kinds."""

from __future__ import annotations

import cv2
import foreign_captures as write
import numpy as np
import pytest
import torch
from foreign_reading import check_pixels, opened

from gavatar.capture.check import check_capture
from gavatar.capture.opening import open_capture
from gavatar.registry import load_plugins
from gavatar_runtime.errors import UserError

load_plugins()


def poses(folder, function):
    with np.load(folder / "poses.npz") as file:
        arrays = dict(file)
    function(arrays)
    np.savez(folder / "poses.npz", **arrays)


def _rows(change):
    def function(arrays):
        for key in ("thetas", "transl"):
            arrays[key] = change(arrays[key])

    return function


@pytest.mark.parametrize("more", [1, 5])
def test_poses_beyond_the_images_are_cut_with_a_note(tmp_path, more):
    expected = write.instantavatar(tmp_path)
    poses(tmp_path, _rows(lambda x: np.concatenate([x, x[:more]])))
    capture, notes = opened(tmp_path)
    assert len(capture.motion) == 12
    check_pixels(capture, expected)
    assert len(notes) == 1
    assert f"{12 + more} frames, but there are 12 images" in notes[0]
    assert check_capture(tmp_path).faults == []


def test_an_image_beyond_the_poses_is_left_out_with_a_note_and_several_are_an_error(tmp_path):
    expected = write.instantavatar(tmp_path)
    poses(tmp_path, _rows(lambda x: x[:-1]))
    capture, notes = opened(tmp_path)
    assert max(v.frame for views in capture.splits.values() for v in views) == 10
    check_pixels(capture, expected)
    assert "the last image is left out" in notes[0]
    assert len(notes) == 1
    poses(tmp_path, _rows(lambda x: x[:-1]))
    with pytest.raises(UserError, match="poses of 10 frames, but there are 12 images"):
        open_capture(tmp_path)


# initialneil/SplattingAvatar #35 lists the members of anim_nerf_train.npz; shapes (1, 10), (10,), (T, 10) are all met
@pytest.mark.parametrize("parts", [True, False])
@pytest.mark.parametrize("betas", [(1, 10), (10,), (12, 10)])
def test_poses_in_parts_or_whole_and_shapes_in_any_number_of_rows(tmp_path, parts, betas):
    expected = write.instantavatar(tmp_path)

    def change(arrays):
        if parts:
            thetas = arrays.pop("thetas")
            arrays |= {"global_orient": thetas[:, :3], "body_pose": thetas[:, 3:]}
        arrays["betas"] = np.broadcast_to(arrays["betas"], (12, 10)).copy() if len(betas) == 2 else arrays["betas"][0]
        arrays["betas"] = arrays["betas"][: betas[0]] if len(betas) == 2 else arrays["betas"]

    poses(tmp_path, change)
    capture, notes = opened(tmp_path)
    check_pixels(capture, expected)
    assert notes == []


@pytest.mark.parametrize("kind", ["png", "png 0/1", "npy", "npy bool", "npy 255", "npy (H, W, 1)", "npy float"])
@pytest.mark.parametrize("inverted", [False, True])
def test_masks_of_any_kind_are_the_person(tmp_path, kind, inverted):
    expected = write.instantavatar(tmp_path)
    person = expected["person"] != inverted
    for path in list((tmp_path / "masks").iterdir()):
        path.unlink()
    for i in range(12):
        stem = tmp_path / f"masks/mask_{i:04d}"
        if kind.startswith("png"):
            cv2.imwrite(f"{stem}.png", person.astype(np.uint8) * (1 if "1" in kind else 255))
        else:
            plain = person.astype(np.uint8)
            arrays = {"bool": person, "255": plain * 255, "(H, W, 1)": plain[..., None], "float": plain.astype(float)}
            array = arrays.get(kind.removeprefix("npy "), plain)
            np.save(f"{stem}.npy", array)
    capture, notes = opened(tmp_path)
    np.testing.assert_array_equal(capture.load(capture.views("train")[0])[1] > 0.5, expected["person"])
    assert len(notes) == inverted


def test_upstreams_poses_are_cut_alike(tmp_path):
    expected = write.upstream(tmp_path)
    file = tmp_path / "test/smpl_parms.pth"
    content = torch.load(file, weights_only=True)
    torch.save(content | {k: torch.cat([content[k], content[k]]) for k in ("body_pose", "trans")}, file)
    capture, notes = opened(tmp_path)
    check_pixels(capture, expected)
    assert "the last 2 poses are left out" in notes[0]
    torch.save(content | {k: content[k][:1] for k in ("body_pose", "trans")}, file)
    capture, notes = opened(tmp_path)
    assert len(capture.splits["test"]) == 1
    assert "the last image is left out" in notes[0]


def test_the_border_decides_for_most_of_the_masks_not_for_one(tmp_path):
    """A person who fills one image is no reason to turn the others."""
    expected = write.instantavatar(tmp_path)
    near = np.ones((write.HEIGHT, write.WIDTH), np.uint8)
    near[20:30, 20:30] = 0
    np.save(tmp_path / "masks/mask_0000.npy", near)
    capture, notes = opened(tmp_path)
    assert notes == []
    np.testing.assert_array_equal(capture.load(capture.views("train")[1])[1] > 0.5, expected["person"])
