"""Is a capture fit to be trained on? Every fault with its file and field, not only the first."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from gavatar_runtime.errors import Faults, UserError

from ..registry import BODIES, CAPTURES, resolve, split_node
from .capture import Capture, View
from .meeting import apart


@dataclasses.dataclass
class CaptureCheck:
    """format: name of the layout. faults: sentences. capture: as opened, None when it could not be."""

    format: str
    faults: list[str]
    capture: Capture | None

    def summary(self) -> str:
        """A line a property: layout, body, frames, cameras with their sizes, views of each split."""
        capture = self.capture
        if capture is None:
            return f"{self.format} capture, which could not be opened"
        sizes = sorted({f"{c.width}x{c.height}" for c in capture.cameras.values()})
        moving = ", moving" if len({id(c) for c in capture.moving.values()}) > len(capture.cameras) else ""
        lines = [
            f"{self.format} capture '{capture.name}', body {capture.body_model}",
            f"  {len(capture.motion)} frames at {capture.motion.fps:g} a second, poses of "
            f"{capture.motion.poses.shape[1]} joints",
            f"  {len(capture.cameras)} cameras of {', '.join(sizes)}{moving}",
            *(f"  {split:<11}{len(views):>6} views" for split, views in capture.splits.items()),
        ]
        return "\n".join(lines)


def check_capture(path: Path, node: dict | None = None) -> CaptureCheck:
    """Open a capture and read every image and mask that its splits name.

    Found are: files that are missing or damaged, fields that are missing, misshaped or not finite, with the frames
    where they are, frames without pose, images and masks of another size than their camera, masks without a person, a
    body that stands clearly elsewhere than the masks' person. Of more than 20 faults of one kind the rest are counted.
    Raises UserError only when the folder is of no known layout.
    """
    path = Path(path)
    name, options = split_node(resolve(CAPTURES, node or {"name": CAPTURES.default}, path))
    faults, capture = Faults(collect=True), None
    capture = faults.of(CAPTURES.build(name, options).read, path, faults)
    if capture is not None:
        _check_images(capture, faults)
        body = BODIES.build(BODIES.having(shipped=True)[0]).data
        sentence = apart(capture.placed(body), body, capture.views("train"))
        faults.add(*[sentence] if sentence else [])
    return CaptureCheck(name, faults.sentences, capture)


def _check_images(capture: Capture, faults: Faults) -> None:
    missing = capture.missing()
    for folder in dict.fromkeys(path.parent for path in missing):
        lacking = [sentence for path, sentence in missing.items() if path.parent == folder]
        faults.add_all(lacking, f"files of {folder} are missing")

    def check(view: View) -> None:
        if {capture.image_path(view), capture.mask_path(view)} & missing.keys():
            return
        _, mask = capture.read(view)
        if not (mask > 127).any():
            raise UserError(f"{capture.mask_path(view)} shows no person: the mask of frame {view} is empty")

    faults.each(check, dict.fromkeys(view for views in capture.splits.values() for view in views), "views are faulty")
