"""`gavatar-prepare SOURCE -o CAPTURE`: a video, or footage with landmarks and masks -> a capture with a fitted body."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

from gavatar_runtime.cli.settings import as_flags
from gavatar_runtime.errors import UserError, exit_cleanly, options_spelled, spelled

from ..optional import requires_extra
from ..preparation.fit_settings import FITTED_BETAS, LARGEST, MOST_FRAMES

DESCRIPTION = "Find the person in a video, fit the body, write a capture that gavatar-train reads."
EPILOG = """SOURCE is a video of one person before a camera that stands still, or a folder that holds one of
  frames/*.png (or one video)  masks/NAME.png  landmarks.npz            one camera that need not be known
  videos/CAM.mp4  masks/CAM/NAME.png  landmarks_CAM.npz  cameras.json   several calibrated cameras

Without landmarks and masks the person is found by MediaPipe's pose networks, which come with the package; of several
people the largest is followed. What you have may be given in files.

landmarks.npz holds MediaPipe's 33 points: image (T, 33, 4) x, y in pixels, z, visibility; world (T, 33, 4) in metres;
fps. Points that were not seen have visibility 0. It may hold hands too: left_hand, right_hand (T, 21, 3) x, y in
pixels, confidence, or wholebody (T, 133, 3) in COCO-WholeBody's order.

examples
  gavatar-prepare clip.mp4 -o captures/anna --height 1.72
  gavatar-prepare footage/anna -o captures/anna --license "my own"
  gavatar-prepare lab -o captures/lab --size 960 --frames 0:100:2 --holdout-camera cam04

  gavatar-prepare --check captures/anna

Look at CAPTURE/preview.png and preview.mp4 before training: the body's left half is blue, its right half orange, the
mask's outline green.
"""


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "gavatar-prepare", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", metavar="SOURCE", type=Path, help="folder of footage, or a video")
    parser.add_argument("-o", "--out", metavar="CAPTURE", type=Path, help="folder to write")
    parser.add_argument("--check", action="store_true", help="SOURCE is a capture, of any layout that gavatar reads: "
                        "name everything that is wrong with it and write nothing")  # fmt: skip
    parser.add_argument("--landmarks", metavar="FILE", type=Path, help="landmarks .npz (several cameras: their folder)")
    parser.add_argument("--masks", metavar="DIR", type=Path, help="folder of masks (default: SOURCE/masks)")
    parser.add_argument(
        "--cameras", metavar="FILE", type=Path, help="calibrated cameras (default: SOURCE/cameras.json)"
    )
    parser.add_argument("--fps", type=float, help="frame rate of the footage (default: what it says)")
    parser.add_argument(
        "--frames", metavar="A:B:STEP", default="::", help="frames to take, as in Python (default: all)"
    )
    parser.add_argument("--max-frames", type=int, default=MOST_FRAMES, metavar="N", help="of raw video take every k-th "
                        "frame so that at most N remain, unless --frames (default: %(default)s)")  # fmt: skip
    parser.add_argument("--size", type=int, metavar="N", help="make the images' longer side N pixels (default: as they "
                        f"are; raw video at most {LARGEST})")  # fmt: skip
    parser.add_argument("--holdout-camera", metavar="CAM", help="keep this camera's images from training, to test "
                        "novel views (the body is fitted to all cameras)")  # fmt: skip
    parser.add_argument("--fov", type=float, metavar="DEG", help="field of view of an unknown camera over the longer "
                        "side, degrees (default: 40)")  # fmt: skip
    parser.add_argument("--refine-cameras", action="store_true",
                        help="let calibrated principal points move a little, where the cameras disagree")  # fmt: skip
    parser.add_argument("--height", type=float, metavar="M", help="the person's height in metres, if known")
    parser.add_argument("--pose-network", metavar="FILE", type=Path, help="another landmark network with the inputs "
                        "and outputs of MediaPipe's (ONNX); the package brings its 'full' one")  # fmt: skip
    parser.add_argument("--background", metavar="FILE", type=Path, help="picture of the room without anybody, of a "
                        "camera that stands still (default: learnt from the footage where it can be)")  # fmt: skip
    parser.add_argument("--matting-network", metavar="FILE", type=Path, help="a network of yours that makes the masks "
                        "(ONNX, as MODNet's: docs/guide/your_own_video.md)")  # fmt: skip
    parser.add_argument("--body", metavar="NAME", help="body to fit: free (default), or smpl, smplh, "
                        "smplx from your own files (docs/reference/bodies.md)")  # fmt: skip
    parser.add_argument("--body-path", metavar="PATH", help="model file of --body, or the folder to look in before "
                        "those of $GAVATAR_BODY_MODELS")  # fmt: skip
    parser.add_argument("--gender", choices=("neutral", "male", "female"), help="of --body's model (default: neutral)")
    parser.add_argument("--num-betas", type=int, default=FITTED_BETAS, metavar="N", help="shape coefficients to fit "
                        "(default: %(default)s)")  # fmt: skip
    parser.add_argument("--name", help="name of the capture (default: the folder's)")
    parser.add_argument("--license", default="unknown", help="licence of the footage (default: unknown)")
    parser.add_argument("--preview", action=argparse.BooleanOptionalAction, default=True,
                        help="write preview.png and preview.mp4 of the body over the footage")  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="replace CAPTURE if it exists")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    return parser


def _slice(text: str) -> slice:
    try:
        parts = [int(part) if part else None for part in text.split(":")]
        if len(parts) not in (2, 3) or (len(parts) == 3 and parts[2] is not None and parts[2] < 1):
            raise ValueError
    except ValueError:
        raise UserError(f"--frames {text}: give A:B or A:B:STEP with a step of at least 1, such as 0:100:2") from None
    return slice(*parts)


def _body(name: str | None, **options: str | None) -> dict[str, Any]:
    """The body as one value: its name and the options that were given, path and gender."""
    from ..registry import BODIES, load_plugins

    load_plugins()
    options = {key: value for key, value in options.items() if value is not None}
    name = name or BODIES.having(shipped=True)[0]
    takes = {field.name for field in dataclasses.fields(BODIES[name].config)}
    if not takes.issuperset(options):
        raise UserError(
            f"--body-path and --gender are for the official bodies, not for '{name}': give --body smpl, smplh or smplx "
            "too"
        )
    return {"name": name, **options}


def check(path: Path) -> int:
    """Print what a capture holds and what is wrong with it; 2 when anything is."""
    from ..capture.check import check_capture
    from ..registry import load_plugins

    load_plugins()
    found = check_capture(path)
    print(found.summary())
    for fault in found.faults:
        print(f"fault: {fault}")
    print(f"{len(found.faults)} faults" if found.faults else "nothing is wrong with it")
    return 2 if found.faults else 0


@exit_cleanly
@requires_extra("train")
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    if arguments.check:
        return check(arguments.source)
    if arguments.out is None:
        raise UserError("give the folder to write by -o CAPTURE, or --check to look at a capture")
    from ..preparation.from_footage import prepare

    named = ("height", "fps", "max_frames", "size", "landmarks", "masks", "cameras", "fov", "refine_cameras",
             "holdout_camera", "pose_network", "background", "matting_network", "num_betas", "name", "license",
             "preview", "overwrite")  # fmt: skip
    options = {name: value for name, value in vars(arguments).items() if name in named}
    frames = _slice(arguments.frames)
    body = _body(arguments.body, path=arguments.body_path, gender=arguments.gender)
    flags = as_flags(vars(arguments))
    with options_spelled(flags):
        print(prepare(arguments.source, arguments.out, frames=frames, body=body, progress=not arguments.quiet,
                      say=lambda sentence: print(spelled(sentence, flags)), **options))  # fmt: skip
    return 0


if __name__ == "__main__":
    main()
