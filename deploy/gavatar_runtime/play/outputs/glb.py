"""Gaussians as glTF with the extension KHR_gaussian_splatting: splats to viewers that know it, points to all others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...formats.glb_file import GlbFile
from ...values.gaussians import Gaussians
from .gaussian_files import GaussianFileOptions, GaussianFiles
from .output import OUTPUTS
from .splat_values import axes, harmonics, opacities, unit_quaternions

EXTENSION = "KHR_gaussian_splatting"
POINTS = 0  # the mode of a primitive
# What a viewer has to know of the numbers; the two that the format would assume anyway are left out.
NATURE = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}


@OUTPUTS.register(
    "glb",
    config=GaussianFileOptions,
    summary="Gaussians as .glb with KHR_gaussian_splatting, or one a frame: NAME/%06d.glb",
)
class GlbOutput(GaussianFiles):
    """One mesh of points in one node. Metres; y points up and z to the viewer, as our world has them.

    See `gaussian_primitive`. An avatar that moves in a .glb is `gavatar-convert`'s.
    """

    suffixes = (".glb", "%d.glb")

    def encode(self, gaussians: Gaussians) -> bytes:
        file = GlbFile()
        node: dict[str, Any] = {"name": "gaussians"}
        if len(gaussians):  # a mesh without points is none to the format
            node["mesh"] = file.add("meshes", {"primitives": [gaussian_primitive(file, gaussians)]})
        file.document |= {"scene": 0, "scenes": [{"nodes": [file.add("nodes", node)]}]}
        return file.to_bytes()


def gaussian_primitive(file: GlbFile, gaussians: Gaussians, more: Mapping[str, int] | None = None) -> dict:
    """The primitive of at least one Gaussian, whose arrays go into the file.

    POSITION; of the extension ROTATION (xyzw, of length 1), SCALE (standard deviations, linear), OPACITY (linear) and
    SH_DEGREE_0_COEF_0, all float32. COLOR_0 for viewers that draw points: linear light, as glTF has it, with the
    opacity; float32 too, since some readers take whole numbers of 16 bits for bytes. more: accessors of further
    attributes by name.
    """
    opacity = opacities(gaussians)
    quaternions = unit_quaternions(gaussians)[:, [1, 2, 3, 0]]
    fallback = np.column_stack([linear_light(np.clip(gaussians.colors, 0, 1)), opacity])
    attributes = {"POSITION": file.accessor(np.asarray(gaussians.means, np.float32), vertices=True, bounds=True)}
    splats = {"ROTATION": quaternions, "SCALE": axes(gaussians), "OPACITY": opacity}
    splats["SH_DEGREE_0_COEF_0"] = harmonics(gaussians)
    for name, values in splats.items():
        attributes[f"{EXTENSION}:{name}"] = file.accessor(values.astype(np.float32), vertices=True)
    attributes["COLOR_0"] = file.accessor(fallback.astype(np.float32), vertices=True)
    file.document["extensionsUsed"] = [EXTENSION]
    return {"mode": POINTS, "attributes": attributes | dict(more or {}), "extensions": {EXTENSION: dict(NATURE)}}


def linear_light(colors: np.ndarray) -> np.ndarray:
    """sRGB in [0, 1] -> linear light in [0, 1] (IEC 61966-2-1)."""
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
