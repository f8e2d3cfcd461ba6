"""`gavatar-view NAME.gavatar`: a page that shows an avatar, drawn by this machine. Loads no torch."""

from __future__ import annotations

import argparse
import os
import sys
import threading
import webbrowser

from ..errors import exit_cleanly, options_spelled
from .play_arguments import detail
from .settings import as_flags, as_settings, parse_options

DESCRIPTION = "Look at an avatar in a browser: turn it, play its motions, drop motion files on it. Nothing to install."
EPILOG = """examples
  gavatar-view anna.gavatar
  gavatar-view anna.gavatar --motion dance.npz,wave
  gavatar-view anna.gavatar --drive 0                     the avatar does as you do before webcam 0
  gavatar-view anna.gavatar --drive 0 --set fov=65        a camera that sees more of the room
  gavatar-view anna.gavatar --port 8000 --no-browser      on another machine; from yours:
                                                           ssh -L 8000:127.0.0.1:8000 THAT_MACHINE
The page is served to this machine alone, at the address that is printed. --host opens it to others, who need the
whole address: it has a token. End it with Ctrl+C.
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        "gavatar-view", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("avatar", metavar="NAME.gavatar", help="bundle that gavatar-export wrote, zipped or unpacked")
    p.add_argument("--motion", metavar="NAME,FILE", default="", help="more motions; the first plays")
    p.add_argument("--tier", metavar="NAME", help="how it is decoded at the start (default: the first that it holds)")
    p.add_argument("--gaussians", type=detail, metavar="N|auto", help="at most so many at the start, or auto: "
                   "as many as the footage's pixels are worth (default: all)")  # fmt: skip
    p.add_argument("--drive", metavar="CAMERA", help="a webcam by its number, or a video: it does as that person")
    p.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="an option of the driver "
                   "(gavatar-list driver): fov=65, degrees that the camera sees over its longer side")  # fmt: skip
    p.add_argument("--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1, this machine alone)")
    p.add_argument("--port", type=int, default=0, help="port to listen on (default: any that is free)")
    p.add_argument("--no-browser", action="store_true", help="only print the address")
    p.add_argument("--threads", type=int, metavar="N", help="CPU threads (default: all cores)")
    return p


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    from ..bundle import read_bundle
    from ..live.drivers import build_driver
    from ..live.sources import source_to_drive
    from ..motions import motions_named
    from ..view.drive import Drive
    from ..view.server import Viewer
    from ..view.viewed_avatar import ViewedAvatar

    with options_spelled(as_flags(vars(arguments))):
        bundle, motions = read_bundle(arguments.avatar), motions_named(arguments.motion)
        scene = ViewedAvatar(
            bundle, motions, tier=arguments.tier, gaussians=arguments.gaussians, threads=arguments.threads
        )
        source = None if arguments.drive is None else source_to_drive(arguments.drive)
        with options_spelled(as_settings("")):
            driver = build_driver(parse_options(arguments.set)) if arguments.set else None
        scene.drive = Drive(scene.body, source, driver)
        viewer = Viewer(scene, arguments.host, arguments.port)
    with viewer:
        print(f"{scene.bundle.manifest.name}: {viewer.address}", flush=True)
        if not arguments.no_browser and not _opened(viewer.address):
            print("note: no browser could be started: open the address yourself", file=sys.stderr)
        try:
            while not threading.Event().wait(1.0):  # without an end Ctrl+C would not be heard on Windows
                pass
        except KeyboardInterrupt:
            print()
        finally:
            scene.drive.close()
    return 0


def _opened(address: str) -> bool:
    """Whether a browser was started; one of text would take the terminal, and shows no pictures."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    return webbrowser.open(address)


if __name__ == "__main__":
    main()
