"""The official files of SMPL, SMPL-H and SMPL-X, read as they are downloaded.

They come as pickles of Python 2 with chumpy and SciPy objects inside (read by `gavatar_runtime.formats.safe_pickle`,
which runs nothing) or as .npz, under names that differ from release to release.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gavatar_runtime.errors import UserError, did_you_mean
from gavatar_runtime.formats.numpy_file import load_npz
from gavatar_runtime.formats.safe_pickle import load_pickle
from gavatar_runtime.geometry.skinning import whole_weights
from gavatar_runtime.values.body import BodyData, Hands
from gavatar_runtime.values.skeletons import SMPL, SMPLH, SMPLX

from .search import ENVIRONMENT, files_below, search_folders
from .uv_atlas import find_uv

GENDERS = {"neutral": "n", "male": "m", "female": "f"}
_KEYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "f", "kintree_table")
_HAND_KEYS = ("hands_meanl", "hands_meanr", "hands_componentsl", "hands_componentsr")


@dataclasses.dataclass(frozen=True)
class Family:
    """What is particular to one model. names: regular expressions of its files, lower case, best first, with {gender}
    and {g} for its first letter. shape, few: shape coefficients before those of expression, in files of 400 and in
    short ones. download, license: for messages and manifests."""

    name: str
    title: str
    joint_names: tuple[str, ...]
    names: tuple[str, ...]
    example: str
    download: str
    license: str
    expression: bool = False


FAMILIES = {
    "smpl": Family(
        "smpl", "SMPL", SMPL,
        (r"smpl_{gender}\.(npz|pkl)", r"basicmodel_({gender}|{g})_lbs_10_207_0_v1\.\d+\.\d+\.(pkl|npz)"),
        "SMPL_{GENDER}.pkl or basicmodel_{g}_lbs_10_207_0_v1.1.0.pkl",
        "https://smpl.is.tue.mpg.de (SMPL for Python, version 1.1.0)",
        "SMPL Model License, non-commercial: https://smpl.is.tue.mpg.de/modellicense.html",
    ),
    "smplh": Family(
        "smplh", "SMPL-H", SMPLH,
        (r"smplh_{gender}\.(npz|pkl)", r".*smplh?[^/]*/{gender}/model\.(npz|pkl)"),
        "SMPLH_{GENDER}.pkl or smplh/{gender}/model.npz",
        "https://mano.is.tue.mpg.de (Extended SMPL+H model, or Models & Code)",
        "MANO/SMPL+H Model License, non-commercial: https://mano.is.tue.mpg.de/license.html",
    ),
    "smplx": Family(
        "smplx", "SMPL-X", SMPLX,
        (r"smplx_{gender}\.(npz|pkl)", r"smplx_{gender}_.*\.(npz|pkl)", r".*smplx[^/]*/{gender}/model\.(npz|pkl)"),
        "SMPLX_{GENDER}.npz",
        "https://smpl-x.is.tue.mpg.de (SMPL-X v1.1, NPZ+PKL)",
        "SMPL-X Model License, non-commercial: https://smpl-x.is.tue.mpg.de/modellicense.html",
        expression=True,
    ),
}  # fmt: skip


def find_model(family: Family, path: str, gender: str) -> Path:
    """The model file of a family and gender: `path` itself if it is a file, else the best match below `path` and the
    folders of GAVATAR_BODY_MODELS. Raises UserError saying which file to download and where to put it."""
    if gender not in GENDERS:
        raise UserError(f"body.gender={gender}: {did_you_mean(str(gender), GENDERS)}")
    if path and not Path(path).expanduser().exists():
        raise UserError(f"body.path={path} does not exist: give a model file or the folder that holds it")
    if path and Path(path).expanduser().is_file():
        return Path(path).expanduser()
    folders = search_folders(path)
    words = {"gender": gender, "g": GENDERS[gender]}
    files = list(files_below(folders))
    for name in family.names:
        pattern = re.compile(name.format(**words))
        matches = [p for relative, p in files if pattern.fullmatch(relative if "/" in name else p.name.lower())]
        if matches:
            return min(matches, key=lambda p: p.suffix.lower() != ".npz")  # the first .npz, else the first
    example = family.example.format(gender=gender, GENDER=gender.upper(), g=GENDERS[gender])
    where = ", ".join(map(str, folders)) or f"nowhere: neither body.path nor ${ENVIRONMENT} names a folder"
    raise UserError(
        f"body '{family.name}': no {gender} {family.title} model was found (looked in {where}); download {example} "
        f"from {family.download}, put it into a folder, and give body.path=FOLDER or {ENVIRONMENT}=FOLDER"
    )


def read_arrays(path: Path, keys: tuple[str, ...]) -> dict[str, Any]:
    """Those of `keys` that the model file holds, by its suffix. Raises UserError for a file that cannot be read."""
    if path.suffix.lower() == ".npz":
        return load_npz(path, keys)
    if path.suffix.lower() != ".pkl":
        raise UserError(f"{path}: a body model is an .npz or .pkl file")
    content = load_pickle(path)
    if not isinstance(content, dict):
        raise UserError(f"{path} holds no model: a dictionary with v_template, shapedirs, ... was expected")
    return {key: content[key] for key in keys if key in content}


def read_body(family: Family, path: Path, *, num_betas: int = 0, num_expression: int = 10, hands: str = "flat",
              uv: str = "", folders: Sequence[Path] = ()) -> BodyData:  # fmt: skip
    """The body in a model file, with the UV atlas of the user's own files.

    num_betas: shape coefficients kept, 0 for all that the file has. num_expression: the same for expression, -1 for
    all. hands: `flat` or `mean`, see `Hands.relative`. uv: an .obj or .npz with the atlas, '' to look for one.
    Raises UserError naming file and field.
    """
    arrays = read_arrays(path, (*_KEYS, *_HAND_KEYS, "vt", "ft"))
    _check(family, path, arrays)
    J = len(family.joint_names)
    V = len(arrays["v_template"])
    shapedirs, exprdirs = _directions(family, np.asarray(arrays["shapedirs"]).reshape(V, 3, -1))
    parents = np.asarray(arrays["kintree_table"])[0].astype(np.int64).astype(np.int32)
    parents[0] = -1
    faces, vt, ft = find_uv(family, path, arrays, uv, list(folders))
    return BodyData(
        name=family.name,
        v_template=np.asarray(arrays["v_template"], np.float64),
        shapedirs=shapedirs[:, :, : num_betas or None].astype(np.float32),
        J_regressor=np.asarray(arrays["J_regressor"], np.float64),
        parents=parents,
        lbs_weights=whole_weights(np.asarray(arrays["weights"], np.float64), f"{path}: 'weights'"),
        faces=faces,
        uv=vt,
        uv_faces=ft,
        joint_names=family.joint_names,
        posedirs=np.ascontiguousarray(np.asarray(arrays["posedirs"]).reshape(V, 3, 9 * (J - 1)), np.float32),
        exprdirs=None
        if exprdirs is None
        else exprdirs[:, :, : None if num_expression < 0 else num_expression].astype(np.float32),
        hands=_hands(family, path, arrays, hands, list(folders)) if J > 50 else None,
    )


def _directions(family: Family, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Shape and expression. SMPL-X keeps them in one array, 300 + 100, or 10 + 10 in the older, shorter files."""
    if not family.expression:
        return directions, None
    split = 300 if directions.shape[2] >= 400 else 10
    return directions[:, :, :split], directions[:, :, split:]


def _check(family: Family, path: Path, arrays: dict[str, Any]) -> None:
    for key in _KEYS:
        if key not in arrays:
            raise UserError(f"{path}: array '{key}' is missing: it is no {family.title} model as downloaded")
        if not isinstance(arrays[key], np.ndarray) or arrays[key].dtype.kind not in "fiu":
            raise UserError(f"{path}: '{key}' is not an array of numbers")
    J, V = len(family.joint_names), len(arrays["v_template"])
    count = arrays["kintree_table"].shape[-1]
    if count != J:
        others = [f.title for f in FAMILIES.values() if len(f.joint_names) == count]
        hint = f"it is a model of {others[0]}" if others else "it is another model"
        raise UserError(f"{path} has {count} joints and {family.title} has {J}: {hint}")
    shapes = {
        "v_template": (V, 3), "J_regressor": (J, V), "weights": (V, J), "kintree_table": (2, J),
    }  # fmt: skip
    for key, shape in shapes.items():
        if arrays[key].shape != shape:
            raise UserError(f"{path}: '{key}' has shape {arrays[key].shape}, expected {shape}")
    for key, size in (("posedirs", V * 3 * 9 * (J - 1)), ("shapedirs", None)):
        if arrays[key].shape[0] != V or (size is not None and arrays[key].size != size) or arrays[key].size % (3 * V):
            raise UserError(f"{path}: '{key}' has shape {arrays[key].shape}, which does not fit {V} vertices")
    for key in ("v_template", "shapedirs", "posedirs", "J_regressor", "weights"):
        if not np.isfinite(arrays[key]).all():
            raise UserError(f"{path}: '{key}' holds NaN or infinity: the file is damaged")
    faces, parents = arrays["f"], arrays["kintree_table"][0].astype(np.int64)
    if faces.ndim != 2 or faces.shape[1] != 3 or not (faces.min() >= 0 and faces.max() < V):
        raise UserError(f"{path}: 'f' must be (F, 3) vertex numbers below {V}")
    if not ((parents[1:] >= 0) & (parents[1:] < np.arange(1, J))).all():
        raise UserError(f"{path}: 'kintree_table' does not put every parent before its children")


def _hands(family: Family, path: Path, arrays: dict[str, Any], mode: str, folders: list[Path]) -> Hands | None:
    """Mean and components from the model file, or, for the SMPL-H files that lack them, from MANO's two files."""
    if mode not in ("flat", "mean"):
        raise UserError(f"body.hands={mode}: {did_you_mean(str(mode), ('flat', 'mean'))}")
    if all(key in arrays for key in _HAND_KEYS):
        sides = [(arrays[f"hands_mean{s}"], arrays[f"hands_components{s}"]) for s in "lr"]
    else:
        sides = [_mano(side, [path.parent, *folders]) for side in ("left", "right")]
    if any(mean is None for mean, _ in sides):
        if mode == "flat":
            return Hands(np.zeros((2, 15, 3)), np.zeros((2, 0, 45)))
        raise UserError(
            f"body.hands=mean: {path} has no hand poses (hands_meanl, ...); put MANO_LEFT.pkl and MANO_RIGHT.pkl from "
            "https://mano.is.tue.mpg.de beside it, or use body.hands=flat"
        )
    try:
        mean = np.stack([np.asarray(mean, np.float64).reshape(15, 3) for mean, _ in sides])
        components = np.stack([np.asarray(c, np.float64).reshape(-1, 45) for _, c in sides])
    except (TypeError, ValueError):
        raise UserError(f"{path}: its hand means must hold 45 numbers and its hand components 45 a row") from None
    return Hands(mean, components, relative=mode == "mean")


def _mano(side: str, folders: list[Path]) -> tuple[Any, Any]:
    """hands_mean and hands_components of MANO_LEFT.pkl or MANO_RIGHT.pkl; None where the file is not there."""
    for _, path in files_below([f for f in folders if f.is_dir()]):
        if path.name.lower() == f"mano_{side}.pkl":
            arrays = read_arrays(path, ("hands_mean", "hands_components"))
            if len(arrays) < 2:
                raise UserError(f"{path}: hands_mean or hands_components is missing")
            return arrays["hands_mean"], arrays["hands_components"]
    return None, None


@functools.lru_cache(maxsize=2)
def _cached(family: str, path: str, changed: int, options: tuple) -> BodyData:
    """`read_body`, for the several times that one process opens the same model."""
    return read_body(FAMILIES[family], Path(path), **dict(options))


def official_body(family: str, config: Any) -> tuple[BodyData, str]:
    """Body and licence of one of FAMILIES as the options of its component ask for it; the arrays are shared and
    read-only. Raises UserError for whatever is missing or wrong."""
    chosen = FAMILIES[family]
    path = find_model(chosen, config.path, config.gender)
    if config.num_betas < 0:
        raise UserError(f"body.num_betas={config.num_betas}: give a number of coefficients, 0 for all")
    options = {"num_betas": config.num_betas, "uv": config.uv, "folders": tuple(search_folders(config.path))}
    given = dataclasses.asdict(config)
    options |= {key: given[key] for key in ("hands", "num_expression") if key in given}
    return _cached(family, str(path), path.stat().st_mtime_ns, tuple(options.items())), chosen.license
