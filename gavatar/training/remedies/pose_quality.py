"""How good estimated poses are, told by how evenly the body's silhouette fits the masks before anything is learnt."""

from __future__ import annotations

import numpy as np
import torch

from ..scene import Scene

VIEWS = 40  # looked at, spread evenly
# of the overlap, root mean square from view to view: 0.01 to 0.025 where landmarks or several cameras gave the poses,
# and for true ones; 0.036 to 0.04 where these are 5 cm off
UNSTEADY = 0.03
LEAST_VIEWS = 4


@torch.no_grad()
def unsteadiness(scene: Scene, scale: float) -> float | None:
    """Standard deviation over views of the overlap of silhouette and mask (intersection over union), the avatar as it
    is at the start and posed as estimated; None where too few views show a person.

    Clothes and hair are missing in every view alike; poses that are wrong are wrong in another way each time."""
    attributes, found = scene.avatar.attributes(), []
    for row in np.unique(np.linspace(0, len(scene.views) - 1, VIEWS).round().astype(int)):
        seen = scene.compare([int(row)], scale, attributes)
        whole = torch.maximum(seen.alpha, seen.mask).sum()
        if seen.mask.sum() > 0 and whole > 0:
            found.append(float(torch.minimum(seen.alpha, seen.mask).sum() / whole))
    return float(np.std(found)) if len(found) >= LEAST_VIEWS else None
