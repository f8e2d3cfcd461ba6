"""The viewer's page: the same controls as the web player's, before a server that draws."""

from __future__ import annotations

import functools

from ..motions import MOTIONS
from ..web.page import CONTROLS, page, script

VIEWER = ("pose.js", "motion.js", *CONTROLS, "drive.js", "remote.js")


@functools.cache
def viewer_page() -> bytes:
    """The whole page."""
    suffixes = sorted({suffix for component in MOTIONS for suffix in component.kind.suffixes})
    body = f"<script>\n(() => {{\n{script(VIEWER)}\nopenViewer();\n}})();\n</script>\n"
    return page(body, ",".join(suffixes)).encode()
