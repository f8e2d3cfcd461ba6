"""What is played: the part of a motion, how the person is looked at, and how the avatar is decoded."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any, Literal, cast

import numpy as np

from ..avatar.adaptive import AdaptiveAvatar
from ..avatar.played import PlayedAvatar
from ..avatar.playing import Avatar
from ..bundle import Bundle
from ..decoding.detail import WORTH, count_for_side, count_for_size
from ..errors import WrongValue, did_you_mean
from ..formats.camera_file import read_camera
from ..render.rasterizers import Rasterizer
from ..render.renderer import Renderer
from ..tiers import player_tiers
from ..values.camera import Camera
from ..values.motion import Motion
from .defaults import AUTO, COLORS, DEFAULT_FPS, DEFAULT_SIZE, MAX_SIZE
from .framing import DIRECTIONS, fitted_to, frame_motion, orbit, points_of_all, size_on_screen
from .grounding import grounded
from .selection import choose_tier


@dataclasses.dataclass(frozen=True)
class Clip:
    """The part of a motion that is played.

    fps: frames per second; None keeps the motion's own up to 30. seconds: play for so long: a shorter motion repeats, a
    longer one is cut. frames: of these at that rate only. ground: move it as a whole, so that the person stands on
    y = 0. Raises UserError for a number that is not positive.
    """

    fps: float | None = None
    seconds: float | None = None
    frames: slice | None = None
    ground: bool = False

    def __post_init__(self) -> None:
        _check_positive(fps=self.fps, seconds=self.seconds)

    def of(self, motion: Motion) -> Motion:
        """The motion resampled, then repeated or cut, then its frames. Raises UserError when none is left."""
        fps = self.fps or min(motion.fps, DEFAULT_FPS)
        motion = motion.resampled(fps)
        index = np.arange(len(motion))
        if self.seconds is not None:
            index = np.arange(max(1, round(self.seconds * fps))) % len(motion)
        if self.frames is not None:
            count, index = len(index), index[self.frames]
            if not len(index):
                raise WrongValue(
                    f"`frames` leaves no frame: motion '{motion.name}' has {count} at {fps:g} frames per second"
                )
        return motion.taken(index)

    def fitted(self, avatar: PlayedAvatar, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
        """The motion fitted to the avatar, on the floor if asked, and what moves in it that the body lacks."""
        motion, ignored = avatar.fit(motion)
        return grounded(avatar, motion)[0] if self.ground else motion, ignored


@dataclasses.dataclass(frozen=True)
class Shot:
    """How the person is looked at.

    size, width, height: pixels; what is not given is as long as what is, and 512 alone. camera: `front`, `left`,
    `back`, `right` or degrees from the front towards the person's left, far enough to hold the whole motion; a
    `Camera`, or FILE.json[:NAME] to read one, which keeps its own size unless another is given. orbit: seconds in which
    the camera circles the person once, True for once in the clip. background: sRGB in [0, 1], a colour's name, #rrggbb
    or `r,g,b`. rasterizer: what draws, by name or built already; rasterizer_options: of the one that is named.
    Raises UserError for what is none of these.
    """

    size: int | None = None
    width: int | None = None
    height: int | None = None
    camera: str | float | Camera = "front"
    orbit: float | bool | None = None
    background: str | Sequence[float] = "white"
    rasterizer: str | Rasterizer = AUTO
    rasterizer_options: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        _check_counts(MAX_SIZE, size=self.size, width=self.width, height=self.height)
        if self.circles and self.orbit is not True:
            _check_positive(orbit=self.orbit)
        self.color  # noqa: B018  # says what is wrong with it now

    @property
    def circles(self) -> bool:
        """Whether the camera goes round the person."""
        return self.orbit is not None and self.orbit is not False

    @property
    def color(self) -> tuple[float, float, float]:
        """The background as sRGB in [0, 1]."""
        return color_from(self.background)

    def cameras(
        self, avatar: PlayedAvatar, motion: Motion, beside: Sequence[tuple[PlayedAvatar, Motion]] = ()
    ) -> list[Camera]:
        """One camera a frame. motion: fitted to the avatar. beside: other avatars in the picture, each with its own."""
        width = self.width or self.size or self.height or DEFAULT_SIZE
        height = self.height or self.size or self.width or DEFAULT_SIZE
        camera = self._stored()
        if camera is None:
            azimuth = self._azimuth()
            camera = frame_motion(avatar, motion, width, height, azimuth=azimuth, orbit=self.circles, beside=beside)
        elif self.size or self.width or self.height:
            camera = fitted_to(camera, width, height)
        if self.orbit is None or self.orbit is False:
            return [camera] * len(motion)
        points = points_of_all([(avatar, motion), *beside])
        period = len(motion) if self.orbit is True else self.orbit * motion.fps
        return orbit(camera, (points.min(0) + points.max(0)) / 2, np.arange(len(motion)) / period)

    def renderer(self, avatar: PlayedAvatar, threads: int | None) -> Renderer:
        """What draws the avatar. threads: of a rasterizer that is not built yet, None for one a core."""
        threads = threads if isinstance(self.rasterizer, str) else None
        return Renderer(avatar, self.rasterizer, options=self.rasterizer_options, threads=threads)

    def _stored(self) -> Camera | None:
        if isinstance(self.camera, str) and ".json" in self.camera.lower():
            return read_camera(self.camera)
        return self.camera if isinstance(self.camera, Camera) else None

    def _azimuth(self) -> float:
        if isinstance(self.camera, str) and self.camera in DIRECTIONS:
            return DIRECTIONS[self.camera]
        try:
            value = float(cast("str | float", self.camera))
        except (TypeError, ValueError):
            value = math.nan
        if abs(value) <= 1e6:
            return value
        raise WrongValue(
            f"unknown camera '{self.camera}': give degrees, FILE.json[:NAME], or "
            f"{did_you_mean(str(self.camera), DIRECTIONS)}"
        )


@dataclasses.dataclass(frozen=True)
class Level:
    """How closely and how fast the avatar is decoded.

    tier: how, of those that the bundle holds; min_psnr, target_fps: choose one (`choose_tier`). budget_ms: keep frames
    within so many milliseconds by the level of detail and the reuse of decodes. gaussians: at most so many, each the
    larger, `auto` for as many as the person's size in the images is worth, None for all. seen_only: decode only what
    the camera can see. reuse: decode every so many frames only. threads: None for one a core. uv: `gaussians`, as the
    side of an atlas with so many texels on the body (`in_gaussians`).
    Raises UserError for numbers out of range and for what excludes each other.
    """

    tier: str | None = None
    min_psnr: float | None = None
    target_fps: float | None = None
    budget_ms: float | None = None
    gaussians: int | Literal["auto"] | None = None
    seen_only: bool = False
    reuse: int = 1
    threads: int | None = None
    uv: int | Literal["auto"] | None = None

    def __post_init__(self) -> None:
        _check_positive(min_psnr=self.min_psnr, target_fps=self.target_fps, budget_ms=self.budget_ms)
        _check_counts(None, reuse=self.reuse, threads=self.threads)
        for name, value in (("gaussians", self.gaussians), ("uv", self.uv)):
            if value != AUTO:
                _check_counts(None, **{name: cast("int | None", value)})
        if self.gaussians is not None and self.uv is not None:
            raise WrongValue("`gaussians` and `uv` both choose the level of detail: give one of them")
        if self.budget_ms and (self.gaussians or self.uv or self.reuse > 1 or self.seen_only):
            raise WrongValue(
                "`budget_ms` chooses the level of detail and the reuse: leave `gaussians`, `uv`, `reuse` and "
                "`seen_only` out"
            )

    def in_gaussians(self, bundle: Bundle) -> tuple[Level, str]:
        """The level with `gaussians` where it has `uv`, and a sentence that says how many these are, '' where it is as
        it was."""
        if self.uv is None:
            return self, ""
        if isinstance(self.uv, str):
            return dataclasses.replace(self, gaussians="auto", uv=None), ""
        count, note = gaussians_of_side(bundle, self.uv)
        return dataclasses.replace(self, gaussians=count, uv=None), note

    def open(self, bundle: Bundle, clip: Clip, view: Shot, motion: Motion) -> Avatar | AdaptiveAvatar:
        """The avatar at this level, for a motion that is played as clip and view say.

        The frame rate of the clip chooses a tier where nothing else does; not with reuse or seen_only, which need
        networks. Raises UserError for what the bundle cannot do.
        """
        tier = choose_tier(
            bundle,
            tier=self.tier,
            min_psnr=self.min_psnr,
            target_fps=self.target_fps,
            wished_fps=clip.fps if self.reuse == 1 and not self.seen_only else None,
        )
        if self.budget_ms:
            return AdaptiveAvatar(bundle, self.budget_ms / 1000, tier=tier, threads=self.threads)
        count = self.in_gaussians(bundle)[0].gaussians
        count = _count_on_screen(bundle, clip, view, motion) if isinstance(count, str) else count
        avatar = Avatar(
            bundle, tier=tier, gaussians=count, reuse=self.reuse, seen_only=self.seen_only, threads=self.threads
        )
        if self.seen_only and not avatar.seen_only:
            raise WrongValue(f"`seen_only`: {_why_not_seen_only(avatar, self.reuse)}")
        return avatar


def differing(options: Clip | Shot | Level) -> list[str]:
    """Which fields are not what they are by default."""
    values = {field.name: (getattr(options, field.name), field.default) for field in dataclasses.fields(options)}
    return [name for name, (value, default) in values.items() if type(value) is not type(default) or value != default]


def color_from(color: str | Sequence[float]) -> tuple[float, float, float]:
    """sRGB in [0, 1] of three numbers, a name, `#rrggbb` or `r,g,b`. Raises UserError."""
    values: Sequence[float] = ()
    if not isinstance(color, str):
        values = color
    elif color.lower() in COLORS:
        values = COLORS[color.lower()]
    elif re.fullmatch(r"#[0-9a-fA-F]{6}", color):
        values = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    else:
        with contextlib.suppress(ValueError):  # which is as wrong as too few numbers
            values = [float(part) for part in color.split(",")]
    if len(values) != 3 or not all(0 <= c <= 1 for c in values):
        raise WrongValue(f"`background={color}`: give {', '.join(COLORS)}, #rrggbb, or r,g,b between 0 and 1")
    return values[0], values[1], values[2]


def gaussians_of_side(bundle: Bundle, uv: int) -> tuple[int, str]:
    """How many Gaussians of a bundle a side of the atlas stands for, and a sentence that says so."""
    count = count_for_side(*bundle.surfaces(), uv)
    return count, f"`uv={uv}` is the former way to say `gaussians={count}`"


def _count_on_screen(bundle: Bundle, clip: Clip, view: Shot, motion: Motion) -> int | None:
    """As many Gaussians as the person's largest size in the images is worth."""
    body = Avatar(bundle, tier=None)
    motion, _ = clip.fitted(body, motion)
    count = count_for_size(body.surface, size_on_screen(body, motion, view.cameras(body, motion)))
    return count if count < WORTH * len(body) else None


def _why_not_seen_only(avatar: Avatar, reuse: int) -> str:
    if reuse > 1:
        return "decodes that are reused are of all Gaussians: leave `reuse` out"
    if avatar.tier is not None and player_tiers()[avatar.tier].kind.picks and avatar.dynamic:
        return f"{avatar.bundle.path} was written before that was possible: export it again"
    return f"tier {avatar.tier} has nothing to leave out: it is for tiers that run networks, of an avatar with dynamics"


def _check_positive(**values: float | None) -> None:
    for name, value in values.items():
        if value is not None and not (isinstance(value, Real) and 0 < value < 1e6):
            shown = f"{value:g}" if isinstance(value, Real) else value
            raise WrongValue(f"`{name}={shown}`: give a positive number")


def _check_counts(most: int | None, **values: int | None) -> None:
    for name, value in values.items():
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
            raise WrongValue(f"`{name}={value}`: give a whole number from 1 up")
        if most is not None and value > most:
            raise WrongValue(f"`{name}={value}`: at most {most}")
