"""The avatar of half a person ends where the footage did: limbs that no image showed are hidden, not made up."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.values.surface import Surface

from ..training.run import Run

HANGS = 0.5  # least skinning weight on limbs that rest for which a point is one of them
SEEN = 0.5  # least confidence of the evidence for which a point stays


def never_filmed(run: Run) -> np.ndarray:
    """(N,) bool: the avatar's points on limbs that rest throughout its capture and that no training view shows. All
    False where every limb was seen.

    A thigh whose knee was never seen may be seen itself, and stays as far as it was; a shin cannot be.
    """
    surface, resting = run.avatar.surface, set(run.capture.resting)
    if not resting:
        return np.zeros(len(surface), bool)
    names = list(run.built.body.data.joint_names)
    first, beyond = np.zeros(len(names), bool), np.zeros(len(names), bool)
    for j, (name, parent) in enumerate(zip(names, surface.parents, strict=True)):
        beyond[j] = parent >= 0 and (first[parent] or beyond[parent])
        first[j] = name in resting and not beyond[j]
    hidden = _share(surface, first | beyond) > HANGS
    if run.evidence is not None:
        seen = run.evidence.on(surface).confidence >= SEEN
        hidden &= ~seen | (_share(surface, beyond) > HANGS)
    return hidden


def _share(surface: Surface, joints: np.ndarray) -> np.ndarray:
    """(N,) how much of each point's skinning weight lies on the joints (J,) bool."""
    return (surface.joint_weight * joints[surface.joint_index]).sum(-1)
