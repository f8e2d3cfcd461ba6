"""How many CPUs this process was given: by affinity (taskset, a batch system) and by a container's quota."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path("/")  # where proc/ lies and mounted control groups begin


def usable_cpus(root: Path | None = None) -> int:
    """Threads that can run at once, at least one: what `threads` means where none is given.

    The CPUs of the process's affinity, or of the machine where the system knows no affinity (macOS, Windows), at most
    the whole CPUs of its control groups' quotas (cgroup v2 cpu.max, v1 cpu.cfs_quota_us, of the group and of all above
    it). A quota of 1.5 gives one: with two, the kernel would stop both for a third of every period, and a frame's
    threads wait for each other. root: for tests, a folder in place of `ROOT`.
    """
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = cpu_quota(root)
    return cpus if quota is None else max(1, min(cpus, int(quota)))


def cpu_quota(root: Path | None = None) -> float | None:
    """CPUs of the tightest quota of this process, None for none. Files that are absent or not understood limit nothing.
    root: as in `usable_cpus`."""
    quotas = [_quota_of(folder) for folder in _groups(ROOT if root is None else root)]
    return min((quota for quota in quotas if quota is not None), default=None)


def _groups(root: Path) -> list[Path]:
    """The folders of this process's control groups that may limit CPU time, with those above them up to the mount."""
    own: dict[str, str] = {}  # controllers ('' is v2): path in the hierarchy
    for line in _lines(root / "proc/self/cgroup"):
        _, controllers, path = (*line.split(":", 2), "", "")[:3]
        own |= {controller: path for controller in controllers.split(",")}
    folders = []
    for line in _lines(root / "proc/self/mountinfo"):
        left, _, right = line.partition(" - ")
        mount, system = left.split(), right.split()
        if len(mount) < 5 or not system:
            continue
        controller = {"cgroup2": "", "cgroup": "cpu"}.get(system[0])
        if controller is None or controller not in own or (controller and controller not in system[-1].split(",")):
            continue
        top = root / mount[4].lstrip("/")
        # a container sees its own group as the mount's root, under a path of the host's
        inside = os.path.relpath(own[controller], mount[3])
        folder = top if inside.startswith("..") else top / inside
        folders += [folder, *folder.parents[: len(folder.parts) - len(top.parts)]]
    return folders


def _quota_of(folder: Path) -> float | None:
    words = [word for line in _lines(folder / "cpu.max") for word in line.split()]
    if not words:
        words = [word for name in ("quota", "period") for word in _lines(folder / f"cpu.cfs_{name}_us")]
    try:
        quota, period = (float(word) for word in words)  # `max` is no number; v1 says -1
    except ValueError:
        return None
    return quota / period if quota > 0 and period > 0 else None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except (OSError, ValueError):
        return []
