"""How components reach Hydra: every one composes by name, its options typed and checked."""

from __future__ import annotations

import dataclasses

import pytest

from gavatar import registry as registries
from gavatar.config import check, compose_config


@dataclasses.dataclass
class Options:
    """width: how wide. names: of what."""

    width: int = 64
    names: list[str] = dataclasses.field(default_factory=lambda: ["a"])


@dataclasses.dataclass(frozen=True)
class FrozenOptions:
    """A frozen dataclass, one field of which the user owes."""

    path: str
    width: int = 4


def compose(*overrides):
    hydra = pytest.importorskip("hydra")
    store = pytest.importorskip("hydra.core.config_store").ConfigStore.instance()
    defaults = ["_self_"] + [{r.group: r.names()[0]} for r in (registries.DECODERS, registries.ENCODERS)]
    store.store(name="registry_test", node={"defaults": defaults, "decoder": {}, "encoder": {}})
    registries.fill_config_store()
    with hydra.initialize(version_base="1.3", config_path=None):
        return hydra.compose("registry_test", overrides=list(overrides))


def test_every_component_composes_by_name_with_its_defaults():
    registries.load_plugins()
    for registry in (registries.DECODERS, registries.ENCODERS):
        for component in registry:
            node = compose(f"{registry.group}={component.name}")[registry.group]
            assert node.name == component.name
            assert set(node) == {"name"} | {f.name for f in dataclasses.fields(component.config)}


def test_an_override_of_an_option_is_typed_and_checked(plugin_modules):
    registries.DECODERS.register("typed", config=Options)(lambda options: options)
    node = compose("decoder=typed", "decoder.width=8", "decoder.names=[x,y]").decoder
    assert registries.DECODERS.build("typed", node) == Options(8, ["x", "y"])
    for wrong in ("decoder.width=wide", "decoder.widht=8"):
        with pytest.raises(Exception, match=r"widht|width"):
            compose("decoder=typed", wrong)


def test_frozen_options_and_options_without_default_compose(plugin_modules):
    from omegaconf import OmegaConf

    registries.DECODERS.register("frozen", config=FrozenOptions)(lambda options: options)
    assert OmegaConf.is_missing(compose("decoder=frozen").decoder, "path")
    node = compose("decoder=frozen", "decoder.path=here", "decoder.width=5").decoder
    assert registries.DECODERS.build("frozen", node) == FrozenOptions("here", 5)


def test_options_that_hydra_cannot_hold_are_named_and_the_rest_go_on(plugin_modules):
    @dataclasses.dataclass
    class Odd:
        value: complex = 1j

    registries.DECODERS.register("odd", config=Odd)(lambda options: options)
    with pytest.warns(UserWarning, match="decoder 'odd' cannot be configured"):
        node = compose("decoder=mlp").decoder
    assert node.name == "mlp"


@pytest.mark.parametrize("preset", ["default", "demo", "paper", "upstream"])
def test_every_preset_takes_every_encoder_and_decoder(preset):
    registries.load_plugins()
    for registry in (registries.ENCODERS, registries.DECODERS):
        for name in registry.names():
            config = check(compose_config(["capture=x", f"experiment={preset}", f"{registry.group}={name}"]))
            assert getattr(config, registry.group)["name"] == name
