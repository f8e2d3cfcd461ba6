"""An avatar as a web page: one .html that plays from a disk, or a folder for a web server and for pages of others."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from ..errors import UserError
from ..formats.files import atomic
from ..web.look import read_look
from ..web.page import folder_page, module, single_page, three_page
from ..web.web_data import Packed, pack
from .conversion import CONVERSIONS, Conversion, Request


def packed(request: Request, notes: list[str]) -> Packed:
    """What the request asks for as the player reads it."""
    look = read_look(request.avatar, request.tier)
    if request.gaussians is not None:
        look = look.thinned(request.gaussians)
    notes += look.notes
    return pack(look, request.motions)


@CONVERSIONS.register("html", summary="one page that plays in any browser, offline, from a disk or any web server")
class HtmlPage(Conversion):
    """Everything in one file; about a third larger than the folder's data."""

    suffixes = (".html", ".htm")

    def write(self, request: Request, path: Path) -> None:
        data = single_page(packed(request, self.notes))
        with atomic(path) as temporary:
            temporary.write_bytes(data)


@CONVERSIONS.register("web", summary="a folder for a web server: page, gavatar.js (an ES module) and avatar.bin")
class WebFolder(Conversion):
    """index.html, gavatar.js, avatar.bin, and three.html, which shows the avatar in a scene of three.js."""

    suffixes = ("/",)

    def write(self, request: Request, path: Path) -> None:
        files = {
            "index.html": folder_page(), "three.html": three_page(), "gavatar.js": module().encode(),
            "avatar.bin": packed(request, self.notes).to_bytes(),
        }  # fmt: skip
        if path.is_dir() and any(path.iterdir()) and not (path / "avatar.bin").is_file():
            raise UserError(f"{path} holds other files: give a folder that is empty, or not there yet")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            made = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
            for name, data in files.items():
                (made / name).write_bytes(data)
            _place(made, path)
        except OSError as error:
            raise UserError(f"{path} cannot be written: {error.strerror or error}") from error
        finally:
            if "made" in locals():
                shutil.rmtree(made, ignore_errors=True)


def _place(made: Path, path: Path) -> None:
    """Put the files of `made` where they belong, each whole; those of others that lie there are left alone."""
    path.mkdir(exist_ok=True)
    umask = os.umask(0)
    os.umask(umask)
    for file in sorted(made.iterdir()):
        os.chmod(file, 0o666 & ~umask)
        os.replace(file, path / file.name)
