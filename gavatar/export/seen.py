"""Gaussians that no camera of the capture sees: which they are, and what leaving them out does to the picture."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from scipy.spatial import cKDTree

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.progress import shown
from gavatar_runtime.render.widening import as_trained
from gavatar_runtime.values.gaussians import Gaussians

from ..assemble import build_rasterizer
from ..capture.capture import View
from ..images.image_quality import mean_psnr, psnr
from ..images.pixel_weights import pixel_weights
from ..protocols import Rasterizer
from ..registry import RASTERIZERS, split_node
from ..training.posing import posed
from ..training.run import Run

SEEN = 1 / 255  # pixels: what adds up to less in a view moves no pixel of it by an 8-bit step
MARGIN = 0.02  # metres in the canonical pose: other poses and cameras uncover what lies beside the seen
HELD_OUT = ("novel_pose", "test", "val")
COMPARED = 12  # views that the picture is compared on
WHITE = (1.0, 1.0, 1.0)


def _rasterizer(run: Run) -> Rasterizer:
    """That of training, with the normals it asks for, or the default one where it does not draw on the CPU, where an
    opened run is."""
    node = run.config.rasterizer
    draws = "cpu" in RASTERIZERS.traits(*split_node(node)).devices
    return build_rasterizer(node if draws else {"name": RASTERIZERS.default}, run.avatar)


def seen(run: Run, margin: float = MARGIN, progress: bool = False) -> np.ndarray:
    """(N,) bool: which of the avatar's Gaussians some training view sees, or lie within `margin` metres of one.

    Every view is drawn with the refined pose of its frame. Raises UserError if none is seen: the poses or the cameras
    do not belong to the capture.
    """
    rasterize, motion = _rasterizer(run), run.motion.motion()
    largest = torch.zeros(len(run.avatar.surface))
    views = sorted(run.capture.views(run.config.train_split), key=lambda view: view.frame)
    frame: int | None = None
    gaussians: Gaussians | None = None
    for view in shown(views, "looking for what is seen", "view", show=progress):
        if gaussians is None or view.frame != frame:
            frame, gaussians = view.frame, posed(run, motion, view.frame)
        camera = run.capture.camera(view)
        weights = pixel_weights(rasterize, as_trained(gaussians, camera, run.pixel), camera)
        largest = torch.maximum(largest, weights)
    found = (largest > SEEN).numpy()
    if not found.any():
        raise UserError(f"{run.directory}: no training view of {run.capture.path} sees the avatar; is it its capture?")
    points = run.avatar.surface.points
    near = cKDTree(points[found]).query(points[~found], distance_upper_bound=margin)[0]
    found[~found] = np.isfinite(near)
    return found


@torch.no_grad()
def difference(run: Run, kept: np.ndarray) -> dict[str, float]:
    """PSNR, dB, of the kept Gaussians' picture against all Gaussians', over held-out views (training views where the
    capture holds none out): `psnr` of the mean error, `worst_psnr` of the worst view, `views`."""
    capture, rasterize = run.capture, _rasterizer(run)
    split = next((name for name in HELD_OUT if capture.splits.get(name)), run.config.train_split)
    motion = capture.truth or capture.motion if split in HELD_OUT else run.motion.motion()
    views: list[View] = capture.views(split)
    views = [views[i] for i in evenly_spaced(len(views), COMPARED)]
    rows, values = torch.from_numpy(np.flatnonzero(kept)), []
    for view in views:
        camera = capture.camera(view)
        whole = as_trained(posed(run, motion, view.frame), camera, run.pixel)
        fields = {f.name: getattr(whole, f.name) for f in dataclasses.fields(whole)}
        part = dataclasses.replace(whole, **{name: v[rows] for name, v in fields.items() if v is not None})
        pictures = [rasterize(g, camera, WHITE).color.clone() for g in (whole, part)]
        a, b = (p.permute(2, 0, 1)[None].clamp(0, 1) for p in pictures)
        values.append(min(100.0, float(psnr(a, b))))
    return {"psnr": round(mean_psnr(values), 2), "worst_psnr": round(min(values), 2), "views": len(values)}
