"""Loading the compiled kernel: what it is compared with, what is said where it cannot be used, and how it is built."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys

import pytest
from children import child_environment
from places import ROOT

from gavatar_runtime import native_library as nl
from gavatar_runtime.errors import UserError

built = pytest.mark.skipif(not nl.available()[0], reason=f"native kernel: {nl.available()[1]}")


# Where it is not there


@built
def test_without_the_library_it_says_why_and_skinning_goes_on():
    script = """
import numpy as np
from gavatar_runtime import native_library as nl
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.rasterizers.native import NativeRasterizer, available
from gavatar_runtime.geometry.skinning import skin
assert available() == (False, "it is switched off by GAVATAR_NATIVE=0"), available()
try:
    NativeRasterizer()
except UserError as error:
    assert "GAVATAR_NATIVE=0" in str(error) and "numpy" in str(error)
else:
    raise SystemExit("no UserError")
points = np.ones((5, 3), np.float32)
moved = skin(points, np.zeros((5, 1), np.int32), np.ones((5, 1), np.float32), np.eye(4, dtype=np.float32)[None])
assert np.array_equal(moved, points)
"""
    environment = child_environment(GAVATAR_NATIVE="0")
    assert subprocess.run([sys.executable, "-c", script], timeout=60, env=environment).returncode == 0


@built
def test_an_unknown_instruction_set_is_named():
    with pytest.raises(UserError, match="pentium"):
        nl.use_instruction_set("pentium")


# Where it is of another version: what Python and the library both know is compared before either is used


@built
def test_the_library_is_compiled_with_the_structs_and_the_rule_of_this_package():
    assert nl.mismatch(nl.library()) == ""


@built
@pytest.mark.parametrize("struct", nl.STRUCTS, ids=lambda struct: struct.__name__)
def test_a_struct_of_another_size_is_noticed(struct):
    longer = type(struct.__name__, (ctypes.Structure,), {"_fields_": [*struct._fields_, ("more", ctypes.c_double)]})
    sizes = f"has {ctypes.sizeof(struct)} bytes, {ctypes.sizeof(longer)} are needed"
    assert sizes in nl.mismatch(nl.library(), structs=[longer])


@built
def test_a_struct_that_the_library_does_not_know_is_noticed():
    class NewStruct(ctypes.Structure):
        _fields_ = (("one", ctypes.c_float),)

    assert "GvNew" in nl.mismatch(nl.library(), structs=[NewStruct])


@built
@pytest.mark.parametrize("name", nl.RULE)
def test_another_rule_is_noticed(name):
    assert nl.RULE[name] > 0
    assert name in nl.mismatch(nl.library(), rule={**nl.RULE, name: 1.001 * nl.RULE[name]})


@built
def test_a_constant_that_the_library_does_not_know_is_noticed():
    assert "SOFTNESS" in nl.mismatch(nl.library(), rule={"SOFTNESS": 1.0})


OTHER_LIBRARY = """
#include <stdint.h>
extern "C" int32_t gv_abi_version(void) { return %d; }
extern "C" int64_t gv_struct_size(const char*) { return 8; }
extern "C" double gv_rule(const char*) { return 0; }
"""


@pytest.mark.parametrize(
    ("version", "reason"),
    [(nl.ABI_VERSION - 1, "of the interface"), (nl.ABI_VERSION, "its GvGaussians has 8 bytes")],
)
def test_a_library_of_another_version_is_refused_with_what_to_do(tmp_path, version, reason):
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("needs a C++ compiler")
    source, library = tmp_path / "other.cpp", tmp_path / "other.so"
    source.write_text(OTHER_LIBRARY % version)
    subprocess.run([compiler, "-shared", "-fPIC", source, "-o", library], check=True)
    script = "from gavatar_runtime import native_library as nl; nl.library()"
    environment = child_environment(GAVATAR_NATIVE_LIBRARY=str(library))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, env=environment)
    message = done.stderr.strip().splitlines()[-1]
    assert "UserError" in message
    assert reason in message
    assert "install gavatar again" in message


# Building


def test_a_build_without_a_compiler_fails_with_the_reason(monkeypatch, tmp_path):
    pytest.importorskip("setuptools", minversion="77")
    monkeypatch.syspath_prepend(str(ROOT))
    import setup

    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(OSError, match="no C\\+\\+ compiler"):
        setup.compile_library(tmp_path / "lib.so")


def test_the_rule_is_written_for_the_compiler_from_where_it_stands(monkeypatch, tmp_path):
    pytest.importorskip("setuptools", minversion="77")
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.chdir(ROOT)
    import setup

    setup.write_rule(tmp_path)
    header = (tmp_path / "splatting_rule.h").read_text()
    for name, value in nl.RULE.items():
        assert f"constexpr float {name} = {value!r}f;" in header
