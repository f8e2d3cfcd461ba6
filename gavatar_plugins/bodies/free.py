"""The CC0 body that ships with gavatar: SMPL-H's skeleton, so that motions of the SMPL family drive it."""

from __future__ import annotations

import dataclasses
import functools
import importlib.resources

import numpy as np

from gavatar.registry import BODIES, BodyTraits
from gavatar_runtime.values.body import BodyData

BODY_FILE = "gavatar_body_smplh.npz"


@dataclasses.dataclass
class FreeBodyConfig:
    """The free body has no options."""


@functools.cache
def load_free_body() -> BodyData:
    """The packaged body (V 12700, F 25229, J 52, B 10; see `gavatar/data/body/README.md`), read once a process.

    Every caller shares the arrays: treat them as read-only.
    """
    source = importlib.resources.files("gavatar.data") / "body" / BODY_FILE
    with source.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        return BodyData(
            name="free",
            v_template=arrays["v_template"],
            shapedirs=arrays["shapedirs"],
            J_regressor=arrays["J_regressor"],
            parents=arrays["kintree_table"][0].astype(np.int32),
            lbs_weights=arrays["weights"],
            faces=arrays["f"],
            uv=arrays["vt"],
            uv_faces=arrays["ft"],
            joint_names=tuple(str(name) for name in arrays["joint_names"]),
        )


@BODIES.register(
    "free",
    config=FreeBodyConfig,
    summary="CC0 body shipped with gavatar, SMPL-H joint order",
    traits=BodyTraits(shipped=True),
)
class FreeBody:
    """The packaged CC0 body.

    data: its numbers. summary, license: for `gavatar-list` and for what an exported avatar declares.
    """

    summary = "CC0 body shipped with gavatar: 52 joints in SMPL-H order, 10 shape coefficients, no pose blendshapes"
    license = "CC0-1.0"

    def __init__(self, config: FreeBodyConfig):
        self.config = config
        self.data = load_free_body()
