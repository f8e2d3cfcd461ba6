"""The body coloured by what footage says of it: what to film next."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from gavatar_runtime.values.camera import Camera, look_at
from gavatar_runtime.values.gaussians import Gaussians
from gavatar_runtime.values.point_evidence import FULL, Evidence

from ...avatar.trainable import Avatar
from ...protocols import Rasterizer
from ..scene import Scene

# from nothing seen to plenty: red, orange, yellow, green (as seen by most; told apart by lightness as well)
STEPS = (
    (0.0, (0.62, 0.05, 0.12)),
    (0.25 * FULL, (0.93, 0.45, 0.2)),
    (FULL, (0.97, 0.86, 0.45)),
    (20.0, (0.1, 0.5, 0.35)),
)
SIDES = (("front", 0.0), ("left", np.pi / 2), ("back", np.pi), ("right", -np.pi / 2))
WORDS = ("never seen", "hardly", "enough", "well")
HEIGHT, WIDTH, LEGEND = 320, 320, 36


def evidence_colors(evidence: Evidence) -> np.ndarray:
    """(N, 3) colours in [0, 1]: red where nothing was seen, yellow where just enough, green where plenty."""
    at = np.log1p(np.nan_to_num(evidence.views))
    marks = np.log1p([step for step, _ in STEPS])
    colors = np.array([color for _, color in STEPS])
    return np.stack([np.interp(at, marks, channel) for channel in colors.T], 1).astype(np.float32)


def evidence_picture(scene: Scene) -> np.ndarray:
    """(H, W, 3) the avatar of a scene in its canonical pose from four sides, with a legend. Raises ValueError where
    there is no evidence yet."""
    if scene.evidence is None:
        raise ValueError("there is no evidence yet")
    return drawn_evidence(scene.avatar, scene.rasterize, scene.evidence.on(scene.avatar.surface))


@torch.no_grad()
def drawn_evidence(avatar: Avatar, rasterize: Rasterizer, evidence: Evidence) -> np.ndarray:
    """(H, W, 3) an avatar in its canonical pose from four sides, coloured by `evidence`, with a legend."""
    training = avatar.training
    avatar.eval()
    out = avatar.attributes()
    avatar.train(training)
    means = avatar.points + out.offsets[0]
    colors = torch.from_numpy(evidence_colors(evidence)).to(means)
    normals = torch.from_numpy(np.asarray(avatar.surface.normals)).to(means) if avatar.with_normals else None
    gaussians = Gaussians(means, out.scales[0], colors, quaternions=None if out.rotations is None else out.rotations[0],
                          normals=normals)  # fmt: skip
    low, high = (bound.cpu().numpy().astype(np.float64) for bound in (means.amin(0), means.amax(0)))
    middle, size = (low + high) / 2, float((high - low).max())
    pictures = []
    for title, turn in SIDES:
        eye = middle + 4 * size * np.array([np.sin(turn), 0.0, np.cos(turn)])
        focal = 0.92 * HEIGHT * 3.5  # the nearest of the body is 3.5 of its sizes away
        camera = Camera(WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, look_at(eye, middle))
        color = rasterize(gaussians, camera, torch.ones(3, device=means.device)).color
        picture = np.ascontiguousarray(color.clamp(0, 1).cpu().numpy(), np.float32)
        _write(picture, title, (8, 18))
        pictures.append(picture)
    return np.concatenate([np.concatenate(pictures, 1), _legend(len(SIDES) * WIDTH, evidence)], 0)


def _legend(width: int, evidence: Evidence) -> np.ndarray:
    bar = np.ones((LEGEND, width, 3), np.float32)
    left = 10
    for (_, color), word in zip(STEPS, WORDS, strict=True):
        bar[10:26, left : left + 26] = color
        _write(bar, word, (left + 32, 23))
        left += 150
    share = float((evidence.confidence < 0.5).mean())
    _write(bar, f"{100 * share:.0f} % of the points were hardly or never seen squarely", (left + 10, 23))
    return bar


def _write(picture: np.ndarray, text: str, place: tuple[int, int]) -> None:
    letters = np.zeros(picture.shape[:2], np.uint8)
    cv2.putText(letters, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 255, 1, cv2.LINE_AA)
    picture *= 1 - 0.9 * (letters[..., None] / np.float32(255))
