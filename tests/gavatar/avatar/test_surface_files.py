"""Sampled surfaces in files and in the cache."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from surfaces import BETAS, free_surface

from gavatar.avatar.atlas import sample_atlas
from gavatar.avatar.surface_cache import default_cache_dir
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.surface_file import load_surface, save_surface
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Surface

pytestmark = pytest.mark.usefixtures("own_cache")


# ---- files


def same(a: Surface, b: Surface) -> bool:
    one, two = a.to_arrays(), b.to_arrays()
    return all(np.array_equal(one[name], two[name]) and one[name].dtype == two[name].dtype for name in one)


def test_a_surface_survives_a_file_unchanged(tmp_path):
    surface = free_surface(64)
    save_surface(tmp_path / "surface.npz", surface)
    loaded = load_surface(tmp_path / "surface.npz")
    assert same(loaded, surface)
    assert isinstance(loaded.resolution, int)
    assert isinstance(loaded.weight_truncation, float)
    assert [path.name for path in tmp_path.iterdir()] == ["surface.npz"]


def test_arrays_that_do_not_make_a_surface_are_named():
    arrays = free_surface(64).to_arrays()
    assert not any(array.dtype.hasobject for array in arrays.values())
    with pytest.raises(UserError, match=r"avatar\.npz lacks the array 'uv'"):
        Surface.from_arrays({name: value for name, value in arrays.items() if name != "uv"}, "avatar.npz")
    with pytest.raises(UserError, match="'points' has shape"):
        Surface.from_arrays({**arrays, "points": arrays["points"][:-1]})
    with pytest.raises(UserError, match="'joint_index' points outside 0 to 51"):
        Surface.from_arrays({**arrays, "joint_index": arrays["joint_index"] + 52})
    with pytest.raises(UserError, match="'texel' points outside 0 to 4095"):
        Surface.from_arrays({**arrays, "texel": arrays["texel"] - 4096})


def test_unreadable_files_are_the_user_s_error(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        load_surface(tmp_path / "absent.npz")
    np.savez(tmp_path / "pickle.npz", **{**free_surface(64).to_arrays(), "uv": np.array([{}], object)})
    np.save(tmp_path / "other.npy", np.zeros(3))
    (tmp_path / "text.npz").write_text("not an archive")
    (tmp_path / "empty.npz").touch()
    (tmp_path / "folder.npz").mkdir()
    for name in ("pickle.npz", "other.npy", "text.npz", "empty.npz", "folder.npz"):
        with pytest.raises(UserError, match=rf"{name}: not a readable surface"):
            load_surface(tmp_path / name)


# ---- cache


def test_the_second_call_reads_the_cache(tmp_path, monkeypatch):
    first = sample_atlas(load_free_body(), BETAS, 64, cache_dir=tmp_path)
    monkeypatch.setattr(BodyData, "posed", lambda *_: pytest.fail("computed again"))
    assert same(sample_atlas(load_free_body(), BETAS, 64, cache_dir=tmp_path), first)


def test_whatever_changes_the_surface_changes_its_place_in_the_cache(tmp_path):
    body = load_free_body()
    moved = dataclasses.replace(body, v_template=body.v_template + np.float32(1e-3))
    renamed = dataclasses.replace(body, joint_names=("root", *body.joint_names[1:]))
    mirrored = dataclasses.replace(body, uv=body.uv * [-1, 1] + [1, 0])
    variants = [(body, None, 64), (body, BETAS, 64), (body, None, 65), (moved, None, 64), (renamed, None, 64)]
    for number, variant in enumerate([*variants, (mirrored, None, 64)], 1):
        sample_atlas(*variant, cache_dir=tmp_path)
        assert len(list(tmp_path.iterdir())) == number
    sample_atlas(body, None, 64, order="row", cache_dir=tmp_path)
    assert len(list(tmp_path.iterdir())) == 7


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "text", "another archive"])
def test_a_damaged_cache_is_rebuilt_in_silence(tmp_path, damage, recwarn):
    first = sample_atlas(load_free_body(), None, 64, cache_dir=tmp_path)
    (path,) = tmp_path.iterdir()
    data = path.read_bytes()
    if damage == "another archive":
        np.savez(path, texel=np.zeros(3))
    else:
        middle = len(data) // 2
        flipped = data[:middle] + bytes([data[middle] ^ 255]) + data[middle + 1 :]
        path.write_bytes({"truncated": data[:middle], "flipped": flipped, "empty": b"", "text": b"hello"}[damage])
    assert same(sample_atlas(load_free_body(), None, 64, cache_dir=tmp_path), first)
    assert same(load_surface(path), first)
    assert not recwarn.list


def test_an_unusable_cache_folder_only_costs_time(tmp_path):
    (tmp_path / "file").touch()
    assert len(sample_atlas(load_free_body(), None, 64, cache_dir=tmp_path / "file" / "below")) > 0


def test_the_default_cache_honours_xdg(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    sample_atlas(load_free_body(), None, 64)
    assert len(list((tmp_path / "gavatar" / "surfaces").iterdir())) == 1
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for value in ("", "relative/path"):
        monkeypatch.setenv("XDG_CACHE_HOME", value)
        assert default_cache_dir() == tmp_path / "home" / ".cache" / "gavatar" / "surfaces"
