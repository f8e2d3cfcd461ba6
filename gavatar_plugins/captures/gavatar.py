"""gavatar's own capture layout."""

from __future__ import annotations

from pathlib import Path

from gavatar.capture.capture import Capture, read_capture
from gavatar.protocols import CaptureReader
from gavatar.registry import CAPTURES, NoOptions
from gavatar_runtime.errors import Faults


@CAPTURES.register("gavatar", summary="gavatar's own layout: capture.json, cameras.json, images/, masks/, body.npz")
class GavatarCapture(CaptureReader):
    """Reads and recognises gavatar's own layout."""

    signs = "capture.json"

    def __init__(self, config: NoOptions):
        self.config = config

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether the folder looks like this layout."""
        return (path / "capture.json").is_file()

    def read(self, path: Path, faults: Faults | None = None) -> Capture:
        """Open the capture; UserError when malformed, after all faults were collected if `faults` does."""
        return read_capture(path, faults)
