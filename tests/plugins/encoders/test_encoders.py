"""Pose encoders: the contract of every registered one, what they look at, what the linear one may and may not do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from make_bundle import free_body

from gavatar.avatar.atlas import sample_atlas
from gavatar.registry import ENCODERS, load_plugins
from gavatar.training.remedies.facing import facing_texels
from gavatar_plugins.encoders.linear import LinearConfig, LinearEncoder, harmonics, joint_distances
from gavatar_runtime.decoding.pose_inputs import (
    INPUTS,
    PoseInput,
    check_inputs,
    input_shape,
    input_shapes,
    joint_rotations,
    pose_inputs,
)
from gavatar_runtime.decoding.uv_maps import normal_map
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.values.camera import Camera, look_at
from gavatar_runtime.values.motion import Motion

load_plugins()
CASES = [(name, {}) for name in ENCODERS.names() if name != "none"]
CASES += [("linear", {"order": order, "bases": bases}) for order, bases in ((0, 4), (1, 0), (1, 4), (2, 0), (2, 4))]
CHANNELS = 6


@pytest.fixture(scope="module")
def surface(tmp_path_factory):
    return sample_atlas(free_body(), None, 64, cache_dir=tmp_path_factory.mktemp("surfaces"))


def random_poses(count: int, size: float = 0.4, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, size, (count, 52, 3)).astype(np.float32)


def tensors(surface, poses, inputs) -> list[torch.Tensor]:
    """The inputs of those names."""
    return [torch.from_numpy(a) for a in pose_inputs(surface, poses, tuple(inputs))]


def prepared(surface, poses, seen=None, **options) -> LinearEncoder:
    """A linear encoder of the poses, its maps filled with noise."""
    encoder = LinearEncoder(LinearConfig(**options), channels=CHANNELS)
    seen = torch.ones(len(poses), 64, 64, dtype=torch.bool) if seen is None else seen
    encoder.prepare(surface, seen, *tensors(surface, poses, encoder.inputs))
    torch.manual_seed(0)
    torch.nn.init.normal_(encoder.maps)
    return encoder


# the contract


@pytest.mark.parametrize(("name", "options"), CASES)
def test_an_encoder_starts_at_zero_and_every_parameter_that_matters_learns(surface, name, options):
    encoder = ENCODERS.build(name, {"map_size": 64, **options}, channels=CHANNELS)
    poses = random_poses(5)
    traits = ENCODERS.traits(name, options)
    inputs = tensors(surface, poses, traits.inputs)
    if traits.prepares:
        encoder.prepare(surface, torch.ones(5, 64, 64, dtype=torch.bool), *inputs)
    out = encoder(*inputs)
    assert out.shape == (5, CHANNELS, 64, 64)
    assert not out.any()  # stage 2 begins at the avatar of stage 1
    before = [p.detach().clone() for p in encoder.parameters()]
    optimizer = torch.optim.Adam(encoder.parameters(), lr=1e-2)
    for _ in range(3):
        optimizer.zero_grad()
        (encoder(*inputs) - 1).square().mean().backward()
        optimizer.step()
    assert encoder(*inputs).any()
    assert any(not torch.equal(a, b) for a, b in zip(before, encoder.parameters(), strict=True))


@pytest.mark.parametrize(("name", "options"), CASES)
def test_an_encoder_is_finite_in_any_pose_and_gives_one_pose_what_it_gives_it_in_a_batch(surface, name, options):
    encoder = ENCODERS.build(name, {"map_size": 64, **options}, channels=CHANNELS)
    poses = np.concatenate([random_poses(3), np.zeros((1, 52, 3)), np.full((1, 52, 3), np.pi), random_poses(1, 9.0)])
    traits = ENCODERS.traits(name, options)
    inputs = tensors(surface, poses, traits.inputs)
    if traits.prepares:
        encoder.prepare(surface, torch.ones(6, 64, 64, dtype=torch.bool), *inputs)
    for parameter in encoder.parameters():
        torch.nn.init.normal_(parameter, 0, 0.1)
    with torch.no_grad():
        together = encoder.eval()(*inputs)
        assert torch.isfinite(together).all()
        for i in range(len(poses)):
            alone = encoder(*(x[i : i + 1] for x in inputs))
            # the same float32 sums in another order
            torch.testing.assert_close(alone[0], together[i], atol=1e-4, rtol=1e-4)


# what encoders look at


def test_normals_are_those_of_the_posed_surface_and_turn_with_the_root(surface):
    pose = random_poses(1, 0.2)[0]
    pose[0] = 0
    normals = normal_map(surface, pose).reshape(-1, 3)[surface.texel]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    # finite differences of the posed mesh: blending normals as points ignores the gradient of the weights
    posed, _ = free_body().posed(pose.astype(np.float64))
    corners = posed[free_body().faces[surface.face]]
    geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    geometric /= np.linalg.norm(geometric, axis=1, keepdims=True)
    assert np.median((geometric * normals).sum(1)) > 0.99
    turned = pose.copy()
    turned[0] = (0.3, 1.2, -0.5)
    R = matrix_from_axis_angle(turned[0])
    expected = normals @ R.T
    np.testing.assert_allclose(normal_map(surface, turned).reshape(-1, 3)[surface.texel], expected, atol=1e-5)
    empty = np.ones(64 * 64, bool)
    empty[surface.texel] = False
    assert not normal_map(surface, turned).reshape(-1, 3)[empty].any()


def test_joint_rotations_do_not_see_where_the_person_faces():
    poses = random_poses(2)
    poses[1, 1:] = poses[0, 1:]
    rotations = joint_rotations(poses)
    assert rotations.shape == (2, 22, 3, 3)
    np.testing.assert_array_equal(rotations[0], rotations[1])
    np.testing.assert_array_equal(rotations[0, 0], np.eye(3))


@pytest.mark.parametrize("name", INPUTS)
def test_what_the_player_makes_of_one_pose_is_what_training_makes_of_many(surface, name):
    poses = np.concatenate([random_poses(2, 1.0), np.zeros((1, 52, 3), np.float32), np.full((1, 52, 3), np.pi)])
    expected = INPUTS[name](surface, poses.astype(np.float32))
    made = PoseInput(name, surface)
    for i, pose in enumerate(poses.astype(np.float32)):
        np.testing.assert_allclose(made(pose)[0], expected[i], atol=2e-6)  # float32 sums in another order


@pytest.mark.parametrize("name", INPUTS)
def test_an_input_has_the_shape_that_it_declares(surface, name):
    assert INPUTS[name](surface, random_poses(2)).shape == (2, *input_shape(name, surface.resolution))
    assert input_shapes(name) == {name: INPUTS[name].shape}


def test_an_input_that_nobody_knows_is_one_sentence():
    with pytest.raises(UserError, match=r"the encoder wants the input 'smell'.*joint_rotations"):
        input_shapes("positional_map", "smell")
    check_inputs(tuple(INPUTS), "anything")


def test_texels_count_as_seen_where_they_face_the_camera(surface):
    pose = np.zeros((1, 52, 3), np.float32)
    motion = Motion(pose, np.array([[0.5, 1.0, -2.0]], np.float32), 1.0)
    place = motion.trans[0] + surface.joints[0]
    front = Camera(64, 64, 64, 64, 32, 32, look_at((*place[:2], place[2] + 5), place))
    back = Camera(64, 64, 64, 64, 32, 32, look_at((*place[:2], place[2] - 5), place))
    seen = facing_texels(surface, motion, [0, 0], [front, back]).numpy().reshape(2, -1)[:, surface.texel]
    facing = normal_map(surface, pose[0]).reshape(-1, 3)[surface.texel][:, 2]
    np.testing.assert_array_equal(seen[0], facing > 0.1)
    np.testing.assert_array_equal(seen[1], facing < -0.1)


# the linear encoder


def test_harmonics_are_orthonormal_over_the_sphere_and_without_mean():
    n = 200_000
    i = np.arange(n) + 0.5
    theta, z = np.pi * (1 + 5**0.5) * i, 1 - 2 * i / n  # a Fibonacci lattice
    r = np.sqrt(1 - z**2)
    normals = torch.from_numpy(np.stack([r * np.cos(theta), r * np.sin(theta), z]))[None]
    values = harmonics(normals, 2)[0]
    gram = values @ values.T / n
    torch.testing.assert_close(gram, torch.eye(8, dtype=gram.dtype), atol=1e-4, rtol=0)  # the lattice's own error
    assert values.mean(1).abs().max() < 1e-4
    assert torch.equal(harmonics(normals, 1)[0], values[:3])


def test_light_of_degree_2_counts_as_a_matt_surface_returns_it(surface):
    """Light of one direction n0 comes back as max(0, n n0): its coefficients of degree 2 are 3/8 of those of degree 1
    in the scale of the harmonics here, up to the constants that maps learn anyway."""
    poses = random_poses(6)
    first, second = (prepared(surface, poses, order=order, bases=0) for order in (1, 2))
    weights = second.weights(tensors(surface, poses, second.inputs))
    torch.testing.assert_close(weights[:, :3], first.weights(tensors(surface, poses, first.inputs)))
    plain = harmonics(tensors(surface, poses, second.inputs)[0], 2)
    torch.testing.assert_close(weights[:, 3:], plain[:, 3:] * 3 / 8)


def test_distances_along_the_skeleton():
    steps = joint_distances(free_body().parents, 22)
    assert (steps == steps.T).all()
    assert (np.diag(steps) == 0).all()
    assert steps[0, 3] == 1  # pelvis, spine
    assert steps[1, 2] == 2  # hip to hip, through the pelvis
    assert steps[18, 20] == 1  # elbow, wrist
    assert steps[20, 21] == 8  # wrist to wrist: elbow, shoulder, collar, upper spine, and down again


def test_light_stays_with_the_room(surface):
    """Turning person and light together would change nothing; turning the person alone does."""
    poses = np.zeros((8, 52, 3), np.float32)
    poses[:, 0, 1] = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    encoder = prepared(surface, poses, bases=0)
    out = encoder(*tensors(surface, poses, encoder.inputs)).detach()
    valid = torch.zeros(64 * 64, dtype=torch.bool)
    valid[torch.from_numpy(surface.texel).long()] = True
    change = (out[0] - out[4]).flatten(1)[:, valid].abs().amax(0)
    assert (change > 1e-3).float().mean() > 0.9
    moved = poses.copy()
    moved[:, 18] = (0, 0, 1.0)  # an elbow bends: what it does not carry has the same light
    elsewhere = (encoder(*tensors(surface, moved, encoder.inputs)).detach() - out).flatten(2).abs().amax((0, 1))
    carried = np.isin(surface.joint_index, [18, 20, *range(22, 37)]) & (surface.joint_weight > 0)
    still = torch.from_numpy(surface.texel[~carried.any(1)]).long()
    assert elsewhere[still].max() < 1e-4


def test_a_joint_changes_only_what_is_within_its_reach(surface):
    poses = random_poses(20)
    encoder = prepared(surface, poses, order=0, bases=3, reach=1)
    before, moved = poses[:1].copy(), poses[:1].copy()
    moved[:, 18] += 0.2  # the left elbow
    change = encoder(*tensors(surface, moved, encoder.inputs)) - encoder(*tensors(surface, before, encoder.inputs))
    change = change.detach().flatten(2).abs().amax((0, 1)).numpy()[surface.texel]
    near = (np.isin(surface.joint_index, [16, 18, 20, *range(22, 37)]) & (surface.joint_weight > 0)).any(1)
    assert change[~near].max() == 0
    assert change[near].max() > 1e-2


def held(encoder: LinearEncoder, surface, poses) -> torch.Tensor:
    """(B, K, M, M) the weights of the maps in those poses."""
    with torch.no_grad():
        return encoder.held_weights(tuple(tensors(surface, poses, encoder.inputs)))


def test_what_depends_on_the_pose_is_zero_in_the_mean_over_training(surface):
    poses = random_poses(20)
    share = torch.rand(20, generator=torch.Generator().manual_seed(0)) + 0.1
    seen = (share[:, None, None] * torch.ones(64, 64)).clone()
    seen[:5, :32] = 0  # half of the atlas is not seen in some views
    weights = held(prepared(surface, poses, seen), surface, poses)
    mean = (weights * seen[:, None]).sum(0) / seen.sum(0)
    assert weights.abs().max() > 0.5
    assert mean.abs().max() < 1e-5 * weights.abs().max() + 1e-5  # float32 sums


def test_a_joint_that_leaves_its_seen_poses_fades_what_it_carries_and_nothing_else(surface):
    poses = random_poses(20, 0.3)
    encoder = prepared(surface, poses, order=0, reach=1)
    far = np.repeat(poses[:1], 5, 0)
    far[:, 18, 1] += np.array([0.0, 0.3, 0.8, 1.6, 3.0])  # the left elbow, step by step away from what it was seen at
    sizes = held(encoder, surface, far).flatten(2).abs().sum(1).numpy()[:, surface.texel]
    carried = (surface.joint_weight * (surface.joint_index == 18)).sum(1) > 0.95
    near = (np.isin(surface.joint_index, [16, 18, 20, *range(22, 37)]) & (surface.joint_weight > 0)).any(1)
    assert sizes[0, carried].mean() > 0.5
    assert sizes[-1, carried].mean() < 0.05 * sizes[0, carried].mean()
    np.testing.assert_array_equal(sizes[-1, ~near], sizes[0, ~near])


def test_a_normal_beyond_those_seen_of_a_texel_fades_its_light(surface):
    poses = np.zeros((9, 52, 3), np.float32)
    poses[:, 0, 1] = np.linspace(-0.5, 0.5, 9)  # turned a little to both sides
    encoder = prepared(surface, poses, bases=0)
    turned = np.repeat(poses[:1], 4, 0)
    turned[:, 0, 1] = (0.5, 0.8, 1.6, np.pi)
    sizes = held(encoder, surface, turned).flatten(2).norm(dim=1).numpy()[:, surface.texel].mean(1)
    seen = held(encoder, surface, poses).flatten(2).norm(dim=1).numpy()[:, surface.texel].mean(1)
    assert seen[-1] == pytest.approx(sizes[0], rel=1e-5)
    assert sizes[2] < 0.2 * sizes[0]
    assert sizes[3] < 1e-3 * sizes[0]


def test_thin_evidence_is_shrunk_and_a_pose_that_recurs_is_no_evidence(surface):
    spread = random_poses(40, 0.4)
    shaking = spread[:1] + random_poses(40, 0.01, seed=1)  # one pose, as an estimator gives it frame after frame
    each, once = torch.ones(40, 64, 64), torch.full((40, 64, 64), 1 / 40)
    rich, thin, noise = (prepared(surface, *given) for given in ((spread, each), (spread, once), (shaking, once)))
    texel = torch.from_numpy(surface.texel).long()
    trusts = [encoder.trust.flatten(1)[:, texel].mean(1) for encoder in (rich, thin, noise)]
    assert (trusts[0] > 2 * trusts[1]).all()
    assert (trusts[2] < 1e-3).all()
    assert held(noise, surface, spread).abs().max() < 1e-2 * held(rich, surface, spread).abs().max()


def test_an_encoder_of_the_former_kind_stays_clamped(surface):
    """Weights were once clamped to their range, and a state of that kind has neither trust nor fading."""
    poses = random_poses(20, 0.3)
    state = prepared(surface, poses).state_dict()
    former = {k: v for k, v in state.items() if k in ("maps", "mean", "carried", "rotation_mean", "components")}
    former |= {"low": torch.full_like(state["mean"], -0.3), "high": torch.full_like(state["mean"], 0.2)}
    encoder = LinearEncoder(LinearConfig(), channels=CHANNELS)
    encoder.load_state_dict(former)
    wild = tensors(surface, random_poses(4, 1.0, seed=1), encoder.inputs)
    expected = (encoder.weights(tuple(wild)) - former["mean"]).clamp(-0.3, 0.2)
    torch.testing.assert_close(encoder.held_weights(tuple(wild)), expected)
    again = LinearEncoder(LinearConfig(), channels=CHANNELS)
    again.load_state_dict(encoder.state_dict())
    assert torch.equal(again(*wild), encoder(*wild))


def test_what_was_never_seen_or_in_one_pose_keeps_its_one_look(surface):
    poses = random_poses(20)
    seen = torch.zeros(20, 64, 64, dtype=torch.bool)
    seen[:, :32] = True  # the upper half of the atlas in every view
    seen[3, 32:48] = True  # some below in a single one
    encoder = prepared(surface, poses, seen)
    out = encoder(*tensors(surface, random_poses(4, seed=2), encoder.inputs)).detach()
    assert out[:, :, :32].abs().max() > 0.1
    assert out[:, :, 32:].abs().max() < 1e-5
    alone = prepared(surface, poses[:1])  # one frame: nothing is known to change
    assert alone(*tensors(surface, poses, alone.inputs)).abs().max() < 1e-5


def test_a_motion_without_movement_prepares(surface):
    poses = np.zeros((4, 52, 3), np.float32)
    encoder = prepared(surface, poses)
    assert torch.isfinite(encoder(*tensors(surface, random_poses(3, 2.0), encoder.inputs))).all()
    assert all(torch.isfinite(b).all() for b in encoder.buffers())


@pytest.mark.parametrize(
    ("options", "message"),
    [({"order": 3}, "order must be 0"), ({"order": 0, "bases": 0}, "encoder=none"), ({"bases": -1}, "bases"),
     ({"map_size": 32}, "from 64 to 1024"), ({"map_size": 100_000}, "from 64 to 1024"), ({"reach": -1}, "negative"),
     ({"beyond": -0.1}, "negative"), ({"thin": -1.0}, "negative")],
)  # fmt: skip
def test_impossible_options_are_one_sentence(options, message):
    with pytest.raises(UserError, match=message):
        LinearEncoder(dataclasses.replace(LinearConfig(), **options), channels=4)
