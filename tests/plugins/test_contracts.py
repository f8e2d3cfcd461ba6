"""Every registered component keeps to the contract of its group, and what it says of itself is true."""

from __future__ import annotations

import dataclasses
import re

import pytest
import torch
from loss_inputs import motion
from tiny_capture import demo

from gavatar.assemble import build_avatar
from gavatar.avatar.trainable import AvatarConfig
from gavatar.capture.opening import open_capture
from gavatar.losses import LossInputs, judging_poses
from gavatar.registry import (
    BODIES,
    CAPTURES,
    DECODERS,
    ENCODERS,
    LOSSES,
    RASTERIZERS,
    REGISTRIES,
    TIERS,
    load_plugins,
    resolve,
)
from gavatar_runtime.errors import UserError
from gavatar_runtime.tiers import player_tiers

load_plugins()


@pytest.mark.parametrize("registry", REGISTRIES, ids=lambda registry: registry.group)
def test_every_component_says_what_it_can_with_its_defaults(registry):
    for component in registry:
        assert isinstance(component.default_traits, type(registry.usual_traits)), component.name


def test_the_configuration_names_the_defaults_of_its_groups():
    """conf/train.yaml, which Hydra composes, and the registries, which the library asks, say the same."""
    from gavatar.config import compose_config

    composed = compose_config(["capture=x"])
    for registry in (BODIES, CAPTURES, RASTERIZERS):
        assert composed[registry.group].name == registry.default


@pytest.mark.parametrize("name", CAPTURES.names())
def test_a_reader_is_known_by_its_signs_or_chooses_among_those_that_are(name, tmp_path):
    reader = CAPTURES[name].factory
    assert bool(reader.signs) != CAPTURES.traits(name).chooses
    assert reader.recognises(tmp_path) is False  # nothing is in it
    with pytest.raises(UserError):
        CAPTURES.build(name).read(tmp_path)


def test_what_stands_for_others_is_resolved_and_what_does_not_stays(tmp_path):
    (tmp_path / "capture.json").touch()
    assert resolve(CAPTURES, {"name": "auto"}, tmp_path) == {"name": "gavatar"}
    node = {"name": "zju", "step": 2}
    assert resolve(CAPTURES, node, tmp_path) is node
    with pytest.raises(UserError, match="capture_format 'zju' has no option 'stp'"):
        open_capture(tmp_path, {"name": "zju", "stp": 2})


@pytest.mark.parametrize("name", BODIES.having(shipped=True))
def test_a_shipped_body_needs_no_files_and_has_a_licence(name):
    body = BODIES.build(name)
    assert body.data.num_joints > 0
    assert body.license
    assert BODIES[name].needs == ""


@pytest.mark.parametrize("name", TIERS.names())
def test_a_tier_is_built_and_played_under_one_name(name):
    player = player_tiers()[name].factory
    assert TIERS[name].default == player_tiers()[name].default
    for needed in TIERS[name].factory.needs:
        assert set(player_tiers()[needed].factory.members) <= set(player.members)


def test_a_static_encoder_is_no_network_and_any_other_is_one():
    for component in ENCODERS:
        built = ENCODERS.build(component.name, channels=4, map_size=None)
        assert (built is None) == component.default_traits.static, component.name


def test_an_encoder_declares_its_inputs_with_their_shapes_by_its_options():
    assert ENCODERS.traits("unet").inputs == {"positional_map": (3, "M", "M")}
    assert list(ENCODERS.traits("linear", {"order": 0}).inputs) == ["joint_rotations"]
    assert ENCODERS.traits("linear").inputs == {"normal_map": (3, "M", "M"), "joint_rotations": (22, 3, 3)}


@pytest.mark.parametrize(
    ("registry", "members", "traits"),
    [
        (DECODERS, {"on_step": lambda self, step: None}, "DecoderTraits(counts_steps=...)"),
        (DECODERS, {"mixed_precision": True}, "DecoderTraits(mixed_precision=...)"),
        (ENCODERS, {"prepare": lambda self, *given: None}, "EncoderTraits(prepares=...)"),
        (ENCODERS, {"inputs": ("normal_map",)}, "EncoderTraits(inputs=...)"),
    ],
)
def test_what_a_network_has_and_does_not_declare_is_refused(registry, members, traits):
    made = type("Made", (torch.nn.Module,), {"__init__": lambda self, *a, **b: super(made, self).__init__(), **members})
    registry.register("silent")(made)
    names = {"encoder": "none", "decoder": "mlp"} | {registry.group: "silent"}
    try:
        with pytest.raises(UserError, match=re.escape(traits)):
            build_avatar(
                {"name": "free"}, {"name": names["encoder"]}, {"name": names["decoder"]},
                AvatarConfig(), open_capture(demo()), 0,
            )  # fmt: skip
    finally:
        registry.forget("silent")


def test_decoders_are_exported_unless_an_option_forbids_it():
    for component in DECODERS:
        assert component.default_traits.not_exported == ""
    assert "decoder.anisotropic=true" in DECODERS.traits("mlp", {"anisotropic": True}).not_exported


def test_a_rasterizer_that_compensates_does_not_widen_and_its_switches_are_kept():
    traits = RASTERIZERS.traits("native", {"antialiased": True, "backface": 0.2, "resolution": 0.5, "threads": 1})
    assert not traits.widens
    assert traits.resolution == 0.5
    assert traits.played_with == {"antialiased": True, "backface": 0.2}
    assert RASTERIZERS.traits("native").widens
    assert RASTERIZERS.traits("native").played_with == {}


def test_losses_that_judge_poses_can_do_so_from_images_and_motion_alone():
    torch.manual_seed(0)
    image, mask = torch.full((1, 3, 16, 16), 0.5), torch.ones(1, 16, 16)
    inputs = LossInputs(
        render=image, target=image * 0.9, alpha=mask, mask=mask, motion=motion(torch.randn(5, 22, 3) * 0.1)
    )
    chosen = judging_poses({name: {} for name in LOSSES.names()})
    assert set(chosen) == set(LOSSES.having(judges_poses=True))
    values = {name: LOSSES.build(name)(inputs) for name in chosen}
    assert any(value is not None and float(value) > 0 for value in values.values())


def test_losses_of_a_composed_configuration_keep_their_weights_when_they_are_chosen():
    losses = {"l1": 0.8, "feature": 1.0, "mask": {"weight": 0.1, "norm": "l2"}, "scale": None}
    assert judging_poses(losses) == {"l1": 0.8, "mask": {"weight": 0.1, "norm": "l2"}, "scale": None}
    with pytest.raises(UserError, match="unknown loss 'l2'"):
        judging_poses({"l2": 1.0})


def test_options_of_every_component_are_a_dataclass_with_a_docstring():
    for registry in REGISTRIES:
        for component in registry:
            assert dataclasses.is_dataclass(component.config)
            if dataclasses.fields(component.config):
                assert component.config.__doc__, f"{registry.group} {component.name}"
