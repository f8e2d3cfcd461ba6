"""Damage to the bytes of files, as accidents and careless tools do it: one kind a function, by a seeded `Random`.

Every function takes the random numbers and what is whole, and returns the damaged bytes (or array); now and then it
comes out whole. What is damaged in which way depends on the seed alone.
"""

from __future__ import annotations

import copy
import io
import json
import re
import zipfile
from random import Random
from typing import Any

import numpy as np

BVH_LINES = (
    "", "}", "{", "JOINT x", "CHANNELS 7 a b", "OFFSET nan 0 0", "Frames: -3", "Frames: 99999999999", "Frame Time: 0",
    "Frame Time: nan",
)  # fmt: skip
OTHER_KINDS = (np.float16, np.float64, np.int32, np.uint8, np.int64, np.complex64, "U5")
CLAIMED_SIZES = (b"999999999999", b"40000000", b"0", b"-1", b"1")


def damaged_file(r: Random, name: str, data: bytes) -> bytes:
    """Damage of the kind that the suffix of `name` is open to."""
    if name.endswith(".json"):
        return damaged_json(r, data)
    if name.endswith(".npz"):
        return damaged_npz(r, data)
    if name.endswith(".onnx") and r.random() < 0.7:
        return damaged_graph(r, data)
    if name.endswith(".bvh"):
        return damaged_text(r, data)
    return flipped(r, data)


def flipped(r: Random, data: bytes) -> bytes:
    """Cut short, or with some bytes replaced, of all or of the first 400."""
    kind = r.randrange(4)
    if kind == 0:
        return data[: r.randrange(len(data) + 1)]
    out = bytearray(data)
    for _ in range(r.randrange(1, 20)):
        if out:
            out[r.randrange(len(out) if kind != 3 else min(400, len(out)))] = r.randrange(256)
    return bytes(out)


def damaged_json(r: Random, data: bytes) -> bytes:
    """One or two values somewhere in the tree left out or replaced."""
    root = json.loads(data)
    for _ in range(r.randrange(1, 3)):
        node, place = root, None
        while isinstance(node, (dict, list)) and node and r.random() < 0.75:
            key = r.choice(list(node)) if isinstance(node, dict) else r.randrange(len(node))
            place, node = (node, key), node[key]
        if place is None:
            continue
        parent, key = place
        if r.random() < 0.2 and isinstance(parent, dict):
            parent.pop(key, None)
        else:
            parent[key] = _other_value(r, copy.deepcopy(node))
    return json.dumps(root).encode()


def _other_value(r: Random, value: Any) -> Any:
    fixed = [None, -1, 10**12, "x" * 50, [], {}, [value, value], 0, float("inf"), float("nan"), True]
    kind = r.randrange(len(fixed) + 3)
    if kind < len(fixed):
        return fixed[kind]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value * r.choice([-1, 0.5, 1e6, 1e-9])
    if isinstance(value, list) and value:
        value.pop(r.randrange(len(value)))
    elif isinstance(value, str):
        value += r.choice(["\0", "/../..", "é", "%n", ""])
    return value


def damaged_npz(r: Random, data: bytes) -> bytes:
    """One or two arrays left out or damaged; sometimes bytes of the file too, or a size that a header claims."""
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = dict(file)
    for _ in range(r.randrange(1, 3)):
        if not arrays:
            break
        name = r.choice(list(arrays))
        if r.random() < 0.12:
            arrays.pop(name)
        else:
            arrays[name] = damaged_array(r, arrays[name])
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    chance = r.random()
    if chance < 0.15:
        return flipped(r, buffer.getvalue())
    return lying_header(r, buffer.getvalue()) if chance < 0.25 else buffer.getvalue()


def lying_header(r: Random, data: bytes) -> bytes:
    """An .npz one of whose arrays claims another size than it has."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        members = {name: file.read(name) for name in file.namelist()}
    if not members:
        return data
    name = r.choice(list(members))
    size = r.choice(CLAIMED_SIZES)
    head, rest = members[name][:128], members[name][128:]
    members[name] = re.sub(rb"\((\d*)", b"(" + size, head, count=1)[:128].ljust(128) + rest
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        for name, content in members.items():
            file.writestr(name, content)
    return buffer.getvalue()


def damaged_array(r: Random, x: np.ndarray) -> np.ndarray:
    """Another value, kind, shape, order or size, whichever fits the array; else the array as it is."""
    x = np.array(x)
    rng = np.random.default_rng(r.randrange(2**31))
    number, whole, real = x.dtype.kind in "fiu", x.dtype.kind in "iu", x.dtype.kind == "f"
    kind = r.randrange(13)
    if kind == 0 and number and x.size:
        return _one_entry(rng, x, r.choice(_extremes(x.dtype)))
    if kind == 1 and real and x.size:
        return _one_entry(rng, x, r.choice([np.nan, np.inf, -np.inf, 3e38, 1e-40]))
    if kind == 2 and x.ndim:
        return x[: r.randrange(len(x) + 1)]
    if kind == 3 and x.ndim:
        return np.concatenate([x, x])
    if kind == 5 and number:
        return x.astype(r.choice(OTHER_KINDS))
    if kind == 9 and number:
        return np.full_like(x, r.choice([127, 1])) if whole else (x * 1e30).astype(x.dtype)
    if kind == 11 and whole and x.size:
        return rng.permutation(x.reshape(-1)).reshape(x.shape)
    if kind == 12 and whole and x.size:
        return (x.astype(np.int64) + r.choice([1, -1, 1000, -1000])).astype(x.dtype)
    always = {
        4: lambda: x.T,
        6: lambda: np.zeros_like(x),
        7: lambda: x.reshape(-1),
        8: lambda: x[None],
        10: lambda: np.zeros((0, *x.shape[1:]), x.dtype),
    }
    return always[kind]() if kind in always else x


def _extremes(dtype: np.dtype) -> list[float]:
    if dtype.kind == "f":
        return [0.0, -1.0, 1e4]
    info = np.iinfo(dtype)
    return [0, int(info.min), int(info.max), max(-1, int(info.min)), 127]


def _one_entry(rng: np.random.Generator, x: np.ndarray, value: float) -> np.ndarray:
    flat = x.reshape(-1).copy()
    with np.errstate(over="ignore"):
        flat[rng.integers(flat.size)] = np.asarray(value).astype(x.dtype)
    return flat.reshape(x.shape)


def damaged_graph(r: Random, data: bytes) -> bytes:
    """An ONNX model that still parses: a constant, an operator, a name or a declared shape is another."""
    import onnx
    from onnx import numpy_helper

    model = onnx.load_from_string(data)
    graph, kind = model.graph, r.randrange(6)
    if kind <= 1 and graph.initializer:
        constant = r.choice(graph.initializer)
        array = damaged_array(r, numpy_helper.to_array(constant))
        if array.dtype.kind in "fiu":
            constant.CopyFrom(numpy_helper.from_array(np.ascontiguousarray(array), constant.name))
    elif kind == 2 and graph.node:
        r.choice(graph.node).op_type = r.choice(["Add", "Relu", "Identity", "MatMul", "Nonsense", "Sqrt"])
    elif kind == 3 and graph.node:
        del graph.node[r.randrange(len(graph.node))]
    elif kind == 4:
        r.choice([*graph.input, *graph.output]).name += "_"
    else:
        dims = r.choice([*graph.input, *graph.output]).type.tensor_type.shape.dim
        if dims:
            r.choice(dims).dim_value = r.choice([0, 1, 7, 10**9])
    return model.SerializeToString()


def damaged_text(r: Random, data: bytes) -> bytes:
    """A BVH file with a line lost, doubled, replaced or spoilt, cut short, or with other bytes."""
    lines = data.decode("latin1").split("\n")
    i, kind = r.randrange(min(len(lines), 300)), r.randrange(8)
    if kind == 0:
        lines.pop(i)
    elif kind == 1:
        lines.insert(i, r.choice(lines))
    elif kind == 2:
        lines[i] = r.choice(BVH_LINES)
    elif kind == 3:
        lines[-r.randrange(1, min(50, len(lines)))] += " nan"
    elif kind == 4:
        lines = lines[: r.randrange(len(lines))]
    elif kind == 5:
        lines[i] = lines[i].replace(" ", "\t").upper()
    elif kind == 6:
        lines = [line.replace("Zrotation", "Xrotation") for line in lines]
    else:
        return flipped(r, data)
    return "\n".join(lines).encode("latin1")
