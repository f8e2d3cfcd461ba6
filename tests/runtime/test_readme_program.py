"""The program of deploy/README.md."""

from __future__ import annotations

import re

import pytest
from places import ROOT

from gavatar_runtime.errors import UserError
from gavatar_runtime.render.choice import build_rasterizer


def test_the_program_in_the_readme_runs(static):
    try:
        build_rasterizer()
    except UserError as error:
        pytest.skip(str(error))
    text = (ROOT / "deploy" / "README.md").read_text(encoding="utf-8")
    program = re.search(r"```python\n(.*?)```", text, re.DOTALL).group(1)
    program = (
        program.replace('"anna.gavatar"', repr(str(static)))
        .replace('"wave"', '"wave", seconds=0.1')
        .replace("512", "32")
    )
    names = {}
    exec(program, names)
    assert names["image"].shape == (32, 32, 3)
