"""How well raw video is prepared: a capture with known truth is made into a video, and everything is found again.

    python benchmarks/preparation.py studio_male --out DIR

Prints, against the capture's truth: the masks' intersection over union, MPJPE (root-aligned, the camera's axes) and
PA-MPJPE of the fitted body before any training, of the silhouettes, and both joint errors after stage 1. The camera is
unknown to the preparation unless --fov says its field of view. The last row is what no fit can beat: the silhouette of
the true body, which wears no clothes, against the true mask.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np

from gavatar.body.skeleton import BodyData
from gavatar.capture.capture import Capture, read_capture
from gavatar.config import compose_config
from gavatar.images.metrics import joint_errors
from gavatar.preparation.detect import Detector
from gavatar.preparation.draw import body_mask, iou, overlay
from gavatar.preparation.fit import FitOptions
from gavatar.preparation.footage_source import SourceOptions, open_source
from gavatar.preparation.initial import DEFAULT_FOV
from gavatar.preparation.pipeline import fit_and_write
from gavatar.preparation.write import CaptureFacts
from gavatar.registry import BODIES, load_plugins
from gavatar.training.run import open_run, train
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion


def make_video(capture: Capture, camera: str, frames: int, path: Path) -> Path:
    """The first `frames` images of a camera, on white, as an mp4."""
    size = (capture.cameras[camera].width, capture.cameras[camera].height)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), capture.motion.fps, size)
    for t in range(frames):
        color, alpha = capture.load(type(capture.views("train")[0])(camera, t))
        writer.write(
            np.ascontiguousarray(np.round(255 * np.clip(color + 1 - alpha[..., None], 0, 1))[..., ::-1], np.uint8)
        )
    writer.release()
    return path


def joints_seen(data: BodyData, motion: Motion, betas: np.ndarray, camera: Camera) -> np.ndarray:
    """(T, J, 3) joints along the camera's axes, metres."""
    poses = motion.poses.reshape(len(motion.trans), -1, 3)
    joints = np.array([data.posed(p, betas, t)[1] for p, t in zip(poses, motion.trans, strict=True)])
    return joints @ camera.T_camera_world[:3, :3].T


def scores(a, b) -> dict:
    values = [iou(x, y) for x, y in zip(a, b, strict=True)]
    return {"mean": round(float(np.mean(values)), 4), "worst": round(float(min(values)), 4)}


def silhouettes(data: BodyData, motion: Motion, betas: np.ndarray, camera: Camera):
    poses = motion.poses.reshape(len(motion.trans), -1, 3)
    return (body_mask(data, camera, p, betas, t) > 0 for p, t in zip(poses, motion.trans, strict=True))


def figure(out: Path, data: BodyData, motion: Motion, camera: Camera, path: Path, columns: int = 6) -> None:
    """Footage, mask and fitted body of a few frames, one below the other."""
    rows = []
    for t in evenly_spaced(len(motion.trans), columns):
        stem = next((out / "capture/images/cam0").glob(f"{t:06d}.*"))
        image, mask = cv2.imread(str(stem)), cv2.imread(str(out / f"capture/masks/cam0/{t:06d}.png"))
        body = overlay(image, data, camera, motion.poses[t].reshape(-1, 3), motion.betas, motion.trans[t])
        x = slice(camera.width // 5, -camera.width // 5)
        rows.append(np.vstack([cv2.resize(i[:, x], None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA) for i in
                               (image, mask, body)]))  # fmt: skip
    cv2.imwrite(str(path), np.hstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 88])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for the video, the capture, the run, the result"
    )
    parser.add_argument("--camera", default="cam0")
    parser.add_argument("--frames", type=int, default=140)
    parser.add_argument(
        "--fov", type=float, default=DEFAULT_FOV, help="degrees over the longer side (default: a guess)"
    )
    parser.add_argument("--train-steps", type=int, default=500, help="of stage 1; 0 leaves training out")
    parser.add_argument("--figure", type=Path, help="also write a picture of footage, masks and fitted body")
    arguments = parser.parse_args()
    load_plugins()
    given, out = read_capture(arguments.capture), arguments.out
    count = min(arguments.frames, len(given.motion.trans))
    out.mkdir(parents=True, exist_ok=True)
    data, camera = BODIES.build("free").data, given.cameras[arguments.camera]
    truth = Motion(given.truth.poses[:count], given.truth.trans[:count], given.truth.fps, given.truth.betas)
    clip = make_video(given, arguments.camera, count, out / "clip.mp4")

    start = time.perf_counter()
    source = open_source(clip, SourceOptions(detector=Detector(out / "masks"), most_frames=count))
    detected = time.perf_counter()
    facts = CaptureFacts("prepared", "free", given.license, f"gavatar-prepare {clip.name}")
    fit_and_write(source, data, out / "capture", facts, fov=arguments.fov, options=FitOptions(), overwrite=True)
    fitted = time.perf_counter()
    found = read_capture(out / "capture")
    lens = found.cameras["cam0"]
    true_joints = joints_seen(data, truth, truth.betas, camera)
    views = [type(given.views("train")[0])(arguments.camera, t) for t in range(count)]
    true_masks = [given.load(view)[1] > 0.5 for view in views]
    errors = joint_errors(joints_seen(data, found.motion, found.motion.betas, lens), true_joints)
    result = {
        "frames": count, "fov": arguments.fov, "notes": source.notes,
        "seconds": {"detection": round(detected - start, 1), "fit_and_write": round(fitted - detected, 1)},
        "mask_iou": scores((m > 127 for m in source.footage[0].masks()), true_masks),
        "fit": {"mpjpe_mm": round(errors[0], 2), "pa_mpjpe_mm": round(errors[1], 2),
                "silhouette_iou": scores(silhouettes(data, found.motion, found.motion.betas, lens), true_masks)},
        "true_body_silhouette_iou": scores(silhouettes(data, truth, truth.betas, camera), true_masks),
    }  # fmt: skip
    print(json.dumps(result, indent=1), flush=True)
    if arguments.figure:
        figure(out, data, found.motion, lens, arguments.figure)
    if arguments.train_steps:
        overrides = ["experiment=demo", "encoder=none", f"stage1.steps={arguments.train_steps}", "stage2.steps=0"]
        overrides += [f"capture={out / 'capture'}", f"out={out / 'run'}", "overwrite=true"]
        train(compose_config(overrides), out / "run")
        refined = open_run(out / "run", stage=1).motion.motion()
        trained = sorted({view.frame for view in found.views("train")})
        for name, motion in (("fitted_training_frames", found.motion), ("after_stage1", refined)):
            joints = joints_seen(data, motion, found.motion.betas, lens)
            error = joint_errors(joints[trained], true_joints[trained])
            result[name] = {"mpjpe_mm": round(error[0], 2), "pa_mpjpe_mm": round(error[1], 2)}
        result["seconds"]["stage1"] = round(time.perf_counter() - fitted, 1)
    (out / "preparation.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
