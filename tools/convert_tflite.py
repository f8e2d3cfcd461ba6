"""Convert MediaPipe's networks of bodies, hands and faces from .tflite to ONNX, once; the results lie in
gavatar/data/pose, hands and face.

    pip install ai-edge-litert onnx
    pip download --no-deps mediapipe==0.10.21 && unzip mediapipe-0.10.21-*.whl 'mediapipe/modules/*.tflite'
    python tools/convert_tflite.py mediapipe/modules/pose_detection/pose_detection.tflite pose_detection.onnx

Weights stay float16 as in the source and are cast when the session is made. tests/peers/test_pose_networks.py holds
each converted network to LiteRT's run of its source.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import onnx
from ai_edge_litert import schema_py_generated as schema
from ai_edge_litert.interpreter import Interpreter
from onnx import TensorProto, helper, numpy_helper

NAMES = {v: k for k, v in vars(schema.BuiltinOperator).items() if not k.startswith("_")}
TO_NCHW, TO_NHWC = [0, 3, 1, 2], [0, 2, 3, 1]
SOURCE = "MediaPipe (Apache-2.0, Copyright The MediaPipe Authors), converted from"


class Converter:
    """One .tflite graph rewritten in ONNX operators; 4-D activations are NCHW inside, NHWC at inputs and outputs."""

    def __init__(self, path: Path):
        self.path = path
        model = schema.ModelT.InitFromObj(schema.Model.GetRootAs(path.read_bytes(), 0))
        self.graph, self.codes = model.subgraphs[0], model.operatorCodes
        # the interpreter undoes float16 and sparse storage; without delegates every tensor can be read
        self.values = Interpreter(str(path), experimental_preserve_all_tensors=True,
                                  experimental_op_resolver_type=_builtin_resolver())  # fmt: skip
        self.values.allocate_tensors()
        self.values.invoke()
        self.nodes: list = []
        self.initializers: dict = {}
        self.constant = {i for i, t in enumerate(self.graph.tensors) if self._stored(t, model)}

    @staticmethod
    def _stored(tensor, model) -> bool:
        data = model.buffers[tensor.buffer].data
        return data is not None and len(data) > 0

    def name(self, index: int) -> str:
        return f"t{index}"

    def shape(self, index: int) -> list[int]:
        return [int(n) for n in self.graph.tensors[index].shape]

    def value(self, index: int) -> np.ndarray:
        return self.values.get_tensor(index)

    def add(self, kind: str, inputs: list[str], output: str, **attributes) -> str:
        self.nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def weight(self, name: str, array: np.ndarray) -> str:
        """A float32 tensor kept as float16 where that loses nothing (the source's own precision)."""
        half = array.astype(np.float16)
        if array.dtype == np.float32 and np.array_equal(half.astype(np.float32), array):
            self.initializers[name + "_f16"] = numpy_helper.from_array(half, name + "_f16")
            return self.add("Cast", [name + "_f16"], name, to=TensorProto.FLOAT)
        self.initializers[name] = numpy_helper.from_array(array, name)
        return name

    def integers(self, name: str, numbers) -> str:
        self.initializers[name] = numpy_helper.from_array(np.asarray(numbers, np.int64), name)
        return name

    def operand(self, index: int) -> str:
        """The ONNX name of an operator's input; constants are stored at first use, 4-D ones as NCHW."""
        name = self.name(index)
        if index in self.constant and name not in self.initializers and name + "_f16" not in self.initializers:
            array = self.value(index)
            self.weight(name, array.transpose(TO_NCHW) if array.ndim == 4 else array)
        return name

    def pads(self, index: int, stride, dilation, kernel, padding) -> list[int]:
        """TensorFlow's SAME padding, whose odd pixel goes to the end; VALID pads nothing."""
        if padding == schema.Padding.VALID:
            return [0, 0, 0, 0]
        before, after = [], []
        for size, s, d, k in zip(self.shape(index)[1:3], stride, dilation, kernel, strict=True):
            total = max((-(-size // s) - 1) * s + (k - 1) * d + 1 - size, 0)
            before.append(total // 2)
            after.append(total - total // 2)
        return before + after

    def activate(self, kind: int, source: str, output: str) -> None:
        kinds = schema.ActivationFunctionType
        if kind == kinds.RELU:
            self.add("Relu", [source], output)
        elif kind == kinds.RELU6:
            self.initializers["zero"] = numpy_helper.from_array(np.float32(0), "zero")
            self.initializers["six"] = numpy_helper.from_array(np.float32(6), "six")
            self.add("Clip", [source, "zero", "six"], output)
        else:
            raise NotImplementedError(f"activation {kind}")

    def fused(self, kind: str, inputs: list[str], output: str, activation: int, **attributes) -> None:
        if activation == schema.ActivationFunctionType.NONE:
            self.add(kind, inputs, output, **attributes)
        else:
            self.activate(activation, self.add(kind, inputs, output + "_raw", **attributes), output)

    def convolution(self, op, options, depthwise: bool) -> None:
        data, weight, bias = op.inputs[:3]
        W = self.value(weight)
        group = W.shape[3] if depthwise else 1
        if depthwise and options.depthMultiplier != 1:
            raise NotImplementedError("depth multiplier")
        kernel, stride = W.shape[1:3], (options.strideH, options.strideW)
        dilation = (options.dilationHFactor, options.dilationWFactor)
        W = W.transpose([3, 0, 1, 2]) if depthwise else W.transpose(TO_NCHW)
        inputs = [self.operand(data), self.weight(self.name(weight), W), self.operand(bias)]
        self.fused("Conv", inputs, self.name(op.outputs[0]), options.fusedActivationFunction, group=int(group),
                   strides=list(stride), dilations=list(dilation), kernel_shape=list(map(int, kernel)),
                   pads=self.pads(data, stride, dilation, kernel, options.padding))  # fmt: skip

    def reshape(self, op) -> None:
        data, output = op.inputs[0], self.name(op.outputs[0])
        source = self.operand(data)
        if len(self.shape(data)) == 4:
            source = self.add("Transpose", [source], output + "_nhwc", perm=TO_NHWC)
        shape = self.integers(output + "_shape", self.shape(op.outputs[0]))
        if len(self.shape(op.outputs[0])) == 4:
            flat = self.add("Reshape", [source, shape], output + "_flat")
            self.add("Transpose", [flat], output, perm=TO_NCHW)
        else:
            self.add("Reshape", [source, shape], output)

    def resize(self, op, options) -> None:
        output = self.name(op.outputs[0])
        n, h, w, c = self.shape(op.outputs[0])
        mode = "half_pixel" if options.halfPixelCenters else "align_corners" if options.alignCorners else "asymmetric"
        sizes = self.integers(output + "_sizes", [n, c, h, w])
        self.add("Resize", [self.operand(op.inputs[0]), "", "", sizes], output, mode="linear",
                 coordinate_transformation_mode=mode)  # fmt: skip

    def pad(self, op) -> None:
        amounts = self.value(op.inputs[1])[TO_NCHW]
        output = self.name(op.outputs[0])
        pads = self.integers(output + "_pads", amounts.T.reshape(-1))
        self.add("Pad", [self.operand(op.inputs[0]), pads], output)

    def concatenation(self, op, options) -> None:
        axis, rank = options.axis, len(self.shape(op.outputs[0]))
        axis = TO_NCHW.index(axis % 4) if rank == 4 else axis
        inputs = [self.operand(i) for i in op.inputs]
        self.fused("Concat", inputs, self.name(op.outputs[0]), options.fusedActivationFunction, axis=axis)

    def mean(self, op, options) -> None:
        data, output = op.inputs[0], self.name(op.outputs[0])
        axes = np.asarray(self.value(op.inputs[1])).reshape(-1) % len(self.shape(data))
        if len(self.shape(data)) == 4:
            axes = [TO_NCHW.index(int(axis)) for axis in axes]
            if not options.keepDims and len(axes) < 3 and sorted(axes) != [2, 3]:
                raise NotImplementedError("a mean that leaves rows or columns without keeping their number")
        self.add("ReduceMean", [self.operand(data)], output, axes=[int(axis) for axis in axes],
                 keepdims=int(options.keepDims))  # fmt: skip

    def fully_connected(self, op, options) -> None:
        data, weight = op.inputs[:2]
        output, source = self.name(op.outputs[0]), self.operand(data)
        W = self.value(weight)
        if len(self.shape(data)) != 2:
            if len(self.shape(data)) == 4:
                source = self.add("Transpose", [source], output + "_nhwc", perm=TO_NHWC)
            source = self.add("Reshape", [source, self.integers(output + "_rows", [-1, W.shape[1]])], output + "_flat")
        inputs = [source, self.weight(self.name(weight), W)]
        if len(op.inputs) > 2 and op.inputs[2] >= 0:
            inputs.append(self.operand(op.inputs[2]))
        self.fused("Gemm", inputs, output, options.fusedActivationFunction, transB=1)

    def prelu(self, op) -> None:
        slope = self.name(op.inputs[1])
        if slope not in self.initializers and slope + "_f16" not in self.initializers:
            array = self.value(op.inputs[1])  # (1, 1, C) beside activations of (1, C, H, W)
            self.weight(slope, array.reshape(-1, 1, 1) if array.size == array.shape[-1] else array.transpose(2, 0, 1))
        self.add("PRelu", [self.operand(op.inputs[0]), slope], self.name(op.outputs[0]))

    def strided_slice(self, op, options) -> None:
        if options.ellipsisMask or options.newAxisMask or options.shrinkAxisMask:
            raise NotImplementedError("a slice that adds or drops axes")
        shape = self.shape(op.inputs[0])
        begin, end, step = (np.array(self.value(i), np.int64) for i in op.inputs[1:4])
        if (step < 1).any():
            raise NotImplementedError("a slice that runs backwards")
        for axis in range(len(shape)):
            begin[axis] = 0 if options.beginMask >> axis & 1 else begin[axis]
            end[axis] = shape[axis] if options.endMask >> axis & 1 else end[axis]
        axes = [TO_NCHW.index(axis) for axis in range(4)] if len(shape) == 4 else list(range(len(shape)))
        output = self.name(op.outputs[0])
        parts = {"begin": begin, "end": end, "axes": axes, "step": step}
        names = [self.integers(f"{output}_{key}", value) for key, value in parts.items()]
        self.add("Slice", [self.operand(op.inputs[0]), *names], output)

    def operator(self, op) -> None:
        code = self.codes[op.opcodeIndex]
        kind = NAMES[max(code.builtinCode, code.deprecatedBuiltinCode)]
        options, output = op.builtinOptions, self.name(op.outputs[0])
        if kind in ("DEQUANTIZE", "DENSIFY"):
            self.constant.add(op.outputs[0])
        elif kind in ("CONV_2D", "DEPTHWISE_CONV_2D"):
            self.convolution(op, options, kind == "DEPTHWISE_CONV_2D")
        elif kind == "ADD":
            self.fused("Add", [self.operand(i) for i in op.inputs], output, options.fusedActivationFunction)
        elif kind == "MAX_POOL_2D":
            kernel, stride = (options.filterHeight, options.filterWidth), (options.strideH, options.strideW)
            self.fused("MaxPool", [self.operand(op.inputs[0])], output, options.fusedActivationFunction,
                       kernel_shape=list(kernel), strides=list(stride),
                       pads=self.pads(op.inputs[0], stride, (1, 1), kernel, options.padding))  # fmt: skip
        elif kind == "RESIZE_BILINEAR":
            self.resize(op, options)
        elif kind == "DEPTH_TO_SPACE":
            self.add("DepthToSpace", [self.operand(op.inputs[0])], output, blocksize=options.blockSize, mode="DCR")
        elif kind == "STRIDED_SLICE":
            self.strided_slice(op, options)
        elif kind == "MEAN":
            self.mean(op, options)
        elif kind == "FULLY_CONNECTED":
            self.fully_connected(op, options)
        elif kind == "PRELU":
            self.prelu(op)
        elif kind == "LOGISTIC":
            self.add("Sigmoid", [self.operand(op.inputs[0])], output)
        elif kind in ("PAD", "RESHAPE"):
            {"PAD": self.pad, "RESHAPE": self.reshape}[kind](op)
        elif kind == "CONCATENATION":
            self.concatenation(op, options)
        else:
            raise NotImplementedError(f"{self.path}: operator {kind}")

    def convert(self) -> onnx.ModelProto:
        (entry,) = self.graph.inputs
        self.add("Transpose", ["image"], self.name(entry), perm=TO_NCHW)
        for op in self.graph.operators:
            self.operator(op)
        inputs = [helper.make_tensor_value_info("image", TensorProto.FLOAT, self.shape(entry))]
        outputs = []
        for index in self.graph.outputs:
            shape, label = self.shape(index), self.graph.tensors[index].name.decode()
            outputs.append(helper.make_tensor_value_info(label, TensorProto.FLOAT, shape))
            if len(shape) == 4:
                self.add("Transpose", [self.name(index)], label, perm=TO_NHWC)
            else:
                self.add("Identity", [self.name(index)], label)
        graph = helper.make_graph(self.nodes, self.path.stem, inputs, outputs, list(self.initializers.values()))
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], producer_name="gavatar")
        model.ir_version = 8
        helper.set_model_props(model, {"license": "Apache-2.0", "source": f"{SOURCE} {self.path.name}"})
        onnx.checker.check_model(model)
        return model


def _builtin_resolver():
    from ai_edge_litert.interpreter import OpResolverType

    return OpResolverType.BUILTIN_WITHOUT_DEFAULT_DELEGATES


def main() -> None:
    parser = argparse.ArgumentParser(description="Convert one of MediaPipe's networks from .tflite to ONNX.")
    parser.add_argument("source", type=Path)
    parser.add_argument("target", type=Path)
    arguments = parser.parse_args()
    onnx.save(Converter(arguments.source).convert(), arguments.target)


if __name__ == "__main__":
    main()
