"""Distilling what a pose does to an avatar into linear bases by body part and a tiny network of the pose.

Local bases beat one global basis at the same cost, since a wrinkle at the elbow depends on the elbow alone.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
import torch

from gavatar_runtime.decoding.residuals import grouped
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.progress import shown
from gavatar_runtime.tiers.blendshape import Coefficients, pose_input, turn_input
from gavatar_runtime.values.body import SMPL_BODY_JOINTS
from gavatar_runtime.values.surface import Atlas, Surface

from ..avatar.atlas import MIN_RESOLUTION
from ..protocols import TierSource
from .tier_source import joint_of_points, upsampling

LENGTH_WEIGHT = 20.0  # per metre: 5 mm, about a pixel of a person 400 pixels tall, count as a tenth of the colour range
WEIGHT = np.array([LENGTH_WEIGHT] * 3 + [1.0] * 3 + [LENGTH_WEIGHT], np.float32)  # of offset, colour and scale
PROTOTYPES = 128  # of the capture's poses, that the distance of another is taken from
FADE = (0.4, 1.5)  # distances, of rotation matrices' entries, between which residuals fade into the still look: below,
# they are closer to the full model than it is; above, as far (docs/lab/tiers.md)
RIDGE = 0.1  # penalty on the squared weights of rotations' entries, against about a thousand poses
JUDGED = 60  # poses over the range of motion, fitted to by nothing, that decide whether the fade helps
KEPT = 1e-4  # bases with a smaller share of their part's variance are left out


def distil(
    source: TierSource, *, rank: int, uv: int, samples: int, wide: int, width: int, steps: int
) -> dict[str, np.ndarray]:
    """The arrays of blendshape.npz (`gavatar_runtime.tiers.members.BLENDSHAPE`).

    Residuals against the still look are decoded on a surface of side `uv` for the capture's poses and `samples` more,
    reduced by PCA within each body part to `rank` bases (a multiple of four), which are upsampled onto the
    bundle's points. `wide` further poses, over a body's range of motion, have no say in the bases; the network learns
    what weights of these come closest to the full model there, where else it would guess.
    """
    rank = -(-rank // 4) * 4
    residuals = _Residuals(source, _coarse(source, uv))
    coarse, poses = residuals.surface, np.concatenate([source.train_poses, source.random_poses(samples)])
    # numbered on the coarse surface, which is the whole body: the fine one may lack parts that no camera saw
    joint, fine_joint = joint_of_points(coarse), joint_of_points(source.surface)
    owners, part = np.unique(joint, return_inverse=True)
    coefficients, bases = bases_by_part(residuals.stacked(poses), part, rank)
    further = source.wide_poses(wide)
    far = [_coefficients(residual, bases, part) for residual in residuals.of(further, "distilling far poses")]
    flat = np.concatenate([coefficients, np.reshape(far, (len(further), -1)).astype(np.float32)])
    # the root's rotation matters where the look depends on where the person faces
    facing = "normal_map" in source.avatar.encoder_traits.inputs
    body = _Body(np.asarray(coarse.parents), owners, np.arange(0 if facing else 1, SMPL_BODY_JOINTS))
    real, every = len(source.train_poses), np.concatenate([poses, further])
    arrays = _fit(every, flat, real, body, facing, width, steps, source.progress)
    fine_part, index, mixing = _mixing(coarse, source.surface, joint, fine_joint, owners)
    ratio = np.median(source.surface.spacing) / np.median(coarse.spacing)
    unit = (1 / WEIGHT) * np.array([1] * 6 + [ratio], np.float32)
    quantised, gains = _quantise(bases * unit, index, mixing, fine_part, len(owners))
    arrays |= {"part": fine_part, "basis": quantised, "gains": gains}
    judged = source.wide_poses(JUDGED, seed=1)
    wanted = [_coefficients(residual, bases, part) for residual in residuals.of(judged, "judging the fade")]
    arrays = _faded(arrays, source.train_poses, body, judged, wanted)
    return {k: v.astype(np.float32) if v.dtype == np.float64 else v for k, v in arrays.items()}


def _coarse(source: TierSource, uv: int) -> Atlas:
    """The body at side `uv` of its atlas, or at one with about as many points as the bundle where that has fewer."""
    coarse, count = source.surface_at(uv), len(source.surface)
    if len(coarse) <= count:
        return coarse
    return source.surface_at(max(MIN_RESOLUTION, round(uv * (count / len(coarse)) ** 0.5)))


class _Residuals:
    """What poses change of the still look on a coarse surface, (M, 7) each, in units of what the eye sees alike."""

    def __init__(self, source: TierSource, surface: Atlas):
        self.source, self.surface = source, surface
        self._mean = source.mean(surface)

    def of(self, poses: np.ndarray, label: str) -> Iterator[np.ndarray]:
        """One after the other. label: of the bar."""
        bar = shown(poses, label, "pose", show=self.source.progress)
        return ((self.source.decode(pose, self.surface) - self._mean) * WEIGHT for pose in bar)

    def stacked(self, poses: np.ndarray) -> np.ndarray:
        """(S, M, 7) float32."""
        rows = np.empty((len(poses), len(self.surface), 7), np.float32)
        for row, residual in zip(rows, self.of(poses, "distilling poses"), strict=True):
            row[:] = residual
        return rows


def _coefficients(residual: np.ndarray, bases: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(P x K,) weights of the bases (M, K, 7) that come closest to a residual (M, 7), part by part."""
    parts = range(int(part.max()) + 1)
    return np.concatenate([np.einsum("nkc,nc->k", bases[part == p], residual[part == p]) for p in parts])


def _faded(
    arrays: dict[str, np.ndarray], filmed: np.ndarray, body: _Body, judged: np.ndarray, wanted: list[np.ndarray]
) -> dict[str, np.ndarray]:
    """With what lets residuals fade far from the `filmed` poses (F, J, 3), if that comes closer to what is `wanted` of
    the coefficients in the poses `judged`."""
    seen = pose_input(filmed, body.joints)[evenly_spaced(len(filmed), PROTOTYPES)].astype(np.float16)
    fading = arrays | {"seen": seen, "near": body.near, "fade": np.array(FADE, np.float32)}
    errors = [
        sum(np.square(predict(pose).ravel() - target).sum() for pose, target in zip(judged, wanted, strict=True))
        for predict in (Coefficients(a, body.parents, "distillation") for a in (fading, arrays))
    ]
    # the bases are orthonormal: what of a residual lies beyond them is the same for both
    return fading if errors[0] <= errors[1] else arrays


@dataclasses.dataclass
class _Body:
    """parents: (J,) of its joints. owners: (P,) the joint of each part. joints: whose rotations are looked at."""

    parents: np.ndarray
    owners: np.ndarray
    joints: np.ndarray

    @property
    def near(self) -> np.ndarray:
        """(P, len(joints)) bool: those of `joints` that bend each part: its owner, that one's parent and children."""
        own = self.owners[:, None]
        return (self.joints == own) | (self.joints == self.parents[own]) | (self.parents[self.joints] == own)


def bases_by_part(residuals: np.ndarray, part: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (S, P x rank) and bases (M, rank, 7) of residuals (S, M, 7), by part (M,)."""
    poses, count = len(residuals), int(part.max()) + 1
    coefficients = np.zeros((poses, count, rank), np.float32)
    bases = np.zeros((len(part), rank, 7), np.float32)
    for p in range(count):
        own = np.flatnonzero(part == p)
        c, basis = _principal(residuals[:, own].reshape(poses, -1), rank)
        coefficients[:, p, : c.shape[1]] = c
        # none, where no pose changes the part
        bases[own, : len(basis)] = basis.reshape(len(basis), len(own), 7).swapaxes(0, 1)
    return coefficients.reshape(poses, -1), bases


def _mixing(
    coarse: Atlas, fine: Surface, joint: np.ndarray, fine_joint: np.ndarray, owners: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Part (N,) of each fine point, numbers (N, 4) and weights (N, 4) of the coarse points that it takes bases from."""
    index, mixing = upsampling(coarse, fine)
    # a joint that carries no coarse point has no bases: its points stay still, whatever part they are counted to
    fine_part = np.minimum(np.searchsorted(owners, fine_joint), len(owners) - 1).astype(np.uint8)
    # a point takes bases of its own part only: another part's have other coefficients
    mixing = mixing * (joint[index] == fine_joint[:, None])
    lost = mixing.sum(1) < 0.05
    mixing /= np.maximum(mixing.sum(1, keepdims=True), 1e-6)
    mixing[lost] = 0
    return fine_part, index, mixing


def _fit(
    poses: np.ndarray, flat: np.ndarray, real: int, body: _Body, facing: bool, width: int, steps: int, progress: bool
) -> dict[str, np.ndarray]:
    """What gives the coefficients `flat` (S, P x K) of `poses` (S, J, 3), of which the first `real` were filmed: the
    network, and where the look depends on where the person faces, what is linear in `turn_input` before it."""
    inputs, spread = pose_input(poses, body.joints), 0.25 * flat.std(0)
    arrays = {
        "joints": body.joints,
        "input_low": inputs.min(0),
        "input_high": inputs.max(0),
        "low": np.minimum(flat[:real].min(0), flat.mean(0)) - spread,
        "high": np.maximum(flat[:real].max(0), flat.mean(0)) + spread,
    }
    if facing:
        turned = turn_input(poses, body.owners, body.parents)
        direct, turn = fit_turns(inputs, turned, flat, real, body.near)
        arrays |= {"owners": body.owners.astype(np.uint8), "direct": direct, "turn": turn}
        flat = flat - inputs @ direct - np.einsum("spf,pfk->spk", turned, turn).reshape(flat.shape)
    for i, (w, b) in enumerate(_fit_network(inputs, flat, real, width, steps, progress)):
        arrays |= {f"weight_{i}": w, f"bias_{i}": b}
    return arrays


def fit_turns(
    inputs: np.ndarray, turned: np.ndarray, flat: np.ndarray, real: int, near: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """direct (D, P x K) and turn (P, 55, K) by ridge regression, part by part on the inputs (S, D) of its near joints
    and its own of `turned` (S, P, 55). The first `real` samples count four times."""
    samples, parts = turned.shape[:2]
    rank = flat.shape[1] // parts
    importance = np.ones((samples, 1))
    importance[:real] = 4
    direct = np.zeros((inputs.shape[1], parts, rank), np.float32)
    turn = np.zeros((parts, turned.shape[2], rank), np.float32)
    for p in range(parts):
        columns = np.flatnonzero(np.repeat(near[p], 9))
        x = np.concatenate([inputs[:, columns], turned[:, p]], 1).astype(np.float64)
        penalty = np.full(x.shape[1], RIDGE)
        penalty[-1] = 1e-6  # the constant is free
        normal = x.T @ (importance * x) + np.diag(penalty)
        solution = np.linalg.solve(normal, x.T @ (importance * flat[:, p * rank : (p + 1) * rank]))
        direct[columns, p], turn[p] = solution[: len(columns)], solution[len(columns) :]
    return direct.reshape(len(direct), -1), turn


def _principal(rows: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (S, K) and orthonormal bases (K, D) of the rows (S, D), not centred: zero is the still look."""
    values, vectors = np.linalg.eigh(rows @ rows.T)
    values, vectors = values[::-1][:rank], vectors[:, ::-1][:, :rank]
    keep = values > KEPT * max(values.sum(), 1e-12)
    values, vectors = values[keep], vectors[:, keep]
    scale = np.sqrt(values)
    return vectors * scale, (vectors / scale).T @ rows


def _quantise(
    bases: np.ndarray, index: np.ndarray, mixing: np.ndarray, part: np.ndarray, parts: int
) -> tuple[np.ndarray, np.ndarray]:
    """Bases (M, K, 7) upsampled to (N, K / 4, 8, 4) int8 (`residuals.grouped`) and their steps (P, 8), one a part
    and channel."""
    count, rank = len(index), bases.shape[1]
    largest = np.zeros((parts, 7), np.float32)
    for chunk in np.array_split(np.arange(count), max(1, count // 20000)):
        fine = np.einsum("nikc,ni->nkc", bases[index[chunk]], mixing[chunk])
        np.maximum.at(largest, part[chunk], np.abs(fine).max(1))
    gains = np.maximum(largest / 127, 1e-12)
    result = np.zeros((count, rank, 8), np.int8)
    for chunk in np.array_split(np.arange(count), max(1, count // 20000)):
        fine = np.einsum("nikc,ni->nkc", bases[index[chunk]], mixing[chunk])
        result[chunk, :, :7] = np.rint(fine / gains[part[chunk]][:, None])
    return grouped(result), np.concatenate([gains, np.zeros((parts, 1), np.float32)], 1)


def _fit_network(
    inputs: np.ndarray, targets: np.ndarray, real: int, width: int, steps: int, progress: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Layers (weight (in, out), bias) from pose inputs (S, D) to coefficients (S, C), least squares in their own units:
    the bases are orthonormal, so that is the error of the residuals. The first `real` samples count four times."""
    generator = torch.Generator().manual_seed(0)
    x, y = torch.from_numpy(inputs), torch.from_numpy(targets)
    size = y.square().mean().sqrt().clamp(min=1e-8)
    y = y / size
    sizes = [x.shape[1], width, width, y.shape[1]]
    layers = []
    for i, o in itertools.pairwise(sizes):
        w = torch.randn(i, o, generator=generator) * (2 / i) ** 0.5 * (0.1 if o == sizes[-1] else 1)
        layers.append((w.requires_grad_(), torch.zeros(o, requires_grad=True)))
    optimizer = torch.optim.AdamW([p for layer in layers for p in layer], lr=3e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    chance = torch.ones(len(x))
    chance[:real] = 4
    for _ in shown(range(steps), "fitting coefficients", "step", show=progress):
        batch = torch.multinomial(chance, min(128, len(x)), generator=generator)
        h = x[batch] + 0.02 * torch.randn(len(batch), x.shape[1], generator=generator)
        for i, (w, b) in enumerate(layers):
            h = h @ w + b
            if i < len(layers) - 1:
                h = h.relu()
        loss = (h - y[batch]).square().sum(1).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    weights = [(w.detach().numpy(), b.detach().numpy()) for w, b in layers]
    last = weights[-1]
    return [*weights[:-1], (last[0] * float(size), last[1] * float(size))]
