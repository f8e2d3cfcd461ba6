"""The smallest useful decoder: one hidden layer."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from gavatar.attributes import Attributes
from gavatar.registry import DECODERS


@dataclasses.dataclass
class TinyConfig:
    """width: of the hidden layer. reach: largest offset from the surface, metres."""

    width: int = 16
    reach: float = 0.05


@DECODERS.register("tinydecoder", config=TinyConfig, summary="one hidden layer, an example of a third-party component")
class TinyDecoder(nn.Module):
    """features (P, C) -> offsets bounded by `reach`, colours in [0, 1], scales below twice the point spacing."""

    def __init__(self, config: TinyConfig, *, in_channels: int):
        super().__init__()
        self.config = config
        self.layers = nn.Sequential(nn.Linear(in_channels, config.width), nn.ReLU(), nn.Linear(config.width, 7))

    def forward(self, features: Tensor, uv: Tensor, spacing: Tensor) -> Attributes:
        out = self.layers(features)
        return Attributes(
            offsets=self.config.reach * torch.tanh(out[..., 0:3]),
            colors=torch.sigmoid(out[..., 3:6]),
            scales=2 * spacing * torch.sigmoid(out[..., 6]),
        )
