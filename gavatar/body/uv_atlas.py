"""UV atlases of the official bodies: from the .obj and .npz files that their makers offer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.numpy_file import load_npz

from .search import files_below

# SMPL-H has SMPL's mesh
_NAMES = {
    "smpl": ("smpl_uv", "smplh_uv"),
    "smplh": ("smplh_uv", "smpl_uv"),
    "smplx": ("smplx_uv",),
}
_OFFERS = {
    "smpl": "smpl_uv.obj (UV map in OBJ format) from https://smpl.is.tue.mpg.de",
    "smplh": "smpl_uv.obj (UV map in OBJ format; SMPL-H has SMPL's mesh) from https://smpl.is.tue.mpg.de",
    "smplx": "smplx_uv.obj (UV map) from https://smpl-x.is.tue.mpg.de",
}


def find_uv(
    family: Any, model: Path, arrays: dict[str, Any], given: str, folders: list[Path]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces (F, 3) int32, uv (U, 2) float64, v up, and uv_faces (F, 3) int32 of a model.

    From the file `given`; else from `vt` and `ft` in the model file; else from smpl_uv*.obj or .npz (smplx_uv*) beside
    the model or below `folders`. Raises UserError saying which file to download, or what is wrong with one.
    """
    faces, count = np.asarray(arrays["f"]).astype(np.int32), len(arrays["v_template"])
    if given:
        return _read(Path(given).expanduser(), faces, count)
    if "vt" in arrays and "ft" in arrays:
        return _checked(model, faces, faces, np.asarray(arrays["vt"]), np.asarray(arrays["ft"]))
    for stem in _NAMES[family.name]:
        for _, path in files_below([model.parent, *folders]):
            name = path.name.lower()
            if name.startswith(stem) and name.endswith((".obj", ".npz")):
                return _read(path, faces, count)
    raise UserError(
        f"body '{family.name}': {model} has no UV atlas and none lies beside it; download {_OFFERS[family.name]} and "
        "put it into the same folder, or give body.uv=FILE"
    )


def _read(path: Path, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if not path.is_file():
        raise UserError(f"UV atlas {path} does not exist: give an .obj or .npz file")
    if path.suffix.lower() == ".npz":
        arrays = load_npz(path, ("vt", "ft", "f"))
        for key in ("vt", "ft"):
            if key not in arrays:
                raise UserError(f"{path}: array '{key}' is missing: a UV atlas holds vt (U, 2) and ft (F, 3)")
        return _checked(path, faces, arrays.get("f", faces), arrays["vt"], arrays["ft"])
    vertices, vt, f, ft = read_obj(path)
    if vertices != count:
        raise UserError(f"{path} has {vertices} vertices and the model {count}: it is the atlas of another model")
    return _checked(path, faces, f, vt, ft)


def read_obj(path: Path) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Number of vertices, vt (U, 2), faces (F, 3) and uv faces (F, 3), counted from 0, of a Wavefront .obj of
    triangles. Raises UserError naming file and line."""
    vertices, vt, corners = 0, [], []
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
    for number, line in enumerate(lines, 1):
        word, *values = line.split() or [""]
        try:
            if word == "v":
                vertices += 1
            elif word == "vt":
                vt.append((float(values[0]), float(values[1])))
            elif word == "f":
                if len(values) != 3:
                    raise UserError(f"{path}, line {number}: a face of {len(values)} corners, expected triangles")
                corners.append([[int(n) for n in value.split("/")[:2]] for value in values])
        except (ValueError, IndexError):
            raise UserError(f"{path}, line {number}: '{line.strip()}' is not understood") from None
    if not corners or {len(corner) for face in corners for corner in face} != {2}:
        raise UserError(f"{path} has no faces with UV coordinates (lines 'f 1/1 2/2 3/3')")
    table = np.asarray(corners, np.int64) - 1
    return vertices, np.asarray(vt, np.float64).reshape(-1, 2), table[..., 0], table[..., 1]


def _checked(
    path: Path, faces: np.ndarray, f: np.ndarray, vt: np.ndarray, ft: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The atlas, its faces being the model's in whatever order."""
    if vt.ndim != 2 or vt.shape[1] < 2 or not np.isfinite(vt).all():
        raise UserError(f"{path}: its UV coordinates must be finite numbers (U, 2)")
    if ft.shape != f.shape or ft.shape[1:] != (3,) or not len(ft) or not 0 <= ft.min() <= ft.max() < len(vt):
        raise UserError(f"{path}: its UV faces must be (F, 3) like its faces, with numbers below {len(vt)}")
    if f is not faces and not np.array_equal(_sorted(f), _sorted(faces)):
        raise UserError(f"{path}: its triangles are not the model's: it is the atlas of another model")
    return f.astype(np.int32), np.asarray(vt[:, :2], np.float64), ft.astype(np.int32)


def _sorted(faces: np.ndarray) -> np.ndarray:
    ordered = np.sort(faces, 1)
    return ordered[np.lexsort(ordered.T)]
