"""Which stored tier to play, from the error and the cost that were measured for each, and how many Gaussians of it."""

from __future__ import annotations

from typing import Any

from ..bundle import Bundle
from ..decoding.detail import count_for_footage
from ..errors import UserError, WrongValue
from ..tiers import player_tiers, stored_tiers
from ..values.surface import Surface
from .defaults import AUTO

NEEDED = {"name", "frame_ms", "psnr_capture", "worst_psnr_capture"}  # of what the manifest says of a tier


def choose_tier(
    bundle: Bundle,
    *,
    tier: str | None = None,
    min_psnr: float | None = None,
    target_fps: float | None = None,
    wished_fps: float | None = None,
) -> str:
    """`tier`, or the one that the others pick, else `full`.

    min_psnr: dB, the fastest of those whose worst frame on the capture's poses was that close to the full model.
    target_fps: the closest of those that are fast enough, by the frame times of the manifest, measured where it was
    exported. wished_fps: likewise, without target_fps, but no condition: else the fastest; and nothing where the bundle
    does not say how fast its tiers are.
    Raises UserError for a tier beside these, for a bundle without figures and for a condition that no tier meets.
    """
    if tier and (min_psnr or target_fps):
        raise WrongValue("`tier` names a tier, and `min_psnr` and `target_fps` choose one: give one or the other")
    if tier:
        return tier
    measured = [t for t in bundle.manifest.tiers if isinstance(t, dict) and set(t) >= NEEDED]
    wish = wished_fps if measured else None
    if not (min_psnr or target_fps or wish):
        return player_tiers().default
    if not measured:
        raise UserError(
            f"{bundle.path} holds no measured tiers ({', '.join(stored_tiers(bundle))} only); export it with "
            "--tiers auto"
        )
    default = player_tiers().default
    fits = [t for t in measured if not min_psnr or t["name"] == default or t["worst_psnr_capture"] >= min_psnr]
    fastest = min(fits, key=lambda t: t["frame_ms"])
    rate = target_fps or wish
    fast = [t for t in fits if rate and 1000 / t["frame_ms"] >= rate]
    if target_fps and not fast:
        raise UserError(
            f"no stored tier of {bundle.path} plays at {target_fps:g} frames per second within those limits: the "
            f"fastest is {fastest['name']} at {1000 / fastest['frame_ms']:.0f}"
        )
    return _name(max(fast, key=lambda t: (t["psnr_capture"], -t["frame_ms"])) if fast else fastest)


def _name(described: dict[str, Any]) -> str:
    return str(described["name"])


def wanted_count(gaussians: int | str, surface: Surface, pixel: float | None) -> int:
    """How many Gaussians `gaussians` asks for: a number, or `auto` for as many as the footage's pixels were worth.
    pixel: metres that one of these spanned, None where that is not known. Raises WrongValue for anything else."""
    if isinstance(gaussians, int) and gaussians >= 1:
        return gaussians
    if gaussians != AUTO:
        raise WrongValue(f"`gaussians={gaussians}`: give a whole number from 1 up, or {AUTO}")
    return count_for_footage(surface, pixel)
