"""Several faults of one file, or of many files of a folder, are each named or counted."""

from __future__ import annotations

import json
import pickle

import foreign_captures as write
import numpy as np
import pytest
import torch
from changed_files import npy, npz, pth
from tiny_capture import write_tiny_capture

from gavatar.capture.check import check_capture
from gavatar.capture.opening import open_capture
from gavatar.registry import load_plugins
from gavatar_runtime.errors import UserError

load_plugins()


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
