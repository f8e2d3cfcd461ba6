"""Every reader: an absent file is a FileNotFoundError too, and a folder in a file's place is one sentence."""

from __future__ import annotations

import pytest

from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import MissingFile, UserError
from gavatar_runtime.formats.bvh_file import read_bvh
from gavatar_runtime.formats.camera_file import read_cameras
from gavatar_runtime.formats.data_file import load_data
from gavatar_runtime.formats.joblib_file import load_joblib
from gavatar_runtime.formats.numpy_file import load_npy, load_npz
from gavatar_runtime.formats.safe_pickle import load_pickle
from gavatar_runtime.formats.surface_file import load_surface
from gavatar_runtime.formats.torch_file import load_torch
from gavatar_runtime.motions import read_motion
from gavatar_runtime.rigs.rig_names import read_mapping

READERS = {
    "read_bvh": read_bvh,
    "read_cameras": read_cameras,
    "load_data": load_data,
    "load_joblib": load_joblib,
    "load_npy": load_npy,
    "load_npz": load_npz,
    "load_pickle": load_pickle,
    "load_surface": load_surface,
    "load_torch": load_torch,
    "read_mapping": lambda path: read_mapping(path, []),
    "read_motion": lambda path: read_motion(path.with_suffix(".bvh")),
}


@pytest.mark.parametrize("name", [*READERS, "read_bundle"])
def test_an_absent_file_is_missing_and_named(name, tmp_path):
    reader = READERS.get(name, read_bundle)
    for path in (tmp_path / "absent.file", tmp_path / "no folder" / "absent.file"):
        with pytest.raises(MissingFile, match="absent") as raised:
            reader(path)
        assert isinstance(raised.value, FileNotFoundError)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize("name", READERS)  # a bundle may be a folder
def test_a_folder_in_a_files_place_is_one_sentence(name, tmp_path):
    (tmp_path / "folder.bvh").mkdir()
    with pytest.raises(UserError, match=r"folder\.bvh.* directory") as raised:
        READERS[name](tmp_path / "folder.bvh")
    assert not isinstance(raised.value, FileNotFoundError)
    assert "\n" not in str(raised.value)
