"""Fewer Gaussians of an avatar: the first of the progressive order against the former thinning by texels.

    python benchmarks/detail.py NAME.gavatar... [--pictures FOLDER]

Until points came in any number, a level of detail was one Gaussian for each cell of a coarser grid over the UV atlas,
the one nearest to the cell's centre, each widened by what the cell is larger than its texel. That rule stands here, and
the first Gaussians of the order are drawn in the same number. Both are compared with all Gaussians, decoded by tier
`baked` where there is one, in several poses, from in front, from the left and from behind, at SIZE pixels:

  psnr     dB, mean over pictures on white
  closed   share of the pixels well inside the silhouette (3 pixels eroded) where at most 2 % of the background shows
  darkest  alpha that only one in a thousand of these pixels is below
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from gavatar.storage import write_image
from gavatar.text_table import format_table
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import Bundle, read_bundle
from gavatar_runtime.decoding.detail import first, grown
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.framing import DIRECTIONS, frame_motion
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.render.rasterizers import Rasterizer
from gavatar_runtime.tiers import stored_tiers
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.surface import Atlas, Surface

SHARES = (1 / 2, 1 / 4, 1 / 8, 1 / 16)  # of the Gaussians, about: the former rule has the last word on how many
VIEWS = ("front", "left", "back")
CLIPS = (("wave", 0.5), ("dance", 0.3), ("walk", 0.6))  # and where in it
SIZE, ERODED, OPAQUE = 512, 3, 0.98
FORMER_SPREAD = 0.3
BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}


def side_of(surface: Surface, free: float) -> float:
    """Of the atlas whose texels are as many as the Gaussians: its own, or one that as many would fill. free: share of
    an atlas that the body covers."""
    return float(surface.resolution) if isinstance(surface, Atlas) else float(np.sqrt(len(surface) / free))


def by_texels(surface: Surface, side: float, coarser: int) -> tuple[np.ndarray, np.ndarray]:
    """The former rule: rows (M,) and the variance (M,) that each gains. side: of the surface's own atlas."""
    place = surface.uv * coarser
    cell = np.floor(place).astype(np.int64)
    off = np.square(place - cell - 0.5).sum(1)
    key = cell[:, 1] * coarser + cell[:, 0]
    order = np.lexsort((np.arange(len(off)), off, key))
    key = key[order]
    chosen = np.sort(order[np.concatenate([[True], key[1:] != key[:-1]])])
    return chosen, FORMER_SPREAD**2 * max((side / coarser) ** 2 - 1, 0) * np.square(surface.spacing[chosen])


def frames(bundle: Bundle) -> Iterator[tuple[Gaussians, Camera]]:
    """All Gaussians in each pose, as each camera sees them."""
    tier = "baked" if "baked" in stored_tiers(bundle) else ""
    avatar = Avatar(bundle, tier=tier)
    for name, share in CLIPS:
        clip, _ = avatar.fit(read_motion(name))
        pose, trans = clip.poses[int(share * len(clip))], clip.trans[int(share * len(clip))]
        still = Motion(pose[None], trans[None], 1.0)
        gaussians = avatar.gaussians(pose, trans)
        for view in VIEWS:
            yield gaussians, frame_motion(avatar, still, SIZE, SIZE, azimuth=DIRECTIONS[view])


def taken(gaussians: Gaussians, rows: np.ndarray, added: np.ndarray) -> Gaussians:
    """The Gaussians `rows` of one pose, widened."""
    per_point = {
        field.name: getattr(gaussians, field.name)[rows]
        for field in dataclasses.fields(gaussians)
        if isinstance(getattr(gaussians, field.name), np.ndarray)
    }
    return dataclasses.replace(gaussians, **per_point | {"scales": grown(gaussians.scales[rows], added)})


def levels(surface: Surface, free: float) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Each rule at each number of Gaussians: its name, rows and added variances."""
    side = side_of(surface, free)
    for share in SHARES:
        chosen, added = by_texels(surface, side, max(1, round(side * np.sqrt(share))))
        yield "texels", chosen, added
        yield "prefix", *first(surface, len(chosen))


def measured(path: Path, pictures: Path | None) -> list[list[str]]:
    """A row of the table for each level of one avatar."""
    bundle = read_bundle(path)
    surface, atlas = bundle.surfaces()
    free = 0.63 if atlas is None else len(atlas) / atlas.resolution**2
    rasterizer = build_rasterizer()
    scenes = [(g, c, _drawn(rasterizer, g, c)) for g, c in frames(bundle)]
    rows: list[list[str]] = []
    shown: list[list[tuple[np.ndarray, np.ndarray]]] = []
    for rule, chosen, added in levels(surface, free):
        psnr, alphas = [], []
        row: list[tuple[np.ndarray, np.ndarray]] = []
        for gaussians, camera, full in scenes:
            part = _drawn(rasterizer, taken(gaussians, chosen, added), camera)
            psnr.append(-10 * np.log10(np.mean(np.square(_on(part, 1) - _on(full, 1)))))
            inside = cv2.erode((full[1] > OPAQUE).astype(np.uint8), np.ones((2 * ERODED + 1,) * 2, np.uint8)) > 0
            alphas.append(part[1][inside])
            row.append(part)
        alpha = np.concatenate(alphas)
        numbers = (f"{np.mean(psnr):.2f}", f"{100 * (alpha >= OPAQUE).mean():.2f} %", f"{np.quantile(alpha, 1e-3):.3f}")
        rows.append([f"{path.stem} {rule}", str(len(chosen)), *numbers])
        shown.append(row)
    if pictures is not None:
        for name, color in BACKGROUNDS.items():
            full_row = np.concatenate([_on(full, color[0]) for _, _, full in scenes[::2]], 1)
            grid = [full_row, *(np.concatenate([_on(part, color[0]) for part in row[::2]], 1) for row in shown)]
            write_image(pictures / f"{path.stem}_{name}.png", np.concatenate(grid))
    return rows


def _drawn(rasterizer: Rasterizer, gaussians: Gaussians, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) colours on black and (H, W) alpha."""
    image = rasterizer.render(gaussians, camera, BACKGROUNDS["black"])
    return image.color.copy(), image.alpha.copy()


def _on(drawn: tuple[np.ndarray, np.ndarray], grey: float) -> np.ndarray:
    return np.clip(drawn[0] + (1 - drawn[1][..., None]) * grey, 0, 1)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("avatars", nargs="+", type=Path, metavar="NAME.gavatar")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="all of them, on black and on white")
    arguments = parser.parse_args(argv)
    rows = [row for path in arguments.avatars for row in measured(path, arguments.pictures)]
    print(format_table(["avatar, rule", "gaussians", "psnr", "closed", "darkest"], rows))


if __name__ == "__main__":
    main()
