"""LPIPS, for those who have the weights."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.images.lpips import Lpips as LpipsNetwork
from gavatar.images.perceptual import cheaper_pair
from gavatar.losses import LossConfig, LossInputs, check_size, step_seed
from gavatar.registry import LOSSES, LossTraits
from gavatar_runtime.components import path_option


@dataclasses.dataclass
class LpipsConfig(LossConfig):
    """weight: the paper's 0.2. net: 'alex' (the authors' choice) or 'vgg'.

    backbone: torchvision checkpoint of that network, a file or the folder it lies in; by default the environment
    variable GAVATAR_LPIPS_BACKBONE, then torch's own download folder. linear: LPIPS's linear weights, by default those
    in the installed `lpips` package. crop: side in pixels of a random window on the person, 0 for the whole image.
    max_size: longest side in pixels after averaging down, 0 to keep it.
    """

    weight: float = 0.2
    net: str = "alex"
    backbone: str = path_option()
    linear: str = path_option()
    crop: int = 0
    max_size: int = 0


@LOSSES.register(
    "lpips",
    config=LpipsConfig,
    summary="LPIPS 0.1 with AlexNet or VGG16 (paper: 0.2)",
    needs="backbone weights (GAVATAR_LPIPS_BACKBONE) and the lpips package",
    traits=LossTraits(judges_poses=False),  # its network at every step of a fit costs more than it tells
)
class Lpips:
    """Mean over the batch of LPIPS; UserError at once when weights are missing. See `gavatar.images.lpips`."""

    def __init__(self, config: LpipsConfig):
        check_size("losses.lpips.crop", config.crop)
        check_size("losses.lpips.max_size", config.max_size)
        self.config = config
        self.network = LpipsNetwork(config.net, config.backbone, config.linear)

    def __call__(self, inputs: LossInputs) -> Tensor:
        config = self.config
        pair = cheaper_pair(
            inputs.render, inputs.target, inputs.mask, config.crop, config.max_size, step_seed(inputs.progress)
        )
        return self.network(*pair).mean()
