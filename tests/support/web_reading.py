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
        place = arrays["place"][:n].astype(np.float64) / 65535
        got = {
            "points": np.array(said["low"]) + np.array(said["span"]) * place[:, :3],
            "scales": said["scale"][0] + said["scale"][1] * place[:, 3],
            "colors": arrays["color"][:n, :3] / 255, "spacing": arrays["color"][:n, 3] / 255 * said["spacing"],
            **{k: arrays[k].swapaxes(0, 1)[:n].reshape(n, -1) for k in ("joints", "weights")},
            **{k: arrays[k][:n] for k in ("part",) if k in arrays},
        }  # fmt: skip
        if "basis" in arrays:  # layers of the texture: (groups 7, padded, 4)
            got["basis"] = arrays["basis"].reshape(-1, chunk["padded"], 4).swapaxes(0, 1)[:n]
        assert np.array_equal(np.sort(arrays["at"]), np.arange(n))
        for name, array in got.items():
            array = array[np.argsort(arrays["at"])]
            out.setdefault(name, []).append(array)
    return {name: np.concatenate(parts) for name, parts in out.items()}
