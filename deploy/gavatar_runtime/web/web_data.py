"""An avatar as the web player reads it: a header and gzipped blocks, in one file.

`avatar.bin` is MAGIC, the header's length (uint32, little endian), the header (JSON) and the blocks one after another.
The header's `blocks` has the size of each; whatever lies in a block is listed beside its number as a `layout`: name,
kind (`f4`, `u1`, `i1`, `u2`, `i4`: little endian), shape and offset. Gaussians come in chunks whose texels fill whole
rows of a texture WIDTH wide; each chunk is the next part of their progressive order (`Surface.rank`) and makes the
whole avatar denser. In a chunk neighbours on the body stand side by side and each number is stored as its difference to
the neighbour's before it, which compresses better; `at` is the row of the progressive order that each Gaussian has.

Positions and scales are 16-bit numbers between the bounds in the header, colours, skinning weights and spacings 8-bit.
"""

from __future__ import annotations

import dataclasses
import gzip
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .. import splatting_rule as rule
from ..decoding.detail import SPREAD
from ..tiers.members import BLENDSHAPE
from ..values.motion import Motion
from .look import StillLook

MAGIC = b"GAVATWEB"
VERSION = 2
WIDTH = 1024  # texels in a row of the player's textures
FIRST_ROWS = 8  # of the first chunk, which shows at once; each further one is as large as all before
SLOTS = 4  # joints a texel
LEVEL = 6  # of gzip: 9 takes four times as long for one percent


@dataclasses.dataclass(frozen=True)
class Packed:
    """header: of JSON values. blocks: gzipped, by number."""

    header: dict[str, Any]
    blocks: tuple[bytes, ...]

    def to_bytes(self) -> bytes:
        """The whole `avatar.bin`."""
        header = json.dumps(self.header, separators=(",", ":"), allow_nan=False).encode()
        return b"".join((MAGIC, len(header).to_bytes(4, "little"), header, *self.blocks))


class _Blocks:
    """Blocks as they are made."""

    def __init__(self) -> None:
        self.made: list[bytes] = []

    def add(self, arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Where the arrays went: {block, layout}."""
        layout, data = [], bytearray()
        for name, array in arrays.items():
            array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
            data.extend(bytes(-len(data) % 4))
            kind = f"{array.dtype.kind}{array.dtype.itemsize}"
            layout.append({"name": name, "kind": kind, "shape": list(array.shape), "offset": len(data)})
            data.extend(array.tobytes())
        self.made.append(gzip.compress(bytes(data), LEVEL, mtime=0))
        return {"block": len(self.made) - 1, "layout": layout}


def pack(look: StillLook, motions: Sequence[Motion]) -> Packed:
    """motions: fitted to the body, the first one plays at the start; their names are told apart already."""
    blocks = _Blocks()
    head = _look(look, blocks)
    points = _Points.of(look, head)
    chunks = [points.chunk(start, count) for start, count in _chunks(len(look))]
    listed = [_chunk_entry(chunk, blocks) for chunk in chunks[:1]]
    moving = [_motion(motion, blocks) for motion in motions]
    listed += [_chunk_entry(chunk, blocks) for chunk in chunks[1:]]
    header = {
        "format": "gavatar-web", "version": VERSION, "name": look.name, "tier": look.tier, "notes": list(look.notes),
        "pixel": look.pixel, "relaxed": _numbers(look.relaxed),
        "joints": {
            "names": list(look.joint_names), "parents": [int(p) for p in look.parents], "rest": _numbers(look.rest),
            "inverse": _numbers(look.inverse),
        },
        "points": {**points.bounds, "count": len(look), "slots": points.joints.shape[1], "chunks": listed},
        "look": head, "motions": moving,
        "rule": {
            "low_pass": rule.LOW_PASS, "alpha_max": rule.ALPHA_MAX, "alpha_min": rule.ALPHA_MIN, "near": rule.NEAR,
            "frustum_margin": rule.FRUSTUM_MARGIN,
        },
        "blocks": [{"size": len(block)} for block in blocks.made],
    }  # fmt: skip
    return Packed(header, tuple(blocks.made))


def _numbers(array: np.ndarray) -> list[float]:
    """Flat, as short as float32 can be told."""
    return [float(f"{x:.8g}") for x in np.asarray(array, np.float64).ravel()]


def _chunks(count: int) -> list[tuple[int, int]]:
    """(start, count) of chunks of whole rows, the last one's cut."""
    starts, size = [0], FIRST_ROWS * WIDTH
    while starts[-1] + size < count:
        starts.append(starts[-1] + size)
        size = starts[-1]
    return list(zip(starts, np.diff([*starts, count]).tolist(), strict=True))


def _look(look: StillLook, blocks: _Blocks) -> dict[str, Any] | None:
    """Of the residual: how many parts and groups of four bases it has, and the arrays that weigh them."""
    if look.residual is None:
        return None
    per_point = ("part", "basis")
    weighing = {name: a for name, a in look.residual.items() if name not in per_point}
    weighing = {name: _small(a) for name, a in weighing.items()}
    groups = look.residual["basis"].shape[1]
    return {"parts": len(look.residual["gains"]), "groups": groups, **blocks.add(weighing), "member": BLENDSHAPE.file}


def _small(array: np.ndarray) -> np.ndarray:
    return array.astype(np.int32 if array.dtype.kind in "iu" else np.float32)


@dataclasses.dataclass(frozen=True, eq=False)
class _Points:
    """All Gaussians, chunk by chunk; rank: places in the progressive order; bounds: what turns their numbers into
    metres."""

    rank: np.ndarray
    place: np.ndarray
    color: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    part: np.ndarray | None
    basis: np.ndarray | None
    bounds: dict[str, Any]

    @classmethod
    def of(cls, look: StillLook, head: dict[str, Any] | None) -> _Points:
        # a bundle's own order follows the surface: it is kept within each chunk
        ranked = np.argsort(look.rank)
        order = np.concatenate([np.sort(ranked[start : start + count]) for start, count in _chunks(len(look))])
        low, high = look.points.min(0).astype(np.float64), look.points.max(0).astype(np.float64)
        least, most = float(look.scales.min()), float(look.scales.max())
        widest = max(float(look.spacing.max()), 1e-9)
        place = np.empty((len(look), 4), np.uint16)
        place[:, :3] = _quantised(look.points, low, high, 65535)
        place[:, 3] = _quantised(look.scales, least, most, 65535)
        color = np.empty((len(look), 4), np.uint8)
        color[:, :3] = np.rint(np.clip(look.colors, 0, 1) * 255)
        color[:, 3] = _quantised(look.spacing, 0.0, widest, 255)
        joints, weights = _skinning(look.joint_index, look.joint_weight)
        part = basis = None
        if look.residual is not None and head is not None:
            part = look.residual["part"].astype(np.uint8)[order]
            # of each Gaussian (groups, 8, 4): a layer of the texture is one group's channel, and the eighth is padding
            basis = look.residual["basis"][order][:, :, :7].reshape(len(look), head["groups"] * 7, 4)
        bounds = {
            "low": low.tolist(), "span": (high - low).tolist(), "scale": [least, most - least], "spacing": widest,
            "spread": SPREAD,
        }  # fmt: skip
        return cls(look.rank[order], place[order], color[order], joints[order], weights[order], part, basis, bounds)

    def chunk(self, start: int, count: int) -> dict[str, Any]:
        """{start, count, padded, arrays}; padded: count up to whole rows of the textures."""
        rows = slice(start, start + count)
        stored = {"place": self.place, "color": self.color, "joints": self.joints, "weights": self.weights}
        if self.part is not None and self.basis is not None:
            stored |= {"part": self.part, "basis": self.basis}
        arrays = {name: _differences(array[rows]) for name, array in stored.items()}
        arrays["at"] = (self.rank[rows] - start).astype(np.int32)
        return {"start": start, "count": count, "padded": -(-count // WIDTH) * WIDTH, "arrays": arrays}


def _chunk_entry(chunk: dict[str, Any], blocks: _Blocks) -> dict[str, Any]:
    return {name: chunk[name] for name in ("start", "count", "padded")} | blocks.add(chunk["arrays"])


def _motion(motion: Motion, blocks: _Blocks) -> dict[str, Any]:
    arrays = {"poses": motion.poses.astype(np.float32), "trans": motion.trans.astype(np.float32)}
    return {"name": motion.name, "fps": float(motion.fps), **blocks.add(arrays)}


def _quantised(values: np.ndarray, low: Any, high: Any, steps: int) -> np.ndarray:
    span = np.maximum(np.asarray(high, np.float64) - low, np.finfo(np.float64).tiny)
    return np.rint((values - np.asarray(low, np.float64)) / span * steps)


def _skinning(index: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 4 k) uint8 joints and weights that sum to 255 to the last one, the heaviest first."""
    slots = -(-index.shape[1] // SLOTS) * SLOTS
    order = np.argsort(-weight, 1, kind="stable")
    index, weight = np.take_along_axis(index, order, 1), np.take_along_axis(weight, order, 1)
    exact = weight / np.maximum(weight.sum(1, keepdims=True), np.finfo(np.float32).tiny) * 255
    whole = np.floor(exact)
    # the largest remainders are rounded up until the sum is right
    owed = np.rint(255 - whole.sum(1)).astype(np.int64)
    rank = np.argsort(np.argsort(-(exact - whole), 1, kind="stable"), 1)
    whole += rank < owed[:, None]
    joints, weights = (np.zeros((len(index), slots), np.uint8) for _ in range(2))
    joints[:, : index.shape[1]], weights[:, : index.shape[1]] = index, whole
    while slots > SLOTS and not weights[:, slots - SLOTS :].any():
        slots -= SLOTS
    return np.ascontiguousarray(joints[:, :slots]), np.ascontiguousarray(weights[:, :slots])


def _differences(array: np.ndarray) -> np.ndarray:
    """(numbers a Gaussian, N) of (N, ...): each number less that of the Gaussian before it, modulo its type."""
    planes = array.reshape(len(array), -1).T
    return np.diff(planes, axis=1, prepend=planes.dtype.type(0))
