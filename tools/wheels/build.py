"""Wheels for every machine from one source: Linux, macOS and Windows, and one without the compiled kernel.

    python tools/wheels/build.py                                  what `make wheels` does, into dist/
    python tools/wheels/build.py --only manylinux2014_x86_64 any

The wheels are built from the source distribution, each in a fresh copy of it, so that they hold what it holds and
nothing that lies about. The compiler for all of them is the package ziglang (tools/wheels/requirements.txt).
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# The platform of a wheel, and what the compiler calls it. 2.17 is the glibc of manylinux2014. macOS on x86-64 begins
# at 10.15: aligned memory comes from aligned_alloc, which its C library has since then.
TARGETS = {
    "manylinux2014_x86_64": "x86_64-linux-gnu.2.17",
    "manylinux2014_aarch64": "aarch64-linux-gnu.2.17",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "macosx_10_15_x86_64": "x86_64-macos.10.15",
    "win_amd64": "x86_64-windows-gnu",
    "any": None,
}


def run(command: list[str], folder: Path, **environment: str) -> None:
    """Run a command quietly; exit with what it printed if it fails."""
    done = subprocess.run(command, cwd=folder, env=os.environ | environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"error: {' '.join(command)} failed\n{done.stdout}{done.stderr}")


def source_distribution(out: Path, scratch: Path) -> Path:
    """Build the source distribution of this checkout into `out`; leaves nothing else in the checkout."""
    info = ["egg_info", "--egg-base", str(scratch)]
    run([sys.executable, "setup.py", "-q", *info, "sdist", "--dist-dir", str(scratch / "sdist")], ROOT)
    (archive,) = (scratch / "sdist").glob("*.tar.gz")
    return Path(shutil.copy(archive, out))


def unpack(archive: Path, folder: Path) -> Path:
    """The source tree of a distribution, in `folder`."""
    with tarfile.open(archive) as file:
        file.extractall(folder, filter="data")
    (tree,) = folder.iterdir()
    return tree


def build_wheel(archive: Path, platform: str, compiler: str, out: Path) -> Path:
    """Build the wheel of a platform from a source distribution. compiler: as CXX."""
    with tempfile.TemporaryDirectory() as folder:
        tree = unpack(archive, Path(folder) / "source")
        made = Path(folder) / "made"
        pip = [sys.executable, "-m", "pip", "wheel", "--disable-pip-version-check", "--no-deps", "--no-build-isolation"]
        run([*pip, "-w", str(made), str(tree)], Path(folder), GAVATAR_WHEEL=platform, CXX=compiler)
        (wheel,) = made.glob("*.whl")
        return Path(shutil.copy(wheel, out))


def zig_command(target: str | None) -> list[str]:
    """The C++ compiler for a target, as the beginning of a command; none for no target."""
    return [sys.executable, "-m", "ziglang", "c++", "-target", target] if target else []


def main() -> None:
    """Build into dist/ and print names and sizes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=TARGETS, default=list(TARGETS), metavar="PLATFORM")
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for former in arguments.out.glob("gavatar-*"):  # wheels of another state of the source must not lie beside these
        former.unlink()
    with tempfile.TemporaryDirectory() as scratch:
        made = [source_distribution(arguments.out, Path(scratch))]
    for platform in arguments.only:
        print(f"building {platform}", file=sys.stderr, flush=True)
        compiler = shlex.join(zig_command(TARGETS[platform]))
        made.append(build_wheel(made[0], platform, compiler, arguments.out))
    for path in made:
        print(f"{path.stat().st_size / 1e6:6.2f} MB  {path.name}")


if __name__ == "__main__":
    main()
