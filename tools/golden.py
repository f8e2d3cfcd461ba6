"""Golden results: what gavatar computes, as hashes and numbers, so that two revisions can be held together bit by bit.

    python tools/golden.py record before.json [--quick]      what is run stands in golden_tasks.txt
    python tools/golden.py compare before.json after.json    exits 1 on any difference

It runs the commands gavatar-* that stand beside the interpreter and reads what they wrote: however the packages are
laid out, the same three files golden* do for both revisions, each with its own environment, on the same machine:

    git worktree add ../before REVISION && make -C ../before setup
    ../before/.venv/bin/python tools/golden.py record before.json
    .venv/bin/python tools/golden.py record after.json
    .venv/bin/python tools/golden.py compare before.json after.json

Recorded: tensors of checkpoints, motions, previews, losses and verdicts of trainings; scores; arrays, networks and
manifests of bundles; played frames; converted motions; prepared captures. Not recorded: times and what hangs on them,
versions, machines, places, wording. Each command has one thread, because sums over several come out in another order.
Motion files are taken from ../shared; where that is missing, tasks that need it are left out, and this is said.
"""

from __future__ import annotations

import argparse
import dataclasses
import fnmatch
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

BIN = Path(sys.executable).parent
SHARED = Path(__file__).resolve().parents[2] / "shared"
ENVIRONMENT = os.environ | {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS")}
ENVIRONMENT.pop("GAVATAR_BODY_MODELS", None)
# what differs by nature, by dotted path: times and what hangs on them, versions, places, wording
SKIPPED = re.compile(
    r"(^|\.)(\w*seconds|\w+_ms|fps|frames_per_second|memory_mb|first_frame_s|dominated|machine|cores|created_by|run"
    r"|protocol|pose_sources|perceptual_network|psnr_split)(\.|$)|^\d+\.frames$|^members\.|^rasterizer$"
)
PARSED = {".npz", ".pt", ".png", ".jpg", ".mp4", ".json", ".gavatar"}  # what of a folder is read, but for
UNREAD = {"evaluation.png", "turn.json", "wave.json"}  # a drawn table, and timings


# --- reading: a file -> names and values, arrays as hashes -----------------------------------------------------------
def array(values: Any) -> str:
    """Hash of an array's bytes, with what helps to understand a difference: dtype, shape, sum."""
    values = np.ascontiguousarray(values)
    digest = hashlib.sha256(values.tobytes()).hexdigest()[:20]
    total = f" sum {np.asarray(values, np.float64).sum():.9g}" if values.dtype.kind in "fiub" else ""
    return f"{digest} {values.dtype}{list(values.shape)}{total}"


def flat(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """(dotted path, value) of the leaves of dictionaries and lists, without those SKIPPED; tensors as hashes."""
    if isinstance(tree, (dict, list, tuple)) and len(tree):
        for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
            yield from flat(value, f"{path}.{key}" if path else str(key))
    elif not SKIPPED.search(path):
        if hasattr(tree, "detach"):
            tree = tree.detach().numpy()
        yield path, array(tree) if isinstance(tree, np.ndarray) else tree


def network(data: bytes) -> str:
    """Hash of an ONNX model, without the version in its metadata."""
    import onnx

    model = onnx.load_model_from_string(data)
    kept = {p.key: p.value for p in model.metadata_props if p.key != "created_by"}
    onnx.helper.set_model_props(model, kept)
    return hashlib.sha256(model.SerializeToString(deterministic=True)).hexdigest()[:20]


def bundle(path: Path) -> Iterator[tuple[str, Any]]:
    """Arrays, networks and manifest of a .gavatar."""
    with zipfile.ZipFile(path) as file:
        for name in sorted(file.namelist()):
            data = file.read(name)
            if name.endswith(".npz"):
                yield from ((f"{name}:{key}", value) for key, value in archive(file.open(name)))
            elif name.endswith(".json"):
                yield from ((f"{name}:{key}", value) for key, value in flat(json.loads(data)))
            else:
                yield name, network(data) if name.endswith(".onnx") else hashlib.sha256(data).hexdigest()[:20]


def archive(file: Any) -> Iterator[tuple[str, str]]:
    """Hashes of an .npz's arrays."""
    with np.load(file, allow_pickle=False) as arrays:
        yield from ((key, array(arrays[key])) for key in sorted(arrays.files))


def video(path: Path) -> Iterator[tuple[str, str]]:
    """Hashes of a video's frames."""
    import cv2

    reader, number = cv2.VideoCapture(str(path)), 0
    while (read := reader.read())[0]:
        yield f"{number:06d}", array(read[1])
        number += 1


def contents(path: Path) -> Iterator[tuple[str, Any]]:
    """What a file holds, or every file that can be read below a folder."""
    if path.is_dir():
        for file in sorted(p for p in path.rglob("*") if p.suffix in PARSED and p.name not in UNREAD):
            yield from ((f"{file.relative_to(path)}:{key}", value) for key, value in contents(file))
    elif path.suffix in (".png", ".jpg"):
        import cv2

        yield "pixels", array(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    elif path.suffix == ".pt":
        import torch

        yield from flat(torch.load(path, map_location="cpu", weights_only=True))
    elif path.suffix == ".json":
        yield from flat(json.loads(path.read_text(encoding="utf-8")))
    else:
        yield from {".npz": archive, ".mp4": video, ".gavatar": bundle}[path.suffix](path)


# --- what is run ------------------------------------------------------------------------------------------------------
TASKS = Path(__file__).with_name("golden_tasks.txt")
COMMANDS = {  # by group: the command, what its output's name ends in
    "train": ("gavatar-train capture={material}/SOURCE out=OUT progress=false threads=1", ""),
    "eval": ("gavatar-eval {work}/train/SOURCE --out OUT", ""),
    "export": ("gavatar-export {work}/train/SOURCE -o OUT", ".gavatar"),
    "tradeoff": ("gavatar-tradeoff {work}/export/SOURCE.gavatar --json OUT", ".json"),
    "play": ("gavatar-play {work}/export/SOURCE.gavatar --out OUT --size 128 --threads 1 --quiet", "/"),
    "convert": ("gavatar-motion convert SOURCE -o OUT", ".npz"),
    "prepare": ("gavatar-prepare {material}/SOURCE -o OUT --quiet --no-preview", ""),
    "demo": ("gavatar-demo --out OUT progress=false threads=1", ""),
}
WORDS = {
    "SMALL": "experiment=demo stage1.steps=12 stage2.steps=5",
    "PUBLISHED": "stage1.steps=6 stage2.steps=3 COARSE",
    "COARSE": "'stage1.levels=[{{until:1.0,uv:64,image:0.5}}]' 'stage2.levels=[{{until:1.0,uv:64,image:0.5}}]'",
    "SMPLX": "body=smplx body.path={material}/SMPLX_NEUTRAL.npz",
    "SHORT": "--frames 8:40:10",
}


@dataclasses.dataclass(frozen=True)
class Task:
    """A command. name: GROUP/ENTRY. words: its command line, in which {work}, {material} and {shared} are filled in.
    output: what is read afterwards, below {work}. needs: names of the tasks whose output it uses."""

    name: str
    words: str
    output: str
    needs: tuple[str, ...]
    quick: bool


def all_tasks() -> list[Task]:
    """The rows of TASKS, each after those it needs."""
    tasks = []
    for row in TASKS.read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
        if not row or row.startswith("#"):
            continue
        group, entry, source, *rest = row.split(maxsplit=3)
        quick, group = not group.endswith("*"), group.rstrip("*")
        command, suffix = COMMANDS[group]
        output = f"{group}/{entry}{'' if '.' in entry else suffix}"
        words = " ".join([command.replace("SOURCE", source).replace("OUT", f"{{work}}/{output}"), *rest])
        for short, long in WORDS.items():
            words = re.sub(rf"\b{short}\b(?!_)", lambda _, long=long: long, words)
        used = re.findall(r"\{work\}/((?:train|export)/\w+)", words)
        needs = tuple(name for name in used if name != f"{group}/{entry}")
        tasks.append(Task(f"{group}/{entry}", words, output, needs, quick))
    return tasks


def chosen(patterns: list[str], quick: bool) -> tuple[list[Task], list[str]]:
    """The tasks whose names match, with all that they need, and the names of those that lack the files of SHARED."""
    tasks = [task for task in all_tasks() if task.quick or not quick]
    wanted = {task.name for task in tasks if any(fnmatch.fnmatch(task.name, p) for p in patterns)}
    for task in reversed(tasks):
        if task.name in wanted:
            wanted |= set(task.needs)
    tasks = [task for task in tasks if task.name in wanted]
    lacking = [task.name for task in tasks if "{shared}" in task.words and not SHARED.is_dir()]
    return [task for task in tasks if task.name not in lacking], lacking


def run(task: Task, work: Path, needed: list[Future]) -> dict[str, Any]:
    """What a task's command wrote, or why it failed under `failed`."""
    if any("failed" in other.result() for other in needed):
        return {"failed": f"for want of {', '.join(task.needs)}"}
    words = shlex.split(task.words.format(work=work, material=work / "material", shared=SHARED))
    (work / task.output).parent.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    done = subprocess.run([str(BIN / words[0]), *words[1:]], env=ENVIRONMENT, cwd=work, capture_output=True, text=True)
    found = {"failed": done.stderr.strip()[-500:]} if done.returncode else dict(contents(work / task.output))
    says = found["failed"] if done.returncode else f"{len(found)} values"
    print(f"{task.name:24}{time.perf_counter() - start:7.1f} s  {says}", file=sys.stderr)
    return found or {"failed": "nothing that can be read was written"}


def record(out: Path, quick: bool, only: list[str], work: Path, jobs: int) -> int:
    """Run all tasks in the folder `work` and write what came out to `out`; 1 if any failed, else 0."""
    from golden_material import write_material

    tasks, lacking = chosen(only, quick)
    if not tasks:
        raise SystemExit(f"no task is called {' or '.join(only)}: see {TASKS}")
    start = time.perf_counter()
    write_material(work / "material")
    futures: dict[str, Future] = {}
    with ThreadPoolExecutor(jobs) as pool:
        for task in tasks:
            futures[task.name] = pool.submit(run, task, work, [futures[name] for name in task.needs])
    results = {name: future.result() for name, future in futures.items()}
    for name in lacking:
        print(f"left out for want of {SHARED}: {name}", file=sys.stderr)
    about = {"quick": quick, "only": only, "left_out": lacking, "packages": packages(), "machine": machine()}
    part = out.with_name(out.name + ".part")
    part.write_text(json.dumps({"about": about, "results": results}, indent=0) + "\n", encoding="utf-8")
    part.replace(out)
    failed = [name for name, found in results.items() if "failed" in found]
    count = sum(map(len, results.values()))
    print(f"{out}: {count} values of {len(results)} tasks in {time.perf_counter() - start:.0f} s", file=sys.stderr)
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return int(bool(failed))


def packages() -> dict[str, str]:
    """Versions of what does the arithmetic."""
    return {name: importlib.metadata.version(name) for name in ("numpy", "torch", "onnxruntime", "onnx")}


def machine() -> str:
    """The processor's name, where the system tells it."""
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", info.read_text()) if info.exists() else None
    return found.group(1) if found else platform.processor()


def compare(before: dict, after: dict, only: list[str], shown: int = 20) -> int:
    """Print how many values of each group are equal, and the first that are not; 1 if there is any, else 0."""
    for key, value in before["about"].items():
        if after["about"].get(key) != value:
            print(f"note: {key} differs: {value} before, {after['about'].get(key)} after")
    counts: dict[str, Counter] = {}
    lines = []
    for task in dict.fromkeys([*before["results"], *after["results"]]):
        if not any(fnmatch.fnmatch(task, pattern) for pattern in only):
            continue
        old, new = before["results"].get(task, {}), after["results"].get(task, {})
        count = counts.setdefault(task.split("/")[0], Counter())
        places = {value: key for key, value in new.items() if key not in old and isinstance(value, str)}
        for key in dict.fromkeys([*old, *new]):
            kind = "missing" if key not in new else "new" if key not in old else "equal"
            if kind == "equal" and json.dumps(old[key]) != json.dumps(new[key]):
                kind = "differing"
            count[kind] += 1
            if kind != "equal":
                place = f" (its value now stands under {places[old[key]]})" if old.get(key) in places else ""
                lines.append(f"{kind:10}{task} {key}: {old.get(key, '-')} -> {new.get(key, '-')}{place}")
    kinds = ("equal", "differing", "missing", "new")
    print(f"{'group':10}" + "".join(f"{kind:>12}" for kind in kinds))
    for group, count in counts.items():
        print(f"{group:10}" + "".join(f"{count[kind]:12}" for kind in kinds))
    print("\n".join(lines[:shown]) + (f"\nand {len(lines) - shown} more" if len(lines) > shown else ""))
    if not counts:
        print("nothing was compared")
    return int(bool(lines) or not counts)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("record", help="run everything and write what came out")
    one.add_argument("out", type=Path, metavar="OUT.json")
    one.add_argument("--quick", action="store_true", help="without the demo and the trainings on the whole capture")
    one.add_argument(
        "--work", type=Path, metavar="DIR", help="new folder for what is written (default: a temporary one)"
    )
    one.add_argument("--jobs", type=int, default=2, metavar="N", help="commands at a time (default: 2)")
    two = commands.add_parser("compare", help="hold two recordings together")
    two.add_argument("before", type=Path, metavar="BEFORE.json")
    two.add_argument("after", type=Path, metavar="AFTER.json")
    for command in (one, two):
        command.add_argument(
            "--only",
            nargs="+",
            default=["*"],
            metavar="TASK",
            help="names or patterns of tasks: 'train/*' (default: all)",
        )
    a = parser.parse_args()
    if a.command == "compare":
        return compare(json.loads(a.before.read_text()), json.loads(a.after.read_text()), a.only)
    if not (BIN / "gavatar-train").exists():
        parser.error(
            f"{BIN} holds no gavatar-train: run this with the interpreter of an environment with gavatar in it"
        )
    a.out.parent.mkdir(parents=True, exist_ok=True)
    if a.work is not None:
        a.work.mkdir(parents=True)
        return record(a.out, a.quick, a.only, a.work.resolve(), a.jobs)
    with tempfile.TemporaryDirectory(prefix="gavatar-golden-") as work:
        return record(a.out, a.quick, a.only, Path(work), a.jobs)


if __name__ == "__main__":
    sys.exit(main())
