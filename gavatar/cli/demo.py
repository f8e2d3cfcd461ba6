"""`gavatar-demo`: from the embedded capture to a playing avatar, in minutes on two CPU cores."""

from __future__ import annotations

import argparse
from pathlib import Path

from gavatar_runtime.errors import UserError, exit_cleanly

from ..optional import requires_extra

DESCRIPTION = """Train, evaluate, export and play an avatar of the capture that comes with gavatar (synthetic, CC0):
a person turning and moving before one camera, with estimated poses that are off by 52 mm."""
EPILOG = """Writes wave.mp4, turn.mp4, summary.png, summary.json, studio_demo.gavatar, avatar.html (for a browser)
and the run directories.
A demo that was interrupted goes on where it was. Any setting of gavatar-train may be added, for example:
  gavatar-demo --out quick stage1.steps=100 stage2.steps=20
"""


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "gavatar-demo", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", default="gavatar_demo", metavar="DIR", help="where to write (default: gavatar_demo)")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="gavatar-train settings for all trainings")
    return parser


@exit_cleanly
@requires_extra("train")
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    for override in arguments.overrides:
        if "=" not in override:
            raise UserError(f"'{override}' is not a setting: write KEY=VALUE, or --out DIR for the folder")
    from ..config import register_configs
    from ..demo import demo_capture, run_demo, screen
    from ..overrides import check_overrides

    register_configs()
    check_overrides([f"capture={demo_capture()}", "experiment=demo", *arguments.overrides])
    print(screen(run_demo(Path(arguments.out), arguments.overrides)))
    return 0
