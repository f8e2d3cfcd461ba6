"""What each choice about appearance is worth: a capture with one planted fault, trained with and without a remedy.

python benchmarks/appearance.py CAPTURE --json appearance.json           # all studies
python benchmarks/appearance.py CAPTURE --figure docs/figures/appearance.jpg

Runs are of the preset `demo` at images of half size (atlas 64, then 128), on the capture's true poses and with motion
optimisation off, so that appearance is seen apart from pose; --estimated takes the poses as estimated and optimises
them. Scores are of whole frames on white against the capture as it is, without the planted fault.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from gavatar.capture.capture import Capture, View
from gavatar.capture.opening import open_capture
from gavatar.config import compose_config
from gavatar.evaluation.scores import Evaluator, evaluate
from gavatar.registry import load_plugins
from gavatar.storage import write_image, write_json
from gavatar.text_table import format_table
from gavatar.training.run import open_run, train
from gavatar_runtime.errors import exit_cleanly
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle

LEVELS = "[{until:0.65,gaussians:2850,image:0.25},{until:1.0,gaussians:10700,image:0.5}]"
MOVING = "motion.enabled=true"
STATIC = ["encoder=none", "stage2.steps=0"]
# of every run but those named `auto`: nothing is decided by what is measured
BY_HAND = ["mask_matte=0", "exposure=false", "motion.mend=0", "motion.betas=false", "motion.start=0"]
SPLITS = ("test", "novel_pose", "novel_view")


@dataclass
class Variant:
    """One run of a study. fault: of FAULTS, planted in the capture that is trained on. prepare: what is done to the
    opened run before it is scored. image: scale at which it is scored. run: name of the run, where variants share one.
    """

    name: str
    overrides: list[str] = field(default_factory=list)
    fault: str | None = None
    stage: int = 1
    image: float = 0.5
    prepare: Callable = lambda run: None
    run: str | None = None
    auto: bool = False


def batch_statistics(run) -> None:
    """The networks left in training mode: BatchNorm normalises by the one pose that it is given."""
    run.avatar.train()


def forget_pixel(run) -> None:
    """As if nothing were known of the size of the training's pixels."""
    run.pixel = None


def STUDIES() -> dict[str, list[Variant]]:
    dyn = ["stage2.steps=300", "stage2.batch=3", "stage2.lr_features=0", "encoder.width=16"]
    group, batch = [*dyn, "encoder=unet"], [*dyn, "encoder=unet_batchnorm"]
    upstream = ["decoder=upstream", "decoder.scale_warmup=50", *STATIC]
    floor = ["decoder.scale_floor=0.4", *STATIC]
    antialiased = ["rasterizer=native", "rasterizer.antialiased=true", *STATIC]

    def auto(name: str, fault: str | None) -> Variant:
        return Variant(f"{name}, auto", STATIC, fault=fault, auto=True)

    return {
        "batchnorm": [
            Variant("U-Net, GroupNorm", group, stage=2, run="group"),
            Variant("the same, stage 1", group, stage=1, run="group"),
            Variant("U-Net, BatchNorm, running statistics", batch, stage=2, run="batch"),
            Variant("U-Net, BatchNorm, statistics of the pose", batch, stage=2, run="batch", prepare=batch_statistics),
            Variant("decoder upstream, running statistics", upstream, run="upstream"),
            Variant("decoder upstream, statistics of the points", upstream, run="upstream", prepare=batch_statistics),
        ],
        "anisotropic": [
            Variant("isotropic", STATIC, run="static"),
            Variant("anisotropic", ["decoder.anisotropic=true", *STATIC]),
        ],
        "masks": [
            Variant("true masks", STATIC, run="static"),
            Variant("masks too wide", STATIC, fault="wide_mask"),
            Variant("masks too wide, mask_matte 5", ["mask_matte=5", *STATIC], fault="wide_mask"),
            auto("masks too wide", "wide_mask"),
            Variant("masks too narrow", STATIC, fault="narrow_mask"),
            Variant("masks too narrow, mask_matte -5", ["mask_matte=-5", *STATIC], fault="narrow_mask"),
            auto("masks too narrow", "narrow_mask"),
            Variant("true masks before a dark wall", STATIC, fault="dark"),
            auto("true masks before a dark wall", "dark"),
        ],
        "unseen": [
            Variant("front only", STATIC, fault="front"),
        ],
        "exposure": [
            Variant("steady", STATIC, run="static"),
            Variant("flicker", STATIC, fault="flicker"),
            Variant("flicker, exposure", ["exposure=true", *STATIC], fault="flicker"),
            Variant("drift", STATIC, fault="drift"),
            auto("flicker", "flicker"),
            Variant("drift, exposure", ["exposure=true", *STATIC], fault="drift"),
            auto("drift", "drift"),
            Variant("steady, exposure", ["exposure=true", *STATIC]),
            auto("steady", None),
        ],
        "shape": [
            Variant("wrong shape", [*STATIC, MOVING], fault="shape"),
            Variant("wrong shape, betas", [*STATIC, MOVING, "motion.betas=true"], fault="shape"),
            Variant("wrong shape, auto", [*STATIC, MOVING], fault="shape", auto=True),
            Variant("right shape", [*STATIC, MOVING]),
            Variant("right shape, auto", [*STATIC, MOVING], auto=True),
        ],
        "size": [
            Variant("as trained, 256 px", STATIC, run="static"),
            Variant("512 px, pixel filter alone", STATIC, run="static", image=1.0, prepare=forget_pixel),
            Variant("512 px, as_trained", STATIC, run="static", image=1.0),
            Variant("scale_floor 0.4, 256 px", floor, run="floor"),
            Variant("scale_floor 0.4, 512 px", floor, run="floor", image=1.0, prepare=forget_pixel),
            Variant("antialiased, 256 px", antialiased, run="antialiased"),
            Variant("antialiased, 512 px", antialiased, run="antialiased", image=1.0, prepare=forget_pixel),
            Variant("antialiased, 512 px, as_trained", antialiased, run="antialiased", image=1.0),
        ],
    }


DARK, WIDER = 0.05, 3  # the background that a bad mask takes in, and by how many pixels


def wide_mask(view: View, color: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Filmed before something dark, cut out a few pixels too wide."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * WIDER + 1, 2 * WIDER + 1))
    return color + (1 - alpha[..., None]) * DARK, cv2.dilate(alpha, disc)


def narrow_mask(view: View, color: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Filmed before something dark, cut out a few pixels too narrow."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * WIDER + 1, 2 * WIDER + 1))
    return color + (1 - alpha[..., None]) * DARK, cv2.erode(alpha, disc)


def dark(view: View, color: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Filmed before something dark, cut out as it should be."""
    return color + (1 - alpha[..., None]) * DARK, alpha


def flicker(view: View, color: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Brightness off by 12 % and each colour by 4 % more, another way in every frame; on white."""
    random = np.random.default_rng([view.frame, 5])
    gain = np.exp(random.normal(0, 0.12) + random.normal(0, 0.04, 3))
    return np.minimum(color * gain, alpha[..., None]) + (1 - alpha[..., None]), alpha


def drift(view: View, color: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Brightness that rises and falls by a fifth once in sixty frames, on white: no view of a side averages it out."""
    gain = np.exp(0.2 * np.sin(2 * np.pi * view.frame / 60))
    return np.minimum(color * gain, alpha[..., None]) + (1 - alpha[..., None]), alpha


# what is done to a training image (premultiplied colour, alpha), and the background that the result has
FAULTS = {
    "wide_mask": (wide_mask, "footage"),
    "narrow_mask": (narrow_mask, "footage"),
    "dark": (dark, "footage"),
    "flicker": (flicker, "white"),
    "drift": (drift, "white"),
}


def planted(capture: Capture, folder: Path, true_poses: bool, fault: str | None) -> Path:
    """A capture folder like `capture` with the fault planted in its training views. Written anew each time."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    source = capture.path.resolve()
    info = json.loads((source / "capture.json").read_text(encoding="utf-8"))
    for name in ("cameras.json", "body_truth.npz"):
        if (source / name).exists():
            (folder / name).symlink_to(source / name)
    (folder / "body.npz").symlink_to(source / ("body_truth.npz" if true_poses else "body.npz"))
    if true_poses:  # the truth has no shape of its own
        (folder / "body.npz").unlink()
        with np.load(source / "body.npz") as given, np.load(source / "body_truth.npz") as truth:
            np.savez(folder / "body.npz", **dict(given) | dict(truth))
    if fault == "shape":
        with np.load(folder / "body.npz") as given:
            arrays = dict(given)
        (folder / "body.npz").unlink()
        np.savez(folder / "body.npz", **arrays | {"betas": arrays["betas"] + np.eye(1, arrays["betas"].size)[0]})
    if fault == "front":
        info["splits"]["train"] = facing(capture)
    if fault in FAULTS:
        change, info["background"] = FAULTS[fault]
        for view in capture.views("train"):
            color, alpha = change(view, *capture.load(view))
            write_image(folder / "images" / view.camera / f"{view.frame:06d}.png", color)
            write_image(folder / "masks" / view.camera / f"{view.frame:06d}.png", np.repeat(alpha[..., None], 3, -1))
        info["splits"] = {"train": info["splits"]["train"]}
    else:
        for name in ("images", "masks"):
            (folder / name).symlink_to(source / name)
    write_json(folder / "capture.json", info)
    return folder


def facing(capture: Capture, degrees: float = 60) -> list:
    """Training views in which the person faces the camera within so many degrees."""
    motion = capture.truth or capture.motion
    kept: dict[str, list[int]] = {}
    for view in capture.views("train"):
        forward = matrix_from_axis_angle(motion.poses[view.frame, 0].astype(np.float64))[:, 2]
        towards = capture.camera(view).position - motion.trans[view.frame]
        cosine = np.dot(forward[[0, 2]], towards[[0, 2]])
        cosine /= np.linalg.norm(forward[[0, 2]]) * np.linalg.norm(towards[[0, 2]])
        if cosine > np.cos(np.radians(degrees)):
            kept.setdefault(view.camera, []).append(view.frame)
    return [[camera, frames] for camera, frames in kept.items()]


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="a capture with true poses, for example studio_male")
    parser.add_argument("--study", default="", help="comma-separated, by default all")
    parser.add_argument("--only", default="", help="of a study, the variants whose name holds this")
    parser.add_argument("--out", type=Path, default=Path("runs/appearance"), help="run directories (%(default)s)")
    parser.add_argument("--estimated", action="store_true", help="train on the estimated poses and optimise them")
    parser.add_argument("--steps", type=int, default=500, help="of stage 1 (%(default)s)")
    parser.add_argument("--every", type=int, default=3, help="score each Nth view of a split (%(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="only the picture, of runs that are there")
    parser.add_argument("override", nargs="*", help="Hydra overrides for every run")
    return parser.parse_intermixed_args(argv)


def trained(args: argparse.Namespace, capture: Capture, variant: Variant) -> Path:
    """The variant's run directory, trained unless it is there already."""
    poses = "estimated" if args.estimated else "true"
    directory = args.out / poses / (variant.run or variant.name).replace(" ", "_").replace(",", "")
    if not (directory / "motion.npz").exists():
        source = planted(capture, args.out / poses / "captures" / (variant.fault or "none"), not args.estimated,
                         variant.fault)  # fmt: skip
        base = [f"capture={source}", f"out={directory}", "experiment=demo", f"stage1.steps={args.steps}"]
        base += [f"stage1.levels={LEVELS}", "stage2.levels=[{until:1.0,gaussians:10700,image:0.5}]", "progress=false"]
        base += ["preview_every=1000000", "checkpoint_every=1000000", "overwrite=true"]
        if not args.estimated:
            base.append("motion.enabled=false")
        base += [] if variant.auto else BY_HAND
        train(compose_config([*base, *variant.overrides, *args.override]), directory)
    return directory


def scored(args: argparse.Namespace, capture: Capture, directory: Path, variant: Variant) -> dict:
    """PSNR and SSIM of each split with true poses, and of the training views with the poses of training."""
    run = open_run(directory, variant.stage)
    metrics = json.loads((directory / "metrics.json").read_text(encoding="utf-8"))
    seconds, choices = metrics["seconds"], metrics["verdicts"].get("choices", {})
    train_views = run.capture.views("train")
    run.capture = capture.resized(variant.image)
    run.capture.splits = {s: run.capture.splits[s][:: args.every] for s in SPLITS}
    run.capture.splits["train"] = train_views[:: args.every]
    variant.prepare(run)
    result = evaluate(run, ["train", *SPLITS], fit_steps=0, perceptual=False, progress=False)
    row = {"variant": variant.name, "seconds": round(sum(seconds.values()), 1)}
    row["chosen"] = {name: [choice["value"], choice["measured"]] for name, choice in choices.items()}
    for score in result.rows:
        if score.split == "train" or score.poses == "true":
            row |= {f"{score.split}_psnr": round(score.psnr, 3), f"{score.split}_ssim": round(score.ssim, 5)}
            if score.split == "train" and score.mpjpe_mm is not None:
                row["mpjpe_mm"] = round(score.mpjpe_mm, 2)
    return row


# of studio_male: a face at twice the trained size, a hand in a novel pose, an outline, a back that was never filmed
PANELS = (
    (View("cam0", 60), (75, 222, 70), [("static", True), ("static", False), ("floor", True)]),
    (View("cam0", 160), (150, 220, 130), [("static", False), ("anisotropic", False)]),
    (
        View("cam0", 60),
        (190, 90, 160),
        [("masks_too_wide", False), ("masks_too_wide_mask_matte_5", False)],
    ),
    (View("cam0", 28), (75, 140, 220), [("front_only", False)]),
)


def figure(args: argparse.Namespace, capture: Capture) -> None:
    """A row a panel: footage, then the runs of it; where `bare`, drawn by the pixel filter alone."""
    rows = []
    for view, (top, left, side), runs in PANELS:
        color, alpha = capture.load(view)
        cells = [color + (1 - alpha[..., None])]
        for name, bare in runs:
            run = open_run(args.out / "true" / name)
            run.capture, run.pixel = capture, None if bare else run.pixel
            cells.append(Evaluator(run, progress=False).render(view, capture.truth))
        cells = [cell[top : top + side, left : left + side] for cell in cells]
        cells += [np.ones_like(cells[0])] * (4 - len(cells))
        rows.append(
            np.concatenate([cv2.resize(c, (240, 240), interpolation=cv2.INTER_NEAREST_EXACT) for c in cells], 1)
        )
    write_image(args.figure, np.concatenate(rows))


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    args = arguments(argv)
    load_plugins()
    capture = open_capture(args.capture)
    if args.figure:
        figure(args, capture)
        return 0
    studies = STUDIES()
    chosen = args.study.split(",") if args.study else list(studies)
    report: dict[str, list[dict]] = {}
    for study in chosen:
        for variant in studies[study]:
            if args.only and args.only not in variant.name:
                continue
            start = time.monotonic()
            row = scored(args, capture, trained(args, capture, variant), variant)
            report.setdefault(study, []).append(row)
            print(f"{time.monotonic() - start:6.0f} s  {study}: {json.dumps(row)}", flush=True)
            if args.json:
                write_json(args.json, {"arguments": sys.argv[1:] if argv is None else argv, "studies": report})
    for study, rows in report.items():
        header = [study, "train", *SPLITS, "MPJPE", "s"]
        keys = [*(f"{s}_psnr" for s in ("train", *SPLITS)), "mpjpe_mm", "seconds"]
        print(format_table(header, [[r["variant"], *(f"{r[k]:.2f}" if k in r else "-" for k in keys)] for r in rows]))
    return 0


if __name__ == "__main__":
    main()
