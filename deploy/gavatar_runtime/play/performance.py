"""Playing an avatar from a motion into a file: what `gavatar-play` does, for programs."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

from ..avatar.adaptive import AdaptiveAvatar
from ..avatar.played import PlayedAvatar
from ..avatar.playing import Avatar
from ..bundle import Bundle, read_bundle
from ..errors import WrongValue, options_spelled, spelled
from ..motions import MOTIONS, read_motion
from ..motions.sequence import in_sequence
from ..render.choice import best_rasterizer, player_rasterizers
from ..render.rasterizers import Rasterizer
from ..render.renderer import Renderer
from ..values.camera import Camera
from ..values.motion import Motion
from .company import Companion, Place, abreast
from .defaults import AUTO, BLEND
from .outputs import FrameFormat, Output, default_output, find_output, open_output, output_called
from .player import Progress, Timings, play_gaussians, play_images
from .staging import Clip, Level, Shot, differing

Cast = list[tuple[PlayedAvatar, Motion]]  # the first avatar and its companions, each with its motion where it stands


@dataclasses.dataclass(frozen=True)
class PlayReport:
    """What was played.

    avatar, motion: their names. output: the path that was written. frames: that it holds. width, height: pixels, and
    rasterizer, the class that drew; None where nothing was drawn. gaussians: that were played, at full detail of an
    avatar that adapts. tier: how they were decoded. ignored_joints: what moves in the motion that the body lacks.
    notes: sentences for the user. ready_seconds: from the call to the first frame. timings: of each frame. budget_ms,
    levels: of an avatar that adapts (`AdaptiveAvatar.report`), else None and ().
    """

    avatar: str
    motion: str
    output: str
    frames: int
    width: int | None
    height: int | None
    fps: float
    gaussians: int
    tier: str | None
    rasterizer: str | None
    threads: int | None
    ignored_joints: tuple[str, ...]
    notes: tuple[str, ...]
    ready_seconds: float
    timings: Timings = dataclasses.field(repr=False)
    budget_ms: float | None = None
    levels: tuple[dict[str, Any], ...] = ()


def perform(
    avatar: str | os.PathLike | Bundle | PlayedAvatar,
    motion: str | Path | Motion | Sequence[str | Path | Motion] | None = None,
    out: str | os.PathLike | None = None,
    *,
    blend: float = BLEND, place: Place | None = None, beside: Sequence[Companion] = (),
    output: str | None = None, output_options: Mapping[str, Any] | None = None,
    fps: float | None = None, seconds: float | None = None, frames: slice | None = None, ground: bool = False,
    size: int | None = None, width: int | None = None, height: int | None = None,
    camera: str | float | Camera = "front", orbit: float | bool | None = None,
    background: str | Sequence[float] = "white",
    rasterizer: str | Rasterizer = AUTO, rasterizer_options: Mapping[str, Any] | None = None,
    tier: str | None = None, min_psnr: float | None = None, target_fps: float | None = None,
    budget_ms: float | None = None, gaussians: int | Literal["auto"] | None = None, seen_only: bool = False,
    reuse: int = 1, threads: int | None = None, uv: int | Literal["auto"] | None = None,
    progress: Progress | None = None, tell: Callable[[str], None] | None = None,
) -> PlayReport:  # fmt: skip
    """Play an avatar through a motion into a file.

    avatar: a bundle, its path, or an avatar, which is played as it was opened. motion: one, or the name or file of one,
    or several, played one after another with `blend` seconds from each to the next (`in_sequence`).
    place: where the person stands. beside: other avatars in the picture, each with a motion and a place.
    out: where to, the kind of output by its suffix (`find_output`); None is a video beside the bundle, or a folder of
    frames where no video can be written. output, output_options: the name of an output where the suffix alone does not
    tell, and options of its own (`open_output`).
    fps, seconds, frames, ground: which part of the motion (`Clip`). size, width, height, camera, orbit, background,
    rasterizer, rasterizer_options: how the person is looked at and drawn (`Shot`). tier, min_psnr, target_fps,
    budget_ms, gaussians, seen_only, reuse, threads, uv: how they are decoded (`Level`); where none of these chooses a
    tier, fps does.
    progress: called as `progress(done, total)` after each frame. tell: called with each note when it comes up.
    Raises UserError for whatever the caller can mend; no file is left behind then.
    """
    start = perf_counter()
    clip = Clip(fps, seconds, frames, ground)
    view = Shot(size, width, height, camera, orbit, background, rasterizer, rasterizer_options)
    level = Level(tier, min_psnr, target_fps, budget_ms, gaussians, seen_only, reuse, threads, uv)
    notes = _Notes(tell)
    read = _all_read(motion, notes)
    source = read_bundle(avatar) if isinstance(avatar, (str, os.PathLike)) else avatar
    level = _in_gaussians(level, source, notes)
    motion, lacking = _joined(source, read, blend)
    company = [_arriving(companion, blend, notes) for companion in beside]
    span = abreast(clip, [motion, *(its for _, its in company)]) if company else clip
    motion = span.of(motion)
    out = _default_path(source, motion, output, notes) if out is None else out
    drawn = _is_drawn(out, output, view, level, notes)
    played = _opened(source, clip, view, level, motion)
    motion, ignored = clip.fitted(played, motion)
    ignored = tuple(dict.fromkeys((*lacking, *ignored)))
    notes.add(f"the body has no {_listed(ignored)}; the motion's are ignored" if ignored else "")
    cast = [(played, (place or Place()).of(motion, played.joints[0]))]
    cast += [_entered(*one, its, span, clip, view, level) for one, its in zip(company, beside, strict=True)]
    opened = partial(open_output, out, name=output, options=output_options)
    ready = _images(cast, opened, view, threads) if drawn else _gaussians(cast, opened)
    seconds_to_ready = perf_counter() - start
    timings = ready.play(progress=progress)
    for note in ready.output.notes:
        notes.add(note)
    return _report(str(out), ready, cast, threads, ignored, tuple(notes.all), seconds_to_ready, timings)


def _in_gaussians(level: Level, source: Bundle | PlayedAvatar, notes: _Notes) -> Level:
    if not isinstance(source, Bundle):
        return level
    level, note = level.in_gaussians(source)
    notes.add(note)
    return level


def _all_read(motion: str | Path | Motion | Sequence[str | Path | Motion] | None, notes: _Notes) -> list[Motion]:
    if motion is None or isinstance(motion, (str, Path, Motion)):
        motion = [motion if isinstance(motion, Motion) else motion or MOTIONS.default]
    read = [one if isinstance(one, Motion) else _read(one) for one in motion or [MOTIONS.default]]
    for note in dict.fromkeys(note for one in read for note in one.notes):
        notes.add(note)
    return read


def _joined(source: Bundle | PlayedAvatar, motions: Sequence[Motion], blend: float) -> tuple[Motion, tuple[str, ...]]:
    """The one motion, as it is; or several as one of the avatar's body, and what moves in them that it lacks."""
    if len(motions) == 1:
        return motions[0], ()
    body = Avatar(source, tier=None) if isinstance(source, Bundle) else source
    fitted = [body.fit(motion) for motion in motions]
    return in_sequence([motion for motion, _ in fitted], blend), tuple(n for _, names in fitted for n in names)


def _arriving(companion: Companion, blend: float, notes: _Notes) -> tuple[Bundle | PlayedAvatar, Motion]:
    """What a companion comes with: the avatar, not opened yet, and its one motion."""
    read = _all_read(companion.motion, notes)
    source = companion.avatar
    source = read_bundle(source) if isinstance(source, (str, os.PathLike)) else source
    body = Avatar(source, tier=None) if isinstance(source, Bundle) else source
    fitted = [body.fit(motion) for motion in read]
    lacking = tuple(dict.fromkeys(name for _, names in fitted for name in names))
    notes.add(f"{body.name} has no {_listed(lacking)}; the motion's are ignored" if lacking else "")
    return source, in_sequence([motion for motion, _ in fitted], blend)


def _entered(
    source: Bundle | PlayedAvatar, motion: Motion, companion: Companion, span: Clip, clip: Clip, view: Shot,
    level: Level,
) -> tuple[PlayedAvatar, Motion]:  # fmt: skip
    """A companion as it plays, and its motion at its place."""
    motion = span.of(motion)
    if level.budget_ms or level.gaussians == AUTO:
        option = "`budget_ms`" if level.budget_ms else f"`gaussians={AUTO}`"
        raise WrongValue(f"{option} goes by what one avatar needs: leave it out where several are in the picture")
    if companion.tier:
        level = dataclasses.replace(level, tier=companion.tier, min_psnr=None, target_fps=None)
    played = level.open(source, clip, view, motion) if isinstance(source, Bundle) else source
    motion, _ = span.fitted(played, motion)
    return played, companion.place.of(motion, played.joints[0])


def _read(source: str | Path) -> Motion:
    """The motion; what is said of options is said of those of `read_motion`, for `perform` has an fps of its own."""

    def spelling(name: str, value: str) -> str:
        return f"`read_motion(..., {name}={value or '...'})`"

    with options_spelled(spelling):
        motion = read_motion(source)
    return dataclasses.replace(motion, notes=tuple(spelled(note, spelling) for note in motion.notes))


class _Notes:
    """Sentences for the user, told as they come up and kept; '' is none."""

    def __init__(self, tell: Callable[[str], None] | None):
        self.all: list[str] = []
        self._tell = tell

    def add(self, note: str) -> None:
        if not note:
            return
        self.all.append(note)
        if self._tell is not None:
            self._tell(note)


@dataclasses.dataclass(frozen=True)
class _Ready:
    """What is ready to be played: what does it, where to, and the class that draws, if any."""

    play: Callable[..., Timings]
    output: Output[Any]
    frames: FrameFormat
    rasterizer: str | None = None


def _images(cast: Cast, opened: Callable[[FrameFormat], Output[Any]], view: Shot, threads: int | None) -> _Ready:
    (avatar, motion), *others = cast
    cameras = view.cameras(avatar, motion, others)
    renderer = view.renderer(avatar, threads)
    beside = [(Renderer(other, renderer.rasterizer), its) for other, its in others]
    frames = FrameFormat(motion.fps, cameras[0].width, cameras[0].height, view.color)
    output = opened(frames)
    play = partial(play_images, renderer, motion, cameras, output, background=view.color, beside=beside)
    return _Ready(play, output, frames, type(renderer.rasterizer).__name__)


def _gaussians(cast: Cast, opened: Callable[[FrameFormat], Output[Any]]) -> _Ready:
    (avatar, motion), *others = cast
    frames = FrameFormat(motion.fps, pixel=avatar.pixel)
    output = opened(frames)
    return _Ready(partial(play_gaussians, avatar, motion, output, beside=others), output, frames)


def _report(
    out: str,
    ready: _Ready,
    cast: Cast,
    threads: int | None,
    ignored: tuple[str, ...],
    notes: tuple[str, ...],
    seconds_to_ready: float,
    timings: Timings,
) -> PlayReport:
    avatar, motion = cast[0]
    adaptive = avatar if isinstance(avatar, AdaptiveAvatar) else None
    return PlayReport(
        avatar=", ".join(one.name for one, _ in cast),
        motion=", ".join(its.name for _, its in cast),
        output=out,
        frames=len(timings),
        width=ready.frames.width or None,
        height=ready.frames.height or None,
        fps=motion.fps,
        gaussians=sum(len(one) for one, _ in cast),
        tier=avatar.tier,
        rasterizer=ready.rasterizer,
        threads=threads,
        ignored_joints=ignored,
        notes=notes,
        ready_seconds=seconds_to_ready,
        timings=timings,
        budget_ms=1000 * adaptive.budget_s if adaptive else None,
        levels=tuple(adaptive.report()) if adaptive else (),
    )


def _opened(source: Bundle | PlayedAvatar, clip: Clip, view: Shot, level: Level, motion: Motion) -> PlayedAvatar:
    if isinstance(source, Bundle):
        return level.open(source, clip, view, motion)
    given = [name for name in differing(level) if name != "threads"]
    if given:
        raise WrongValue(
            f"the avatar is open already, by tier {source.tier}: leave {_options(given)} out, or give its bundle"
        )
    return source


def _default_path(source: Bundle | PlayedAvatar, motion: Motion, output: str | None, notes: _Notes) -> str:
    """A name beside the bundle, for the output of that name or the default one."""
    path = Path(source.path if isinstance(source, Bundle) else source.bundle.path).resolve()
    name = f"{path.parent / path.stem}_{motion.name}"
    if output is not None:
        return name + next(iter(output_called(output).suffixes), "")
    chosen, preferred = default_output()
    place = name + output_called(chosen.name).suffixes[0]
    if chosen is not preferred:
        notes.add(f"{place} is {chosen.summary}: {preferred.summary} {preferred.missing()}")
    return place


def _slower_rasterizer() -> str:
    """A note where `auto` is not the rasterizer that is preferred, '' where it is."""
    traits = {component.name: component.default_traits for component in player_rasterizers()}
    preference = {name: 0 if known is None else known.preference for name, known in traits.items()}
    preferred = player_rasterizers()[max(preference, key=preference.__getitem__)]
    why, drawn_by = preferred.missing(), best_rasterizer()
    return f"rasterizer {drawn_by}, for {preferred.name} ({preferred.summary}) is missing: {why}" if why else ""


def _is_drawn(out: str | os.PathLike, output: str | None, view: Shot, level: Level, notes: _Notes) -> bool:
    """Whether that output takes pictures; what there is to note of it either way."""
    if find_output(out, output).wants != "image":
        _check_undrawn(out, view, level, notes)
        return False
    if view.rasterizer == AUTO:
        notes.add(_slower_rasterizer())
    return True


def _check_undrawn(out: str | os.PathLike, view: Shot, level: Level, notes: _Notes) -> None:
    """Note what an output of Gaussians makes no use of; UserError for what would decode for a camera."""
    if level.seen_only or level.gaussians == AUTO:
        option = "`seen_only`" if level.seen_only else f"`gaussians={AUTO}`"
        raise WrongValue(f"{option} goes by what a camera sees, and {out} takes all Gaussians: leave it out")
    unused = list(dict.fromkeys(name.removesuffix("_options") for name in differing(view)))
    if unused:
        notes.add(f"{out} takes the Gaussians, which nothing draws: {_options(unused)} had no use")


def _options(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
