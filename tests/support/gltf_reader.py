"""A small reader of .glb from the text of glTF 2.0, which shares nothing with what writes them."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class ReadGlb:
    """document: the JSON. Everything else is computed from it and the buffer."""

    def __init__(self, document: dict[str, Any], buffer: bytes):
        self.document, self._buffer = document, buffer

    def accessor(self, index: int) -> np.ndarray:
        """(N, width), or (N,) of scalars; normalised whole numbers as fractions. Checks alignment, length, bounds."""
        accessor = self.document["accessors"][index]
        view = self.document["bufferViews"][accessor["bufferView"]]
        dtype, width = np.dtype(TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
        start, count = view.get("byteOffset", 0) + accessor.get("byteOffset", 0), accessor["count"]
        stride = view.get("byteStride", dtype.itemsize * width)
        assert count >= 1
        assert start % dtype.itemsize == 0
        assert view.get("byteOffset", 0) + view["byteLength"] <= len(self._buffer)
        assert accessor.get("byteOffset", 0) + (count - 1) * stride + dtype.itemsize * width <= view["byteLength"]
        rows = [np.frombuffer(self._buffer, dtype, width, start + i * stride) for i in range(count)]
        values = np.stack(rows)
        for bound, least in (("min", np.min), ("max", np.max)):
            if bound in accessor:
                np.testing.assert_array_equal(np.float32(accessor[bound]), np.float32(least(values, 0)))
        if accessor.get("normalized"):
            values = np.maximum(values / np.float64(np.iinfo(dtype).max), -1)
        return values[:, 0] if width == 1 else values

    def primitive(self) -> dict[str, np.ndarray]:
        """The arrays of the only mesh, by the names of its attributes."""
        ((primitive,),) = [mesh["primitives"] for mesh in self.document["meshes"]]
        return {name: self.accessor(index) for name, index in primitive["attributes"].items()}

    def animations(self) -> dict[str, dict[str, Any]]:
        return {animation["name"]: animation for animation in self.document.get("animations", ())}

    def skinned(self, animation: str | None, time: float) -> np.ndarray:
        """(N, 3) positions of the skinned mesh at a time of an animation, None for the nodes as they are."""
        nodes = [dict(node) for node in self.document["nodes"]]
        for channel in () if animation is None else self.animations()[animation]["channels"]:
            sampler = self.animations()[animation]["samplers"][channel["sampler"]]
            times, values = self.accessor(sampler["input"]), self.accessor(sampler["output"])
            target = channel["target"]
            nodes[target["node"]][target["path"]] = _sampled(times, values, time, target["path"] == "rotation")
        world = self._world(nodes)
        (node,) = [node for node in nodes if "mesh" in node]
        skin = self.document["skins"][node["skin"]]
        inverse = self.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2).astype(np.float64)
        joints = np.stack([world[joint] @ bind for joint, bind in zip(skin["joints"], inverse, strict=True)])
        arrays = self.primitive()
        points = np.column_stack([arrays["POSITION"], np.ones(len(arrays["POSITION"]))])
        out = np.zeros((len(points), 4))
        for n in range(sum(name.startswith("JOINTS_") for name in arrays)):
            for index, weight in zip(arrays[f"JOINTS_{n}"].T, arrays[f"WEIGHTS_{n}"].T, strict=True):
                out += weight[:, None] * np.einsum("nab,nb->na", joints[index], points)
        np.testing.assert_allclose(out[:, 3], 1, atol=1e-6)
        return out[:, :3]

    def _world(self, nodes: list[dict[str, Any]]) -> dict[int, np.ndarray]:
        """Every node below the scene, (4, 4) to the world; each has one parent."""
        world: dict[int, np.ndarray] = {}

        def visit(index: int, above: np.ndarray) -> None:
            assert index not in world
            node = nodes[index]
            local = np.eye(4)
            x, y, z, w = node.get("rotation", (0, 0, 0, 1))
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], np.float64)
            local[:3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
            local[:3, 3] = node.get("translation", (0, 0, 0))
            world[index] = above @ local
            for child in node.get("children", ()):
                visit(child, world[index])

        for root in self.document["scenes"][self.document["scene"]]["nodes"]:
            visit(root, np.eye(4))
        return world


def _sampled(times: np.ndarray, values: np.ndarray, time: float, rotation: bool) -> np.ndarray:
    """Linear between keys, on the sphere for rotations, constant beyond the ends."""
    i = int(np.clip(np.searchsorted(times, time, "right") - 1, 0, len(times) - 1))
    if i == len(times) - 1 or time <= times[i]:
        return values[i].astype(np.float64)
    a, b = values[i].astype(np.float64), values[i + 1].astype(np.float64)
    f = (time - times[i]) / (times[i + 1] - times[i])
    if not rotation:
        return a * (1 - f) + b * f
    dot = a @ b
    angle = np.arccos(min(1, abs(dot)))
    if angle < 1e-6:
        return a
    return (np.sin((1 - f) * angle) * a + np.sign(dot) * np.sin(f * angle) * b) / np.sin(angle)


def read_glb(content: bytes) -> ReadGlb:
    """The chunks of the file, their lengths and paddings checked."""
    magic, version, length = struct.unpack("<3I", content[:12])
    assert (magic, version, length) == (0x46546C67, 2, len(content))
    chunks, place = [], 12
    while place < length:
        size, kind = struct.unpack("<2I", content[place : place + 8])
        assert size % 4 == 0
        chunks.append((kind, content[place + 8 : place + 8 + size]))
        place += 8 + size
    assert [kind for kind, _ in chunks] == [0x4E4F534A, 0x004E4942][: len(chunks)]
    document = json.loads(chunks[0][1])
    buffer = chunks[1][1] if len(chunks) > 1 else b""
    assert [b["byteLength"] for b in document.get("buffers", [])] == ([len(buffer)] if buffer else [])
    return ReadGlb(document, buffer)
