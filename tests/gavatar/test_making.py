"""From footage to a page in one call, and the same call again."""

from __future__ import annotations

import pytest
from tiny_capture import SMALL, write_tiny_capture

import gavatar
from gavatar.overrides import from_overrides
from gavatar_runtime.errors import MissingFile, UserError

SETTINGS = {name: value for name, value in from_overrides(SMALL).items() if not name.startswith(("encoder", "stage2"))}
SETTINGS |= {"stage1.steps": 2, "stage2.steps": 0, "encoder": "none"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    capture = write_tiny_capture(folder / "footage")
    steps: list[str] = []
    avatar = gavatar.make(capture, folder / "anna", settings=SETTINGS, say=steps.append, progress=False)
    return folder, capture, avatar, steps


def test_a_capture_becomes_a_bundle_and_a_page(made):
    folder, _, avatar, steps = made
    assert [step[:3] for step in steps if "/4" in step] == ["1/4", "2/4", "3/4", "4/4"]
    assert avatar.bundle == folder / "anna" / "anna.gavatar"
    assert avatar.page == folder / "anna" / "anna.html"
    text = avatar.page.read_text()
    assert '"name":"turn"' in text
    assert "http://" not in text.replace("http://www.w3.org", "")


def test_the_same_call_again_does_nothing_twice(made):
    folder, capture, avatar, _ = made
    files = [avatar.page, avatar.bundle]
    before = [file.stat().st_mtime_ns for file in files]
    gavatar.make(capture, folder / "anna", settings=SETTINGS, say=lambda _: None, progress=False)
    assert [file.stat().st_mtime_ns for file in files] == before


def test_what_is_missing_is_made_again(made):
    folder, capture, avatar, _ = made
    avatar.page.unlink()
    gavatar.make(capture, folder / "anna", settings=SETTINGS, say=lambda _: None, progress=False)
    assert avatar.page.is_file()


def test_a_folder_of_something_else_is_left_alone(made, tmp_path):
    folder, capture, *_ = made
    with pytest.raises(UserError, match="was made with another settings"):
        gavatar.make(capture, folder / "anna", settings={**SETTINGS, "seed": 3}, progress=False)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UserError, match="holds other files"):
        gavatar.make(capture, tmp_path, settings=SETTINGS, progress=False)
    with pytest.raises(MissingFile, match="does not exist"):
        gavatar.make(tmp_path / "clip.mp4", tmp_path / "new", progress=False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["notes.txt"]
