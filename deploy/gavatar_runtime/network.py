"""An ONNX member of a bundle as a function of arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .bundle import Bundle
from .errors import UserError

ROWS = "rows"  # an optional input: which rows are wanted, int32 (`gavatar.graphs.decoder_model`)


class Network:
    """`network(*inputs)` -> list of outputs, both in the order of the names given and checked against the member's.

    inputs: None takes those that the member has, in its order; they stand in `inputs`.
    picks: whether the member has the optional input `rows`. threads: of ONNX Runtime within one operator, None for one
    a core. Raises UserError for a member that is missing, damaged, or that ONNX Runtime cannot load.
    """

    def __init__(self, bundle: Bundle, member: str, inputs: tuple[str, ...] | None, outputs, threads):
        import onnxruntime  # a tenth of a second that reading a manifest need not pay

        options = onnxruntime.SessionOptions()
        options.inter_op_num_threads = 1
        if threads is not None:
            options.intra_op_num_threads = threads
        # idle workers would spin on the cores that skinning and splatting need next
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        data = bundle.read(member)
        try:
            self._session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # ONNX Runtime's exceptions have no common base but this
            cause = str(error).strip().splitlines()[0]
            version = onnxruntime.__version__
            raise UserError(f"{bundle.path}: ONNX Runtime {version} cannot load {member}: {cause}") from error
        found = tuple(x.name for x in self._session.get_inputs())
        missing = set(outputs) - {x.name for x in self._session.get_outputs()}
        inputs = found if inputs is None else inputs
        if found != inputs or missing:
            raise UserError(
                f"{bundle.path}: {member} has inputs {found} and lacks outputs {sorted(missing)}, expected inputs "
                f"{inputs} and outputs {outputs}; export the avatar again"
            )
        self.inputs, self._outputs = inputs, list(outputs)
        self.picks = ROWS in {x.name for x in self._session.get_overridable_initializers()}
        self._binding = self._session.io_binding()
        self._value = onnxruntime.OrtValue.ortvalue_from_numpy

    def __call__(
        self, *arrays: np.ndarray, rows: np.ndarray | None = None, out: Sequence[np.ndarray] | None = None
    ) -> list[np.ndarray]:
        """The outputs. rows: (M,) int32, only where it `picks`. out: contiguous float32 arrays of just the outputs'
        shapes, which are filled and returned; None for new ones."""
        feeds = dict(zip(self.inputs, arrays, strict=True))
        if rows is not None:
            feeds[ROWS] = rows
        if out is None:
            return self._session.run(self._outputs, feeds)
        feeds = {name: np.ascontiguousarray(array) for name, array in feeds.items()}  # alive until the run is over
        self._binding.clear_binding_inputs()
        self._binding.clear_binding_outputs()
        for name, array in feeds.items():
            # by value: `bind_cpu_input` knows no input that has a default
            self._binding.bind_ortvalue_input(name, self._value(array))
        for name, array in zip(self._outputs, out, strict=True):
            self._binding.bind_output(name, "cpu", 0, array.dtype, array.shape, array.ctypes.data)
        self._session.run_with_iobinding(self._binding)
        return list(out)
