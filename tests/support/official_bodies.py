"""Body models of our own making in the official files' layouts: keys, shapes, dtypes and object types as downloaded.

Two kinds: random numbers with any number of vertices, for comparing arithmetic, and the free body dressed up as SMPL,
SMPL-H or SMPL-X (its own mesh, with jaw and eyes added), for looking at.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from fake_chumpy import Ch, python2_pickle

from gavatar_runtime.values.skeletons import BODY, FINGERS, SMPL, SMPLH, SMPLX

JOINTS = {"smpl": SMPL, "smplh": SMPLH, "smplx": SMPLX}
_BODY_PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]


def parents(names: tuple[str, ...]) -> list[int]:
    """Each joint's parent: fingers hang in chains of three on the wrists, jaw and eyes on the head."""
    out = list(_BODY_PARENTS)
    for name in names[len(BODY) :]:
        side = name.split("_")[0]
        if name in FINGERS:
            out.append(names.index(f"{side}_wrist") if name.endswith("1") else len(out) - 1)
        else:
            out.append(names.index(f"{side}_wrist") if name.endswith("_hand") else names.index("head"))
    return out


def kintree(names: tuple[str, ...]) -> np.ndarray:
    """(2, J) uint32; the root's parent is 2^32 - 1, as in the files."""
    return np.array([parents(names), range(len(names))], np.int64).astype(np.uint32)


def random_arrays(family: str, vertices: int = 60, coefficients: int | None = None, seed: int = 0) -> dict:
    """A model of random numbers of the right order of magnitude."""
    rng = np.random.default_rng(seed)
    names = JOINTS[family]
    J, V = len(names), vertices
    coefficients = coefficients or {"smpl": 10, "smplh": 16, "smplx": 20}[family]
    # joints at sparse averages of vertices, weights on a few joints of each vertex
    regressor, weights = np.zeros((J, V)), np.zeros((V, J))
    for row in regressor:
        row[rng.choice(V, 5, replace=False)] = rng.dirichlet(np.ones(5))
    for row in weights:
        row[rng.choice(J, 4, replace=False)] = rng.dirichlet(np.ones(4))
    arrays = {
        "v_template": rng.normal(0, 0.5, (V, 3)),
        "shapedirs": rng.normal(0, 0.02, (V, 3, coefficients)),
        "posedirs": rng.normal(0, 0.003, (V, 3, 9 * (J - 1))).astype(np.float32),
        "J_regressor": regressor,
        "weights": weights,
        "f": _distinct_faces(rng, V),
        "kintree_table": kintree(names),
    }
    if J > 50:
        arrays |= hand_arrays(seed)
    if family == "smplx":
        arrays |= {"lmk_faces_idx": np.arange(51), "lmk_bary_coords": np.full((51, 3), 1 / 3)}
    return arrays


def _distinct_faces(rng: np.random.Generator, vertices: int) -> np.ndarray:
    """(F, 3) uint32, some 2 V triangles of three different vertices, none of them twice."""
    faces = np.unique(np.sort(rng.integers(0, vertices, (2 * vertices, 3)), 1), axis=0)
    faces = faces[(np.diff(faces, axis=1) > 0).all(1)]
    return rng.permuted(rng.permutation(faces), axis=1).astype(np.uint32)


def hand_arrays(seed: int = 0) -> dict:
    """Mean and components of both hands: orthonormal rows, as a principal component analysis gives."""
    rng = np.random.default_rng([seed, 1])
    arrays = {}
    for side in "lr":
        arrays[f"hands_mean{side}"] = rng.normal(0, 0.3, 45)
        arrays[f"hands_components{side}"] = np.linalg.qr(rng.normal(size=(45, 45)))[0]
        arrays[f"hands_coeffs{side}"] = rng.normal(size=(6, 45))
    return arrays


def uv_arrays(arrays: dict) -> dict:
    """An atlas for any mesh: each triangle alone in a cell of a square grid."""
    count = len(arrays["f"])
    side = int(np.ceil(np.sqrt(count)))
    cell = np.stack([np.arange(count) % side, np.arange(count) // side], -1)[:, None] / side
    corners = np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]) / side
    return {"vt": (cell + corners).reshape(-1, 2), "ft": np.arange(3 * count, dtype=np.int64).reshape(-1, 3)}


def obj_text(arrays: dict, uv: dict, shuffled: bool = False) -> str:
    """The mesh and its atlas as Wavefront .obj, v, vt and f v/vt; `shuffled` turns and reorders the triangles."""
    f, ft = np.asarray(arrays["f"], np.int64) + 1, np.asarray(uv["ft"]) + 1
    if shuffled:
        order = np.random.default_rng(0).permutation(len(f))
        f, ft = np.roll(f[order], 1, 1), np.roll(ft[order], 1, 1)
    lines = ["# a comment", "mtllib body.mtl"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in arrays["v_template"]]
    lines += [f"vt {u:.9f} {v:.9f}" for u, v in uv["vt"]]
    lines += [f"f {a}/{x} {b}/{y} {c}/{z}" for (a, b, c), (x, y, z) in zip(f, ft, strict=True)]
    return "\n".join(lines) + "\n"


def write_smpl_pickle(path: Path, arrays: dict) -> Path:
    """As the SMPL of 2015: Python 2, chumpy variables, a sparse regressor, strings beside the numbers."""
    import scipy.sparse

    content = {
        **arrays,
        "J_regressor": scipy.sparse.csc_matrix(arrays["J_regressor"]),
        "J_regressor_prior": scipy.sparse.csc_matrix(arrays["J_regressor"]),
        "shapedirs": Ch(arrays["shapedirs"]),
        "v_template": Ch(arrays["v_template"]) if "hands_meanl" not in arrays else arrays["v_template"],
        "J": arrays["J_regressor"] @ arrays["v_template"],
        "bs_type": "lrotmin",
        "bs_style": "lbs",
        "vert_sym_idxs": np.arange(len(arrays["v_template"])),
        "weights_prior": arrays["weights"],
    }
    path.write_bytes(python2_pickle(content))
    return path


def write_mano(folder: Path, arrays: dict) -> None:
    """MANO_LEFT.pkl and MANO_RIGHT.pkl: of each the hand's mean and components (and the mesh, which is not read)."""
    for side, name in (("l", "LEFT"), ("r", "RIGHT")):
        content = {
            "hands_mean": arrays[f"hands_mean{side}"],
            "hands_components": arrays[f"hands_components{side}"],
            "v_template": Ch(np.zeros((5, 3))),
        }
        (folder / f"MANO_{name}.pkl").write_bytes(python2_pickle(content))


def write_npz(path: Path, arrays: dict) -> Path:
    """As SMPL-X's .npz: plain arrays and two dictionaries as objects, which nobody needs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = {"joint2num": np.array({"pelvis": 0}, object), "part2num": np.array({"body": 0}, object)}
    np.savez(path, **arrays, **names)
    return path


def dressed_free_body(family: str, pose_mm: float = 8.0) -> dict:
    """The free body as a model of the family with its own atlas and smooth pose blendshapes of up to about `pose_mm`.
    SMPL-X gets a jaw and eyes cut from the head's skinning weights and expressions that move the mouth; SMPL's fingers
    are stiff."""
    from make_bundle import free_body

    free = free_body()
    names, V = JOINTS[family], len(free.v_template)
    weights, regressor = np.zeros((V, len(names))), np.zeros((len(names), V))
    for j, name in enumerate(free.joint_names):
        place = names.index(name if name in names else f"{name.split('_')[0]}_hand")
        weights[:, place] += free.lbs_weights[:, j]
        if name in names or name.endswith("middle1"):
            regressor[place] = free.J_regressor[j]
    vertices = free.v_template.astype(np.float64)
    expression = np.zeros((V, 3, 10))
    if family == "smplx":
        expression = _face(names, vertices, weights, regressor)
    joints = regressor @ vertices
    arrays = {
        "v_template": vertices,
        "shapedirs": np.concatenate([free.shapedirs, expression], 2) if family == "smplx" else free.shapedirs,
        "posedirs": _pose_blendshapes(names, vertices, joints, 0.001 * pose_mm),
        "J_regressor": regressor,
        "weights": weights,
        "f": free.faces.astype(np.uint32),
        "kintree_table": kintree(names),
        "vt": free.uv,
        "ft": free.uv_faces.astype(np.uint32),
    }
    if family == "smpl":
        return arrays
    arrays |= hand_arrays()
    for side, sign in (("l", -1), ("r", 1)):  # hands that rest half closed
        arrays[f"hands_mean{side}"] = np.tile([0, 0, 0.35 * sign], 15)
    return arrays


def _face(names, vertices: np.ndarray, weights: np.ndarray, regressor: np.ndarray) -> np.ndarray:
    """Give jaw and eyes their joints and their share of the head's weights; returns (V, 3, 10) expressions."""
    head = names.index("head")
    ours = np.flatnonzero(weights[:, head] > 0.9)
    top, front = vertices[ours, 1].max(), vertices[ours, 2].max()
    x, y, z = (vertices - (0, top, front)).T
    smooth = lambda value, low, high: np.clip((value - low) / (high - low), 0, 1)  # noqa: E731
    chin = weights[:, head] * smooth(-y, 0.178, 0.192) * smooth(z, -0.1, -0.06)
    centres = {
        "jaw": (0, -0.14, -0.1),
        "left_eye_smplhf": (0.032, -0.105, -0.03),
        "right_eye_smplhf": (-0.032, -0.105, -0.03),
    }
    shares = {"jaw": chin}
    for name in list(centres)[1:]:
        distance = np.linalg.norm(np.stack([x, y, z], -1) - centres[name], axis=-1)
        shares[name] = weights[:, head] * 0.8 * smooth(-distance, -0.022, -0.008)
    for name, share in shares.items():
        weights[:, names.index(name)] += share
        weights[:, head] -= share
        target = centres[name] + np.array([0, top, front])
        regressor[names.index(name)] = _regress(vertices[ours], target, ours, len(vertices))
    rng = np.random.default_rng(0)
    mouth = np.exp(-(x**2 + (y + 0.175) ** 2) / 0.02**2) * smooth(z, -0.06, -0.02)
    return 0.003 * mouth[:, None, None] * rng.normal(size=(1, 3, 10))


def _regress(points: np.ndarray, target: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """(count,) weights on `rows`, of sum 1, whose average of the points is the target: the least of them."""
    A = np.concatenate([points.T, np.ones((1, len(points)))])
    out = np.zeros(count)
    out[rows] = np.linalg.lstsq(A, np.append(target, 1), rcond=None)[0]
    return out


def _pose_blendshapes(names, vertices: np.ndarray, joints: np.ndarray, size: float) -> np.ndarray:
    """(V, 3, 9 (J-1)): each joint moves the skin around it, 7 cm wide, in directions of its own."""
    rng = np.random.default_rng(0)
    out = np.zeros((len(vertices), 3, 9 * (len(names) - 1)), np.float32)
    for j, centre in enumerate(joints[1:]):
        near = np.exp(-np.sum((vertices - centre) ** 2, -1) / 0.07**2).astype(np.float32)
        near[near < 1e-4] = 0
        out[:, :, 9 * j : 9 * j + 9] = near[:, None, None] * rng.normal(0, 0.4 * size, (1, 3, 9)).astype(np.float32)
    return out
