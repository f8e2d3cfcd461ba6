"""Points that no training view saw take on what is around them on the body."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...avatar.trainable import Avatar
from ...avatar.uv_sampling import bilinear, sample_uv
from ..scene import Scene
from ..verdicts import FillingVerdict
from .evidence import blending_weights

LEAST = 1.0  # pixels, over all views, below which a point counts as unseen
NEIGHBOURS = 8
STEPS, RATE = 150, 2e-2
OFFSET_UNIT = 0.01  # metres of offset that weigh as much as the whole range of a colour


def harmonic(points: np.ndarray, values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(N, C) values, those that are not known (N,) replaced by the smoothest continuation of the others over the points
    (N, 3): each is the mean of its nearest neighbours. Parts without a known neighbour get the mean of all known."""
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import cg
    from scipy.spatial import cKDTree

    if known.all() or not known.any():
        return values
    count = min(NEIGHBOURS + 1, len(points))
    index = cKDTree(points).query(points, count)[1][:, 1:]
    row = np.repeat(np.arange(len(points)), index.shape[1])
    W = coo_matrix((np.ones(row.size), (row, index.ravel())), (len(points),) * 2).tocsr()
    W = W.maximum(W.T)
    free = np.flatnonzero(~known)
    degree = np.asarray(W.sum(1)).ravel()[free]
    weak = 1e-4  # of a bond to the mean of all known: it decides only where nothing else does
    A = diags(degree + weak) - W[free][:, free]
    mean = values[known].mean(0)
    right = W[free][:, np.flatnonzero(known)] @ values[known] + weak * mean
    filled = values.astype(np.float64)
    for channel in range(values.shape[1]):
        filled[free, channel], _ = cg(A, right[:, channel], x0=np.full(len(free), mean[channel]), rtol=1e-6)
    return filled.astype(values.dtype)


def fill_unseen(scene: Scene, image: float) -> FillingVerdict:
    """Give unseen points the harmonic continuation of colour, offset and relative scale of what was seen, by changing
    those texels of the features that no seen point reads. image: scale of the images in which they are unseen.

    The avatar is otherwise untouched: seen points decode to what they did before, exactly. With smoothed features
    (upstream) every texel is read by its neighbours too, and nothing is filled.
    """
    avatar = scene.avatar
    training = avatar.training
    avatar.eval()
    seen = blending_weights(scene, image) >= LEAST
    unseen, free = int((~seen).sum()), _free_texels(avatar, seen)
    possible = not len(avatar.smooth) and bool(seen.any()) and bool(free.any())
    if unseen and possible:
        _fit(avatar, ~seen, free, _continued(avatar, seen))
    avatar.train(training)
    return FillingVerdict(points=unseen, of=len(seen), filled=unseen if possible else 0)


@torch.no_grad()
def _continued(avatar: Avatar, seen: Tensor) -> Tensor:
    """(M, 7 or more) colour, offset and relative scale that the unseen points are to have."""
    out = avatar.attributes()
    spacing = avatar.spacing.view(-1, *[1] * (out.scales.dim() - 2))
    parts = [out.colors[0], out.offsets[0] / OFFSET_UNIT, (out.scales[0] / spacing).reshape(len(seen), -1)]
    filled = harmonic(avatar.surface.points, torch.cat(parts, 1).cpu().numpy(), seen.cpu().numpy())
    return torch.from_numpy(filled).to(seen.device)[~seen]


def _free_texels(avatar: Avatar, seen: Tensor) -> Tensor:
    """(R, R) whether a texel of the features is read by no seen point."""
    size = avatar.features.shape[-1]
    corner, weight = bilinear(avatar.surface.uv[seen.cpu().numpy()], size)
    free = np.ones(size * size, bool)
    free[corner[weight > 1e-6]] = False  # what rounding alone makes of a weight of zero
    return torch.from_numpy(free.reshape(size, size)).to(avatar.features.device)


def _fit(avatar: Avatar, unseen: Tensor, free: Tensor, target: Tensor) -> None:
    """Adam on the free texels alone, decoding only the unseen points, towards `target` (M, 7 or more)."""
    uv, spacing = avatar.uv[unseen], avatar.spacing[unseen]
    base = avatar.features.detach()
    change = torch.zeros_like(base).requires_grad_()
    optimizer = torch.optim.Adam([change], lr=RATE)
    for _ in range(STEPS):
        features = sample_uv(base + change * free, uv)[0]
        out = avatar.decoder(features, uv, spacing)
        unit = spacing.view(-1, *[1] * (out.scales.dim() - 1))
        got = torch.cat([out.colors, out.offsets / OFFSET_UNIT, (out.scales / unit).reshape(len(uv), -1)], 1)
        loss = (got - target).square().mean()
        (gradient,) = torch.autograd.grad(loss, change)
        change.grad = gradient
        optimizer.step()
    with torch.no_grad():
        avatar.features.add_(change.detach() * free)
