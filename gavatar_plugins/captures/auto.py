"""The reader that looks for itself."""

from __future__ import annotations

from pathlib import Path

from gavatar.capture.capture import Capture
from gavatar.capture.opening import capture_format
from gavatar.registry import CAPTURES, NoOptions
from gavatar_runtime.errors import Faults


@CAPTURES.register("auto", summary="the first registered layout that recognises the folder")
class AutoCapture:
    """Asks every other reader."""

    signs = ""

    def __init__(self, config: NoOptions):
        self.config = config

    @staticmethod
    def recognises(path: Path) -> bool:
        """Never itself a match."""
        return False

    def read(self, path: Path, faults: Faults | None = None) -> Capture:
        """Open the capture; UserError when no layout fits."""
        return CAPTURES.build(capture_format(path)).read(path, faults)
