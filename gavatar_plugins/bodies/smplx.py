"""SMPL-X (Pavlakos et al. 2019): body, hands and face, from the user's own files."""

from __future__ import annotations

import dataclasses

from gavatar.body.official_files import official_body
from gavatar.registry import BODIES
from gavatar_runtime.components import path_option


@dataclasses.dataclass
class SmplxConfig:
    """path: model file, or folder that is searched for it before those of $GAVATAR_BODY_MODELS. gender: neutral, male
    or female. num_betas: shape coefficients, 0 for all. uv: .obj or .npz of the UV atlas, '' to look for it. hands:
    `flat` or `mean`, the pose of hands that no motion moves. num_expression: expression coefficients, -1 for all."""

    path: str = path_option()
    gender: str = "neutral"
    num_betas: int = 0
    uv: str = path_option()
    hands: str = "flat"
    num_expression: int = 10


@BODIES.register(
    "smplx",
    config=SmplxConfig,
    summary="SMPL-X: 55 joints with fingers, jaw and eyes, expression, pose blendshapes",
    needs="the SMPL-X model and its UV atlas, downloaded by you (docs/reference/bodies.md)",
)
class Smplx:
    """data: the numbers of the model. license: of its files."""

    def __init__(self, config: SmplxConfig):
        self.config = config
        self.data, self.license = official_body("smplx", config)
