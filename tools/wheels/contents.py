"""What a wheel holds, against what it should: nothing of torch, no leftovers, both licences, one library at most."""

from __future__ import annotations

import zipfile
from pathlib import Path

LARGEST = 17.5e6  # bytes: 15 million, and the hand networks since
LIBRARY = "gavatar_runtime/_gavatar_native"
SUFFIXES = {"manylinux": ".so", "macosx": ".dylib", "win": ".dll"}
ROOMS = {"gavatar", "gavatar_plugins", "gavatar_runtime"}
# of builds, editors, tests and other programs: nothing that a user needs
LEFTOVERS = (".o", ".obj", ".cpp", ".h", ".pyc", ".pdb", ".lib", ".pth", ".pt", ".orig", ".DS_Store")
NEEDED = (
    "gavatar/data/body/gavatar_body_smplh.npz", "gavatar/conf/train.yaml", "gavatar_runtime/py.typed",
    "gavatar_runtime/browser/page.html",
)  # fmt: skip


def platform_of(wheel: Path) -> str:
    """The last part of its tag."""
    return wheel.stem.rsplit("-", 1)[-1]


def library_name(platform: str) -> str | None:
    """The member that is the compiled kernel, None for a wheel without."""
    for start, suffix in SUFFIXES.items():
        if platform.startswith(start):
            return LIBRARY + suffix
    return None


def faults(wheel: Path) -> list[str]:
    """What is wrong with a wheel's contents, one sentence each."""
    found, platform = [], platform_of(wheel)
    if wheel.stat().st_size > LARGEST:
        found.append(f"it has {wheel.stat().st_size / 1e6:.1f} MB, more than {LARGEST / 1e6:.0f}")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (info,) = {name.split("/")[0] for name in names if ".dist-info/" in name}
        tag = archive.read(f"{info}/WHEEL").decode()
        metadata = archive.read(f"{info}/METADATA").decode()
    if f"Tag: py3-none-{platform}\n" not in tag:
        found.append(f"its file WHEEL has another tag: {tag}")
    if ("Root-Is-Purelib: true" in tag) != (platform == "any"):
        found.append("Root-Is-Purelib is wrong")
    if {name.split("/")[0] for name in names} != {*ROOMS, info}:
        found.append(f"folders beside {', '.join(sorted(ROOMS))} and {info}")
    found += [f"{name} is a leftover" for name in names if name.endswith(LEFTOVERS) or "/build/" in name]
    found += [f"{name} is missing" for name in NEEDED if name not in names]
    licences = {name.rsplit("/", 1)[-1] for name in names if ".dist-info/licenses/" in name}
    if licences != {"LICENSE", "NOTICE"}:
        found.append(f"licences are {sorted(licences)}")
    compiled = [name for name in names if name.endswith(tuple(SUFFIXES.values()))]
    wanted = library_name(platform)
    if compiled != ([wanted] if wanted else []):
        found.append(f"compiled members are {compiled}, wanted {wanted}")
    needs = [line for line in metadata.splitlines() if line.startswith("Requires-Dist: ") and "extra ==" not in line]
    if any("torch" in line for line in needs):
        found.append("the player's install would bring torch")
    return found
