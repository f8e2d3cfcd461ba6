"""`gavatar-eval RUN`: image and joint errors per split, as a table, JSON and a figure; `--all DIR` of many runs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gavatar_runtime.errors import UserError, exit_cleanly

from ..optional import requires_extra

if TYPE_CHECKING:
    from ..evaluation.result import Evaluation

DESCRIPTION = "Evaluate a trained run: PSNR, SSIM, perceptual distance and joint errors per split."
EPILOG = """examples
  gavatar-eval runs/anna
  gavatar-eval runs/anna --splits novel_pose --no-fit
  gavatar-eval runs/anna --stage 1 --out eval_static
  gavatar-eval --all runs                      every run in a folder, in one table

Images are compared whole, composited on white, at the capture's size. The column `poses` says which poses were
rendered: `refined` by training, `true` from the capture's ground truth, `estimated` as given in body.npz, `fitted` to
the very images they are scored on (avatar frozen): never compare fitted rows with rows that are not.
A run of two stages is told whether its dynamics gain what they cost on the frames held out of training.
Writes evaluation.json and evaluation.png; with --all these into each run, and DIR/comparison.csv, .json and .html, a
page with pictures. With --all, a run that was evaluated before in the same way is read and not measured again, so that
a killed command continues, and jobs on other machines can evaluate their own runs; --again measures all.
"""


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "gavatar-eval", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", metavar="RUN", help="run directory that gavatar-train wrote, or a folder of them")
    parser.add_argument("--all", action="store_true", help="evaluate every run in the folder, however deep")
    parser.add_argument("--again", action="store_true", help="with --all: measure what was measured before, too")
    parser.add_argument("--stage", type=int, choices=(1, 2), help="avatar of this stage (default: the last trained)")
    parser.add_argument("--splits", nargs="+", metavar="SPLIT", help="splits to score (default: all of the capture)")
    parser.add_argument("--capture", metavar="DIR", help="where the capture is now, if it has moved")
    parser.add_argument("--no-fit", action="store_true", help="skip the rows with fitted poses, which take longest")
    parser.add_argument("--fit-steps", type=int, default=60, metavar="N", help="steps of pose fitting (default: 60)")
    parser.add_argument("--no-perceptual", action="store_true", help="leave the perceptual distance out")
    parser.add_argument("--rasterizer", metavar="NAME", help="rasterizer to draw with (default: the run's)")
    parser.add_argument("--out", metavar="DIR", help="where to write evaluation.json and .png (default: the run)")
    return parser


def evaluate_one(
    directory: Path, out: Path, *, stage: int | None = None, capture: str | None = None, **how: Any
) -> Evaluation:
    """Evaluate a run and write evaluation.json and .png to `out`. how: keywords of `TrainedRun.evaluate`."""
    from ..evaluation.comparison import preview_of
    from ..evaluation.comparison_page import write_preview
    from ..evaluation.evaluation_figure import evaluation_figure
    from ..evaluation.former import MEASURED, what_is_measured
    from ..face import open_run
    from ..storage import write_json

    measured = what_is_measured(directory, stage, how)
    result = open_run(directory, stage, capture).evaluate(**how)
    evaluation_figure(result, out / "evaluation.png")
    for row, (target, render) in zip(result.rows, result.pictures, strict=True):
        write_preview(preview_of(out, row.as_json()), target, render)
    write_json(out / "evaluation.json", result.as_json() | {MEASURED: measured})  # last: it stands for all of them
    return result


def evaluate_all(folder: Path, out: Path | None, *, again: bool = False, **how: Any) -> int:
    """Evaluate every run in a folder; those that cannot be are named, and the rest go on. 2 when there are such. out:
    where to write instead of beside each run. again: also what was evaluated in the same way before. how: keywords of
    `evaluate_one`."""
    from ..evaluation.comparison import Comparison, runs_in
    from ..evaluation.comparison_page import job_faults
    from ..evaluation.former import former_evaluation

    together, comparison, failures, read = out or folder, Comparison(), [], 0
    for directory in runs_in(folder):
        name = directory.relative_to(folder).as_posix()
        place = directory if out is None else out / name
        try:
            former = None if again else former_evaluation(directory, place, how)
            read += former is not None
            if former is None:
                print(f"evaluating {directory}", file=sys.stderr)
            comparison.add(name, former or evaluate_one(directory, place, **how).as_json(), place)
        except UserError as error:
            failures.append((name, str(error)))
    if read:
        print(f"{read} runs were evaluated before: read, not measured again (--again measures them)", file=sys.stderr)
    if comparison.rows:
        comparison.write_csv(together / "comparison.csv")
        comparison.write_json(together / "comparison.json")
        known = {name for name, _ in failures} | {row["run"] for row in comparison.rows}
        lost = [(name, why) for name, why in job_faults(folder) if name not in known]
        comparison.write_html(together / "comparison.html", f"Runs in {folder}", [*failures, *lost])
        print(comparison)
        print(f"\nwrote {together / 'comparison.csv'}, .json and .html")
    for name, sentence in failures:
        print(f"error: {folder / name}: {sentence}", file=sys.stderr)
    return 2 if failures else 0


@exit_cleanly
@requires_extra("train")
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    if arguments.fit_steps < 1:
        raise UserError("--fit-steps must be at least 1; leave fitting out with --no-fit")
    how = dict(
        stage=arguments.stage,
        splits=arguments.splits,
        fit_steps=0 if arguments.no_fit else arguments.fit_steps,
        perceptual=not arguments.no_perceptual,
        rasterizer=arguments.rasterizer,
    )
    if arguments.all:
        if arguments.capture is not None:
            raise UserError("--capture is of one run: leave it out with --all")
        return evaluate_all(
            Path(arguments.run), Path(arguments.out) if arguments.out else None, again=arguments.again, **how
        )
    out = Path(arguments.out or arguments.run)
    result = evaluate_one(Path(arguments.run), out, capture=arguments.capture, **how)
    print(result)
    print(f"\nwrote {out / 'evaluation.json'} and {out / 'evaluation.png'}")
    return 0


if __name__ == "__main__":
    main()
