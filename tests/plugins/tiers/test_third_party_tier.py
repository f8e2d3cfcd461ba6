"""A tier of another distribution is exported, measured and played like those that are shipped."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
from places import SUPPORT

from gavatar.export.bundling import export
from gavatar.registry import TIERS
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.tiers import PLAYER_TIERS, stored_tiers


@pytest.fixture
def grey(monkeypatch):
    """The modules of the documented example, imported as their entry points would be."""
    monkeypatch.syspath_prepend(str(SUPPORT / "plugin_example" / "src"))
    yield importlib.import_module("gavatar_tinydecoder.grey_builder")
    for registry in (TIERS, PLAYER_TIERS):
        registry.forget("grey")
    for module in [name for name in sys.modules if name.startswith("gavatar_tinydecoder")]:
        del sys.modules[module]


def test_a_tier_of_another_distribution_is_written_measured_and_played(grey, tiered_run, tmp_path):
    manifest = export(tiered_run, tmp_path / "a.gavatar", tiers=["grey"])
    described = {tier["name"]: tier for tier in manifest.tiers}
    assert list(described) == ["full", "grey"]
    assert described["grey"]["members"] == ["grey.npz"]
    assert described["grey"]["psnr_capture"] < described["full"]["psnr_capture"] == 100.0
    bundle = read_bundle(tmp_path / "a.gavatar", verify=True)
    assert stored_tiers(bundle) == ["full", "grey"]
    for count in (None, 500):
        gaussians = Avatar(bundle, tier="grey", gaussians=count).gaussians(np.zeros((52, 3), np.float32))
        assert len(np.unique(gaussians.colors)) == 1
        assert gaussians.scales.min() >= 0.01


def test_a_builder_whose_arrays_no_reader_knows_writes_nothing(grey, tiered_run, tmp_path, monkeypatch):
    monkeypatch.setattr(grey.GreyBuilder, "build", lambda self, source: {"grey.npz": grey.GREY.pack({"shad": 1.0})})
    with pytest.raises(ValueError, match=r"grey.npz: arrays \['shade'\] are missing, arrays \['shad'\] are unknown"):
        export(tiered_run, tmp_path / "a.gavatar", tiers=["grey"])
    assert list(tmp_path.iterdir()) == []


def test_a_bundle_with_a_tier_that_nobody_here_reads_plays_by_those_that_are_known(grey, tiered_run, tmp_path):
    export(tiered_run, tmp_path / "a.gavatar", tiers=["grey"])
    PLAYER_TIERS.forget("grey")
    bundle = read_bundle(tmp_path / "a.gavatar")
    assert len(Avatar(bundle)) == bundle.manifest.gaussians
    with pytest.raises(UserError, match="unknown tier 'grey'"):
        Avatar(bundle, tier="grey")
