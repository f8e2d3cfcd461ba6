"""Brightness that changes from image to image, kept out of the avatar."""

from __future__ import annotations

import torch
from torch import Tensor, nn

RATE = 0.01  # of the logarithm, a step: a few dozen visits cross the range of an automatic exposure


class Exposure(nn.Module):
    """A gain of red, green and blue for each of V training views, optimised beside the avatar.

    The geometric mean of all gains is 1 by construction, so the avatar keeps the mean brightness of the footage, and
    evaluation, which knows no gains, draws that. log_gain: (V, 3), starts at zero.
    """

    def __init__(self, views: int):
        super().__init__()
        self.log_gain = nn.Parameter(torch.zeros(views, 3))

    def gains(self, rows: list[int]) -> Tensor:
        """(B, 3) of the views in `rows`."""
        return (self.log_gain[rows] - self.log_gain.mean(0)).exp()

    def forward(self, rows: list[int], render: Tensor, alpha: Tensor, background: Tensor) -> Tensor:
        """Renders (B, 3, H, W) over `background` (3,) as the cameras of the views in `rows` would have taken them: the
        person brightened, the background not. alpha: (B, H, W) rendered."""
        behind = (1 - alpha[:, None]) * background[:, None, None]
        return self.gains(rows)[:, :, None, None] * (render - behind) + behind
