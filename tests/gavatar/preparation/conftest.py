"""What tests of preparing footage share."""

from __future__ import annotations

import pytest

from gavatar.preparation.fit import FitOptions


@pytest.fixture
def few_steps(monkeypatch):
    """A fit of a few steps: enough to see that everything is written."""
    monkeypatch.setattr(FitOptions.__init__, "__defaults__", ((5, 5, 5), *FitOptions.__init__.__defaults__[1:]))
