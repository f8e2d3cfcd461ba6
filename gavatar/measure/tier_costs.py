"""What a bundle says of the tiers that it holds, and which of them pay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.cpus import usable_cpus
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.tiers import player_tiers, stored_tiers
from gavatar_runtime.values.motion import Motion

from .choices import Choice
from .fidelity import compare, images
from .timing import machine, measure_speeds

SIZE = 512  # pixels, the side of the images that tiers are measured by
TIMED_FRAMES, TIMED_S = 40, 3.0
SAME_TIME, SAME_PSNR = 1.1, 0.5  # times, and dB, within which two tiers are alike
CAPTURE, MIXED = "capture", "mixed"  # sets of poses: of the capture, and beyond them


def describe_tiers(path: Path, poses: Mapping[str, np.ndarray], size: int = SIZE) -> list[dict[str, Any]]:
    """What the manifest says of each stored tier: its error against the full model on sets of poses (F, J, 3), CAPTURE
    and MIXED, and its cost on this machine in those of CAPTURE."""
    bundle = read_bundle(path)
    sets = {name: Motion(p, np.zeros((len(p), 3), np.float32), 30.0) for name, p in poses.items()}
    avatar, default = Avatar(bundle, tier=None), player_tiers().default
    cameras = {name: frame_motion(avatar, motion, size, size) for name, motion in sets.items()}

    def draw(tier: str) -> dict[str, list[np.ndarray]]:
        return {k: images(Choice(tier), bundle, m, range(len(m)), [cameras[k]] * len(m)) for k, m in sets.items()}

    tiers, motion = stored_tiers(bundle), sets[CAPTURE]
    many = motion.taken(np.resize(np.arange(len(motion)), TIMED_FRAMES))
    speeds = measure_speeds([Choice(tier) for tier in tiers], bundle, many, cameras[CAPTURE], budget_s=TIMED_S)
    full, described = draw(default), []
    for tier, speed in zip(tiers, speeds, strict=True):
        entry: dict[str, Any] = {"name": tier, "members": list(player_tiers()[tier].kind.members)}
        drawn = full if tier == default else draw(tier)
        for name in sets:
            likeness = compare(drawn[name], full[name])
            entry |= {f"psnr_{name}": round(likeness.psnr, 2), f"worst_psnr_{name}": round(likeness.worst_psnr, 2)}
        entry |= {"frame_ms": round(speed.median_ms, 2), "size": size, "cores": usable_cpus(), "machine": machine()}
        described.append(entry)
    return described


def on_front(tiers: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The descriptions of tiers that pay; the default one always stays.

    A tier does not pay where another is no slower and no farther from the full model, both on the capture's poses and
    on mixed ones: within SAME_TIME and SAME_PSNR, for times vary, and such differences are none to choose by. Of two
    that are alike in all the closer one stays.
    """
    qualities, default = (f"psnr_{CAPTURE}", f"psnr_{MIXED}"), player_tiers().default

    def beats(one: dict[str, Any], other: dict[str, Any]) -> bool:
        near = all(one[q] >= other[q] - SAME_PSNR for q in qualities)
        return near and one["frame_ms"] <= SAME_TIME * other["frame_ms"]

    kept: list[dict[str, Any]] = []
    for tier in sorted(tiers, key=lambda t: (t["name"] == default, sum(t[q] for q in qualities)), reverse=True):
        if not any(beats(other, tier) for other in kept):
            kept = [other for other in kept if other["name"] == default or not beats(tier, other)] + [tier]
    return [tier for tier in tiers if any(tier is other for other in kept)]
