"""A decoder of your own, trained by its name: python examples/08_own_decoder.py CAPTURE RUN [setting=value ...]"""

import dataclasses
import sys

import torch
from torch import Tensor, nn

import gavatar
from gavatar.attributes import Attributes
from gavatar.registry import DECODERS


@dataclasses.dataclass
class TinyConfig:
    width: int = 16  # of the hidden layer


@DECODERS.register("tiny", config=TinyConfig, summary="one hidden layer")
class TinyDecoder(nn.Module):
    def __init__(self, config: TinyConfig, *, in_channels: int):
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(in_channels, config.width), nn.ReLU(), nn.Linear(config.width, 7))

    def forward(self, features: Tensor, uv: Tensor, spacing: Tensor) -> Attributes:
        out = self.layers(features)
        colors, scales = torch.sigmoid(out[..., 3:6]), 2 * spacing * torch.sigmoid(out[..., 6])
        return Attributes(offsets=0.05 * torch.tanh(out[..., :3]), colors=colors, scales=scales)


capture, run_directory, *settings = sys.argv[1:]
overrides = dict(setting.split("=", 1) for setting in settings)
decoder = {"name": "tiny", "width": 24}
print(gavatar.train(capture, preset="demo", encoder="none", decoder=decoder, out=run_directory, **overrides))
