"""The compiled kernel (`deploy/native/`) through ctypes: loading, threads, instruction set. Needs only NumPy.

The package works without it: `library()` raises UserError, `available()` says why, and the other rasterizers serve.
"""

from __future__ import annotations

import ctypes
import functools
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from . import splatting_rule as rules
from .cpus import usable_cpus
from .errors import UserError

ABI_VERSION = 5
MOST_THREADS = 256  # as in pool.cpp
LIBRARY = Path(__file__).with_name("_gavatar_native" + {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so"))

INSTALL_AGAIN = "install gavatar again (in a checkout: pip install -e .)"

_P, _F, _D, _I, _L = ctypes.c_void_p, ctypes.c_float, ctypes.c_double, ctypes.c_int32, ctypes.c_int64


# These mirror gavatar_native.h, field by field: GvGaussians is GaussiansStruct here. ABI_VERSION changes with them.
_ARRAYS = [(name, _P) for name in ("means", "scales", "colors", "opacities", "quaternions")]


class GaussiansStruct(ctypes.Structure):
    __slots__ = ()
    _fields_ = (("count", _L), *_ARRAYS, ("normals", _P), ("scale_columns", _I))


class CameraStruct(ctypes.Structure):
    __slots__ = ()
    _fields_ = (
        ("rotation", _D * 9), ("translation", _D * 3), ("fx", _D), ("fy", _D), ("cx", _D), ("cy", _D), ("width", _I),
        ("height", _I),
    )  # fmt: skip


class OptionsStruct(ctypes.Structure):
    __slots__ = ()
    _fields_ = (
        ("background", _F * 3), ("transmittance_stop", _F), ("block_stop", _F), ("keep", _I), ("fast", _I),
        ("antialiased", _I), ("backface", _F), ("depth_cut", _F),
    )  # fmt: skip


class ImagesStruct(ctypes.Structure):
    __slots__ = ()
    _fields_ = (("color", _P), ("alpha", _P), ("depth", _P), ("color8", _P))


class ReportStruct(ctypes.Structure):
    __slots__ = ()
    _fields_ = (
        ("dropped", _L), ("visible", _L), ("entries", _L), ("blended", _L), ("project_s", _D), ("sort_s", _D),
        ("blend_s", _D),
    )  # fmt: skip


class GradientsStruct(ctypes.Structure):
    __slots__ = ()
    _fields_ = tuple(_ARRAYS)


class BackwardReportStruct(ctypes.Structure):
    __slots__ = ()
    _fields_ = (("blend_s", _D), ("project_s", _D))


STRUCTS = (
    GaussiansStruct, CameraStruct, OptionsStruct, ImagesStruct, ReportStruct, GradientsStruct, BackwardReportStruct,
)  # fmt: skip
RULE = {name: value for name, value in vars(rules).items() if name.isupper()}

# What `mismatch` calls once the version is right, before it is known whether all else is.
_CHECKS: dict[str, tuple[Any, list[Any]]] = {
    "gv_struct_size": (_L, [ctypes.c_char_p]),
    "gv_rule": (_D, [ctypes.c_char_p]),
}
_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "gv_compiler": (ctypes.c_char_p, []),
    "gv_isa_count": (_I, []),
    "gv_isa_name": (ctypes.c_char_p, [_I]),
    "gv_isa_supported": (_I, [_I]),
    "gv_isa": (_I, []),
    "gv_set_isa": (_I, [_I]),
    "gv_threads": (_I, []),
    "gv_set_threads": (None, [_I]),
    "gv_frame_new": (_P, []),
    "gv_frame_free": (None, [_P]),
    "gv_frame_bytes": (_L, [_P]),
    "gv_forward": (_I, [_P] * 6),
    "gv_backward": (_I, [_P] * 8),
    "gv_skin": (_I, [_L, _I, _I, _I] + [_P] * 5),
    "gv_skin_backward": (_I, [_L, _I, _I, _I] + [_P] * 7),
    "gv_blendshapes": (_I, [_L, _I, _I] + [_P] * 8),
    "gv_upsample": (_I, [_L, _I, _I] + [_P] * 7),
    "gv_ssim": (_I, [_L, _I, _I, _I, _I] + [_P] * 6),
    "gv_sparse_product": (_I, [_L, _I, _I] + [_P] * 5),
    "gv_resize": (_I, [_I, _I, _I, _P, _I, _I, _P]),
    "gv_resize8": (_I, [_I, _I, _I, _P, _I, _I, _P]),
    "gv_jpeg_most": (_L, [_I, _I]),
    "gv_jpeg": (_L, [_I, _I, _P, _I, _P]),
}


def _declare(lib: ctypes.CDLL, signatures: dict[str, tuple[Any, list[Any]]]) -> None:
    """Raises AttributeError for a function that the library lacks."""
    for name, (result, arguments) in signatures.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments


def mismatch(
    lib: ctypes.CDLL,
    structs: Sequence[type[ctypes.Structure]] = STRUCTS,
    rule: Mapping[str, float] = RULE,
) -> str:
    """What `lib` was compiled with that this package has otherwise, '' if nothing: version, sizes of structs, rule."""
    if lib.gv_abi_version() != ABI_VERSION:
        return f"version {lib.gv_abi_version()} of the interface, {ABI_VERSION} is needed"
    _declare(lib, _CHECKS)
    for struct in structs:
        name, wanted = "Gv" + struct.__name__.removesuffix("Struct"), ctypes.sizeof(struct)
        size = lib.gv_struct_size(name.encode())
        if size != wanted:
            return f"its {name} has {size} bytes, {wanted} are needed"
    for name, value in rule.items():
        compiled = lib.gv_rule(name.encode())
        if compiled != ctypes.c_float(value).value:
            return f"its {name} is {compiled:g}, the rule's is {value:g}"
    return ""


@functools.cache
def _load() -> tuple[ctypes.CDLL | None, str]:
    """The library and '', or None and the reason."""
    if os.environ.get("GAVATAR_NATIVE") == "0":
        return None, "it is switched off by GAVATAR_NATIVE=0"
    path = Path(os.environ.get("GAVATAR_NATIVE_LIBRARY") or LIBRARY)
    if not path.exists():
        return None, f"{path.name} is not in this install (a wheel without it, no C++ compiler, or it failed)"
    try:
        lib = ctypes.CDLL(str(path))
        difference = mismatch(lib)
        if not difference:
            _declare(lib, _SIGNATURES)
    except (OSError, AttributeError) as error:
        return None, f"{path.name} cannot be loaded ({error}); {INSTALL_AGAIN}"
    if difference:
        return None, f"{path.name} is of another version of gavatar ({difference}); {INSTALL_AGAIN}"
    if not lib.gv_isa_supported(0):
        return None, "this processor lacks SSE4.1"
    lib.gv_set_threads(min(usable_cpus(), MOST_THREADS))  # the kernel by itself knows affinity, but no quotas
    wanted = os.environ.get("GAVATAR_NATIVE_ISA")
    if wanted:
        _choose(lib, wanted)
    return lib, ""


def available() -> tuple[bool, str]:
    """(whether the compiled kernel can be used, the reason if not)."""
    lib, reason = _load()
    return lib is not None, reason


def library() -> ctypes.CDLL:
    """The loaded kernel. Raises UserError with the reason and what to use instead."""
    lib, reason = _load()
    if lib is None:
        raise UserError(f"rasterizer 'native' is not available: {reason}; use rasterizer numpy (player) or torch")
    return lib


def instruction_sets() -> list[str]:
    """The compiled-in instruction sets that this processor has, from the plainest to the best."""
    lib = library()
    return [lib.gv_isa_name(i).decode() for i in range(lib.gv_isa_count()) if lib.gv_isa_supported(i)]


def instruction_set() -> str:
    """The instruction set in use: the best one unless GAVATAR_NATIVE_ISA or `use_instruction_set` chose another."""
    lib = library()
    return lib.gv_isa_name(lib.gv_isa()).decode()


def use_instruction_set(name: str | None) -> None:
    """Use instruction set `name` from now on, None for the best. Raises UserError if this processor lacks it."""
    _choose(library(), name)


def _choose(lib: ctypes.CDLL, name: str | None) -> None:
    names = [lib.gv_isa_name(i).decode() for i in range(lib.gv_isa_count()) if lib.gv_isa_supported(i)]
    if name is not None and name not in names:
        raise UserError(f"GAVATAR_NATIVE_ISA '{name}' is not one of this processor's: {', '.join(names)}")
    lib.gv_set_isa(-1 if name is None else names.index(name))


def threads() -> int:
    """Threads that the kernel uses, the caller's included."""
    return library().gv_threads()


def set_threads(count: int) -> None:
    """Use `count` threads from now on; 0 for as many as `cpus.usable_cpus`, at most `MOST_THREADS`."""
    if not 0 <= count <= MOST_THREADS:
        raise UserError(f"rasterizer.threads must be between 0 and {MOST_THREADS}, got {count}")
    library().gv_set_threads(count or min(usable_cpus(), MOST_THREADS))


class Frame:
    """What a forward leaves for its backward, and buffers for the next frame: one at a time a frame in flight."""

    handle: int | None = None

    def __init__(self) -> None:
        self._lib = library()
        self.handle = self._lib.gv_frame_new()
        if not self.handle:
            raise MemoryError("native rasterizer: out of memory")

    @property
    def nbytes(self) -> int:
        return self._lib.gv_frame_bytes(self.handle)

    def __del__(self) -> None:
        if self.handle:
            self._lib.gv_frame_free(self.handle)
            self.handle = None


def camera_struct(camera: Any) -> CameraStruct:
    """A `gavatar_runtime.values.camera.Camera` for the kernel. Raises UserError for what is not a camera's numbers."""
    T = camera.T_camera_world
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, *T[:3].ravel().tolist())
    if not (0 < camera.width <= 1 << 17 and 0 < camera.height <= 1 << 17):
        raise UserError(f"camera: width and height must be in 1..131072, got {camera.width} x {camera.height}")
    if not (camera.fx > 0 and camera.fy > 0 and all(abs(x) < 1e30 for x in numbers)):
        raise UserError("camera: fx and fy must be positive and every number finite")
    return CameraStruct(
        (_D * 9)(*T[:3, :3].ravel().tolist()), (_D * 3)(*T[:3, 3].tolist()), *numbers[:4], camera.width, camera.height
    )


def check(code: int) -> None:
    """Turn a kernel's return code into an exception."""
    if code == -2:
        raise IndexError("native kernel: an index or a size lies outside what the arrays hold")
    if code:
        raise MemoryError("native rasterizer: out of memory")
