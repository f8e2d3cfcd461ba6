"""Points of an avatar's surface, with no offset, against `smplx.lbs.lbs` of a body that has them as vertices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from official_bodies import dressed_free_body, write_npz

from gavatar.attributes import Attributes
from gavatar.avatar.atlas import sample_atlas
from gavatar.avatar.blendshapes import at_points, expression_of, pose_blendshapes_of
from gavatar.avatar.torch_skinning import dense_weights
from gavatar.avatar.trainable import Avatar, AvatarConfig, Pose
from gavatar.body.official_files import FAMILIES, read_body
from gavatar.body.skeleton import Skeleton
from gavatar.body.torch_rotations import matrix_from_axis_angle
from gavatar_runtime.avatar.expression import Expression
from gavatar_runtime.avatar.pose_blendshapes import PoseBlendshapes, Turns, canonical_rotations
from gavatar_runtime.geometry.skinning import skin

lbs = pytest.importorskip("smplx.lbs").lbs

BETAS = np.array([0.7, -0.5, 0.3])
# The avatar's numbers are float32 (6e-8 relative, over some metres and 55 joints); the aim of the project is 1e-5
TOLERANCE = 5e-6


def body(case, folder):
    """SMPL-X without pose blendshapes; its own expressions, or some that move every vertex and joint by centimetres. Or
    with blendshapes of centimetres."""
    size = 30 if case == "pose blendshapes" else 0
    arrays = dressed_free_body("smplx", pose_mm=size)
    data = read_body(FAMILIES["smplx"], write_npz(folder / "SMPLX_NEUTRAL.npz", arrays))
    if case == "whole body":
        rng = np.random.default_rng(1)
        centre = data.v_template[rng.integers(0, len(data.v_template), 10)]
        near = np.exp(-np.sum((data.v_template[:, None] - centre) ** 2, -1) / 0.3**2)
        data = dataclasses.replace(data, exprdirs=0.02 * near[:, None] * rng.normal(size=(1, 3, 10)))
    return data


@pytest.fixture(scope="module", params=["face", "whole body", "pose blendshapes"])
def scene(request, tmp_path_factory):
    data = body(request.param, tmp_path_factory.mktemp("model"))
    return data, sample_atlas(data, BETAS, 96)


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
        "posedirs": extended(data.posedirs.astype(np.float64)).reshape(3 * (vertices + len(surface)), -1).T,
        "J_regressor": np.pad(data.J_regressor, ((0, 0), (0, len(surface)))),
        "lbs_weights": weights,
    }
    arrays = {name: torch.as_tensor(array, dtype=torch.float64) for name, array in arrays.items()}
    coefficients = torch.as_tensor(np.concatenate([np.tile(BETAS, (len(poses), 1)), expression], 1))
    parents = torch.as_tensor(np.asarray(data.parents, np.int64))
    points, _ = lbs(coefficients, torch.as_tensor(poses).reshape(len(poses), -1), parents=parents, **arrays)
    return points[:, vertices:].numpy()


def avatar_of(data, surface):
    """With no network: its points are the body's."""
    config = AvatarConfig(features=1, feature_size=2, pose_blendshapes=bool(data.posedirs.any()))
    avatar = Avatar(config, Skeleton(data, BETAS), None, torch.nn.Identity())
    avatar.sample_at(surface)
    return avatar


def ours(data, surface, poses, expression):
    """(B, N, 3) by the avatar in training."""
    avatar = avatar_of(data, surface)
    zero = Attributes(torch.zeros(1, len(surface), 3), torch.zeros(1, len(surface), 3), torch.ones(1, len(surface)))
    rotations = matrix_from_axis_angle(torch.as_tensor(poses, dtype=torch.float32))
    pose = Pose(rotations, torch.zeros(len(poses), 3), torch.as_tensor(expression, dtype=torch.float32))
    sets = avatar.pose(zero, pose)
    return np.stack([gaussians.means.numpy() for gaussians in sets])


def played(data, surface, poses, expression):
    """(B, N, 3) as the player does it, with the directions as a bundle stores them."""
    stored = expression_of(data, surface).to_arrays()
    directions = Expression.from_arrays(stored, len(surface), data.num_joints, "expression.npz")
    arrays = pose_blendshapes_of(data, surface).to_arrays()
    skin_shapes = PoseBlendshapes.from_arrays(arrays, len(surface), data.num_joints, "pose_blendshapes.npz")
    out = []
    for pose, coefficients in zip(poses.astype(np.float32), expression.astype(np.float32), strict=True):
        A = surface.skin_transforms(pose, directions.joints @ coefficients)
        points = directions.points(surface.points, coefficients) + skin_shapes.offsets(pose, Turns.of(surface))
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
    # and of pose blendshapes, whose 27 directions about a point are rounded independently; weights of corners too
    rounding += 2**-11 * 27 * 2 * np.abs(data.posedirs).max()
    assert np.abs(played(data, surface, poses, expression) - expected)[:, sure].max() < TOLERANCE + rounding


def at_vertices(data):
    """A surface whose points are the vertices."""
    faces = np.asarray(data.faces)
    face, corner = np.zeros(len(data.v_template), int), np.zeros(len(data.v_template), int)
    for c in range(3):
        face[faces[:, c]], corner[faces[:, c]] = np.arange(len(faces)), c
    order = np.argsort(-data.lbs_weights, 1)[:, :8]
    weight = np.take_along_axis(data.lbs_weights, order, 1)
    posed, _ = data.posed(data.canonical_pose(), BETAS)
    count = len(posed)
    return dataclasses.replace(
        sample_atlas(data, BETAS, 64), texel=np.arange(count, dtype=np.int32), uv=np.zeros((count, 2), np.float32),
        face=face.astype(np.int32), barycentric=np.eye(3, dtype=np.float32)[corner], points=posed.astype(np.float32),
        joint_index=order.astype(np.int32), joint_weight=(weight / weight.sum(1, keepdims=True)).astype(np.float32),
        spacing=np.ones(count, np.float32), normals=np.zeros((count, 3), np.float32),
    )  # fmt: skip


def test_points_on_vertices_are_smplxs_vertices(scene):
    data, _ = scene
    surface = at_vertices(data)
    poses, expression = random_scene(2)
    arrays = {
        "v_template": data.v_template, "shapedirs": np.concatenate([data.shapedirs[:, :, :3], data.exprdirs], 2),
        "posedirs": data.posedirs.reshape(3 * len(data.v_template), -1).T, "J_regressor": data.J_regressor,
        "lbs_weights": data.lbs_weights,
    }  # fmt: skip
    arrays = {name: torch.as_tensor(np.asarray(array, np.float64)) for name, array in arrays.items()}
    coefficients = torch.as_tensor(np.concatenate([np.tile(BETAS, (3, 1)), expression], 1))
    parents = torch.as_tensor(np.asarray(data.parents, np.int64))
    vertices, _ = lbs(coefficients, torch.as_tensor(poses).reshape(3, -1), parents=parents, **arrays)
    sure = rigid(surface)
    used = np.unique(data.faces)  # others are no surface
    sure &= np.isin(np.arange(len(sure)), used)
    assert sure.mean() > 0.7
    difference = np.abs(ours(data, surface, poses, expression) - vertices.numpy())[:, sure]
    assert difference.max() < TOLERANCE


def test_a_canonical_pose_adds_nothing(scene):
    data, surface = scene
    blendshapes = pose_blendshapes_of(data, surface)
    assert np.abs(blendshapes.offsets(data.canonical_pose().astype(np.float32), Turns.of(surface))).max() < 1e-8
    rest = blendshapes.offsets(np.zeros((55, 3), np.float32), Turns.of(surface))
    assert (np.abs(rest).max() > 1e-3) == bool(data.posedirs.any())


def test_gradients_reach_the_pose_through_an_expression(scene):
    data, surface = scene
    poses, expression = random_scene(1, batch=1)
    avatar = avatar_of(data, surface)
    zero = Attributes(torch.zeros(1, len(surface), 3), torch.zeros(1, len(surface), 3), torch.ones(1, len(surface)))
    axis_angle = torch.tensor(poses, dtype=torch.float32, requires_grad=True)
    coefficients = torch.tensor(expression, dtype=torch.float32, requires_grad=True)
    pose = Pose(matrix_from_axis_angle(axis_angle), torch.zeros(1, 3), coefficients)
    (gaussians,) = avatar.pose(zero, pose)
    gaussians.means.square().mean().backward()
    assert axis_angle.grad.abs().max() > 0
    assert (coefficients.grad.abs() > 0).all()
