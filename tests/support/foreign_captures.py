"""Tiny captures in other people's layouts, written from their published readers' field order and conventions, with what
those readers would see: where each vertex of the posed body falls in each image."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
import torch

from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.skeletons import SMPL, SMPLX

WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
PARENTS = {
    24: (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21),
    55: (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15,
         *(p for w, first in ((20, 25), (21, 40)) for f in range(5) for p in (w, first + 3 * f, first + 3 * f + 1))),
}  # fmt: skip
K = np.array([[FOCAL, 0, WIDTH / 2 + 1.5], [0, FOCAL * 1.02, HEIGHT / 2 - 2.0], [0, 0, 1]])


def family_body(joints: int = 24) -> BodyData:
    """A random body of SMPL's or SMPL-X's skeleton whose rest pelvis is far from the origin, as SMPL's is."""
    rng = np.random.default_rng(5)
    vertices = 40
    regressor = rng.random((joints, vertices))
    weights = rng.random((vertices, joints)) ** 4
    return BodyData(
        name="smpl" if joints == 24 else "smplx",
        v_template=rng.normal(0, 0.25, (vertices, 3)) + np.array([0.02, -0.3, 0.04]),
        shapedirs=rng.normal(0, 0.02, (vertices, 3, 10)),
        J_regressor=regressor / regressor.sum(1, keepdims=True),
        parents=np.array(PARENTS[joints]),
        lbs_weights=weights / weights.sum(1, keepdims=True),
        faces=np.zeros((1, 3), int),
        uv=np.zeros((3, 2)),
        uv_faces=np.zeros((1, 3), int),
        joint_names=SMPL if joints == 24 else SMPLX,
    )


def random_motion(frames: int, joints: int = 24, root=(np.pi, 0, 0)):
    """Poses (T, J, 3), translations before a camera, betas (10,): a person upright where `root` takes +y."""
    rng = np.random.default_rng(1)
    poses = rng.normal(0, 0.2, (frames, joints, 3))
    poses[:, 0] = np.array(root) + rng.normal(0, 0.05, (frames, 3))
    return poses, rng.normal(0, 0.1, (frames, 3)) + np.array([0, 0.2, 4.0]), rng.normal(0, 1, 10)


def project(K: np.ndarray, T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """K [R | t] x, the data set's own pixel positions."""
    camera = points @ T[:3, :3].T + T[:3, 3]
    return (camera / camera[:, 2:]) @ K.T[:, :2]


def write_images(images: list[Path], masks: list[Path], *, invert=False, npy=False, label=255) -> np.ndarray:
    """Images of noise and masks of a rectangle; returns the mask, (H, W) bool."""
    rng = np.random.default_rng(2)
    person = np.zeros((HEIGHT, WIDTH), bool)
    person[10:40, 20:45] = True
    for path in [*images, *masks]:
        path.parent.mkdir(parents=True, exist_ok=True)
    for path in images:
        cv2.imwrite(str(path), rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8))
    for path in masks:
        if npy:
            np.save(path, person.astype(np.uint8))
        else:
            cv2.imwrite(str(path), np.where(person != invert, label, 0).astype(np.uint8))
    return person


def instantavatar(folder: Path, frames: int = 12, npy: bool = True, thetas: bool = True) -> dict:
    """InstantAvatar: scripts/peoplesnapshot/preprocess_PeopleSnapshot.py, instant_avatar/datasets/*.py."""
    body, (poses, transl, betas) = family_body(), random_motion(frames)
    images = [folder / f"images/image_{i:04d}.png" for i in range(frames)]
    person = write_images(
        images, [folder / f"masks/mask_{i:04d}.{'npy' if npy else 'png'}" for i in range(frames)], npy=npy
    )
    T = np.eye(4)
    np.savez(folder / "cameras.npz", intrinsic=K, extrinsic=T, height=HEIGHT, width=WIDTH)
    flat = poses.reshape(frames, -1)
    parts = {"thetas": flat} if thetas else {"global_orient": flat[:, :3], "body_pose": flat[:, 3:]}
    np.savez(folder / ("poses.npz" if npy else "poses_optimized.npz"), betas=betas[None], transl=transl, **parts)
    pixels = {("cam0", i): project(K, T, body.posed(poses[i], betas, transl[i])[0]) + 0.5 for i in range(frames)}
    return {"body": body, "pixels": pixels, "person": person}


def upstream(folder: Path, joints: int = 24, moving: bool = False, counts=(4, 2)) -> dict:
    """GaussianAvatar: scene/dataset_mono.py (the position of a pixel is K x with corners at integers: 3DGS's ndc2pix
    takes half a pixel off, so that pixel centres stand at integer + 0.5)."""
    body, (poses, trans, betas) = family_body(joints), random_motion(sum(counts), joints)
    pixels, start = {}, 0
    for split, count in zip(("train", "test"), counts, strict=True):
        images = [folder / split / f"images/{i:08d}.png" for i in range(count)]
        person = write_images(images, [folder / split / f"masks/{i:08d}.png" for i in range(count)])
        rows = slice(start, start + count)
        content = {"beta": betas[None], "body_pose": poses[rows].reshape(count, -1), "trans": trans[rows]}
        torch.save(
            {k: torch.tensor(v, dtype=torch.float64) for k, v in content.items()}, folder / split / "smpl_parms.pth"
        )
        for i in range(count):
            T = np.eye(4)
            if moving:
                T[:3, :3] = matrix_from_axis_angle(np.array([0.02, 0.05 * i, -0.01]))
                T[:3, 3] = 0.01 * i
                (folder / split / "cam_parms").mkdir(exist_ok=True)
                np.savez(folder / split / "cam_parms" / f"{i:08d}.npz", intrinsic=K, extrinsic=T)
            posed, _ = body.posed(poses[start + i], betas, trans[start + i])
            pixels[split, start + i] = project(K, T, posed)
        if not moving:
            np.savez(folder / split / "cam_parms.npz", intrinsic=K, extrinsic=np.eye(4))
        start += count
    return {"body": body, "pixels": pixels, "person": person}


def zju(folder: Path, frames: int = 5, cameras: int = 3, params: str = "new_params", lens=None) -> dict:
    """Neural Body: lib/datasets/light_stage/multi_view_dataset.py, tools/custom/get_annots.py; z-up world; the posed
    model is turned by Rh about its own origin and moved by Th."""
    body, (poses, Th, betas) = family_body(), random_motion(frames, root=(0, 0, 0))
    poses[:, 0] = 0
    Rh = np.array([np.pi / 2, 0, 0]) + np.random.default_rng(3).normal(0, 0.05, (frames, 3))
    Th = Th * 0.1
    looking = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from z-up to x right, y down, z forward
    cams = {"K": [], "D": [], "R": [], "T": []}
    for c in range(cameras):
        cams["K"].append(K)
        cams["D"].append(np.zeros((5, 1)) if lens is None else np.asarray(lens).reshape(5, 1))
        cams["R"].append(looking @ matrix_from_axis_angle(np.array([0, 0, 0.4 * c])))
        cams["T"].append(np.array([[0.05], [0.1], [4.0]]) * 1000)
    names = [[f"Camera_B{c + 1}/{i:06d}.jpg" for c in range(cameras)] for i in range(frames)]
    images = [folder / name for row in names for name in row]
    person = write_images(
        images, [folder / "mask_cihp" / Path(n).with_suffix(".png") for r in names for n in r], label=13
    )
    np.save(folder / "annots.npy", {"cams": cams, "ims": [{"ims": row} for row in names]}, allow_pickle=True)
    (folder / params).mkdir()
    pixels = {}
    for i in range(frames):
        np.save(folder / params / f"{i}.npy", {
            "poses": poses[i].reshape(1, 72), "Rh": Rh[i][None], "Th": Th[i][None], "shapes": betas[None],
        }, allow_pickle=True)  # fmt: skip
        posed = body.posed(poses[i], betas)[0] @ matrix_from_axis_angle(Rh[i]).T + Th[i]
        for c in range(cameras):
            pixels[str(c), i] = project(K, np.c_[cams["R"][c], cams["T"][c] / 1000], posed) + 0.5
    return {"body": body, "pixels": pixels, "person": person, "Rh": Rh}


def neuman(folder: Path, frames: int = 12, dump=None) -> dict:
    """NeuMan: data_io/neuman_helper.py, data_io/colmap_helper.py, preprocess/export_alignment.py. The scene has its own
    axes and scale, another in each frame, and the camera moves."""
    body, (poses, _, betas) = family_body(), random_motion(frames, root=(0.4, 0.3, 0))
    rng = np.random.default_rng(4)
    names = [f"{i:05d}.png" for i in range(frames)]
    person = write_images(
        [folder / "images" / n for n in names], [folder / "segmentations" / n for n in names], invert=True
    )
    (folder / "sparse").mkdir()
    header = "# Camera list with one line of data per camera:\n"
    (folder / "sparse/cameras.txt").write_text(
        f"{header}1 OPENCV {WIDTH} {HEIGHT} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]} 0.01 0 0 0\n"
    )
    lines, alignments, pixels = ["# Image list with two lines of data per image:"], {}, {}
    for i, name in reversed(list(enumerate(names))):  # COLMAP lists images in no order
        half = np.array([0.05, 0.1 * i / frames, 0.02])
        quaternion = np.array([np.sqrt(1 - half @ half), *half])
        T = np.c_[_rotation(quaternion), [0.1, 0.02 * i, 0.3]]
        lines += [f"{i + 1} {' '.join(map(str, [*quaternion, *T[:, 3]]))} 1 {name}", "1.0 2.0 -1"]
        scale = 0.5 + 0.05 * rng.random()
        A = scale * matrix_from_axis_angle(np.array([0.1, -0.2, 0.3]) + rng.normal(0, 0.02, 3))
        place = np.array([0.1, 0.1, 2.0]) + rng.normal(0, 0.05, 3)
        alignments[name] = np.concatenate([A.T, place[None]])  # [x, 1] @ alignment is the place in the scene
        pixels["cam0", i] = project(K, T, body.posed(poses[i], betas)[0] @ A.T + place)
    (folder / "sparse/images.txt").write_text("\n".join(lines) + "\n")
    np.save(folder / "alignments.npy", alignments, allow_pickle=True)
    content = {
        1: {"pose": poses.reshape(frames, 72), "betas": np.tile(betas, (frames, 1)), "verts": np.zeros((frames, 4, 3))}
    }
    write = dump or (lambda value, path: Path(path).write_bytes(pickle.dumps(value)))
    write(content, folder / "smpl_output_romp.pkl")
    return {"body": body, "pixels": pixels, "person": person}


def _rotation(q: np.ndarray) -> np.ndarray:
    w, v = q[0], q[1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross
