"""The rasterizer of the gsplat package: forward and backward on CUDA."""

from __future__ import annotations

import dataclasses
import math
import subprocess
from collections.abc import Callable
from types import ModuleType

import torch
from torch import Tensor

from gavatar.optional import import_from_extra
from gavatar.protocols import Background, Rasterizer
from gavatar.registry import RASTERIZERS, RasterizerTraits
from gavatar_runtime.errors import UserError
from gavatar_runtime.splatting_rule import LOW_PASS, NEAR
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering

from .torch_projection import FIELDS, finite_mask

OLDEST = (1, 5)  # before it the support ended at 3 sigma, where alpha is still 2.8 / 255
TILE_SIZES = (8, 16)  # a tile's pixels are the threads of one CUDA block: whole warps, and no more than registers allow

# gsplat draws what lies on the near plane, the rule does not
_JUST_BEYOND_NEAR = torch.nextafter(torch.tensor(NEAR), torch.tensor(math.inf)).item()


@dataclasses.dataclass
class GsplatRasterizerConfig:
    """tile_size: pixels on a side. It does not change the picture."""

    tile_size: int = 16

    def __post_init__(self) -> None:
        if self.tile_size not in TILE_SIZES:
            raise UserError(f"rasterizer.tile_size must be one of {TILE_SIZES} for gsplat, got {self.tile_size}")


def _missing() -> str:
    """Why it cannot be had here, as far as can be told without compiling; '' if nothing speaks against it."""
    try:
        _package()
    except UserError as error:
        return str(error)
    return ""


@RASTERIZERS.register(
    "gsplat",
    config=GsplatRasterizerConfig,
    summary="differentiable, compiled for CUDA by the gsplat package",
    needs="pip install 'gavatar[gpu]', a CUDA device and, at first use, nvcc",
    missing=_missing,
    traits=RasterizerTraits(devices=("cuda",)),
)
class GsplatRasterizer(Rasterizer):
    """Splatting of float32 CUDA tensors, with gradients to every field and to the background.

    `rasterizer(gaussians, camera, background) -> Rendering`, as `gavatar_runtime.splatting_rule` says, but
    for what is fixed in gsplat's kernels (gsplat 1.5.3, `RasterizeToPixels3DGS{Fwd,Bwd}.cu`, `Utils.cuh`):

    - alpha is clamped at 0.999, not at ALPHA_MAX, and a clamped alpha passes no gradient to the geometry and opacity
      (docs/reference/rasterizers.md has what that makes: 66 dB and more);
    - a pixel stops at a transmittance of exactly TRANSMITTANCE_STOP too;
    - the determinant of the 2D covariance is a difference of float32 products: a splat some thousand times longer than
      the low-pass filter is wide, and slanting, is rounded, or left out where the difference comes out negative;
    - gradients are sums of atomic additions, whose last bits differ from run to run.

    The kernels are compiled when a rasterizer is first built on a machine, which takes minutes, and kept by torch.
    Raises UserError without gsplat, without a CUDA device, where the kernels do not compile, and for tensors that are
    not float32 on CUDA.
    """

    def __init__(self, config: GsplatRasterizerConfig | None = None):
        self.config = config or GsplatRasterizerConfig()
        self._rasterization = _load()

    def __call__(self, gaussians: Gaussians, camera: Camera, background: Background = (1.0, 1.0, 1.0)) -> Rendering:
        _check(gaussians)
        finite = finite_mask(gaussians)
        dropped = len(finite) - int(finite.sum())
        if dropped:
            fields = (getattr(gaussians, name) for name in FIELDS)
            gaussians = Gaussians(*(None if value is None else value[finite] for value in fields))
        features, alpha = self._splat(gaussians, camera)
        background = torch.as_tensor(background, dtype=alpha.dtype, device=alpha.device)
        color = features[..., :3] + (1 - alpha)[..., None] * background
        return Rendering(color, alpha, features[..., 3], dropped)

    def _splat(self, gaussians: Gaussians, camera: Camera) -> tuple[Tensor, Tensor]:
        """(H, W, 4) colour and depth without background, and (H, W) alpha."""
        means, n = gaussians.means, len(gaussians)
        if n == 0:  # gsplat divides by it; the sum keeps the graph
            nothing = means.sum() + gaussians.colors.sum() + means.new_zeros((camera.height, camera.width, 4))
            return nothing, nothing[..., 0]
        scales, opacities = gaussians.scales, gaussians.opacities
        intrinsics = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
        images, alphas, _ = self._rasterization(
            means,
            _quaternions(gaussians),
            scales[:, None].expand(n, 3) if scales.ndim == 1 else scales,
            means.new_ones(n) if opacities is None else opacities,
            gaussians.colors,
            means.new_tensor(camera.T_camera_world.tolist())[None],
            means.new_tensor(intrinsics)[None],
            camera.width,
            camera.height,
            near_plane=_JUST_BEYOND_NEAR,
            far_plane=math.inf,
            eps2d=LOW_PASS,
            packed=False,
            tile_size=self.config.tile_size,
            render_mode="RGB+D",
        )
        return images[0], alphas[0, ..., 0]


def _quaternions(gaussians: Gaussians) -> Tensor:
    """(N, 4); the identity where there is none, and in place of a zero, which gsplat would divide by."""
    identity = gaussians.means.new_tensor([1.0, 0, 0, 0])
    quaternions = gaussians.quaternions
    if quaternions is None:
        return identity.expand(len(gaussians), 4)
    return torch.where((quaternions == 0).all(1, keepdim=True), identity, quaternions)


def _check(gaussians: Gaussians) -> None:
    for name in FIELDS:
        value = getattr(gaussians, name)
        if value is not None and (value.device.type != "cuda" or value.dtype != torch.float32):
            raise UserError(
                f"rasterizer=gsplat takes float32 tensors on CUDA, got gaussians.{name} of {value.dtype} on "
                f"{value.device}; use rasterizer=auto"
            )


def _load() -> Callable[..., tuple[Tensor, Tensor, dict]]:
    """`gsplat.rasterization` with its kernels in memory, compiled if need be; UserError for what is missing."""
    gsplat = _package()
    try:
        from gsplat.cuda._backend import _C as kernels
    except (ImportError, OSError, RuntimeError, subprocess.CalledProcessError) as error:
        cause = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise UserError(f"rasterizer=gsplat: the kernels of gsplat do not compile here ({cause})") from error
    if kernels is None:
        raise UserError("rasterizer=gsplat: gsplat has no compiled kernels and found no nvcc to compile them with")
    return gsplat.rasterization


def _package() -> ModuleType:
    """The package, where it is new enough and there is a device for it; else UserError."""
    gsplat = import_from_extra("gsplat", "rasterizer=gsplat")
    if tuple(int(part) for part in gsplat.__version__.split(".")[:2]) < OLDEST:
        raise UserError(
            f"rasterizer=gsplat needs gsplat 1.5 or later, found {gsplat.__version__}: pip install -U gsplat"
        )
    if not torch.cuda.is_available():
        raise UserError("rasterizer=gsplat needs a CUDA device, and torch sees none: use rasterizer=auto")
    return gsplat
