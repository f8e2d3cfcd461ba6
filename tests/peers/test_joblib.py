"""Files of joblib against our reader that runs nothing."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.joblib_file import load_joblib

joblib = pytest.importorskip("joblib")


def test_what_joblib_writes_is_what_we_read(tmp_path):
    rng = np.random.default_rng(0)
    content = {
        1: {
            "pose": rng.normal(size=(5, 72)).astype(np.float32), "betas": np.asfortranarray(rng.normal(size=(5, 10))),
            "ids": np.arange(3), "empty": np.zeros((0, 4)), "name": "x", "list": [np.ones(2), 3.5],
        }
    }  # fmt: skip
    joblib.dump(content, tmp_path / "a.pkl")
    mine, theirs = load_joblib(tmp_path / "a.pkl")[1], joblib.load(tmp_path / "a.pkl")[1]
    for key in ("pose", "betas", "ids", "empty"):
        np.testing.assert_array_equal(mine[key], theirs[key])
        assert mine[key].dtype == theirs[key].dtype
    np.testing.assert_array_equal(mine["list"][0], np.ones(2))
    assert (mine["name"], mine["list"][1]) == ("x", 3.5)


@pytest.mark.parametrize("compress", [("zlib", 3), ("gzip", 3), ("bz2", 3), ("lzma", 1), ("xz", 1), 9, True])
@pytest.mark.parametrize("kind", ["small", "big"])
def test_compressed_files_are_unpacked(tmp_path, compress, kind):
    size = 10 if kind == "small" else 200_000
    content = {"a": np.arange(size, dtype=np.float32), "rows": [np.ones(3), {"b": np.array([{"c": 1}], object)}]}
    joblib.dump(content, tmp_path / "a.pkl", compress=compress)
    mine = load_joblib(tmp_path / "a.pkl")
    np.testing.assert_array_equal(mine["a"], content["a"])
    assert mine["rows"][1]["b"][0] == {"c": 1}
    whole = (tmp_path / "a.pkl").read_bytes()
    (tmp_path / "cut.pkl").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UserError, match=r"cut\.pkl"):
        load_joblib(tmp_path / "cut.pkl")


def test_a_file_that_unpacks_without_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("gavatar_runtime.formats.joblib_file.MOST_UNPACKED", 1 << 20)
    joblib.dump({"a": np.zeros(1 << 20, np.float32)}, tmp_path / "a.pkl", compress=3)
    with pytest.raises(UserError, match=r"a\.pkl unpacks to more than"):
        load_joblib(tmp_path / "a.pkl")
    (tmp_path / "lz4.pkl").write_bytes(b"\x04\x22\x4d\x18" + b"x" * 50)
    with pytest.raises(UserError, match="compressed with lz4"):
        load_joblib(tmp_path / "lz4.pkl")


def test_a_hostile_joblib_file_is_refused(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "exploded"), "w"))

    for content in ({"a": Bomb()}, {"a": np.array([Bomb()], object)}):
        joblib.dump(content, tmp_path / "b.pkl")
        with pytest.raises(UserError, match=r"b\.pkl"):
            load_joblib(tmp_path / "b.pkl")
    assert not (tmp_path / "exploded").exists()


def test_a_neuman_capture_whose_poses_joblib_wrote_opens(tmp_path):
    import foreign_captures

    from gavatar.capture.opening import open_capture
    from gavatar.registry import load_plugins

    load_plugins()
    expected = foreign_captures.neuman(tmp_path, dump=joblib.dump)
    capture = open_capture(tmp_path).placed(expected["body"])
    posed, _ = expected["body"].posed(
        capture.motion.poses[2].astype(float), capture.motion.betas, capture.motion.trans[2]
    )
    from gavatar.capture.capture import View

    pixels = capture.camera(View("cam0", 2)).project(posed)[:, :2]
    np.testing.assert_allclose(pixels, expected["pixels"]["cam0", 2], atol=2e-3)  # as in test_foreign_captures.py
