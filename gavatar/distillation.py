"""Distilling what a pose does to an avatar into linear bases by body part and a tiny network of the pose.

Local bases beat one global basis at the same cost, since a wrinkle at the elbow depends on the elbow alone.
"""

from __future__ import annotations

import itertools

import numpy as np
import torch
from tqdm import tqdm

from gavatar_runtime.body import SMPL_BODY_JOINTS
from gavatar_runtime.residuals import grouped
from gavatar_runtime.spacing import evenly_spaced
from gavatar_runtime.tiers.blendshape import pose_input

from .attributes import encoder_inputs
from .tiers import TierSource, joint_of_points, upsampling

LENGTH_WEIGHT = 20.0  # per metre: 5 mm, about a pixel of a person 400 pixels tall, count as a tenth of the colour range
PROTOTYPES = 128  # of the capture's poses, that the distance of another is taken from
FADE = (0.4, 1.5)  # distances, of rotation matrices' entries, between which residuals fade into the still look: below,
# they are closer to the full model than it is; above, as far (docs/choosing_a_tier.md)
KEPT = 1e-4  # bases with a smaller share of their part's variance are left out


def distil(
    source: TierSource, *, rank: int, uv: int, samples: int, wide: int, width: int, steps: int
) -> dict[str, np.ndarray]:
    """The arrays of blendshape.npz (see `gavatar_runtime.tiers.blendshape.Blendshape`).

    Residuals against the still look are decoded on a surface of side `uv` for the capture's poses and `samples` more,
    reduced by PCA within each body part to `rank` bases (a multiple of four), which are upsampled onto the
    bundle's points. `wide` further poses, over a body's range of motion, have no say in the bases; the network learns
    what weights of these come closest to the full model there, where else it would guess.
    """
    rank = -(-rank // 4) * 4
    coarse = source.run.built.surface(min(uv, source.surface.resolution))
    poses = np.concatenate([source.train_poses, source.random_poses(samples)])
    weight = np.array([LENGTH_WEIGHT] * 3 + [1.0] * 3 + [LENGTH_WEIGHT], np.float32)
    mean = source.mean(coarse)
    residuals = np.empty((len(poses), len(coarse), 7), np.float32)

    def decoded(chosen: np.ndarray, label: str):
        bar = tqdm(chosen, desc=label, unit="pose", disable=not source.progress, leave=False)
        return ((source.decode(pose, coarse) - mean) * weight for pose in bar)

    for row, residual in zip(residuals, decoded(poses, "distilling poses"), strict=True):
        row[:] = residual
    # numbered on the coarse surface, which is the whole body: the fine one may lack parts that no camera saw
    joint, fine_joint = joint_of_points(coarse), joint_of_points(source.surface)
    owners, part = np.unique(joint, return_inverse=True)
    count = len(owners)
    coefficients = np.zeros((len(poses), count, rank), np.float32)
    bases = np.zeros((len(coarse), rank, 7), np.float32)
    for p in range(count):
        rows = residuals[:, part == p].reshape(len(poses), -1)
        c, basis = _principal(rows, rank)
        coefficients[:, p, : c.shape[1]] = c
        bases[part == p, : len(basis)] = basis.reshape(len(basis), -1, 7).swapaxes(0, 1)
    del residuals
    # the root's rotation matters where the look depends on where the person faces
    facing = "normal_map" in encoder_inputs(source.run.avatar.encoder)
    joints = np.arange(0 if facing else 1, SMPL_BODY_JOINTS)
    flat = coefficients.reshape(len(poses), -1)
    further = source.wide_poses(wide)
    projected = [
        np.concatenate([np.einsum("nkc,nc->k", bases[part == p], residual[part == p]) for p in range(count)])
        for residual in decoded(further, "distilling far poses")
    ]
    inputs = pose_input(np.concatenate([poses, further]), joints)
    flat = np.concatenate([flat, np.reshape(projected, (len(further), -1)).astype(np.float32)])
    layers = _fit_network(inputs, flat, len(source.train_poses), width, steps, source.progress)

    index, mixing = upsampling(coarse, source.surface)
    # a joint that carries no coarse point has no bases: its points stay still, whatever part they are counted to
    fine_part = np.minimum(np.searchsorted(owners, fine_joint), count - 1).astype(np.uint8)
    # a point takes bases of its own part only: another part's have other coefficients
    mixing = mixing * (joint[index] == fine_joint[:, None])
    lost = mixing.sum(1) < 0.05
    mixing /= np.maximum(mixing.sum(1, keepdims=True), 1e-6)
    mixing[lost] = 0
    ratio = np.median(source.surface.spacing) / np.median(coarse.spacing)
    unit = (1 / weight) * np.array([1] * 6 + [ratio], np.float32)
    quantised, gains = _quantise(bases * unit, index, mixing, fine_part, count)
    seen = flat[: len(source.train_poses)]
    spread = 0.25 * flat.std(0)
    arrays = {
        "part": fine_part,
        "basis": quantised,
        "gains": gains,
        "low": np.minimum(seen.min(0), flat.mean(0)) - spread,
        "high": np.maximum(seen.max(0), flat.mean(0)) + spread,
        "joints": joints,
        "input_low": inputs.min(0),
        "input_high": inputs.max(0),
        "seen": inputs[evenly_spaced(len(source.train_poses), PROTOTYPES)].astype(np.float16),
        "near": _neighbours(np.asarray(coarse.parents), owners, joints),
        "fade": np.array(FADE, np.float32),
    }
    for i, (w, b) in enumerate(layers):
        arrays |= {f"weight_{i}": w, f"bias_{i}": b}
    return {k: v.astype(np.float32) if v.dtype == np.float64 else v for k, v in arrays.items()}


def _neighbours(parents: np.ndarray, owners: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(P, len(joints)) bool: those of `joints` that bend the part of each owner: its own, its parent, its children."""
    own = owners[:, None]
    return (joints == own) | (joints == parents[own]) | (parents[joints] == own)


def _principal(rows: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (S, K) and orthonormal bases (K, D) of the rows (S, D), not centred: zero is the still look."""
    values, vectors = np.linalg.eigh(rows @ rows.T)
    values, vectors = values[::-1][:rank], vectors[:, ::-1][:, :rank]
    keep = values > KEPT * max(values.sum(), 1e-12)
    values, vectors = values[keep], vectors[:, keep]
    scale = np.sqrt(values)
    return vectors * scale, (vectors / scale).T @ rows


def _quantise(bases, index, mixing, part, parts) -> tuple[np.ndarray, np.ndarray]:
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


def _fit_network(inputs, targets, real: int, width: int, steps: int, progress: bool):
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
    for _ in tqdm(range(steps), desc="fitting coefficients", unit="step", disable=not progress, leave=False):
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
