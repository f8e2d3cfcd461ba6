"""What a run is judged by: image metrics (torch), joint errors (NumPy).

Image metrics take (B, 3, H, W) images in [0, 1] and give (B,). PSNR and SSIM are those of
`gavatar.images.image_quality`, so
that what is reported is what was trained. `masked` restricts any of them to where the person is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.values.body import SMPL_BODY_JOINTS
from gavatar_runtime.values.skeletons import FINGERS

from .image_quality import mean_psnr, psnr, ssim
from .lpips import Lpips
from .perceptual import MAX_DEPTH, NETWORK_NAME, load_weights, perceptual_distance

ImageMetric = Callable[[Tensor, Tensor], Tensor]

__all__ = [
    "ImageMetric", "joint_errors", "lpips_metric", "masked", "mean_psnr", "mpjpe", "mpjpe_hands", "pa_mpjpe",
    "perceptual_metric", "psnr", "rotation_errors", "ssim",
]  # fmt: skip


def perceptual_metric(depth: int = MAX_DEPTH) -> tuple[ImageMetric, str]:
    """The perceptual distance over all depths of its network, and the name to report it by (it is not LPIPS).

    Raises UserError when the network's weights are not installed.
    """
    load_weights()

    @torch.no_grad()
    def distance(image: Tensor, reference: Tensor) -> Tensor:
        return perceptual_distance(image, reference, depth)

    return distance, f"{NETWORK_NAME}, {depth} depths"


def lpips_metric(net: str = "alex", backbone: str = "", linear: str = "") -> tuple[ImageMetric, str]:
    """True LPIPS and its name; UserError when its weights are missing (see `gavatar.images.lpips`)."""
    network = Lpips(net, backbone, linear)
    return torch.no_grad()(network.forward), network.title


def masked(metric: ImageMetric, image: Tensor, reference: Tensor, mask: Tensor, margin: int = 0) -> Tensor:
    """(B,) `metric` of each image inside the bounding box of its `mask` (B, H, W), grown by `margin` pixels.

    The box holds every pixel of the mask above 0.5. Raises UserError for a mask that has none.
    """
    scores = []
    for b, covered in enumerate(mask > 0.5):
        rows, columns = covered.any(1).nonzero().flatten(), covered.any(0).nonzero().flatten()
        if len(rows) == 0:
            raise UserError(f"mask {b} of the batch is empty: there is no person to score, leave this view out")
        y, x = (slice(max(0, int(i[0]) - margin), int(i[-1]) + 1 + margin) for i in (rows, columns))
        scores.append(metric(image[b : b + 1, :, y, x], reference[b : b + 1, :, y, x]))
    return torch.cat(scores)


def mpjpe(joints: np.ndarray, truth: np.ndarray, root: int | None = 0) -> np.ndarray:
    """(T,) mean per-joint position error in mm of joints (T, J, 3), metres, over the first 22 joints.

    Both are moved so that their joint `root` is the origin; None compares world positions.
    """
    joints, truth = _body_joints(joints, truth)
    if root is not None:
        joints, truth = joints - joints[:, root, None], truth - truth[:, root, None]
    return 1000 * np.linalg.norm(joints - truth, axis=-1).mean(-1)


def pa_mpjpe(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(T,) as `mpjpe`, after the similarity (rotation, translation, scale) that best fits each frame (Umeyama 1991).

    A mirrored skeleton is not turned into its image. Joints that all coincide get scale 0 and are compared with the
    truth's centre. A frame that holds NaN or infinity scores NaN.
    """
    joints, truth = _body_joints(joints, truth)
    finite = np.isfinite(joints).all((1, 2)) & np.isfinite(truth).all((1, 2))
    errors = np.full(len(joints), np.nan)
    x, y = joints[finite], truth[finite]
    x, y = x - x.mean(1, keepdims=True), y - y.mean(1, keepdims=True)
    u, s, vt = np.linalg.svd(x.swapaxes(1, 2) @ y)
    sign = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1.0, 1.0)
    s[:, 2], u[:, :, 2] = s[:, 2] * sign, u[:, :, 2] * sign[:, None]
    power = np.square(x).sum((1, 2))
    scale = np.where(power > 0, s.sum(1) / np.where(power > 0, power, 1), 0)
    errors[finite] = 1000 * np.linalg.norm(scale[:, None, None] * (x @ (u @ vt)) - y, axis=-1).mean(-1)
    return errors


def joint_errors(joints: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """(MPJPE with the pelvis as root, PA-MPJPE) in mm, means over the frames of joints (T, J, 3), metres."""
    return float(mpjpe(joints, truth).mean()), float(pa_mpjpe(joints, truth).mean())


def mpjpe_hands(joints: np.ndarray, truth: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """(T,) mean position error in mm of the finger joints of joints (T, J, 3), metres, named `names`, each hand moved
    so that its wrist is the origin: what fingers err beyond what carries them. NaN for a body without fingers."""
    errors = []
    for side in ("left", "right"):
        wrist = [names.index(f"{side}_wrist")] if f"{side}_wrist" in names else []
        fingers = [names.index(name) for name in FINGERS if name.startswith(side) and name in names]
        if wrist and fingers:
            mine, theirs = (np.asarray(j, np.float64)[:, fingers] - j[:, wrist] for j in (joints, truth))
            errors.append(1000 * np.linalg.norm(mine - theirs, axis=-1))
    return np.concatenate(errors, 1).mean(1) if errors else np.full(len(joints), np.nan)


def rotation_errors(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(...,) degrees, 0 to 180, between rotations given as axis-angle (..., 3)."""
    mine, theirs = (matrix_from_axis_angle(np.asarray(p, np.float64)) for p in (poses, truth))
    return np.degrees(np.linalg.norm(axis_angle_from_matrix(np.swapaxes(mine, -1, -2) @ theirs), axis=-1))


def _body_joints(joints: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    joints, truth = (np.asarray(j, np.float64)[:, :SMPL_BODY_JOINTS] for j in (joints, truth))
    if joints.shape != truth.shape or joints.shape[-1] != 3:
        raise ValueError(f"joints {joints.shape} and truth {truth.shape} must both be (T, J, 3)")
    return joints, truth
