"""Skinning in training: the kernel's sparse product and torch's dense one are the same function."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gavatar.avatar.torch_skinning import can_skin_sparse, dense_weights, skin, skin_sparse
from gavatar.body.skeleton import joint_transforms
from gavatar.body.torch_rotations import matrix_from_axis_angle
from gavatar_runtime import native_library as nl
from gavatar_runtime.geometry.kinematics import joint_transforms as numpy_joint_transforms

needs_kernel = pytest.mark.skipif(not nl.available()[0], reason="the native kernel was not compiled")


def inputs(count: int, clouds: int, poses: int, joints: int = 24, slots: int = 5, seed: int = 0):
    rng = np.random.default_rng(seed)
    index = rng.integers(0, joints, (count, slots)).astype(np.int32)
    weight = rng.dirichlet(np.ones(slots), count).astype(np.float32)
    points = torch.as_tensor(rng.normal(0, 1, (clouds, count, 3)), dtype=torch.float32)
    transforms = torch.as_tensor(rng.normal(0, 1, (poses, joints, 3, 4)), dtype=torch.float32)
    upstream = torch.as_tensor(rng.normal(0, 1, (poses, count, 3)), dtype=torch.float32)
    return points, index, weight, transforms, upstream


@needs_kernel
@pytest.mark.parametrize("count", [0, 1, 9000])  # nothing, one, and more than one piece of the kernel's work
@pytest.mark.parametrize(("clouds", "poses"), [(1, 1), (1, 3), (3, 3)])
def test_sparse_skinning_is_dense_skinning_with_gradients(count, clouds, poses):
    points, index, weight, transforms, upstream = inputs(count, clouds, poses)
    p, T = points.clone().requires_grad_(), transforms.clone().requires_grad_()
    out = skin_sparse(p, torch.as_tensor(index), torch.as_tensor(weight), T)
    out.backward(upstream)

    P, M = points.double().requires_grad_(), transforms.double().requires_grad_()
    expected = skin(P, torch.as_tensor(dense_weights(index, weight.astype(np.float64), 24)), M)
    expected.backward(upstream.double())
    # values: some twenty float32 terms of order 1; gradients of the transforms: sums of `count` such terms, whose
    # rounding grows with the root of their number
    torch.testing.assert_close(out.double(), expected, atol=5e-6, rtol=0)
    torch.testing.assert_close(p.grad.double(), P.grad, atol=5e-6 * poses, rtol=0)
    torch.testing.assert_close(T.grad.double(), M.grad, atol=5e-6 * max(1, count) ** 0.5, rtol=1e-5)


@needs_kernel
def test_gradients_that_nobody_wants_are_not_computed_and_wrong_joints_are_refused():
    points, index, weight, transforms, upstream = inputs(50, 1, 2)
    index_t, weight_t = torch.as_tensor(index), torch.as_tensor(weight)
    transforms.requires_grad_()
    skin_sparse(points, index_t, weight_t, transforms).backward(upstream)
    assert points.grad is None
    assert transforms.grad is not None
    with pytest.raises(IndexError, match="joint_index"):
        skin_sparse(points, index_t + 24, weight_t, transforms)


def test_only_float32_on_the_cpu_takes_the_kernel(monkeypatch):
    assert can_skin_sparse(torch.zeros(1, 1, 3)) == nl.available()[0]
    assert not can_skin_sparse(torch.zeros(1, 1, 3, dtype=torch.float64))
    monkeypatch.setattr(nl, "available", lambda: (False, "not compiled"))
    assert not can_skin_sparse(torch.zeros(1, 1, 3))


@pytest.mark.parametrize(
    "parents", [[-1], [-1, 0], list(range(-1, 16)), [-1, 0, 0, 1, 1, 2, 4, 6], [2, 0, -1, 1], [-1, -1, 0, 1]]
)
@pytest.mark.parametrize("joints_batched", [False, True])
def test_transforms_by_doubling_are_those_joint_by_joint(parents, joints_batched):
    rng = np.random.default_rng(1)
    poses = rng.normal(0, 1, (3, len(parents), 3))
    poses[0] = 0
    poses[1, 0] = [np.pi, 0, 0]
    joints = rng.normal(0, 1, (*((3,) if joints_batched else ()), len(parents), 3))
    rotations = matrix_from_axis_angle(torch.as_tensor(poses)).requires_grad_()
    R, p = joint_transforms(rotations, torch.as_tensor(joints), parents)
    for b in range(3):
        expected = in_turn(rotations[b].detach().numpy(), joints[b] if joints_batched else joints, parents)
        T = torch.cat([R[b], p[b][..., None]], -1).detach().numpy()
        np.testing.assert_allclose(T, expected[:, :3], atol=1e-13)  # float64, a chain of 17 products of order 1
    assert torch.autograd.gradcheck(lambda r: joint_transforms(r, torch.as_tensor(joints), parents), (rotations,))


def in_turn(rotations: np.ndarray, joints: np.ndarray, parents: list[int]) -> np.ndarray:
    """(J, 4, 4), each joint after its parent, whatever their order."""
    world: dict[int, np.ndarray] = {-1: np.eye(4)}

    def transform(j: int) -> np.ndarray:
        if j not in world:
            local = np.eye(4)
            local[:3, :3] = rotations[j]
            local[:3, 3] = joints[j] - (joints[parents[j]] if parents[j] >= 0 else 0)
            world[j] = transform(parents[j]) @ local
        return world[j]

    return np.stack([transform(j) for j in range(len(parents))])


def test_the_torch_and_the_numpy_kinematics_agree():
    rng = np.random.default_rng(2)
    parents = [-1, 0, 1, 2, 1, 4]
    poses, joints = rng.normal(0, 1, (6, 3)), rng.normal(0, 1, (6, 3))
    R, p = joint_transforms(matrix_from_axis_angle(torch.as_tensor(poses)), torch.as_tensor(joints), parents)
    expected = numpy_joint_transforms(poses, joints, np.array(parents))
    np.testing.assert_allclose(torch.cat([R, p[..., None]], -1), expected[:, :3], atol=1e-13)
