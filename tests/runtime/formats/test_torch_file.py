"""Files of torch.save, read without torch."""

from __future__ import annotations

import numpy as np
import places
import pytest
import torch

from gavatar_runtime.errors import UserError
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
