"""Networks in 8-bit arithmetic: static quantisation, per channel, calibrated on data."""

from __future__ import annotations

import logging
import tempfile
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import onnx

SMALL_OUTPUT = 8  # layers with fewer outputs stay in float32: they cost nothing and their error is the result's


def quantized(
    model: onnx.ModelProto, samples: Iterable[dict[str, np.ndarray]], kinds: Sequence[str] = ("Gemm",)
) -> onnx.ModelProto:
    """`model` with its layers of `kinds` quantised: 8-bit weights by output channel and 8-bit activations whose ranges
    are those met with `samples`, input arrays by name. Inputs and outputs stay float32."""
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    class Reader(CalibrationDataReader):
        def __init__(self) -> None:
            self.rows = iter(samples)

        def get_next(self) -> dict[str, np.ndarray] | None:
            return next(self.rows, None)

    with tempfile.TemporaryDirectory(prefix="gavatar-int8-") as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        level = logging.getLogger().level
        logging.getLogger().setLevel(logging.ERROR)  # it advises pre-processing that has been done
        try:
            source, prepared, result = (str(Path(folder) / f"{n}.onnx") for n in ("source", "prepared", "result"))
            onnx.save(model, source)
            quant_pre_process(source, prepared, skip_symbolic_shape=True)
            prepared_model = onnx.load(prepared)
            quantize_static(
                prepared,
                result,
                Reader(),
                quant_format=QuantFormat.QDQ,
                op_types_to_quantize=[*kinds, "Relu", "LeakyRelu"],
                nodes_to_exclude=_small(prepared_model),
                per_channel=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
            )
            return onnx.load(result)
        finally:
            logging.getLogger().setLevel(level)


def _small(model: onnx.ModelProto) -> list[str]:
    biases = {t.name: t.dims[0] for t in model.graph.initializer if len(t.dims) == 1}
    return [n.name for n in model.graph.node if n.op_type == "Gemm" and biases.get(n.input[-1], 99) < SMALL_OUTPUT]
