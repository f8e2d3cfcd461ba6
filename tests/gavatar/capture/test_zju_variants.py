"""ZJU-MoCap's layout as people really have it: other paths, sizes, shapes, units, numbers, and parts of it missing."""

from __future__ import annotations

import pickle

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


def _backslashes(content):
    for frame in content["ims"]:
        frame["ims"] = [name.replace("/", "\\") for name in frame["ims"]]


def _as_arrays(content):
    content["ims"] = np.array([{"ims": np.array(f["ims"])} for f in content["ims"]])
    content["cams"] = {key: np.stack([np.asarray(v) for v in value]) for key, value in content["cams"].items()}


def _as_lists(content):
    content["cams"] = {key: [np.asarray(v).tolist() for v in value] for key, value in content["cams"].items()}


def _flat(content):
    content["cams"]["D"] = [np.zeros(shape) for shape in ((5,), (5, 1), (1, 5))]
    content["cams"]["T"] = [
        np.reshape(T, shape) for T, shape in zip(content["cams"]["T"], ((3,), (1, 3), (3, 1)), strict=True)
    ]


# zju3dv/animatable_nerf #26: written on Windows
@pytest.mark.parametrize("variant", [_backslashes, _as_arrays, _as_lists, _flat])
def test_paths_of_windows_and_arrays_in_any_shape_mean_the_same(tmp_path, variant):
    expected = write.zju(tmp_path)
    change(tmp_path / "annots.npy", variant)
    capture, notes = opened(tmp_path)
    check_pixels(capture, expected)
    assert notes == []
    assert check_capture(tmp_path).faults == []


@pytest.mark.parametrize("name", ["C:\\data\\0.jpg", "\\\\server\\share\\0.jpg", "..\\0.jpg", "C:0.jpg"])
def test_paths_of_windows_that_lead_out_of_the_capture_are_refused(tmp_path, name):
    write.zju(tmp_path)
    change(tmp_path / "annots.npy", lambda c: c["ims"][0]["ims"].__setitem__(1, name))
    with pytest.raises(UserError, match="lies outside of the capture"):
        open_capture(tmp_path)


@pytest.mark.parametrize("module", ["numpy._core", "numpy.core"])
def test_annots_pickled_by_either_numpy_are_read(tmp_path, module):
    expected = write.zju(tmp_path)
    path = tmp_path / "annots.npy"
    content = np.load(path, allow_pickle=True)
    # protocol 2 ends names at a newline instead of counting their letters
    data = pickle.dumps(content, protocol=2).replace(b"cnumpy._core.", b"c" + module.encode() + b".")
    assert module.encode() in data
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(content))
        file.write(data)
    check_pixels(open_capture(tmp_path), expected)


# skhu101/GauHuman #53: a data set in metres brought into this layout
def test_cameras_in_metres_are_told_from_millimetres_and_noted(tmp_path):
    expected = write.zju(tmp_path)
    change(tmp_path / "annots.npy", lambda c: c["cams"].update(T=[np.array(T) / 1000 for T in c["cams"]["T"]]))
    capture, notes = opened(tmp_path)
    check_pixels(capture, expected)
    assert len(notes) == 1
    assert "taken as metres" in notes[0]
    change(tmp_path / "annots.npy", lambda c: c["cams"].update(T=[np.zeros(3)] * 3))  # one camera at the origin is none
    assert opened(tmp_path)[1] == []


def test_cameras_of_different_sizes_each_have_their_own(tmp_path):
    write.zju(tmp_path)
    for i in range(5):
        for folder, suffix in (("", "jpg"), ("mask_cihp/", "png")):
            cv2.imwrite(str(tmp_path / f"{folder}Camera_B2/{i:06d}.{suffix}"), np.full((30, 40), 200, np.uint8))
    capture = open_capture(tmp_path)
    assert [(c.width, c.height) for c in capture.cameras.values()] == [(64, 48), (40, 30), (64, 48)]
    assert not [fault for fault in check_capture(tmp_path).faults if "pixels" in fault]


# zju3dv/neuralbody #56: 23 cameras filmed, 21 are calibrated; others copy some of the cameras only
def test_views_whose_image_is_missing_are_left_out_with_a_note(tmp_path):
    expected = write.zju(tmp_path)
    for path in (tmp_path / "Camera_B2").iterdir():
        path.unlink()
    (tmp_path / "Camera_B3/000003.jpg").unlink()
    capture, notes = opened(tmp_path)
    assert "1" not in {v.camera for v in capture.splits["novel_view"]}
    assert [v.frame for v in capture.splits["novel_view"]] == [0, 1, 2, 4]
    assert len(notes) == 1
    assert "of camera 1 frames 0 to 4; of camera 2 frame 3" in notes[0]
    check_pixels(capture, expected)
    assert check_capture(tmp_path).faults == []


def test_a_capture_whose_training_images_are_missing_is_refused_by_one_sentence(tmp_path):
    write.zju(tmp_path)
    for path in (tmp_path / "Camera_B1").iterdir():
        path.unlink()
    with pytest.raises(UserError, match=r"lists 15 images of which 5 are missing, the first .*000000\.jpg"):
        open_capture(tmp_path)


def test_masks_may_lie_in_either_folder_and_the_wrong_way_round_are_turned(tmp_path):
    expected = write.zju(tmp_path)
    (tmp_path / "mask_cihp").rename(tmp_path / "mask")
    capture = open_capture(tmp_path)
    np.testing.assert_array_equal(capture.load(capture.views("train")[0])[1] > 0.5, expected["person"])
    for path in (tmp_path / "mask").rglob("*.png"):
        cv2.imwrite(str(path), np.where(expected["person"], 0, 255).astype(np.uint8))
    capture, notes = opened(tmp_path)
    np.testing.assert_array_equal(capture.load(capture.views("train")[0])[1] > 0.5, expected["person"])
    assert len(notes) == 1
    assert "the other way round" in notes[0]


def _renumber(folder, images=lambda i: f"{i:06d}", params=str):
    for root in (folder, folder / "mask_cihp"):
        for camera in root.glob("Camera_*"):
            for path in sorted(camera.iterdir(), reverse=True):
                path.rename(camera / f"{images(int(path.stem))}{path.suffix}")
    change(folder / "annots.npy", lambda c: [f.update(ims=[
        f"{n.split('/')[0]}/{images(int(n.split('/')[1][:6]))}.jpg" for n in f["ims"]]) for f in c["ims"]])  # fmt: skip
    for i in reversed(range(5)):
        (folder / f"new_params/{i}.npy").rename(folder / f"new_params/{params(i)}.npy")


@pytest.mark.parametrize(
    ("images", "params", "noted"),
    [
        (lambda i: f"{i + 60:06d}", lambda i: str(i + 60), False),
        (lambda i: f"{i + 1:06d}", lambda i: f"{i + 1:06d}", False),
        (lambda i: f"{i + 1:06d}", str, True),
        (lambda i: f"{700 + 5 * i}", str, True),
    ],
)
def test_frames_may_start_at_any_number_and_parameters_too(tmp_path, images, params, noted):
    expected = write.zju(tmp_path)
    _renumber(tmp_path, images, params)
    capture, notes = opened(tmp_path)
    check_pixels(capture, expected)
    assert bool(notes) == noted
    assert all("paired in their order" in note for note in notes)
    if noted:  # one file less: it cannot be known which
        (tmp_path / "new_params/2.npy").unlink()
        with pytest.raises(UserError, match="is missing, though annots"):
            open_capture(tmp_path)


# skhu101/GauHuman #3 and #39: annots_new.npy of the refined release under the name annots.npy
@pytest.mark.parametrize("ims", [[], {}, None])
def test_annots_with_cameras_alone_are_named_for_what_they_are(tmp_path, ims):
    write.zju(tmp_path)
    change(tmp_path / "annots.npy", lambda c: c.update(ims=ims))
    with pytest.raises(UserError, match=r"'ims' is missing or empty.*annots_new\.npy holds cameras alone"):
        open_capture(tmp_path)


def test_faults_of_annots_and_of_parameters_are_named_together(tmp_path):
    write.zju(tmp_path)
    change(tmp_path / "annots.npy", lambda c: [c["ims"][1].update(ims=["a"]), c["cams"]["R"].__setitem__(2, np.eye(2))])
    change(tmp_path / "new_params/0.npy", lambda c: c.update(poses=np.zeros(66), Th=np.full(3, np.nan)))
    change(tmp_path / "new_params/4.npy", lambda c: c.pop("Rh"))
    faults = check_capture(tmp_path, {"name": "zju"}).faults
    words = ("frame 1 must list 3", "R of camera 2", "0.npy: poses has", "0.npy: Th holds", "4.npy: field 'Rh'")
    for word in words:
        assert sum(word in fault for fault in faults) == 1, (word, faults)
    assert len(faults) == len(words)
