"""How close the pictures of a way of playing come to those of the full model, and to the footage."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import torch

from gavatar_runtime.bundle import Bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

from ..capture.capture import Capture, View
from ..images.image_quality import mean_psnr
from .choices import Choice

QUALITY_FRAMES = 12  # evenly spaced over the motion, on which a choice is compared with the full model
FOOTAGE_SPLITS = ("novel_pose", "test", "val")  # the first of these that a capture has is what it is held against

Perceptual = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]  # of two images (1, 3, H, W) in [0, 1]


@dataclasses.dataclass(frozen=True)
class Likeness:
    """Of pairs of whole frames on white: mean and worst PSNR, dB, and mean perceptual distance, None without its
    network."""

    psnr: float
    worst_psnr: float
    perceptual: float | None = None


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """Held-out views of a capture. motion: their poses, fitted to the avatar. targets: (H, W, 3) footage on white."""

    motion: Motion
    frames: list[int]
    cameras: list[Camera]
    targets: list[np.ndarray]


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """dB of two images in [0, 1], at most 100 so that equal ones can be averaged."""
    mse = float(np.mean(np.square(image.astype(np.float64) - reference)))
    return 100.0 if mse < 1e-10 else -10 * np.log10(mse)


def compare(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray], perceptual: Perceptual | None = None) -> Likeness:
    """How alike pairs of images (H, W, 3) in [0, 1] are."""
    pairs = list(zip(ours, theirs, strict=True))
    values = [psnr(a, b) for a, b in pairs]
    distance = None
    if perceptual is not None:
        tensors = [[torch.from_numpy(i).float().permute(2, 0, 1)[None] for i in pair] for pair in pairs]
        distance = float(np.mean([float(perceptual(a, b)) for a, b in tensors]))
    return Likeness(mean_psnr(values), min(values), distance)


def images(
    choice: Choice, bundle: Bundle, motion: Motion, frames: Sequence[int], cameras: Sequence[Camera]
) -> list[np.ndarray]:
    """Images of a choice at `frames` of a motion on white, each with its camera. Where decodes are reused, the frames
    before are played too, as they would be."""
    renderer, drawn, at = choice.renderer(bundle), [], 0
    for frame, camera in zip(frames, cameras, strict=True):
        if choice.reuse > 1:
            at = max(at, frame - 2 * choice.reuse)
            for earlier in range(at, frame):
                renderer.avatar.gaussians(*motion.at(earlier))
        at = frame + 1
        gaussians = renderer.gaussians(*motion.at(frame), camera=camera)
        drawn.append(np.clip(renderer.rasterize(gaussians, camera).color, 0, 1))
    return drawn


def held_out(capture: Capture, fit: Callable[[Motion], Motion], limit: int = QUALITY_FRAMES) -> HeldOut:
    """Some of the views that a capture holds out, in true poses where it has them. fit: brings a motion to the avatar's
    body. Raises UserError for a capture that holds nothing out."""
    split = next((s for s in FOOTAGE_SPLITS if capture.splits.get(s)), None)
    if split is None:
        raise UserError(
            f"capture '{capture.name}' holds no frames out ({', '.join(FOOTAGE_SPLITS)}): leave `capture` out"
        )
    views: list[View] = capture.views(split)
    views = [views[i] for i in evenly_spaced(len(views), limit)]
    targets = []
    for view in views:
        color, alpha = capture.load(view)
        targets.append(color + (1 - alpha[..., None]))
    cameras = [capture.camera(view) for view in views]
    return HeldOut(fit(capture.truth or capture.motion), [view.frame for view in views], cameras, targets)
