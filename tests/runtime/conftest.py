"""What tests of playing share: two small bundles, a stand-in for a rasterizer, machines without video encoders."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from dots import Dots

from gavatar_runtime import native_library as nl
from gavatar_runtime.render.rasterizers import PLAYER_RASTERIZERS


def _bundle(folder: Path, **options: bool) -> Path:
    pytest.importorskip("onnx", reason="the hand-made networks need onnx")
    from make_bundle import make_bundle

    return make_bundle(folder / "tester.gavatar", **options)


@pytest.fixture(scope="session")
def static(tmp_path_factory) -> Path:
    """A bundle whose look is constant."""
    return _bundle(tmp_path_factory.mktemp("static"))


@pytest.fixture(scope="session")
def dynamic(tmp_path_factory) -> Path:
    """A bundle whose look depends on the pose."""
    return _bundle(tmp_path_factory.mktemp("dynamic"), dynamic=True)


@pytest.fixture
def dots() -> Iterator[None]:
    """The stand-in is registered as `dots` for the length of a test."""
    PLAYER_RASTERIZERS.register("dots")(Dots)
    yield
    PLAYER_RASTERIZERS.forget("dots")


@pytest.fixture
def no_opencv(monkeypatch) -> None:
    """The tests may read images with OpenCV, the code may not import it."""
    monkeypatch.setitem(sys.modules, "cv2", None)


@pytest.fixture
def no_ffmpeg(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))


@pytest.fixture
def kernel_defaults_afterwards() -> Iterator[None]:
    """The kernel's threads and instruction set, which are the process's, as they were by default."""
    yield
    nl.set_threads(0)
    nl.use_instruction_set(None)
