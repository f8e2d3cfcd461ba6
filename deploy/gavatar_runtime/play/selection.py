"""Which stored tier to play, from the error and the cost that were measured for each."""

from __future__ import annotations

import argparse

from ..bundle import Bundle
from ..errors import UserError
from ..tiers import player_tiers, stored_tiers

NEEDED = {"name", "frame_ms", "psnr_capture", "worst_psnr_capture"}  # of what the manifest says of a tier


def choose_tier(bundle: Bundle, arguments: argparse.Namespace) -> str:
    """The tier of `--tier`, or the one that `--min-psnr`, `--target-fps` and `--fps` pick, else `full`.

    min_psnr: the fastest of those whose worst frame on the capture's poses was that close to the full model.
    target_fps: the closest of those that are fast enough, by the frame times of the manifest, measured where it was
    exported. fps: likewise, without target_fps, but a wish: else the fastest, for the video has that rate at any speed;
    and not where the bundle says nothing of its tiers, nor with --reuse or --seen-only, which need networks.
    Raises UserError for --tier beside these, for a bundle without figures and for a wish that no stored tier grants.
    """
    if arguments.tier and (arguments.min_psnr or arguments.target_fps):
        raise UserError("--tier names a tier and --min-psnr and --target-fps choose one: give one or the other")
    if arguments.tier:
        return arguments.tier
    tiers = [t for t in bundle.manifest.tiers if isinstance(t, dict) and set(t) >= NEEDED]
    wish = arguments.fps if tiers and arguments.reuse == 1 and not arguments.seen_only else None
    if not (arguments.min_psnr or arguments.target_fps or wish):
        return player_tiers().default
    if not tiers:
        raise UserError(
            f"{bundle.path} holds no measured tiers ({', '.join(stored_tiers(bundle))} only); export it with "
            "--tiers auto"
        )
    fits = tiers
    if arguments.min_psnr:
        fits = [t for t in fits if t["name"] == player_tiers().default or t["worst_psnr_capture"] >= arguments.min_psnr]
    rate = arguments.target_fps or wish
    if rate:
        fast = [t for t in fits if 1000 / t["frame_ms"] >= rate]
        if not fast and not arguments.target_fps:
            return min(fits, key=lambda t: t["frame_ms"])["name"]
        if not fast:
            best = min(fits, key=lambda t: t["frame_ms"])
            raise UserError(
                f"no stored tier of {bundle.path} plays at {arguments.target_fps:g} frames per second within those "
                f"limits: the fastest is {best['name']} at {1000 / best['frame_ms']:.0f}"
            )
        return max(fast, key=lambda t: (t["psnr_capture"], -t["frame_ms"]))["name"]
    return min(fits, key=lambda t: t["frame_ms"])["name"]
