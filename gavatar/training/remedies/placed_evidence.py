"""Evidence with the places that it was taken at, to be had at any others."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gavatar_runtime.values.array_rules import FAR, Rule, checked
from gavatar_runtime.values.point_evidence import Evidence
from gavatar_runtime.values.surface import Surface

PLACES = {"points": Rule(("N", 3), low=-FAR, high=FAR)}


@dataclasses.dataclass(frozen=True)
class PlacedEvidence:
    """Evidence and where it was taken: points (N, 3) of the body in its canonical pose, metres."""

    points: np.ndarray
    evidence: Evidence

    def on(self, surface: Surface) -> Evidence:
        """That of the points of another surface of the same body, each as the nearest point here."""
        if np.array_equal(self.points, surface.points):
            return self.evidence
        return self.evidence.take(cKDTree(self.points).query(surface.points)[1])

    def state(self) -> dict[str, Tensor]:
        """Tensors for a checkpoint."""
        arrays = {"points": self.points} | self.evidence.to_arrays()
        return {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in arrays.items()}

    @classmethod
    def from_state(cls, state: Mapping[str, Tensor], source: str) -> PlacedEvidence:
        """What `state` made of it. Raises UserError naming `source` for what breaks a rule."""
        arrays = {name: tensor.numpy() for name, tensor in state.items()}
        evidence = Evidence.from_arrays(arrays, source)
        return cls(checked(arrays, PLACES, source, sizes={"N": len(evidence)})["points"], evidence)
