"""Export: the bundle plays as the trained avatar does, or is not written."""

from __future__ import annotations

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.assemble import build_rasterizer as training_rasterizer
from gavatar.config import compose_config
from gavatar.export import bundling, packing
from gavatar.export import onnx_graphs as graphs
from gavatar.export.bundling import export, export_front
from gavatar.export.onnx_graphs import OPSET
from gavatar.export.seen import difference, seen
from gavatar.export.verification import ExportCheck
from gavatar.images.pixel_weights import pixel_weights
from gavatar.training.posing import posed
from gavatar.training.run import open_run, train
from gavatar_runtime import native_library
from gavatar_runtime.avatar.playing import Avatar as PlayedAvatar
from gavatar_runtime.bundle import pack_surfaces, read_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.tiers.members import BLENDSHAPE

VARIANTS = {
    "mlp and unet": [],
    "upstream and BatchNorm": ["decoder=upstream", "decoder.width=16", "encoder.norm=batch", "avatar.smoothing=true"],
    "features of another size than the map": ["avatar.feature_size=32"],
    "light and joints": ["encoder=linear", "encoder.map_size=64", "encoder.order=2", "encoder.thin=0.001"],
    "light alone, on a map of another size": ["encoder=linear", "encoder.map_size=72", "encoder.bases=0"],
    "joints alone": ["encoder=linear", "encoder.map_size=64", "encoder.order=0"],
    "static": ["encoder=none"],
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    capture = write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")
    opened = {}
    for name, overrides in VARIANTS.items():
        out = tmp_path_factory.mktemp("run") / "run"
        changed = {o.split("=")[0] for o in overrides}
        settings = [o for o in SMALL if o.split("=")[0] not in changed]
        if "decoder" in changed:
            settings = [o for o in settings if not o.startswith("decoder")]
        if "encoder" in changed:
            settings = [o for o in settings if not o.startswith("encoder")]
        train(compose_config([f"capture={capture}", f"out={out}", *settings, *overrides]), out)
        opened[name] = open_run(out)
        if "encoder=linear" in overrides:  # a few steps leave the maps near zero: give the pose something to do
            torch.manual_seed(0)
            opened[name].avatar.encoder.maps.normal_(0, 0.02)
    return opened


def test_a_run_of_one_frame_exports_with_measured_tiers(tmp_path):
    capture = write_tiny_capture(tmp_path / "one", frames=(20,), test=(), novel=())
    train(compose_config([f"capture={capture}", f"out={tmp_path / 'run'}", *SMALL]), tmp_path / "run")
    manifest = export(open_run(tmp_path / "run"), tmp_path / "a.gavatar", tiers=["baked"])
    assert all(0 < tier["frame_ms"] < np.inf for tier in manifest.tiers)


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_played_avatar_is_the_trained_one(runs, variant, tmp_path):
    run = runs[variant]
    manifest = export(run, tmp_path / "a.gavatar")
    assert manifest.dynamic == (variant != "static")
    played, motion = PlayedAvatar(read_bundle(tmp_path / "a.gavatar", verify=True)), run.motion.motion()
    for frame in (0, 4):
        got, expected = played.gaussians(motion.poses[frame], motion.trans[frame]), posed(run, motion, frame)
        # float32 through one network in two engines: a hundredth of the export's own tolerance
        assert np.abs(got.means - expected.means.numpy()).max() < 1e-5
        assert np.abs(got.colors - expected.colors.numpy()).max() < 1e-4
        assert np.abs(got.scales - expected.scales.numpy()).max() < 1e-6
    assert manifest.export_check["position_m"] < 1e-5
    assert manifest.export_check["poses"] == 6  # as many as there are training frames


def test_the_manifest_keeps_the_switches_that_the_avatar_was_trained_with(runs, tmp_path, monkeypatch):
    run = runs["static"]
    assert export(run, tmp_path / "plain.gavatar").rasterizer == {}
    trained = {"name": "native", "threads": 1, "antialiased": True, "fast": False, "resolution": 0.5}
    monkeypatch.setattr(run.config, "rasterizer", trained)
    assert export(run, tmp_path / "a.gavatar").rasterizer == {"antialiased": True}
    switches = read_bundle(tmp_path / "a.gavatar").manifest.rasterizer
    for name in ("native", "numpy"):
        if name == "numpy" or native_library.available()[0]:
            assert build_rasterizer(name, trained=switches).config.antialiased
            assert not build_rasterizer(name, {"antialiased": False}, trained=switches).config.antialiased


def test_cheaper_tiers_follow_an_encoder_that_sees_light(runs, tmp_path):
    run = runs["light and joints"]
    manifest = export(run, tmp_path / "a.gavatar", tiers=["coarse", "blendshape"])
    psnr = {tier["name"]: tier["psnr_capture"] for tier in manifest.tiers}
    assert min(psnr["coarse"], psnr["blendshape"]) > psnr["baked"] + 3  # dB: half the error of a still look or less
    bundle = read_bundle(tmp_path / "a.gavatar")
    assert bundle.manifest.components["encoder_inputs"] == ["normal_map", "joint_rotations"]
    pose = run.motion.motion().poses[0].copy()
    turned = pose.copy()
    turned[0] = run.motion.motion().poses[3][0]  # another facing of the capture
    change = {}
    for tier in ("full", "coarse", "blendshape"):
        avatar = PlayedAvatar(bundle, tier=tier)
        before = avatar.gaussians(pose).colors.copy()
        change[tier] = (avatar.gaussians(turned).colors - before).ravel()
    assert np.abs(change["full"]).max() > 1e-4  # a few steps of training; it fades outside what they saw
    for tier in ("coarse", "blendshape"):
        assert (
            np.corrcoef(change[tier], change["full"])[0, 1] > 0.5
        )  # blendshape after four steps: 0.59; blind to facing: 0
    arrays = bundle.arrays("blendshape.npz")
    for damage in (
        {"turn": arrays["turn"][:, 1:]},
        {"owners": arrays["owners"] + 30},
        {"direct": arrays["turn"]},
        {"seen": np.zeros((1, 9)), "near": arrays["turn"][:, 0] > 0, "fade": np.ones(2)},
    ):
        sizes = {"N": len(avatar), "body_joints": len(avatar.joint_names)}
        with pytest.raises(UserError, match=f"blendshape.npz: array '({'|'.join(damage)})'"):
            BLENDSHAPE.read(arrays | damage, "blendshape.npz", sizes)


def test_a_bundle_whose_map_lost_its_normals_is_one_sentence(runs, tmp_path, monkeypatch):
    monkeypatch.setattr(packing, "pack_surfaces", lambda a, b, normals: pack_surfaces(a, b))
    monkeypatch.setattr(bundling, "verify", lambda *a: ExportCheck(0, 0, 0, 1))
    export(runs["light and joints"], tmp_path / "a.gavatar")
    with pytest.raises(UserError, match=r"wants a normal_map.*export it again"):
        PlayedAvatar(tmp_path / "a.gavatar")


def test_onnx_members_state_opset_and_metadata_and_hold_no_batchnorm(runs, tmp_path):
    export(runs["upstream and BatchNorm"], tmp_path / "a.gavatar")
    bundle = read_bundle(tmp_path / "a.gavatar")
    for member in ("encoder.onnx", "decoder.onnx"):
        model = onnx.load_from_string(bundle.read(member))
        onnx.checker.check_model(model)
        properties = {p.key: p.value for p in model.metadata_props}
        assert model.opset_import[0].version == OPSET == bundle.manifest.opset
        assert properties["decoder"] == "upstream"
        assert properties["license"] == "CC0-1.0"
        assert "BatchNormalization" not in {node.op_type for node in model.graph.node}
    session = onnxruntime.InferenceSession(bundle.read("decoder.onnx"))
    shape = session.get_inputs()[0].shape
    features = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    (offsets,) = session.run(["offsets"], {"pose_features": features})
    assert len(offsets) == bundle.manifest.gaussians == len(runs["upstream and BatchNorm"].avatar.surface)


def test_a_decoder_gives_the_rows_it_is_asked_for(runs, tmp_path, monkeypatch):
    monkeypatch.setattr(graphs, "CHUNK", 256)  # several chunks, the last of them not full
    for name in ("mlp and unet", "features of another size than the map"):
        export(runs[name], tmp_path / "a.gavatar")
        session = onnxruntime.InferenceSession(read_bundle(tmp_path / "a.gavatar").read("decoder.onnx"))
        shape = session.get_inputs()[0].shape
        feeds = {"pose_features": np.random.default_rng(0).normal(size=shape).astype(np.float32)}
        whole = session.run(["offsets", "colors", "scales"], feeds)
        count = len(whole[0])
        for rows in ([0], [count - 1, 5, 5], np.arange(256), np.arange(0, count, 3), np.arange(count)[::-1]):
            rows = np.asarray(rows, np.int32)
            got = session.run(["offsets", "colors", "scales"], {**feeds, "rows": rows})
            for a, b in zip(got, whole, strict=True):
                np.testing.assert_allclose(a, b[rows], atol=1e-6)  # a matrix product in blocks of another place


def test_weights_of_a_picture_add_up_to_its_alpha(runs):
    run = runs["mlp and unet"]
    rasterize, camera = training_rasterizer({"name": "native"}), run.capture.camera(run.capture.views("train")[0])
    gaussians = posed(run, run.motion.motion(), 0)
    weights = pixel_weights(rasterize, gaussians, camera)
    assert weights.min() >= 0
    total = float(rasterize(gaussians, camera, (0.0, 0.0, 0.0)).alpha.sum())
    assert float(weights.sum()) == pytest.approx(total, rel=1e-4)  # float32 sums over a picture


def test_gaussians_that_no_camera_sees_are_left_out_and_the_picture_stays(runs, tmp_path):
    run = runs["mlp and unet"]
    strict, wide = seen(run, margin=0.0), seen(run, margin=0.02)
    assert 0 < strict.sum() < wide.sum() <= len(run.avatar.surface)
    assert wide[strict].all()
    changed = difference(run, strict)
    assert changed["psnr"] >= changed["worst_psnr"] > 35  # a hole of one pixel in this small picture costs more
    manifest = export(run, tmp_path / "a.gavatar", drop_unseen=True)
    left = manifest.training["unseen"]
    assert manifest.gaussians == wide.sum() == len(run.avatar.surface) - left["dropped"]
    played = PlayedAvatar(read_bundle(tmp_path / "a.gavatar", verify=True))
    motion = run.motion.motion()
    got = played.gaussians(motion.poses[0], motion.trans[0])
    expected = posed(run, motion, 0).means.numpy()[wide]
    assert np.abs(got.means - expected).max() < 1e-5


def test_an_export_leaves_the_run_as_it_was(runs, tmp_path):
    run = runs["mlp and unet"]
    surface, before = run.avatar.surface, {k: v.clone() for k, v in run.avatar.state_dict().items()}
    gaussians = posed(run, run.motion.motion(), 0)
    manifest = export(
        run, tmp_path / "a.gavatar", gaussians=len(run.built.atlas(96)), drop_unseen=True, tiers=["baked"]
    )
    assert manifest.gaussians != len(surface)
    assert run.avatar.surface is surface
    assert all(torch.equal(v, before[k]) for k, v in run.avatar.state_dict().items())
    again = posed(run, run.motion.motion(), 0)
    assert torch.equal(again.means, gaussians.means)
    assert torch.equal(again.colors, gaussians.colors)


def test_of_the_measured_tiers_those_that_pay_are_written(runs, tmp_path, monkeypatch):
    described = [
        {"name": "full", "frame_ms": 100.0, "psnr_capture": 100.0, "psnr_mixed": 100.0},
        {"name": "int8", "frame_ms": 99.0, "psnr_capture": 60.0, "psnr_mixed": 60.0},
        {"name": "baked", "frame_ms": 5.0, "psnr_capture": 30.0, "psnr_mixed": 30.0},
        {"name": "coarse", "frame_ms": 20.0, "psnr_capture": 40.0, "psnr_mixed": 40.0},
    ]
    monkeypatch.setattr(bundling, "describe_tiers", lambda draft, poses: described)
    monkeypatch.setattr(bundling.TIERS, "names", lambda: ["int8", "coarse"])
    manifest = export_front(runs["mlp and unet"], tmp_path / "a.gavatar")
    assert [tier["name"] for tier in manifest.tiers] == ["full", "baked", "coarse"]
    assert not {name for name in manifest.members if "int8" in name}
    for tier in ("full", "baked", "coarse"):
        assert len(PlayedAvatar(read_bundle(tmp_path / "a.gavatar", verify=True), tier=tier)) == manifest.gaussians
    assert export_front(runs["static"], tmp_path / "static.gavatar").tiers == []


def test_a_decoder_that_says_it_is_not_exported_is_one_sentence(runs, tmp_path, monkeypatch):
    run = runs["static"]
    monkeypatch.setattr(run.config, "decoder", run.config.decoder | {"anisotropic": True})
    with pytest.raises(UserError, match=r"its Gaussians are anisotropic.*train it without that option"):
        export(run, tmp_path / "a.gavatar")
    assert list(tmp_path.iterdir()) == []


def test_an_export_beyond_tolerance_is_refused_and_nothing_is_left(runs, tmp_path, monkeypatch):
    run = runs["mlp and unet"]
    wrong = ExportCheck(0.01, 0, 0, 1)
    monkeypatch.setattr(bundling, "verify", lambda *a: wrong)
    with pytest.raises(UserError, match=r"was not written.*10\.000 mm"):
        export(run, tmp_path / "a.gavatar")
    monkeypatch.setattr(bundling, "verify", lambda *a: ExportCheck(float("nan"), 0, 0, 1))
    with pytest.raises(UserError, match="was not written"):
        export(run, tmp_path / "a.gavatar")
    assert list(tmp_path.iterdir()) == []
