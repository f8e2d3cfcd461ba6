"""Reads what `web.web_data` packs, as the player in the page does: plain, and independent of it."""

from __future__ import annotations

import gzip
import json
from typing import Any

import numpy as np

KINDS = {"f4": "<f4", "u1": "u1", "i1": "i1", "u2": "<u2", "i4": "<i4"}


def read_bin(data: bytes) -> tuple[dict[str, Any], list[bytes]]:
    """Header and blocks of an `avatar.bin`."""
    assert data[:8] == b"GAVATWEB"
    end = 12 + int.from_bytes(data[8:12], "little")
    header = json.loads(data[12:end])
    blocks = []
    for entry in header["blocks"]:
        blocks.append(data[end : end + entry["size"]])
        end += entry["size"]
    assert end == len(data)
    return header, blocks


def arrays_of(entry: dict[str, Any], blocks: list[bytes]) -> dict[str, np.ndarray]:
    """The arrays that an entry's layout names."""
    data = gzip.decompress(blocks[entry["block"]])
    return {
        item["name"]: np.frombuffer(
            data, KINDS[item["kind"]], int(np.prod(item["shape"], dtype=int)), item["offset"]
        ).reshape(item["shape"])
        for item in entry["layout"]
    }


def points_of(header: dict[str, Any], blocks: list[bytes]) -> dict[str, np.ndarray]:
    """points, scales, spacing, colors, joints and weights (N, slots) of all chunks, in the progressive order."""
    said = header["points"]
    out: dict[str, list[np.ndarray]] = {}
    for chunk in said["chunks"]:
        arrays, n = arrays_of(chunk, blocks), chunk["count"]
        assert chunk["padded"] % 1024 == 0
        assert chunk["start"] == sum(map(len, out.get("points", [])))
        rows = {name: np.cumsum(a, 1, dtype=a.dtype).T for name, a in arrays.items() if name != "at"}
        place = rows["place"].astype(np.float64) / 65535
        got = {
            "points": np.array(said["low"]) + np.array(said["span"]) * place[:, :3],
            "scales": said["scale"][0] + said["scale"][1] * place[:, 3],
            "colors": rows["color"][:, :3] / 255, "spacing": rows["color"][:, 3] / 255 * said["spacing"],
            "joints": rows["joints"], "weights": rows["weights"],
        }  # fmt: skip
        if "basis" in rows:
            got |= {"part": rows["part"][:, 0], "basis": rows["basis"].reshape(n, -1, 4)}
        assert np.array_equal(np.sort(arrays["at"]), np.arange(n))
        for name, array in got.items():
            array = array[np.argsort(arrays["at"])]
            out.setdefault(name, []).append(array)
    return {name: np.concatenate(parts) for name, parts in out.items()}
