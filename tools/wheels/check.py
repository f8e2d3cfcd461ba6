"""Checks the wheels in dist/: what they hold, what their libraries need, and what those draw.

    python tools/wheels/check.py            what `make check-wheels` does
    python tools/wheels/check.py --install  and this machine's wheels in fresh environments without a compiler

Libraries of this machine run as they are, those of 64-bit ARM under qemu-user-static (which needs libc6-arm64-cross
besides), those of Windows under wine; each by a small program (draw.cpp) that knows only the C interface. Nothing here
runs macOS: its libraries are only taken apart. Prints the table of docs/reference/wheels.md. Ends with 1 if a check
fails; what could not be run is said, with the reason.
"""

from __future__ import annotations

import argparse
import itertools
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from build import ROOT, TARGETS, zig_command

sys.path.insert(0, str(ROOT / "deploy"))
import contents
import libraries
import numpy as np
import scene
from fresh_install import draw_installed

from gavatar_runtime.formats.png import write_png

LEAST_DB = 80.0  # between any two pictures
# relative L2 of all gradients: float32 in another order, and pixels whose opacity lies at the 1/255 threshold
MOST_GRADIENT = 1e-3
ARM_ROOT = Path("/usr/aarch64-linux-gnu")


def runner(platform: str) -> tuple[list[str] | None, str]:
    """(the command in front of a program of a platform, how that is called); None and the reason where none is."""
    if platform.startswith("macosx"):
        return None, "no: linked and inspected only"
    if platform.startswith("win"):
        return (["wine"], "wine") if shutil.which("wine") else (None, "not run: wine is not installed")
    if platform.endswith(os.uname().machine):
        return [], "as it is"
    if platform.endswith("aarch64"):
        if not shutil.which("qemu-aarch64-static"):
            return None, "not run: qemu-user-static is not installed"
        if not ARM_ROOT.exists():
            return None, "not run: libc6-arm64-cross is not installed"
        return ["qemu-aarch64-static", "-L", str(ARM_ROOT)], "qemu-aarch64"
    return None, "not run: no emulator for it"


def draw(platform: str, library: Path, program: list[str], folder: Path) -> tuple[np.ndarray, np.ndarray, str]:
    """The picture and the gradients by a library, and what the program says of itself. folder: with scene.bin."""
    binary, out = folder / f"draw_{platform}.exe", folder / f"{platform}.bin"
    source = [str(ROOT / "tools/wheels/draw.cpp"), f"-I{ROOT / 'deploy/native'}", "-o", str(binary)]
    subprocess.run([*zig_command(TARGETS[platform]), "-std=c++17", "-O1", *source], check=True, capture_output=True)
    environment = os.environ | {"WINEDEBUG": "-all", "WINEPREFIX": str(folder / "wine")}
    command = [*program, str(binary), str(library), str(folder / "scene.bin"), str(out)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stdout}{done.stderr}")
    return *scene.read_drawn(scene.make_scene(), out), done.stdout.strip()


def check_wheel(wheel: Path, folder: Path, drawn: dict[str, tuple[np.ndarray, np.ndarray]]) -> tuple[list[str], str]:
    """(faults, the row of the table); what it drew goes into `drawn`."""
    platform, found = contents.platform_of(wheel), contents.faults(wheel)
    name, needs, how, picture = contents.library_name(platform), "-", "the kernel is not in it", "-"
    if name is not None:
        with zipfile.ZipFile(wheel) as archive:
            library = Path(archive.extract(name, folder / platform))
        more, needs = libraries.faults(platform, library)
        found += more
        if platform.startswith("manylinux"):
            found += libraries.auditwheel(wheel, platform)
        program, how = runner(platform)
        if program is not None:
            try:
                *drawn[platform], said = draw(platform, library, program, folder)
                how = f"{how}: {said.split(',')[0]}"
                picture = f"{scene.psnr(drawn[platform][0], drawn['numpy'][0]):.1f} dB"
            except (RuntimeError, subprocess.CalledProcessError, OSError) as error:
                found.append(f"cannot be run: {error}")
    size = wheel.stat().st_size / 1e6
    return found, f"| `{platform}` | {size:.2f} MB | {needs} | {how} | {picture} |"


def compare(drawn: dict[str, tuple[np.ndarray, np.ndarray]]) -> list[str]:
    """Faults where two pictures or two gradients differ by too much; says how much they do."""
    found = []
    for (a, one), (b, other) in itertools.combinations(drawn.items(), 2):
        decibel = scene.psnr(one[0], other[0])
        words = f"{a} and {b}: {decibel:.1f} dB"
        if len(one[1]) and len(other[1]):
            gradient = float(np.linalg.norm(one[1] - other[1]) / np.linalg.norm(other[1]))
            words += f", gradients {gradient:.1e} apart (relative L2)"
            if not gradient <= MOST_GRADIENT:
                found.append(f"gradients of {a} and {b} are {gradient:.1e} apart")
        if not decibel >= LEAST_DB:
            found.append(f"pictures of {a} and {b} agree within {decibel:.1f} dB only")
        print(words)
    return found


def main() -> None:
    """Check what lies in dist/."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dist", type=Path, default=ROOT / "dist")
    parser.add_argument("--install", action="store_true", help="install into fresh environments too; needs the index")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write what each library drew as .png")
    arguments = parser.parse_args()
    wheels = sorted(arguments.dist.glob("gavatar-*.whl"))
    if not wheels:
        sys.exit(f"error: no wheel is in {arguments.dist}; `make wheels` builds them")
    faults, rows = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = scene.make_scene()
        scene.write_scene(made, folder / "scene.bin")
        drawn = {"numpy": (scene.picture_by_numpy(made), np.empty(0))}
        for wheel in wheels:
            found, row = check_wheel(wheel, folder, drawn)
            rows.append(row)
            faults += [f"{wheel.name}: {fault}" for fault in found]
            if arguments.install and (runner(contents.platform_of(wheel))[1] == "as it is" or "-any" in wheel.name):
                name = contents.platform_of(wheel)
                try:
                    drawn[f"{name} installed"] = draw_installed(wheel, folder / f"fresh_{name}"), np.empty(0)
                except (RuntimeError, subprocess.CalledProcessError) as error:
                    faults.append(f"{wheel.name}: {error}")
    print("| wheel | size | least system | run by | PSNR against NumPy in double precision |\n|---|---|---|---|---|")
    print("\n".join(rows) + "\n")
    faults += compare(drawn)
    if arguments.pictures:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
        for name, (picture, _) in drawn.items():
            write_png(arguments.pictures / f"{name}.png", (picture.clip(0, 1) * 255 + 0.5).astype(np.uint8))
    for fault in faults:
        print(f"error: {fault}", file=sys.stderr)
    print(f"{len(wheels)} wheels, {len(faults)} faults")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
