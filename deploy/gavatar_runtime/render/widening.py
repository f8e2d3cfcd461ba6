"""Cameras nearer than those of training, whose finer pixels would show the gaps between Gaussians."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..splatting_rule import LOW_PASS
from ..values.camera import Camera
from ..values.gaussians import Gaussians


def as_trained(gaussians: Gaussians, camera: Camera, pixel: float | None) -> Gaussians:
    """The Gaussians for a camera whose pixels are finer than those of the training images.

    pixel: metres of the person that a training pixel spanned, None if that is not known. Drawing adds LOW_PASS square
    pixels to the variance of every splat. Training counted on it: Gaussians may have shrunk to specks that its coarser
    pixels alone made into a closed surface. A finer pixel adds less, so what is missing is added here, as by the
    smoothing filter of Mip-Splatting (Yu et al. 2024, section 4.1), but only for playing: nothing changes where pixels
    are as coarse as in training. NumPy arrays or torch tensors; scales (N,) or (N, 3). One depth, the mean one, serves
    all; not finite, or behind the camera, it changes nothing.
    """
    if pixel is None or not len(gaussians):
        return gaussians
    sample = gaussians.means[:: max(1, len(gaussians) // 256)]
    centre = np.array([float(x) for x in sample.mean(0)])
    depth = camera.T_camera_world[2, :3] @ centre + camera.T_camera_world[2, 3]
    # a plain float: one of NumPy's would make float32 scales float64
    missing = float(LOW_PASS * (pixel**2 - (2 * depth / (camera.fx + camera.fy)) ** 2))
    if not (depth > 0 and missing > 0):  # written so that NaN changes nothing
        return gaussians
    return _widened(gaussians, missing)


def as_filmed(gaussians: Gaussians, pixel: float | None) -> Gaussians:
    """The Gaussians as the training images showed them, for programs of others, which know nothing of those: with all
    that drawing added there, so that they close up at any distance. pixel: as for `as_trained`."""
    if pixel is None or not len(gaussians):
        return gaussians
    return _widened(gaussians, float(LOW_PASS * pixel**2))


def _widened(gaussians: Gaussians, variance: float) -> Gaussians:
    return dataclasses.replace(gaussians, scales=(gaussians.scales * gaussians.scales + variance) ** 0.5)
