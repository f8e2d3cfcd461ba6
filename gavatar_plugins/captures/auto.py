"""The reader that looks for itself."""

from __future__ import annotations

from pathlib import Path

from gavatar.build import open_capture
from gavatar.capture import Capture
from gavatar.registry import CAPTURES, NoOptions


@CAPTURES.register("auto", summary="the first registered layout that recognises the folder")
class AutoCapture:
    """Asks every other reader."""

    def __init__(self, config: NoOptions):
        self.config = config

    @staticmethod
    def recognises(path: Path) -> bool:
        """Never itself a match."""
        return False

    def read(self, path: Path) -> Capture:
        """Open the capture; UserError when no layout fits."""
        return open_capture(path)
