"""The body that a capture's poses are of."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

from gavatar.body.official_files import FAMILIES, find_model
from gavatar.registry import BODIES, BodyTraits
from gavatar_runtime.components import path_option
from gavatar_runtime.errors import UserError, did_you_mean
from gavatar_runtime.notes import Note

# Captures made on the free body before it had a name of its own call it by its skeleton, which is SMPL-H's.
_BODIES = {"free": "free", "smplh": "free", "smplh-official": "smplh", "smpl": "smpl", "smplx": "smplx"}


@dataclasses.dataclass
class AutoBodyConfig:
    """path: where the official files are, before $GAVATAR_BODY_MODELS. gender: neutral, male or
    female, '' for what the capture says. hands: as of smplx."""

    path: str = path_option()
    gender: str = ""
    hands: str = "flat"


@BODIES.register(
    "auto",
    config=AutoBodyConfig,
    summary="what the capture's poses are of: free, smpl, smplh or smplx",
    traits=BodyTraits(chooses=True, capture_name="free"),
    default=True,
)
class AutoBody:
    """Without a capture, the free body. data, license: its own."""

    def __init__(self, config: AutoBodyConfig):
        if config.path or config.gender:
            raise UserError("body 'auto' is chosen by a capture, and here is none: name the body that the files are of")
        self.config = config
        body = BODIES.build("free")
        self.data, self.license = body.data, body.license

    @staticmethod
    def choose(config: AutoBodyConfig, capture: Any) -> dict[str, Any]:
        """The node (name and options) of the body for a capture.

        Where the official files are missing: the free body, with a warning, for captures that know how to stand on
        another body (`Capture.placement`), else UserError.
        """
        family = capture.body_model
        if family not in _BODIES:
            known = did_you_mean(family, [c.name for c in BODIES if c.name != "auto"])
            raise UserError(f"the capture's body_model is '{family}', which no body is for: give body=NAME, {known}")
        name = _BODIES[family]
        if name == "free":
            return {"name": "free"}
        gender = config.gender or capture.gender
        try:
            find_model(FAMILIES[name], config.path, gender)
        except UserError as error:
            if config.path:
                raise
            if capture.placement is None:
                raise UserError(f"{error} (or body=free, though the capture's shape is one of {name})") from None
            warnings.warn(f"the free body takes the place of {name}, without its shape: {error}", Note)
            return {"name": "free"}
        options = {"path": config.path, "gender": gender}
        return {"name": name, **options, **({"hands": config.hands} if name in ("smplx", "smplh") else {})}
