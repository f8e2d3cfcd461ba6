"""The bundle, as the player reads it, against the PyTorch model."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gavatar_runtime.avatar.playing import Avatar as PlayedAvatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced

from ..training.posing import posed
from ..training.run import Run

POSITION_TOLERANCE = 1e-4  # metres: a tenth of a millimetre, far below a pixel at any sensible distance
COLOR_TOLERANCE = 1 / 255  # one 8-bit step


@dataclasses.dataclass
class ExportCheck:
    """The played avatar against the trained one over some poses. position_m, scale_m: largest distances, metres.
    color: largest difference in [0, 1]. poses: how many were compared."""

    position_m: float
    scale_m: float
    color: float
    poses: int

    def as_json(self) -> dict[str, float]:
        """The numbers and what they had to stay below."""
        tolerances = {"position_tolerance_m": POSITION_TOLERANCE, "color_tolerance": COLOR_TOLERANCE}
        return dataclasses.asdict(self) | tolerances

    def require(self, path: Path) -> None:
        """UserError, naming the bundle's `path`, where a difference is beyond its tolerance or not a number."""
        # written so that a NaN fails too
        if not (self.position_m <= POSITION_TOLERANCE and self.color <= COLOR_TOLERANCE):
            raise UserError(
                f"{path} was not written: the exported avatar differs from the trained one by "
                f"{1000 * self.position_m:.3f} mm (limit {1000 * POSITION_TOLERANCE}) and {255 * self.color:.2f}/255 "
                "in colour (limit 1/255)"
            )


def verify(path: Path, run: Run, poses: int = 8) -> ExportCheck:
    """Compare a bundle with the PyTorch model on refined poses of the capture; with expressions of the capture, or made
    up ones, where the body has any. run: whose avatar stands on the points of the bundle."""
    played = PlayedAvatar(read_bundle(path))
    motion = run.motion.motion()
    if played.expression is not None and motion.expression is None:
        made_up = np.sin(np.arange(len(motion))[:, None] + np.arange(played.expression.count))
        motion = dataclasses.replace(motion, expression=made_up.astype(np.float32))
    frames = sorted({view.frame for view in run.capture.views(run.config.train_split)})
    frames = [frames[i] for i in evenly_spaced(len(frames), poses)]
    errors = []
    for frame in frames:
        expected = posed(run, motion, frame)
        got = played.gaussians(*motion.at(frame))
        errors.append(
            [
                float(np.linalg.norm(got.means - expected.means.numpy(), axis=-1).max()),
                float(np.abs(got.scales - expected.scales.numpy()).max()),
                float(np.abs(got.colors - expected.colors.numpy()).max()),
            ]
        )
    position, scale, color = np.max(errors, 0)
    return ExportCheck(float(position), float(scale), float(color), len(frames))
