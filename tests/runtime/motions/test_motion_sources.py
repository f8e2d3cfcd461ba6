"""How a name, a file or a folder finds what reads it."""

from __future__ import annotations

import numpy as np
import pytest
from motion_files import amass

from gavatar_runtime import plugins
from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import MOTIONS, MotionSource, read_motion
from gavatar_runtime.values.motion import Motion


def test_an_unknown_name_lists_names_and_suffixes_and_the_nearest():
    with pytest.raises(UserError, match=r"unknown motion 'wavee'.*\.npz.*turn, walk, wave.*did you mean 'wave'"):
        read_motion("wavee")


def test_a_file_of_an_unknown_suffix_and_a_format_name_are_unknown_motions():
    for source in ("dance.xyz", "amass", "", "."):
        with pytest.raises(UserError, match="unknown motion"):
            read_motion(source)


def test_a_missing_file_and_a_folder_are_told_apart(tmp_path):
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(UserError, match=r"absent\.npz does not exist"):
        read_motion(tmp_path / "absent.npz")
    with pytest.raises(UserError, match=r"folder\.npz is a directory"):
        read_motion(tmp_path / "folder.npz")


def test_the_suffix_may_be_in_capitals(tmp_path):
    amass(tmp_path / "a.npz").rename(tmp_path / "A.NPZ")
    assert len(read_motion(tmp_path / "A.NPZ")) == 4


def test_a_new_format_is_one_decorated_class(tmp_path):
    @MOTIONS.register("still")
    class Still(MotionSource):
        suffixes = (".still",)

        def __init__(self, config, *, path):
            self.path = path

        def load(self):
            return Motion(np.zeros((1, 22, 3), np.float32), np.zeros((1, 3), np.float32), 1.0)

    try:
        (tmp_path / "a.still").write_text("")
        assert len(read_motion(tmp_path / "a.still")) == 1
    finally:
        MOTIONS.forget("still")


def test_plugins_are_asked_for_an_unknown_name_only_and_a_broken_one_is_named(monkeypatch):
    import importlib.metadata

    class Point:
        def __init__(self, name, load):
            self.name, self.load = name, load

    def broken():
        raise ImportError("no module 'sensor'")

    def nod():
        @MOTIONS.register("nod")
        class Nod(MotionSource):
            def __init__(self, config):
                pass

            def load(self):
                return Motion(np.zeros((2, 22, 3), np.float32), np.zeros((2, 3), np.float32), 1.0, name="nod")

    asked = []

    def entry_points(group):
        asked.append(group)
        return [Point("bad", broken), Point("good", nod)]

    monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)
    plugins.load_entry_points.cache_clear()
    try:
        read_motion("wave")
        assert asked == []
        with pytest.warns(UserWarning, match="plugin bad was skipped: ImportError: no module 'sensor'"):
            assert read_motion("nod").name == "nod"
        assert asked == ["gavatar.plugins"]
    finally:
        plugins.load_entry_points.cache_clear()
        MOTIONS.forget("nod")
