"""Other processes of Python, which see this checkout."""

from __future__ import annotations

import os

from places import ROOT


def child_environment(**more: str) -> dict[str, str]:
    """This process's environment with the checkout in front of the path, and `more`."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "deploy"), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path, **more}
