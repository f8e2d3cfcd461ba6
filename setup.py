"""Builds the native kernel (deploy/native/) when the package is installed; pyproject.toml says everything else.

The library is plain C under a C interface, loaded through ctypes, so one build serves every Python: wheels are tagged
py3-none-PLATFORM. Where it cannot be compiled, the install goes on without it and says so in one line.

CXX names the compiler. GAVATAR_WHEEL names another machine's platform (win_amd64, macosx_11_0_arm64, ...) that CXX
compiles for, or `any` for a wheel without the library; then a library that cannot be compiled is an error.
tools/wheels/build.py sets both.
"""

from __future__ import annotations

import dataclasses
import os
import platform
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

SOURCES = Path("deploy", "native")
RULES = Path("deploy", "gavatar_runtime", "splatting_rule.py")
# never -ffast-math: loading a library linked with it changes the denormal handling of the whole process
FLAGS = [
    "-std=c++17", "-O3", "-fvisibility=hidden", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast",
    "-DNDEBUG", "-Wall", "-Wextra",
]  # fmt: skip
X86 = {
    "sse4": ["-msse4.1"],
    "avx2": ["-mavx2", "-mfma", "-mbmi", "-mbmi2"],
    "avx512": ["-mavx512f", "-mavx512dq", "-mavx512bw", "-mavx512vl", "-mavx2", "-mfma", "-mbmi", "-mbmi2"],
}


# the same for clang-cl, which Visual Studio brings; cl itself lacks the vector types that the kernel is written in
CL_FLAGS = [
    "/nologo", "/std:c++17", "/O2", "/EHsc", "/MD", "/DNDEBUG", "/W3", "/clang:-fno-math-errno",
    "/clang:-fno-trapping-math", "/clang:-ffp-contract=fast",
]  # fmt: skip
SUFFIXES = {"win32": ".dll", "darwin": ".dylib"}
WHEEL = os.environ.get("GAVATAR_WHEEL", "")


@dataclasses.dataclass(frozen=True)
class Machine:
    """What the library is compiled for. system: as sys.platform says it."""

    system: str
    x86_64: bool

    @property
    def suffix(self) -> str:
        return SUFFIXES.get(self.system, ".so")


def wanted_machine(wheel: str = WHEEL) -> Machine:
    """The machine of a wheel's platform, this one for ''. Raises ValueError for a platform that is not known."""
    if not wheel:
        return Machine(sys.platform, platform.machine().lower() in ("x86_64", "amd64") and sys.maxsize > 2**32)
    for start, system in (("manylinux", "linux"), ("macosx", "darwin"), ("win", "win32")):
        if wheel.startswith(start) and wheel.endswith(("x86_64", "amd64", "arm64", "aarch64")):
            return Machine(system, wheel.endswith(("x86_64", "amd64")))
    raise ValueError(f"GAVATAR_WHEEL={wheel} is no platform that is known here: manylinux..., macosx..., win... or any")


def find_compiler() -> list[str] | None:
    """The C++ compiler as the beginning of a command: CXX, or the first of g++, clang++, c++, clang-cl."""
    for name in (os.environ.get("CXX"), "g++", "clang++", "c++", "clang-cl"):
        command = shlex.split(name, posix=os.name != "nt") if name else []
        if command and shutil.which(command[0]):
            return command
    return None


def write_rule(folder: Path) -> None:
    """Write splatting_rule.h, the constants of splatting_rule.py, into `folder`: they stand in one place."""
    rule = {name: value for name, value in runpy.run_path(str(RULES)).items() if name.isupper()}
    lines = [
        f"// The splatting rule's constants, written by setup.py from {RULES.name}.",
        "#pragma once",
        "namespace gv {",
        *(f"constexpr float {name} = {float(value)!r}f;" for name, value in rule.items()),
        "struct RuleConstant {",
        "  const char* name;",
        "  float value;",
        "};",
        "constexpr RuleConstant RULE[] = {",
        *(f'    {{"{name}", {name}}},' for name in rule),
        "};",
        "}  // namespace gv",
    ]
    Path(folder, "splatting_rule.h").write_text("\n".join(lines) + "\n")


def instruction_sets(machine: Machine, compiler: list[str]) -> dict[str, list[str]]:
    """Flags of each instruction set by its name."""
    # GCC does not align the stack for AVX on Windows (its bug 54412)
    return X86 if machine.x86_64 and not is_mingw(machine, compiler) else {"baseline": []}


def is_mingw(machine: Machine, compiler: list[str]) -> bool:
    """Whether it is GCC that compiles for Windows."""
    return machine.system == "win32" and "g++" in Path(compiler[0]).name


def link_command(compiler: list[str], flags: list[str], machine: Machine, folder: Path, output: Path) -> list[str]:
    """The command that links the objects, which come after it, into `output`; files it needs go into `folder`."""
    if uses_cl_flags(compiler):
        return [*compiler, "/nologo", "/LD", "/MD", f"/Fe{output}"]
    command = [*compiler, "-shared", "-pthread", *(f for f in flags if "sanitize" in f), "-o", str(output)]
    if machine.system == "darwin":
        # of a wheel no symbols, which would name the folders of the build
        return [*command, f"-Wl,-install_name,@rpath/_gavatar_native{machine.suffix}", *(["-s"] if WHEEL else [])]
    command += [] if "-g" in flags else ["-s"]  # no symbols, a smaller file
    if machine.system == "win32":  # else it would want DLLs of its compiler
        return [*command, "-static"] if is_mingw(machine, compiler) else command
    script = folder / "exports.map"  # what is linked in of a C++ library stays inside
    script.write_text("{ global: gv_*; local: *; };\n")
    return [*command, f"-Wl,--version-script={script}"]


def uses_cl_flags(compiler: list[str]) -> bool:
    """Whether a compiler takes the flags of Microsoft's."""
    return Path(compiler[0]).stem.lower() in ("cl", "clang-cl")


def compile_library(target: Path, flags: list[str] | None = None, machine: Machine | None = None) -> None:
    """Compile deploy/native into the shared library `target`, all files at once. Raises OSError or
    CalledProcessError."""
    compiler, machine = find_compiler(), machine or wanted_machine()
    if compiler is None:
        raise OSError("no C++ compiler was found")
    cl = uses_cl_flags(compiler)
    if cl and Path(compiler[0]).stem.lower() == "cl":
        raise OSError("cl lacks the vector types that the kernel is written in: set CXX=clang-cl, or CXX=clang++")
    sets = instruction_sets(machine, compiler)
    jobs = [(name, "kernels.cpp", [*extra, f"-DGV_NAMESPACE={name}"]) for name, extra in sets.items()]
    jobs += [(path.stem, path.name, []) for path in sorted(SOURCES.glob("*.cpp")) if path.name != "kernels.cpp"]
    position = [] if machine.system == "win32" else ["-fPIC"]
    flags = [*(CL_FLAGS if cl else [*FLAGS, *position]), *(flags or [])]
    flags += ["-DGV_BASELINE_ONLY"] if "baseline" in sets else []
    with tempfile.TemporaryDirectory() as folder:
        write_rule(Path(folder))
        running = []
        for name, source, extra in jobs:
            output = str(Path(folder, f"{name}.o"))
            command = [*compiler, *flags, *extra, f"-I{folder}", "-c", str(SOURCES / source)]
            command += [f"/Fo{output}"] if cl else ["-o", output]
            running.append((subprocess.Popen(command), command, output))
        for process, command, _ in running:
            if process.wait():
                raise subprocess.CalledProcessError(process.returncode, command)
        target.parent.mkdir(parents=True, exist_ok=True)
        # linked beside the objects: on Windows linkers leave an import library next to what they write
        linked = Path(folder, target.name)
        subprocess.check_call(
            [*link_command(compiler, flags, machine, Path(folder), linked), *(o for _, _, o in running)]
        )
        fresh = target.with_name(f"{target.stem}.{os.getpid()}{machine.suffix}")
        shutil.copy(linked, fresh)
        os.replace(fresh, target)


class BuildNative(build_ext):
    """Compiles the library instead of a Python extension. Without a compiler the install goes on; a wheel for a named
    platform does not."""

    def get_ext_filename(self, name: str) -> str:
        return str(Path(*name.split(".")).with_suffix(wanted_machine().suffix))

    def get_export_symbols(self, extension) -> list[str]:
        return []

    def build_extension(self, extension) -> None:
        target = Path(self.get_ext_fullpath(extension.name))
        try:
            compile_library(target)
        except (OSError, subprocess.CalledProcessError) as error:
            target.unlink(missing_ok=True)
            if WHEEL:
                raise CompileError(f"the native kernel was not compiled for {WHEEL}: {error}") from None
            print(
                f"gavatar: the native kernel was not compiled ({error}); the numpy and torch rasterizers serve instead",
                file=sys.stderr,
            )

    def copy_extensions_to_source(self) -> None:  # editable installs
        wanted, self.extensions = self.extensions, [e for e in self.extensions if self._built(e).exists()]
        super().copy_extensions_to_source()
        self.extensions = wanted

    def _built(self, extension) -> Path:
        return Path(self.build_lib, self.get_ext_filename(self.get_ext_fullname(extension.name)))

    def get_outputs(self) -> list[str]:
        return [path for path in super().get_outputs() if Path(path).exists()]


class PlatformWheel(bdist_wheel):
    """py3-none-PLATFORM: the library is of the platform, and of no Python in particular."""

    def get_tag(self) -> tuple[str, str, str]:
        return ("py3", "none", WHEEL or super().get_tag()[2])


if __name__ == "__main__":
    native = Extension(
        "gavatar_runtime._gavatar_native", [str(SOURCES / "engine.cpp")], language="c++", optional=not WHEEL
    )
    setup(
        ext_modules=[] if WHEEL == "any" else [native],
        cmdclass={"build_ext": BuildNative, "bdist_wheel": PlatformWheel},
    )
