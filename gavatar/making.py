"""From a clip to a page that plays, in one call; each step that is finished is not done again."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from gavatar_runtime.conversions import convert
from gavatar_runtime.errors import MissingFile, UserError
from gavatar_runtime.progress import chapter, duration
from gavatar_runtime.tiers import player_tiers

from .face import TrainedRun, open_capture, prepare, train
from .overrides import as_overrides
from .storage import atomic, write_json
from .training.preview import LIVE

ASKED = "make.json"  # what the folder's steps were asked for
PREVIEW_EVERY = 50  # steps: a new picture every ten seconds or so for who watches
EXPORTED = "exported.sha256"  # of the avatar that the bundle was made of


@dataclasses.dataclass(frozen=True)
class MadeAvatar:
    """What `make` wrote. page: the .html that plays; bundle: the .gavatar; run: the training; capture: its footage."""

    page: Path
    bundle: Path
    run: TrainedRun
    capture: Path

    def __str__(self) -> str:
        size = self.page.stat().st_size / 1e6
        return f"{self.page}: {size:.1f} MB, open it in a browser\n{self.bundle}: gavatar-view, gavatar-play"


def make(
    clip: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    preset: str = "default",
    settings: Mapping[str, Any] | None = None,
    say: Callable[[str], None] = print,
    progress: bool = True,
    **footage: Any,
) -> MadeAvatar:
    """Film, one call, a page that plays: prepare, train, export and convert, in the folder `out`.

    clip: a video or a folder of frames, or a capture that is prepared already. out: default the clip's name beside it.
    preset: of training. settings: of `gavatar-train`. say: is told each step. footage: options of `prepare`, such as
    height=1.72. A call that was interrupted goes on where it was when it is given again.
    Raises UserError for whatever the steps refuse, and where `out` holds what was made of something else.
    """
    clip = Path(clip)
    if not clip.exists():
        raise MissingFile(f"{clip} does not exist: give a video, a folder of frames or a capture")
    folder = Path(out) if out is not None else clip.with_suffix("") if clip.is_file() else Path(f"{clip}_avatar")
    _claim(folder, clip, {"preset": preset, "settings": sorted(as_overrides(dict(settings or {}))), "footage": footage})
    began = time.monotonic()
    with _step(1, "prepare: find the person and fit the body", say):
        capture = _prepared(clip, folder, footage, say, progress)
    with _step(2, f"train the avatar; to watch it: {folder / 'run' / 'previews' / LIVE}", say):
        how = {"progress": progress, "preview_every": PREVIEW_EVERY, **(settings or {})}
        run = train(capture, preset, out=folder / "run", **how)
    name = folder.resolve().name
    bundle, page = folder / f"{name}.gavatar", folder / f"{name}.html"
    with _step(3, "export to ONNX, verified against PyTorch", say):
        _exported(run, bundle, folder / EXPORTED, progress)
    with _step(4, "the page", say):
        if not page.exists() or page.stat().st_mtime < bundle.stat().st_mtime:
            for note in convert(bundle, page):
                say(f"note: {note}")
    say(f"took {duration(time.monotonic() - began)} in all")
    return MadeAvatar(page, bundle, run, capture)


@contextlib.contextmanager
def _step(number: int, sentence: str, say: Callable[[str], None]) -> Iterator[None]:
    """One of the four, said before it, its number before every bar inside it."""
    say(f"{number}/4  {sentence}")
    with chapter(f"{number}/4"):
        yield


def _exported(run: TrainedRun, bundle: Path, record: Path, progress: bool) -> None:
    """The bundle of a run, unless it was made of the same numbers before."""
    state = _digest(run)
    if not (bundle.exists() and record.exists() and record.read_text(encoding="utf-8") == state):
        run.export(bundle, tiers=player_tiers().having(linear=True) if run.dynamic else (), progress=progress)
        with atomic(record) as temporary:
            temporary.write_text(state, encoding="utf-8")


def _claim(folder: Path, clip: Path, asked: dict[str, Any]) -> None:
    """Write down what the folder is for; UserError where it is for something else already."""
    status = clip.resolve().stat()
    source = {"clip": str(clip.resolve()), "bytes": status.st_size if clip.is_file() else None}
    wanted = {**source, **{key: repr(value) if key == "footage" else value for key, value in asked.items()}}
    record = folder / ASKED
    if record.exists():
        former = json.loads(record.read_text(encoding="utf-8"))
        differs = [key for key in wanted if former.get(key) != wanted[key]]
        if differs:
            raise UserError(f"{folder} was made with another {differs[0]}: choose another folder, or remove this one")
    elif folder.is_dir() and any(folder.iterdir()):
        raise UserError(f"{folder} holds other files: choose a folder that is empty or not there yet")
    folder.mkdir(parents=True, exist_ok=True)
    write_json(record, wanted)


def _prepared(clip: Path, folder: Path, footage: dict[str, Any], say: Callable[[str], None], progress: bool) -> Path:
    """The capture of a clip, made unless it is there; a folder that is one already is taken as it is."""
    capture = folder / "capture"
    if (clip / "capture.json").is_file():
        return clip
    if not (capture / "capture.json").is_file():
        footage = {"name": folder.resolve().name} | footage
        say(str(prepare(clip, capture, say=say, progress=progress, **footage)))
    open_capture(capture)
    return capture


def _digest(run: TrainedRun) -> str:
    """Of the avatar's numbers: its files are written anew whenever a finished run is looked at."""
    digest = hashlib.sha256()
    for name, tensor in sorted(run.opened.avatar.state_dict().items()):
        digest.update(name.encode() + tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
