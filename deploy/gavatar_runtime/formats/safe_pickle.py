"""Reading pickles of data without running anything that they ask for.

Body models, motions and fits are passed around as pickles, and a pickle is a program: it may name any function and call
it. Here the machine of the standard library runs with a closed table of names. Behind each name stands a class or
function of this module that only keeps what it is given; none of NumPy's, SciPy's or chumpy's code takes part, and no
module is imported. What was kept is then checked and becomes arrays.

What is understood: the plain types, NumPy arrays, scalars and dtypes (Python 2 and 3, any protocol), SciPy's csc, csr
and coo matrices (as dense arrays) and chumpy arrays (as their values). Any other name is refused.
"""

from __future__ import annotations

import functools
import io
import math
import os
import pickle
import types
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..errors import UserError

_KINDS = "biufcSUVO"
_MOST_DENSE = 1 << 26  # entries of a sparse matrix made dense: 100 times the largest joint regressor
_DEEPEST = 100


def load_pickle(path: str | os.PathLike) -> Any:
    """What the pickle in a file holds: dictionaries, lists, strings, numbers and NumPy arrays; nothing is executed.

    Text of Python 2 is read as latin-1. Raises UserError naming the file when it is missing, damaged, or names anything
    but the data types above.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
    return loads(data, str(path))


def loads(data: bytes, source: str = "pickle") -> Any:
    """As `load_pickle`, of bytes; `source` names them in messages."""
    try:
        return _plain(_Machine(io.BytesIO(data), encoding="latin1").load())
    except _Refused as error:
        raise UserError(f"{source} asks for '{error}', which is not data: it was not loaded and nothing ran") from None
    except Exception as error:  # whatever a hostile or damaged stream makes the machine stumble over
        cause = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UserError(
            f"{source} is not a readable pickle of arrays: it is damaged or of another kind ({cause})"
        ) from None


class _Refused(Exception):
    """A name that is not in the table."""


class _Held:
    """An object of the pickle as it stands there: the arguments it was made with and the state it was given.

    `state` is set by the machine's BUILD; it is data, never code.
    """

    def __init__(self, *arguments: Any):
        self.arguments, self.state = arguments, None

    @functools.cached_property
    def plain(self) -> Any:
        """The value, made once however often the pickle refers to it."""
        return self.value()

    def value(self) -> Any:
        """The plain value; raises ValueError for a state that makes no sense."""
        raise NotImplementedError


class _Dtype(_Held):
    def value(self) -> np.dtype:
        code, order = self.arguments[0], "|"
        if isinstance(code, bytes):
            code = code.decode("latin1")
        if isinstance(self.state, tuple) and len(self.state) > 1:
            if len(self.state) > 3 and any(field is not None for field in self.state[2:5]):
                raise ValueError("structured arrays are not read")
            order = self.state[1]
        if not isinstance(code, str) or order not in ("<", ">", "|", "="):
            raise ValueError(f"dtype {code!r}")
        dtype = np.dtype(code)
        if dtype.kind not in _KINDS:
            raise ValueError(f"arrays of {dtype} are not read")
        return dtype if order in "|=" else dtype.newbyteorder(order)


class _Array(_Held):
    def value(self) -> np.ndarray:
        if self.state is None:
            raise ValueError("an array without content")
        shape, dtype, fortran, content = self.state[-4:]
        dtype = _plain(dtype)
        if not isinstance(dtype, np.dtype):
            raise ValueError("an array without dtype")
        return _array(content, dtype, shape, "F" if fortran else "C")


class _FromBuffer(_Held):
    """numpy._core.numeric._frombuffer(buffer, dtype, shape, order), of protocol 5."""

    def value(self) -> np.ndarray:
        content, dtype, shape, order = self.arguments
        return _array(content, _plain(dtype), shape, "F" if order == "F" else "C")


class _Scalar(_Held):
    def value(self) -> Any:
        dtype, content = _plain(self.arguments[0]), self.arguments[1]
        return _array(content, dtype, (), "C")[()]


def _array(content: Any, dtype: np.dtype, shape: Any, order: str) -> np.ndarray:
    if not isinstance(shape, tuple) or not all(type(n) is int and n >= 0 for n in shape):
        raise ValueError(f"shape {shape!r}")
    if dtype.hasobject:
        items = _plain(content)
        if not isinstance(items, list) or len(items) != math.prod(shape):
            raise ValueError("an object array of the wrong length")
        out = np.empty(len(items), object)
        out[:] = items if all(np.ndim(i) == 0 for i in items) else [*items, None][: len(items)]
        return out.reshape(shape, order=order)
    if isinstance(content, str):
        content = content.encode("latin1")
    if not isinstance(content, (bytes, bytearray)) or len(content) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"an array of shape {shape} and type {dtype} with content of another length")
    return np.frombuffer(bytes(content), dtype).reshape(shape, order=order).copy(order="K")


def _ndarray(value: Any) -> np.ndarray:
    """An array of numbers that is one already: nested lists are not multiplied out."""
    if not isinstance(value, (np.ndarray, np.generic, int, float)) or np.asarray(value).dtype.kind not in "biufc":
        raise ValueError("something else where an array of numbers was expected")
    return np.asarray(value)


class _Sparse(_Held):
    """A SciPy matrix; `form` is csc, csr or coo."""

    form = ""

    def value(self) -> np.ndarray:
        state = _plain(self.state)
        if not isinstance(state, dict):
            raise ValueError("a sparse matrix without content")
        shape = tuple(int(n) for n in state.get("_shape", state.get("shape", ())))
        if len(shape) != 2 or min(shape) < 0 or math.prod(shape) > _MOST_DENSE:
            raise ValueError(f"a sparse matrix of shape {shape}")
        values = _ndarray(state["data"])
        row, column = self._places(state, shape)
        if not (len(row) == len(column) == len(values)):
            raise ValueError("a sparse matrix with lists of different lengths")
        if len(row) and not (row.min() >= 0 and row.max() < shape[0] and column.min() >= 0 and column.max() < shape[1]):
            raise ValueError("a sparse matrix with an index out of range")
        dense = np.zeros(shape, np.result_type(values.dtype, np.float32))
        np.add.at(dense, (row, column), values)
        return dense

    def _places(self, state: dict, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        if self.form == "coo":
            coords = state.get("coords", (state.get("row"), state.get("col")))
            return _ndarray(coords[0]).astype(np.int64), _ndarray(coords[1]).astype(np.int64)
        start, minor = (_ndarray(state[key]).astype(np.int64) for key in ("indptr", "indices"))
        lines = shape[1] if self.form == "csc" else shape[0]
        count = np.diff(start)
        if len(start) != lines + 1 or count.min(initial=0) < 0 or count.sum() != len(minor):
            raise ValueError("a sparse matrix whose pointers do not fit its indices")
        major = np.repeat(np.arange(lines), count)
        return (minor, major) if self.form == "csc" else (major, minor)


class _Csc(_Sparse):
    form = "csc"


class _Csr(_Sparse):
    form = "csr"


class _Coo(_Sparse):
    form = "coo"


class _Chumpy(_Held):
    """chumpy.ch.Ch: a variable whose value is `x`."""

    def value(self) -> np.ndarray:
        state = self.state if isinstance(self.state, dict) else {}
        if "x" not in state:
            raise ValueError("a chumpy expression that is not a plain array")
        return _ndarray(_plain(state["x"]))


class _ChumpySelect(_Held):
    """chumpy.reordering.Select: some entries of another chumpy array, flat, in a shape."""

    def value(self) -> np.ndarray:
        state = self.state if isinstance(self.state, dict) else {}
        whole = _ndarray(_plain(state["a"])).reshape(-1)
        shape = _plain(state.get("preferred_shape"))
        chosen = whole[_ndarray(_plain(state["idxs"])).astype(np.int64).reshape(-1)]
        return chosen if shape is None else chosen.reshape(tuple(int(n) for n in shape))


class _Object:
    """`object`, as the base that Python 2 names when it makes instances."""


def _reconstructor(cls: Any, base: Any = None, state: Any = None) -> Any:
    """copyreg._reconstructor for the classes of this module."""
    if not (isinstance(cls, type) and issubclass(cls, _Held)):
        raise _Refused("copyreg._reconstructor of a class that is not data")
    return cls()


def _encode(text: str, encoding: str = "latin1") -> bytes:
    """_codecs.encode, which Python 3 uses for bytes in old protocols."""
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1", "utf-8", "ascii"):
        raise _Refused("_codecs.encode with another encoding")
    return text.encode(encoding)


def _bytes(content: Any = b"", encoding: str = "latin1") -> bytes:
    """bytes and bytearray as pickles make them, never by length."""
    return _encode(content, encoding) if isinstance(content, str) else b"".join([content])


def _table() -> dict[tuple[str, str], Any]:
    table: dict[tuple[str, str], Any] = {("_codecs", "encode"): _encode}
    for module in ("copy_reg", "copyreg"):
        table[module, "_reconstructor"] = _reconstructor
    for module in ("__builtin__", "builtins"):
        table |= {(module, "object"): _Object, (module, "set"): set, (module, "frozenset"): frozenset}
        table |= {(module, "bytes"): _bytes, (module, "bytearray"): _bytes, (module, "complex"): complex}
    for core in ("numpy.core", "numpy._core"):
        table |= {(f"{core}.multiarray", "_reconstruct"): _Array, (f"{core}.multiarray", "scalar"): _Scalar}
        table[f"{core}.numeric", "_frombuffer"] = _FromBuffer
    table |= {("numpy", "ndarray"): _Object, ("numpy", "dtype"): _Dtype}
    for kind, cls in {"csc": _Csc, "csr": _Csr, "coo": _Coo}.items():
        for module in (f"scipy.sparse.{kind}", f"scipy.sparse._{kind}", "scipy.sparse"):
            table |= {(module, f"{kind}_matrix"): cls, (module, f"{kind}_array"): cls}
    table |= {("chumpy.ch", "Ch"): _Chumpy, ("chumpy", "Ch"): _Chumpy}
    table["chumpy.reordering", "Select"] = _ChumpySelect
    return table


_TABLE = types.MappingProxyType(_table())


class _Machine(pickle._Unpickler):
    """The standard library's machine in its Python form: its memo is a dictionary, so that a huge index in a hostile
    stream costs nothing, and its operations can be narrowed."""

    dispatch: ClassVar[dict] = dict(pickle._Unpickler.dispatch)

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _TABLE[module, name]
        except (KeyError, TypeError):
            raise _Refused(f"{module}.{name}") from None

    def persistent_load(self, pid: Any) -> Any:
        raise _Refused("an object stored elsewhere")

    def get_extension(self, code: int) -> Any:
        raise _Refused(f"extension {code}")

    def load_build(self) -> None:
        """State is kept by what this module makes and by nothing else: a class or function takes none."""
        state = self.stack.pop()
        if not isinstance(self.stack[-1], _Held):
            raise _Refused("state for something that is not data")
        self.stack[-1].state = state

    def load_bytearray8(self) -> None:
        """Only as long as the stream is: the length that it states is not believed."""
        size = int.from_bytes(self.read(8), "little")
        content = bytearray(self.read(size))
        if len(content) != size:
            raise ValueError("cut short")
        self.append(content)

    dispatch[pickle.BUILD[0]] = load_build
    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8


def _plain(value: Any, depth: int = 0, known: dict[int, Any] | None = None) -> Any:
    """`value` with every held object as the array it stands for; what is shared stays shared."""
    known = {} if known is None else known
    if depth > _DEEPEST:
        raise ValueError("nested too deeply, or in a circle")
    if isinstance(value, _Held):
        return value.plain
    if isinstance(value, (dict, list, tuple, set, frozenset)):
        if id(value) not in known:
            known[id(value)] = _plain_container(value, depth + 1, known)
        return known[id(value)]
    if isinstance(value, type) or callable(value) or isinstance(value, _Object):
        raise ValueError("a class or function where data was expected")
    return value


def _plain_container(value: Any, depth: int, known: dict[int, Any]) -> Any:
    if isinstance(value, dict):
        return {_plain(k, depth, known): _plain(v, depth, known) for k, v in value.items()}
    return type(value)(_plain(item, depth, known) for item in value)
