"""Which rasterizer draws, and which options it is given."""

from __future__ import annotations

import dataclasses

import pytest

from gavatar_runtime.components import Registry
from gavatar_runtime.errors import UserError
from gavatar_runtime.render import rasterizers
from gavatar_runtime.render.choice import best_rasterizer, build_rasterizer, player_rasterizers
from gavatar_runtime.render.rasterizers import RasterizerTraits


@dataclasses.dataclass
class WithThreads:
    threads: int = 0


class Configured:
    def __init__(self, config):
        self.config = config


@pytest.fixture
def registry(monkeypatch) -> Registry:
    """In place of the player's: `many` takes threads and is preferred, `plain` takes nothing."""
    made = Registry("rasterizer", RasterizerTraits)
    made.register("many", config=WithThreads, traits=RasterizerTraits(preference=2))(type("Many", (Configured,), {}))
    made.register("plain", traits=RasterizerTraits(preference=1))(type("Plain", (Configured,), {}))
    monkeypatch.setattr(rasterizers, "PLAYER_RASTERIZERS", made)
    return made


@pytest.mark.usefixtures("registry")
def test_a_rasterizer_that_takes_threads_is_given_them_and_others_are_not():
    assert build_rasterizer("many", threads=3).config.threads == 3
    assert build_rasterizer("many", {"threads": 2}, threads=3).config.threads == 2
    assert type(build_rasterizer("plain", threads=3)).__name__ == "Plain"


@pytest.mark.usefixtures("registry")
def test_of_the_switches_in_a_manifest_it_is_given_those_that_it_knows():
    assert build_rasterizer("many", trained={"threads": 4, "fast": True}).config.threads == 4
    assert build_rasterizer("many", {"threads": 2}, trained={"threads": 4}).config.threads == 2
    with pytest.raises(UserError, match="rasterizer 'many' has no option 'fast'"):
        build_rasterizer("many", {"fast": True})


def test_auto_is_the_preferred_of_those_that_can_be_had(registry):
    assert type(build_rasterizer()).__name__ == "Many"
    registry.register(
        "best", missing=lambda: "no compiler", traits=RasterizerTraits(preference=9)
    )(type("Best", (Configured,), {}))  # fmt: skip
    assert best_rasterizer() == "many"
    registry.register("unwilling")(type("Unwilling", (Configured,), {}))
    assert best_rasterizer() == "many"


@pytest.mark.parametrize("name", ["native", "numpy"])
def test_every_rasterizer_of_the_player_keeps_the_contract(name):
    assert name in player_rasterizers()
    try:
        built = build_rasterizer(name)
    except UserError as error:
        pytest.skip(str(error))
    assert isinstance(built.wants_normals, bool)
    assert built.stage_seconds == {}
