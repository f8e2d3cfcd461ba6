"""The compiled rasterizer in training: exact forward and backward on the CPU, float32."""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gavatar.protocols import Background, Rasterizer
from gavatar.registry import RASTERIZERS, RasterizerTraits
from gavatar_runtime import native_library as nl
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.rasterizers import SWITCHES
from gavatar_runtime.render.rasterizers.native_options import NativeOptions
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering

SPARE_FRAMES = 16  # frames whose memory waits for the next forward; a batch has fewer


@dataclasses.dataclass
class NativeRasterizerConfig(NativeOptions):
    """The player's options. Those that change the picture change its gradients with it. A bundle keeps them and is
    played with them (`rasterizers.SWITCHES`), all but `threads` and `resolution`."""


def _traits(config: NativeRasterizerConfig) -> RasterizerTraits:
    return RasterizerTraits(
        devices=("cpu",),
        widens=not config.antialiased,
        resolution=config.resolution,
        played_with={name: getattr(config, name) for name in SWITCHES if getattr(config, name)},
    )


@RASTERIZERS.register(
    "native",
    config=NativeRasterizerConfig,
    summary="exact, differentiable, compiled for the CPU",
    needs="a C++ compiler at install, or the wheel",
    missing=lambda: nl.available()[1],
    traits=_traits,
)
class NativeRasterizer(Rasterizer):
    """Exact splatting of float32 CPU tensors, with gradients to every field and to the background.

    `rasterizer(gaussians, camera, background) -> Rendering`, following `gavatar_runtime.splatting_rule`.
    Results and
    gradients are the same to the last bit whatever the number of threads. Raises UserError for float64 or CUDA
    tensors, which rasterizer=torch takes, and where the kernel was not compiled.
    """

    def __init__(self, config: NativeRasterizerConfig | None = None):
        self.config = config or NativeRasterizerConfig()
        self._lib = nl.library()
        nl.set_threads(self.config.threads)
        self._spare: list[nl.Frame] = []
        self.stage_seconds: dict[str, float] = {}

    @property
    def wants_normals(self) -> bool:
        """Whether `Gaussians.normals` would be of use."""
        return self.config.backface > 0

    def __call__(self, gaussians: Gaussians, camera: Camera, background: Background = (1.0, 1.0, 1.0)) -> Rendering:
        fields = _checked(gaussians)
        background = torch.as_tensor(background, dtype=torch.float32)
        report = nl.ReportStruct()
        inputs = (*fields, background)
        keep = torch.is_grad_enabled() and any(x is not None and x.requires_grad for x in inputs)
        normals = _checked_normals(gaussians) if self.wants_normals else None
        small = self.config.drawn_by(camera)
        color, alpha, depth = _Splat.apply(*inputs, normals, small, self, report, keep)
        if small is not camera:
            color, alpha, depth = _enlarged(color, alpha, depth, camera)
        self.stage_seconds = {"project": report.project_s, "sort": report.sort_s, "blend": report.blend_s}
        return Rendering(color, alpha, depth, dropped=report.dropped)

    def take_frame(self) -> nl.Frame:
        return self._spare.pop() if self._spare else nl.Frame()

    def give_frame(self, frame: nl.Frame) -> None:
        if len(self._spare) < SPARE_FRAMES:
            self._spare.append(frame)


def _checked(gaussians: Gaussians) -> list[Tensor | None]:
    """The five fields, after UserError for what the kernel does not take and ValueError for shapes."""
    n = len(gaussians.means)
    shapes: dict[str, list[tuple[int, ...]]] = {
        "means": [(n, 3)],
        "scales": [(n,), (n, 3)],
        "colors": [(n, 3)],
        "opacities": [(n,)],
        "quaternions": [(n, 4)],
    }
    fields = []
    for name, allowed in shapes.items():
        value = getattr(gaussians, name)
        if value is not None:
            if value.device.type != "cpu" or value.dtype != torch.float32:
                raise UserError(
                    f"rasterizer=native takes float32 tensors on the CPU, got gaussians.{name} of {value.dtype} on "
                    f"{value.device}; use rasterizer=torch"
                )
            if tuple(value.shape) not in allowed:
                raise ValueError(f"gaussians.{name}: expected shape {allowed[0]}, got {tuple(value.shape)}")
        fields.append(value)
    return fields


def _checked_normals(gaussians: Gaussians) -> Tensor | None:
    normals = gaussians.normals
    if normals is None:
        return None
    if tuple(normals.shape) != tuple(gaussians.means.shape):
        raise ValueError(
            f"gaussians.normals: expected shape {tuple(gaussians.means.shape)}, got {tuple(normals.shape)}"
        )
    return normals.detach().to("cpu", torch.float32).contiguous()


def _enlarged(color: Tensor, alpha: Tensor, depth: Tensor, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """The images at the camera's size, linearly, as cv2.resize does it."""
    images = torch.cat((color, alpha[..., None], depth[..., None]), -1).permute(2, 0, 1)[None]
    large = torch.nn.functional.interpolate(images, (camera.height, camera.width), mode="bilinear", align_corners=False)
    large = large[0].permute(1, 2, 0)
    return large[..., :3], large[..., 3], large[..., 4]


class _Lease:
    """A frame in the hands of one autograd node; goes back to the rasterizer when the node does."""

    def __init__(self, owner: NativeRasterizer, frame: nl.Frame):
        self.owner, self.frame = owner, frame

    def __del__(self) -> None:
        self.owner.give_frame(self.frame)


def _pointer(tensor: Tensor | None) -> int | None:
    return None if tensor is None else tensor.data_ptr()


def _struct(fields: Sequence[Any], normals: Tensor | None) -> nl.GaussiansStruct:
    """fields: means, scales, colours, opacities and quaternions; the last two may be None."""
    columns = 3 if fields[1].ndim == 2 else 1
    return nl.GaussiansStruct(len(fields[0]), *map(_pointer, fields), _pointer(normals), columns)


class _Splat(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, means: Tensor, scales: Tensor, colors: Tensor, opacities: Tensor | None, quaternions: Tensor | None,
        background: Tensor, normals: Tensor | None, camera: Camera, owner: NativeRasterizer, report: nl.ReportStruct,
        keep: bool,
    ) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
        fields = [None if x is None else x.contiguous() for x in (means, scales, colors, opacities, quaternions)]
        lease = _Lease(owner, owner.take_frame())
        struct, camera_struct = _struct(fields, normals), nl.camera_struct(camera)
        options = owner.config.struct(background.tolist(), keep=keep)
        color = torch.empty((camera.height, camera.width, 3))
        alpha, depth = (torch.empty((camera.height, camera.width)) for _ in range(2))
        images = nl.ImagesStruct(_pointer(color), _pointer(alpha), _pointer(depth), None)
        pointers = (ctypes.byref(x) for x in (struct, camera_struct, options, images, report))
        nl.check(owner._lib.gv_forward(lease.frame.handle, *pointers))
        ctx.set_materialize_grads(False)  # an image without gradient costs nothing in the backward
        if keep:
            ctx.lease, ctx.camera, ctx.options, ctx.owner = lease, camera_struct, options, owner
            ctx.save_for_backward(*fields, color, alpha, depth)
        return color, alpha, depth

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor | None) -> tuple[Tensor | None, ...]:
        *fields, color, alpha, depth = ctx.saved_tensors
        given = [None if g is None else g.contiguous() for g in upstream]
        wanted = ctx.needs_input_grad[:5]
        grads = [
            torch.empty_like(x) if x is not None and (want or i == 0) else None
            for i, (x, want) in enumerate(zip(fields, wanted, strict=True))
        ]
        structs = (
            _struct(fields, None), ctx.camera, ctx.options,
            nl.ImagesStruct(*map(_pointer, (color, alpha, depth)), None),
            nl.ImagesStruct(*map(_pointer, given), None), nl.GradientsStruct(*map(_pointer, grads)),
            nl.BackwardReportStruct(),
        )  # fmt: skip
        nl.check(ctx.owner._lib.gv_backward(ctx.lease.frame.handle, *(ctypes.byref(x) for x in structs)))
        times = {"backward_blend": structs[-1].blend_s, "backward_project": structs[-1].project_s}
        ctx.owner.stage_seconds = {**ctx.owner.stage_seconds, **times}
        grads = [g if want else None for g, want in zip(grads, wanted, strict=True)]
        background = None
        if ctx.needs_input_grad[5] and given[0] is not None:
            background = torch.einsum("hw,hwc->c", 1 - alpha, given[0])
        return (*grads, background, None, None, None, None, None)
