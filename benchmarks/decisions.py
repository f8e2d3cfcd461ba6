"""What the measures say that `auto` decides by, on captures as they are and with a planted fault.

    python benchmarks/decisions.py CAPTURE [CAPTURE ...] [--steps 50] [--json decisions.json]

Masks: how far off they are found to be, of masks dilated (above zero) or eroded by so many pixels. The rest after
`--steps` steps of stage 1 of 500 (preset `demo`, atlas 64, images of 128 pixels): how unevenly silhouettes fit at the
start, how much brightness the whole person has in common, what a trial of another shape gains, of the capture as it
is, with brightness that rises and falls by a fifth every sixty frames, and with the first shape coefficient off by one.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import torch

from gavatar.capture.capture import Capture, View
from gavatar.capture.opening import open_capture
from gavatar.config import check, compose_config
from gavatar.registry import load_plugins
from gavatar.storage import write_json
from gavatar.training.remedies.brightness import brightness
from gavatar.training.remedies.mask_border import mask_border
from gavatar.training.remedies.pose_quality import unsteadiness
from gavatar.training.remedies.shape_trial import shape_trial
from gavatar.training.scene import Scene
from gavatar.training.trainer import Trainer
from gavatar_runtime.errors import exit_cleanly

WIDTHS = (-3, -2, -1, 0, 1, 2, 3, 5)
SIDE = 128  # pixels of the images
DRIFT, PERIOD, SHAPE = 0.2, 60, 1.0


def masks_off_by(capture: Capture, pixels: int) -> Any:
    """The capture's pictures with masks that are `pixels` too wide."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(pixels) + 1,) * 2)

    def read(view: View) -> tuple[np.ndarray, np.ndarray]:
        image, mask = capture.read(view)
        return image, (cv2.dilate if pixels > 0 else cv2.erode)(mask, disc) if pixels else mask

    return SimpleNamespace(read=read)


def young(path: Path, steps: int, fault: str = "") -> tuple[Scene, float, float | None]:
    """A scene after some steps of stage 1, the scale of its images, and how unevenly silhouettes fitted before them."""
    capture = open_capture(path)
    scale = min(1.0, SIDE / max(max(c.width, c.height) for c in capture.cameras.values()))
    overrides = [f"capture={path}", "out=unused", "experiment=demo", "encoder=none", "progress=false"]
    overrides += ["stage1.steps=500", f"stage1.levels=[{{until:1.0,uv:64,image:{scale}}}]"]
    config = check(compose_config(overrides))
    trainer = Trainer(config, Path(tempfile.mkdtemp(prefix="decisions-")))  # for the preview that a first step draws
    scene = trainer.scene
    if fault == "drift":
        color = scene.footage.at(scale).color
        for row, view in enumerate(scene.views):
            gain = np.exp(DRIFT * np.sin(2 * np.pi * view.frame / PERIOD))
            color[row] = torch.minimum(gain * color[row].float(), scene.footage.at(scale).alpha[row]).to(torch.uint8)
    if fault == "shape":
        betas = np.zeros(10) if scene.built.betas is None else np.array(scene.built.betas, np.float64)
        scene.built.reshape(betas + SHAPE * np.eye(1, len(betas))[0])
    stage = trainer.stage(1)
    scene.avatar.train()
    stage._prepare(0)
    uneven = unsteadiness(scene, scale)
    for step in range(steps):
        stage.step(step)
    return scene, scale, uneven


def measured(path: Path, steps: int) -> dict[str, Any]:
    """The table's row of one capture."""
    capture = open_capture(path)
    views = capture.views("train")
    borders = {width: mask_border(masks_off_by(capture, width), views) for width in WIDTHS}
    row: dict[str, Any] = {"capture": path.name, "masks": {w: b and [b.pixels, b.mending] for w, b in borders.items()}}
    for fault in ("", "drift", "shape"):
        scene, scale, uneven = young(path, steps, fault)
        light, shape = brightness(scene, scale), shape_trial(scene, scale)
        row[fault or "as it is"] = {
            "silhouettes": None if uneven is None else round(uneven, 4),
            "brightness": light and light.common,
            "shape_db": shape and shape.gain_db,
        }
    return row


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, nargs="+")
    parser.add_argument("--steps", type=int, default=50, help="(%(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args(argv)
    load_plugins()
    rows = []
    for path in args.capture:
        rows.append(measured(path, args.steps))
        print(json.dumps(rows[-1]), flush=True)
    if args.json:
        write_json(args.json, rows)
    return 0


if __name__ == "__main__":
    main()
