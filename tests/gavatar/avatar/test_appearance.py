"""What the avatar looks like: anisotropic Gaussians, cameras nearer than those of training."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tiny_capture import SMALL, demo, write_tiny_capture

from gavatar.assemble import build_avatar, build_rasterizer, capture_on_body
from gavatar.avatar.torch_skinning import skin_rotations
from gavatar.avatar.trainable import AvatarConfig
from gavatar.body.torch_rotations import matrix_from_axis_angle, quaternion_from_matrix, quaternion_product
from gavatar.capture.opening import open_capture
from gavatar.config import compose_config
from gavatar.evaluation.scores import Evaluator
from gavatar.export.bundling import export
from gavatar.registry import load_plugins
from gavatar.training.motion_table import MotionTable
from gavatar.training.run import finest_pixel, open_run, train
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.widening import as_trained
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians

WHITE = (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


@pytest.fixture(scope="module")
def built():
    load_plugins()
    filmed = open_capture(demo())
    node = {"name": "mlp", "widths": [16], "skip": -1, "head_width": 8, "anisotropic": True}
    made = build_avatar({"name": "auto"}, {"name": "none"}, node, AvatarConfig(features=8, feature_size=32), filmed, 0)
    made.avatar.sample_at(made.atlas(64))
    motion = capture_on_body(filmed, made.body.data).truth
    return made, MotionTable(motion, made.body.data.num_joints).requires_grad_(False)


def test_quaternions_and_their_products_are_those_of_scipy():
    random = np.random.default_rng(0).normal(size=(40, 3)) * 2
    special = [[0, 0, 0], [1e-9, 0, 0], [np.pi, 0, 0], [0, -np.pi, 0], [0, 0, np.pi - 1e-7], [2 * np.pi, 0, 0]]
    rotations = Rotation.from_rotvec(np.concatenate([special, random]))
    ours = quaternion_from_matrix(torch.from_numpy(rotations.as_matrix()))
    assert torch.allclose(ours.norm(dim=-1), torch.ones(len(ours), dtype=torch.float64))
    others = rotations[::-1]
    product = quaternion_product(ours, ours.flip(0)).numpy()
    expected = (rotations * others).as_quat(scalar_first=True)
    # a quaternion and its negative are one rotation
    np.testing.assert_allclose(np.abs((product * expected).sum(-1)), 1, atol=1e-12)


def test_skinned_rotations_are_near_the_nearest_rotation_of_the_blended_matrix(built):
    made, table = built
    avatar = made.avatar
    transforms = avatar.skeleton.canonical_to_posed(table([0, 40, 80, 110]).rotations)
    identity = torch.tensor([1.0, 0, 0, 0]).expand(len(avatar.surface), 4)
    got = Rotation.from_quat(
        skin_rotations(identity, avatar.weights, transforms, avatar.skeleton.parents).reshape(-1, 4).numpy(),
        scalar_first=True,
    )
    blended = (avatar.weights @ transforms.flatten(-2)).unflatten(-1, (3, 4))[..., :3].reshape(-1, 3, 3)
    U, _, V = np.linalg.svd(blended.double().numpy())
    angle = np.degrees((got.inv() * Rotation.from_matrix(U @ V)).magnitude())
    # two averages of the same rotations: equal where one joint carries a point, apart where bent joints share it
    # (measured over the capture: 7.3 degrees at most, 0.8 for 99 of 100 points)
    assert angle.max() < 10
    assert np.quantile(angle, 0.95) < 2


@pytest.mark.parametrize("angle", [0.0, 1.0, np.pi, 2 * np.pi - 0.1])
def test_turning_the_whole_body_turns_every_gaussian_alike(built, angle):
    made, _ = built
    avatar = made.avatar
    rest = torch.eye(3).expand(1, len(avatar.skeleton.parents), 3, 3).clone()
    turned = rest.clone()
    turned[:, 0] = matrix_from_axis_angle(angle * torch.tensor([0.6, 0.0, -0.8]))
    own = torch.nn.functional.normalize(torch.randn(len(avatar.surface), 4), dim=-1)
    before, after = (
        skin_rotations(own, avatar.weights, avatar.skeleton.canonical_to_posed(pose), avatar.skeleton.parents)[0]
        for pose in (rest, turned)
    )
    expected = quaternion_product(quaternion_from_matrix(turned[0, 0]), before)
    np.testing.assert_allclose((after * expected).sum(-1).abs().detach().numpy(), 1, atol=1e-5)


def test_equal_scales_make_anisotropic_gaussians_isotropic_ones(built):
    made, table = built
    avatar, camera = made.avatar, open_capture(demo()).cameras["cam0"].scaled(0.5)
    with torch.no_grad():
        attributes = avatar.attributes()
        attributes = dataclasses.replace(attributes, scales=attributes.scales[..., :1].expand_as(attributes.scales))
        round_ = dataclasses.replace(attributes, scales=attributes.scales[..., 0].contiguous(), rotations=None)
        draw = build_rasterizer({"name": "torch"})
        pictures = [draw(avatar.pose(a, table([30]))[0], camera, WHITE).color for a in (attributes, round_)]
    # float32 covariances by two formulas; 1e-5 is the bound between rasterizers where no threshold is crossed
    difference = (pictures[0] - pictures[1]).abs().amax(-1)
    assert (difference > 1e-4).float().mean() < 1e-3
    assert difference.max() < 1 / 255 + 1e-4  # a splat at the edge of its support


def test_anisotropic_gaussians_train_and_are_not_exported(capture, tmp_path):
    out = tmp_path / "run"
    config = [f"capture={capture}", f"out={out}", *SMALL, "encoder=none", "decoder.anisotropic=true"]
    train(compose_config([o for o in config if not o.startswith("encoder.")]), out)
    run = open_run(out)
    (gaussians,) = run.avatar.pose(run.avatar.attributes(), MotionTable(run.capture.motion, 52)([0]))
    spread = gaussians.scales.amax(-1) / gaussians.scales.amin(-1)
    assert gaussians.scales.shape == (len(run.avatar.surface), 3)
    assert float(spread.max()) > 1  # the axes have come apart
    with pytest.raises(UserError, match="anisotropic"):
        export(run, tmp_path / "a.gavatar")
    assert not (tmp_path / "a.gavatar").exists()


def camera_at(distance: float, side: int, focal: float) -> Camera:
    T = np.eye(4)
    T[2, 3] = distance
    return Camera(side, side, focal, focal, side / 2, side / 2, T)


def specks(count: int = 24, spacing: float = 0.02) -> Gaussians:
    """A grid of dots, smaller than their spacing, that pixels of a spacing's size close."""
    grid = (np.arange(count) - (count - 1) / 2) * spacing
    x, y = np.meshgrid(grid, grid)
    means = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], -1).astype(np.float32)
    return Gaussians(means, np.full(len(means), 0.2 * spacing, np.float32), np.zeros_like(means))


def drawn(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    tensors = [torch.from_numpy(np.asarray(x)) for x in (gaussians.means, gaussians.scales, gaussians.colors)]
    load_plugins()
    return build_rasterizer({"name": "torch"})(Gaussians(*tensors), camera, WHITE).alpha.numpy()


def test_a_nearer_camera_sees_no_more_gaps_than_training_did():
    far, near = camera_at(2.0, 32, 100.0), camera_at(2.0, 128, 400.0)
    gaussians, pixel = specks(), 2.0 / 100
    inside = slice(40, 88)
    # training pixels fall anywhere between the dots
    phases = [dataclasses.replace(far, cx=16 + x, cy=16 + y) for x in (0, 0.25, 0.5) for y in (0, 0.25, 0.5)]
    seen = min(drawn(gaussians, camera)[10:22, 10:22].min() for camera in phases)
    gaps, closed = (
        drawn(gaussians, near)[inside, inside],
        drawn(as_trained(gaussians, near, pixel), near)[inside, inside],
    )
    assert gaps.min() < 0.3 < seen  # the fault: training saw a surface, a finer pixel sees dots
    # the variance in metres is that of training; finer pixels only fall into more places between the dots
    assert closed.min() > seen - 0.01


@pytest.mark.parametrize(
    ("pixel", "distance"), [(None, 2.0), (0.005, 2.0), (0.02, -2.0), (0.02, np.nan), (0.02, np.inf), (0.02, 0.0)]
)
def test_nothing_changes_where_it_is_not_known_or_not_needed(pixel, distance):
    gaussians = specks()
    assert as_trained(gaussians, camera_at(distance, 128, 300.0), pixel) is gaussians


def test_no_gaussians_and_three_scales_are_served_too():
    camera = camera_at(2.0, 128, 400.0)
    none = Gaussians(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    assert as_trained(none, camera, 0.02) is none
    one = Gaussians(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.float32), np.zeros((1, 3)))
    wide = as_trained(one, camera, 0.02).scales
    assert wide.dtype == np.float32
    np.testing.assert_allclose(wide, np.sqrt(0.3 * (0.02**2 - 0.005**2)), rtol=1e-6)


def test_evaluation_and_player_agree_on_a_camera_nearer_than_training(capture, tmp_path):
    from gavatar_runtime.avatar.playing import Avatar
    from gavatar_runtime.render.choice import build_rasterizer as player_rasterizer

    out = tmp_path / "run"
    config = [f"capture={capture}", f"out={out}", *SMALL, "encoder=none"]
    train(compose_config([o for o in config if not o.startswith("encoder.")]), out)
    run = open_run(out)
    export(run, tmp_path / "a.gavatar")
    played = Avatar(tmp_path / "a.gavatar")
    view = run.capture.views("train")[0]
    camera = run.capture.camera(view)  # four times as fine as the last level's images
    assert played.pixel == pytest.approx(run.pixel)
    assert run.pixel == pytest.approx(
        finest_pixel(run.capture, run.capture.views("train"), 1.0, run.motion.motion()) * 4
    )
    motion = run.motion.motion()
    gaussians = played.gaussians(motion.poses[view.frame], motion.trans[view.frame])
    wide = as_trained(gaussians, camera, played.pixel)
    assert (wide.scales > gaussians.scales).all()
    image = player_rasterizer("numpy").render(wide, camera, WHITE).color
    difference = np.abs(image - Evaluator(run, progress=False).render(view, motion)).max(-1)
    assert (difference > 2 / 255).mean() < 1e-3  # the bound between rasterizers
