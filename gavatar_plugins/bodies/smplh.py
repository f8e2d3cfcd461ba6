"""SMPL-H (Romero et al. 2017): SMPL with MANO's hands, from the user's own files."""

from __future__ import annotations

import dataclasses

from gavatar.body.official_files import official_body
from gavatar.registry import BODIES, BodyTraits
from gavatar_runtime.components import path_option


@dataclasses.dataclass
class SmplhConfig:
    """path: model file, or folder that is searched for it before those of $GAVATAR_BODY_MODELS. gender: neutral, male
    or female. num_betas: shape coefficients, 0 for all. uv: .obj or .npz of the UV atlas, '' to look for it. hands:
    `flat` or `mean`, the pose of hands that no motion moves."""

    path: str = path_option()
    gender: str = "neutral"
    num_betas: int = 0
    uv: str = path_option()
    hands: str = "flat"


@BODIES.register(
    "smplh",
    config=SmplhConfig,
    summary="SMPL-H: 52 joints with fingers, pose blendshapes",
    needs="the SMPL-H model and smpl_uv.obj, downloaded by you (docs/reference/bodies.md)",
    traits=BodyTraits(capture_name="smplh-official"),  # captures called the free body `smplh` before it had a name
)
class Smplh:
    """data: the numbers of the model. license: of its files."""

    def __init__(self, config: SmplhConfig):
        self.config = config
        self.data, self.license = official_body("smplh", config)
