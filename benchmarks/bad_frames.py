"""Does motion optimisation help the frames that are badly wrong, and never hurt the others?

    python benchmarks/bad_frames.py CAPTURE --json bad_frames.json

Plants gross errors in a capture's estimated motion, trains stage 1 on it, and compares every training frame's error
before and after, with and without the guard (`motion.guard`); `motion.mend=0` leaves them unmended. The errors: a tenth
of the frames with four joints turned by 30 degrees each; one frame in a hundred, two at least, with left and right
limbs exchanged; four frames in a row whose root jumps 20 cm aside. Frames are dealt out by the seed; no frame gets two.
Error of a frame: mean distance of its 22 joints from their true places in the world, mm.
"""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path

import numpy as np

from gavatar.body.skeleton import SMPL_BODY_JOINTS
from gavatar.capture.opening import open_capture
from gavatar.config import compose_config
from gavatar.evaluation.joint_errors import joints_of
from gavatar.registry import load_plugins
from gavatar.storage import write_json
from gavatar.text_table import format_table
from gavatar.training.remedies.acceptance import refuse_worse_poses
from gavatar.training.remedies.outliers import other_side
from gavatar.training.run import train
from gavatar_runtime.errors import exit_cleanly
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.values.skeletons import BODY

TURN, JUMP = np.radians(30.0), 0.2  # radians, metres
TURNED, JUMPING = 4, 4  # joints of a turned frame; frames of the jump


def dealt(frames: list[int], seed: int) -> dict[str, list[int]]:
    """Which of the training frames get which error: `turned`, `swapped`, `jump`, and `none`."""
    random = np.random.default_rng(seed)
    start = int(random.integers(len(frames) - JUMPING))
    jump = frames[start : start + JUMPING]
    rest = [f for f in frames if f not in jump]
    shuffled = [int(f) for f in random.permutation(rest)]
    swapped = max(2, round(len(frames) / 100))
    turned = round(len(frames) / 10)
    groups = {"turned": shuffled[:turned], "swapped": shuffled[turned : turned + swapped], "jump": jump}
    return groups | {"none": shuffled[turned + swapped :]}


def spoilt(arrays: dict[str, np.ndarray], groups: dict[str, list[int]], seed: int) -> dict[str, np.ndarray]:
    """The arrays of a body.npz with the errors planted."""
    random = np.random.default_rng([seed, 1])
    poses = arrays["poses"].reshape(len(arrays["poses"]), -1, 3).astype(np.float64)
    trans = arrays["trans"].copy()
    for frame in groups["turned"]:
        for joint in random.choice(np.arange(1, SMPL_BODY_JOINTS), TURNED, replace=False):
            axis = random.normal(size=3)
            turn = matrix_from_axis_angle(TURN * axis / np.linalg.norm(axis))
            poses[frame, joint] = axis_angle_from_matrix(matrix_from_axis_angle(poses[frame, joint]) @ turn)
    names = list(BODY)
    other = [names.index(other_side(name, names)) for name in names]
    for frame in groups["swapped"]:
        limbs = slice(1, SMPL_BODY_JOINTS)
        poses[frame, limbs] = (poses[frame, other] * [1, -1, -1])[limbs]  # mirrored: x is to the person's left
    trans[groups["jump"], 0] += JUMP
    return arrays | {"poses": poses.reshape(arrays["poses"].shape).astype(np.float32), "trans": trans}


def plant(source: Path, folder: Path, seed: int) -> dict[str, list[int]]:
    """Write `source`'s capture to `folder` with the errors planted, its images by link; returns who got which."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for entry in source.resolve().iterdir():
        if entry.name != "body.npz":
            os.symlink(entry, folder / entry.name)
    frames = sorted({view.frame for view in open_capture(source).views("train")})
    groups = dealt(frames, seed)
    with np.load(source / "body.npz") as file:
        np.savez(folder / "body.npz", **spoilt(dict(file), groups, seed))
    return groups


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="a capture in our layout with true poses, for example studio_male")
    parser.add_argument("--seed", type=int, default=0, help="of the errors and of the training (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("runs/bad_frames"), help="(%(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("override", nargs="*", help="Hydra overrides, after those of experiment=demo encoder=none")
    args = parser.parse_intermixed_args(argv)
    load_plugins()
    groups = plant(args.capture, args.out / "capture", args.seed)
    base = [f"capture={args.out / 'capture'}", "experiment=demo", "encoder=none", "overwrite=true", "progress=false"]
    base += [f"out={args.out / 'run'}", f"seed={args.seed}", "motion.guard=false"]
    trainer = train(compose_config([*base, *args.override]), args.out / "run")
    scene, capture = trainer.scene, trainer.capture
    frames = sorted(frame for group in groups.values() for frame in group)
    truth = joints_of(scene.built, capture.truth, frames)

    def errors(motion) -> np.ndarray:
        joints = joints_of(scene.built, motion, frames) - truth
        return 1000 * np.linalg.norm(joints[:, :SMPL_BODY_JOINTS], axis=-1).mean(1)

    before, after = errors(capture.motion), errors(scene.motion.motion())
    refused = refuse_worse_poses(scene, trainer.plans[0].image)
    guarded = errors(scene.motion.motion())
    rows = []
    for name, members in groups.items():
        at = np.isin(frames, members)
        row = {"group": name, "frames": int(at.sum()), "before_mm": round(float(before[at].mean()), 1)}
        for state, error in (("after", after), ("guarded", guarded)):
            row[f"{state}_mm"] = round(float(error[at].mean()), 1)
            row[f"{state}_worst_mm"] = round(float(error[at].max()), 1)
            row[f"worse_{state}"] = int((error[at] > before[at]).sum())
        row["refused"] = len(set(refused) & set(members))
        rows.append(row)
    print(format_table(list(rows[0]), [[str(value) for value in row.values()] for row in rows]))
    if args.json:
        write_json(args.json, rows)
    return 0


if __name__ == "__main__":
    main()
