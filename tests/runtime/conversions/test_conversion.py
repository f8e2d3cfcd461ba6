"""Avatars as files of other programs: how the kind is found, what is written, and that it is written whole."""

from __future__ import annotations

import numpy as np
import pytest
from web_reading import arrays_of, points_of, read_bin

from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.conversions import convert, find_conversion
from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.values.motion import Motion

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import still


@pytest.fixture
def bundle(static):
    return read_bundle(static)


@pytest.mark.parametrize(("path", "name"), [("a.html", "html"), ("a.HTM", "html"), ("site/", "web"), ("site", "web")])
def test_the_suffix_chooses(path, name):
    assert find_conversion(path).name == name


@pytest.mark.parametrize("path", ["a.mp4", "a.tar", "a.htmll"])
def test_other_suffixes_are_told_what_there_is(path):
    with pytest.raises(WrongValue, match=r"\.html.*gavatar-play"):
        find_conversion(path)


def test_a_name_that_does_not_fit_the_path():
    with pytest.raises(WrongValue, match=r"'html' cannot write 'a\.txt'"):
        find_conversion("a.txt", "html")
    with pytest.raises(UserError, match="nothing"):
        find_conversion("a.html", "nothing")


def test_a_page_is_written_whole(bundle, tmp_path):
    path = tmp_path / "new" / "a.html"
    convert(bundle, path, motions=["wave"])
    text = path.read_text()
    assert text.startswith("<!DOCTYPE html>")
    assert text.endswith("</html>\n")
    assert [p.name for p in path.parent.iterdir()] == ["a.html"]


def test_a_folder_for_a_web_server(bundle, tmp_path):
    site = tmp_path / "site"
    convert(bundle, f"{site}/", motions=["wave", "turn"])
    assert {p.name for p in site.iterdir()} == {"index.html", "three.html", "gavatar.js", "avatar.bin"}
    header, blocks = read_bin((site / "avatar.bin").read_bytes())
    assert [m["name"] for m in header["motions"]] == ["wave", "turn"]
    assert len(points_of(header, blocks)["points"]) == 300
    convert(bundle, f"{site}/", gaussians=100)  # again, over its own
    assert read_bin((site / "avatar.bin").read_bytes())[0]["points"]["count"] == 100
    assert all(p.stat().st_mode & 0o444 for p in site.iterdir())


def test_a_folder_of_others_is_left_alone(bundle, tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(UserError, match="holds other files"):
        convert(bundle, f"{tmp_path}/")
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_place_that_cannot_be_written_is_one_sentence(bundle, tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "a.html", f"{tmp_path}/file/site/"):
        with pytest.raises(UserError, match="file"):
            convert(bundle, path)


def test_motions_of_one_name_are_told_apart(bundle, tmp_path):
    moved = Motion(np.zeros((2, 52, 3), np.float32), np.ones((2, 3), np.float32), 30.0, name="still")
    convert(bundle, f"{tmp_path}/site/", motions=[still(), moved, still()])
    header, blocks = read_bin((tmp_path / "site" / "avatar.bin").read_bytes())
    assert [m["name"] for m in header["motions"]] == ["still", "still_2", "still_3"]
    assert np.array_equal(arrays_of(header["motions"][1], blocks)["trans"], moved.trans)


def test_without_motions_the_default_one_plays(bundle, tmp_path):
    convert(bundle, f"{tmp_path}/site/", motions=[])
    assert len(read_bin((tmp_path / "site" / "avatar.bin").read_bytes())[0]["motions"]) == 1


def test_what_a_page_cannot_play_is_refused_before_anything_is_written(dynamic, tmp_path):
    with pytest.raises(WrongValue, match="--tiers baked,blendshape"):
        convert(dynamic, tmp_path / "a.html")
    assert not any(tmp_path.iterdir())
