"""Builds the native kernel (deploy/native/) when the package is installed; pyproject.toml says everything else.

The library is plain C under a C interface, loaded through ctypes, so one build serves every Python: wheels are tagged
py3-none-PLATFORM. Where it cannot be compiled, the install goes on without it and says so in one line.
"""

from __future__ import annotations

import os
import platform
import runpy
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

SOURCES = Path("deploy", "native")
RULES = Path("deploy", "gavatar_runtime", "splatting_rule.py")
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
# never -ffast-math: loading a library linked with it changes the denormal handling of the whole process
FLAGS = [
    "-std=c++17", "-O3", "-fPIC", "-fvisibility=hidden", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast",
    "-DNDEBUG", "-Wall", "-Wextra",
]  # fmt: skip
X86 = {
    "sse4": ["-msse4.1"],
    "avx2": ["-mavx2", "-mfma", "-mbmi", "-mbmi2"],
    "avx512": ["-mavx512f", "-mavx512dq", "-mavx512bw", "-mavx512vl", "-mavx2", "-mfma", "-mbmi", "-mbmi2"],
}


def find_compiler() -> str | None:
    """The C++ compiler: CXX, or the first of g++, clang++, c++."""
    for name in (os.environ.get("CXX"), "g++", "clang++", "c++"):
        if name and shutil.which(name.split()[0]):
            return name
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


def compile_library(target: Path, flags: list[str] | None = None) -> None:
    """Compile deploy/native into the shared library `target`, all files at once. Raises OSError or
    CalledProcessError."""
    compiler = find_compiler()
    if compiler is None:
        raise OSError("no C++ compiler was found")
    x86 = platform.machine().lower() in ("x86_64", "amd64") and sys.maxsize > 2**32
    sets = X86 if x86 else {"baseline": []}
    jobs = [(name, "kernels.cpp", [*extra, f"-DGV_NAMESPACE={name}"]) for name, extra in sets.items()]
    jobs += [(path.stem, path.name, []) for path in sorted(SOURCES.glob("*.cpp")) if path.name != "kernels.cpp"]
    flags = [*FLAGS, *(flags or []), *([] if x86 else ["-DGV_BASELINE_ONLY"])]
    with tempfile.TemporaryDirectory() as folder:
        write_rule(Path(folder))
        running = []
        for name, source, extra in jobs:
            output = str(Path(folder, f"{name}.o"))
            command = [*compiler.split(), *flags, *extra, f"-I{folder}", "-c", str(SOURCES / source), "-o", output]
            running.append((subprocess.Popen(command), command, output))
        for process, command, _ in running:
            if process.wait():
                raise subprocess.CalledProcessError(process.returncode, command)
        target.parent.mkdir(parents=True, exist_ok=True)
        # -s: no symbols, a smaller file; threads are the one thing beyond the C++ library
        link = [] if sys.platform == "darwin" or "-g" in flags else ["-s"]
        objects = [output for _, _, output in running]
        fresh = target.with_name(f"{target.stem}.{os.getpid()}{SUFFIX}")
        subprocess.check_call([*compiler.split(), "-shared", *link, *(f for f in flags if "sanitize" in f),
                               "-o", str(fresh), *objects, "-pthread"])  # fmt: skip
        os.replace(fresh, target)


class BuildNative(build_ext):
    """Compiles the library instead of a Python extension, and never fails the install."""

    def get_ext_filename(self, name: str) -> str:
        return str(Path(*name.split(".")).with_suffix(SUFFIX))

    def get_export_symbols(self, extension) -> list[str]:
        return []

    def build_extension(self, extension) -> None:
        target = Path(self.get_ext_fullpath(extension.name))
        try:
            compile_library(target)
        except (OSError, subprocess.CalledProcessError) as error:
            target.unlink(missing_ok=True)
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
        return ("py3", "none", super().get_tag()[2])


if __name__ == "__main__":
    setup(
        ext_modules=[
            Extension("gavatar_runtime._gavatar_native", [str(SOURCES / "engine.cpp")], language="c++", optional=True)
        ],
        cmdclass={"build_ext": BuildNative, "bdist_wheel": PlatformWheel},
    )
