"""What stands behind the names in a pickle: classes that keep what they are given and turn it into arrays.

None of NumPy's, SciPy's, PyTorch's or chumpy's code takes part. The machine of `safe_pickle` makes these objects; a
`PlainReader` makes plain values of them.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

Plain = Callable[[Any], Any]  # held or plain value -> plain value

_KINDS = "biufcSUVO"
_MOST_DENSE = 1 << 26  # entries of a sparse matrix made dense: 100 times the largest joint regressor
_DEEPEST = 100


class Refused(Exception):
    """A name that is not in the table."""


@dataclasses.dataclass(frozen=True)
class Unread:
    """In place of a member that is not read: why, as in "asks for 'omegaconf.DictConfig', which is not data"."""

    why: str


class Held:
    """An object of the pickle as it stands there: the arguments it was made with and the state it was given.

    `state` is set by the machine's BUILD; it is data, never code.
    """

    arguments: tuple[Any, ...]
    state: Any

    def __init__(self, *arguments: Any):
        self.arguments, self.state = arguments, None

    def value(self, plain: Plain) -> Any:
        """The plain value; raises ValueError for a state that makes no sense. plain: for what is held within."""
        raise NotImplementedError


class Unknown(Held):
    """Of a class that the table lacks, where such are let stand: inert. Its items, its entries or its attributes are
    the value; without any it is unread."""

    name = ""
    items: dict[Any, Any]
    entries: list[Any]

    def __new__(cls, *arguments: Any, **named: Any) -> Unknown:
        made = super().__new__(cls)
        made.arguments, made.state, made.items, made.entries = arguments, None, {}, []
        return made

    def __init__(self, *arguments: Any, **named: Any):
        self.arguments = arguments

    def __call__(self, *arguments: Any) -> Unknown:
        return self

    def __setitem__(self, key: Any, value: Any) -> None:
        self.items[key] = value

    def append(self, entry: Any) -> None:
        self.entries.append(entry)

    def extend(self, entries: list) -> None:
        self.entries.extend(entries)

    add, update = append, extend

    def value(self, plain: Plain) -> Any:
        attributes = self.state[-1] if isinstance(self.state, tuple) and self.state else self.state
        for content in (self.items, self.entries, attributes):
            if isinstance(content, (dict, list)) and content:
                return plain(content)
        return not_data(self.name)


def not_data(name: str) -> Unread:
    return Unread(f"asks for '{name}', which is not data")


@functools.lru_cache(maxsize=1000)
def unknown(name: str) -> type[Unknown]:
    """The class that stands for `name`."""
    return type("Unknown", (Unknown,), {"name": name})


class Dtype(Held):
    def value(self, plain: Plain) -> np.dtype:
        code: Any = self.arguments[0]
        order: Any = "|"
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


class Array(Held):
    def value(self, plain: Plain) -> np.ndarray:
        if self.state is None:
            raise ValueError("an array without content")
        shape, dtype, fortran, content = self.state[-4:]
        dtype = plain(dtype)
        if not isinstance(dtype, np.dtype):
            raise ValueError("an array without dtype")
        return array_of(content, dtype, shape, "F" if fortran else "C", plain)


class FromBuffer(Held):
    """numpy._core.numeric._frombuffer(buffer, dtype, shape, order), of protocol 5."""

    def value(self, plain: Plain) -> np.ndarray:
        content, dtype, shape, order = self.arguments
        return array_of(content, plain(dtype), shape, "F" if order == "F" else "C", plain)


class Scalar(Held):
    def value(self, plain: Plain) -> Any:
        dtype, content = plain(self.arguments[0]), self.arguments[1]
        return array_of(content, dtype, (), "C", plain)[()]


def array_of(content: Any, dtype: np.dtype, shape: Any, order: Literal["C", "F"], plain: Plain) -> np.ndarray:
    """The array of some bytes, or of a list of objects."""
    if not isinstance(shape, tuple) or not all(type(n) is int and n >= 0 for n in shape):
        raise ValueError(f"shape {shape!r}")
    if dtype.hasobject:
        items = plain(content)
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


class _Sparse(Held):
    """A SciPy matrix; `form` is csc, csr or coo."""

    form = ""

    def value(self, plain: Plain) -> np.ndarray:
        state = plain(self.state)
        if not isinstance(state, dict):
            raise ValueError("a sparse matrix without content")
        sizes: Any = state.get("_shape", state.get("shape", ()))
        shape = tuple(int(n) for n in sizes)
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


class _Chumpy(Held):
    """chumpy.ch.Ch: a variable whose value is `x`."""

    def value(self, plain: Plain) -> np.ndarray:
        state = self.state if isinstance(self.state, dict) else {}
        if "x" not in state:
            raise ValueError("a chumpy expression that is not a plain array")
        return _ndarray(plain(state["x"]))


class _ChumpySelect(Held):
    """chumpy.reordering.Select: some entries of another chumpy array, flat, in a shape."""

    def value(self, plain: Plain) -> np.ndarray:
        state = self.state if isinstance(self.state, dict) else {}
        whole = _ndarray(plain(state["a"])).reshape(-1)
        shape = plain(state.get("preferred_shape"))
        chosen = whole[_ndarray(plain(state["idxs"])).astype(np.int64).reshape(-1)]
        return chosen if shape is None else chosen.reshape(tuple(int(n) for n in shape))


class _Object:
    """`object`, as the base that Python 2 names when it makes instances."""


def _reconstructor(cls: Any, base: Any = None, state: Any = None) -> Any:
    """copyreg._reconstructor for the classes of this module."""
    if not (isinstance(cls, type) and issubclass(cls, Held)):
        raise Refused("copyreg._reconstructor of a class that is not data")
    made = cls()
    if isinstance(made, Unknown):  # of a kind of dictionary or list
        made.items.update(state if isinstance(state, dict) else {})
        made.entries.extend(state if isinstance(state, list) else [])
    return made


def _encode(text: str, encoding: str = "latin1") -> bytes:
    """_codecs.encode, which Python 3 uses for bytes in old protocols."""
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1", "utf-8", "ascii"):
        raise Refused("_codecs.encode with another encoding")
    return text.encode(encoding)


def _bytes(content: Any = b"", encoding: str = "latin1") -> bytes:
    """bytes and bytearray as pickles make them, never by length."""
    return _encode(content, encoding) if isinstance(content, str) else b"".join([content])


def _dict(*arguments: Any) -> dict:
    """dict, OrderedDict and defaultdict; a default's factory is left out."""
    return dict(next((a for a in reversed(arguments) if isinstance(a, (dict, list, tuple))), ()))


def _table() -> dict[tuple[str, str], Any]:
    table: dict[tuple[str, str], Any] = {("_codecs", "encode"): _encode}
    for module in ("copy_reg", "copyreg"):
        table[module, "_reconstructor"] = _reconstructor
    for module in ("__builtin__", "builtins"):
        table |= {(module, "object"): _Object, (module, "set"): set, (module, "frozenset"): frozenset}
        table |= {(module, "bytes"): _bytes, (module, "bytearray"): _bytes, (module, "complex"): complex}
        # what a defaultdict makes its defaults with
        table |= {(module, name): unknown(name) for name in ("list", "int", "float", "str", "bool", "tuple")}
        table[module, "dict"] = _dict
    table |= {("collections", "OrderedDict"): _dict, ("collections", "defaultdict"): _dict}
    for core in ("numpy.core", "numpy._core"):
        table |= {(f"{core}.multiarray", "_reconstruct"): Array, (f"{core}.multiarray", "scalar"): Scalar}
        table[f"{core}.numeric", "_frombuffer"] = FromBuffer
    table |= {("numpy", "ndarray"): _Object, ("numpy", "dtype"): Dtype}
    for kind, cls in {"csc": _Csc, "csr": _Csr, "coo": _Coo}.items():
        for module in (f"scipy.sparse.{kind}", f"scipy.sparse._{kind}", "scipy.sparse"):
            table |= {(module, f"{kind}_matrix"): cls, (module, f"{kind}_array"): cls}
    table |= {("chumpy.ch", "Ch"): _Chumpy, ("chumpy", "Ch"): _Chumpy}
    table["chumpy.reordering", "Select"] = _ChumpySelect
    return table


TABLE = types.MappingProxyType(_table())


_UNDER_WAY = object()


class PlainReader:
    """Makes plain values: every held object becomes what it stands for, what is shared stays shared.

    lenient: what cannot be read becomes `Unread` where it stands; else it raises ValueError.
    """

    def __init__(self, lenient: bool = False):
        self.lenient = lenient
        self._known: dict[int, tuple[Any, Any]] = {}

    def __call__(self, value: Any, depth: int = 0) -> Any:
        if depth > _DEEPEST:
            return self._fault(ValueError("nested too deeply"))
        if isinstance(value, (Held, dict, list, tuple, set, frozenset)):
            if id(value) not in self._known:
                self._known[id(value)] = value, _UNDER_WAY  # the value too: its id stays its own
                self._known[id(value)] = value, self._made(value, depth + 1)
            made = self._known[id(value)][1]
            return self._fault(ValueError("it holds itself")) if made is _UNDER_WAY else made
        if isinstance(value, type) and issubclass(value, Unknown):
            return self._fault(ValueError(not_data(value.name).why))
        if isinstance(value, type) or callable(value) or isinstance(value, _Object):
            return self._fault(ValueError("a class or function where data was expected"))
        return value

    def _made(self, value: Any, depth: int) -> Any:
        if isinstance(value, dict):
            return {self._key(k, depth): self(v, depth) for k, v in value.items()}
        if not isinstance(value, Held):
            return type(value)(self(item, depth) for item in value)
        try:
            made = value.value(lambda held: self(held, depth))
        except Refused:
            raise
        except Exception as error:
            return self._fault(error)
        if isinstance(made, Unread) and not self.lenient:
            raise ValueError(made.why)
        return made

    def _key(self, key: Any, depth: int) -> Any:
        key = self(key, depth)
        return str(key) if isinstance(key, (Unread, dict, list, np.ndarray)) else key

    def _fault(self, error: Exception) -> Unread:
        if not self.lenient:
            raise error
        return Unread(str(error) or type(error).__name__)
