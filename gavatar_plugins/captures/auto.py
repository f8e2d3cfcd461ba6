"""The reader that looks for itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gavatar.capture.capture import Capture
from gavatar.capture.opening import capture_format
from gavatar.protocols import CaptureReader
from gavatar.registry import CAPTURES, CaptureTraits, NoOptions
from gavatar_runtime.errors import Faults


@CAPTURES.register(
    "auto",
    summary="the first registered layout that recognises the folder",
    traits=CaptureTraits(chooses=True),
    default=True,
)
class AutoCapture(CaptureReader):
    """Asks every other reader."""

    signs = ""

    def __init__(self, config: NoOptions):
        self.config = config

    @staticmethod
    def recognises(path: Path) -> bool:
        """Never itself a match."""
        return False

    @staticmethod
    def choose(config: NoOptions, path: Path) -> dict[str, Any]:
        """The node of the layout that the folder has; UserError when it is missing or of no known one."""
        return {"name": capture_format(path)}

    def read(self, path: Path, faults: Faults | None = None) -> Capture:
        """Open the capture; UserError when no layout fits."""
        return CAPTURES.build(capture_format(path)).read(path, faults)
