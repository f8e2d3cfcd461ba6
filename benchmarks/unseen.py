"""What an avatar looks like where it was not filmed: cameras that look from behind at a person filmed from the front.

python benchmarks/unseen.py RUN... --json unseen.json                 # runs trained with train_split=train_front
python benchmarks/unseen.py RUN... --stages 1 --pictures DIR          # the pictures from behind, on white and black
python benchmarks/unseen.py --train CAPTURE --out DIR --seeds 0 1     # train them first

Of a capture with true poses. `behind`: views outside training whose camera stands more than 120 degrees from where the
person faces, all drawn with true poses on white:
  PSNR, blurred    of the whole picture, and of picture and footage blurred by 8 pixels (sigma)
  perceptual       distance of the whole picture
  energy           mean square of what is finer than 4 pixels (sigma), of unseen parts over that of seen parts in the
                   same avatar's pictures; `footage` is the same of the footage
  seen             PSNR inside the person where training saw them, over all views outside training
A part is seen where some training view saw that place of the body, in its true pose, nearer than all else and within 60
degrees of squarely; the body itself, without clothes and hair, tells the places apart, the same for every run.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from gavatar.avatar.atlas import sample_atlas
from gavatar.capture.capture import View
from gavatar.config import compose_config, register_configs
from gavatar.evaluation.scores import Evaluator
from gavatar.images.metrics import perceptual_metric
from gavatar.storage import write_image, write_json
from gavatar.text_table import format_table
from gavatar.training.run import Run, open_run, train
from gavatar_runtime.errors import UserError, exit_cleanly
from gavatar_runtime.geometry.kinematics import skin
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.surface import Surface

BEHIND = 120.0  # degrees between where the person faces and the camera
SQUARE = 0.5  # cosine between normal and view from which on a part is seen
NEARER = 0.03  # metres behind the nearest point of its pixel at which a point is hidden
BLUR, FINE = 8.0, 4.0  # pixels, sigma
AT_MOST = 24  # views from behind, evenly spaced
LEVELS = "[{{until:{0},uv:64,image:{1}}},{{until:1.0,uv:128,image:0.4}}]"
TRAINING = [
    "experiment=demo", "train_split=train_front",
    "stage1.levels=" + LEVELS.format(0.65, 0.2), "stage2.levels=" + LEVELS.format(0.5, 0.4),
]  # fmt: skip


def facing(motion: Motion, frame: int, camera: Camera) -> float:
    """Degrees, about the vertical, between where the person faces and where the camera stands."""
    front = (matrix_from_axis_angle(motion.poses[frame, 0]) @ [0, 0, 1])[[0, 2]]
    away = (camera.position - motion.trans[frame])[[0, 2]]
    cosine = front @ away / max(np.linalg.norm(front) * np.linalg.norm(away), 1e-9)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def outside_training(run: Run) -> list[View]:
    """Every view of the capture that is not of the training split, each once."""
    capture, trained = run.capture, set(run.capture.views(run.config.train_split))
    views = {view: None for split in capture.splits for view in capture.views(split) if view not in trained}
    return list(views)


class Places:
    """Which places of the body training saw, and where they are in a picture."""

    def __init__(self, run: Run):
        self.run, self.motion = run, run.capture.truth
        self.surface: Surface = sample_atlas(run.built.body.data, run.built.betas, 160)
        self.seen = np.zeros(len(self.surface), bool)
        for view in run.capture.views(run.config.train_split):
            points, squareness, pixel, nearest = self._project(view)
            depth = points[:, 2]
            visible = (pixel >= 0) & (depth < nearest[np.maximum(pixel, 0)] + NEARER)
            self.seen |= visible & (squareness > SQUARE)

    def _project(self, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Points in the camera, cosines towards it, the cell of 3 x 3 pixels each falls in (-1: none), and the nearest
        depth in each cell."""
        surface, camera = self.surface, self.run.capture.camera(view).scaled(0.4)
        pose = np.asarray(self.motion.poses[view.frame], np.float32)
        points = surface.posed(pose) + self.motion.trans[view.frame]
        turns = surface.skin_transforms(pose)
        turns[:, :3, 3] = 0
        normals = skin(surface.normals, surface.joint_index, surface.joint_weight, turns)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        towards = camera.position - points
        squareness = (normals * towards).sum(1) / np.linalg.norm(towards, axis=1)
        local = points @ camera.T_camera_world[:3, :3].T + camera.T_camera_world[:3, 3]
        x = np.floor((local[:, 0] / local[:, 2] * camera.fx + camera.cx) / 3).astype(int)
        y = np.floor((local[:, 1] / local[:, 2] * camera.fy + camera.cy) / 3).astype(int)
        width, height = camera.width // 3 + 1, camera.height // 3 + 1
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (local[:, 2] > 0.1)
        cell = np.where(inside, y * width + x, -1)
        nearest = np.full(width * height, np.inf)
        np.minimum.at(nearest, cell[inside], local[inside, 2])
        return local, squareness, cell, nearest

    def in_view(self, view: View, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(H, W) bool each: pixels well inside the person that show unseen, and seen, places. What the body does not
        reach (clothes, hair) counts to the nearest of its pixels."""
        local, _, cell, nearest = self._project(view)
        front = (cell >= 0) & (local[:, 2] < nearest[np.maximum(cell, 0)] + NEARER)
        camera = self.run.capture.camera(view).scaled(0.4)
        width, height = camera.width // 3 + 1, camera.height // 3 + 1
        votes = np.zeros((2, width * height))
        np.add.at(votes, (self.seen[front].astype(int), cell[front]), 1.0)
        known = votes.sum(0).reshape(height, width) > 0
        label = (votes[1] > votes[0]).reshape(height, width)
        _, index = cv2.distanceTransformWithLabels(
            (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        by_label = np.zeros(index.max() + 1, bool)
        by_label[index[known]] = label[known]
        filled = by_label[index].astype(np.float32)
        x = (np.arange(mask.shape[1]) + 0.5) / mask.shape[1] * camera.width / 3
        y = (np.arange(mask.shape[0]) + 0.5) / mask.shape[0] * camera.height / 3
        seen = filled[np.minimum(y.astype(int), height - 1)][:, np.minimum(x.astype(int), width - 1)] > 0.5
        inner = cv2.erode((mask > 0.99).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        return inner & ~seen, inner & seen


def blurred(picture: np.ndarray, sigma: float) -> np.ndarray:
    return cv2.GaussianBlur(picture, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)


def fine(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W) mean square over the channels of what is finer than FINE pixels, the person's rim left out of the blur."""
    weight = (mask > 0.99).astype(np.float32)[..., None]
    mean = blurred(picture * weight, FINE) / np.maximum(blurred(weight, FINE).reshape(weight.shape), 1e-3)
    return np.square((picture - mean) * weight).mean(-1)


def decibels(error: float) -> float:
    return float(-10 * np.log10(max(error, 1e-10)))


def score(run: Run, views: list[View], places: Places, pictures: Path | None = None) -> dict[str, Any]:
    """The row of one avatar. pictures: folder for its pictures from behind, on white and on black."""
    capture, motion = run.capture, run.capture.truth
    evaluator, (metric, _) = Evaluator(run, progress=False), perceptual_metric()
    behind = [v for v in views if facing(motion, v.frame, capture.camera(v)) > BEHIND]
    behind = [behind[i] for i in np.unique(np.linspace(0, len(behind) - 1, AT_MOST).round().astype(int))]
    rest = [v for v in views if v not in set(behind)][:: max(1, len(views) // AT_MOST)]
    back: dict[str, list[float]] = {"psnr": [], "blurred": [], "perceptual": []}
    sums = {key: 0.0 for key in ("unseen", "seen", "unseen_footage", "seen_footage", "unseen_n", "seen_n")}
    seen_error, seen_count, unseen_error = 0.0, 0, 0.0
    for view in [*behind, *rest]:
        color, alpha = capture.load(view)
        target = color + (1 - alpha[..., None])
        image = np.clip(evaluator.render(view, motion), 0, 1)
        unseen, seen = places.in_view(view, alpha)
        error = np.square(image - target).mean(-1)
        seen_error, seen_count = seen_error + error[seen].sum(), seen_count + int(seen.sum())
        if view not in set(behind):
            continue
        unseen_error += error[unseen].sum()
        back["psnr"].append(decibels(error.mean()))
        back["blurred"].append(decibels(np.square(blurred(image, BLUR) - blurred(target, BLUR)).mean()))
        one, other = (torch.from_numpy(p).permute(2, 0, 1)[None].float() for p in (image, target))
        back["perceptual"].append(float(metric(one, other)))
        drawn, filmed = fine(image, alpha), fine(target, alpha)
        for name, part in (("unseen", unseen), ("seen", seen)):
            sums[name] += drawn[part].sum()
            sums[f"{name}_footage"] += filmed[part].sum()
            sums[f"{name}_n"] += part.sum()
        if pictures is not None:
            dark = np.clip(on_black(evaluator, view, motion), 0, 1)
            row = np.concatenate([target, image, color, dark], 1)
            write_image(pictures / f"{view.camera}_{view.frame:06d}.png", row)
    count = {name: max(sums[f"{name}_n"], 1) for name in ("unseen", "seen")}
    ratio = (sums["unseen"] / count["unseen"]) / max(sums["seen"] / count["seen"], 1e-12)
    footage = (sums["unseen_footage"] / count["unseen"]) / max(sums["seen_footage"] / count["seen"], 1e-12)
    return {
        "views": len(behind),
        **{name: float(np.mean(values)) for name, values in back.items()},
        "unseen_psnr": decibels(unseen_error / count["unseen"]),
        "unseen_share": sums["unseen_n"] / max(sums["unseen_n"] + sums["seen_n"], 1),
        "energy": ratio,
        "energy_footage": footage,
        "seen_psnr": decibels(seen_error / max(seen_count, 1)),
    }


def on_black(evaluator: Evaluator, view: View, motion: Motion) -> np.ndarray:
    """(H, W, 3) the avatar on black."""
    scene = evaluator.scene([view], motion)
    with torch.no_grad():
        attributes, camera = evaluator._attributes(motion, view.frame), evaluator.run.capture.camera(view)
        image, _ = scene.draw(
            attributes, scene.motion([view.frame]), [camera], background=torch.zeros(3), pixel=evaluator.run.pixel
        )
    return image[0].permute(1, 2, 0).cpu().numpy()


def trained(capture: str, out: Path, seeds: list[int]) -> list[Path]:
    """The runs of one seed each, trained on the views of `train_front` as the lab page says."""
    places = []
    for seed in seeds:
        places.append(out / f"front_s{seed}")
        train(compose_config([f"capture={capture}", f"out={places[-1]}", f"seed={seed}", *TRAINING]), places[-1])
    return places


def table(rows: list[dict[str, Any]]) -> str:
    header = ["run", "stage", "behind", "blurred", "perceptual", "unseen", "energy", "footage", "seen"]
    keys = [("psnr", 2), ("blurred", 2), ("perceptual", 4), ("unseen_psnr", 2), ("energy", 3), ("energy_footage", 3),
            ("seen_psnr", 2)]  # fmt: skip
    return format_table(header, [[r["run"], str(r["stage"]), *(f"{r[k]:.{d}f}" for k, d in keys)] for r in rows])


@exit_cleanly
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", type=Path)
    parser.add_argument("--train", metavar="CAPTURE", help="train on its views of train_front first")
    parser.add_argument("--out", type=Path, default=Path("runs/unseen"), help="where to train (default: runs/unseen)")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--stages", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write pictures: footage, avatar, on white, black")
    arguments = parser.parse_args()
    register_configs()
    torch.set_num_threads(1)
    runs = arguments.runs + (trained(arguments.train, arguments.out, arguments.seeds) if arguments.train else [])
    rows = []
    for directory in runs:
        places = None
        for stage in arguments.stages:
            run = open_run(directory, stage)
            if run.capture.truth is None:
                raise UserError(f"{run.capture.path} has no true poses (body_truth.npz): nothing tells where a view is")
            places = places or Places(run)
            folder = arguments.pictures and arguments.pictures / f"{directory.name}_stage{stage}"
            rows.append({"run": directory.name, "stage": stage} | score(run, outside_training(run), places, folder))
            print(table(rows[-1:]), file=sys.stderr)
    if arguments.json:
        write_json(arguments.json, rows)
    print(table(rows))


if __name__ == "__main__":
    main()
