"""gavatar's own capture layout."""

from __future__ import annotations

from pathlib import Path

from gavatar.capture import Capture, read_capture
from gavatar.registry import CAPTURES, NoOptions


@CAPTURES.register("gavatar", summary="gavatar's own layout: capture.json, cameras.json, images/, masks/, body.npz")
class GavatarCapture:
    """Reads and recognises gavatar's own layout."""

    def __init__(self, config: NoOptions):
        self.config = config

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether the folder looks like this layout."""
        return (path / "capture.json").is_file()

    def read(self, path: Path) -> Capture:
        """Open the capture; UserError when malformed."""
        return read_capture(path)
