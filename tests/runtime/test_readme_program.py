"""The programs of deploy/README.md."""

from __future__ import annotations

import re
import shutil

import pytest
from places import ROOT

from gavatar_runtime.errors import UserError
from gavatar_runtime.render.choice import build_rasterizer

PROGRAMS = re.findall(r"```python\n(.*?)```", (ROOT / "deploy" / "README.md").read_text(encoding="utf-8"), re.DOTALL)


def run(program: str, bundle, folder, monkeypatch, **smaller: str) -> dict:
    """Its names after it ran beside a bundle called anna.gavatar, with less to do."""
    try:
        build_rasterizer()
    except UserError as error:
        pytest.skip(str(error))
    shutil.copy(bundle, folder / "anna.gavatar")
    monkeypatch.chdir(folder)
    for old, new in smaller.items():
        assert old in program
        program = program.replace(old, new)
    names: dict = {}
    exec(program, names)
    return names


def test_there_are_two_programs():
    assert len(PROGRAMS) == 2


def test_the_one_that_draws_frame_by_frame_runs(static, tmp_path, monkeypatch):
    names = run(PROGRAMS[0], static, tmp_path, monkeypatch, **{"512": "32", "range(len(motion))": "range(2)"})
    assert names["image"].shape == (32, 32, 3)


def test_the_one_that_plays_into_files_runs(static, tmp_path, monkeypatch):
    run(
        PROGRAMS[1],
        static,
        tmp_path,
        monkeypatch,
        **{"fps=30, size=512": "fps=3, size=32", "slice(0, 60)": "slice(0, 2)"},
    )
    assert (tmp_path / "wave.mp4").exists()
    assert sorted(path.name for path in (tmp_path / "wave").iterdir()) == ["000000.ply", "000001.ply"]
