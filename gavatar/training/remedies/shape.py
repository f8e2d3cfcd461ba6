"""The person's shape, corrected beside the motion."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from gavatar_runtime.errors import UserError

from ...assemble import AvatarBuild


class Shape(nn.Module):
    """One correction of the shape coefficients for the whole capture.

    betas: (n,) as estimated, or None for the mean shape. available: coefficients that the body has. change: (m,) starts
    at zero, m = n, or ten where none were estimated, as far as the body has them. settled: the body has been given this
    shape, and the change is part of it. Raises UserError for a body without shape coefficients.
    """

    def __init__(self, betas: np.ndarray | None, available: int):
        super().__init__()
        self.estimated = np.zeros(10) if betas is None else np.asarray(betas, np.float64).reshape(-1)
        count = min(len(self.estimated), available)
        if count == 0:
            raise UserError("motion.betas=true: body or capture has no shape coefficients; leave the option out")
        self.change = nn.Parameter(torch.zeros(count))
        self.settled = False

    @property
    def betas(self) -> np.ndarray:
        """(n,) float64 the corrected coefficients."""
        betas = self.estimated.copy()
        betas[: len(self.change)] += self.change.detach().double().cpu().numpy()
        return betas


def new_shape(built: AvatarBuild) -> Shape:
    """A correction of the shape of an avatar's body, zero at first."""
    return Shape(built.betas, built.body.data.num_betas)
