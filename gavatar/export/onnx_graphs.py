"""ONNX graphs of an avatar's networks, with the rewrites that change no result: BatchNorm and feature smoothing folded
away, transposed convolutions as convolution + pixel shuffle, the decoder in chunks of rows that stay in the cache."""

from __future__ import annotations

import copy
import io
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

from gavatar_runtime.decoding.network import CHUNK, ROWS
from gavatar_runtime.decoding.pose_inputs import input_shape
from gavatar_runtime.tiers.members import OUTPUTS, POSE_FEATURES
from gavatar_runtime.values.surface import Surface

from ..avatar.trainable import Avatar
from ..avatar.uv_sampling import bilinear, sample_uv

OPSET = 18
# the model of a chunk of rows, its inputs by name, features to add or None -> the model with quantised layers
Quantize = Callable[[onnx.ModelProto, dict[str, np.ndarray], np.ndarray | None], onnx.ModelProto]


def fold_batchnorm(module: nn.Module) -> nn.Module:
    """A copy of `module` in eval mode in which every BatchNorm that follows a linear or (transposed) convolution layer
    within an nn.Sequential is folded into it: the same function as evaluated, one operation less."""
    module = copy.deepcopy(module).eval()
    for parent in list(module.modules()):
        if isinstance(parent, nn.Sequential):
            _fold_sequential(parent)
    return module


def _fold_sequential(layers: nn.Sequential) -> None:
    for i in range(len(layers) - 1):
        layer, norm = layers[i], layers[i + 1]
        if isinstance(layer, nn.Linear) and isinstance(norm, nn.BatchNorm1d):
            layers[i] = fuse_linear_bn_eval(layer, norm)
        elif isinstance(layer, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
            layers[i] = fuse_conv_bn_eval(layer, norm)
        elif isinstance(layer, nn.ConvTranspose2d) and isinstance(norm, nn.BatchNorm2d):
            layers[i] = fuse_conv_bn_eval(layer, norm, transpose=True)
        else:
            continue
        layers[i + 1] = nn.Identity()


def subpixel(module: nn.Module) -> nn.Module:
    """A copy of `module` in which every ConvTranspose2d of kernel 4, stride 2 and padding 1 is a 3x3 convolution with
    four times the channels and a pixel shuffle: the same sums in another order.

    Output row 2i + a of the transposed convolution takes input rows i - 1 and i (a = 0) or i and i + 1 (a = 1), by taps
    3, 1 and 2, 0 of its kernel.
    """
    module = copy.deepcopy(module)
    for parent in list(module.modules()):
        for name, child in parent.named_children():
            if isinstance(child, nn.ConvTranspose2d) and _doubles(child):
                setattr(parent, name, _as_subpixel(child))
    return module


def _doubles(layer: nn.ConvTranspose2d) -> bool:
    shape = (layer.kernel_size, layer.stride, layer.padding, layer.output_padding, layer.dilation, layer.groups)
    return shape == ((4, 4), (2, 2), (1, 1), (0, 0), (1, 1), 1)


def _as_subpixel(layer: nn.ConvTranspose2d) -> nn.Sequential:
    taps = {0: {0: 3, 1: 1}, 1: {1: 2, 2: 0}}  # output phase -> row of the 3x3 kernel -> row of the 4x4 one
    weight = layer.weight.detach()
    inside, outside = weight.shape[:2]
    kernel = weight.new_zeros(outside, 2, 2, inside, 3, 3)
    for a, rows in taps.items():
        for b, columns in taps.items():
            for r, ky in rows.items():
                for c, kx in columns.items():
                    kernel[:, a, b, :, r, c] = weight[:, :, ky, kx].T
    conv = nn.Conv2d(inside, 4 * outside, 3, padding=1, bias=layer.bias is not None)
    conv.weight.data = kernel.reshape(4 * outside, inside, 3, 3)
    if layer.bias is not None and conv.bias is not None:
        conv.bias.data = layer.bias.detach().repeat_interleave(4)
    return nn.Sequential(conv, nn.PixelShuffle(2))


class RowDecoder(nn.Module):
    """The decoder for a chunk of P points, as the body of a loop over chunks.

    texels: (M * M, C), the map to sample (the learnable features, smoothed once, already added where the maps are of
    one size; else their samples are `constant`, (P, C)). corner, corner_weight: (P, 4), see `bilinear`: gathering
    rows is several times faster than ONNX Runtime's GridSample.
    """

    def __init__(self, avatar: Avatar):
        super().__init__()
        self.decoder = fold_batchnorm(avatar.decoder)

    def forward(
        self,
        texels: Tensor,
        corner: Tensor,
        corner_weight: Tensor,
        uv: Tensor,
        spacing: Tensor,
        constant: Tensor | None = None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        sampled = texels[corner[:, 0]] * corner_weight[:, :1]
        for k in range(1, 4):
            sampled = sampled + texels[corner[:, k]] * corner_weight[:, k : k + 1]
        if constant is not None:
            sampled = sampled + constant
        out = self.decoder(sampled, uv, spacing)
        return out.offsets, out.colors, out.scales


def to_onnx(module: nn.Module, example: tuple[Tensor, ...], inputs: list[str], outputs: list[str]) -> onnx.ModelProto:
    """The traced module as an ONNX model of `OPSET`."""
    buffer: Any = io.BytesIO()  # this exporter writes to what is open too, which its types do not say
    with warnings.catch_warnings():
        # torch.export's exporter gives the same graph 25 times slower and with one more dependency
        warnings.simplefilter("ignore")
        torch.onnx.export(
            module, example, buffer, input_names=inputs, output_names=outputs, opset_version=OPSET, dynamo=False
        )
    return onnx.load_from_string(buffer.getvalue())


def encoder_model(avatar: Avatar, *, shuffle: bool = False) -> onnx.ModelProto:
    """The encoder's inputs of one pose, by name -> pose_features (1, C, M, M). shuffle: `subpixel` convolutions, which
    are slower in float32 (28 ms against 18) and what 8-bit arithmetic needs: ONNX Runtime has no ConvTranspose in it.
    """
    names = avatar.encoder_traits.inputs
    example = tuple(torch.zeros(1, *input_shape(name, avatar.encoder.map_size)) for name in names)
    encoder = fold_batchnorm(avatar.encoder)
    if shuffle:
        encoder = subpixel(encoder)
    return to_onnx(encoder, example, list(names), [POSE_FEATURES])


def decoder_model(avatar: Avatar, surface: Surface | None = None, quantize: Quantize | None = None) -> onnx.ModelProto:
    """pose_features -> offsets (N, 3), colors (N, 3), scales (N,) on the points of `surface` (None for the avatar's);
    without input for a static avatar, whose decoder does not depend on the pose and is evaluated here once and for all.
    A second input, `rows` (M,) int32, may be given: then only those points are decoded, in its order, and N is M. (It
    is an initializer that may be overridden, so that a caller who does not know of it gets them all.)

    quantize: a function (rows, scanned, features) -> rows, or None. rows: the model of one chunk, whose inputs are
    `texels` and one row of each array in `scanned`; features (1, C, M, M) are added to the pose features, or None.
    """
    surface = surface or avatar.surface
    if avatar.encoder is None:
        with torch.no_grad():
            attributes = avatar.sampled(surface).attributes()
        return constant_model({name: getattr(attributes, name)[0].numpy() for name in OUTPUTS})
    size, channels = avatar.encoder.map_size, avatar.config.features
    chunk = min(CHUNK, len(surface))
    features = avatar.smooth(avatar.features).detach()
    add_first = features.shape[-1] == size
    corner, weight = bilinear(surface.uv, size)
    scanned = {"corner": corner, "corner_weight": weight, "uv": surface.uv, "spacing": surface.spacing}
    if not add_first:
        with torch.no_grad():
            scanned["constant"] = sample_uv(features, torch.from_numpy(np.asarray(surface.uv, np.float32)))[0].numpy()
    example = (torch.zeros(size * size, channels), *(torch.from_numpy(x[:chunk]) for x in scanned.values()))
    rows = to_onnx(RowDecoder(avatar).eval(), example, ["texels", *scanned], list(OUTPUTS))
    if quantize is not None:
        inputs = {i.name for i in rows.graph.input}
        chunked = {name: _padded(values, chunk) for name, values in scanned.items() if name in inputs}
        rows = quantize(rows, chunked, features.numpy() if add_first else None)
    constants = {"features": features.numpy()} if add_first else {}
    return _scan_model(rows, scanned, constants, (1, channels, size, size), chunk)


def _padded(array: np.ndarray, chunk: int) -> np.ndarray:
    """(N, ...) -> (chunks, chunk, ...), the last row repeated."""
    array = np.asarray(array)
    missing = -len(array) % chunk
    return np.concatenate([array, np.repeat(array[-1:], missing, 0)]).reshape(-1, chunk, *array.shape[1:])


def _scan_model(rows: onnx.ModelProto, scanned: dict, constants: dict, shape: tuple, chunk: int) -> onnx.ModelProto:
    """A loop (ONNX Scan) of `rows` over chunks of the wanted rows of the `scanned` arrays (N, ...), its outputs joined;
    weights stand in the loop's body, once."""
    body = copy.deepcopy(rows.graph)
    for info in [i for i in body.input if i.name == "texels"]:
        body.input.remove(info)  # found in the scope outside
    scanned = {info.name: scanned[info.name] for info in body.input}  # the tracer leaves out what a decoder ignores
    count = len(next(iter(scanned.values())))
    nodes, initializers = [], []

    def constant(name: str, value: np.ndarray) -> str:
        initializers.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def node(kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    constant(ROWS, np.arange(count, dtype=np.int32))
    total = POSE_FEATURES
    if "features" in constants:
        total = node("Add", [total, constant("features", constants["features"])], "all_features")
    flat = node("Reshape", [total, constant("map_shape", np.array([shape[1], -1], np.int64))], "channels_first")
    node("Transpose", [flat], "texels", perm=[1, 0])
    # the wanted rows, filled up to whole chunks by row 0
    wanted = node("Shape", [ROWS], "wanted")
    negative = node("Neg", [wanted], "negative")
    missing = node("Mod", [negative, constant("chunk", np.array([chunk], np.int64))], "missing")
    ends = node("Concat", [constant("first", np.zeros(1, np.int64)), missing], "ends", axis=0)
    filled = node("Pad", [ROWS, ends], "filled_rows")
    for name, values in scanned.items():
        taken = node("Gather", [constant(f"all_{name}", values), filled], f"taken_{name}", axis=0)
        place = constant(f"chunks_{name}", np.array([-1, chunk, *np.shape(values)[1:]], np.int64))
        node("Reshape", [taken, place], f"scanned_{name}")
    stacked = [f"stacked_{name}" for name in OUTPUTS]
    scan = helper.make_node("Scan", [f"scanned_{k}" for k in scanned], stacked, body=body, num_scan_inputs=len(scanned))
    nodes.append(scan)
    outputs = []
    constant("axis", np.zeros(1, np.int64))
    for name, tail in (("offsets", (3,)), ("colors", (3,)), ("scales", ())):
        joined = node("Reshape", [f"stacked_{name}", constant(f"shape_{name}", np.array([-1, *tail], np.int64))],
                      f"joined_{name}")  # fmt: skip
        node("Slice", [joined, "first", wanted, "axis"], name)
        outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, ("gaussians", *tail)))
    inputs = [
        helper.make_tensor_value_info(POSE_FEATURES, TensorProto.FLOAT, shape),
        helper.make_tensor_value_info(ROWS, TensorProto.INT32, ("gaussians",)),
    ]
    graph = helper.make_graph(nodes, "decoder", inputs, outputs, initializers)
    return helper.make_model(graph, opset_imports=list(rows.opset_import), ir_version=rows.ir_version)


def constant_model(values: dict[str, np.ndarray]) -> onnx.ModelProto:
    """A model without inputs that returns `values`."""
    nodes, initializers, outputs = [], [], []
    for name, value in values.items():
        value = np.ascontiguousarray(value, np.float32)
        initializers.append(numpy_helper.from_array(value, f"{name}_value"))
        nodes.append(helper.make_node("Identity", [f"{name}_value"], [name]))
        outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, value.shape))
    graph = helper.make_graph(nodes, "static_avatar", [], outputs, initializers)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=9)


def with_metadata(model: onnx.ModelProto, properties: Mapping[str, str]) -> bytes:
    """The checked model's bytes, with what a stranger needs to know in its metadata_props."""
    helper.set_model_props(model, dict(properties))
    onnx.checker.check_model(model)
    return model.SerializeToString()
