"""How far apart the points of a regular grid are on a surface."""

from __future__ import annotations

import numpy as np


def spacing_on_grid(points: np.ndarray, texel: np.ndarray, side: int) -> np.ndarray:
    """(N,) float32 metres from each of points (N, 3) to its neighbours in a grid of side R, geometric mean of right and
    down; beside the rim of a chart, and where a neighbour is on another, the median of all. texel: (N,) row R + column.
    """
    at = np.full((side + 1) * (side + 1), -1, np.int64)
    row, column = np.divmod(texel.astype(np.int64), side)
    at[row * (side + 1) + column] = np.arange(len(points))
    steps = []
    for down, right in ((0, 1), (1, 0)):
        other = at[(row + down) * (side + 1) + column + right]
        distance = np.linalg.norm(points[other] - points, axis=1)
        known = distance[other >= 0]
        middle = float(np.median(known)) if len(known) else 0.0
        steps.append(np.where((other >= 0) & (distance < 4 * middle), distance, middle))
    return np.sqrt(steps[0] * steps[1]).astype(np.float32)
