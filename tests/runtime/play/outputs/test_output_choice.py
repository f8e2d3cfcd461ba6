"""An output is chosen by the suffix of its path, or by its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gavatar_runtime.components import Registry
from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.play.outputs import (
    OUTPUTS,
    FrameFormat,
    ImageOutput,
    OutputTraits,
    find_output,
    open_output,
    output,
    save_gaussians,
)
from gavatar_runtime.values.gaussians import Gaussians

FRAMES = FrameFormat(1, 16, 16)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("a.mp4", "VideoFile"),
        ("a.MP4", "VideoFile"),
        ("a.png", "ContactSheet"),
        ("a.jpg", "ContactSheet"),
        ("a", "FrameFolder"),
        ("a.mp4/", "FrameFolder"),
        ("a/%06d.png", "FrameFolder"),
        ("there.mp4", "FrameFolder"),
        ("a.ply", "PlyFile"),
        ("a/%06d.PLY", "PlyFile"),
    ],
)
def test_the_suffix_chooses(tmp_path, name, kind):
    (tmp_path / "there.mp4").mkdir()
    path = f"{tmp_path}/{name}"
    assert find_output(path).__name__ == kind
    opened = open_output(path, FRAMES)
    assert type(opened).__name__ == kind
    opened.discard()
    assert [entry.name for entry in tmp_path.iterdir()] == ["there.mp4"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.mp5", r"cannot write .*a\.mp5.*did you mean '\.mp4'"),
        ("a.plyy", r"did you mean '\.ply'"),
        ("%03d.jpg", r"%03d\.jpg.*choose from: %d\.glb, %d\.ply, %d\.png, %d\.sog"),
    ],
)
def test_a_suffix_that_nothing_writes_is_refused_with_the_choices(tmp_path, name, message):
    with pytest.raises(WrongValue, match=message):
        open_output(tmp_path / name, FRAMES)


def test_a_name_chooses_and_must_fit_the_suffix(tmp_path):
    assert find_output(tmp_path / "a.png", "sheet").__name__ == "ContactSheet"
    with pytest.raises(WrongValue, match=r"output 'video' cannot write .*a\.avi'.*\.mp4"):
        find_output(tmp_path / "a.avi", "video")
    with pytest.raises(UserError, match=r"unknown output 'vidio'.*did you mean 'video'"):
        find_output(tmp_path / "a.mp4", "vidio")


@pytest.fixture
def own(monkeypatch) -> Registry:
    """A registry for the length of a test."""
    registry: Registry = Registry("output", OutputTraits, base=output.Output)
    monkeypatch.setattr(output, "OUTPUTS", registry)
    return registry


def test_an_output_without_suffixes_is_chosen_by_its_name_alone(own, tmp_path):
    @own.register("window")
    class Window(ImageOutput):
        def __init__(self, options, *, path: Path, frames: FrameFormat):
            super().__init__(path)
            self.size = frames.width, frames.height

        def add(self, image: np.ndarray) -> None: ...

        def close(self) -> None: ...

        def discard(self) -> None: ...

    assert open_output("anywhere.xyz", FRAMES, name="window").size == (16, 16)
    with pytest.raises(WrongValue, match=r"cannot write 'anywhere\.xyz'"):
        open_output("anywhere.xyz", FRAMES)


def test_the_default_is_the_preferred_one_that_can_be_had(own):
    own.register("fine", missing=lambda: "takes a film", traits=OutputTraits(preference=3))(ImageOutput)
    own.register("plain", traits=OutputTraits(preference=1))(ImageOutput)
    own.register("odd", traits=OutputTraits(preference=2), missing=lambda: "takes a moon")(ImageOutput)
    chosen, preferred = output.default_output()
    assert (chosen.name, preferred.name, preferred.missing()) == ("plain", "fine", "takes a film")


def test_of_two_outputs_for_a_suffix_the_preferred_one_is_taken(own):
    class One(ImageOutput):
        suffixes = (".one",)

    class Other(One):
        pass

    own.register("a")(One)
    own.register("b", traits=OutputTraits(preference=1))(Other)
    assert find_output("a.one") is Other
    assert find_output("a.one", "a") is One


def test_what_is_registered_must_be_an_output(own):
    with pytest.raises(TypeError, match="output 'thing' is no class derived from Output"):
        own.register("thing")(lambda options, *, path, frames: None)


def test_an_output_that_lacks_a_part_cannot_be_opened(own):
    @own.register("half")
    class Half(ImageOutput):
        suffixes = (".half",)

        def __init__(self, options, *, path: Path, frames: FrameFormat):
            super().__init__(path)

        def add(self, image: np.ndarray) -> None: ...

    with pytest.raises(TypeError, match="abstract"):
        open_output("a.half", FRAMES)


def test_gaussians_are_saved_without_a_motion_where_an_output_takes_them(tmp_path):
    one = Gaussians(np.zeros((1, 3), np.float32), np.ones(1, np.float32), np.ones((1, 3), np.float32))
    assert save_gaussians(tmp_path / "a.ply", one) == ()
    assert (tmp_path / "a.ply").read_bytes().startswith(b"ply\n")
    save_gaussians(tmp_path / "f" / "%02d.ply", one)
    assert [path.name for path in (tmp_path / "f").iterdir()] == ["00.ply"]
    with pytest.raises(
        WrongValue, match=r"a\.png is an output of images, not of Gaussians: choose from: \.glb, \.ply, \.sog"
    ):
        save_gaussians(tmp_path / "a.png", one)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ply", "f"]


def test_every_output_says_what_it_wants_and_what_it_writes():
    """The contract of a registered output, whoever brings it."""
    for component in OUTPUTS:
        kind = component.factory
        assert kind.wants in ("image", "gaussians"), component.name
        assert all(s == "/" or s.startswith((".", "%d.")) for s in kind.suffixes), component.name
        assert all(s == s.lower() for s in kind.suffixes), component.name
