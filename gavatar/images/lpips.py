"""LPIPS 0.1 (Zhang et al. 2018) with weights that the user provides.

Two files are needed and neither is shipped: torchvision's ImageNet checkpoint of the backbone, and LPIPS's linear
weights, which the PyPI package `lpips` carries. Only the files are used: neither `lpips` nor torchvision is imported.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import pathlib
import pickle

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gavatar_runtime.errors import UserError, did_you_mean

BACKBONE_VARIABLE = "GAVATAR_LPIPS_BACKBONE"
MIN_SIZE = 32  # AlexNet's last pooling needs 31 pixels
# LPIPS's own normalisation, of images in [-1, 1]
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
UNIT_EPS = 1e-10


@dataclasses.dataclass(frozen=True)
class Backbone:
    """A torchvision classifier up to its last comparison.

    title: how the metric is called. checkpoint: torchvision's file name. pool: kernel of the stride-2 max pooling.
    slices: per comparison whether pooling comes first, and its convolutions, each followed by ReLU, as (channels out,
    kernel, stride, padding).
    """

    title: str
    checkpoint: str
    pool: int
    slices: tuple[tuple[bool, tuple[tuple[int, int, int, int], ...]], ...]


BACKBONES = {
    "alex": Backbone(
        "LPIPS 0.1 (AlexNet)",
        "alexnet-owt-7be5be79.pth",
        3,
        (
            (False, ((64, 11, 4, 2),)),
            (True, ((192, 5, 1, 2),)),
            (True, ((384, 3, 1, 1),)),
            (False, ((256, 3, 1, 1),)),
            (False, ((256, 3, 1, 1),)),
        ),
    ),
    "vgg": Backbone(
        "LPIPS 0.1 (VGG16)",
        "vgg16-397923af.pth",
        2,
        tuple(
            (first > 0, ((channels, 3, 1, 1),) * repeats)
            for first, (channels, repeats) in enumerate(((64, 2), (128, 2), (256, 3), (512, 3), (512, 3)))
        ),
    ),
}


class Lpips(nn.Module):
    """LPIPS of (B, 3, H, W) images in [0, 1] -> (B,), the second image without gradient.

    net: 'alex' or 'vgg'. backbone, linear: weight files, '' for the usual places (see `find_backbone`, `find_linear`).
    Images smaller than 32 pixels are continued by their edge. Raises UserError when weights are missing or are not
    those of `net`.
    """

    def __init__(self, net: str = "alex", backbone: str = "", linear: str = ""):
        super().__init__()
        if net not in BACKBONES:
            raise UserError(f"lpips: unknown net '{net}': {did_you_mean(net, BACKBONES)}")
        self.backbone = BACKBONES[net]
        self.title = self.backbone.title
        # the files are found before either is read, so that what is missing is said first
        files = find_backbone(net, backbone), find_linear(net, linear)
        self.slices = _load_slices(self.backbone, files[0])
        channels = [convolutions[-1][0] for _, convolutions in self.backbone.slices]
        state = _read(files[1])
        for i, width in enumerate(channels):
            weight = _take(state, f"lin{i}.model.1.weight", (1, width, 1, 1), files[1], self.title)
            self.register_buffer(f"linear{i}", weight)
        self.shift: Tensor
        self.scale: Tensor
        self.register_buffer("shift", torch.tensor(SHIFT)[:, None, None])
        self.register_buffer("scale", torch.tensor(SCALE)[:, None, None])
        self.requires_grad_(False)

    def forward(self, image: Tensor, reference: Tensor) -> Tensor:
        dtype = image.dtype if image.dtype == torch.float64 else torch.float32
        if (self.shift.device, self.shift.dtype) != (image.device, dtype):
            self.to(image.device, dtype)
        with torch.no_grad():
            expected = self._features(reference.to(dtype))
        total = image.new_zeros(len(image), dtype=dtype)
        for i, (found, wanted) in enumerate(zip(self._features(image.to(dtype)), expected, strict=True)):
            difference = (_unit(found) - _unit(wanted)).square()
            total = total + (difference * getattr(self, f"linear{i}")).sum(1).mean((-2, -1))
        return total

    def _features(self, images: Tensor) -> list[Tensor]:
        H, W = images.shape[-2:]
        if min(H, W) < MIN_SIZE:
            images = F.pad(images, (0, max(0, MIN_SIZE - W), 0, max(0, MIN_SIZE - H)), mode="replicate")
        x, features = (2 * images - 1 - self.shift) / self.scale, []
        for (pooled, _), convolutions in zip(self.backbone.slices, self.slices, strict=True):
            if pooled:
                x = F.max_pool2d(x, self.backbone.pool, 2)
            for convolution in convolutions.children():
                x = F.relu(convolution(x))
            features.append(x)
        return features


def _unit(x: Tensor) -> Tensor:
    # the square root is kept off zero, where its gradient is infinite: squares of tiny features underflow
    return x / (torch.sqrt(x.square().sum(1, keepdim=True) + UNIT_EPS**2) + UNIT_EPS)


def find_backbone(net: str, path: str = "") -> pathlib.Path:
    """The checkpoint of `net`: `path`, else the environment variable GAVATAR_LPIPS_BACKBONE (either may name the file
    or the folder it lies in), else torch's download folder; UserError saying what to download and where to put it."""
    name = BACKBONES[net].checkpoint
    for source, place in (("lpips.backbone", path), (BACKBONE_VARIABLE, os.environ.get(BACKBONE_VARIABLE, ""))):
        if place:
            file = pathlib.Path(place).expanduser()
            file = file / name if file.is_dir() else file
            if not file.is_file():
                raise UserError(f"{source}: there is no file {file}; it must be torchvision's {name} or its folder")
            return file
    cached = pathlib.Path(torch.hub.get_dir()) / "checkpoints" / name
    if cached.is_file():
        return cached
    raise UserError(
        f"LPIPS needs the backbone {name}: download it from https://download.pytorch.org/models/{name} and name the "
        f"file in losses.lpips.backbone or in the environment variable {BACKBONE_VARIABLE}"
    )


def find_linear(net: str, path: str = "") -> pathlib.Path:
    """LPIPS's linear weights for `net`: `path`, else the file inside the installed `lpips` package; UserError."""
    if path:
        file = pathlib.Path(path).expanduser()
        if not file.is_file():
            raise UserError(
                f"lpips.linear: there is no file {file}; it must be weights/v0.1/{net}.pth of package lpips"
            )
        return file
    package = importlib.util.find_spec("lpips")
    for folder in (package and package.submodule_search_locations) or ():
        file = pathlib.Path(folder) / "weights" / "v0.1" / f"{net}.pth"
        if file.is_file():
            return file
    raise UserError(
        "LPIPS needs the linear weights of the lpips package: pip install --no-deps lpips "
        "(or name its file weights/v0.1/" + net + ".pth in losses.lpips.linear)"
    )


def _load_slices(backbone: Backbone, file: pathlib.Path) -> nn.ModuleList:
    """The convolutions with torchvision's weights, whose numbering also counts each ReLU and pooling."""
    state, slices, number, channels = _read(file), nn.ModuleList(), 0, 3
    for pooled, convolutions in backbone.slices:
        number += pooled
        layers = nn.ModuleList()
        for width, kernel, stride, padding in convolutions:
            layer = nn.Conv2d(channels, width, kernel, stride, padding)
            for field in ("weight", "bias"):
                shape = tuple(getattr(layer, field).shape)
                weight = _take(state, f"features.{number}.{field}", shape, file, backbone.title)
                setattr(layer, field, nn.Parameter(weight, requires_grad=False))
            layers.append(layer)
            channels, number = width, number + 2
        slices.append(layers)
    return slices


def _read(file: pathlib.Path) -> dict[str, Tensor]:
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
    except (RuntimeError, EOFError, OSError, pickle.UnpicklingError) as error:
        raise UserError(
            f"{file}: cannot be read as a torch checkpoint ({type(error).__name__}); download it anew"
        ) from None
    return state if isinstance(state, dict) else {}


def _take(state: dict[str, Tensor], key: str, shape: tuple[int, ...], file: pathlib.Path, title: str) -> Tensor:
    weight = state.get(key)
    if not isinstance(weight, Tensor) or tuple(weight.shape) != shape:
        raise UserError(f"{file}: holds no '{key}' of shape {shape}, so it is not the weights file of {title}")
    return weight.float()
