"""How plugins fill the registries, and what is said of those that fail."""

from __future__ import annotations

import sys
import warnings

import pytest
from plugin_sources import GOOD

from gavatar import registry as registries


def test_a_failing_plugin_is_reported_with_its_cause_and_the_rest_go_on(plugin_modules):
    plugin_modules({"p_raises": "1 / 0", "p_exits": "raise SystemExit(3)", "p_good": GOOD})
    with pytest.warns(UserWarning, match=r"p_(raises|exits) .* was skipped") as caught:
        failures = registries.load_plugins()
    assert {f.plugin.split()[0]: f.cause for f in failures} == {
        "p_raises": "ZeroDivisionError: division by zero",
        "p_exits": "SystemExit: 3",
    }
    assert len(caught) == 2
    assert "fine" in registries.DECODERS


def test_plugins_that_want_an_extra_share_one_warning_that_says_what_to_install(plugin_modules, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)  # as if not installed
    plugin_modules({"p_one": "import gsplat", "p_two": "from gsplat import rasterization", "p_good": GOOD})
    with pytest.warns(UserWarning, match=r"pip install 'gavatar\[gpu\]' brings them: p_one .*, p_two ") as caught:
        failures = registries.load_plugins()
    assert len(caught) == 1
    assert {f.extra for f in failures} == {"gpu"}
    assert all(f.cause == "needs gsplat: pip install 'gavatar[gpu]'" for f in failures)
    assert "fine" in registries.DECODERS


def test_a_plugin_that_lacks_its_own_dependency_is_not_blamed_on_an_extra(plugin_modules):
    plugin_modules({"p_needs": "import no_such_module_anywhere"})
    with pytest.warns(UserWarning, match="was skipped: ModuleNotFoundError"):
        (failure,) = registries.load_plugins()
    assert failure.extra == ""


def test_every_shipped_plugin_imports_with_the_training_extras():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert [f for f in registries.load_plugins() if f.extra in ("", "train")] == []
