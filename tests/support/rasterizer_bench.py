"""What every rasterizer's test needs: which ones there are, and the judge of their pictures.

The judge has two tiers. Where the reference made every decision of the rule with room to spare, a picture must agree to
rounding. Where some decision was close (`Reference.doubtful`), a float32 rasterizer may decide the other way: such
pixels may differ by anything, but only few of them.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference_splat
import torch
from splat_scenes import as_torch

from gavatar.registry import RASTERIZERS, load_plugins
from gavatar_runtime.errors import UserError
from gavatar_runtime.splatting_rule import ALPHA_MAX
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering

load_plugins()
FLIPS = 1e-3  # of the pixels may have decided otherwise: the project's bound on threshold flips


@dataclasses.dataclass(frozen=True)
class Target:
    """A rasterizer on a device, and how exactly it follows the rule there.

    tolerance: of colours and alpha in [0, 1] where nothing is in doubt. slack: its relative error of an alpha or a
    transmittance, at most. gradient: relative L2 error of a gradient. alpha_max, through_clamp: its clamp of alpha.
    """

    name: str
    device: str
    # float32: exponents up to 5.5 with an error of some units in the last place (6e-8), summed over some ten layers;
    # measured 3e-6 at 512x512 (native 1.7e-6, torch 2.9e-6, numpy 2.1e-6)
    tolerance: float = 1e-5
    slack: float = 2e-4
    # sums of thousands of such terms that cancel; measured 1e-5 (native) and 6e-5 (torch). The project's bound is 1e-3
    gradient: float = 2e-4
    alpha_max: float = ALPHA_MAX
    through_clamp: bool = True

    @property
    def fast(self) -> bool:
        """Whether a million Gaussians, or 16 million pixels, take less than seconds."""
        return self.device == "cuda" or self.name == "native" or (self.name == "auto" and _builds("native"))

    def build(self):
        """The rasterizer; skips the test, with the reason, where it cannot be had."""
        if self.device == "cuda" and not torch.cuda.is_available():
            pytest.skip("torch sees no CUDA device")
        try:
            return RASTERIZERS.build(self.name)
        except UserError as error:
            pytest.skip(str(error))

    def draw(self, scene: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0), dtype=torch.float32) -> Rendering:
        """The picture as NumPy arrays, from a scene of NumPy arrays."""
        with torch.no_grad():
            out = self.build()(self.tensors(scene, dtype), camera, background)
        images = (image.cpu().numpy() for image in (out.color, out.alpha, out.depth))
        return Rendering(*images, out.dropped)

    def tensors(self, scene: Gaussians, dtype=torch.float32) -> Gaussians:
        fields = dataclasses.asdict(as_torch(scene, dtype))
        return Gaussians(**{k: None if v is None else v.to(self.device) for k, v in fields.items()})

    def reference(
        self, scene: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0), **options
    ) -> reference_splat.Reference:
        """What this rasterizer should draw, of the scene as rounded to float32."""
        rounded = {k: None if v is None else np.asarray(v, np.float32) for k, v in vars(scene).items()}
        # depths are sums of three products: a few units in the last place
        options = {"alpha_max": self.alpha_max, "slack": self.slack, "depth_slack": 1e-6} | options
        return reference_splat.render(Gaussians(**rounded), camera, background, **options)

    def __str__(self) -> str:
        return f"{self.name}-{self.device}"


def target(name: str, device: str) -> Target:
    if name == "gsplat" or (name == "auto" and device == "cuda" and _builds("gsplat")):
        # gsplat is compiled with -use_fast_math: exponentials and quotients good to 1e-6, times exponents up to 5.5.
        # Its own tests hold pictures to 1e-4
        return Target(name, device, 1e-4, 1e-3, 1e-3, alpha_max=0.999, through_clamp=False)
    return Target(name, device)


def _builds(name: str) -> bool:
    try:
        return bool(RASTERIZERS.build(name))
    except UserError:
        return False


TARGETS = [target(name, device) for name in RASTERIZERS.names() for device in RASTERIZERS.traits(name).devices]
every = pytest.mark.parametrize("target", TARGETS, ids=str)
every_differentiable = pytest.mark.parametrize(
    "target", [t for t in TARGETS if RASTERIZERS.traits(t.name).differentiable], ids=str
)


def judge(target: Target, got: Rendering, expected: reference_splat.Reference) -> None:
    """Fails the test where `got` is not `expected`."""
    deepest = max(1.0, float(expected.depth.max()))
    pairs = [(got.color, expected.color, 1.0), (got.alpha, expected.alpha, 1.0), (got.depth, expected.depth, deepest)]
    flipped = np.zeros_like(expected.doubtful)
    for name, (mine, exact, unit) in zip(("color", "alpha", "depth"), pairs, strict=True):
        error = np.abs(np.asarray(mine, np.float64) - exact) / unit
        error = error.max(-1) if error.ndim == 3 else error
        assert np.isfinite(error).all(), f"{name} is not finite"
        wrong = (error > target.tolerance) & ~expected.doubtful
        assert not wrong.any(), (
            f"{name} is off by {error[wrong].max():.2e} at {int(wrong.sum())} pixels, the first at row, column "
            f"{tuple(np.argwhere(wrong)[0])}"
        )
        flipped |= error > target.tolerance
    # one pixel in a small picture is more than the bound, and no fault
    assert flipped.sum() <= max(2, FLIPS * flipped.size), f"{int(flipped.sum())} pixels decided otherwise"
    assert got.dropped == expected.dropped


def check(target: Target, scene: Gaussians, camera: Camera, background=(0.2, 0.5, 0.9)) -> None:
    """The target draws the scene as the reference does."""
    judge(target, target.draw(scene, camera, background), target.reference(scene, camera, background))
