"""What real footage gives, where no truth is known but the pictures: several calibrated cameras, one held out.

    python benchmarks/real_captures.py real_p2s --holdout cam04 --out DIR --figure real.jpg
    python benchmarks/real_captures.py real_turn/video.mp4 --out DIR

FOOTAGE is a video or a folder as `gavatar-prepare` takes them. It is prepared, an avatar is trained (stage 1, no
dynamics, sized for two CPU cores), and these are measured:

  masks      intersection over union of the masks found here with those that came with the footage (of another network;
             neither is the truth), where it came with some
  body       intersection over union of the fitted body's silhouette with the mask, per camera
  held out   PSNR and SSIM of the held-out camera's pictures (without --holdout: of every tenth frame, poses fitted to
             it with the avatar frozen), whole frame on white, and inside the mask's bounding box
  trained    the same of the training views
  see_through  share of the mask's inside, eroded, where the avatar lets more than a tenth of the background through

--given takes the footage's own landmarks and masks for the capture instead of finding them.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np
import torch

from gavatar.capture.capture import Capture, View, read_capture
from gavatar.config import compose_config
from gavatar.evaluation.scores import Evaluator
from gavatar.images.image_quality import mean_psnr, psnr, ssim
from gavatar.images.metrics import masked
from gavatar.preparation.detect import Detector
from gavatar.preparation.draw import iou
from gavatar.preparation.fit import FitOptions
from gavatar.preparation.footage_source import Source, SourceOptions, open_source
from gavatar.preparation.pipeline import fit_and_write
from gavatar.preparation.write import CaptureFacts
from gavatar.registry import BODIES, load_plugins
from gavatar.training.posing import attributes_in
from gavatar.training.run import Run, open_run, train
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.values.motion import Motion

HOLE = 0.9  # opacity below which a pixel well inside the mask counts as see-through
LARGEST_FIGURE = 1100  # pixels
MARGIN = 0.02  # of the mask's box: how far inside the mask that is


def detected(source: Path, options: SourceOptions, out: Path) -> Source:
    """`source` with the person found in it, whatever landmarks and masks lie beside it."""
    bare = out / "footage"
    bare.mkdir(parents=True, exist_ok=True)
    for name in ("videos", "frames", "cameras.json", "video.mp4"):
        if (source / name).exists() and not (bare / name).exists():
            (bare / name).symlink_to((source / name).resolve())
    return open_source(bare, options)


def mask_agreement(found: Source, given: Source) -> dict[str, dict]:
    return {a.name: _spread([iou(x > 127, y > 127) for x, y in zip(a.masks(), b.masks(), strict=True)])
            for a, b in zip(found.footage, given.footage, strict=True)}  # fmt: skip


def _spread(values) -> dict:
    return {"mean": round(float(np.mean(values)), 4), "worst": round(float(np.min(values)), 4)}


@torch.no_grad()
def opacity(evaluator: Evaluator, view: View, motion: Motion) -> np.ndarray:
    """(H, W) of the avatar in a view, drawn as a player draws it."""
    scene, run = evaluator.scene([view], motion), evaluator.run
    attributes = attributes_in(run, motion, view.frame)
    camera = run.capture.camera(view)
    return scene.draw(attributes, scene.motion([view.frame]), [camera], pixel=run.pixel)[1][0].numpy()


def holes(alpha: np.ndarray, mask: np.ndarray) -> float:
    """Share of the mask's inside where the avatar is see-through."""
    _, _, w, h = cv2.boundingRect(mask.astype(np.uint8))
    side = 2 * max(1, round(MARGIN * max(w, h))) + 1
    inside = cv2.erode(mask.astype(np.uint8), np.ones((side, side))) > 0
    return float((alpha[inside] < HOLE).mean()) if inside.any() else 0.0


def score(run: Run, evaluator: Evaluator, views: list[View], motion: Motion) -> dict:
    """Means over `views`, the avatar in the poses of `motion`."""
    rows = []
    for view in views:
        color, alpha = run.capture.load(view)
        pair = [torch.from_numpy(np.ascontiguousarray(i)).permute(2, 0, 1)[None].clamp(0, 1)
                for i in (evaluator.render(view, motion), color + (1 - alpha[..., None]))]  # fmt: skip
        mask = torch.from_numpy(alpha)[None]
        rows.append((float(psnr(*pair)), float(ssim(*pair)), float(masked(psnr, *pair, mask)),
                     float(masked(ssim, *pair, mask)),
                     holes(opacity(evaluator, view, motion), alpha > 0.5)))  # fmt: skip
    table = np.array(rows)
    ssim_whole, ssim_in_box, holes_share = (round(float(table[:, k].mean()), 4) for k in (1, 3, 4))
    return {"views": len(views), "psnr": round(mean_psnr(table[:, 0]), 2), "ssim": ssim_whole,
            "psnr_in_box": round(mean_psnr(table[:, 2]), 2), "worst_in_box": round(float(table[:, 2].min()), 2),
            "ssim_in_box": ssim_in_box, "see_through": holes_share}  # fmt: skip


def figure(path: Path, run: Run, evaluator: Evaluator, views: list[View], motion: Motion, columns: int = 5) -> None:
    """Footage, avatar, their difference three times enlarged, and the avatar on green, where what is see-through shows:
    a few views, each cropped around the person."""
    chosen = [views[i] for i in evenly_spaced(len(views), columns)]
    loaded = [run.capture.load(view) for view in chosen]
    boxes = [cv2.boundingRect((alpha > 0.5).astype(np.uint8)) for _, alpha in loaded]
    w, h = (max(box[k] for box in boxes) + 16 for k in (2, 3))
    stacks = []
    for view, (color, alpha), (x, y, bw, bh) in zip(chosen, loaded, boxes, strict=True):
        target = color + (1 - alpha[..., None])
        image, through = np.clip(evaluator.render(view, motion), 0, 1), 1 - opacity(evaluator, view, motion)[..., None]
        error = np.repeat(1 - np.clip(3 * np.abs(image - target).mean(-1, keepdims=True), 0, 1), 3, -1)
        on_green = np.clip(image - through * (1, 0, 1), 0, 1)
        crop = np.float32([[1, 0, (w - bw) // 2 - x], [0, 1, (h - bh) // 2 - y]])
        stacks.append(np.vstack([
            cv2.warpAffine(np.float32(i), crop, (w, h), borderValue=edge)
            for i, edge in ((target, (1, 1, 1)), (image, (1, 1, 1)), (error, (1, 1, 1)), (on_green, (0, 1, 0)))
        ]))  # fmt: skip
    picture = np.round(255 * np.clip(np.hstack(stacks), 0, 1)).astype(np.uint8)[..., ::-1]
    shrink = min(1.0, LARGEST_FIGURE / picture.shape[1])
    picture = cv2.resize(picture, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 88] if path.suffix in (".jpg", ".jpeg") else [])


def body_coverage(scores: np.ndarray, names: list[str]) -> dict:
    return {name: _spread(row) for name, row in zip(names, scores, strict=True)}


def held_out(capture: Capture) -> tuple[str, list[View]]:
    """The held-out camera at frames whose poses were refined, else the held-out frames."""
    trained = {view.frame for view in capture.views("train")}
    novel = [view for view in capture.splits.get("novel_view", []) if view.frame in trained]
    return ("novel_view", novel) if novel else ("test", list(capture.splits.get("test", [])))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("footage", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder for the capture, the run, the result")
    parser.add_argument("--holdout", metavar="CAM", help="camera whose pictures are kept from training")
    parser.add_argument("--given", action="store_true", help="the footage's own landmarks and masks")
    parser.add_argument("--frames", default="::4", help="A:B:STEP (default: %(default)s)")
    parser.add_argument("--size", type=int, default=640, help="longer side, pixels (default: %(default)s)")
    parser.add_argument("--steps", type=int, default=750, help="of stage 1 (default: %(default)s)")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="further overrides of the training")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figure", type=Path)
    return parser.parse_args()


def main() -> None:
    options = arguments()
    load_plugins()
    out, start = options.out, time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    frames = slice(*(int(part) if part else None for part in options.frames.split(":")))
    opened = SourceOptions(frames=frames, size=options.size, detector=Detector(out / "masks", progress=False))
    has_masks = options.footage.is_dir() and (options.footage / "masks").is_dir()
    given = open_source(options.footage, opened) if has_masks else None
    if options.given and given is None:
        raise SystemExit(f"{options.footage} holds no masks and landmarks")
    source = given if options.given else (
        detected(options.footage, opened, out) if options.footage.is_dir() else open_source(options.footage, opened)
    )  # fmt: skip
    result: dict = {"footage": options.footage.name, "frames": len(source.footage[0].numbers), "size": options.size}
    if given is not None and source is not given:
        result["masks"] = mask_agreement(source, given)
    found = time.perf_counter()
    facts = CaptureFacts(options.footage.stem, "free", holdout_camera=options.holdout)
    known = source.footage[0].lens is not None
    quality = fit_and_write(source, BODIES.build("free").data, out / "capture", facts, overwrite=True, progress=False,
                      options=FitOptions(refine_cameras=known and len(source.footage) > 1))  # fmt: skip
    result["body"] = body_coverage(quality.iou, [f.name for f in source.footage])
    prepared = time.perf_counter()
    print(json.dumps(result, indent=1), flush=True)
    if options.steps:
        overrides = ["experiment=demo", "encoder=none", f"stage1.steps={options.steps}", "stage2.steps=0"]
        overrides += ["progress=false", f"capture={out / 'capture'}", f"out={out / 'run'}", "overwrite=true"]
        train(compose_config(overrides + options.set), out / "run")
        trained = time.perf_counter()
        run = open_run(out / "run", stage=1)
        evaluator, motion = Evaluator(run, progress=False), run.motion.motion()
        kind, views = held_out(run.capture)
        fitted = motion if kind == "novel_view" else evaluator.fit(views)
        result["gaussians"] = len(run.avatar.surface)
        result["held_out"] = {"split": kind, **score(run, evaluator, views, fitted)}
        result["trained"] = score(run, evaluator, read_capture(out / "capture").views("train")[::5], motion)
        result["seconds"] = {"finding": round(found - start, 1), "fit_and_write": round(prepared - found, 1),
                             "stage1": round(trained - prepared, 1)}  # fmt: skip
        print(json.dumps(result, indent=1), flush=True)
        if options.figure:
            figure(options.figure, run, evaluator, views, fitted)
    print(json.dumps(result, indent=1))
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
