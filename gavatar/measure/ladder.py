"""What each way of playing an avatar costs and gains on this machine: the ladder from full networks to a still look."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import Bundle, read_bundle
from gavatar_runtime.decoding.detail import count_for_size
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.play.framing import frame_motion, size_on_screen
from gavatar_runtime.tiers import members_read, stored_tiers
from gavatar_runtime.values.motion import Motion

from ..capture.capture import Capture
from .choices import Choice, default_choices
from .fidelity import QUALITY_FRAMES, Likeness, Perceptual, compare, held_out, images
from .timing import Footprint, Speed, measure_process, measure_speeds


@dataclasses.dataclass(frozen=True)
class Row:
    """What one choice measured. bundle_mb: members that the tier reads. full, footage: likeness to the full model and
    to held-out footage. dominated: another choice is both faster and closer to the full model."""

    choice: Choice
    gaussians: int
    width: int
    height: int
    bundle_mb: float
    speed: Speed
    full: Likeness
    footage: Likeness | None = None
    process: Footprint | None = None
    dominated: bool = False

    def as_json(self) -> dict[str, Any]:
        """Every number by name, None where it was not measured, floats to four digits."""
        values = {"gaussians": self.gaussians, "width": self.width, "height": self.height, "fps": self.speed.fps}
        values |= dataclasses.asdict(self.speed)
        for name, likeness in (("full", self.full), ("footage", self.footage)):
            found = _numbers(Likeness, likeness)
            values |= {f"{key}_vs_{name}": value for key, value in found.items()}
        values |= {**_numbers(Footprint, self.process), "bundle_mb": self.bundle_mb, "dominated": self.dominated}
        return self.choice.as_json() | {k: round(v, 4) if isinstance(v, float) else v for k, v in values.items()}


def _numbers(kind: type[Likeness | Footprint], measured: Likeness | Footprint | None) -> dict[str, Any]:
    """Its numbers by name, None each where it was not measured."""
    names = [field.name for field in dataclasses.fields(kind)]
    return {name: None if measured is None else getattr(measured, name) for name in names}


def tier_bytes(bundle: Bundle, tier: str) -> int:
    """Size of the members that a tier reads."""
    read = members_read(bundle.manifest.members, stored_tiers(bundle), [tier])
    return sum(len(bundle.read(member)) for member in read)


def dominated(speeds: Sequence[float], closeness: Sequence[float]) -> list[bool]:
    """Of choices by frames a second and dB from the full model: which another beats or equals in both."""
    values = list(zip(speeds, closeness, strict=True))
    return [any(other[0] >= mine[0] and other[1] >= mine[1] and other != mine for other in values) for mine in values]


def run_ladder(
    path: Path,
    motion: Motion,
    width: int,
    height: int,
    *,
    capture: Capture | None = None,
    choices: Sequence[Choice] | None = None,
    perceptual: Perceptual | None = None,
    processes: bool = True,
    threads: int | None = None,
    say: Callable[[str], object] = lambda text: None,
) -> list[Row]:
    """Measure every choice, by default those of the bundle's ladder. motion: fitted to the avatar. capture: whose
    held-out footage choices are held against too. processes: also measure new processes of `gavatar-play`."""
    bundle = read_bundle(path)
    avatar = Avatar(bundle, tier=None)
    camera = frame_motion(avatar, motion, width, height)
    if choices is None:
        enough = count_for_size(avatar.surface, size_on_screen(avatar, motion, [camera] * len(motion)))
        choices = default_choices(bundle, enough)
    frames = evenly_spaced(len(motion), QUALITY_FRAMES).tolist()
    full = images(Choice(), bundle, motion, frames, [camera] * len(frames))
    footage = None if capture is None else held_out(capture, lambda motion: avatar.fit(motion)[0])
    rows = []
    for choice, speed in zip(choices, measure_speeds(choices, bundle, motion, camera, threads=threads), strict=True):
        ours = images(choice, bundle, motion, frames, [camera] * len(frames))
        filmed = None
        if footage is not None:
            drawn = images(choice, bundle, footage.motion, footage.frames, footage.cameras)
            filmed = compare(drawn, footage.targets, perceptual)
        row = Row(
            choice,
            len(Avatar(bundle, tier=None, gaussians=choice.gaussians)),
            width,
            height,
            tier_bytes(bundle, choice.tier) / 1e6,
            speed,
            compare(ours, full, perceptual),
            filmed,
            measure_process(choice, path, width, height, speed) if processes else None,
        )
        say(f"{choice.label}: {speed.fps:.1f} frames per second, {row.full.psnr:.1f} dB against full")
        rows.append(row)
    beaten = dominated([row.speed.fps for row in rows], [row.full.psnr for row in rows])
    return [dataclasses.replace(row, dominated=is_beaten) for row, is_beaten in zip(rows, beaten, strict=True)]
