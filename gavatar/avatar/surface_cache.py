"""Sampled surfaces on disk, so that each is computed once."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.surface_file import load_surface, save_surface
from gavatar_runtime.geometry import kinematics, ordering, rotations
from gavatar_runtime.values import body as body_module
from gavatar_runtime.values import surface as runtime_surface
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Surface

from . import on_body


def cached(
    name: str,
    body: BodyData,
    betas: np.ndarray | None,
    key: str,
    code: Path,
    sample: Callable[[], Surface],
    cache_dir: str | os.PathLike[str] | None = None,
) -> Surface:
    """What `sample` gives, from the cache where it was computed before.

    name: that its file begins with. body, betas, key: all that it depends on, and `code`, the source file that samples.
    cache_dir: folder of computed surfaces, by default `default_cache_dir()`; a damaged or unwritable cache is passed
    over in silence.
    """
    folder = default_cache_dir() if cache_dir is None else Path(cache_dir)
    path = folder / f"{name}-{_fingerprint(body, betas, key, code)}.npz"
    with contextlib.suppress(UserError):
        return load_surface(path)
    surface = sample()
    with contextlib.suppress(UserError, OSError):
        save_surface(path, surface)
    return surface


def default_cache_dir() -> Path:
    """`$XDG_CACHE_HOME/gavatar/surfaces`, or under `~/.cache` where the variable is unset, empty or relative."""
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():
        try:
            base = Path.home() / ".cache"
        except RuntimeError:  # a user without a home, as in some containers
            base = Path(tempfile.gettempdir())
    return base / "gavatar" / "surfaces"


def _fingerprint(body: BodyData, betas: np.ndarray | None, key: str, code: Path) -> str:
    """Hash of everything the surface depends on, the code that computes it included."""
    digest = hashlib.sha256(f"{key} {' '.join(body.joint_names)}".encode())
    for module in (body_module, kinematics, rotations, ordering, runtime_surface, on_body):
        digest.update(Path(inspect.getfile(module)).read_bytes())
    digest.update(code.read_bytes())
    shape = np.zeros(0) if betas is None else np.asarray(betas, np.float64).reshape(-1)
    arrays = (body.v_template, body.shapedirs, body.J_regressor, body.parents, body.lbs_weights, body.faces, body.uv)
    blendshapes = [] if body.posedirs is None else [body.posedirs]
    for array in (shape, body.uv_faces, *arrays, *blendshapes):
        array = np.asarray(array)
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()[:32]
