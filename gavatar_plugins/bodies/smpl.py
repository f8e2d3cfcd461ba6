"""SMPL (Loper et al. 2015), from the user's own files."""

from __future__ import annotations

import dataclasses

from gavatar.body.official_files import official_body
from gavatar.registry import BODIES
from gavatar_runtime.components import path_option


@dataclasses.dataclass
class SmplConfig:
    """path: model file, or folder that is searched for it before those of $GAVATAR_BODY_MODELS. gender: neutral, male
    or female. num_betas: shape coefficients, 0 for all. uv: .obj or .npz of the UV atlas, '' to look for it."""

    path: str = path_option()
    gender: str = "neutral"
    num_betas: int = 0
    uv: str = path_option()


@BODIES.register(
    "smpl",
    config=SmplConfig,
    summary="SMPL: 24 joints, pose blendshapes",
    needs="the SMPL model and smpl_uv.obj, downloaded by you (docs/reference/bodies.md)",
)
class Smpl:
    """data: the numbers of the model. license: of its files."""

    def __init__(self, config: SmplConfig):
        self.config = config
        self.data, self.license = official_body("smpl", config)
