"""A decoder like the one of the authors' released code: shared layers of 128 with BatchNorm and Softplus."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from gavatar.attributes import Attributes
from gavatar.registry import DECODERS, DecoderTraits


@dataclasses.dataclass
class UpstreamConfig:
    """width: of every layer. offset_scale: metres per unit of the offset head (unbounded). scale_warmup: steps over
    which the scales grow from zero to the sigmoid's full range of one metre."""

    width: int = 128
    offset_scale: float = 0.02
    scale_warmup: int = 1000


def _block(inside: int, outside: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inside, outside), nn.BatchNorm1d(outside), nn.Softplus())


@DECODERS.register(
    "upstream",
    config=UpstreamConfig,
    summary="5 shared layers of 128 + UV, BatchNorm, Softplus",
    traits=DecoderTraits(counts_steps=True),
)
class UpstreamDecoder(nn.Module):
    """Features and UV pass five shared layers, the input joining again before the fifth; three heads 128-128-out.

    Scales are a sigmoid in metres times a warm-up factor, kept in a buffer so that what is exported is what was
    evaluated.
    """

    warmup: Tensor

    def __init__(self, config: UpstreamConfig, *, in_channels: int):
        super().__init__()
        self.config = config
        w, inputs = config.width, in_channels + 2
        self.shared = nn.Sequential(_block(inputs, w), *(_block(w, w) for _ in range(3)))
        self.joined = _block(w + inputs, w)
        self.heads = nn.ModuleDict(
            {
                name: nn.Sequential(_block(w, w), _block(w, w), nn.Linear(w, out))
                for name, out in (("offset", 3), ("color", 3), ("scale", 1))
            }
        )
        self.register_buffer("warmup", torch.ones(()))

    def on_step(self, step: int) -> None:
        """Set the scales' warm-up factor for stage-1 step `step` (from 0)."""
        self.warmup.fill_(min(1.0, (step + 1) / max(1, self.config.scale_warmup)))

    def forward(self, features: Tensor, uv: Tensor, spacing: Tensor) -> Attributes:
        """features: (P, C). uv: (P, 2). spacing: (P,), unused: scales are learned in metres."""
        inputs = torch.cat([features, uv], -1)
        x = self.joined(torch.cat([self.shared(inputs), inputs], -1))
        return Attributes(
            offsets=self.config.offset_scale * self.heads["offset"](x),
            colors=torch.sigmoid(self.heads["color"](x)),
            scales=self.warmup * torch.sigmoid(self.heads["scale"](x)[..., 0]),
        )
