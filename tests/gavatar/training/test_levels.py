"""How many points a level of training has, and where: a number or a side of the atlas, by the policy of the run."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from tiny_capture import SMALL, write_tiny_capture

from gavatar.assemble import build_configured
from gavatar.capture.opening import open_capture
from gavatar.config import check, compose_config
from gavatar.storage import load_tensors, save_tensors
from gavatar.training.run import open_run, train
from gavatar.training.trainer import Trainer
from gavatar_runtime.notes import Note
from gavatar_runtime.values.surface import Atlas

# the small setting without an encoder and its options
STATIC = [s for s in SMALL if not s.startswith("encoder")]
STATIC += ["encoder=none", "stage2.steps=0", "stage1.steps=2", "stage1.batch=1"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("levels") / "tiny")


def built(capture, *overrides):
    config = check(compose_config([f"capture={capture}", "out=x", *STATIC, *overrides]))
    return config, build_configured(config, open_capture(capture))


LEVELS = "stage1.levels=[{until:0.5,gaussians:500,image:0.125},{until:1.0,gaussians:1200,image:0.125}]"
SIDES = "stage1.levels=[{until:0.5,uv:64,image:0.125},{until:1.0,uv:72,image:0.125}]"


def test_a_coarse_level_is_a_prefix_of_the_finest(capture):
    config, made = built(capture, "points=detail", LEVELS, "stage2.levels=[{until:1.0,gaussians:900,image:0.125}]")
    coarse, fine = (made.surface(made.count(level)) for level in config.stage1.levels)
    assert (len(coarse), len(fine)) == (500, 1200)
    first = fine.rank < 500
    np.testing.assert_array_equal(coarse.points, fine.points[first])
    np.testing.assert_allclose(coarse.spacing, fine.spacing[first] * np.sqrt(1200 / 500), rtol=1e-6)
    assert made.surface(500) is coarse
    assert len(made.surface(3000)) == 3000  # more than it is trained with


def test_a_side_of_the_atlas_stands_for_the_number_of_its_texels(capture):
    config, made = built(capture, "points=even", SIDES)
    assert [made.count(level) for level in config.stage1.levels] == [len(made.atlas(64)), len(made.atlas(72))]
    surface = made.surface(made.count(config.stage1.levels[0]))
    assert not isinstance(surface, Atlas)
    with pytest.warns(Note, match=r"levels name sides of the atlas.*uv: 64 for gaussians: 2850, uv: 72 for"):
        Trainer(config, capture / "unused")


def test_on_the_atlas_each_level_has_the_texels_of_its_own(capture, recwarn):
    config, made = built(capture, "points=atlas", SIDES)
    for level in config.stage1.levels:
        surface = made.surface(made.count(level))
        assert isinstance(surface, Atlas)
        assert surface.resolution == level.uv
    Trainer(config, capture / "unused")
    assert not any("sides of the atlas" in str(note.message) for note in recwarn)


def test_a_run_opens_on_the_points_it_was_trained_with(capture, tmp_path):
    settings = [f"capture={capture}", f"out={tmp_path / 'run'}", *STATIC, "points=detail", LEVELS]
    trained = train(compose_config(settings), tmp_path / "run")
    opened = open_run(tmp_path / "run")
    np.testing.assert_array_equal(opened.avatar.surface.points, trained.scene.avatar.surface.points)
    assert len(opened.avatar.surface) == 1200


def test_a_run_from_before_there_were_policies_opens_on_its_atlas(capture, tmp_path):
    settings = [f"capture={capture}", f"out={tmp_path / 'run'}", *STATIC, "points=atlas", SIDES]
    train(compose_config(settings), tmp_path / "run")
    config = OmegaConf.load(tmp_path / "run" / "config.yaml")
    del config["points"]
    for stage in ("stage1", "stage2"):
        for level in config[stage].levels:
            level.uv = level.uv or 64
            del level["gaussians"]
    OmegaConf.save(config, tmp_path / "run" / "config.yaml")
    state = load_tensors(tmp_path / "run" / "stage1.pt")
    del state["gaussians"]
    save_tensors(tmp_path / "run" / "stage1.pt", state | {"uv": 72})
    surface = open_run(tmp_path / "run").avatar.surface
    assert isinstance(surface, Atlas)
    assert surface.resolution == 72
    assert torch.isfinite(open_run(tmp_path / "run").avatar.attributes().colors).all()
