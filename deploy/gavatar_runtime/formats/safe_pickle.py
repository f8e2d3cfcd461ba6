"""Reading pickles of data without running anything that they ask for.

Body models, motions and fits are passed around as pickles, and a pickle is a program: it may name any function and call
it. Here the machine of the standard library runs with a closed table of names. Behind each name stands a class or
function of `pickled_values` that only keeps what it is given; no module is imported. What was kept is then checked and
becomes arrays.

What is understood: the plain types, dictionaries with an order or a default, NumPy arrays, scalars and dtypes (Python 2
and 3, any protocol), PyTorch's tensors (`torch_file`), SciPy's csc, csr and coo matrices (as dense arrays) and chumpy
arrays (as their values). Any other name is refused, or kept as something unread where the caller is lenient.
"""

from __future__ import annotations

import io
import os
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

from ..errors import UserError, cannot_read
from .pickled_values import TABLE, Held, PlainReader, Refused, unknown

# Of the standard library, the modules whose objects may stand unread; any other there can run something
_HARMLESS = {
    "argparse", "array", "collections", "dataclasses", "datetime", "decimal", "enum", "fractions", "functools",
    "pathlib", "random", "types", "typing", "uuid", "zoneinfo",
}  # fmt: skip
# what other formats add to the names that a pickle may ask for: tensors, by `torch_file`
FURTHER: dict[tuple[str, str], Any] = {}
_RUNNING = {*sys.stdlib_module_names, "__builtin__", "exceptions", "commands"} - _HARMLESS


def load_pickle(path: str | os.PathLike, *, lenient: bool = False) -> Any:
    """What the pickle in a file holds: dictionaries, lists, strings, numbers and NumPy arrays; nothing is executed.

    Text of Python 2 is read as latin-1. lenient: objects of unknown kinds become their items or attributes or, without
    any, `Unread`; names of the standard library that can run something are refused even so.
    Raises UserError naming the file when it is missing, damaged, or names anything but the data types above.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise cannot_read(path, error) from None
    return loads(data, str(path), lenient=lenient)


def loads(data: bytes, source: str = "pickle", *, lenient: bool = False) -> Any:
    """As `load_pickle`, of bytes; `source` names them in messages."""
    try:
        return PlainReader(lenient)(Machine(io.BytesIO(data), encoding="latin1", lenient=lenient).load())
    except Refused as error:
        raise UserError(f"{source} asks for '{error}', which is not data: it was not loaded and nothing ran") from None
    except Exception as error:  # whatever a hostile or damaged stream makes the machine stumble over
        raise UserError(
            f"{source} is not a readable pickle of arrays: it is damaged or of another kind ({cause(error)})"
        ) from None


def cause(error: Exception) -> str:
    """The first line of what went wrong, or its kind."""
    return str(error).splitlines()[0] if str(error).strip() else type(error).__name__


class Machine(pickle._Unpickler):
    """The standard library's machine in its Python form: its memo is a dictionary, so that a huge index in a hostile
    stream costs nothing, and its operations can be narrowed."""

    dispatch: ClassVar[dict] = dict(pickle._Unpickler.dispatch)
    # what the machine of the standard library sets on itself while it loads
    stack: list[Any]
    read: Callable[[int], bytes]
    append: Callable[[Any], None]

    def __init__(self, stream: io.BytesIO, *, encoding: str = "ASCII", lenient: bool = False):
        super().__init__(stream, encoding=encoding)
        self._lenient = lenient

    def find_class(self, module: str, name: str) -> Any:
        for table in (TABLE, FURTHER):
            try:
                return table[module, name]
            except (KeyError, TypeError):
                continue
        if self._lenient and str(module).partition(".")[0] not in _RUNNING:
            return unknown(f"{module}.{name}")
        raise Refused(f"{module}.{name}")

    def persistent_load(self, pid: Any) -> Any:
        raise Refused("an object stored elsewhere")

    def get_extension(self, code: int) -> Any:
        raise Refused(f"extension {code}")

    def load_build(self) -> None:
        """State is kept by what the table makes and by nothing else: a class or function takes none. That of a
        dictionary (the version of a `state_dict`) is left out."""
        state = self.stack.pop()
        if isinstance(self.stack[-1], Held):
            self.stack[-1].state = state
        elif not isinstance(self.stack[-1], dict):
            raise Refused("state for something that is not data")

    def load_bytearray8(self) -> None:
        """Only as long as the stream is: the length that it states is not believed."""
        size = int.from_bytes(self.read(8), "little")
        content = bytearray(self.read(size))
        if len(content) != size:
            raise ValueError("cut short")
        self.append(content)

    dispatch[pickle.BUILD[0]] = load_build
    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8
