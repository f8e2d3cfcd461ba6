"""What tools/wheels promises: tags, contents, symbols. `make check-wheels` looks at the wheels of other machines."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from places import ROOT

TOOLS = ROOT / "tools" / "wheels"


@pytest.fixture
def tools(monkeypatch):
    """Imports a module of tools/wheels."""
    monkeypatch.syspath_prepend(str(TOOLS))

    def load(name: str):
        spec = importlib.util.spec_from_file_location(f"wheels_{name}", TOOLS / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture
def setup_module(monkeypatch):
    pytest.importorskip("setuptools", minversion="77")
    monkeypatch.syspath_prepend(str(ROOT))
    import setup

    return setup


@pytest.mark.parametrize(
    ("wheel", "system", "x86_64", "suffix"),
    [
        ("manylinux2014_x86_64", "linux", True, ".so"),
        ("manylinux2014_aarch64", "linux", False, ".so"),
        ("macosx_11_0_arm64", "darwin", False, ".dylib"),
        ("macosx_10_15_x86_64", "darwin", True, ".dylib"),
        ("win_amd64", "win32", True, ".dll"),
    ],
)
def test_a_wheel_is_of_the_machine_that_its_tag_names(setup_module, tools, wheel, system, x86_64, suffix):
    machine = setup_module.wanted_machine(wheel)
    assert (machine.system, machine.x86_64, machine.suffix) == (system, x86_64, suffix)
    assert wheel in tools("build").TARGETS
    assert tools("contents").library_name(wheel) == f"gavatar_runtime/_gavatar_native{suffix}"


def test_a_platform_that_is_not_known_is_refused(setup_module):
    for wheel in ("linux_riscv64", "win32", "manylinux2014_i686"):
        with pytest.raises(ValueError, match="no platform that is known"):
            setup_module.wanted_machine(wheel)


@pytest.mark.parametrize(("platform", "suffix"), [("win32", ".dll"), ("darwin", ".dylib"), ("linux", ".so")])
def test_the_player_looks_for_the_name_that_the_wheel_gives(platform, suffix):
    script = (
        f"import sys; sys.platform = {platform!r}; from gavatar_runtime.native_library import LIBRARY; print(LIBRARY)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert Path(done.stdout.strip()).name == f"_gavatar_native{suffix}"


def test_compilers_of_two_kinds_get_flags_of_their_kind(setup_module, tmp_path):
    windows = setup_module.Machine("win32", True)
    command = setup_module.link_command(["clang-cl"], [], windows, tmp_path, tmp_path / "x.dll")
    assert command[:4] == ["clang-cl", "/nologo", "/LD", "/MD"]
    assert set(setup_module.instruction_sets(windows, ["clang-cl"])) == {"sse4", "avx2", "avx512"}
    assert set(setup_module.instruction_sets(windows, ["x86_64-w64-mingw32-g++"])) == {"baseline"}
    mac = setup_module.Machine("darwin", False)
    command = setup_module.link_command(["clang++"], [], mac, tmp_path, tmp_path / "x.dylib")
    assert "-Wl,-install_name,@rpath/_gavatar_native.dylib" in command


@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_a_library_shows_only_its_interface(setup_module, tools, monkeypatch, tmp_path, compiler):
    if shutil.which(compiler) is None or shutil.which("nm") is None or sys.platform != "linux":
        pytest.skip(f"needs Linux, {compiler} and nm")
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("CXX", compiler)
    library = tmp_path / "lib.so"
    setup_module.compile_library(library, ["-O0"])
    listed = subprocess.run(["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True).stdout
    header = (ROOT / "deploy/native/gavatar_native.h").read_text()
    names = {line.split()[-1] for line in listed.splitlines()}
    assert names == {name for name in names if f"{name}(" in header}
    assert "gv_forward" in names


@pytest.mark.slow
def test_the_wheel_without_the_kernel_holds_what_it_should_and_no_leftover(tools, tmp_path):
    pytest.importorskip("setuptools", minversion="77")
    build, contents = tools("build"), tools("contents")
    archive = build.source_distribution(tmp_path, tmp_path)
    (tmp_path / "out").mkdir()
    wheel = build.build_wheel(archive, "any", "", tmp_path / "out")
    assert wheel.name.endswith("-py3-none-any.whl")
    assert contents.faults(wheel) == []
    with zipfile.ZipFile(wheel, "a") as file:  # and the check sees what does not belong
        file.writestr("gavatar_runtime/_gavatar_native.so", b"")
        file.writestr("gavatar/kernels.o", b"")
    assert len(contents.faults(wheel)) == 2


@pytest.mark.slow
def test_a_wheel_for_a_platform_fails_where_its_kernel_does(tools, tmp_path):
    pytest.importorskip("setuptools", minversion="77")
    build = tools("build")
    archive = build.source_distribution(tmp_path, tmp_path)
    with pytest.raises(SystemExit, match="was not compiled for win_amd64"):
        build.build_wheel(archive, "win_amd64", shutil.which("false"), tmp_path)
