"""Pickles: arrays of every protocol come out as they went in, and nothing that is not data goes through."""

from __future__ import annotations

import builtins
import collections
import contextlib
import os
import pickle
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from fake_chumpy import Ch, Select, python2_pickle

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.numpy_file import load_npz
from gavatar_runtime.formats.pickled_values import Unread
from gavatar_runtime.formats.safe_pickle import load_pickle, loads

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)

ARRAYS = {
    "matrix": np.arange(6.0).reshape(2, 3),
    "fortran, big-endian": np.asfortranarray(np.arange(6, dtype=">i4").reshape(2, 3)),
    "empty": np.zeros((0, 3)),
    "no axis": np.array(2.5),
    "float16 with NaN and infinity": np.array([np.nan, np.inf, -0.0, 65504], np.float16),
    "bool": np.array([True, False]),
    "unsigned": np.array([0, 4294967295], np.uint32),
    "text": np.array(["left_hip", "Ω"]),
    "bytes": np.array([b"a", b"bc"]),
    "a view": np.arange(20)[::3],
}


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_come_out_as_they_went_in(name, protocol):
    expected = ARRAYS[name]
    got = loads(pickle.dumps({"a": expected, "again": expected}, protocol))["a"]
    np.testing.assert_array_equal(got, expected)
    assert got.dtype == expected.dtype


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_plain_values_and_numpy_scalars(protocol):
    values = {
        "text": "Ω", "bytes": b"\x00\xff", "none": None, "empty": b"", "number": 3, "long": 1 << 70, "real": 2.5,
        "complex": 1j, "nested": [(1, {2}), {"a": [np.float32(0.5), np.int64(7)]}], "frozen": frozenset("ab"),
        "buffer": bytearray(b"xyz"),
    }  # fmt: skip
    assert loads(pickle.dumps(values, protocol)) == values


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("form", ["csc", "csr", "coo"])
def test_sparse_matrices_become_dense(form, protocol):
    sparse = pytest.importorskip("scipy.sparse")
    dense = np.random.default_rng(0).random((5, 30)) * (np.random.default_rng(1).random((5, 30)) < 0.2)
    for matrix in (getattr(sparse, f"{form}_matrix")(dense), getattr(sparse, f"{form}_matrix")((4, 0))):
        got = loads(pickle.dumps(matrix, protocol))
        np.testing.assert_array_equal(got, matrix.toarray())


def test_chumpy_arrays_as_python_2_wrote_them():
    content = {"shapedirs": Ch(np.arange(6.0).reshape(1, 3, 2)), "part": Select(Ch(np.arange(6.0)), [4, 1], (1, 2))}
    got = loads(python2_pickle(content))
    np.testing.assert_array_equal(got["shapedirs"], np.arange(6.0).reshape(1, 3, 2))
    np.testing.assert_array_equal(got["part"], [[4, 1]])


def test_object_arrays_hold_data_only():
    np.testing.assert_array_equal(
        loads(pickle.dumps(np.array([1, "a", None], object))), np.array([1, "a", None], object)
    )
    with pytest.raises(UserError, match="not data"):
        loads(pickle.dumps(np.array([os.system], object)))


class Calls:
    """Pickles as a call of `function` with `arguments`."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def marker_calls(path: str):
    """Ways to leave a trace at `path`, as attackers write them."""
    code = f"open({path!r}, 'w').close()"
    return {
        "os.system": Calls(os.system, f"touch {path}"),
        "exec": Calls(builtins.exec, code),
        "eval": Calls(builtins.eval, f"open({path!r}, 'w')"),
        "open": Calls(builtins.open, path, "w"),
        "subprocess": Calls(subprocess.check_output, ["touch", path]),
        "getattr": Calls(builtins.getattr, "", "join"),
        "import": Calls(builtins.__import__, "os"),
        "numpy.load": Calls(np.load, path, None, True),
        "within a list": [Calls(os.system, f"touch {path}")],
        "as a key": {Calls(os.system, f"touch {path}"): 1},
        "ordered dict": collections.OrderedDict(a=Calls(os.system, f"touch {path}")),
    }


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("name", marker_calls(""))
def test_no_call_goes_through(name, protocol, tmp_path):
    mark = tmp_path / "ran"
    data = pickle.dumps(marker_calls(str(mark))[name], protocol)
    with pytest.raises(UserError, match="not data"):
        loads(data)
    assert not mark.exists()


HOSTILE_STREAMS = {
    "a dotted name behind a known module": b"cnumpy\nndarray.__reduce__\n.",
    "a submodule by a dotted name": b"\x80\x04\x8c\x05numpy\x8c\x09os.system\x93.",
    "an instance by INST": b"(S'touch x'\nios\nsystem\n.",
    "an instance by OBJ": b"(cos\nsystem\nS'touch x'\no.",
    "a persistent id": b"Phere\n.",
    "an extension": b"\x82\x01.",
    "state for a function": b"c_codecs\nencode\n}S'__globals__'\nI1\nsb.",
    "state for a class": b"cchumpy.ch\nCh\n(N}S'value'\nI1\nstb.",
    "another encoding": b"c_codecs\nencode\n(Vx\nVrot13\ntR.",
    "a reconstruction of object": b"ccopy_reg\n_reconstructor\n(c__builtin__\nobject\nc__builtin__\nobject\nNtR.",
}


@pytest.mark.parametrize("name", HOSTILE_STREAMS)
def test_hand_made_streams_are_refused(name):
    with pytest.raises(UserError, match="not data"):
        loads(HOSTILE_STREAMS[name])
    assert loads(pickle.dumps(np.ones(2))).sum() == 2  # and nothing of it stays behind


def nest(levels: int, make) -> bytes:
    """`levels` containers, each holding the former twice: exponential if what is shared were multiplied out."""
    value = make(None)
    for _ in range(levels):
        value = make(value)
    return pickle.dumps(value, 4)


def reconstruct(shape: str, content: bytes) -> bytes:
    dtype = b"cnumpy\ndtype\n(S'f8'\nI0\nI1\ntR(I3\nS'<'\nNNNI-1\nI-1\nI0\ntb"
    array = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR"
    return array + b"(I1\n(" + shape.encode() + b"t" + dtype + b"I00\nS'" + content + b"'\ntb."


DAMAGED_STREAMS = {
    "nothing": b"",
    "text": b"hello",
    "cut short": pickle.dumps(np.arange(1000.0))[:-40],
    "a huge length": b"\x80\x04\x8e" + struct.pack("<Q", 1 << 60) + b"x.",
    "a huge bytearray": b"\x80\x05\x96" + struct.pack("<Q", 1 << 36) + b"x.",
    "a bytearray by length": b"c__builtin__\nbytearray\n(I68719476736\ntR.",
    "a huge array": reconstruct("I4611686018427387904\nI8\n", b"x"),
    "a negative shape": reconstruct("I-1\nI-8\n", b"12345678"),
    "content of another length": reconstruct("I3\n", b"12345678"),
    "a list in a circle": b"\x80\x02]q\x00h\x00a.",
    "a class as the value": b"cnumpy\ndtype\n.",
    "an array never filled": b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR.",
    "deep nesting": b"\x80\x02" + b"]" * 200000 + b"a" * 199999 + b".",
    "a matrix larger than memory": b"cscipy.sparse.csc\ncsc_matrix\n)\x81}(S'_shape'\n(I1" + b"0" * 9 + b"\nI9\ntub.",
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGED_STREAMS)
def test_damaged_and_bloated_streams_end_soon_in_one_sentence(name):
    start = time.monotonic()
    with pytest.raises(UserError) as error:
        loads(DAMAGED_STREAMS[name], "model.pkl")
    assert "model.pkl" in str(error.value)
    assert "\n" not in str(error.value)
    assert time.monotonic() - start < 5


def test_odd_but_harmless_streams_cost_nothing():
    start = time.monotonic()
    assert loads(b"\x80\x02]r\xff\xff\xff\x7f.") == []  # a memo entry far out, which the C machine would make room for
    doubled = loads(nest(90, lambda v: [v, v]))  # 2^90 entries if what is shared were multiplied out
    assert doubled[0] is doubled[1]
    assert time.monotonic() - start < 5


def test_sparse_matrices_that_point_outside_are_refused():
    sparse = pytest.importorskip("scipy.sparse")
    for field, value in (("indices", 7), ("indices", -1), ("indptr", 9)):
        matrix = sparse.csc_matrix(np.eye(3))
        getattr(matrix, field)[1] = value
        with pytest.raises(UserError, match="sparse matrix"):
            loads(pickle.dumps(matrix))


def test_random_bytes_and_mutations_never_do_anything_but_fail():
    rng = np.random.default_rng(0)
    good = pickle.dumps({"v": np.arange(4.0), "s": "text", "l": [1, 2.5, None]}, 2)
    for _ in range(1500):
        data = bytearray(good)
        for place in rng.integers(0, len(data), 3):
            data[place] = rng.integers(0, 256)
        with contextlib.suppress(UserError):
            loads(bytes(data))


def test_reading_imports_nothing():
    """Neither SciPy nor chumpy is imported, even where they are installed."""
    sparse = pytest.importorskip("scipy.sparse")
    data = pickle.dumps(sparse.csc_matrix(np.eye(2)), 2)
    code = (
        "import sys; from gavatar_runtime.formats.safe_pickle import loads; before = set(sys.modules);"
        f"loads({data!r}); loads({python2_pickle({'x': Ch(np.ones(2))})!r});"
        "new = {m.split('.')[0] for m in set(sys.modules) - before};"
        "assert not new & {'scipy', 'chumpy'}, new"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_files_name_themselves(tmp_path):
    with pytest.raises(UserError, match=r"absent\.pkl cannot be read: No such file"):
        load_pickle(tmp_path / "absent.pkl")
    path = tmp_path / "bad.pkl"
    path.write_bytes(pickle.dumps(Calls(os.system, "true")))
    with pytest.raises(UserError, match=r"bad\.pkl asks for '(posix|nt)\.system'"):
        load_pickle(path)


def test_npz_members_that_are_pickles_are_read_by_the_same_rules(tmp_path):
    sparse = pytest.importorskip("scipy.sparse")
    path = tmp_path / "model.npz"
    matrix = sparse.csc_matrix(np.eye(3))
    np.savez(path, plain=np.arange(3), J_regressor=np.array(matrix, object), names=np.array({"pelvis": 0}, object))
    got = load_npz(path)
    np.testing.assert_array_equal(got["J_regressor"], np.eye(3))
    assert got["names"] == {"pelvis": 0}
    assert set(load_npz(path, ["plain", "absent"])) == {"plain"}
    np.savez(path, bad=np.array(Calls(os.system, "true"), object))
    with pytest.raises(UserError, match=r"model\.npz: 'bad' asks for"):
        load_npz(path)
    path.write_bytes(b"PK\x03\x04 no zip")
    with pytest.raises(UserError, match=r"damaged or not an \.npz"):
        load_npz(path)
    with pytest.raises(UserError, match="cannot be read"):
        load_npz(tmp_path / "absent.npz")


def test_dictionaries_with_an_order_or_a_default_are_dictionaries():
    content = collections.defaultdict(list, {1: [2.5]})
    nested = collections.OrderedDict(a=content, b=collections.defaultdict(None, {"x": np.ones(2)}))
    for protocol in PROTOCOLS:
        got = loads(pickle.dumps(nested, protocol))
        assert type(got) is type(got["a"]) is dict
        assert got["a"] == {1: [2.5]}
        np.testing.assert_array_equal(got["b"]["x"], np.ones(2))
    assert loads(pickle.dumps(collections.defaultdict(dict))) == {}


class Settings(dict):
    """A kind of dictionary that a pose estimator may have of its own."""


class Tracks(list):
    """A kind of list."""


class Record:
    """Attributes."""

    def __init__(self, **values):
        self.__dict__ |= values


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_objects_of_unknown_kinds_do_not_spoil_a_file_for_a_lenient_reader(protocol):
    content = {
        "poses": np.ones(3), "settings": Settings(a=1), "tracks": Tracks([1, 2]), "record": Record(x=np.zeros(2)),
        "nothing": Record(), "kind": Settings, "list": [Record(), 5],
    }  # fmt: skip
    data = pickle.dumps(content, protocol)
    with pytest.raises(UserError, match="not data"):
        loads(data)
    got = loads(data, lenient=True)
    np.testing.assert_array_equal(got["poses"], np.ones(3))
    assert (got["settings"], got["tracks"], got["list"][1]) == ({"a": 1}, [1, 2], 5)
    np.testing.assert_array_equal(got["record"]["x"], np.zeros(2))
    for key in ("nothing", "kind"):
        assert isinstance(got[key], Unread)
        assert "which is not data" in got[key].why


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("name", marker_calls(""))
def test_no_call_goes_through_a_lenient_reader_either(name, protocol, tmp_path):
    mark = tmp_path / "ran"
    data = pickle.dumps({"v": marker_calls(str(mark))[name]}, protocol)
    if name == "numpy.load":  # inert: kept as something unread
        assert isinstance(loads(data, lenient=True)["v"], Unread)
    else:
        with pytest.raises(UserError, match="not data"):
            loads(data, lenient=True)
    assert not mark.exists()


@pytest.mark.parametrize("name", {**HOSTILE_STREAMS, **DAMAGED_STREAMS})
def test_hostile_and_damaged_streams_end_soon_for_a_lenient_reader(name):
    start = time.monotonic()
    with contextlib.suppress(UserError):
        loads({**HOSTILE_STREAMS, **DAMAGED_STREAMS}[name], lenient=True)
    assert time.monotonic() - start < 5


def test_a_list_that_holds_itself_twice_ends_soon():
    circle: list = []
    circle += [circle, circle, 1]
    got = loads(pickle.dumps({"circle": circle, "poses": 2}), lenient=True)
    assert got["poses"] == 2
    assert got["circle"][2] == 1
    assert isinstance(got["circle"][0], Unread)


def test_an_unreadable_member_of_an_npz_is_left_unread_by_a_lenient_reader(tmp_path):
    np.savez(tmp_path / "a.npz", good=np.ones(2), odd=np.array(Record(), object), row=np.zeros(2, [("x", float)]))
    got = load_npz(tmp_path / "a.npz", lenient=True)
    np.testing.assert_array_equal(got["good"], np.ones(2))
    assert isinstance(got["odd"], Unread)
    np.savez(tmp_path / "b.npz", good=np.ones(2), bad=np.array(Calls(os.system, "true"), object))
    assert "nothing ran" in load_npz(tmp_path / "b.npz", lenient=True)["bad"].why
