"""An avatar with moving hands and face on SMPL-X's 55 joints, from a capture made here: what is optimised, what plays.

    python benchmarks/smplx_hands.py FOLDER [--figure docs/figures/smplx.jpg]

The body is the free one dressed up as SMPL-X (tests/support/official_bodies.py), the capture 24 rendered views of it
whose fingers close and whose mouth opens, the poses given to training are off by seeded noise. Prints the error of the
finger joints and of the body before and after training with motion.joints=22 and 55, and draws the exported avatar.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from smplx_capture import camera, hand_motion, write_smplx_capture, write_smplx_model

from gavatar.config import compose_config
from gavatar.evaluation.joint_errors import motion_errors, part_errors
from gavatar.export.bundling import export
from gavatar.training.run import open_run, train
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.render.choice import build_rasterizer

SETTINGS = [
    "experiment=demo", "encoder=none", "progress=false", "stage1.steps=500", "stage1.batch=4",
    "stage1.levels=[{until:0.6,gaussians:2850,image:0.5},{until:1.0,gaussians:10700,image:1.0}]",
]  # fmt: skip


def noisy(capture: Path, sigma: float = 0.12) -> None:
    """Keep the poses as body_truth.npz and disturb body.npz: `sigma` radians on every joint but the root."""
    with np.load(capture / "body.npz") as file:
        arrays = dict(file)
    np.savez(capture / "body_truth.npz", **arrays)
    poses = arrays["poses"].reshape(len(arrays["poses"]), -1, 3)
    noise = np.random.default_rng(0).normal(0, sigma, poses.shape)
    noise[:, 0] = 0
    np.savez(capture / "body.npz", **(arrays | {"poses": (poses + noise).reshape(len(poses), -1)}))


def errors(run, motion) -> tuple[float, float]:
    """Mean distance to the true joints in millimetres: of the 22 body joints, root at its place, and of the finger
    joints from their own wrist, so that each hand is judged alone."""
    truth, frames = run.capture.truth, range(len(run.capture.truth))
    body, _ = motion_errors(run.built, motion, truth, frames)
    return body, part_errors(run.built, motion, truth, frames).mpjpe_hands_mm


def draw(path: Path, bundle: Path, data) -> None:
    """Whole body, face and left hand of the exported avatar in four poses."""
    avatar, rasterizer = Avatar(bundle), build_rasterizer()
    poses, trans = hand_motion(data, 4)
    rows = []
    for view in (camera(300), camera(300, (0, 1.66, 0), 2, 13), camera(300, (0.6, 1.08, 0), 2, 14)):
        images = []
        for pose, place in zip(poses, trans, strict=True):  # the rasterizer fills its image again: keep a copy
            images.append(np.clip(rasterizer.render(avatar.gaussians(pose, place), view, (1, 1, 1)).color, 0, 1))
        rows.append(np.hstack(images))
    cv2.imwrite(str(path), np.round(255 * np.vstack(rows)).astype(np.uint8)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    folder = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    data = write_smplx_model(folder)
    capture = write_smplx_capture(folder / "capture", data, size=384, frames=24)
    noisy(capture)
    for joints in (22, 55):
        out = folder / f"joints{joints}"
        config = compose_config(
            [f"capture={capture}", f"out={out}", f"body.path={folder}", f"motion.joints={joints}", *SETTINGS]
        )
        train(config, out)
        run = open_run(out)
        if joints == 22:
            print("before: body {:.1f} mm, fingers {:.1f} mm".format(*errors(run, run.capture.motion)))
        print(
            "motion.joints={}: body {:.1f} mm, fingers {:.1f} mm".format(joints, *errors(run, run.motion.motion())),
            flush=True,
        )
    export(run, folder / "hands.gavatar")
    if arguments.figure:
        draw(arguments.figure, folder / "hands.gavatar", data)


if __name__ == "__main__":
    main()
