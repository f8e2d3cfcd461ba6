"""Pages: the files of `deploy/web`, put together into one script or one file that asks no other host for anything."""

from __future__ import annotations

import base64
import functools
import importlib.resources
import json
import re
from collections.abc import Iterable, Sequence

from .web_data import Packed

FILES = "gavatar_runtime.browser"
# in the order of their imports, so that each stands after what it needs
PLAYER = ("pose.js", "motion.js", "data.js", "sorter.js", "splats.js", "avatar.js")
MOTION_FILES = ("bvh_file.js", "rig_names.js", "retarget.js", "motion_files.js")
CONTROLS = ("controls.js",)
PAGE = (*PLAYER, *MOTION_FILES, *CONTROLS, "engine.js", "page.js")
PUBLIC = (
    *("load", "Avatar", "Motion", "Skeleton", "Splats", "FileSource", "PageSource", "orbitCamera"),
    *("extent", "distanceFor", "readMotionFile", "Controls", "LocalEngine", "openPage"),
)
# nothing is loaded from anywhere but the page itself and, for the folder, the files beside it
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' blob:; style-src 'unsafe-inline'; img-src 'self' data: "
    "blob:; media-src 'self' blob:; worker-src blob:; connect-src 'self' blob: data:"
)
_IMPORT = re.compile(r"^import\b[^;]*;\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const|let)\b)", re.MULTILINE)


@functools.cache
def asset(name: str) -> str:
    """The text of a file of the player."""
    return importlib.resources.files(FILES).joinpath(name).read_text(encoding="utf-8")


def script(files: Iterable[str], exports: Sequence[str] = ()) -> str:
    """Modules in one scope: their imports of each other fall away. exports: the names that the whole exports."""
    text = "\n".join(_EXPORT.sub("", _IMPORT.sub("", asset(name))) for name in files)
    return text + (f"\nexport {{ {', '.join(exports)} }};\n" if exports else "")


def module() -> str:
    """`gavatar.js`, the player as one ES module."""
    return script(PAGE, PUBLIC)


def page(body: str, accept: str = ".npz,.bvh") -> str:
    """The page with `body` after its controls. accept: suffixes of motion files that may be added."""
    parts = {"policy": POLICY, "style": asset("page.css"), "accept": accept, "body": body}
    return re.sub(r"\{(policy|style|accept|body)\}", lambda found: parts[found[1]], asset("page.html"))


def single_page(packed: Packed) -> bytes:
    """One .html that plays from a disk or any host: script, header and blocks stand in it, and the first Gaussians show
    while the others are still being read."""
    header = json.dumps(packed.header, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    start = (
        f"<script>\nvar gavatar = (() => {{\n{script(PAGE)}\nreturn {{ {', '.join(PUBLIC)}, pageSource }};\n}})();\n"
        f"gavatar.source = gavatar.pageSource({header});\ngavatar.page = gavatar.openPage(gavatar.source);\n</script>\n"
    )
    blocks = (
        f'<script type="text/plain" id="block{k}">{base64.b64encode(block).decode()}</script>\n'
        f'<script>gavatar.source.arrived({k}, document.getElementById("block{k}"))</script>\n'
        for k, block in enumerate(packed.blocks)
    )
    return page(start + "".join(blocks)).encode()


def folder_page() -> bytes:
    """The page of a folder that has `gavatar.js` and `avatar.bin` beside it."""
    body = '<script type="module">\nimport { openPage } from "./gavatar.js";\nopenPage("avatar.bin");\n</script>\n'
    return page(body).encode()


def three_page() -> bytes:
    """The page that shows the avatar of its folder in a scene of three.js."""
    return asset("three.html").encode()
