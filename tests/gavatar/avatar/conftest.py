"""What tests of the avatar share."""

from __future__ import annotations

import pytest


@pytest.fixture
def own_cache(tmp_path_factory, monkeypatch):
    """Tests share one temporary cache and never touch the user's."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
