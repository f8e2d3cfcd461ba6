"""The paper's decoder: eight shared layers with one skip, then three heads (paper, section 4.1 and supplement)."""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor, nn

from gavatar.attributes import Attributes
from gavatar.registry import DECODERS


@dataclasses.dataclass
class MlpConfig:
    """widths: of the shared layers. skip: the layer (from 0) that sees the input again, -1 for none. head_width: of
    the hidden layer of each head. offset_limit: metres, offsets are bounded by construction. scale_limit: largest
    scale in units of the point spacing; scale_init: at the start, same units.
    """

    widths: list[int] = dataclasses.field(default_factory=lambda: [128, 128, 128, 256, 128, 128, 128, 64])
    skip: int = 3
    head_width: int = 64
    offset_limit: float = 0.15
    scale_limit: float = 3.0
    scale_init: float = 0.8


@DECODERS.register("mlp", config=MlpConfig, summary="8 layers with a skip and three 2-layer heads, ReLU (paper)")
class MlpDecoder(nn.Module):
    """ReLU multilayer perceptron. Offsets are `offset_limit * tanh`, colours a sigmoid, scales `scale_limit * spacing`
    times a sigmoid: bounded by construction, so that no pose can make the avatar explode, and independent of the UV
    resolution it was trained at."""

    def __init__(self, config: MlpConfig, *, in_channels: int):
        super().__init__()
        self.config = config
        self.skip = config.skip
        layers = []
        inside = in_channels
        for level, outside in enumerate(config.widths):
            if level == self.skip and level > 0:
                inside += in_channels
            layers.append(nn.Linear(inside, outside))
            inside = outside
        self.layers = nn.ModuleList(layers)
        self.heads = nn.ModuleDict(
            {
                name: nn.Sequential(nn.Linear(inside, config.head_width), nn.ReLU(), nn.Linear(config.head_width, out))
                for name, out in (("offset", 3), ("color", 3), ("scale", 1))
            }
        )
        for layer in self.layers:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            nn.init.zeros_(layer.bias)
        for head in self.heads.values():
            nn.init.normal_(head[2].weight, std=1e-3)  # start on the body, grey, at the initial scale
            nn.init.zeros_(head[2].bias)
        start = config.scale_init / config.scale_limit
        nn.init.constant_(self.heads["scale"][2].bias, math.log(start / (1 - start)))

    def forward(self, features: Tensor, uv: Tensor, spacing: Tensor) -> Attributes:
        """features: (P, C). uv: (P, 2), unused: the learnable features tell the place. spacing: (P,) metres."""
        x = features
        for level, layer in enumerate(self.layers):
            if level == self.skip and level > 0:
                x = torch.cat([x, features], -1)
            x = torch.relu(layer(x))
        limit = self.config.offset_limit
        return Attributes(
            offsets=limit * torch.tanh(self.heads["offset"](x) / limit),
            colors=torch.sigmoid(self.heads["color"](x)),
            scales=self.config.scale_limit * spacing * torch.sigmoid(self.heads["scale"](x)[..., 0]),
        )
