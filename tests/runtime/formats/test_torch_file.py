"""Files of torch.save, read without torch."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import places
import pytest
import torch

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.numpy_file import load_npy
from gavatar_runtime.formats.safe_pickle import load_pickle
from gavatar_runtime.formats.torch_file import load_torch
from gavatar_runtime.motions import read_motion


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.int64, torch.uint8, torch.bool])
def test_tensors_read_without_torch_equal_what_torch_reads(tmp_path, dtype):
    whole = (torch.arange(24).reshape(4, 6) % 2 if dtype == torch.bool else torch.arange(24).reshape(4, 6)).to(dtype)
    content = {
        "whole": whole, "transposed": whole.T, "part": whole[1:3, ::2], "one": whole[2, 3], "none": whole[:0],
        "expanded": whole[:1].expand(3, 6), "shared": [whole[0], whole[1]], "text": "x", "number": 3,
        "parameter": torch.nn.Parameter(torch.ones(2)),
    }  # fmt: skip
    torch.save(content, tmp_path / "a.pth")
    mine, theirs = load_torch(tmp_path / "a.pth"), torch.load(tmp_path / "a.pth", weights_only=True)
    assert mine["text"] == "x"
    assert mine["number"] == 3
    for key in ("whole", "transposed", "part", "one", "none", "expanded", "parameter"):
        np.testing.assert_array_equal(mine[key], theirs[key].detach().numpy(), err_msg=key)
        assert mine[key].dtype == theirs[key].detach().numpy().dtype
    np.testing.assert_array_equal(mine["shared"][1], theirs["shared"][1].numpy())


def test_damaged_torch_files_are_one_sentence(tmp_path):
    torch.save({"body_pose": torch.zeros(2, 72)}, tmp_path / "old.pth", _use_new_zipfile_serialization=False)
    (tmp_path / "old.pth").write_bytes((tmp_path / "old.pth").read_bytes()[:-100])
    torch.save({"body_pose": torch.zeros(2, 72)}, tmp_path / "cut.pth")
    (tmp_path / "cut.pth").write_bytes((tmp_path / "cut.pth").read_bytes()[:300])
    (tmp_path / "empty.pth").write_bytes(b"")
    for name in ("old.pth", "cut.pth", "empty.pth"):
        with pytest.raises(UserError, match=name) as raised:
            read_motion(tmp_path / name)
        assert "\n" not in str(raised.value)


@pytest.mark.shared
def test_the_upstream_test_pose_reads_as_torch_reads_it():
    path = places.SHARED / "motions" / "upstream_test_pose_smpl_parms.pth"
    if not path.exists():
        pytest.skip(f"{path} is absent")
    mine, theirs = load_torch(path), torch.load(path, weights_only=True)
    for key, value in theirs.items():
        np.testing.assert_array_equal(mine[key], value.numpy())


def test_bfloat16_becomes_float32_of_the_same_value(tmp_path):
    values = torch.tensor([1.0, -2.5, 3e38, 1e-40, float("nan"), float("inf")]).to(torch.bfloat16)
    torch.save({"a": values, "part": values[1:3]}, tmp_path / "a.pt")
    mine = load_torch(tmp_path / "a.pt")
    np.testing.assert_array_equal(mine["a"], values.float().numpy())
    np.testing.assert_array_equal(mine["part"], values[1:3].float().numpy())
    assert mine["a"].dtype == np.float32


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16, torch.int64, torch.bool])
def test_the_format_of_old_and_tensors_in_a_plain_pickle_are_read(tmp_path, dtype):
    whole = (torch.arange(24).reshape(4, 6) % 2 if dtype == torch.bool else torch.arange(24).reshape(4, 6)).to(dtype)
    content = {"whole": whole, "transposed": whole.T, "part": whole[1:3, ::2], "again": whole, "none": whole[:0]}
    expected = {key: (v.float() if dtype == torch.bfloat16 else v).numpy() for key, v in content.items()}
    torch.save(content, tmp_path / "old.pth", _use_new_zipfile_serialization=False)
    (tmp_path / "plain.pkl").write_bytes(pickle.dumps(content))
    np.save(tmp_path / "a.npy", content, allow_pickle=True)  # as TRAM does
    for mine in (load_torch(tmp_path / "old.pth"), load_pickle(tmp_path / "plain.pkl"), load_npy(tmp_path / "a.npy")):
        for key, value in expected.items():
            np.testing.assert_array_equal(mine[key], value, err_msg=key)


def test_a_state_dict_with_its_version_is_read(tmp_path):
    layer = torch.nn.Linear(2, 3)
    torch.save(layer.state_dict(), tmp_path / "a.pth")
    mine = load_torch(tmp_path / "a.pth")
    np.testing.assert_array_equal(mine["weight"], layer.weight.detach().numpy())


def test_members_of_unknown_kinds_do_not_spoil_a_file_of_tensors(tmp_path):
    content = {"poses": torch.ones(2), "device": torch.device("cpu"), "dtype": torch.float32, "path": Path("x")}
    torch.save(content, tmp_path / "a.pt")
    with pytest.raises(UserError, match=r"a\.pt asks for"):
        load_torch(tmp_path / "a.pt")
    np.testing.assert_array_equal(load_torch(tmp_path / "a.pt", lenient=True)["poses"], np.ones(2))


def test_cut_storages_of_old_files_are_refused(tmp_path):
    torch.save({"a": torch.ones(40)}, tmp_path / "a.pth", _use_new_zipfile_serialization=False)
    whole = (tmp_path / "a.pth").read_bytes()
    for length in (len(whole) - 1, len(whole) - 170, 60, 20):
        (tmp_path / "a.pth").write_bytes(whole[:length])
        with pytest.raises(UserError, match=r"a\.pth is not a readable file of tensors"):
            load_torch(tmp_path / "a.pth")
