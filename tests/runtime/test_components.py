"""A registry of named components: options, names, what they can."""

from __future__ import annotations

import dataclasses
import warnings

import pytest

from gavatar_runtime.components import NoOptions, Registry
from gavatar_runtime.errors import UserError


@dataclasses.dataclass
class Options:
    """width: how wide. names: of what."""

    width: int = 64
    names: list[str] = dataclasses.field(default_factory=lambda: ["a"])


@pytest.fixture
def decoders() -> Registry:
    registry = Registry("decoder")

    @registry.register("mlp", config=Options)
    def build_mlp(options, *, channels):
        """Builds nothing."""
        return options, channels

    registry.register("upstream", summary="another")(lambda options: None)
    return registry


def test_the_options_given_are_filled_and_the_rest_keeps_its_defaults(decoders):
    options, channels = decoders.build("mlp", {"name": "mlp", "width": 8}, channels=3)
    assert (options, channels) == (Options(width=8), 3)
    assert decoders.options("mlp", None).names is not decoders.options("mlp", None).names


def test_an_unknown_name_lists_the_choices_and_the_nearest(decoders):
    with pytest.raises(UserError, match=r"unknown decoder 'mpl': choose from: mlp, upstream; did you mean 'mlp'\?"):
        decoders["mpl"]
    with pytest.raises(UserError, match=r"choose from: mlp, upstream$"):
        decoders["zzzz"]
    with pytest.raises(UserError, match=r"choose from: \(none\)"):
        Registry("encoder")["none"]


def test_an_unknown_option_lists_the_choices_and_the_nearest(decoders):
    with pytest.raises(UserError, match=r"decoder 'mlp' has no option 'widht': .* did you mean 'width'\?"):
        decoders.options("mlp", {"widht": 3})
    with pytest.raises(UserError, match=r"decoder 'upstream' has no option 'width': choose from: \(none\)"):
        decoders.options("upstream", {"width": 3})


def test_a_name_taken_by_another_module_is_replaced_with_a_warning(decoders):
    def other(options):
        return "other"

    other.__module__ = "elsewhere.plugin"
    with pytest.warns(UserWarning, match="decoder 'mlp' of .* is replaced by elsewhere.plugin"):
        decoders.register("mlp")(other)
    assert decoders.build("mlp") == "other"
    assert decoders.names() == ["mlp", "upstream"]


def test_a_module_may_register_its_own_name_again_silently(decoders):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        decoders.register("mlp")(decoders["mlp"].factory)


@pytest.mark.parametrize("config", [dict, {"width": 3}, None])
def test_options_must_be_a_dataclass(decoders, config):
    with pytest.raises(TypeError, match="decoder 'bad': config must be a dataclass"):
        decoders.register("bad", config=config)


def test_the_summary_falls_back_to_the_first_line_of_the_docstring(decoders):
    assert decoders["mlp"].summary == "Builds nothing."
    assert [c.name for c in decoders] == ["mlp", "upstream"]
    assert "mlp" in decoders
    assert "none" not in decoders


# What components can


@dataclasses.dataclass(frozen=True)
class Traits:
    """exact: as it says. share: as it says."""

    exact: bool = True
    share: float = 1.0


@dataclasses.dataclass
class Draft:
    """share: of the whole."""

    share: float = 0.5


@dataclasses.dataclass
class Owed:
    """path: which the user owes."""

    path: str


@pytest.fixture
def drawers() -> Registry:
    registry = Registry("drawer", Traits)
    registry.register("whole", default=True)(lambda options: "whole")
    registry.register("rough", traits=Traits(exact=False))(lambda options: "rough")
    registry.register("draft", config=Draft, traits=lambda o: Traits(share=o.share))(lambda options: "draft")
    registry.register("owed", config=Owed, traits=lambda o: Traits(exact=False))(lambda options: "owed")
    return registry


def test_a_component_that_says_nothing_has_the_traits_of_its_registry(drawers):
    assert drawers.traits("whole") == Traits()
    assert drawers.traits("rough") == Traits(exact=False)


def test_traits_follow_from_the_options(drawers):
    assert drawers.traits("draft").share == 0.5
    assert drawers.traits("draft", {"name": "draft", "share": 0.25}).share == 0.25
    with pytest.raises(UserError, match="has no option 'shar'"):
        drawers.traits("draft", {"shar": 0.25})


def test_components_are_found_by_what_they_can_with_the_defaults_of_their_options(drawers):
    assert drawers.having(exact=True) == ["draft", "whole"]
    assert drawers.having(exact=True, share=0.5) == ["draft"]
    assert drawers.having(exact=False) == ["rough"]  # what `owed` can hangs on an option that nobody gave
    assert drawers["owed"].default_traits is None
    assert drawers.having(exact=False, share=7.0) == []


@pytest.mark.parametrize("traits", [NoOptions(), {"exact": False}, "exact"])
def test_traits_of_another_kind_are_the_plugins_mistake(drawers, traits):
    with pytest.raises(TypeError, match="drawer 'bad': traits must be Traits"):
        drawers.register("bad", traits=traits)


def test_a_registry_has_one_default_or_none(drawers, decoders):
    assert drawers.default == "whole"
    with pytest.raises(ValueError, match="drawer 'other' cannot be the default: that is 'whole'"):
        drawers.register("other", default=True)
    assert "other" not in drawers
    drawers.register("whole", default=True)(drawers["whole"].factory)  # a module that is loaded again
    with pytest.raises(UserError, match="no decoder is the default: name one, choose from: mlp, upstream"):
        _ = decoders.default


def test_what_is_forgotten_is_no_longer_there(drawers):
    for name in ("whole", "whole", "rough"):
        drawers.forget(name)
    assert drawers.names() == ["draft", "owed"]
    drawers.register("draft", config=Draft, default=True)(lambda options: "draft")
    assert drawers.default == "draft"
