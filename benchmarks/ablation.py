r"""The paper's ablation on one capture: baseline, +opt (motion), +opt+dyn (pose encoder), for presets and seeds.

python benchmarks/ablation.py CAPTURE --presets paper,upstream,default --seeds 0,1 --gaussians 41516 --steps 1500/600 \
    --device cuda --jobs 4 --out runs/ablation --json ablation.json

Every run of one call has the same data, images, atlas and step counts; what differs is the preset, whether motion
is optimised, and stage 2. `+opt, as long` (--control) trains stage 1 for the steps of both stages: what dynamics add
beyond more training. Scores are of whole frames on white. Held-out frames are rendered with the true poses, and with
--fit apart with poses fitted to them, the avatar frozen. Runs are processes of their own, --jobs at a time. A run that
--out holds already, of the same settings, is not made again: a long table is made in pieces (--minutes) by giving the
same command until it says that all are done.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from gavatar.config import LevelConfig, check, compose_config
from gavatar.evaluation.joint_errors import motion_errors
from gavatar.evaluation.result import Evaluation
from gavatar.evaluation.scores import Evaluator, evaluate
from gavatar.registry import load_plugins
from gavatar.storage import write_image, write_json
from gavatar.text_table import format_table
from gavatar.training.preview import error_map
from gavatar.training.run import open_run, train
from gavatar_runtime.cpus import usable_cpus
from gavatar_runtime.errors import exit_cleanly
from gavatar_runtime.geometry.spacing import evenly_spaced

PRESETS = ("paper", "upstream", "default")
# of a capture without true poses: training frames with the poses of training, held-out ones with fitted poses
SPLITS_WITHOUT_TRUTH = ["train", "test", "novel_view"]
KINDS = {"baseline": {1: "baseline"}, "avatar": {1: "+opt", 2: "+opt+dyn"}, "control": {1: "+opt, as long"}}
VARIANTS = ["baseline", "+opt", "+opt, as long", "+opt+dyn"]
SPLITS = ["test", "novel_pose", "novel_view"]
ROWS = "rows.json"
UPSTREAM_STEPS = 11000  # of its stage 1; its warm-up of the scales takes 1000 of them


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="a capture with true poses, for example studio_male")
    parser.add_argument("--presets", default=",".join(PRESETS), help="experiments to compare (%(default)s)")
    parser.add_argument("--seeds", default="0", help="comma-separated (%(default)s)")
    parser.add_argument("--gaussians", type=int, help="of the last level; coarser levels shrink alike")
    parser.add_argument(
        "--image", type=float, default=1.0, help="factor on the images of every level and of the scores (%(default)s)"
    )
    parser.add_argument("--steps", help="S1/S2, of the two stages; by default the preset's own")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time (%(default)s)")
    parser.add_argument("--minutes", type=float, help="start no run after this long; what was left out is said")
    parser.add_argument("--fit", type=int, default=0, help="steps of fitting held-out poses, 0 for none (%(default)s)")
    parser.add_argument("--every", type=int, default=1, help="score each Nth view of a split (%(default)s)")
    parser.add_argument("--control", action="store_true", help="also `+opt, as long`")
    parser.add_argument("--no-perceptual", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("runs/ablation"), help="run directories (%(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="rows of preset, variant, split and seed")
    parser.add_argument(
        "--figure", type=Path, metavar="FILE", help="picture of the last preset's first seed (jpg, png)"
    )
    parser.add_argument("--picture-of", type=Path, metavar="RUN", help="only make --figure, of a finished run's stages")
    parser.add_argument("--one", nargs=3, metavar=("PRESET", "KIND", "SEED"), help=argparse.SUPPRESS)
    parser.add_argument("override", nargs="*", help="Hydra overrides for every run, for example decoder.scale_limit=2")
    args = parser.parse_intermixed_args(argv)
    args.capture = args.capture.absolute()
    return args


def overrides(args: argparse.Namespace, preset: str, kind: str, seed: str) -> list[str]:
    """The configuration of one run as Hydra overrides: the preset at this call's sizes and step counts."""
    base = [f"capture={args.capture}", f"experiment={preset}", *args.override]
    config = check(compose_config([*base, "out=unused"]))
    steps = [int(s) for s in args.steps.split("/")] if args.steps else [config.stage1.steps, config.stage2.steps]
    # upstream leaves motion optimisation to a switch: +opt is that switch thrown
    out = [*base, f"motion.enabled={str(kind != 'baseline').lower()}", f"seed={seed}", f"device={args.device}"]
    out += [f"out={run_directory(args, preset, kind, seed)}", "progress=false"]
    out += ["preview_every=1000000", "checkpoint_every=1000000", "dynamics=always"]  # stage 2 is scored, paying or not
    out += [f"stage1.steps={sum(steps) if kind == 'control' else steps[0]}"]
    out += [f"stage2.steps={steps[1] if kind == 'avatar' else 0}"]
    if config.decoder["name"] == "upstream":
        out.append(f"decoder.scale_warmup={max(1, round(config.decoder['scale_warmup'] * steps[0] / UPSTREAM_STEPS))}")
    for stage in ("stage1", "stage2"):
        levels = getattr(config, stage).levels
        points = [_points(level, levels[-1], args.gaussians) for level in levels]
        sized = [
            f"{{until: {x.until}, {number}, image: {x.image * args.image}}}"
            for x, number in zip(levels, points, strict=True)
        ]
        out.append(f"{stage}.levels=[{', '.join(sized)}]")
    return out


def _points(level: LevelConfig, last: LevelConfig, gaussians: int | None) -> str:
    """How many points a level has, as a setting, where the last one has `gaussians`, or its own number."""
    if gaussians is None:
        return f"uv: {level.uv}" if level.gaussians is None else f"gaussians: {level.gaussians}"
    share = (level.uv / last.uv) ** 2 if level.gaussians is None else level.gaussians / last.gaussians
    return f"gaussians: {max(1, round(share * gaussians))}"


def run_directory(args: argparse.Namespace, preset: str, kind: str, seed: str) -> Path:
    """Of the capture as well, so that tables of several captures share a folder."""
    return args.out / args.capture.name / f"{preset}_{kind}_{seed}"


def one(args: argparse.Namespace) -> None:
    """Train and score one run; its rows go to rows.json of its directory, its pictures beside them."""
    preset, kind, seed = args.one
    directory = run_directory(args, preset, kind, seed)
    trainer = train(compose_config(overrides(args, preset, kind, seed)), directory)
    rows = []
    for stage, variant in KINDS[kind].items():
        run = open_run(directory, stage)
        if args.image != 1:
            run.capture = run.capture.resized(args.image)
        for split, views in run.capture.splits.items():
            run.capture.splits[split] = views[:: args.every] if split != "train" else views
        device = trainer.scene.device
        result = evaluate(run, scored_splits(run.capture), args.fit, not args.no_perceptual, False, device)
        rows += _rows(result, preset, variant, seed, sum(trainer.record.seconds[n] for n in range(1, stage + 1)))
        _pictures(args, run, directory / "pictures" / variant.strip("+").replace("+", "_"), device)
    write_json(directory / ROWS, {"settings": settings(args, preset, kind, seed), "rows": rows})


def settings(args: argparse.Namespace, preset: str, kind: str, seed: str) -> list[str]:
    """All that the rows of a run depend on."""
    scored = [f"image={args.image}", f"fit={args.fit}", f"every={args.every}", f"perceptual={not args.no_perceptual}"]
    return [*overrides(args, preset, kind, seed), *scored]


def finished_rows(args: argparse.Namespace, preset: str, kind: str, seed: str) -> list[dict] | None:
    """The rows of a run that an earlier call finished with the same settings, else None."""
    try:
        known = json.loads((run_directory(args, preset, kind, seed) / ROWS).read_text(encoding="utf-8"))
        return known["rows"] if known["settings"] == settings(args, preset, kind, seed) else None
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _rows(result: Evaluation, preset: str, variant: str, seed: str, seconds: float) -> list[dict]:
    run = result.run
    frames = sorted({view.frame for view in run.capture.views("train")})
    after = (None, None)
    if run.capture.truth is not None:
        after = motion_errors(run.built, run.motion.motion(), run.capture.truth, frames)
    before = result.estimated_mpjpe_mm or (None, None)
    about = {"preset": preset, "variant": variant, "seed": int(seed), "gaussians": len(run.avatar.surface)}
    about |= {"train_seconds": round(seconds, 1), "perceptual_network": result.perceptual_name}
    for name, values in (("before", before), ("after", after)):
        about |= {f"train_mpjpe_{name}_mm": _rounded(values[0]), f"train_pa_mpjpe_{name}_mm": _rounded(values[1])}
    return [about | row.as_json() for row in result.rows]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


def scored_splits(capture) -> list[str]:
    """The splits that the capture has and that say something of it."""
    return [s for s in (SPLITS if capture.truth is not None else SPLITS_WITHOUT_TRUTH) if capture.splits.get(s)]


def pictured(capture) -> list:
    """A few views that show front, back, side and held-out motion."""
    views = [capture.splits[s] for s in SPLITS if capture.splits.get(s)]
    cameras = {view.camera: view for view in capture.splits.get("novel_view") or []}  # the last frame of each camera
    if "novel_pose" not in scored_splits(capture):
        seen, held_out = capture.views("train"), capture.splits.get("test") or []
        spread = [seen[i] for i in evenly_spaced(len(seen), 4)]
        return [*spread, *held_out[len(held_out) // 2 :][:1], *cameras.values()]
    return [
        views[0][len(views[0]) // 2],
        views[0][-1],
        capture.views("novel_pose")[len(views[1]) // 2],
        *cameras.values(),
    ]


def _pictures(args: argparse.Namespace, run, folder: Path, device) -> None:
    evaluator = Evaluator(run, progress=False, device=device)
    folder.mkdir(parents=True, exist_ok=True)
    motion = run.capture.truth
    if motion is None:
        motion = run.motion.motion()
        held_out = [view for view in pictured(run.capture) if view not in run.capture.views("train")]
        if held_out and args.fit:  # frames that training has seen keep its poses
            frames = sorted({view.frame for view in held_out} - {view.frame for view in run.capture.views("train")})
            fitted = evaluator.fit([view for view in held_out if view.frame in frames], args.fit) if frames else motion
            motion.poses[frames], motion.trans[frames] = fitted.poses[frames], fitted.trans[frames]
    for number, view in enumerate(pictured(run.capture)):
        color, alpha = run.capture.load(view)
        write_image(folder / f"{number}_target.png", color + (1 - alpha[..., None]))
        write_image(folder / f"{number}.png", evaluator.render(view, motion))


def figure(args: argparse.Namespace, preset: str, seed: str, path: Path) -> None:
    """Columns are views; rows are the footage, every variant, and the error of the first and the last of them."""
    cells = {}
    for variant, kind in {"baseline": "baseline", "opt": "avatar", "opt_dyn": "avatar"}.items():
        folder = run_directory(args, preset, kind, seed) / "pictures" / variant
        cells[variant] = [_read(p) for p in sorted(folder.glob("?.png"))]
        targets = [_read(p) for p in sorted(folder.glob("?_target.png"))]
    rows = [targets, *cells.values()]
    rows += [[error_map(t, r) for t, r in zip(targets, cells[v], strict=True)] for v in cells]
    boxes = [_person(target) for target in targets]
    picture = np.concatenate([np.concatenate([_cut(c, b) for c, b in zip(row, boxes, strict=True)], 1) for row in rows])
    write_image(path, picture)


def picture_of(args: argparse.Namespace) -> None:
    """--figure of one run: the footage, each finished stage, and their errors."""
    targets, renders = [], {}
    for stage in (1, 2):
        run = open_run(args.picture_of, stage, args.capture)
        evaluator = Evaluator(run, progress=False)
        views = pictured(run.capture)
        footage = [run.capture.load(view) for view in views]
        targets = [color + (1 - alpha[..., None]) for color, alpha in footage]
        motion = run.capture.truth or run.motion.motion()
        renders[stage] = [evaluator.render(view, motion) for view in views]
    errors = [[error_map(t, r) for t, r in zip(targets, row, strict=True)] for row in renders.values()]
    boxes = [_person(target) for target in targets]
    rows = [targets, *renders.values(), *errors]
    cells = [np.concatenate([_cut(c, b) for c, b in zip(row, boxes, strict=True)], 1) for row in rows]
    write_image(args.figure, np.concatenate(cells))


def _read(path: Path) -> np.ndarray:
    return cv2.imread(str(path))[..., ::-1].astype(np.float32) / 255


def _person(image: np.ndarray) -> tuple[int, int, int]:
    """The centre and side of a square about what is not white."""
    rows, columns = np.nonzero((image < 0.97).any(-1))
    side = int(1.1 * max(np.ptp(rows), np.ptp(columns)))
    return (rows.min() + rows.max()) // 2, (columns.min() + columns.max()) // 2, min(side, *image.shape[:2])


def _cut(image: np.ndarray, box: tuple[int, int, int], size: int = 256) -> np.ndarray:
    y, x, side = box
    top, left = (int(np.clip(c - side // 2, 0, n - side)) for c, n in ((y, image.shape[0]), (x, image.shape[1])))
    return cv2.resize(image[top : top + side, left : left + side], (size, size), interpolation=cv2.INTER_AREA)


def table(rows: list[dict]) -> str:
    """Mean and, over several seeds, the spread (largest minus smallest) of each preset, variant and split."""
    header = ["preset, variant", "split, poses", "PSNR", "spread", "SSIM", "perceptual", "worst", "MPJPE", "PA", "s"]
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault((row["preset"], row["variant"], row["split"], row["poses"]), []).append(row)

    def mean(group: list[dict], key: str, digits: int) -> str:
        values = [row[key] for row in group if row[key] is not None]
        return f"{np.mean(values):.{digits}f}" if values else "-"

    lines = []
    for (preset, variant, split, poses), group in groups.items():
        psnr = [row["psnr"] for row in group]
        numbers = [mean(group, k, d) for k, d in (("ssim", 4), ("perceptual", 4), ("worst_psnr", 2))]
        joints = [mean(group, k, 1) for k in ("train_mpjpe_after_mm", "train_pa_mpjpe_after_mm")]
        spread = f"{np.ptp(psnr):.2f}" if len(psnr) > 1 else "-"
        lines.append([f"{preset} {variant}", f"{split}, {poses}", f"{np.mean(psnr):.2f}", spread, *numbers, *joints,
                      mean(group, "train_seconds", 0)])  # fmt: skip
    return format_table(header, lines)


def launch(args: argparse.Namespace, argv: list[str], job: tuple[str, str, str], end: float) -> str | None:
    """Run one job in a process, unless an earlier call finished it; None when it went well, else one sentence."""
    if finished_rows(args, *job) is not None:
        return None
    if time.monotonic() > end:
        return "not started: --minutes were over"
    directory = run_directory(args, *job)
    directory.mkdir(parents=True, exist_ok=True)
    threads = str(max(1, usable_cpus() // args.jobs))
    environment = os.environ | {"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", threads)}
    with open(directory / "log.txt", "w", encoding="utf-8") as log:
        command = [sys.executable, __file__, *argv, "--one", *job]
        done = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, env=environment)
    if done.returncode:
        last = (directory / "log.txt").read_text(encoding="utf-8").strip().splitlines()[-1:]
        return f"failed ({done.returncode}): {' '.join(last)}"
    return None


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    argv = list(sys.argv[1:] if argv is None else argv)
    args = arguments(argv)
    if args.one:
        one(args)
        return 0
    load_plugins()
    if args.picture_of:
        args.figure = args.figure or args.picture_of / "stages.jpg"
        picture_of(args)
        return 0
    presets, seeds = args.presets.split(","), args.seeds.split(",")
    kinds = ["baseline", "avatar", *(["control"] if args.control else [])]
    jobs = [(preset, kind, seed) for seed in seeds for preset in presets for kind in sorted(kinds)]
    for job in jobs[: len(presets) * len(kinds)]:
        overrides(args, *job)  # a mistake is found before anything trains
    start = time.monotonic()
    end = start + 60 * args.minutes if args.minutes else float("inf")
    rows: list[dict] = []
    faults: dict[str, str] = {}

    def finish(job: tuple[str, str, str]) -> None:
        fault = launch(args, argv, job, end)
        if fault:
            faults["_".join(job)] = fault
        else:
            rows.extend(finished_rows(args, *job) or [])
        order = {name: i for i, name in enumerate([*presets, *VARIANTS, *SPLITS_WITHOUT_TRUTH, *SPLITS])}
        rows.sort(key=lambda r: (order[r["preset"]], order[r["variant"]], order[r["split"]], r["poses"], r["seed"]))
        print(f"{time.monotonic() - start:6.0f} s  {' '.join(job)}  {fault or 'done'}", flush=True)
        if args.json:
            about = {"arguments": argv, "seconds": round(time.monotonic() - start, 1), "left_out": faults}
            write_json(args.json, about | {"protocol": "whole frames on white, mean over views", "rows": rows})

    with ThreadPoolExecutor(args.jobs) as pool:
        list(pool.map(finish, jobs))
    print(table(rows))
    if args.figure and not {f"{presets[-1]}_{kind}_{seeds[0]}" for kind in ("baseline", "avatar")} & set(faults):
        figure(args, presets[-1], seeds[0], args.figure)
    return 1 if faults else 0


if __name__ == "__main__":
    main()
