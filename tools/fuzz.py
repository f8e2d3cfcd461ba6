"""Damaged bundles, motions and captures thrown at gavatar's readers: whatever comes of one must be a finite result or
one sentence to the user.

    python tools/fuzz.py bundle AVATAR.gavatar --cases 1000 --seed 0      one member damaged, its SHA-256 made to fit
    python tools/fuzz.py zip AVATAR.gavatar                               bytes of the whole file damaged
    python tools/fuzz.py motion FOLDER --avatar AVATAR.gavatar            motion files of a folder
    python tools/fuzz.py capture FOLDER                                   a file of a capture
    python tools/fuzz.py bundle AVATAR.gavatar --one 123                  a seed again, with its traceback

Told are the counts: `fine`, `refused` (by one sentence), and what must not be: `bad` (any other exception, a result
that is not finite, a sentence of several lines, anything printed), `late` (a bundle that opens, and is refused when it
plays), `crash` (the process died), `slow` (above 8 s of CPU; a case is ended after 20). Exits 1 if there is any of
these. Cases run in forked processes that may take 12 GB of addresses; damage depends on the seed alone (`fuzz_damage`).
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random

import numpy as np
from fuzz_damage import damaged_file, flipped

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.values.motion import Motion

MOTION_SUFFIXES = (".bvh", ".npz", ".npy", ".pth", ".pkl", ".pt")
SECONDS, SLOW = 20, 8  # of CPU, after which a case is ended, and after which it is told
WAITED = 300  # seconds, after which one is ended that does not even compute
ADDRESSES = 12 << 30  # bytes a process may map
OF_DECODERS = ("libpng ", "Corrupt JPEG", "Premature end of JPEG")  # OpenCV's picture readers print by themselves
BATCH = 100  # cases a process: what one leaves behind does not reach far
SIDE = 48  # pixels
UNWANTED = ("bad", "late", "crash", "slow")


@dataclasses.dataclass(frozen=True)
class Material:
    """What is damaged. path: a bundle, a folder of motions or a capture. avatar: that motions are played on."""

    path: Path
    avatar: Path | None = None


class Late(Exception):
    """A bundle that was opened and then refused."""


@cache
def _members(bundle: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(bundle) as file:
        return {name: file.read(name) for name in file.namelist()}


@cache
def _motions(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix in MOTION_SUFFIXES)


@cache
def _avatar(bundle: Path) -> Avatar:
    return Avatar(bundle, threads=1)


def play_one_frame(avatar: Avatar, motion: Motion, r: Random) -> None:
    """A random frame decoded and drawn; AssertionError unless all of it is finite."""
    motion, _ = avatar.fit(motion)
    if not len(motion):
        raise UserError("no frame")
    camera = frame_motion(avatar, motion, width=SIDE, height=SIDE)
    gaussians = avatar.gaussians(*motion.at(r.randrange(len(motion))))
    image = build_rasterizer("native", threads=1).render(gaussians, camera, (1, 1, 1)).color
    for name, array in (("image", image), ("means", gaussians.means), ("scales", gaussians.scales)):
        if not np.isfinite(array).all():
            raise AssertionError(f"{name} are not finite")


def bundle_case(material: Material, r: Random, folder: Path) -> str:
    """A bundle with one member damaged and listed as such, opened with one of its tiers and played."""
    whole = _members(material.path)
    name = r.choice([n for n in whole if not n.endswith(".onnx")] * 3 + list(whole))
    members = {**whole, name: damaged_file(r, name, whole[name])}
    if name != "manifest.json":
        manifest = json.loads(members["manifest.json"])
        manifest["members"][name] = hashlib.sha256(members[name]).hexdigest()
        members["manifest.json"] = json.dumps(manifest).encode()
    path = folder / "x.gavatar"
    with zipfile.ZipFile(path, "w") as file:
        for member, data in members.items():
            file.writestr(member, data)
    stored = [tier["name"] for tier in json.loads(whole["manifest.json"])["tiers"]]
    avatar = Avatar(read_bundle(path), tier=r.choice(["full", *stored]), threads=1)
    try:
        play_one_frame(avatar, read_motion("wave"), r)
    except UserError as error:
        raise Late(f"{name}: {error}") from error
    return name


def zip_case(material: Material, r: Random, folder: Path) -> str:
    """A bundle's own bytes damaged, then opened and played."""
    path = folder / "x.gavatar"
    path.write_bytes(flipped(r, material.path.read_bytes()))
    play_one_frame(Avatar(read_bundle(path), threads=1), read_motion("wave"), r)
    return "zip"


def motion_case(material: Material, r: Random, folder: Path) -> str:
    """A damaged motion file, read and played on a whole avatar."""
    source = r.choice(_motions(material.path))
    name = source.name if r.random() < 0.8 or source.suffix == ".bvh" else "any"
    path = folder / ("x" + source.suffix)
    path.write_bytes(damaged_file(r, name, source.read_bytes()))
    play_one_frame(_avatar(material.avatar), read_motion(str(path)), r)
    return source.name


def capture_case(material: Material, r: Random, folder: Path) -> str:
    """A copy of a capture with one file damaged, checked as gavatar-prepare --check does it."""
    from gavatar.capture.check import check_capture

    copied = folder / "capture"
    shutil.rmtree(copied, ignore_errors=True)
    shutil.copytree(material.path, copied)
    files = [path for path in sorted(copied.iterdir()) if path.suffix in (".json", ".npz")]
    kind = r.choice([*files, "images", "masks"])
    path = r.choice(sorted((copied / kind).rglob("*.*"))) if isinstance(kind, str) else kind
    path.write_bytes(damaged_file(r, path.name, path.read_bytes()))
    return f"{path.name}: {'faults' if check_capture(copied).faults else 'none'}"


Case = Callable[[Material, Random, Path], str]
TARGETS: dict[str, Case] = {"bundle": bundle_case, "zip": zip_case, "motion": motion_case, "capture": capture_case}


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What came of a seed. kind: `fine`, `refused` or one of `UNWANTED`. place: FILE:LINE of an exception."""

    seed: int
    kind: str
    text: str = ""
    place: str = ""


def outcome(case: Case, material: Material, seed: int, folder: Path, printed: int) -> Outcome:
    """One case in this process. printed: a file that its stdout and stderr are redirected to."""
    before = os.fstat(printed).st_size
    try:
        found = Outcome(seed, "fine", case(material, Random(seed), folder))
    except Late as error:
        found = Outcome(seed, "late", str(error))
    except UserError as error:
        found = Outcome(seed, "refused" if "\n" not in str(error) else "bad", str(error))
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        found = Outcome(seed, "bad", f"{type(error).__name__}: {error}", f"{Path(last.filename).name}:{last.lineno}")
    sys.stdout.flush()
    said = os.pread(printed, os.fstat(printed).st_size - before, before).decode(errors="replace")
    said = "\n".join(line for line in said.splitlines() if line and not line.startswith(OF_DECODERS))[:300]
    if said and found.kind != "bad":
        return Outcome(seed, "bad", f"{found.kind}, and printed: {said}", "printed")
    return found


def batch(case: Case, material: Material, seeds: range, folder: Path, log: Path) -> None:
    """Cases one after another in this process, a JSON line each as soon as it is known."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    warnings.simplefilter("ignore")
    printed = os.open(folder / "printed", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(printed, stream)
    sys.stdout = sys.stderr = open(printed, "w", closefd=False)  # noqa: SIM115  # for as long as the process lives

    def too_long(*_: object) -> None:
        raise TimeoutError(f"not done after {SECONDS} s of CPU, or {WAITED} s")

    for number in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(number, too_long)
    with log.open("a", buffering=1) as file:
        for seed in seeds:
            file.write(json.dumps({"seed": seed, "kind": "crash"}) + "\n")  # unless another line follows
            start = time.process_time()
            signal.alarm(WAITED)
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            found = outcome(case, material, seed, folder, printed)
            signal.alarm(0)
            signal.setitimer(signal.ITIMER_PROF, 0)
            taken = time.process_time() - start
            if taken > SLOW and found.kind in ("fine", "refused"):
                found = Outcome(seed, "slow", f"{taken:.1f} s: {found.text}")
            file.write(json.dumps(dataclasses.asdict(found)) + "\n")


def prepare(target: str) -> None:
    """Import once what every process of cases would: plugins bring torch, which takes seconds."""
    if target == "capture":
        from gavatar.registry import load_plugins

        load_plugins()


def fuzz(target: str, material: Material, seeds: range) -> list[Outcome]:
    """What came of each seed, in order; each `BATCH` of them, and what follows a crash, in a process of its own."""
    found: dict[int, Outcome] = {}
    with tempfile.TemporaryDirectory() as name:
        folder, log = Path(name), Path(name) / "log"
        start = seeds.start
        while start < seeds.stop:
            child = os.fork()
            if child == 0:
                try:
                    batch(TARGETS[target], material, range(start, min(start + BATCH, seeds.stop)), folder, log)
                finally:
                    os._exit(0)
            _, status = os.waitpid(child, 0)
            for line in log.read_text().splitlines():
                values = json.loads(line)
                found[values["seed"]] = Outcome(**values)
            start = max(found, default=start) + 1
            if status:
                found[start - 1] = Outcome(start - 1, "crash", f"status {status}")
    return [found[seed] for seed in sorted(found)]


def report(outcomes: list[Outcome]) -> str:
    """The counts, and up to two examples of each place where something unwanted came from."""
    counts = Counter(o.kind for o in outcomes)
    lines = [", ".join(f"{counts[kind]} {kind}" for kind in ("fine", "refused", *UNWANTED))]
    seen: Counter[str] = Counter()
    for o in outcomes:
        if o.kind in UNWANTED:
            key = f"{o.kind} {o.place}"
            seen[key] += 1
            if seen[key] <= 2:
                lines.append(f"seed {o.seed}: {o.kind} {o.place} {o.text[:300]!r}")
    lines += [f"{count} of {key}" for key, count in seen.most_common()]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("path", type=Path, help="a bundle, a folder of motions, or a capture")
    parser.add_argument("--avatar", type=Path, help="the bundle that motions are played on")
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the first case")
    parser.add_argument("--one", type=int, metavar="SEED", help="this case alone, in this process, with its traceback")
    options = parser.parse_args()
    if options.target == "motion" and options.avatar is None:
        parser.error("motions need --avatar")
    material = Material(options.path, options.avatar)
    prepare(options.target)
    if options.one is not None:
        with tempfile.TemporaryDirectory() as folder:
            print(TARGETS[options.target](material, Random(options.one), Path(folder)))
        return 0
    outcomes = fuzz(options.target, material, range(options.seed, options.seed + options.cases))
    print(report(outcomes))
    return int(any(o.kind in UNWANTED for o in outcomes))


if __name__ == "__main__":
    sys.exit(main())
