"""Damaged captures in other people's layouts: small ones are written once, and each case damages a copy of one.

    python tests/support/foreign_fuzz.py --cases 2500 --seed 7

prints how many cases of each layout ended in a result, in sentences, and in anything else, with the seeds of those.
"""

from __future__ import annotations

import argparse
import io
import pickle
import random
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path

import foreign_captures as write
import numpy as np
import torch

from gavatar.capture.check import check_capture
from gavatar.registry import load_plugins
from gavatar_runtime.errors import UserError

LAYOUTS = {
    "zju": lambda f: write.zju(f, frames=3),
    "neuman": lambda f: write.neuman(f, frames=4),
    "instantavatar": lambda f: write.instantavatar(f, frames=4),
    "upstream": lambda f: write.upstream(f, counts=(2, 1)),
    "upstream moving": lambda f: write.upstream(f, counts=(2, 1), moving=True),
}
ODD = [
    None,
    -1,
    0,
    10**12,
    10**30,
    1e308 * 10,
    float("nan"),
    True,
    "",
    "x" * 40,
    "a\\b",
    "..",
    "\0",
    [],
    {},
    [[]],
    b"y",
]


class Hang(Exception):
    """A case that takes too long."""


def write_all(folder: Path) -> Path:
    """Every layout in a folder of its own."""
    for name, writer in LAYOUTS.items():
        (folder / name).mkdir(parents=True)
        writer(folder / name)
    return folder


def damaged(r: random.Random, source: Path, folder: Path) -> Path:
    """A copy of one of `write_all`'s captures with one or two of its files damaged."""
    layout = source / r.choice(list(LAYOUTS))
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(layout, folder)
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    pictures = [p for p in files if p.suffix in (".png", ".jpg")]
    for _ in range(r.randrange(1, 3)):
        path = r.choice(
            pictures if pictures and r.random() < 0.15 else [p for p in files if p not in pictures] or files
        )
        if path.is_file():
            _damage(r, path)
    return folder


def _damage(r: random.Random, path: Path) -> None:
    kind = r.random()
    if kind < 0.04:
        path.unlink()
    elif kind < 0.07:
        path.rename(path.with_name(r.choice(["a b", "-1", "é", "00009"]) + path.suffix))
    elif kind < 0.09:
        path.unlink()
        path.mkdir()
    elif kind < 0.25:
        path.write_bytes(flipped(r, path.read_bytes()))
    else:
        try:
            {".npz": _npz, ".npy": _npy, ".pkl": _pkl, ".pth": _pth, ".txt": _txt}.get(path.suffix, _bytes)(r, path)
        except Exception:  # damaged before, so that it cannot be read to change something in it
            _bytes(r, path)


def flipped(r: random.Random, data: bytes) -> bytes:
    """Cut short, or with some bytes changed, all over or near the start."""
    if r.random() < 0.25:
        return data[: r.randrange(len(data) + 1)]
    changed, within = bytearray(data), r.choice([len(data), min(len(data), 200)])
    for _ in range(r.randrange(1, 20) if data else 0):
        changed[r.randrange(within)] = r.randrange(256)
    return bytes(changed)


def _bytes(r: random.Random, path: Path) -> None:
    path.write_bytes(flipped(r, path.read_bytes()))


def _npz(r: random.Random, path: Path) -> None:
    with np.load(path) as file:
        content = dict(file)
    mutated = mutate(r, content)
    arrays = mutated if isinstance(mutated, dict) else {}
    np.savez(path, **{str(k).replace("\0", "") or "k": _array(v) for k, v in arrays.items()})


def _array(value: object) -> np.ndarray:
    try:
        return np.asarray(value)
    except ValueError:
        return np.zeros(0)


def _npy(r: random.Random, path: Path) -> None:
    content = np.load(path, allow_pickle=True)
    content = content.item() if content.dtype == object else content
    mutated = mutate(r, content)
    np.save(path, mutated if isinstance(mutated, np.ndarray) else _boxed(mutated), allow_pickle=True)


def _boxed(value: object) -> np.ndarray:
    box = np.empty((), object)
    box[()] = value
    return box


def _pkl(r: random.Random, path: Path) -> None:
    path.write_bytes(pickle.dumps(mutate(r, pickle.loads(path.read_bytes()))))


def _pth(r: random.Random, path: Path) -> None:
    content = {k: v.numpy() for k, v in torch.load(path, weights_only=True).items()}
    mutated = mutate(r, content)
    if isinstance(mutated, dict):
        mutated = {k: _tensor(v) for k, v in mutated.items()}
    buffer = io.BytesIO()
    torch.save(mutated, buffer)
    path.write_bytes(buffer.getvalue())


def _tensor(value: object) -> object:
    try:
        return torch.from_numpy(np.ascontiguousarray(value))
    except (TypeError, ValueError):
        return value


def _txt(r: random.Random, path: Path) -> None:
    lines = path.read_text().split("\n")
    for _ in range(r.randrange(1, 3)):
        i = r.randrange(len(lines))
        words = lines[i].split(" ")
        kind = r.randrange(5)
        if kind == 0:
            words[r.randrange(len(words))] = r.choice(
                ["nan", "inf", "-1", "0", "1e400", "x", "", "../a.png", "\0", "9" * 500]
            )
        elif kind == 1:
            words.pop(r.randrange(len(words)))
        elif kind == 2:
            words = words + words
        elif kind == 3:
            words = lines[r.randrange(len(lines))].split(" ")
        else:
            words = []
        lines[i] = " ".join(words)
    path.write_text("\n".join(lines))


def mutate(r: random.Random, value: object) -> object:
    """The value with one member somewhere within it changed, dropped or of another kind."""
    if isinstance(value, dict | list) and value and r.random() < 0.9:
        copy = dict(value) if isinstance(value, dict) else list(value)
        key = r.choice(list(copy)) if isinstance(copy, dict) else r.randrange(len(copy))
        if r.random() < 0.1:
            copy.pop(key)
        else:
            copy[key] = mutate(r, copy[key])
        return copy
    if isinstance(value, np.ndarray) and r.random() < 0.8:
        return _mutated_array(r, value)
    return r.choice(ODD)


def _mutated_array(r: random.Random, x: np.ndarray) -> np.ndarray:
    changed = x.copy()
    if x.size and x.dtype.kind == "f":
        changed.reshape(-1)[r.randrange(x.size)] = r.choice([np.nan, np.inf, -np.inf, 1e38, 1e-40, 0])
    part = x[: r.randrange(len(x) + 1)] if x.ndim else x
    kinds = (np.float16, np.int8, np.complex64, bool, object, "U5")
    return r.choice([
        lambda: changed, lambda: changed, lambda: part, lambda: part[:0] if x.ndim else x, lambda: x.T, lambda: x[None],
        lambda: x.reshape(-1), lambda: np.zeros_like(x), lambda: x * 1e30, lambda: -x,
        lambda: x.astype(r.choice(kinds)), lambda: np.concatenate([x, x]) if x.ndim else x,
    ])()  # fmt: skip


def outcome(seed: int, source: Path, folder: Path) -> str:
    """'result', 'sentence', or what else came of a case, with the place."""
    r = random.Random(seed)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            capture = damaged(r, source, folder)
            faults = check_capture(capture).faults
            return (
                "sentence"
                if faults and all(f and "\n" not in f for f in faults)
                else "result"
                if not faults
                else "lines"
            )
        except UserError as error:
            return "sentence" if str(error) and "\n" not in str(error) else f"lines {error!r}"
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            return f"{type(error).__name__}: {str(error)[:120]} at {Path(last.filename).name}:{last.lineno}"


def run(cases: int, seed: int, limit: int = 0) -> tuple[Counter, list[tuple[int, str]]]:
    """How often each outcome came, and the seeds of those that are neither a result nor sentences. limit: seconds a
    case may take, 0 for any."""
    load_plugins()
    counts, bad = Counter(), []
    with tempfile.TemporaryDirectory() as home:
        source = write_all(Path(home) / "whole")
        for number in range(seed, seed + cases):
            signal.alarm(limit)
            found = outcome(number, source, Path(home) / "case")
            signal.alarm(0)
            kind = found if found in ("result", "sentence") else "other"
            counts[kind] += 1
            if kind == "other":
                bad.append((number, found))
    return counts, bad


def _hang(*_: object) -> None:
    raise Hang("20 seconds")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    signal.signal(signal.SIGALRM, _hang)
    totals, others = run(arguments.cases, arguments.seed, limit=20)
    print(dict(totals))
    for line in others:
        print(*line)
    sys.exit(bool(others))
