"""Which places of a body should look alike where footage says nothing: neighbours, and the other side of it."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.spatial import cKDTree

from gavatar_runtime.values.surface import Surface

NEIGHBOURS = 16
ALONG = 4.0  # how many times farther apart places are along a limb or the trunk than around it: hems end at one height
ACROSS = 0.02  # of a bond, what is left of it between the face and the rest of the head
MIRRORED = 0.03  # weight of the bond to the mirrored place, where all bonds to neighbours are 1 together
ELSEWHERE = np.array([0.0, 0.43, 0.9])  # for tips, where the limb points along the normal: no axis of a body
ASTRAY = 3.0  # spacings from the mirrored place within which a point counts as there


@dataclasses.dataclass(frozen=True)
class Bonds:
    """Bonds between N points. near: (N, N) symmetric weights to neighbours, on average 1 a point. mirrored: (N, N)
    symmetric weights to the mirrored place, left for right. frames: (N, 3, 3) the axes that vectors are compared in:
    rows are the normal, the direction along the limb as far as it lies on the surface, and what is square to both."""

    near: csr_matrix
    mirrored: csr_matrix
    frames: np.ndarray


def bonds_of(surface: Surface, head: int | None = None) -> Bonds:
    """The bonds of a body's points in its canonical pose. head: the joint of the head, None of a body without one."""
    axes = along_limbs(surface)
    isotropic = np.zeros(len(surface)) if head is None else share_of(surface, head)
    near = _neighbours(surface, axes, isotropic, face_of(surface, head))
    return Bonds(near, _mirrored(surface), _frames(surface.normals, axes))


def share_of(surface: Surface, joint: int) -> np.ndarray:
    """(N,) skinning weight of one joint."""
    return (surface.joint_weight * (surface.joint_index == joint)).sum(1)


def along_limbs(surface: Surface) -> np.ndarray:
    """(N, 3) unit directions along the limb or the trunk at each point: those from its joints to their children."""
    A, parents = surface.A_canonical, surface.parents
    joints = np.einsum("jab,jb->ja", A[:, :3, :3], surface.joints) + A[:, :3, 3]
    below = np.ones(len(parents))
    for joint in range(len(parents) - 1, -1, -1):
        if parents[joint] >= 0:
            below[parents[joint]] += below[joint]
    bones = np.zeros_like(joints)
    for joint, parent in enumerate(parents):
        if parent >= 0:  # the way that most of the body hangs on: up of the pelvis, to the neck of the chest
            bones[parent] += below[joint] * _unit(joints[joint] - joints[parent])
    for joint, parent in enumerate(parents):
        if below[joint] == 1 and parent >= 0:
            bones[joint] = joints[joint] - joints[parent]
    bones = _unit(bones)
    return _unit(np.einsum("nk,nka->na", surface.joint_weight, bones[surface.joint_index]))


def face_of(surface: Surface, head: int | None) -> np.ndarray:
    """(N,) bool: points of the face, whose skin says nothing of the hair behind it: of the head, before its joint (the
    ears are above it), and below the brow."""
    if head is None:
        return np.zeros(len(surface), bool)
    A = surface.A_canonical[head]
    place = (surface.points - (A[:3, :3] @ surface.joints[head] + A[:3, 3])) @ A[:3, :3]  # as in the rest pose
    of_head = share_of(surface, head) > 0.5
    if not of_head.any():
        return of_head
    top = place[of_head, 1].max()
    return of_head & (place[:, 2] > 0.02) & (place[:, 1] < 0.6 * top)


def _neighbours(surface: Surface, axes: np.ndarray, isotropic: np.ndarray, face: np.ndarray) -> csr_matrix:
    points, normals = surface.points.astype(np.float64), surface.normals
    count = len(points)
    if count < 2:
        return csr_matrix((count, count))
    distance, index = cKDTree(points).query(points, min(NEIGHBOURS + 1, count))
    row = np.repeat(np.arange(count), index.shape[1] - 1)
    column = index[:, 1:].ravel()
    step = points[column] - points[row]
    axis = _unit(axes[row] + axes[column])
    along = np.square((step * axis).sum(1))
    stretch = 1 + (ALONG**2 - 1) * (1 - np.maximum(isotropic[row], isotropic[column]))
    reach = 2 * np.square(np.median(distance[:, 1:7], axis=1))[row]  # of the six nearest: the local spacing
    weight = np.exp(-((step * step).sum(1) + (stretch - 1) * along) / np.maximum(reach, 1e-12))
    weight = np.maximum(weight, 1e-3)  # no point is alone for lying off the others' height
    weight *= np.maximum((normals[row] * normals[column]).sum(1), 0.02)  # not through a limb
    weight[face[row] != face[column]] *= ACROSS
    W = coo_matrix((np.nan_to_num(weight), (row, column)), (count, count)).tocsr()
    W = W.maximum(W.T)
    return (W * (count / max(W.sum(), 1e-12))).tocsr()


def _mirrored(surface: Surface) -> csr_matrix:
    count = len(surface)
    mirror = np.array([-1.0, 1.0, 1.0])  # x is to the left of the body
    middle = surface.joints[surface.root] * [1.0, 0.0, 0.0]
    place = (surface.points - middle) * mirror + middle
    distance, other = cKDTree(surface.points).query(place)
    alike = (surface.normals * mirror * surface.normals[other]).sum(1) > 0.5
    row = np.flatnonzero(alike & (distance < ASTRAY * surface.spacing) & (other != np.arange(count)))
    W = coo_matrix((np.full(len(row), MIRRORED), (row, other[row])), (count, count)).tocsr()
    return W.maximum(W.T)


def _frames(normals: np.ndarray, axes: np.ndarray) -> np.ndarray:
    square = np.cross(normals, axes)
    flat = np.linalg.norm(square, axis=1, keepdims=True) < 0.1  # tips: the limb points outwards
    square = _unit(np.where(flat, np.cross(normals, ELSEWHERE), square))
    return np.stack([normals, np.cross(square, normals), square], 1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
