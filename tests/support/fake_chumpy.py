"""Pickles as the body models of 2015 are: written by Python 2, with chumpy variables and old SciPy matrices inside.

The classes here only carry what chumpy's own instances carry when pickled; `python2_pickle` writes them under chumpy's
names, in the way Python 2 writes instances (`copy_reg._reconstructor` and a dictionary of state).
"""

from __future__ import annotations

import io
import pickle
import sys
import types
from typing import ClassVar

import numpy as np


class Ch:
    """A chumpy variable with value `x`."""

    def __init__(self, x):
        self._dirty_vars, self._itr, self._depends_on_deps = set(), None, {}
        self.x = np.asarray(x)

    @property
    def r(self) -> np.ndarray:
        return self.x

    @property
    def shape(self) -> tuple[int, ...]:
        return self.r.shape

    def __getitem__(self, item) -> np.ndarray:
        return self.r[item]

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        """As chumpy's own: what NumPy makes of it."""
        return np.array(self.r, dtype)


class Select(Ch):
    """Entries `idxs` of another variable, flat, in the shape `preferred_shape`."""

    def __init__(self, a, idxs, preferred_shape):
        self._dirty_vars, self._itr = set(), None
        self.a, self.idxs, self.preferred_shape = a, np.asarray(idxs, np.uint32), preferred_shape

    @property
    def r(self) -> np.ndarray:
        return self.a.r.ravel()[self.idxs].reshape(self.preferred_shape)


class _Python2(pickle._Pickler):
    def save_reduce(self, func, args, state=None, *rest, obj=None, **options):
        if isinstance(obj, Ch):  # old-style reduction of a new-style class at protocol 2 written from protocol < 2
            func, args = __import__("copyreg")._reconstructor, (type(obj), object, None)
        return super().save_reduce(func, args, state, *rest, obj=obj, **options)

    def save_str(self, obj):
        """Python 2's str where it is ASCII, as the keys of those files are."""
        if obj.isascii() and len(obj) < 256:
            self.write(pickle.SHORT_BINSTRING + bytes([len(obj)]) + obj.encode())
            self.memoize(obj)
        else:
            super().save_str(obj)

    def save_bytes(self, obj):
        """Python 2's str, which is what array contents were."""
        self.write(pickle.BINSTRING + len(obj).to_bytes(4, "little") + obj)
        self.memoize(obj)

    dispatch: ClassVar[dict] = {**pickle._Pickler.dispatch, str: save_str, bytes: save_bytes}


def fake_modules() -> dict[str, types.ModuleType]:
    """Modules under which the standard unpickler finds `Ch` and `Select`, for other people's readers in tests."""
    chumpy, ch, reordering = (types.ModuleType(n) for n in ("chumpy", "chumpy.ch", "chumpy.reordering"))
    chumpy.ch, chumpy.reordering, ch.Ch, chumpy.Ch, reordering.Select = ch, reordering, Ch, Ch, Select
    return {"chumpy": chumpy, "chumpy.ch": ch, "chumpy.reordering": reordering}


def python2_pickle(content) -> bytes:
    """`content` as protocol 2 of Python 2, chumpy's and SciPy's classes under their names of 2015."""
    names = {Ch: ("chumpy.ch", "Ch"), Select: ("chumpy.reordering", "Select")}
    before = {name: sys.modules.get(name) for name in fake_modules()}
    modules = {cls: cls.__module__ for cls in names}
    sys.modules.update(fake_modules())
    try:
        for cls, (module, _) in names.items():
            cls.__module__ = module
        stream = io.BytesIO()
        _Python2(stream, 2, fix_imports=True).dump(content)
    finally:
        for cls, module in modules.items():
            cls.__module__ = module
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
    # the names that NumPy and SciPy had then
    data = stream.getvalue().replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n")
    for form in (b"csc", b"csr"):
        data = data.replace(b"cscipy.sparse._" + form + b"\n", b"cscipy.sparse." + form + b"\n")
    return data
