"""Tiers: every cheaper way to decode an avatar, against the full model; level of detail, reuse, choosing."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture
from torch import nn

from gavatar.avatar.uv_sampling import sample_uv
from gavatar.export.bundling import export, on_front
from gavatar.export.distillation import _bases, _fit_turns, distil
from gavatar.export.onnx_graphs import bilinear, subpixel
from gavatar.export.tier_source import RANGE, TierSource, joint_of_points, limb_of_joints, upsampling
from gavatar.measure.ladder import Choice, Row, compare, default_choices, images, mark_dominated
from gavatar.registry import TIERS, load_plugins
from gavatar.training.run import open_run, train
from gavatar_plugins.encoders.linear import harmonics
from gavatar_runtime import native_library
from gavatar_runtime.avatar.adaptive import PATIENCE, RECOVERY, AdaptiveAvatar
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.decoding import residuals
from gavatar_runtime.decoding.detail import thinned, uv_for_size
from gavatar_runtime.decoding.network import CHUNK
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.play.framing import frame_motion, size_on_screen
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.tiers import player_tiers, stored_tiers
from gavatar_runtime.tiers.blendshape import Coefficients, pose_input, turn_input
from gavatar_runtime.values.motion import Motion

load_plugins()
CHEAP = [name for name in TIERS.names() if name != "full"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    from gavatar.config import compose_config

    capture = write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")
    out = tmp_path_factory.mktemp("run") / "run"
    train(compose_config([f"capture={capture}", f"out={out}", *SMALL]), out)
    run = open_run(out)
    # a few steps leave the encoder near its zero start: give the pose something to do
    torch.manual_seed(0)
    with torch.no_grad():
        run.avatar.encoder.up[-1][1].weight.normal_(0, 0.05)
    return run


@pytest.fixture(scope="module")
def bundle(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("bundle") / "a.gavatar"
    export(run, path, tiers=TIERS.names())
    return read_bundle(path, verify=True)


@pytest.fixture(scope="module")
def fine(run, tmp_path_factory):
    """The same avatar with more Gaussians than the smallest level of detail."""
    path, before = tmp_path_factory.mktemp("bundle") / "fine.gavatar", run.avatar.surface
    export(run, path, uv=96, tiers=["int8", "blendshape"])
    run.avatar.sample_at(before)
    return read_bundle(path)


# the kernels


def random_residuals(count: int, seed: int = 0):
    rng = np.random.default_rng(seed)
    base = rng.normal(0.4, 0.5, (count, 8)).astype(np.float32)
    part = rng.integers(0, 5, count).astype(np.uint8)
    basis = rng.integers(-127, 128, (count, 6, 8)).astype(np.int8)
    coefficients = rng.normal(0, 1, (5, 6)).astype(np.float32)
    gains = rng.uniform(0, 1e-3, (5, 8)).astype(np.float32)
    return base, part, residuals.grouped(basis), np.pad(coefficients, ((0, 0), (0, 2))), gains


needs_kernel = pytest.mark.skipif(not native_library.available()[0], reason=native_library.available()[1])


@needs_kernel
@pytest.mark.parametrize("count", [0, 1, 8191, 20001])
def test_compiled_residuals_are_those_of_numpy(count):
    values = random_residuals(count)
    got = residuals.blendshapes(*values, residuals.empty(count))
    expected = residuals.blendshapes_reference(*values, residuals.empty(count))
    rng = np.random.default_rng(1)
    index = rng.integers(0, 50, (count, 4)).astype(np.int32)
    weight, table = rng.random((count, 4), np.float32), rng.normal(0, 1, (50, 8)).astype(np.float32)
    got += residuals.upsample(values[0], index, weight, table, residuals.empty(count))
    expected += residuals.upsample_reference(values[0], index, weight, table, residuals.empty(count))
    for a, b in zip(got, expected, strict=True):
        np.testing.assert_allclose(a, b, atol=2e-6)  # sums of a few float32 numbers near 1, in another order


@needs_kernel
def test_residuals_refuse_a_part_or_row_that_is_not_there():
    base, part, basis, coefficients, gains = random_residuals(10)
    part[7] = 5
    for function in (residuals.blendshapes, residuals.blendshapes_reference):
        with pytest.raises(IndexError, match="part"):
            function(base, part, basis, coefficients, gains, residuals.empty(10))
    index = np.full((10, 2), 3, np.int32)
    for function in (residuals.upsample, residuals.upsample_reference):
        with pytest.raises(IndexError, match="index"):
            function(base, index, np.ones((10, 2), np.float32), np.ones((3, 8), np.float32), residuals.empty(10))


def test_threads_that_share_the_rows_decode_the_same(fine):
    pose = np.random.default_rng(0).normal(0, 0.3, (52, 3)).astype(np.float32)
    for tier in ("full", "int8"):
        one, three = (Avatar(fine, tier=tier, threads=n) for n in (1, 3))
        assert three._tier._decoder._workers == 3
        assert len(three) > 2 * CHUNK  # so that all three have a share
        for _ in range(2):  # the first call finds the shapes, the next fills what is there
            a, b = one.gaussians(pose), three.gaussians(pose)
            for x, y in ((a.means, b.means), (a.scales, b.scales), (a.colors, b.colors)):
                np.testing.assert_allclose(x, y, atol=1e-6)  # products of other shapes may be summed in another order


def test_rows_that_no_thread_can_decode_are_an_error_of_the_call(fine):
    decoder = Avatar(fine, threads=2)._tier._decoder
    size = fine.surfaces()[1].resolution
    features = np.zeros((1, decoder._session.get_inputs()[0].shape[1], size, size), np.float32)
    rows = np.arange(2 * CHUNK, dtype=np.int32)
    rows[-1] = 10**6  # in the other thread's share
    with pytest.raises(Exception, match=r"(?i)gather|indices"):
        decoder(features, rows=rows)
    assert [len(x) for x in decoder(features, rows=rows[:1])] == [1, 1, 1]


def test_the_body_alone_is_what_framing_needs_and_gives_no_gaussians(fine):
    body, avatar = Avatar(fine, tier=None), Avatar(fine)
    assert len(body) == len(avatar)
    assert not body.networks
    assert avatar.networks
    motion = Motion(np.zeros((2, 52, 3), np.float32), np.float32([[0, 0, 0], [0, 0, 1.0]]), 30.0)
    assert frame_motion(body, motion, 64, 64).fx == frame_motion(avatar, motion, 64, 64).fx
    with pytest.raises(ValueError, match="tier=None"):
        body.gaussians(np.zeros((52, 3), np.float32))


# exact rewrites


def test_a_pixel_shuffle_is_the_transposed_convolution():
    torch.manual_seed(0)
    for size, bias in ((1, True), (2, False), (7, True)):
        net = nn.Sequential(nn.ConvTranspose2d(3, 5, 4, 2, 1, bias=bias), nn.ReLU())
        x = torch.randn(2, 3, size, size)
        assert not any(isinstance(m, nn.ConvTranspose2d) for m in subpixel(net).modules())
        assert torch.allclose(subpixel(net)(x), net(x), atol=1e-6)
    other = nn.Sequential(nn.ConvTranspose2d(3, 5, 3, 2, 1))
    assert isinstance(subpixel(other)[0], nn.ConvTranspose2d)  # another kernel is left as it is


def test_four_gathered_texels_are_the_bilinear_sample():
    rng = np.random.default_rng(0)
    uv = np.concatenate([rng.random((50, 2)), [[0, 0], [1, 1], [0, 1], [0.5, 0.5]]]).astype(np.float32)
    maps = torch.from_numpy(rng.normal(size=(1, 3, 16, 16)).astype(np.float32))
    corner, weight = bilinear(uv, 16)
    texels = maps.reshape(3, -1).T.numpy()
    got = (texels[corner] * weight[..., None]).sum(1)
    np.testing.assert_allclose(got, sample_uv(maps, torch.from_numpy(uv))[0].numpy(), atol=1e-5)


# the contract of every tier


@pytest.mark.parametrize("tier", TIERS.names())
def test_a_tier_decodes_every_gaussian_and_stays_within_bounds_in_any_pose(bundle, run, tier):
    avatar = Avatar(bundle, tier=tier)
    rng = np.random.default_rng(0)
    limit = run.avatar.decoder.config.offset_limit
    poses = [np.zeros((52, 3)), rng.normal(0, 2, (52, 3)), np.full((52, 3), np.pi), np.full((52, 3), 1e-12)]
    for pose in poses:
        gaussians = avatar.gaussians(pose.astype(np.float32))
        assert len(gaussians) == len(avatar) == bundle.manifest.gaussians
        for array in (gaussians.means, gaussians.scales, gaussians.colors):
            assert array.dtype == np.float32
            assert np.isfinite(array).all()
        assert gaussians.scales.min() >= 0
        assert gaussians.scales.max() < 3.01 * run.avatar.surface.spacing.max() * 2
        assert 0 <= gaussians.colors.min() <= gaussians.colors.max() <= 1
        body = avatar.surface.posed(pose.astype(np.float32))
        # skinning moves an offset by a blend of rotations: never longer than it was
        assert np.linalg.norm(gaussians.means - body, axis=1).max() <= 2 * np.sqrt(3) * limit


@pytest.mark.parametrize("tier", CHEAP)
def test_a_cheaper_tier_looks_like_the_full_model_on_poses_of_the_capture(bundle, tier):
    entry = next(t for t in bundle.manifest.tiers if t["name"] == tier)
    # the still look of this hardly trained avatar: measured 40 dB and more; a mistake in any table costs 15 dB
    assert entry["psnr_capture"] > 32
    assert entry["frame_ms"] > 0
    assert set(entry["members"]) <= set(bundle.manifest.members)


@pytest.mark.parametrize("tier", ["int8", "coarse", "blendshape"])
def test_tiers_of_the_pose_are_closer_to_the_full_model_than_the_still_look(bundle, tier):
    entries = {t["name"]: t for t in bundle.manifest.tiers}
    assert entries[tier]["psnr_capture"] > entries["baked"]["psnr_capture"]


@pytest.mark.parametrize("tier", TIERS.names())
def test_a_tier_keeps_its_last_two_results_while_it_makes_the_next(bundle, tier):
    """The player decodes ahead while a frame is drawn."""
    avatar = Avatar(bundle, tier=tier)
    poses = np.random.default_rng(0).normal(0, 0.3, (3, 52, 3)).astype(np.float32)
    first = avatar.gaussians(poses[0])
    kept = [a.copy() for a in (first.means, first.scales, first.colors)]
    avatar.gaussians(poses[1])
    avatar.gaussians(poses[2])
    for array, copy in zip((first.means, first.scales, first.colors), kept, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_blendshapes_fade_into_the_still_look_far_from_filmed_poses(run, monkeypatch):
    monkeypatch.setattr("gavatar.export.distillation.JUDGED", 0)  # else kept only where it helps
    options = {"rank": 4, "uv": 64, "samples": 4, "wide": 4, "width": 8, "steps": 5}
    surface = run.avatar.surface
    arrays = distil(TierSource(run, surface, lambda model: b"", False), **options)
    tier = Coefficients(arrays, surface.parents, "test")
    filmed = run.motion.motion().poses[0].astype(np.float32)
    joints = np.arange(1, 22)
    np.testing.assert_allclose(tier.shares(pose_input(filmed, joints)), 1, atol=1e-6)
    far = filmed.copy()
    far[1:22] += (0, 0, np.pi)  # a rotation by pi is 2 sqrt(2) from none
    np.testing.assert_array_equal(tier(far), 0)
    assert np.abs(tier(filmed)).max() > 0
    arm = filmed.copy()
    arm[[16, 18]] += (0, 0, np.pi)
    shares = tier.shares(pose_input(arm, joints))
    assert shares.min() < 1e-6  # the arm's own parts
    assert (shares > 1 - 1e-6).sum() > len(shares) // 2  # and no others
    values = [tier.shares(pose_input(filmed + t * (far - filmed), joints)).mean() for t in np.linspace(0, 0.5, 9)]
    assert (np.diff(values) <= 1e-6).all()
    endless = {k: v for k, v in arrays.items() if k not in ("seen", "near", "fade")}
    assert np.abs(Coefficients(endless, surface.parents, "test")(far)).max() > 0
    cut = {"seen": arrays["seen"][:, 9:], "near": arrays["near"][:, 1:]}  # of one joint less than it looks at
    for wrong in ({"seen": arrays["seen"][:, 1:]}, {"seen": arrays["seen"][:0]}, cut):
        with pytest.raises(UserError, match="do not fit"):
            Coefficients(arrays | wrong, surface.parents, "test")


def test_wide_poses_bend_limbs_within_their_range_and_mirror_sides(run):
    source = TierSource(run, run.avatar.surface, lambda model: b"", False)
    poses = source.wide_poses(200)
    assert poses.shape == (200, 52, 3)
    assert np.isfinite(poses).all()
    assert poses[:, 4, 0].max() > 1.8  # deep knees
    assert poses[:, 16, 2].max() > 1.0  # the left arm high
    assert poses[:, 17, 2].min() < -1.0  # and the right one
    np.testing.assert_array_equal(poses, source.wide_poses(200))
    for joint, (low, high) in RANGE.items():
        assert np.all(np.less(low, high)), joint


def test_player_and_training_half_know_the_same_tiers():
    assert player_tiers().names() == TIERS.names()


def test_a_tier_that_the_bundle_lacks_or_nobody_knows_is_one_sentence(run, tmp_path, bundle):
    export(run, tmp_path / "plain.gavatar")
    assert stored_tiers(read_bundle(tmp_path / "plain.gavatar")) == ["full"]
    with pytest.raises(UserError, match=r"holds no tier 'baked'.*--tiers baked"):
        Avatar(tmp_path / "plain.gavatar", tier="baked")
    with pytest.raises(UserError, match=r"unknown tier 'bakd'.*did you mean 'baked'"):
        Avatar(bundle, tier="bakd")
    with pytest.raises(UserError, match="unknown tier"):
        export(run, tmp_path / "a.gavatar", tiers=["bakd"])


def test_a_tier_brings_the_tiers_that_it_reads(run, tmp_path):
    manifest = export(run, tmp_path / "a.gavatar", tiers=["coarse"])
    assert [t["name"] for t in manifest.tiers] == ["full", "baked", "coarse"]


# level of detail and reuse


def test_fewer_larger_gaussians_close_the_surface(bundle):
    pose = np.zeros((52, 3), np.float32)
    avatar = Avatar(bundle, tier="baked")
    motion = Motion(pose[None], np.zeros((1, 3), np.float32), 30.0)
    camera = frame_motion(avatar, motion, 96, 96)
    rasterizer = build_rasterizer()
    whole = rasterizer.render(avatar.gaussians(pose), camera, (1, 1, 1)).alpha.copy()
    uv = max(64, avatar.surface.resolution * 3 // 4)
    thin = Avatar(bundle, tier="baked", uv=uv)
    part = rasterizer.render(thin.gaussians(pose), camera, (1, 1, 1)).alpha
    assert len(thin) <= len(avatar)
    inside = whole > 0.99
    assert (part[inside] > 0.9).mean() > 0.99


def test_thinning_keeps_one_gaussian_a_cell_and_all_at_full_detail(bundle):
    surface, _ = bundle.surfaces()
    chosen, added = thinned(surface, surface.resolution)
    assert not added.any()
    assert len(chosen) == len(surface)
    finer = dataclasses.replace(surface, resolution=2 * surface.resolution, texel=_doubled(surface))
    chosen, added = thinned(finer, surface.resolution)
    # every fine texel has no neighbour here, so no spacing is known and none is made up
    assert not added.any()
    assert len(chosen) == len(surface)
    with pytest.raises(UserError, match="detail from 64"):
        thinned(surface, surface.resolution + 1)
    with pytest.raises(UserError, match="detail from 64"):
        thinned(surface, 63)
    assert uv_for_size(surface, 1) == 64
    assert uv_for_size(surface, 1e6) == surface.resolution


def _doubled(surface):
    row, column = np.divmod(surface.texel, surface.resolution)
    return 4 * row * surface.resolution + 2 * column


def test_reuse_fades_between_decodes_and_ends_at_each(bundle):
    rng = np.random.default_rng(0)
    poses = np.repeat(rng.normal(0, 0.3, (2, 1, 52, 3)), 4, 0).reshape(8, 52, 3).astype(np.float32)
    avatar, plain = Avatar(bundle, tier="coarse", reuse=4), Avatar(bundle, tier="coarse")
    faded = [avatar.gaussians(p).colors.copy() for p in poses]
    first, second = (plain.gaussians(poses[i]).colors.copy() for i in (0, 4))
    np.testing.assert_array_equal(faded[0], first)
    np.testing.assert_allclose(faded[5], (first + second) / 2, atol=1e-6)
    np.testing.assert_allclose(faded[7], second, atol=1e-6)
    with pytest.raises(UserError, match="reuse=0"):
        Avatar(bundle, reuse=0)


# only what the camera sees, and detail by size


@pytest.mark.parametrize("tier", ["full", "int8"])
@pytest.mark.parametrize("uv", [None, 64])
def test_decoding_what_is_seen_changes_nothing_of_what_is_decoded(fine, tier, uv):
    whole, seen = Avatar(fine, tier=tier, uv=uv), Avatar(fine, tier=tier, uv=uv, seen_only=True)
    assert seen.seen_only
    pose = np.random.default_rng(0).normal(0, 0.2, (52, 3)).astype(np.float32)
    motion = Motion(pose[None], np.zeros((1, 3), np.float32), 30.0)
    camera = frame_motion(whole, motion, 96, 96)
    for _ in range(2):  # the first call finds the shapes, the next ones fill what is there
        every, some = whole.gaussians(pose), seen.gaussians(pose, camera=camera)
        assert 0.4 * len(whole) < len(some) < 0.95 * len(whole)
        place = {tuple(mean): i for i, mean in enumerate(every.means.round(4).tolist())}
        rows = [place.get(tuple(mean), -1) for mean in some.means.round(4).tolist()]
        known = np.array(rows) >= 0  # rounding may part a few
        assert known.mean() > 0.98
        np.testing.assert_allclose(some.colors[known], every.colors[np.array(rows)[known]], atol=1e-5)
    assert len(seen.gaussians(pose)) == len(whole)  # without a camera all are decoded
    away = dataclasses.replace(camera, T_camera_world=np.diag([1.0, -1, -1, 1]) @ camera.T_camera_world)
    assert len(seen.gaussians(pose, camera=away)) == 0
    rasterizer = build_rasterizer()
    assert (rasterizer.render(seen.gaussians(pose, camera=away), away, (1, 1, 1)).color == 1).all()


def test_only_networks_of_one_decode_a_frame_leave_out_what_is_not_seen(fine):
    assert not Avatar(fine, tier="baked", seen_only=True).seen_only
    assert not Avatar(fine, tier="int8", seen_only=True, reuse=2).seen_only


def test_detail_follows_the_persons_size_on_screen(fine):
    avatar = Avatar(fine, tier="baked")
    motion = Motion(np.zeros((2, 52, 3), np.float32), np.float32([[0, 0, 0], [0, 0, 1.0]]), 30.0)
    sizes = []
    for pixels in (48, 96):
        camera = frame_motion(avatar, motion, pixels, pixels)
        sizes.append(size_on_screen(avatar, motion, [camera, camera]))
        assert 0.5 * pixels < sizes[-1] < 1.3 * pixels
    assert sizes[1] == pytest.approx(2 * sizes[0])
    inside = dataclasses.replace(camera, T_camera_world=np.eye(4))
    assert size_on_screen(avatar, motion, [inside, inside]) == np.inf
    assert uv_for_size(avatar.surface, np.inf) == avatar.surface.resolution


def test_the_player_takes_detail_and_seen_only_or_says_why_not(fine, tmp_path, capsys):
    from gavatar_runtime.cli.play import main

    def run(*options) -> tuple[int, dict, str]:
        report = tmp_path / "r.json"
        arguments = ["--size", "64", "--frames", "0:3", "--out", str(tmp_path / "f"), "--json", str(report), *options]
        with pytest.raises(SystemExit) as done:
            main([str(fine.path), *arguments])
        return done.value.code, json.loads(report.read_text()) if report.exists() else {}, capsys.readouterr().err

    code, report, _ = run("--uv", "auto", "--tier", "baked")
    assert code == 0
    assert report["uv"] < fine.surfaces()[0].resolution
    assert report["gaussians"] < fine.manifest.gaussians
    assert run("--detail", "64", "--tier", "full", "--seen-only")[0] == 0
    code, _, error = run("--tier", "baked", "--seen-only")
    assert code == 2
    assert "tier baked has nothing to leave out" in error
    code, _, error = run("--tier", "int8", "--seen-only", "--reuse", "2")
    assert code == 2
    assert "leave --reuse out" in error
    assert "--seen-only out" in run("--budget-ms", "5", "--seen-only")[2]


def test_every_rung_of_the_ladder_opens_and_is_named_once(fine):
    choices = default_choices(fine, auto_uv=70)
    assert len({c.label for c in choices}) == len(choices)
    assert {"baked, backface 0.3", "full, seen only", "blendshape, uv 70", "baked, resolution 0.5"} <= {
        c.label for c in choices
    }
    for choice in choices:
        choice.open(fine)
        choice.rasterizer()


# a budget


def test_a_budget_makes_frames_cheaper_and_finer_again(bundle):
    avatar = AdaptiveAvatar(bundle, 0.010, tier="int8")
    pose = np.zeros((52, 3), np.float32)
    assert avatar.levels[:4] == [(1, None), (2, None), (4, None), (8, None)]

    def frames(count: int, seconds: float) -> tuple:
        for _ in range(count):
            avatar.gaussians(pose)
            avatar.frame_took(seconds)
        return avatar.levels[avatar.level]

    assert frames(PATIENCE, 0.02) == (2, None)
    assert frames(2, 10.0) == (2, None)  # opening a level is slow, and no reason to go on
    assert frames(100, 0.02) == avatar.levels[-1]  # as cheap as it goes, and no further
    assert frames(RECOVERY, 0.008) == avatar.levels[-1]  # within the budget: nothing changes
    frames(8, 0.002)
    assert frames(RECOVERY, 0.002) == avatar.levels[-2]
    assert frames(500, 0.002) == (1, None)
    assert frames(PATIENCE - 1, 0.008) == frames(1, 5.0) == (1, None)  # one slow frame alone
    assert frames(20, 0.0099) == (1, None)  # and it is not carried along
    assert sum(level["frames"] for level in avatar.report()) == 2 * PATIENCE + 2 + 100 + 2 * RECOVERY + 8 + 500 + 20
    assert frames(PATIENCE, 0.05) == (4, None)  # far over: two levels at once
    with pytest.raises(UserError, match="budget of 0 ms"):
        AdaptiveAvatar(bundle, 0.0)
    assert [r for r, _ in AdaptiveAvatar(bundle, 1.0, tier="baked").levels] == [1]  # nothing to reuse


def test_the_player_keeps_a_budget_and_says_what_it_did(bundle, tmp_path, capsys):
    from gavatar_runtime.cli.play import main

    report = tmp_path / "r.json"
    options = [
        "--tier",
        "blendshape",
        "--size",
        "48",
        "--frames",
        "0:12",
        "--out",
        str(tmp_path / "f"),
        "--json",
        str(report),
    ]
    with pytest.raises(SystemExit) as done:
        main([str(bundle.path), *options, "--budget-ms", "0.01"])
    assert done.value.code == 0
    assert "budget 0.01 ms:" in capsys.readouterr().out
    levels = json.loads(report.read_text())["levels"]
    assert len(levels) >= 1
    assert sum(level["frames"] for level in levels) == 12
    with pytest.raises(SystemExit) as done:
        main([str(bundle.path), *options, "--budget-ms", "5", "--reuse", "2"])
    assert done.value.code == 2
    assert "leave --uv, --reuse and --seen-only out" in capsys.readouterr().err


# choosing


def test_only_what_is_beaten_in_both_is_dominated():
    rows = [Row(Choice(n), 1, 8, 8, fps=f, psnr_vs_full=p) for n, f, p in [("a", 1, 100), ("b", 9, 40), ("c", 8, 39)]]
    mark_dominated(rows)
    assert [row.dominated for row in rows] == [False, False, True]


def test_tiers_that_pay_are_chosen_beyond_the_noise_of_times():
    def front(**tiers) -> list[str]:
        return [
            t["name"]
            for t in on_front(
                [{"name": n, "frame_ms": ms, "psnr_capture": c, "psnr_mixed": m} for n, (ms, c, m) in tiers.items()]
            )
        ]

    assert front(full=(400, 100, 100), a=(9, 40, 40), b=(10, 39, 39)) == ["full", "a"]
    assert front(full=(400, 100, 100), b=(9, 39, 39), a=(9.5, 40, 40)) == ["full", "a"]  # 9 against 9.5 ms is noise
    assert front(full=(400, 100, 100), a=(9, 40, 38), b=(50, 40, 40)) == ["full", "a", "b"]  # closer on mixed poses
    assert front(full=(400, 100, 100), a=(9, 40, 39.6), b=(50, 40.1, 40)) == ["full", "a"]  # not by enough to pay
    assert front(full=(13.1, 100, 100), int8=(13.0, 62, 62)) == ["full"]
    assert front(full=(13, 100, 100), int8=(9, 62, 62)) == ["full", "int8"]
    assert front(a=(9, 40, 40), b=(9, 40, 40)) == ["a"]  # one of two that are alike
    assert front(full=(10, 100, 100), a=(20, 100, 100)) == ["full"]


def test_images_of_a_choice_compared_with_themselves_are_equal(bundle):
    motion = Motion(np.zeros((2, 52, 3), np.float32), np.zeros((2, 3), np.float32), 30.0)
    camera = frame_motion(Avatar(bundle, tier="baked"), motion, 48, 48)
    drawn = images(Choice("baked"), bundle, motion, [0, 1], [camera, camera])
    assert compare(drawn, drawn) == (100.0, 100.0, None)


# what builders start from


def test_limbs_and_parts_follow_the_skeleton(run):
    parents = run.built.body.data.parents
    limb = limb_of_joints(parents)
    assert limb[[0, 3, 6, 9, 12, 15]].tolist() == [0] * 6
    assert limb[1] == limb[4] == limb[7] == limb[10] > 0
    assert limb[20] == limb[22]  # fingers with their arm
    assert len({limb[1], limb[2], limb[13], limb[14], 0}) == 5
    joint = joint_of_points(run.avatar.surface)
    assert joint.min() == 0
    assert joint.max() < 22  # fingers count to their hand


def test_upsampling_reproduces_a_smooth_function_on_the_body(run):
    coarse, fine = run.built.surface(64), run.built.surface(96)
    index, weight = upsampling(coarse, fine)
    np.testing.assert_allclose(weight.sum(1), 1, atol=1e-5)
    got = np.einsum("nkc,nk->nc", coarse.points[index], weight)
    error = np.linalg.norm(got - fine.points, axis=1)
    assert np.median(error) < 0.25 * np.median(coarse.spacing)
    assert error.max() < 3 * coarse.spacing.max()  # never another part of the body


def test_grouped_bases_mean_what_they_say():
    rng = np.random.default_rng(0)
    basis = rng.integers(-127, 128, (3, 6, 8)).astype(np.int8)
    w = rng.normal(size=6).astype(np.float32)
    base, part, gains = np.zeros((3, 8), np.float32), np.zeros(3, np.uint8), np.full((1, 8), 1e-3, np.float32)
    padded = np.pad(w, (0, 2))[None]
    points = residuals.blendshapes(base, part, residuals.grouped(basis), padded, gains, residuals.empty(3))[0]
    expected = 1e-3 * np.einsum("nkc,k->nc", basis.astype(np.float32), w)[:, :3]
    np.testing.assert_allclose(points, expected, atol=1e-6)


def test_body_parts_without_points_keep_the_others_bases_in_place(run, monkeypatch):
    monkeypatch.setattr("gavatar.export.distillation.JUDGED", 0)
    whole = run.avatar.surface
    joint = joint_of_points(whole)
    assert (joint == 0).any()
    kept = np.flatnonzero(joint != 0)  # the first part's numbers are not to be taken by the second
    options = {"rank": 4, "uv": 64, "samples": 4, "wide": 4, "width": 8, "steps": 5}
    all_of_it = distil(TierSource(run, whole, lambda model: b"", False), **options)
    cut = distil(TierSource(run, whole.take(kept), lambda model: b"", False), **options)
    np.testing.assert_array_equal(cut["part"], all_of_it["part"][kept])
    np.testing.assert_array_equal(cut["near"], all_of_it["near"])
    assert cut["near"].any(1).all()  # every part hangs on some joint
    steps = [a["basis"] * a["gains"][a["part"]][:, None, :, None] for a in (cut, all_of_it)]
    np.testing.assert_allclose(steps[0], steps[1][kept], atol=all_of_it["gains"].max())  # half a step of int8 each


def test_a_part_that_no_pose_changes_has_bases_of_zero():
    residuals = np.random.default_rng(0).normal(size=(9, 7, 7)).astype(np.float32)
    part = np.array([0, 1, 0, 1, 1, 2, 0])
    residuals[:, part == 1] = 0  # as where no training view saw it
    coefficients, bases = _bases(residuals, part, 4)
    assert (coefficients.shape, bases.shape) == ((9, 12), (7, 4, 7))
    assert not coefficients[:, 4:8].any()
    assert not bases[part == 1].any()
    assert bases[part != 1].any()


# looks that depend on where surfaces face


def test_light_on_a_turning_part_is_linear_in_what_distillation_looks_at(run):
    """Second-order harmonics of a normal carried by one joint, in poses that were not fitted to."""
    surface = run.avatar.surface
    owners = np.array([0, 4, 16])
    rng = np.random.default_rng(0)
    poses = rng.normal(0, 0.8, (500, 52, 3)).astype(np.float32)
    turned = turn_input(poses, owners, surface.parents)
    assert turned.shape == (500, 3, 55)
    T = joint_transforms(poses, surface.joints, surface.parents)[:, owners, :3, :3]
    np.testing.assert_allclose(turned[..., :9].reshape(500, 3, 3, 3), T, atol=1e-5)
    normals = rng.normal(size=(3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    world = torch.from_numpy(np.einsum("spab,pb->sap", turned[..., :9].reshape(500, 3, 3, 3), normals))
    light = harmonics(world, 2).transpose(1, 2).reshape(500, -1).numpy().astype(np.float32)
    joints = np.arange(22)
    near = np.zeros((3, 22), bool)
    inputs = pose_input(poses, joints)
    direct, turn = _fit_turns(inputs[:400], turned[:400], light[:400], 0, near)
    assert not direct.any()
    got = np.einsum("spf,pfk->spk", turned[400:], turn).reshape(100, -1)
    assert np.abs(got - light[400:]).max() < 0.02 * np.abs(light).max()  # the ridge's pull towards zero
