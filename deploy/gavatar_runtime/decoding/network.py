"""An ONNX member of a bundle as a function of arrays."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ..bundle import Bundle
from ..cpus import usable_cpus
from ..errors import UserError
from ..values.array_rules import ADVICE

CHUNK = 2048  # rows that a decoder's graph takes at once: the widest activations (2 MB) stay in a core's caches
LONGEST_CAUSE = 300  # characters of a message of ONNX Runtime, which may list all of a graph
OPEN = -1  # in a shape: an axis as long as whoever calls wants it
ROWS = "rows"  # an optional input: which rows are wanted, int32 (`gavatar.export.onnx_graphs.decoder_model`)


class Network:
    """`network(*inputs)` -> list of outputs, both in the order of the names given and checked against the member's.

    inputs: None takes those that the member has, in its order; they stand in `inputs`.
    by_rows: it will be called with `rows`; where the member has that optional input (`picks`), each thread decodes a
    share of the rows by itself. (The products of a chunk are too small to be shared: two threads that wait for each
    other at every one of them took 1.2 times as long in float32 and 1.45 times in int8.)
    threads: None for as many as `cpus.usable_cpus`. Raises UserError for a member that is missing, damaged, that ONNX
    Runtime cannot load or, when it is called, cannot run, and for inputs and outputs of other names.
    """

    def __init__(
        self,
        bundle: Bundle,
        member: str,
        inputs: tuple[str, ...] | None,
        outputs: tuple[str, ...],
        threads: int | None,
        *,
        by_rows: bool = False,
    ):
        threads = threads or usable_cpus()
        self._source, self._member = str(bundle.path), member
        self._session = _session(bundle, member, 1 if by_rows else threads)
        self.picks = by_rows and ROWS in {x.name for x in self._session.get_overridable_initializers()}
        if by_rows and not self.picks:  # a bundle of the time before `rows`
            self._session = _session(bundle, member, threads)
        found = tuple(x.name for x in self._session.get_inputs())
        missing = set(outputs) - {x.name for x in self._session.get_outputs()}
        inputs = found if inputs is None else inputs
        if found != inputs or missing:
            raise UserError(
                f"{bundle.path}: {member} has inputs {found} and lacks outputs {sorted(missing)}, expected inputs "
                f"{inputs} and outputs {outputs}; export the avatar again"
            )
        self.inputs, self._outputs = inputs, list(outputs)
        self._workers = threads if self.picks else 1
        self._pool = ThreadPoolExecutor(self._workers - 1) if self._workers > 1 else None
        self._bindings = [self._session.io_binding() for _ in range(self._workers)]

    def __call__(
        self, *arrays: np.ndarray, rows: np.ndarray | None = None, out: Sequence[np.ndarray] | None = None
    ) -> list[np.ndarray]:
        """The outputs. rows: (M,) int32, only where it `picks`. out: contiguous float32 arrays of just the outputs'
        shapes, which are filled and returned; None for new ones."""
        feeds = {n: np.ascontiguousarray(a) for n, a in zip(self.inputs, arrays, strict=True)}
        if rows is None:
            return self._run(0, feeds, out)
        ends = np.linspace(0, len(rows), max(1, min(self._workers, -(-len(rows) // CHUNK))) + 1).astype(int)
        shares = [slice(a, b) for a, b in itertools.pairwise(ends)]

        def run(worker: int) -> list[np.ndarray]:
            share = shares[worker]
            into = None if out is None else [array[share] for array in out]
            return self._run(worker, {**feeds, ROWS: np.ascontiguousarray(rows[share])}, into)

        others = [] if self._pool is None else [self._pool.submit(run, worker) for worker in range(1, len(shares))]
        parts = [run(0), *(other.result() for other in others)]
        if out is not None:
            return list(out)
        return parts[0] if len(parts) == 1 else [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]

    def check_shape(self, name: str, shape: Sequence[int | None]) -> None:
        """UserError if the member declares another shape of an input or output: None is an axis of any length, `OPEN`
        one whose length it may not fix."""
        for declared in (*self._session.get_inputs(), *self._session.get_outputs()):
            if declared.name != name:
                continue
            # an axis of any length is declared as text, or not at all
            lengths = [x if isinstance(x, int) else None for x in declared.shape]
            fits = len(lengths) == len(shape) and all(
                None in (a, b) or a == b for a, b in zip(lengths, shape, strict=True)
            )
            if not fits or declared.type != "tensor(float)":
                expected = ", ".join({None: "any", OPEN: "rows"}.get(x, str(x)) for x in shape)
                raise UserError(
                    f"{self._source}: {self._member} declares '{name}' as {declared.type} of shape "
                    f"{tuple(declared.shape)}, not tensor(float) of ({expected}); {ADVICE}"
                )

    def _run(self, worker: int, feeds: dict[str, np.ndarray], out: Sequence[np.ndarray] | None) -> list[np.ndarray]:
        try:
            return self._ran(worker, feeds, out)
        except Exception as error:  # ONNX Runtime's exceptions have no common base but this
            raise _refused(self._source, "run", self._member, error) from error

    def _ran(self, worker: int, feeds: dict[str, np.ndarray], out: Sequence[np.ndarray] | None) -> list[np.ndarray]:
        if out is None:
            return self._session.run(self._outputs, feeds)
        from onnxruntime import OrtValue

        binding = self._bindings[worker]
        binding.clear_binding_inputs()
        binding.clear_binding_outputs()
        for name, array in feeds.items():
            # by value: `bind_cpu_input` knows no input that has a default
            binding.bind_ortvalue_input(name, OrtValue.ortvalue_from_numpy(array))
        for name, array in zip(self._outputs, out, strict=True):
            binding.bind_output(name, "cpu", 0, array.dtype, array.shape, array.ctypes.data)
        self._session.run_with_iobinding(binding)
        return list(out)


def session_options(threads: int | None = None) -> Any:
    """The SessionOptions of a network that shares the CPUs with other work: `threads` within one operator, None for as
    many as `cpus.usable_cpus`, that sleep between operators; silent."""
    import onnxruntime  # a tenth of a second that reading a manifest need not pay

    options = onnxruntime.SessionOptions()
    options.inter_op_num_threads = 1
    # Always a number: left to itself, ONNX Runtime counts the machine's cores and binds a worker to each of them, out
    # of the affinity that the process was given.
    options.intra_op_num_threads = threads or usable_cpus()
    # idle workers would spin on the cores that skinning and splatting need next
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4  # what fails is raised, and need not be printed too
    return options


def _session(bundle: Bundle, member: str, threads: int) -> Any:
    """An ONNX Runtime session of a member, `threads` within one operator."""
    import onnxruntime

    options = session_options(threads)
    data = bundle.read(member)
    try:
        # without `enable_fallback` a failure is printed, and tried again with the same provider
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"], enable_fallback=0)
    except Exception as error:  # ONNX Runtime's exceptions have no common base but this
        raise _refused(bundle.path, "load", member, error) from error


def _refused(source: object, verb: str, member: str, error: Exception) -> UserError:
    import onnxruntime

    cause = next(iter(str(error).strip().splitlines()), type(error).__name__)
    cause = "".join(c if c.isprintable() else "?" for c in cause)[:LONGEST_CAUSE]
    return UserError(f"{source}: ONNX Runtime {onnxruntime.__version__} cannot {verb} {member}: {cause}; {ADVICE}")
