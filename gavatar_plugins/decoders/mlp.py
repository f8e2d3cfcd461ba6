"""The paper's decoder: eight shared layers with one skip, then three heads (paper, section 4.1 and supplement)."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from gavatar.attributes import Attributes
from gavatar.config import AUTO, is_number
from gavatar.registry import DECODERS, DecoderTraits
from gavatar_runtime.errors import UserError

FLOOR = 0.2  # where it is left to `auto`, at the start: arms seen at a slant are no net, and scores stay as they are


@dataclasses.dataclass
class MlpConfig:
    """widths: of the shared layers. skip: the layer (from 0) that sees the input again, -1 for none. head_width: of
    the hidden layer of each head. offset_limit: metres, offsets are bounded by construction. scale_limit: largest
    scale in units of the point spacing; scale_init: at the start, same units. scale_floor: smallest scale, same units,
    so that Gaussians that trained cameras saw at a slant, or widened by small images' pixels, leave no gaps when seen
    otherwise; `auto`: 0.2, until in the course of stage 1 what shows through tells whether it must be larger.
    anisotropic: three scales and a rotation for each Gaussian, to compare by; such an avatar is not exported.
    """

    widths: list[int] = dataclasses.field(default_factory=lambda: [128, 128, 128, 256, 128, 128, 128, 64])
    skip: int = 3
    head_width: int = 64
    offset_limit: float = 0.15
    scale_limit: float = 3.0
    scale_init: float = 0.8
    scale_floor: Any = AUTO
    anisotropic: bool = False


def _traits(config: MlpConfig) -> DecoderTraits:
    finds = config.scale_floor == AUTO
    if not config.anisotropic:
        return DecoderTraits(mixed_precision=True, finds_floor=finds)
    return DecoderTraits(
        mixed_precision=True,
        finds_floor=finds,
        not_exported="its Gaussians are anisotropic (decoder.anisotropic=true), which the player does not draw; train "
        "it without that option to export it",
    )


@DECODERS.register(
    "mlp", config=MlpConfig, summary="8 layers with a skip and three 2-layer heads, ReLU (paper)", traits=_traits
)
class MlpDecoder(nn.Module):
    """ReLU multilayer perceptron. Offsets are `offset_limit * tanh`, colours a sigmoid, scales a sigmoid between
    `scale_floor` and `scale_limit` times the spacing: bounded by construction, so that no pose can make the avatar
    explode, and independent of the UV resolution it was trained at."""

    floor: Tensor

    def __init__(self, config: MlpConfig, *, in_channels: int):
        super().__init__()
        self.config = config
        self.skip = config.skip
        layers: list[nn.Linear] = []
        inside = in_channels
        for level, outside in enumerate(config.widths):
            if level == self.skip and level > 0:
                inside += in_channels
            layers.append(nn.Linear(inside, outside))
            inside = outside
        self.layers = nn.ModuleList(layers)
        outputs = {"offset": 3, "color": 3, "scale": 1}
        if config.anisotropic:
            outputs |= {"scale": 3, "rotation": 4}
        lasts: dict[str, nn.Linear] = {}
        self.heads = nn.ModuleDict()
        for name, out in outputs.items():
            hidden, lasts[name] = nn.Linear(inside, config.head_width), nn.Linear(config.head_width, out)
            self.heads[name] = nn.Sequential(hidden, nn.ReLU(), lasts[name])
        for layer in layers:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            nn.init.zeros_(layer.bias)
        for last in lasts.values():
            nn.init.normal_(last.weight, std=1e-3)  # start on the body, grey, at the initial scale
            nn.init.zeros_(last.bias)
        floor = FLOOR if config.scale_floor == AUTO else config.scale_floor
        if not (is_number(floor) and 0 <= floor < config.scale_init < config.scale_limit):
            raise UserError(
                "decoder: scale_floor must be auto, or 0 <= scale_floor < scale_init < scale_limit must hold, not "
                f"{config.scale_floor}, {config.scale_init}, {config.scale_limit}"
            )
        start = (config.scale_init - floor) / (config.scale_limit - floor)
        nn.init.constant_(lasts["scale"].bias, math.log(start / (1 - start)))
        self.register_buffer("floor", torch.tensor(float(floor)))
        if config.anisotropic:
            nn.init.constant_(lasts["rotation"].bias[:1], 1.0)  # the identity

    def forward(self, features: Tensor, uv: Tensor, spacing: Tensor) -> Attributes:
        """features: (P, C). uv: (P, 2), unused: the learnable features tell the place. spacing: (P,) metres."""
        x = features
        for level, layer in enumerate(self.layers):
            if level == self.skip and level > 0:
                x = torch.cat([x, features], -1)
            x = torch.relu(layer(x))
        limit, floor = self.config.offset_limit, self.floor
        share, unit, rotations = torch.sigmoid(self._head("scale", x)), spacing[..., None], None
        if self.config.anisotropic:
            rotations = F.normalize(self._head("rotation", x), dim=-1)
        else:
            share, unit = share[..., 0], spacing
        return Attributes(
            offsets=limit * torch.tanh(self._head("offset", x) / limit),
            colors=torch.sigmoid(self._head("color", x)),
            scales=unit * (floor + (self.config.scale_limit - floor) * share),
            rotations=rotations,
        )

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        if prefix + "floor" not in state_dict:  # of earlier versions, which had it in the options alone, 0 by default
            former = 0.0 if self.config.scale_floor == AUTO else self.config.scale_floor
            state_dict[prefix + "floor"] = torch.full_like(self.floor, former)
        super()._load_from_state_dict(state_dict, prefix, *rest)

    def _head(self, name: str, x: Tensor) -> Tensor:
        """A head's output in float32, also where products are in bfloat16: a colour has more than 256 values."""
        hidden, activation, last = self.heads[name].children()
        h = activation(hidden(x))
        if not torch.is_autocast_enabled(x.device.type):
            return last(h)
        with torch.autocast(x.device.type, enabled=False):
            return last(h.float())
