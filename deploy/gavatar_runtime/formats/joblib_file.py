"""What `joblib.dump` wrote without compression: a pickle with the arrays' bytes between its operations."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..errors import UserError
from .safe_pickle import _array, _Dtype, _Held, _Machine, _plain, _Refused


def load_joblib(path: str | os.PathLike) -> Any:
    """Dictionaries, lists, numbers and NumPy arrays of a joblib file or a plain pickle; nothing is executed.

    Raises UserError naming the file when it is missing, damaged, compressed, or asks for anything else.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
    if data[:1] != b"\x80":
        raise UserError(f"{path} is not an uncompressed joblib file: save it again with joblib.dump(..., compress=0)")
    try:
        return _plain(_JoblibMachine(io.BytesIO(data)).load())
    except _Refused as error:
        raise UserError(f"{path} asks for '{error}', which is not data: it was not loaded and nothing ran") from None
    except Exception as error:  # whatever a hostile or damaged stream makes the machine stumble over
        cause = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UserError(f"{path} is not a readable joblib file: it is damaged or of another kind ({cause})") from None


class _Wrapper(_Held):
    """joblib.numpy_pickle.NumpyArrayWrapper: shape, order and dtype of an array whose bytes follow in the stream."""

    def __new__(cls, *arguments: Any) -> _Wrapper:
        made = super().__new__(cls)
        made.arguments, made.state, made.content = arguments, None, b""
        return made

    def read(self, stream: io.BytesIO) -> None:
        state = self.state
        if not isinstance(state, dict) or not isinstance(state.get("dtype"), _Dtype):
            raise ValueError("an array without dtype")
        dtype, shape = state["dtype"].plain, state.get("shape")
        if dtype.hasobject or not isinstance(shape, tuple) or not all(type(n) is int and n >= 0 for n in shape):
            raise ValueError("an array of objects or without shape")
        if state.get("numpy_array_alignment_bytes") is not None:
            stream.read(stream.read(1)[0])
        self.content = stream.read(int(np.prod(shape, dtype=object)) * dtype.itemsize)

    def value(self) -> np.ndarray:
        state = self.state
        return _array(self.content, state["dtype"].plain, state["shape"], "F" if state.get("order") == "F" else "C")


class _JoblibMachine(_Machine):
    """The restricted machine with joblib's wrapper added to its table."""

    dispatch: ClassVar[dict] = dict(_Machine.dispatch)

    def __init__(self, stream: io.BytesIO):
        super().__init__(stream, encoding="latin1")
        self._stream = stream

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("joblib.numpy_pickle", "NumpyArrayWrapper"):
            return _Wrapper
        return super().find_class(module, name)

    def load_build(self) -> None:
        """As in the restricted machine; the bytes of an array stand right behind the state of its wrapper."""
        super().load_build()
        if isinstance(self.stack[-1], _Wrapper):
            self.stack[-1].read(self._stream)

    dispatch[b"b"[0]] = load_build
