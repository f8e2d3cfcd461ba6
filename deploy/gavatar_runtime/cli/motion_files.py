"""`gavatar-motion info|convert`: what a motion file holds, and the same motion in AMASS's layout. Loads no torch."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UserError, exit_cleanly, options_spelled, spelled

if TYPE_CHECKING:
    from ..values.motion import HandParameters, Motion

DESCRIPTION = "Describe a motion file or convert it to .npz with AMASS's fields, y-up, metres, SMPL joints."
EPILOG = """examples
  gavatar-motion info dance.bvh
  gavatar-motion convert dance.bvh -o dance.npz --fps 30
  gavatar-motion convert rig.bvh -o rig.npz --set mapping=rig.json
  gavatar-motion convert walk.npz -o walk_smpl.npz --joints smpl
  gavatar-motion convert walk.bvh -o walk.npz --rest first-frame --on anna.gavatar --ground
  gavatar-motion convert wham_output.pkl -o second.npz --set person=4 --set fps=25

Formats: .bvh; .npz, .npy, .pkl, .joblib, .pt, .pth and .json of AMASS, SMPL, SMPL-H, SMPL-X, AIST++, Motion-X, 3DPW and
of pose estimators; a folder of one file a frame; built-in names. docs/reference/motions.md has the table.
"""
SKELETONS = ("same", "body", "smpl", "smplh", "smplx")


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        "gavatar-motion", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = p.add_subparsers(dest="command", required=True, metavar="info|convert")
    info = commands.add_parser("info", help="describe a motion")
    convert = commands.add_parser("convert", help="write it as .npz")
    for command in (info, convert):
        command.add_argument("motion", metavar="NAME|FILE")
        command.add_argument("--set", action="append", default=[], metavar="KEY=VALUE",
                             help="an option of the format: up=z, fps=60, person=4, units=cm, mapping=FILE; as "
                             "motion.KEY=VALUE too")  # fmt: skip
        command.add_argument("--rest", choices=("auto", "offsets", "first-frame", "anatomy"),
                             help="of BVH: the pose that counts as standing at rest (default: auto)")  # fmt: skip
    info.add_argument("--json", action="store_true", help="print JSON")
    convert.add_argument("-o", "--out", metavar="FILE.npz", type=Path, required=True)
    convert.add_argument("--fps", type=float, help="resample to so many frames per second (slerp)")
    convert.add_argument("--joints", choices=SKELETONS, default="same", help="of the written file (default: same)")
    convert.add_argument("--on", metavar="AVATAR", help="for this avatar's body: its joints, its legs, its hand data")
    convert.add_argument("--ground", action="store_true", help="with --on: let the avatar stand on the floor, y = 0")
    convert.add_argument("--overwrite", action="store_true", help="replace FILE.npz if it exists")
    return p


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    from ..motions.source import motion_source
    from .settings import as_motion_options, parse_settings

    options = parse_settings([f"motion.{setting.removeprefix('motion.')}" for setting in arguments.set])["motion"]
    if arguments.rest:
        options["rest"] = arguments.rest
    with options_spelled(as_motion_options):
        source = motion_source(arguments.motion, **options)
        motion = source.load()
    motion = dataclasses.replace(motion, notes=tuple(spelled(note, as_motion_options) for note in motion.notes))
    if arguments.command == "info":
        values = {**describe(motion), "read_as": dict(source.facts), "notes": list(motion.notes)}
        print(json.dumps(values, indent=1) if arguments.json else _table(values))
        return 0
    for note in motion.notes:
        print(f"note: {note}")
    a = arguments
    return _convert(motion, a.out, fps=a.fps, joints=a.joints, avatar=a.on, ground=a.ground, overwrite=a.overwrite)


def describe(motion: Motion) -> dict[str, Any]:
    """Numbers of a motion: frames, fps, seconds, joints and their skeleton, which move, the way that it goes."""
    import numpy as np

    from ..geometry.rotations import matrix_from_axis_angle
    from ..values.skeletons import skeleton_of

    skeleton, names = skeleton_of(motion.poses.shape[1])
    moving = np.ptp(motion.poses, axis=0).max(-1) > 1e-4
    steps = np.linalg.norm(np.diff(motion.trans[:, [0, 2]], axis=0), axis=1)
    up = matrix_from_axis_angle(motion.poses[:, 0].astype(np.float64))[:, 1, 1]
    return {
        "name": motion.name,
        "frames": len(motion),
        "fps": round(float(motion.fps), 3),
        "seconds": round(len(motion) / motion.fps, 3),
        "joints": motion.poses.shape[1],
        "skeleton": skeleton,
        "joints_that_move": int(moving.sum()),
        "joints_at_rest": [n for j, n in enumerate(names) if not motion.poses[:, j].any()],
        "betas": 0 if motion.betas is None else len(motion.betas),
        "expression": 0 if motion.expression is None else motion.expression.shape[1],
        "hands": None if motion.hands is None else _hands(motion.hands),
        "walk_metres": round(float(steps.sum()), 3),
        "pelvis_height_metres": [round(float(v), 3) for v in (motion.trans[:, 1].min(), motion.trans[:, 1].max())],
        "upright": round(float(up.mean()), 3),
    }


def _hands(hands: HandParameters) -> str:
    kind = f"{hands.values.shape[2]} coefficients each" if hands.pca else "rotations"
    about = "mean" if hands.relative else "flat"
    return f"{kind} about the {about} hand, for bodies that have hand data"


def _table(values: dict[str, Any]) -> str:
    resting = values["joints_at_rest"]
    rest = ", ".join(resting[:6]) + (f" and {len(resting) - 6} more" if len(resting) > 6 else "") or "none"
    low, high = values["pelvis_height_metres"]
    return "\n".join(
        [
            f"{values['name']}: {values['frames']} frames at {values['fps']:g} a second, {values['seconds']:g} s",
            f"  joints     {values['joints']}, {values['skeleton']}; {values['joints_that_move']} move",
            f"  at rest    {rest}",
            f"  shape      {values['betas']} betas" if values["betas"] else "  shape      not given",
            *([f"  expression {values['expression']} coefficients"] if values["expression"] else []),
            *([f"  hands      {values['hands']}"] if values["hands"] else []),
            f"  walk       {values['walk_metres']:g} m over the floor; root between {low:g} and {high:g} m high",
            f"  upright    {values['upright']:.2f} on average (1 stands, 0 lies, -1 is upside down)",
            *(f"  {name:<10} {what}" for name, what in values["read_as"].items()),
            *(f"note: {note}" for note in values["notes"]),
        ]
    )


def _convert(
    motion: Motion, out: Path, *, fps: float | None, joints: str, avatar: str | None, ground: bool, overwrite: bool
) -> int:
    from ..motions.fitting import fit_motion
    from ..motions.motion_file import write_motion
    from ..values.skeletons import SKELETONS as NAMES

    if out.suffix.lower() != ".npz":
        raise UserError(f"{out}: the file that is written is an .npz: give it that suffix")
    if ground and not avatar:
        raise UserError("--ground needs --on AVATAR: how high a motion stands depends on the body")
    if avatar and joints != "same":
        raise UserError("--on says which joints are written: leave --joints out")
    if out.exists() and not overwrite:
        raise UserError(f"{out} exists: choose another name or replace it with --overwrite")
    if fps is not None:
        if not 0 < fps < 1e6:
            raise UserError(f"--fps {fps:g}: give a positive number of frames per second")
        motion = motion.resampled(fps)
    if avatar:
        motion = _on_avatar(motion, avatar, ground)
    elif joints != "same":
        # what no skeleton tells stays as it is: a body will
        kept: dict[str, Any] = {"expression": motion.expression, "hands": motion.hands}
        motion, ignored = fit_motion(dataclasses.replace(motion, expression=None, hands=None), NAMES[joints])
        motion = dataclasses.replace(motion, **kept)
        if ignored:
            print(f"note: {joints} has no {', '.join(ignored)}; the motion's are ignored")
    write_motion(out, motion)
    print(f"{out}: {len(motion)} frames at {motion.fps:g} a second, {motion.poses.shape[1]} joints, y-up, metres")
    return 0


def _on_avatar(motion: Motion, bundle: str, ground: bool) -> Motion:
    """The motion as the avatar of that bundle would play it. ground: standing on the floor."""
    from ..avatar.playing import Avatar
    from ..play.grounding import grounded

    avatar = Avatar(bundle)
    motion, ignored = avatar.fit(motion)
    if ignored:
        print(f"note: {avatar.name} has no {', '.join(ignored)}; the motion's are ignored")
    if ground:
        motion, lift = grounded(avatar, motion)
        print(f"note: moved {'up' if lift >= 0 else 'down'} by {abs(lift):.3f} m, on the floor")
    return motion


if __name__ == "__main__":
    main()
