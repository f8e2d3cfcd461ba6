"""Data are read by how a file begins, whatever it is called."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
import torch

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.data_file import load_data

ARRAY = np.arange(6, dtype=np.float32).reshape(2, 3)


def write(path, kind):
    if kind == "npz":
        with path.open("wb") as file:
            np.savez(file, a=ARRAY)
    elif kind == "npy":
        with path.open("wb") as file:
            np.save(file, {"a": ARRAY}, allow_pickle=True)
    elif kind == "torch":
        torch.save({"a": torch.from_numpy(ARRAY)}, path)
    elif kind == "torch of old":
        torch.save({"a": torch.from_numpy(ARRAY)}, path, _use_new_zipfile_serialization=False)
    elif kind.startswith("joblib"):
        pytest.importorskip("joblib").dump({"a": ARRAY}, path, compress=3 if "compressed" in kind else 0)
    elif kind == "json":
        path.write_text("\ufeff\n " + json.dumps({"a": ARRAY.tolist()}), encoding="utf-8")
    else:
        path.write_bytes(pickle.dumps({"a": ARRAY}, int(kind[-1])))
    return path


KINDS = (
    "npz", "npy", "torch", "torch of old", "joblib", "joblib compressed", "json", "pickle 0", "pickle 2", "pickle 4",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("suffix", [".npz", ".pkl", ".pth", ""])
def test_the_suffix_does_not_matter(tmp_path, kind, suffix):
    np.testing.assert_array_equal(load_data(write(tmp_path / f"a{suffix}", kind))["a"], ARRAY)


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"\0" * 100, b"{", b"[1, 2", b'{"a": }', b"[" * 100_000, b"\x80", b"PK"]
)
def test_what_is_nothing_of_the_kind_is_one_sentence(tmp_path, content):
    (tmp_path / "a.pkl").write_bytes(content)
    with pytest.raises(UserError, match=r"a\.pkl") as raised:
        load_data(tmp_path / "a.pkl")
    assert "\n" not in str(raised.value)


def test_a_missing_file_says_so(tmp_path):
    with pytest.raises(UserError, match=r"absent\.pkl cannot be read: No such file"):
        load_data(tmp_path / "absent.pkl")
