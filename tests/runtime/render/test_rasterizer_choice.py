"""Which rasterizer is built, and with which of the options that are given."""

from __future__ import annotations

import dataclasses

import pytest

from gavatar_runtime.components import Registry
from gavatar_runtime.errors import UserError
from gavatar_runtime.render import rasterizers
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.render.rasterizers import RasterizerTraits


def test_a_rasterizer_that_takes_threads_is_given_them_and_others_are_not(monkeypatch):
    registry = Registry("rasterizer", RasterizerTraits)

    @dataclasses.dataclass
    class WithThreads:
        threads: int = 0

    @registry.register("native", config=WithThreads, missing=lambda: "not built", traits=RasterizerTraits(preference=2))
    class Absent:
        def __init__(self, config):
            raise UserError("the native kernel is not built")

    @registry.register("many", config=WithThreads)
    class Many:
        def __init__(self, config):
            self.threads = config.threads

    @registry.register("numpy", traits=RasterizerTraits(preference=1))
    class Plain:
        def __init__(self, config):
            pass

    monkeypatch.setattr(rasterizers, "PLAYER_RASTERIZERS", registry)
    assert build_rasterizer("many", threads=3).threads == 3
    assert build_rasterizer("many", {"threads": 2}, threads=3).threads == 2
    assert isinstance(build_rasterizer("numpy", threads=3), Plain)
    assert build_rasterizer("many", trained={"threads": 4, "fast": True}).threads == 4  # of a manifest: what it knows
    assert build_rasterizer("many", {"threads": 2}, trained={"threads": 4}).threads == 2
    assert isinstance(build_rasterizer("auto"), Plain)
    with pytest.raises(UserError, match="not built"):
        build_rasterizer("native")
