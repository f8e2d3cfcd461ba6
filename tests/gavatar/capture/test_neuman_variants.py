"""NeuMan's layout as people make it of their own videos: other names, masks, cameras and numbers."""

from __future__ import annotations

import pickle
import shutil

import cv2
import foreign_captures as write
import numpy as np
import pytest
from foreign_reading import change, check_pixels, opened

from gavatar.capture.check import check_capture
from gavatar.capture.opening import open_capture
from gavatar.registry import load_plugins
from gavatar_runtime.errors import UserError

load_plugins()


def rename(folder, name):
    """Every image, mask, line and alignment under another name: a function of the frame's number."""
    for kind in ("images", "segmentations"):
        for path in sorted((folder / kind).iterdir(), reverse=True):
            path.rename(path.with_name(name(int(path.stem))))
    lines = (folder / "sparse/images.txt").read_text().splitlines()
    for i, line in enumerate(lines):
        if line.endswith(".png"):
            lines[i] = line[: -len("00000.png")] + name(int(line[-9:-4]))
    (folder / "sparse/images.txt").write_text("\n".join(lines) + "\n")
    change(
        folder / "alignments.npy", lambda c: [c.update({name(int(k[:5])): c.pop(k)}) for k in sorted(c, reverse=True)]
    )


def poses_of(folder, change_person):
    path = folder / "smpl_output_romp.pkl"
    content = pickle.loads(path.read_bytes())
    change_person(content[1])
    path.write_bytes(pickle.dumps(content))


@pytest.mark.parametrize(
    ("name", "noted"),
    [
        (lambda i: f"my clip {i:05d}.png", False),
        (lambda i: f"{i + 40:05d}.png", True),
        (lambda i: f"take {'abcdefghijkl'[i]} (left).png", True),
    ],
)
def test_names_may_hold_blanks_and_numbers_that_count_no_rows(tmp_path, name, noted):
    expected = write.neuman(tmp_path)
    rename(tmp_path, name)
    capture, notes = opened(tmp_path)
    check_pixels(capture, expected)
    assert len(notes) == noted
    assert all("paired in the order of the names" in note for note in notes)
    np.testing.assert_array_equal(capture.load(capture.views("train")[0])[1] > 0.5, expected["person"])
    (tmp_path / "train_split.txt").write_text(f"{name(3)}\n{name(5)}\n")
    assert [v.frame for v in open_capture(tmp_path).splits["train"]] == [3, 5]


# colmap finds no place for some images of a video: NVlabs/instant-ngp #1450
def test_images_that_colmap_did_not_place_do_not_shift_the_poses(tmp_path):
    expected = write.neuman(tmp_path)
    lines = (tmp_path / "sparse/images.txt").read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.endswith("00004.png"))
    (tmp_path / "sparse/images.txt").write_text("\n".join(lines[:at] + lines[at + 2 :]) + "\n")
    for name in (None, lambda i: f"{i + 40:05d}.png"):
        if name:
            rename(tmp_path, name)
        capture, _ = opened(tmp_path)
        assert len(capture.motion) == 11
        for i, number in enumerate([0, 1, 2, 3, *range(5, 12)]):
            expected["pixels"]["cam0", 100 + i] = expected["pixels"]["cam0", number]
        shifted = {
            "body": expected["body"],
            "pixels": {("cam0", i): expected["pixels"]["cam0", 100 + i] for i in range(11)},
        }
        check_pixels(capture, shifted)


def test_images_that_are_listed_and_missing_are_left_out_with_a_note(tmp_path):
    expected = write.neuman(tmp_path)
    (tmp_path / "images/00007.png").unlink()
    capture, notes = opened(tmp_path)
    assert 7 not in [v.frame for v in capture.splits["train"]]
    check_pixels(capture, expected)
    assert len(notes) == 1
    assert "of camera cam0 frame 7" in notes[0]
    for i in range(6):
        (tmp_path / f"images/{i:05d}.png").unlink()
    with pytest.raises(UserError, match="7 are missing"):
        open_capture(tmp_path)


@pytest.mark.parametrize("values", [(0, 255), (0, 1), (255, 0), (1, 0)])  # what is not the person, and what is
@pytest.mark.parametrize("suffix", ["png", "npy"])
def test_masks_of_either_sense_and_scale_are_told_by_their_border(tmp_path, values, suffix):
    expected = write.neuman(tmp_path)
    for path in sorted((tmp_path / "segmentations").iterdir()):
        mask = np.where(expected["person"], values[1], values[0]).astype(np.uint8)
        cv2.imwrite(str(path), mask) if suffix == "png" else np.save(f"{path}.npy", mask)
    capture, notes = opened(tmp_path)
    alpha = capture.load(capture.views("train")[0])[1]
    np.testing.assert_array_equal(alpha > 0.5, expected["person"])
    assert len(notes) == (values[0] == 0)  # the published ones are 255 on what is not the person
    assert check_capture(tmp_path).faults == []


CAMERAS = {  # mks0601/ExAvatar_RELEASE #32 has cameras of several models for one video
    "PINHOLE": ("{fx} {fy} {cx} {cy}", None),
    "OPENCV": ("{fx} {fy} {cx} {cy} 0.3 0 0 0", "OPENCV moves"),
    "FULL_OPENCV": ("{fx} {fy} {cx} {cy} 0.3 0 0 0 0 0 0 0", "FULL_OPENCV moves"),
    "SIMPLE_PINHOLE": ("{fx} {cx} {cy}", None),
    "SIMPLE_RADIAL": ("{fx} {cx} {cy} 1.07", "SIMPLE_RADIAL moves"),
    "RADIAL": ("{fx} {cx} {cy} 0.0001 0", None),
}


@pytest.mark.parametrize("model", CAMERAS)
def test_each_pinhole_of_colmap_is_read_and_distortion_that_is_left_out_is_noted(tmp_path, model):
    write.neuman(tmp_path)
    words, noted = CAMERAS[model]
    values = words.format(fx=61.0, fy=59.0, cx=33.0, cy=22.0)
    (tmp_path / "sparse/cameras.txt").write_text(f"1 {model} {write.WIDTH} {write.HEIGHT} {values}\n")
    capture, notes = opened(tmp_path)
    camera = capture.camera(capture.views("train")[0])
    fy = 59.0 if "{fy}" in words else 61.0
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (61.0, fy, 33.0, 22.0)
    assert [noted in note for note in notes] == ([True] if noted else [])


def test_the_noted_distortion_is_that_of_the_farthest_corner(tmp_path):
    write.neuman(tmp_path)
    (tmp_path / "sparse/cameras.txt").write_text("1 SIMPLE_RADIAL 64 48 50 32 24 0.5\n")
    # a corner lies 40 pixels from the centre: r is 0.8, and the lens moves it by 40 * 0.5 * 0.8^2
    assert "by 13 pixels" in opened(tmp_path)[1][0]


@pytest.mark.parametrize("model", ["OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "FOV", "THIN_PRISM_FISHEYE"])
def test_other_models_are_refused_with_the_way_out(tmp_path, model):
    write.neuman(tmp_path)
    (tmp_path / "sparse/cameras.txt").write_text(f"1 {model} 64 48 60 60 32 24 0 0 0 0\n")
    with pytest.raises(UserError, match="image_undistorter"):
        open_capture(tmp_path)
    (tmp_path / "sparse/cameras.txt").rename(tmp_path / "sparse/cameras.bin")
    with pytest.raises(UserError, match=r"model_converter --output_type TXT` makes it of cameras\.bin"):
        open_capture(tmp_path)


def test_every_fault_of_a_line_and_of_the_other_files_is_named(tmp_path):
    write.neuman(tmp_path)
    path = tmp_path / "sparse/images.txt"
    lines = path.read_text().splitlines()
    lines[1] = "12 nan 0 0 0 0 0 0 9 a/00011.png"
    lines[3] = "11 0 0 0 0 0 0 0 1 00010.png"
    path.write_text("\n".join(lines) + "\n")
    change(tmp_path / "alignments.npy", lambda c: c.update({"00002.png": np.zeros((4, 3)), "00005.png": np.ones(3)}))
    poses_of(tmp_path, lambda p: p.update(pose=np.full((12, 72), np.nan), betas=np.zeros((12, 0, 2))))
    faults = check_capture(tmp_path, {"name": "neuman"}).faults
    words = (
        "line 2: a number", "line 2: camera 9", "line 2: image name", "line 4: the rotation", "00002.png is no turn",
        "00005.png has shape", "pose holds NaN", "betas has shape",
    )  # fmt: skip
    for word in words:
        assert sum(word in fault for fault in faults) == 1, (word, faults)
    assert len(faults) == len(words)


def test_a_folder_without_images_is_one_sentence(tmp_path):
    write.neuman(tmp_path)
    shutil.rmtree(tmp_path / "images")
    with pytest.raises(UserError, match="12 are missing"):
        open_capture(tmp_path)
