"""The ablation's runs differ in what they are to differ in alone; benchmarks fit the code that they measure."""

from __future__ import annotations

import ast
import importlib.util
import json
import sys

import numpy as np
import pytest
import torch
from places import ROOT
from tiny_capture import write_tiny_capture

from gavatar.capture.opening import open_capture
from gavatar.config import check, compose_config
from gavatar.registry import DECODERS, load_plugins
from gavatar_runtime.errors import UserError

BENCHMARKS = ROOT / "benchmarks"


def script(name):
    spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)  # where dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def ablation():
    return script("ablation")


def configuration(ablation, preset, kind, *extra):
    args = ablation.arguments(["capture", "--gaussians", "10726", "--image", "0.5", "--steps", "110/40", *extra])
    return check(compose_config(ablation.overrides(args, preset, kind, "3")))


@pytest.mark.parametrize("preset", ["paper", "upstream", "default"])
def test_every_preset_has_the_same_budget(ablation, preset):
    base, full, control = (configuration(ablation, preset, kind) for kind in ("baseline", "avatar", "control"))
    assert [(c.stage1.steps, c.stage2.steps) for c in (base, full, control)] == [(110, 0), (110, 40), (150, 0)]
    assert [c.motion.enabled for c in (base, full, control)] == [False, True, True]
    assert {c.seed for c in (base, full, control)} == {3}
    for config in (base, full, control):
        assert (config.stage1.levels[-1].gaussians, config.stage1.levels[-1].image) == (10726, 0.5)
        assert config.losses == full.losses


def test_the_warm_up_of_upstream_keeps_its_share_of_the_steps(ablation):
    assert configuration(ablation, "upstream", "avatar").decoder["scale_warmup"] == 10  # 1000 of 11,000


def test_overrides_reach_every_run(ablation):
    assert configuration(ablation, "default", "baseline", "decoder.scale_limit=2").decoder["scale_limit"] == 2


def test_runs_of_two_captures_share_a_folder_without_meeting(ablation):
    places = {
        ablation.run_directory(ablation.arguments([capture]), "demo", "avatar", "0")
        for capture in ("captures/anna", "captures/bob")
    }
    assert len(places) == 2


def test_a_run_of_the_same_settings_is_not_made_again(ablation, tmp_path, monkeypatch):
    def arguments(*extra):
        return ablation.arguments(["capture", "--out", str(tmp_path), "--steps", "110/40", *extra])

    job = ("default", "avatar", "3")
    assert ablation.finished_rows(arguments(), *job) is None
    known = {"settings": ablation.settings(arguments(), *job), "rows": [{"psnr": 30.0}]}
    folder = ablation.run_directory(arguments(), *job)
    folder.mkdir(parents=True)
    (folder / "rows.json").write_text(json.dumps(known))
    assert ablation.finished_rows(arguments(), *job) == known["rows"]
    monkeypatch.setattr(ablation.subprocess, "run", lambda *a, **k: pytest.fail("made again"))
    assert ablation.launch(arguments(), [], job, 0.0) is None
    for other in (["--every", "2"], ["--fit", "3"], ["decoder.scale_limit=2"], ["--image", "0.5"]):
        assert ablation.finished_rows(arguments(*other), *job) is None
    (folder / "rows.json").write_text("[]")
    assert ablation.finished_rows(arguments(), *job) is None
    assert "not started" in ablation.launch(arguments(), [], job, 0.0)


def test_a_resized_capture_is_smaller_and_otherwise_the_same(tmp_path):
    capture = open_capture(write_tiny_capture(tmp_path / "tiny"))
    half = capture.resized(0.5)
    view = capture.views("test")[0]
    (color, alpha), (small, small_alpha) = capture.load(view), half.load(view)
    assert small.shape == (color.shape[0] // 2, color.shape[1] // 2, 3)
    means = color.reshape(len(small), 2, -1, 2, 3).mean((1, 3)), alpha.reshape(len(small), 2, -1, 2).mean((1, 3))
    for got, expected in zip((small, small_alpha), means, strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-6)  # sums of four float32 in another order
    assert half.cameras["cam0"].width == capture.cameras["cam0"].width // 2
    assert half.splits == capture.splits
    view = half.views("train")[0]
    for a, b in zip(half.read(view), half.load(view), strict=True):
        assert a.shape == b.shape


def test_no_gaussian_is_smaller_than_the_floor():
    load_plugins()
    decoder = DECODERS.build("mlp", {"scale_floor": 0.4}, in_channels=4)
    torch.nn.init.constant_(decoder.heads["scale"][2].bias, -100)
    spacing = torch.tensor([0.001, 0.02])
    scales = decoder(torch.zeros(2, 4), torch.zeros(2, 2), spacing).scales
    torch.testing.assert_close(scales, 0.4 * spacing)


@pytest.mark.parametrize("options", [{"scale_floor": 0.9}, {"scale_floor": -0.1}, {"scale_init": 3.0}])
def test_scale_bounds_out_of_order_are_refused(options):
    load_plugins()
    with pytest.raises(UserError, match="scale_floor < scale_init < scale_limit"):
        DECODERS.build("mlp", options, in_channels=4)


def test_the_studies_of_appearance_compose_and_its_u_nets_differ_in_their_norm_alone():
    encoders = []
    for study, variants in script("appearance").STUDIES().items():
        for variant in variants:
            config = check(compose_config(["capture=x", "experiment=demo", *variant.overrides]))
            if study == "batchnorm" and config.stage2.steps:
                encoders.append(dict(config.encoder))
    assert {encoder.pop("norm") for encoder in encoders} == {"group", "batch"}
    assert all(encoder == encoders[0] and encoder["name"] == "unet" for encoder in encoders)


@pytest.mark.parametrize(
    "path", [*BENCHMARKS.glob("*.py"), *BENCHMARKS.parent.glob("tools/*.py")], ids=lambda p: p.stem
)
def test_what_benchmarks_and_tools_import_from_us_is_there(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("gavatar"):
            module = importlib.import_module(node.module)
            for name in node.names:
                assert hasattr(module, name.name) or importlib.util.find_spec(f"{node.module}.{name.name}"), name.name
