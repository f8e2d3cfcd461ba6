"""Our bodies against the `smplx` package on the same files: what `test_bodies.py` asserts and
docs/reference/bodies.md prints.

python tests/peers/smplx_parity.py          prints the table
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import pickle
import sys
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
from fake_chumpy import fake_modules
from official_bodies import random_arrays, uv_arrays, write_npz, write_smpl_pickle

from gavatar.body.skeleton import PosedBody
from gavatar.registry import BODIES, load_plugins

VERTICES = {"smpl": 6890, "smplh": 6890, "smplx": 10475}  # their code picks landmarks by vertex number
CASES = {
    "SMPL": ("smpl", "pkl", {}),
    "SMPL-H, axis-angle hands, flat": ("smplh", "pkl", {"flat_hand_mean": True, "use_pca": False}),
    "SMPL-H, 6 components, mean": ("smplh", "npz", {"flat_hand_mean": False, "num_pca_comps": 6}),
    "SMPL-X, axis-angle hands, mean": ("smplx", "npz", {"flat_hand_mean": False, "use_pca": False}),
    "SMPL-X, 12 components, flat": ("smplx", "pkl", {"flat_hand_mean": True, "num_pca_comps": 12}),
    "SMPL-X, 45 components, mean": ("smplx", "npz", {"flat_hand_mean": False, "num_pca_comps": 45}),
    "SMPL-X of 300 + 100 coefficients": ("smplx", "npz", {"flat_hand_mean": True, "use_pca": False, "num_betas": 300,
                                                          "num_expression_coeffs": 50}),
}  # fmt: skip


@dataclasses.dataclass
class Pair:
    """One file, opened by their code and by ours."""

    theirs: torch.nn.Module
    data: object
    ours: PosedBody
    family: str
    pca: int  # components, 0 for axis-angle


def open_pair(case: str, folder: Path, dtype: torch.dtype = torch.float64) -> Pair:
    import smplx

    family, suffix, options = CASES[case]
    wide = options.get("num_betas") == 300
    arrays = random_arrays(family, VERTICES[family], coefficients=400 if wide else None)
    if wide:  # 400 directions of 0.02 m a vertex would tear the mesh to pieces
        arrays["shapedirs"] *= 0.2
    path = folder / f"{family.upper()}_NEUTRAL.{suffix}"
    if suffix == "npz":
        write_npz(path, arrays)
    elif family == "smplx":
        path.write_bytes(pickle.dumps(arrays, 2))
    else:
        write_smpl_pickle(path, arrays)
    np.savez(folder / f"{family}_uv.npz", **uv_arrays(arrays))
    with mock.patch.dict(sys.modules, fake_modules()), contextlib.redirect_stdout(io.StringIO()):
        theirs = smplx.create(str(path), model_type=family, ext=suffix, dtype=dtype, **{"num_betas": 10, **options})
    load_plugins()
    settings = {"path": str(path), "uv": str(folder / f"{family}_uv.npz"), "num_betas": options.get("num_betas", 10)}
    if family != "smpl":
        settings["hands"] = "flat" if options["flat_hand_mean"] else "mean"
    if family == "smplx":
        settings["num_expression"] = options.get("num_expression_coeffs", 10)
    data = BODIES.build(family, settings).data
    pca = options.get("num_pca_comps", 6) if options.get("use_pca", True) and family != "smpl" else 0
    return Pair(theirs, data, PosedBody(data, dtype), family, pca)


def random_parts(pair: Pair, batch: int, seed: int = 0, angle: float = 0.5) -> dict[str, torch.Tensor]:
    """Parameters by their code's names."""
    g = torch.Generator().manual_seed(seed)
    normal = lambda n, scale: scale * torch.randn(batch, n, generator=g, dtype=torch.float64)  # noqa: E731
    hand = pair.pca or 45
    sizes = {"global_orient": 3, "body_pose": 69 if pair.family == "smpl" else 63}
    if pair.family != "smpl":
        sizes |= {"left_hand_pose": hand, "right_hand_pose": hand}
    if pair.family == "smplx":
        sizes |= {"jaw_pose": 3, "leye_pose": 3, "reye_pose": 3}
    parts = {name: normal(n, angle) for name, n in sizes.items()}
    parts |= {"betas": normal(pair.data.num_betas, 1.0), "transl": normal(3, 2.0)}
    if pair.family == "smplx":
        parts["expression"] = normal(pair.data.num_expression, 1.0)
    return parts


_OUR_NAMES = {
    "left_hand_pose": "left_hand", "right_hand_pose": "right_hand", "jaw_pose": "jaw", "leye_pose": "left_eye",
    "reye_pose": "right_eye", "global_orient": "global_orient", "body_pose": "body_pose",
}  # fmt: skip


def full_pose(pair: Pair, parts: dict[str, torch.Tensor]) -> np.ndarray:
    """(B, J, 3) by `BodyData.full_pose`."""
    ours = {_OUR_NAMES[k]: v.detach().numpy() for k, v in parts.items() if k in _OUR_NAMES}
    return pair.data.full_pose(**ours, pca=bool(pair.pca))


def their_output(pair: Pair, parts: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    """(B, V, 3) and (B, J, 3); what their code appends to the joints is cut off."""
    dtype = pair.theirs.v_template.dtype
    batch = len(parts["betas"])
    pair.theirs.batch_size = batch  # their landmarks are repeated by it
    out = pair.theirs(**{k: v.to(dtype) for k, v in parts.items()})
    return out.vertices, out.joints[:, : pair.data.num_joints]


@dataclasses.dataclass
class Distance:
    """Largest distances in metres over all poses: of vertices and joints, in NumPy and in torch."""

    numpy_vertices: float
    numpy_joints: float
    torch_vertices: float
    torch_joints: float

    @property
    def worst(self) -> float:
        return max(dataclasses.astuple(self))


def distance(pair: Pair, batch: int, seed: int = 0, angle: float = 0.5) -> Distance:
    parts = random_parts(pair, batch, seed, angle)
    with torch.no_grad():
        expected = [x.double().numpy() for x in their_output(pair, parts)]
        poses = full_pose(pair, parts)
        dtype = pair.ours.v_template.dtype
        to = lambda x: None if x is None else torch.as_tensor(x).to(dtype)  # noqa: E731
        got = pair.ours(*(to(x) for x in (poses, parts["betas"], parts["transl"], parts.get("expression"))))
    one = []
    for b in range(batch):
        expression = parts["expression"][b].numpy() if "expression" in parts else None
        one.append(pair.data.posed(poses[b], parts["betas"][b].numpy(), parts["transl"][b].numpy(), expression))
    reference = [np.stack(x) for x in zip(*one, strict=True)]
    apart = lambda a, b: float(np.linalg.norm(np.asarray(a) - b, axis=-1).max())  # noqa: E731
    return Distance(
        *(apart(a, b) for a, b in zip((*reference, *(x.double().numpy() for x in got)), expected * 2, strict=True))
    )


def gradients(pair: Pair, batch: int = 2, seed: int = 3) -> dict[str, float]:
    """Largest difference of the gradients of a random function of vertices and joints, relative to the largest entry of
    the gradient, by pose and shape."""
    parts = random_parts(pair, batch, seed)
    g = torch.Generator().manual_seed(1)
    weight = [
        torch.randn(n, 3, generator=g, dtype=torch.float64) for n in (len(pair.data.v_template), pair.data.num_joints)
    ]

    def scalar(vertices, joints):
        return sum((w * x.double()).sum() for w, x in zip(weight, (vertices, joints), strict=True))

    wanted = [k for k in ("global_orient", "body_pose", "betas", "expression", "jaw_pose", "transl") if k in parts]
    theirs = {k: v.clone().requires_grad_(k in wanted) for k, v in parts.items()}
    scalar(*their_output(pair, theirs)).backward()
    dtype = pair.ours.v_template.dtype
    poses = torch.as_tensor(full_pose(pair, parts)).to(dtype).requires_grad_()
    rest = {k: parts[k].to(dtype).requires_grad_() for k in ("betas", "transl", "expression") if k in parts}
    scalar(*pair.ours(poses, rest["betas"], rest["transl"], rest.get("expression"))).backward()
    ours = {k: v.grad for k, v in rest.items()}
    ours |= {"global_orient": poses.grad[:, 0]}
    count = parts["body_pose"].shape[1] // 3
    ours |= {"body_pose": poses.grad[:, 1 : 1 + count].flatten(1)}
    if "jaw_pose" in parts:
        ours |= {"jaw_pose": poses.grad[:, 22]}
    return {k: float((ours[k] - theirs[k].grad).abs().max() / theirs[k].grad.abs().max()) for k in wanted}


def table(batch: int = 4) -> str:
    """Markdown: one row a case, distances in micrometres, float32 and float64."""
    lines = [
        "| file and hands | NumPy, float64 | torch, float64 | torch, float32 | gradients, float64, relative |",
        "|---|---|---|---|---|",
    ]
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            pair = open_pair(case, Path(folder))
            d64 = [distance(pair, batch, seed, angle) for seed, angle in ((0, 0.5), (1, 1.5))]
            gradient = max(gradients(pair).values())
            d32 = distance(open_pair(case, Path(folder), torch.float32), batch)
        numpy_worst = max(max(d.numpy_vertices, d.numpy_joints) for d in d64)
        torch_worst = max(max(d.torch_vertices, d.torch_joints) for d in d64)
        values = (1e6 * numpy_worst, 1e6 * torch_worst, 1e6 * max(d32.torch_vertices, d32.torch_joints))
        lines.append(f"| {case} | " + " | ".join(f"{v:.2g} um" for v in values) + f" | {gradient:.1e} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
