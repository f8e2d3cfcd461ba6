"""Each fault of a capture in another layout is one sentence with file and field, and the check names them all."""

from __future__ import annotations

import json
import shutil

import cv2
import foreign_captures as write
import numpy as np
import pytest
import torch
from changed_files import npy, npz, pth
from tiny_capture import write_tiny_capture

from gavatar.capture.check import check_capture
from gavatar.capture.opening import open_capture
from gavatar.cli.prepare import main as prepare
from gavatar.registry import load_plugins
from gavatar_runtime.errors import UserError

load_plugins()

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
