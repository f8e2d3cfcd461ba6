"""Damaged captures in other people's layouts end in a result or in sentences (`foreign_fuzz` runs as many as asked)."""

from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
from foreign_fuzz import run
from tiny_capture import write_tiny_capture

from gavatar.capture.capture import read_capture
from gavatar.capture.check import check_capture
from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.numpy_file import load_npy, load_npz


def test_damaged_captures_end_in_a_result_or_in_sentences():
    counts, others = run(60, seed=1)
    assert others == []
    assert counts["sentence"] > 30  # most cases are damaged where it matters
    assert counts["result"] > 0


def damaged_header(path, change):
    np.save(path, np.arange(12.0))
    data = path.read_bytes()
    path.write_bytes(change(data))


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.replace(b"{'descr'", b"{'descr\n"),
        lambda data: data.replace(b"'<f8'", b"'<f8\\"),
        lambda data: data.replace(b"(12,)", b"(((( "),
        lambda data: data.replace(b"(12,)", b"(-1,)"),
        lambda data: data.replace(b"False", b"Fal\x00e"),
        lambda data: data[:9],
    ],
)
def test_a_damaged_header_of_an_array_is_one_sentence(tmp_path, change):
    damaged_header(tmp_path / "a.npy", change)
    with pytest.raises(UserError, match=r"a\.npy is damaged") as raised:
        load_npy(tmp_path / "a.npy")
    assert "\n" not in str(raised.value)


def test_a_size_that_the_file_does_not_have_takes_no_memory(tmp_path):
    """80 TB by the header: refused before they are asked for."""
    with (tmp_path / "a.npy").open("wb") as file:
        header = {"descr": "<f8", "fortran_order": False, "shape": (9999999999999,)}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(96))
    with pytest.raises(UserError, match="states 79999999999992 bytes of values, but 96 follow"):
        load_npy(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("poses.npy", (tmp_path / "a.npy").read_bytes())
    with pytest.raises(UserError, match=r"a\.npz is damaged .*but 96 follow"):
        load_npz(tmp_path / "a.npz")


@pytest.mark.parametrize("number", ["1e999", "-Infinity", "NaN", "1.5", '"x"', "[0]", "null"])
def test_frame_numbers_that_are_no_whole_numbers_are_one_sentence(tmp_path, number):
    tiny = write_tiny_capture(tmp_path / "tiny")
    info = json.loads((tiny / "capture.json").read_text())
    info["splits"]["test"] = [["cam0", ["HERE"]]]
    (tiny / "capture.json").write_text(json.dumps(info).replace('"HERE"', number))
    with pytest.raises(UserError, match=r"split 'test' must be a list.*whole numbers"):
        read_capture(tiny)


@pytest.mark.parametrize("content", ["[" * 100000, '{"version": ' + "9" * 5000 + "}", "\udcff"])
@pytest.mark.parametrize("name", ["capture.json", "cameras.json"])
def test_json_that_python_cannot_hold_is_one_sentence(tmp_path, name, content):
    tiny = write_tiny_capture(tmp_path / "tiny")
    (tiny / name).write_bytes(content.encode("utf-8", "surrogateescape"))
    faults = check_capture(tiny).faults
    assert len(faults) == 1
    assert f"{name} is not valid JSON" in faults[0]
