"""A few frames of the embedded capture as a capture of their own, small enough to train on in a test."""

from __future__ import annotations

import importlib.resources
import json
import shutil
from pathlib import Path

import numpy as np

SMALL = [
    "progress=false", "threads=1", "encoder=unet_small", "encoder.width=8", "encoder.map_size=64",
    "decoder.widths=[32,32]", "decoder.skip=1", "decoder.head_width=16", "avatar.features=8", "avatar.feature_size=64",
    "stage1.steps=6", "stage1.batch=2",
    "stage1.levels=[{until:0.5,gaussians:2000,image:0.125},{until:1.0,gaussians:2850,image:0.25}]",
    "stage2.steps=4", "stage2.batch=2", "stage2.levels=[{until:1.0,gaussians:2850,image:0.25}]",
    "checkpoint_every=2", "preview_every=3", "losses=demo",
    "dynamics=always", "stage2.lr_features=0", "motion.stage2=0", "motion.stage2_trans=0",
]  # fmt: skip


def demo() -> Path:
    """The embedded capture."""
    return Path(str(importlib.resources.files("gavatar.data") / "studio_demo"))


def write_tiny_capture(folder: Path, frames=(0, 8, 16, 40, 60, 99), test=(24,), novel=(105,)) -> Path:
    """A capture of the given frames of the embedded one, renumbered from 0, with cam0 and one cam1 view."""
    source = demo()
    numbers = [*frames, *test, *novel]
    for kind, suffix in (("images", ".jpg"), ("masks", ".png")):
        (folder / kind / "cam0").mkdir(parents=True)
        for new, old in enumerate(numbers):
            name = f"{kind}/cam0/{old:06d}{suffix}"
            shutil.copy(source / name, folder / kind / "cam0" / f"{new:06d}{suffix}")
    for name in ("body.npz", "body_truth.npz"):
        with np.load(source / name) as file:
            arrays = dict(file)
        arrays["poses"], arrays["trans"] = arrays["poses"][numbers], arrays["trans"][numbers]
        np.savez(folder / name, **arrays)
    cameras = json.loads((source / "cameras.json").read_text())
    (folder / "cameras.json").write_text(json.dumps({"cam0": cameras["cam0"]}))
    count, held = len(frames), len(frames) + len(test)
    info = {
        "version": 1, "name": "tiny", "license": "CC0-1.0", "fps": 15, "body_model": "smplh", "background": "white",
        "splits": {
            "train": [["cam0", list(range(count))]],
            "test": [["cam0", list(range(count, held))]],
            "novel_pose": [["cam0", list(range(held, len(numbers)))]],
        },
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(info))
    return folder
