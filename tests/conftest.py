"""Fixtures that tests of several rooms share: a hardly trained avatar whose look depends on the pose, its bundles, and
plugins that come and go.

What they need is imported when they are asked for, so that tests of the player alone load no torch.
"""

from __future__ import annotations

import importlib.metadata
import sys
import textwrap
from pathlib import Path

import pytest
from made_once import made_once


@pytest.fixture(scope="session")
def tiered_run(tmp_path_factory):
    """A `Run` of a few steps."""
    import torch
    from tiny_capture import SMALL, write_tiny_capture

    from gavatar.config import compose_config, register_configs
    from gavatar.training.run import open_run, train

    def make(folder: Path) -> None:
        capture = write_tiny_capture(folder / "tiny")
        train(compose_config([f"capture={capture}", f"out={folder / 'run'}", *SMALL]), folder / "run")

    folder = made_once(tmp_path_factory, "tiered_run", make)
    register_configs()
    run = open_run(folder / "run")
    # a few steps leave the encoder near its zero start: give the pose something to do
    torch.manual_seed(0)
    with torch.no_grad():
        run.avatar.encoder.up[-1][1].weight.normal_(0, 0.05)
    return run


@pytest.fixture(scope="session")
def tiered_bundle(tiered_run, tmp_path_factory):
    """Its bundle with every tier."""
    from gavatar.export.bundling import export
    from gavatar.registry import TIERS
    from gavatar_runtime.bundle import read_bundle

    def make(folder: Path) -> None:
        export(tiered_run, folder / "a.gavatar", tiers=TIERS.names())

    return read_bundle(made_once(tmp_path_factory, "tiered_bundle", make) / "a.gavatar", verify=True)


@pytest.fixture(scope="session")
def fine_bundle(tiered_run, tmp_path_factory):
    """The same avatar with more Gaussians than the smallest level of detail."""
    from gavatar.export.bundling import export
    from gavatar_runtime.bundle import read_bundle

    def make(folder: Path) -> None:
        export(tiered_run, folder / "fine.gavatar", gaussians=6000, tiers=["int8", "blendshape"])

    return read_bundle(made_once(tmp_path_factory, "fine_bundle", make) / "fine.gavatar")


@pytest.fixture
def plugin_modules(tmp_path, monkeypatch):
    """Write modules into an importable folder and announce them as entry points: {module: source}."""
    from gavatar import registry as registries

    def install(sources: dict[str, str]) -> None:
        for name, source in sources.items():
            (tmp_path / f"{name}.py").write_text(textwrap.dedent(source))
        points = [importlib.metadata.EntryPoint(name, name, registries.ENTRY_POINT_GROUP) for name in sources]
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: points)

    monkeypatch.syspath_prepend(str(tmp_path))
    registries.load_plugins()  # the real ones, so that only what `install` adds is new
    monkeypatch.setattr(registries, "PLUGIN_ROOMS", ())
    registries.load_plugins.cache_clear()
    before = {registry: registry.names() for registry in registries.REGISTRIES}
    yield install
    for registry, names in before.items():
        for added in set(registry.names()) - set(names):
            registry.forget(added)
    registries.load_plugins.cache_clear()
    for name in [n for n, m in sys.modules.items() if str(getattr(m, "__file__", "")).startswith(str(tmp_path))]:
        del sys.modules[name]
