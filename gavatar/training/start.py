"""Beginning with the colours of the footage instead of grey."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from .stage import level_at
from .visibility import gathered

if TYPE_CHECKING:
    from .trainer import Trainer

VIEWS = 24  # spread over the training views: more change the median little
STEPS = 120  # of fitting the networks to the colours; without drawing, each costs a fraction of a training step
LEAST = 0.05  # pixels of a view that a point must have made for its colour there to count


def footage_colors(trainer: Trainer, scale: float) -> tuple[Tensor, Tensor]:
    """(N, 3) the median over views of the footage's colour at each point, and (N,) whether any view saw it. By the
    poses as they are now, so a point seen on the wrong place in some views still gets the colour of the rest."""
    count = len(trainer.views)
    rows = sorted({round(i * (count - 1) / (VIEWS - 1)) for i in range(VIEWS)}) if count > 1 else [0]
    seen = []
    for color, weight in gathered(trainer, rows, scale):
        seen.append(torch.where(weight[:, None] > LEAST, color / weight[:, None].clamp(min=LEAST), torch.nan))
    median = torch.stack(seen).nanmedian(0).values
    known = ~median.isnan().any(1)
    return torch.where(known[:, None], median, median[known].mean(0) if known.any() else 0.5).clamp(0, 1), known


def start_from_footage(trainer: Trainer) -> None:
    """Fit features and decoder to `footage_colors`, with offsets and scales kept where they begin."""
    avatar, stage = trainer.avatar, trainer.config.stage1
    level = level_at(stage, 0)
    avatar.sample_at(trainer.built.surface(level.uv))
    colors, _ = footage_colors(trainer, level.image)
    with torch.no_grad():
        scales = avatar.attributes().scales
    groups = [
        {"params": list(avatar.decoder.parameters()), "lr": stage.lr_decoder},
        {"params": [avatar.features, *avatar.smooth.parameters()], "lr": stage.lr_features},
    ]
    optimizer = torch.optim.Adam(groups)
    for _ in range(STEPS):
        out = avatar.attributes()
        loss = (out.colors[0] - colors).square().mean() + (out.offsets / 0.01).square().mean()
        loss = loss + (out.scales / scales - 1).square().mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
    optimizer.zero_grad(set_to_none=True)
