"""The player has no driver of its own, and says what brings one."""

from __future__ import annotations

import subprocess
import sys

import pytest
from live_people import Told

from gavatar_runtime.components import NoOptions, Registry
from gavatar_runtime.errors import UserError
from gavatar_runtime.live import drivers
from gavatar_runtime.live.drivers import Driver, build_driver, why_not
from gavatar_runtime.live.sources import source_to_drive


@pytest.fixture
def none(monkeypatch):
    """An installation without drivers."""
    registry = Registry("driver", base=Driver)
    monkeypatch.setattr(drivers, "DRIVERS", registry)
    monkeypatch.setattr(drivers, "load_entry_points", lambda group: None)
    return registry


def test_without_a_driver_one_sentence_says_what_to_install(none):
    assert "pip install 'gavatar[train]'" in why_not()
    for refused in (build_driver, lambda: source_to_drive("0")):
        with pytest.raises(UserError) as caught:
            refused()
        assert str(caught.value) == why_not()
        assert "\n" not in why_not()


def test_a_driver_that_lacks_something_says_what(none):
    none.register("told", missing=lambda: "it needs a crystal ball", default=True)(type("T", (Told,), {}))
    assert why_not() == "it needs a crystal ball"
    with pytest.raises(UserError, match="crystal"):
        build_driver()


def test_a_driver_of_another_package(none):
    @none.register("told", default=True)
    class Other(Told):
        def __init__(self, config: NoOptions):
            super().__init__()

    assert why_not() == ""
    assert isinstance(build_driver(), Other)


def test_the_shipped_one_is_found_by_its_entry_point():
    pytest.importorskip("cv2", reason="the driver needs OpenCV")
    import importlib.metadata

    points = importlib.metadata.entry_points(group=drivers.ENTRY_POINT_GROUP)
    assert "landmarks" in {point.name for point in points}, "install the package again: it has a new entry point"
    assert why_not() == ""
    assert "landmarks" in drivers.DRIVERS


def test_the_shipped_one_needs_no_torch_and_takes_its_camera_as_it_is_told():
    pytest.importorskip("cv2", reason="the driver needs OpenCV")
    code = (
        "import sys\nfrom gavatar_runtime.live.drivers import build_driver\ndriver = build_driver({'fov': 65})\n"
        "assert not {'torch', 'hydra'} & set(sys.modules)\nassert driver._person.fit.fov == 65\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    with pytest.raises(UserError, match="fov=200"):
        build_driver({"fov": 200})
    with pytest.raises(UserError, match="fow"):
        build_driver({"fow": 60})
