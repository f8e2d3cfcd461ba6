"""What shows through an avatar is measured from where nobody filmed, and decides how small its Gaussians may be."""

from __future__ import annotations

import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import LevelConfig, check, compose_config
from gavatar.storage import load_tensors
from gavatar.training.remedies.see_through import FLOORS, least_floor, see_through
from gavatar.training.trainer import Trainer

IMAGE = 0.5


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


@pytest.fixture
def trainer(capture, tmp_path):
    def made(*overrides):
        trainer = Trainer(check(compose_config([f"capture={capture}", "out=x", *SMALL, *overrides])), tmp_path / "run")
        trainer.scene.place(LevelConfig(gaussians=2850))
        return trainer

    return made


def shrunk(trainer):
    """Every Gaussian as small as the floor allows."""
    torch.nn.init.constant_(trainer.scene.avatar.decoder.heads["scale"][2].bias, -100)
    return trainer


def test_specks_are_seen_through_and_larger_gaussians_close_them(trainer):
    scene = shrunk(trainer("decoder.scale_floor=auto")).scene
    scene.avatar.decoder.floor.fill_(0)
    shares = see_through(scene, IMAGE, [0.0, *FLOORS])
    assert shares[0] > 0.05  # a lattice of dots
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] < 0.2 * shares[0]


def test_an_avatar_that_is_closed_keeps_its_gaussians(trainer):
    made = trainer("decoder.scale_floor=auto")  # at the start, with 0.8 of the spacing
    assert see_through(made.scene, IMAGE, [0.2])[0] <= 0.003
    stage = made.stage(1)
    stage.chooser.floor(IMAGE)
    assert float(made.scene.avatar.decoder.floor) == pytest.approx(0.2)
    assert stage.chooser.choices["decoder.scale_floor"].value == 0.2
    assert "left as it is" in stage.chooser.paragraph


def test_the_floor_is_chosen_once_told_and_kept_with_the_avatar(trainer, tmp_path):
    made = shrunk(trainer("decoder.scale_floor=auto"))
    stage, decoder = made.stage(1), made.scene.avatar.decoder
    stage.chooser.floor(IMAGE)
    choice = stage.chooser.choices["decoder.scale_floor"]
    assert float(decoder.floor) == pytest.approx(choice.value)  # a float32
    assert choice.value in FLOORS[1:]
    assert "see-through from elsewhere: points no smaller than" in stage.chooser.paragraph
    decoder.floor.fill_(0.1)
    stage.chooser.floor(IMAGE)
    assert float(decoder.floor) == pytest.approx(0.1)
    stage.save(0)
    state = load_tensors(tmp_path / "run/checkpoint.pt")["avatar"]
    assert float(state["decoder.floor"]) == pytest.approx(0.1)
    state.pop("decoder.floor")  # as earlier versions wrote it
    made.scene.avatar.load_state_dict(state)
    assert float(decoder.floor) == 0  # their default


def test_a_floor_that_was_given_stays(trainer):
    made = shrunk(trainer("decoder.scale_floor=0.3"))
    stage = made.stage(1)
    stage.chooser.floor(IMAGE)
    assert float(made.scene.avatar.decoder.floor) == pytest.approx(0.3)
    assert "decoder.scale_floor" not in stage.chooser.choices


def test_the_smallest_floor_that_closes_is_taken():
    assert least_floor([0.001, 0.0, 0.0], [0.0, 0.2, 0.3]) == 0.0
    assert least_floor([0.1, 0.003, 0.0], [0.0, 0.2, 0.3]) == 0.2
    assert least_floor([0.1, 0.1, 0.1], [0.0, 0.2, 0.3]) == 0.3
