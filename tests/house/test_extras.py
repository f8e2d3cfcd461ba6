"""Which extra brings which module, and the sentence that says so."""

from __future__ import annotations

import sys

import pytest
from places import ROOT

from gavatar.optional import EXTRAS, extra_of, import_from_extra, requires_extra
from gavatar_runtime.errors import UserError, exit_cleanly


def test_every_module_named_for_an_extra_is_one_that_pyproject_lists():
    tomllib = pytest.importorskip("tomllib")
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    brought_by = {"omegaconf": "hydra_core", "cv2": "opencv_contrib_python_headless"}
    for extra, modules in EXTRAS.items():
        names = " ".join(declared[extra]).replace("-", "_")
        for module in modules:
            assert brought_by.get(module, module) in names, f"{module} is not in extra {extra}"


def test_the_extras_bring_one_wheel_of_opencv_by_one_line():
    """Two of OpenCV's wheels in one environment overwrite each other's files."""
    tomllib = pytest.importorskip("tomllib")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    (line,) = {line for lines in extras.values() for line in lines if line.startswith("opencv")}
    assert line in extras["train"]
    assert line in extras["video"]
    assert not [line for line in project["dependencies"] if line.startswith("opencv")]


def test_submodules_belong_to_the_extra_of_their_package():
    assert extra_of("torch.nn.functional") == "train"
    assert extra_of("numpy") is None
    assert extra_of(None) is None


@pytest.mark.parametrize("absent", ["torch", "kornia"])
def test_a_command_without_its_extra_is_one_sentence_and_exit_code_2(absent, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, absent, None)
    monkeypatch.setattr(sys, "argv", ["/somewhere/bin/gavatar-train", "capture=x"])

    @exit_cleanly
    @requires_extra("train")
    def main():
        import kornia  # noqa: F401

    with pytest.raises(SystemExit) as exit_:
        main()
    assert exit_.value.code == 2
    expected = f"error: gavatar-train needs {absent}, which is not installed: pip install 'gavatar[train]'\n"
    assert capsys.readouterr().err == expected


def test_a_missing_module_of_no_extra_stays_a_bug():
    @requires_extra("train")
    def main():
        import no_such_module_anywhere  # noqa: F401

    with pytest.raises(ModuleNotFoundError):
        main()
    with pytest.raises(ModuleNotFoundError):
        import_from_extra("no_such_module_anywhere", "decoder 'x'")


def test_a_heavy_import_on_first_use_names_the_user_and_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(UserError, match=r"rasterizer 'gsplat' needs gsplat, .*: pip install 'gavatar\[gpu\]'"):
        import_from_extra("gsplat", "rasterizer 'gsplat'")
