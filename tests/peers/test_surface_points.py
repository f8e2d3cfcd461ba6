"""Points of an avatar's surface, with no offset, against `smplx.lbs.lbs` of a body that has them as vertices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from official_bodies import dressed_free_body, write_npz

from gavatar.attributes import Attributes
from gavatar.avatar import Avatar, AvatarConfig
from gavatar.blendshapes import at_points, canonical_rotations, expression_of
from gavatar.body import Skeleton
from gavatar.body_files import FAMILIES, read_body
from gavatar.rotations import matrix_from_axis_angle
from gavatar.skinning import dense_weights
from gavatar.surface import sample_surface
from gavatar_runtime.expression import Expression
from gavatar_runtime.skinning import skin

lbs = pytest.importorskip("smplx.lbs").lbs

BETAS = np.array([0.7, -0.5, 0.3])
# The avatar's numbers are float32 (6e-8 relative, over some metres and 55 joints); the aim of the project is 1e-5
TOLERANCE = 5e-6


def body(case, folder):
    """SMPL-X without pose blendshapes; its own expressions, or some that move every vertex and joint by centimetres."""
    data = read_body(FAMILIES["smplx"], write_npz(folder / "SMPLX_NEUTRAL.npz", dressed_free_body("smplx", pose_mm=0)))
    if case == "whole body":
        rng = np.random.default_rng(1)
        centre = data.v_template[rng.integers(0, len(data.v_template), 10)]
        near = np.exp(-np.sum((data.v_template[:, None] - centre) ** 2, -1) / 0.3**2)
        data = dataclasses.replace(data, exprdirs=0.02 * near[:, None] * rng.normal(size=(1, 3, 10)))
    return data


@pytest.fixture(scope="module", params=["face", "whole body"])
def scene(request, tmp_path_factory):
    data = body(request.param, tmp_path_factory.mktemp("model"))
    return data, sample_surface(data, BETAS, 96)


def theirs(data, surface, poses, expression):
    """(B, N, 3) by smplx: the vertices regress the joints, the points follow them as further vertices."""
    vertices = len(data.v_template)

    def extended(directions):
        return np.concatenate([directions, at_points(data, surface, directions)])

    weights = np.concatenate(
        [data.lbs_weights, dense_weights(surface.joint_index, surface.joint_weight, data.num_joints)]
    )
    arrays = {
        "v_template": extended(np.asarray(data.v_template, np.float64)[..., None])[..., 0],
        "shapedirs": extended(np.concatenate([data.shapedirs[:, :, : len(BETAS)], data.exprdirs], 2).astype(float)),
        "posedirs": np.zeros((9 * (data.num_joints - 1), 3 * (vertices + len(surface)))),
        "J_regressor": np.pad(data.J_regressor, ((0, 0), (0, len(surface)))),
        "lbs_weights": weights,
    }
    arrays = {name: torch.as_tensor(array, dtype=torch.float64) for name, array in arrays.items()}
    coefficients = torch.as_tensor(np.concatenate([np.tile(BETAS, (len(poses), 1)), expression], 1))
    parents = torch.as_tensor(np.asarray(data.parents, np.int64))
    points, _ = lbs(coefficients, torch.as_tensor(poses).reshape(len(poses), -1), parents=parents, **arrays)
    return points[:, vertices:].numpy()


def ours(data, surface, poses, expression):
    """(B, N, 3) by the avatar in training."""
    avatar = Avatar(AvatarConfig(features=1, feature_size=2), Skeleton(data, BETAS), None, torch.nn.Identity())
    avatar.sample_at(surface)
    zero = Attributes(torch.zeros(1, len(surface), 3), torch.zeros(1, len(surface), 3), torch.ones(1, len(surface)))
    rotations = matrix_from_axis_angle(torch.as_tensor(poses, dtype=torch.float32))
    sets = avatar.pose(zero, rotations, torch.zeros(len(poses), 3), torch.as_tensor(expression, dtype=torch.float32))
    return np.stack([gaussians.means.numpy() for gaussians in sets])


def played(data, surface, poses, expression):
    """(B, N, 3) as the player does it, with the directions as a bundle stores them."""
    stored = expression_of(data, surface).to_arrays()
    directions = Expression.from_arrays(stored, len(surface), data.num_joints, "expression.npz")
    out = []
    for pose, coefficients in zip(poses.astype(np.float32), expression.astype(np.float32), strict=True):
        A = surface.skin_transforms(pose, directions.joints @ coefficients)
        points = directions.points(surface.points, coefficients)
        out.append(skin(points, surface.joint_index, surface.joint_weight, A))
    return np.stack(out)


def rigid(surface):
    """(N,) whether canonical skinning of the point is a rigid motion; elsewhere, between trunk and thigh, undoing the
    canonical pose is an approximation of the method itself."""
    R = canonical_rotations(surface)
    return np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max((1, 2)) < 1e-6


def random_scene(seed, batch=3, angle=0.6, size=1.5):
    rng = np.random.default_rng(seed)
    return rng.normal(0, angle, (batch, 55, 3)), rng.normal(0, size, (batch, 10))


@pytest.mark.parametrize("angle", [0.0, 0.6, 2.0])
def test_points_with_an_expression_are_where_smplx_puts_them(scene, angle):
    data, surface = scene
    poses, expression = random_scene(0, angle=angle)
    expected, sure = theirs(data, surface, poses, expression), rigid(surface)
    assert sure.mean() > 0.8
    moved = np.linalg.norm(expected - theirs(data, surface, poses, 0 * expression), axis=-1)
    assert moved.max() > 0.01  # metres: there is something to get wrong
    assert np.abs(ours(data, surface, poses, expression) - expected)[:, sure].max() < TOLERANCE
    # the player's directions are float16: 2^-11 of at most 4 cm, for each of ten coefficients of up to 4
    rounding = 2**-11 * np.abs(expression).sum(1).max() * np.abs(data.exprdirs).max()
    assert np.abs(played(data, surface, poses, expression) - expected)[:, sure].max() < TOLERANCE + rounding


def test_gradients_reach_the_pose_through_an_expression(scene):
    data, surface = scene
    poses, expression = random_scene(1, batch=1)
    avatar = Avatar(AvatarConfig(features=1, feature_size=2), Skeleton(data, BETAS), None, torch.nn.Identity())
    avatar.sample_at(surface)
    zero = Attributes(torch.zeros(1, len(surface), 3), torch.zeros(1, len(surface), 3), torch.ones(1, len(surface)))
    axis_angle = torch.tensor(poses, dtype=torch.float32, requires_grad=True)
    coefficients = torch.tensor(expression, dtype=torch.float32, requires_grad=True)
    (gaussians,) = avatar.pose(zero, matrix_from_axis_angle(axis_angle), torch.zeros(1, 3), coefficients)
    gaussians.means.square().mean().backward()
    assert axis_angle.grad.abs().max() > 0
    assert (coefficients.grad.abs() > 0).all()
