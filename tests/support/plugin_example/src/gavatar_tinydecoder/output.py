"""Gaussians as points for programs that know nothing else: a line of x y z r g b each."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gavatar_runtime.play.outputs import OUTPUTS, FrameFormat
from gavatar_runtime.play.outputs.gaussian_files import GaussianFiles
from gavatar_runtime.values.gaussians import Gaussians


@dataclasses.dataclass
class PointOptions:
    """digits: after the point, of a metre."""

    digits: int = 4


@OUTPUTS.register("points", config=PointOptions, summary="coloured points as text, an example of a third-party output")
class PointFile(GaussianFiles):
    suffixes = (".xyz", "%d.xyz")

    def __init__(self, options: PointOptions, *, path: Path, frames: FrameFormat):
        super().__init__(options, path=path, frames=frames)
        self.digits = options.digits

    def encode(self, gaussians: Gaussians) -> bytes:
        colors = np.rint(255 * np.clip(gaussians.colors, 0, 1)).astype(int)
        rows = zip(gaussians.means.tolist(), colors.tolist(), strict=True)
        lines = [" ".join([*(f"{x:.{self.digits}f}" for x in mean), *map(str, color)]) for mean, color in rows]
        return ("\n".join(lines) + "\n").encode("ascii")
