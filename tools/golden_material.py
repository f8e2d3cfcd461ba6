"""What golden.py trains on: captures cut from the one that comes with gavatar, a made up SMPL-X model, footage."""

from __future__ import annotations

import importlib.util
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

DATA = Path(importlib.util.find_spec("gavatar").submodule_search_locations[0]) / "data"  # loads nothing of gavatar
DEMO, BODY = DATA / "studio_demo", DATA / "body" / "gavatar_body_smplh.npz"


def write_capture(folder: Path, body_model: str = "smplh", edit: Callable[[dict], dict] = lambda given: given) -> None:
    """A capture of 19 training views, 2 test, 2 novel poses and 2 novel views, its body.npz changed by `edit`."""
    shutil.copytree(DEMO, folder)
    info = json.loads((folder / "capture.json").read_text(encoding="utf-8"))
    train = sorted({*range(0, 100, 5), 67} - {25, 65})
    info |= {"name": folder.name, "body_model": body_model, "splits": {
        "train": [["cam0", train]], "test": [["cam0", [25, 65]]], "novel_pose": [["cam0", [101, 108]]],
        "novel_view": [["cam1", [45, 67]]],
    }}  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(info), encoding="utf-8")
    for name in ("body.npz", "body_truth.npz"):
        with np.load(folder / name) as file:
            arrays = edit(dict(file))
        np.savez(folder / name, **arrays)


def jumped(given: dict) -> dict:
    """True poses, but for one frame that stands 30 cm aside."""
    with np.load(DEMO / "body_truth.npz") as truth:
        trans = truth["trans"] + np.where(np.arange(len(truth["trans"])) == 40, 0.3, 0)[:, None] * np.array([1, 0, 0])
        return given | {"poses": truth["poses"], "trans": trans.astype(np.float32)}


def with_face(given: dict) -> dict:
    """The same motion in SMPL-X's joints, with a jaw that opens and an expression that changes."""
    T, poses = len(given["poses"]), given["poses"].reshape(len(given["poses"]), 52, 3)
    face, phase = np.zeros((T, 3, 3), np.float32), np.linspace(0, 1, T, dtype=np.float32)
    face[:, 0, 0] = 0.3 * phase
    poses = np.concatenate([poses[:, :22], face, poses[:, 22:]], 1).reshape(T, -1)
    return given | {"poses": poses, "expression": np.outer(phase, [2, -1, *[0] * 8]).astype(np.float32)}


def write_smplx(path: Path) -> None:
    """The free body in the layout of an SMPL-X file: jaw and eyes that share the head's weights, made up expression,
    pose blendshapes and hands."""
    rng, head = np.random.default_rng(0), 15
    with np.load(BODY) as file:
        free = dict(file)
    share = np.array([0.2, 0.05, 0.05])
    regressor, weights = free["J_regressor"].astype(np.float64), free["weights"].astype(np.float64)
    regressor = np.concatenate([regressor[:22], regressor[[head] * 3], regressor[22:]])
    weights = np.concatenate([weights[:, :22], weights[:, [head]] * share, weights[:, 22:]], 1)
    weights[:, head] *= 1 - share.sum()
    parents = [p + 3 * (p >= 22) for p in free["kintree_table"][0].tolist()]
    parents = np.array([0xFFFFFFFF, *parents[1:22], head, head, head, *parents[22:]])
    expression = weights[:, [22]][..., None] * rng.normal(0, 0.02, (1, 3, 10))
    posedirs = weights[:, None, 1:, None] * rng.normal(0, 0.01, (1, 3, 54, 9))
    hands = {f"hands_mean{s}": rng.normal(0, 0.2, 45) for s in "lr"}
    hands |= {f"hands_components{s}": np.linalg.qr(rng.normal(size=(45, 45)))[0] for s in "lr"}
    np.savez(
        path, v_template=free["v_template"], shapedirs=np.concatenate([free["shapedirs"], expression], 2), f=free["f"],
        posedirs=posedirs.reshape(len(weights), 3, -1).astype(np.float32), J_regressor=regressor, weights=weights,
        kintree_table=np.array([parents, np.arange(55)], np.uint32), vt=free["vt"], ft=free["ft"], **hands,
    )  # fmt: skip


def write_material(folder: Path) -> None:
    """Captures, a body model and footage."""
    write_capture(folder / "few")
    write_capture(folder / "jumped", edit=jumped)
    write_capture(folder / "face", "smplx", with_face)
    shutil.copytree(DEMO, folder / "whole")
    write_smplx(folder / "SMPLX_NEUTRAL.npz")
    (folder / "footage" / "frames").mkdir(parents=True)
    for number in range(0, 48, 6):
        image = cv2.imread(str(DEMO / "images" / "cam0" / f"{number:06d}.jpg"))
        cv2.imwrite(str(folder / "footage" / "frames" / f"{number:06d}.png"), image)
