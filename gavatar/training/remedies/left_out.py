"""Which training views are kept from the pose encoder, so that they can judge it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

STRETCH = 1 / 20  # of the views, in each of (at most) two stretches that follow one another in time
LARGEST = 1 / 12  # of the views, in the cluster of like poses
CENTRES = 12


def left_out_rows(places: Tensor, frames: list[int]) -> list[int]:
    """Rows of the views that judge dynamics, ascending: two stretches of successive frames and one cluster of poses, of
    about a sixth of the views. Frames between training frames would say nothing of poses that were not filmed.

    places: (V, D) poses of the views, alike where they are nearer than 1. frames: that the views show; one is left out
    in all its views. At least half of the views remain; of fewer than four views none is left out.
    """
    shown = sorted(set(frames))
    if len(shown) < 4:
        return []
    length, count = max(1, round(STRETCH * len(shown))), 2 if len(shown) >= 16 else 1
    out: set[int] = set()
    for i in range(count):
        start = round((i + 0.5) / count * len(shown) - length / 2)
        out |= set(shown[start : start + length])
    of_frame = [frames.index(frame) for frame in shown]
    out |= {shown[i] for i in _cluster(places[of_frame], max(1, int(LARGEST * len(shown))) if count > 1 else 0)}
    return [row for row, frame in enumerate(frames) if frame in out]


def _cluster(places: Tensor, most: int) -> list[int]:
    """The largest cluster that has not more than `most` members, () if there is none: around poses that lie farthest
    apart, each with all that are nearer to it than to the others."""
    centres, near = [0], torch.full((len(places),), torch.inf, dtype=places.dtype)
    for _ in range(min(CENTRES, len(places)) - 1):
        near = torch.minimum(near, (places - places[centres[-1]]).square().sum(1))
        if near.max() < 1:  # all others are like one of these
            break
        centres.append(int(near.argmax()))
    own = torch.cdist(places, places[centres]).argmin(1).numpy()
    sizes = np.bincount(own, minlength=len(centres))
    sizes[sizes > most] = 0
    return np.flatnonzero(own == sizes.argmax()).tolist() if sizes.max() > 0 else []
