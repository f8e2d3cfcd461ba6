"""The pose encoder: a U-Net from the UV positional map of the posed body to pose features (paper, section 4.2)."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from gavatar.registry import ENCODERS
from gavatar_runtime.errors import UserError


@dataclasses.dataclass
class UNetConfig:
    """width: channels after the first convolution (doubled twice, then capped at 8x). norm: `batch` as published, or
    `group`, which computes the same in training and evaluation. map_size: side of the positional map, a multiple of 32
    from 64 on.
    """

    width: int = 32
    norm: str = "group"
    map_size: int = 128


@ENCODERS.register("unet", config=UNetConfig, summary="U-Net on the root-relative UV positional map (paper)")
class UNetEncoder(nn.Module):
    """Five [LeakyReLU, Conv, norm] down, five [ReLU, ConvTranspose, norm] up, skips concatenated.

    The first convolution has no activation before it and the last block no norm. The last layer starts at zero, so
    that stage 2 begins exactly at the avatar of stage 1.
    """

    def __init__(self, config: UNetConfig, *, channels: int, map_size: int | None = None):
        super().__init__()
        if config.map_size % 32 or config.map_size < 64:
            raise UserError(f"encoder.map_size must be a multiple of 32 from 64 on, not {config.map_size}")
        self.map_size = config.map_size
        w = config.width
        widths = [w, 2 * w, 4 * w, 8 * w, 8 * w]
        norms = {"batch": lambda n: nn.BatchNorm2d(n, affine=False), "group": lambda n: nn.GroupNorm(n // 8 or 1, n)}
        if config.norm not in norms:
            raise UserError(f"encoder.norm must be one of {', '.join(norms)}, not '{config.norm}'")
        norm = norms[config.norm]
        self.down = nn.ModuleList()
        for level, (inside, outside) in enumerate(zip([3, *widths[:-1]], widths, strict=True)):
            block: list[nn.Module] = [] if level == 0 else [nn.LeakyReLU(0.2)]
            block.append(nn.Conv2d(inside, outside, 4, 2, 1, bias=False))
            # the innermost map is 4x4 (2x2 for a 64-pixel map): statistics over so few values are noise
            if 0 < level < len(widths) - 1:
                block.append(norm(outside))
            self.down.append(nn.Sequential(*block))
        ups = [*reversed(widths[:-1]), channels]
        self.up = nn.ModuleList()
        for level, outside in enumerate(ups):
            inside = widths[-1] if level == 0 else 2 * ups[level - 1]
            last = level == len(ups) - 1
            convolution = nn.ConvTranspose2d(inside, outside, 4, 2, 1, bias=last)
            block = [nn.ReLU(), convolution]
            if last:
                for parameter in convolution.parameters():
                    nn.init.zeros_(parameter)
            if not last:
                block.append(norm(outside))
            self.up.append(nn.Sequential(*block))

    def forward(self, positional_map: Tensor) -> Tensor:
        """positional_map: (B, 3, M, M) metres, root-relative -> (B, C, M, M) pose features."""
        skips = []
        x = positional_map
        for block in self.down:
            x = block(x)
            skips.append(x)
        for level, block in enumerate(self.up):
            x = block(x if level == 0 else torch.cat([x, skips[-1 - level]], 1))
        return x
