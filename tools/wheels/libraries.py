"""What a compiled library asks of the system that loads it, and what it gives: ELF, Mach-O and PE, taken apart."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import lief
from build import ROOT

GLIBC = (2, 17)
MACHINES = {
    "manylinux2014_x86_64": lief.ELF.ARCH.X86_64,
    "manylinux2014_aarch64": lief.ELF.ARCH.AARCH64,
    "macosx_11_0_arm64": lief.MachO.Header.CPU_TYPE.ARM64,
    "macosx_10_15_x86_64": lief.MachO.Header.CPU_TYPE.X86_64,
    "win_amd64": lief.PE.Header.MACHINE_TYPES.AMD64,
}
# What there is on every system of the kind. On Windows: the C library that comes with Windows 10.
LINUX = {"libc.so.6", "libpthread.so.0", "libdl.so.2", "libm.so.6", "ld-linux-x86-64.so.2", "ld-linux-aarch64.so.1"}
MACOS = {"@rpath/_gavatar_native.dylib", "/usr/lib/libSystem.B.dylib"}
WINDOWS = re.compile(r"(kernel32|ntdll|advapi32|api-ms-win-crt-[a-z]+-l1-1-0)\.dll", re.IGNORECASE)
# operator new and delete, which a program may replace, stay visible in Mach-O
MACHO_BESIDES = re.compile(r"__Zn[wa]|__Zd[la]Pv|___dso_handle|__mh_dylib_header")


def interface() -> set[str]:
    """The functions that gavatar_native.h declares."""
    header = (ROOT / "deploy/native/gavatar_native.h").read_text()
    return set(re.findall(r"^GV_API [^(]*?(gv_\w+)\(", header, re.MULTILINE))


def faults(platform: str, library: Path) -> tuple[list[str], str]:
    """(what is wrong with a library, one sentence each; in a few words what it needs)."""
    parsed = lief.parse(str(library))
    if parsed is None:
        return [f"{library.name} is no library"], "-"
    check = {"manylinux": _elf, "macosx_": _macho, "win_amd": _pe}
    for start, one in check.items():
        if platform.startswith(start):
            found, needs = one(platform, parsed)
    text = library.read_bytes()
    found += [f"names a folder of the build: {name}" for name in ("/tmp/", "/home/", "/root/") if name.encode() in text]
    return found, needs


def _exports(names: set[str]) -> list[str]:
    wanted = interface()
    missing, more = sorted(wanted - names), sorted(names - wanted)
    return [f"lacks {name}" for name in missing] + [f"exports {name} besides" for name in more]


def _elf(platform: str, parsed: lief.ELF.Binary) -> tuple[list[str], str]:
    found = _exports({s.name for s in parsed.exported_symbols})
    versions = {
        aux.name for needed in parsed.symbols_version_requirement for aux in needed.get_auxiliary_symbols()
    }  # GLIBC_2.17
    if other := {v for v in versions if not v.startswith("GLIBC_")}:
        found.append(f"asks for {sorted(other)}")
    glibc = max(tuple(map(int, v.removeprefix("GLIBC_").split("."))) for v in versions - other)
    if glibc > GLIBC:
        found.append(f"asks for glibc {'.'.join(map(str, glibc))}")
    if extra := set(parsed.libraries) - LINUX:
        found.append(f"asks for {sorted(extra)}")
    if parsed.header.machine_type != MACHINES[platform]:
        found.append(f"is for {parsed.header.machine_type}")
    return found, f"glibc {'.'.join(map(str, glibc))}"


def _macho(platform: str, fat: lief.MachO.FatBinary) -> tuple[list[str], str]:
    parsed = fat if isinstance(fat, lief.MachO.Binary) else fat.at(0)
    names = {s.name for s in parsed.exported_symbols if not MACHO_BESIDES.match(s.name)}
    found = _exports({name.removeprefix("_") for name in names})
    if extra := {library.name for library in parsed.libraries} - MACOS:
        found.append(f"asks for {sorted(extra)}")
    least = parsed.build_version.minos if parsed.has_build_version else parsed.version_min.version
    promised = [int(n) for n in platform.split("_")[1:3]]
    if list(least[:2]) > promised:
        found.append(f"asks for macOS {least}")
    if parsed.header.cpu_type != MACHINES[platform]:
        found.append(f"is for {parsed.header.cpu_type}")
    if platform.endswith("arm64") and not parsed.has_code_signature:
        found.append("is not signed, which ARM Macs refuse to load")
    if promised < [10, 15] and any(s.name == "_aligned_alloc" for s in parsed.imported_symbols):
        found.append("asks for aligned_alloc, which macOS has since 10.15")
    return found, f"macOS {least[0]}.{least[1]}"


def _pe(platform: str, parsed: lief.PE.Binary) -> tuple[list[str], str]:
    exports = parsed.get_export()
    found = _exports({entry.name for entry in exports.entries})
    imports = {one.name for one in parsed.imports}
    if extra := {name for name in imports if not WINDOWS.fullmatch(name)}:
        found.append(f"asks for {sorted(extra)}")
    if parsed.header.machine != MACHINES[platform]:
        found.append(f"is for {parsed.header.machine}")
    return found, "Windows 10"


def auditwheel(wheel: Path, platform: str) -> list[str]:
    """What auditwheel says against a Linux wheel's promise."""
    done = subprocess.run(
        [sys.executable, "-m", "auditwheel", "show", "--json", str(wheel)], capture_output=True, text=True
    )
    if done.returncode:
        return [f"auditwheel fails: {done.stderr}"]
    policy = json.loads(done.stdout)["overall_tag"]
    return [] if policy in (platform, platform.replace("2014", "_2_17")) else [f"auditwheel calls it {policy}"]
