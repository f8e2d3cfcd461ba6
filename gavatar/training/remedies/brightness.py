"""How far the brightness of the whole person differs from view to view, told by an avatar that is still young."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from ..scene import Scene

DRIFTS = 0.07  # of the logarithm; light that changes with the pose gives 0.05 at most, a drift by a tenth 0.07
INSIDE = 0.95  # of mask and rendered alpha, from which a pixel counts as one of the person
FITS = 0.7  # share of the pixels that are believed, those that differ least
JUDGES = 48  # views that judge, spread evenly; all are measured only where brightness drifts
LEAST_VIEWS, LEAST_PIXELS = 8, 100


@dataclasses.dataclass(frozen=True)
class Brightness:
    """log_gain: (V, 3) of red, green and blue, the brightness of each view beside the avatar's, 0 in the mean; None
    where it does not drift. common: root mean square of the part that upper and lower, left and right halves of the
    person have in common."""

    log_gain: np.ndarray | None
    common: float

    @property
    def drifts(self) -> bool:
        """Whether this is the camera, not the light: parts of a body that turns under lamps do not brighten alike."""
        return self.log_gain is not None


@torch.no_grad()
def brightness(scene: Scene, scale: float) -> Brightness | None:
    """The brightness of all views beside what the static avatar shows in them at an image scale, None where too few of
    them show enough of the person."""
    views = len(scene.views)
    judged = _measured(scene, scale, np.unique(np.linspace(0, views - 1, JUDGES).round().astype(int)))
    known = np.isfinite(judged).all(1)
    if known.sum() < LEAST_VIEWS:
        return None
    judged = judged[known] - judged[known].mean(0)
    shared = [float((judged[:, a] * judged[:, b]).mean()) for a, b in ((3, 4), (5, 6))]
    common = round(float(np.sqrt(max(0.0, min(shared)))), 4)
    if not common > DRIFTS:
        return Brightness(None, common)
    gains = _measured(scene, scale, np.arange(views))[:, :3]
    known = np.isfinite(gains).all(1)
    return Brightness(np.where(known[:, None], gains - gains[known].mean(0), 0.0), common)


def _measured(scene: Scene, scale: float, rows: np.ndarray) -> np.ndarray:
    """(R, 7) logarithms for each of the views: red, green, blue, and all of the upper, lower, left and right half."""
    avatar, found = scene.avatar, []
    training = avatar.training
    avatar.eval()
    attributes, black = avatar.attributes(), torch.zeros(3)
    for row in rows.tolist():
        seen = scene.compare([row], scale, attributes, background=black)
        found.append(_ratios(seen.target[0], seen.render[0], torch.minimum(seen.mask[0], seen.alpha[0]) > INSIDE))
    avatar.train(training)
    return np.array(found)


def _ratios(target: Tensor, render: Tensor, inside: Tensor) -> list[float]:
    """Logarithms of target (3, H, W) over render where it is `inside` (H, W): of each colour, then of all in the upper,
    lower, left and right half of the pixels; NaN where there are too few."""
    y, x = torch.nonzero(inside, as_tuple=True)
    if len(y) < LEAST_PIXELS:
        return [float("nan")] * 7
    t, r = target[:, inside], render[:, inside]
    halves = (y < y.median(), y >= y.median(), x < x.median(), x >= x.median())
    return [_ratio(t[k], r[k]) for k in range(3)] + [_ratio(t[:, half].sum(0), r[:, half].sum(0)) for half in halves]


def _ratio(target: Tensor, render: Tensor) -> float:
    """The logarithm of the gain from render to target, (P,) each, by least squares over those that it fits best, so
    that bright pixels tell more than dark ones and what is out of place tells nothing."""
    if len(target) < LEAST_PIXELS // 4:
        return float("nan")
    gain = target.sum() / render.sum().clamp(min=1e-6)
    for _ in range(2):
        off = (target - gain * render).abs()
        kept = off <= off.quantile(FITS)
        gain = (target * render)[kept].sum() / render[kept].square().sum().clamp(min=1e-6)
    return float(gain.clamp(min=1e-3).log())
