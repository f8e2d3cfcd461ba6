"""What an avatar looks like where footage says little: like its neighbours on the body and the other side of it.

Colours, offsets and relative scales x minimise  sum_i e_i |x_i - seen_i|^2 + sum_ij w_ij |x_i - x_j|^2  over the bonds
of the body (`bonds_of`). e grows from 0 without evidence to infinity with enough of it.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from scipy.sparse import diags
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import cKDTree
from torch import Tensor

from gavatar_runtime.values.point_evidence import Evidence

from ...attributes import Attributes
from ...avatar.trainable import Avatar
from ...avatar.uv_sampling import bilinear, sample_uv
from .bonds import Bonds, bonds_of

SURE = 0.999  # confidence from which on a point stays exactly what was seen
WEAK = 1e-5  # of a bond to the mean of all that was seen: it decides only where nothing else does
PULL = 1.0  # of the loss that holds points to the prior while training goes on
STEPS, RATE = 60, 1e-2
AT_ONCE = 1 << 14  # points that are decoded in one step
HELD = 4.0  # how much more it counts that a point keeps what was seen of it than that another takes on the prior
FAR_APART = 1.0  # metres between points that count as unlike as if their colours were opposites
OFFSET_UNIT = 0.01  # metres of offset that weigh as much as the whole range of a colour


def smoothest(values: np.ndarray, confidence: np.ndarray, bonds: Bonds, odd: np.ndarray | None = None) -> np.ndarray:
    """(N, C) the minimum of the energy above. values: (N, C) what was seen. confidence: (N,) 0 to 1; from 0.999 on a
    point keeps its values. odd: (C,) bool, channels that change their sign in a mirror.

    Points whose values are not finite count as unseen. Where nothing at all was seen, the values are given back."""
    finite = np.isfinite(values).all(1) & np.isfinite(confidence)
    known = np.where(finite, np.clip(np.nan_to_num(confidence), 0, 1), 0.0)
    given = np.where(finite[:, None], values, 0.0).astype(np.float64)
    free, sure = np.flatnonzero(known < SURE), np.flatnonzero(known >= SURE)
    if not known.any() or not len(free):
        return values
    mean = (known[:, None] * given).sum(0) / known.sum()
    evidence = known[free] / (1 - known[free])
    near, across = bonds.near[free], bonds.mirrored[free]
    degree = np.asarray(near.sum(1) + across.sum(1)).ravel() + evidence + WEAK
    out = given.copy()
    for channel in range(values.shape[1]):
        sign = -1.0 if odd is not None and odd[channel] else 1.0
        W = near + sign * across
        A = (diags(degree) - W[:, free]).tocsr()
        right = W[:, sure] @ given[sure, channel] + evidence * given[free, channel] + WEAK * mean[channel]
        scaled = LinearOperator(A.shape, lambda x: x / degree, dtype=np.float64)
        out[free, channel], _ = cg(A, right, x0=np.full(len(free), mean[channel]), rtol=1e-6, maxiter=2000, M=scaled)
    return out.astype(values.dtype)


def continued(avatar: Avatar, evidence: Evidence, bonds: Bonds) -> Tensor:
    """(N, 7 or more) colour, offset in units of 1 cm and relative scale that all points are to have."""
    seen = measured(avatar, static_look(avatar))[0]
    values = seen.cpu().numpy().astype(np.float64)
    values[:, 3:6] = np.einsum("nab,nb->na", bonds.frames, values[:, 3:6])
    odd = np.zeros(values.shape[1], bool)
    odd[5] = True  # what is square to normal and limb
    values = smoothest(values, evidence.confidence, bonds, odd)
    values[:, 3:6] = np.einsum("nab,na->nb", bonds.frames, values[:, 3:6])
    sure = torch.from_numpy(evidence.confidence >= SURE).to(seen.device)
    return torch.where(sure[:, None], seen, torch.from_numpy(values).to(seen))


@torch.no_grad()
def static_look(avatar: Avatar) -> Attributes:
    """What the avatar decodes to in eval mode, without what a pose adds."""
    training = avatar.training
    avatar.eval()
    out = avatar.attributes()
    avatar.train(training)
    return out


def measured(avatar: Avatar, out: Attributes) -> Tensor:
    """(B, N, 7 or more) colours, offsets and relative scales of B poses in units that weigh alike."""
    B, N = out.colors.shape[:2]
    spacing = avatar.spacing.view(-1, *[1] * (out.scales.dim() - 2))
    return torch.cat([out.colors, out.offsets / OFFSET_UNIT, (out.scales / spacing).reshape(B, N, -1)], 2)


@dataclasses.dataclass(frozen=True)
class Prior:
    """What N points are to look like as far as footage says little of them. target: (N, 7 or more). weight: (N,) from 1
    where nothing was seen to 0 where enough was."""

    target: Tensor
    weight: Tensor

    def loss(self, avatar: Avatar, attributes: Attributes) -> Tensor:
        """How far attributes of B poses are from it, in all of them: what a pose adds is nothing there either."""
        error = (measured(avatar, attributes) - self.target).square().mean(2)
        return PULL * (self.weight * error).mean()

    def state(self) -> dict[str, Tensor]:
        """Tensors for a checkpoint, which `Prior(**state)` reads."""
        return {"target": self.target, "weight": self.weight}


def fill(avatar: Avatar, evidence: Evidence, head: int | None, *, fit: bool = True) -> Prior | None:
    """Change the avatar's features so that its points decode to the minimum of the energy, and what holds them there
    while training goes on; None where all, or nothing, was seen, and nothing is changed. head: joint of the head.
    fit: False leaves the features as they are, where training does.

    Points with enough evidence keep what they have: texels that only they read are not touched, and where they share
    one with others the fit holds them."""
    confidence = evidence.confidence
    if not confidence.any() or (confidence >= SURE).all():
        return None
    target = continued(avatar, evidence, bonds_of(avatar.surface, head))
    sure = torch.from_numpy(confidence).to(target)
    if fit:
        training = avatar.training
        avatar.eval()
        _fit(avatar, target, sure)
        avatar.train(training)
    return Prior(target, 1 - sure)


def _free_texels(avatar: Avatar, free: np.ndarray) -> Tensor:
    """(R, R) 1 at texels of the features that some point in `free` (N,) reads, else 0. Smoothed features are read by
    all around."""
    size = avatar.features.shape[-1]
    out = np.zeros(size * size, np.float32)
    corner, weight = bilinear(avatar.surface.uv[free], size)
    out[corner[weight > 1e-6]] = 1  # what rounding alone makes of a weight of zero
    return torch.from_numpy(out.reshape(size, size)).to(avatar.features.device)


def _alike(avatar: Avatar, target: Tensor, confidence: Tensor) -> Tensor:
    """The features with those of each point that is not sure taken from the sure point that looks most as it should:
    a start from which the target is near, where what was never trained may be beyond the reach of any gradient."""
    known = (confidence >= min(SURE, float(confidence.max()))).cpu().numpy()
    place = avatar.surface.points / FAR_APART
    looks = np.concatenate([target.cpu().numpy(), place], 1)
    nearest = cKDTree(looks[known]).query(looks[~known])[1]
    base = avatar.features.detach()
    size = base.shape[-1]
    flat = base[0].flatten(1).T.cpu().numpy()  # (R^2, C)
    corner, weight = bilinear(avatar.surface.uv, size)
    at_points = (flat[corner] * weight[..., None]).sum(1)
    taken = at_points[known][nearest]
    total, sums = np.zeros(size * size, np.float32), np.zeros_like(flat)
    for k in range(4):
        np.add.at(total, corner[~known, k], weight[~known, k])
        np.add.at(sums, corner[~known, k], weight[~known, k, None] * taken)
    read = total > 1e-6
    flat = np.where(read[:, None], sums / np.maximum(total, 1e-6)[:, None], flat)
    return torch.from_numpy(flat.T.reshape(base.shape[1:])[None].copy()).to(base)


def _fit(avatar: Avatar, target: Tensor, confidence: Tensor) -> None:
    """Adam on the texels that points without enough evidence read, towards `target` (N, 7 or more) of all points."""
    base, count = avatar.features.detach(), len(target)
    free = _free_texels(avatar, (confidence < SURE).cpu().numpy())
    weight = (1 + (HELD - 1) * confidence)[:, None]
    change = (_alike(avatar, target, confidence) - base).mul_(free).requires_grad_()
    optimizer = torch.optim.Adam([change], lr=RATE)
    generator = torch.Generator().manual_seed(0)
    for step in range(STEPS):
        optimizer.param_groups[0]["lr"] = RATE * min(1.0, 2 * (1 - step / STEPS))
        rows = torch.randperm(count, generator=generator)[:AT_ONCE].to(base.device) if count > AT_ONCE else slice(None)
        features = sample_uv(avatar.smooth(base + change * free), avatar.uv[rows])[0]
        out = avatar.decoder(features, avatar.uv[rows], avatar.spacing[rows])
        unit = avatar.spacing[rows].view(-1, *[1] * (out.scales.dim() - 1))
        got = torch.cat([out.colors, out.offsets / OFFSET_UNIT, (out.scales / unit).reshape(len(unit), -1)], 1)
        loss = (weight[rows] * (got - target[rows]).square()).mean()
        (change.grad,) = torch.autograd.grad(loss, change)
        optimizer.step()
    with torch.no_grad():
        avatar.features.add_(change.detach() * free)
