"""From a video, or a folder of footage, to a capture that training reads: what `gavatar.prepare` and
`gavatar-prepare` do."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gavatar_runtime.errors import UserError

from ..registry import BODIES, load_plugins, split_node
from .detect import Detector
from .fit import FitOptions
from .fit_settings import FITTED_BETAS, LARGEST, MOST_FRAMES, check_numbers
from .footage_source import SourceOptions, open_source
from .initial import DEFAULT_FOV
from .pipeline import Quality, fit_and_write
from .write import CaptureFacts

PathLike = str | os.PathLike[str]


@dataclasses.dataclass(frozen=True)
class PreparedCapture:
    """A capture that was written. path: its folder. found: what the footage was taken to be. notes: what to know of
    it, one sentence each. quality: how well the body fits. It may be given wherever a path may."""

    path: Path
    found: str
    notes: tuple[str, ...]
    quality: Quality

    def __fspath__(self) -> str:
        return str(self.path)

    def __str__(self) -> str:
        picture = self.path / "preview.png"
        look = f"; look at {picture}" if picture.is_file() else ""
        return f"fit: {self.quality.sentence()}\nwrote {self.path}{look}"


def prepare(
    source: PathLike, out: PathLike, *, height: float | None = None, fps: float | None = None,
    frames: slice = slice(None), max_frames: int = MOST_FRAMES, size: int | None = None,
    landmarks: PathLike | None = None, masks: PathLike | None = None, cameras: PathLike | None = None,
    fov: float | None = None, refine_cameras: bool = False, holdout_camera: str | None = None,
    pose_network: PathLike | None = None, background: PathLike | None = None, matting_network: PathLike | None = None,
    body: str | Mapping[str, Any] | None = None, num_betas: int = FITTED_BETAS,
    name: str | None = None, license: str = "unknown", preview: bool = True, overwrite: bool = False,
    progress: bool = True, say: Callable[[str], None] = print,
) -> PreparedCapture:  # fmt: skip
    """Find the person in footage, fit the body, write the capture `out`.

    source: a video of one person, or a folder of footage, laid out as docs/guide/your_own_video.md says. height:
    the person's, metres. fps: of the footage, where it does not say. frames: which to take, else of a raw video
    every k-th so that at most `max_frames` remain. size: pixels of the images' longer side. landmarks, masks,
    cameras: where they are when not beside the footage. fov: of an unknown camera, degrees over the longer side
    (40). refine_cameras: calibrated principal points may move a little. holdout_camera: kept from training, for
    novel views. pose_network: another landmark network (ONNX). background: a picture of the room without anybody,
    of a camera that stands still. matting_network: a network of yours that makes the masks (ONNX,
    docs/guide/your_own_video.md says which). body: name, or a dict of `name` and its options, by default the one
    that comes with gavatar. num_betas: shape coefficients to fit. name, license: of the capture. preview: write
    preview.png and preview.mp4. overwrite: replace `out`. say: is told what was found and what to know of it.

    Raises UserError in one sentence, and leaves nothing at `out` then.
    """
    check_numbers({"fps": fps, "max_frames": max_frames, "size": size, "fov": fov, "height": height,
                   "num_betas": num_betas})  # fmt: skip
    source, out = Path(source), Path(out)
    if out.exists() and not overwrite:
        raise UserError(f"{out} exists: choose another folder, or let it be replaced with `overwrite`")
    load_plugins()
    body = body or BODIES.having(shipped=True)[0]
    fitted, options = split_node(dict(body) if isinstance(body, Mapping) else {"name": body})
    model = BODIES.build(fitted, options)  # before the footage, which takes long
    with tempfile.TemporaryDirectory(prefix="gavatar-masks-") as folder:
        opened = open_source(source, SourceOptions(
            landmarks=_path(landmarks), masks=_path(masks), cameras=_path(cameras), fps=fps, frames=frames, size=size,
            detector=Detector(Path(folder), _path(pose_network), progress, background=_path(background),
                              matting=_path(matting_network)), most_frames=max_frames, largest=LARGEST,
        ))  # fmt: skip
        for sentence in (f"found {opened.description}", *(f"note: {note}" for note in opened.notes)):
            say(sentence)
        if fov is not None and opened.footage[0].lens is not None:
            raise UserError("`fov` is for an unknown camera, but cameras.json calibrates it: leave one of them out")
        facts = CaptureFacts(
            name=name or out.resolve().name, license=license, source=f"gavatar-prepare {source.name}",
            body_model=BODIES.traits(fitted, options).capture_name or fitted, gender=options.get("gender", "neutral"),
            holdout_camera=holdout_camera,
        )  # fmt: skip
        quality = fit_and_write(
            opened, model.data, out, facts, fov=DEFAULT_FOV if fov is None else fov, overwrite=overwrite,
            options=FitOptions(stature=height, refine_cameras=refine_cameras, num_betas=num_betas), preview=preview,
            progress=progress,
        )  # fmt: skip
    for note in quality.notes:
        say(f"note: {note}")
    return PreparedCapture(out, opened.description, (*opened.notes, *quality.notes), quality)


def _path(path: PathLike | None) -> Path | None:
    return None if path is None else Path(path)
