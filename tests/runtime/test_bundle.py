"""The avatar bundle: what is written reads back, and whatever is wrong with one is a single clear sentence."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import zipfile

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import FORMAT_VERSION, Manifest, pack_arrays, pack_surfaces, read_bundle, write_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.surface import Atlas, Surface

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import MAP_RESOLUTION, free_body, make_bundle, manifest, members, surface_of


@pytest.fixture
def bundle(tmp_path):
    return make_bundle(tmp_path / "tester.gavatar")


def unzipped(bundle, name="folder"):
    folder = bundle.parent / name
    with zipfile.ZipFile(bundle) as file:
        file.extractall(folder)
    return folder


def rewritten(bundle, *, drop=(), change=None):
    """The bundle zipped anew, without some members, with the bytes of others replaced, manifest untouched."""
    with zipfile.ZipFile(bundle) as file:
        contents = {name: file.read(name) for name in file.namelist()}
    with zipfile.ZipFile(bundle, "w") as file:
        for name, data in (contents | (change or {})).items():
            if name not in drop:
                file.writestr(name, data)
    return bundle


def with_manifest(bundle, **fields):
    """The bundle with fields of its manifest replaced, or (None) left out."""
    with zipfile.ZipFile(bundle) as file:
        values = json.loads(file.read("manifest.json")) | fields
    text = json.dumps({k: v for k, v in values.items() if v is not None})
    return rewritten(bundle, change={"manifest.json": text.encode()})


# round trip


@pytest.mark.parametrize("dynamic", [False, True])
def test_a_bundle_reads_back_what_was_written(tmp_path, dynamic):
    made = members(dynamic=dynamic)
    written = write_bundle(tmp_path / "a.gavatar", manifest(dynamic=dynamic), made)
    bundle = read_bundle(tmp_path / "a.gavatar", verify=True)
    assert bundle.manifest == written
    assert {name: bundle.read(name) for name in made} == made
    assert written.members == {name: hashlib.sha256(data).hexdigest() for name, data in made.items()}
    assert written.required == ("surface.npz", "body.npz", "decoder.onnx") + (("encoder.onnx",) if dynamic else ())


def test_an_unpacked_bundle_is_the_same_bundle(bundle):
    folder = read_bundle(unzipped(bundle), verify=True)
    assert folder.manifest == read_bundle(bundle).manifest
    assert len(Avatar(folder)) == 300


def test_the_same_avatar_is_the_same_file_byte_for_byte(tmp_path):
    one, two = (make_bundle(tmp_path / f"{name}.gavatar") for name in "ab")
    os.utime(one, (0, 0))
    assert one.read_bytes() == two.read_bytes()


def test_an_existing_bundle_is_replaced_whole(bundle):
    make_bundle(bundle, 20)
    assert read_bundle(bundle, verify=True).manifest.gaussians == 20


def test_surfaces_keep_exactly_what_playing_needs(tmp_path):
    bundle = read_bundle(make_bundle(tmp_path / "a.gavatar", 50, dynamic=True))
    read, read_map = bundle.surfaces()
    body = free_body()
    kept = ("points", "joint_index", "joint_weight", "joints", "parents", "A_canonical")
    made_map = surface_of(body, 200, MAP_RESOLUTION)
    for made, back, names in (
        (surface_of(body, 50, 32), read, ("uv", "spacing", "rank", *kept)), (made_map, read_map, ("texel", *kept)),
    ):  # fmt: skip
        for name in names:
            np.testing.assert_array_equal(getattr(back, name), getattr(made, name), err_msg=name)
            assert getattr(back, name).dtype == getattr(made, name).dtype, name
    assert type(read) is Surface
    assert type(read_map) is Atlas
    assert read_map.resolution == MAP_RESOLUTION
    centre = np.stack([read_map.texel % MAP_RESOLUTION, read_map.texel // MAP_RESOLUTION], -1) + 0.5
    np.testing.assert_array_equal(read_map.uv, (centre / MAP_RESOLUTION).astype(np.float32))
    np.testing.assert_allclose(read.normals, surface_of(body, 50, 32).normals, atol=5e-4)  # float16


def test_a_static_bundle_has_no_map_surface(bundle):
    assert read_bundle(bundle).surfaces()[1] is None


def test_one_gaussian_makes_a_bundle(tmp_path):
    assert len(Avatar(make_bundle(tmp_path / "one.gavatar", 1))) == 1


def test_a_body_of_more_joints_than_a_byte_counts_keeps_its_indices(tmp_path):
    joints = 300
    body = surface_of(free_body(), 4, 32)
    wide = dataclasses.replace(
        body,
        joints=np.zeros((joints, 3)),
        parents=np.r_[-1, np.zeros(joints - 1)].astype(np.int32),
        A_canonical=np.tile(np.eye(4), (joints, 1, 1)),
        joint_index=np.full_like(body.joint_index, 299),
    )
    write_bundle(tmp_path / "a.gavatar", manifest(4), members(4) | {"surface.npz": pack_surfaces(wide)})
    assert (read_bundle(tmp_path / "a.gavatar").surfaces()[0].joint_index == 299).all()


def test_extra_members_are_listed_checked_and_read(tmp_path):
    made = members() | {"baked.npz": pack_arrays({"a": np.arange(3)})}
    write_bundle(tmp_path / "a.gavatar", manifest(), made)
    np.testing.assert_array_equal(read_bundle(tmp_path / "a.gavatar").arrays("baked.npz")["a"], np.arange(3))


def test_manifest_fields_of_a_later_minor_version_survive(bundle):
    read = read_bundle(with_manifest(bundle, mood="cheerful")).manifest
    assert read.extra == {"mood": "cheerful"}
    assert Manifest.from_json(read.to_json(), "x") == read


# what is wrong with a bundle


def refused(path, message, **options):
    with pytest.raises(UserError, match=message) as raised:
        read_bundle(path, **options)
    assert path.name in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_path_that_does_not_exist(tmp_path):
    refused(tmp_path / "absent.gavatar", "does not exist")


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89PNG\r\n"])
def test_a_file_that_is_not_a_zip(tmp_path, content):
    (tmp_path / "a.gavatar").write_bytes(content)
    refused(tmp_path / "a.gavatar", "not a gavatar bundle")


@pytest.mark.parametrize("share", [0.01, 0.5, 0.99])
def test_a_truncated_bundle(bundle, share):
    data = bundle.read_bytes()
    bundle.write_bytes(data[: int(share * len(data))])
    refused(bundle, "cut short or damaged")


def test_an_empty_folder_and_a_zip_of_something_else(tmp_path):
    (tmp_path / "folder").mkdir()
    refused(tmp_path / "folder", r"no manifest\.json")
    with zipfile.ZipFile(tmp_path / "photos.zip", "w") as file:
        file.writestr("a.jpg", b"")
    refused(tmp_path / "photos.zip", r"no manifest\.json")


@pytest.mark.parametrize("text", [b"", b"{", b"\xff\xfe", b"[1]", b"{}", b'{"format": "gltf"}'])
def test_a_manifest_that_is_none(bundle, text):
    refused(rewritten(bundle, change={"manifest.json": text}), r"not JSON|not a gavatar bundle")


def test_a_later_format_says_to_update(bundle):
    message = f"bundle format {FORMAT_VERSION + 1}.*update gavatar.*written by gavatar 9"
    refused(with_manifest(bundle, format_version=FORMAT_VERSION + 1, created_by="gavatar 9"), message)


@pytest.mark.parametrize("version", ["1", 0, -1, True, 1.0])
def test_a_format_version_that_is_no_version(bundle, version):
    refused(with_manifest(bundle, format_version=version), "format_version")


def test_a_manifest_field_that_is_missing_or_of_another_kind(bundle, tmp_path):
    refused(with_manifest(bundle, gaussians="many"), "'gaussians' is a str, expected int")
    refused(with_manifest(make_bundle(tmp_path / "b.gavatar"), body=None), "lacks the field 'body'")


@pytest.mark.parametrize("member", ["surface.npz", "body.npz", "decoder.onnx", "encoder.onnx"])
@pytest.mark.parametrize("folder", [False, True])
def test_a_missing_member_is_named(tmp_path, member, folder):
    path = make_bundle(tmp_path / "a.gavatar", 20, dynamic=True)
    if folder:
        path = unzipped(path)
        (path / member).unlink()
    else:
        rewritten(path, drop=[member])
    refused(path, f"member {member} is missing")


def test_a_dynamic_bundle_whose_manifest_forgets_its_encoder(bundle):
    refused(with_manifest(bundle, dynamic=True), r"member encoder\.onnx is missing")


@pytest.mark.parametrize("folder", [False, True])
def test_an_altered_member_fails_its_checksum(bundle, folder):
    if folder:
        path = unzipped(bundle)
        data = bytearray((path / "decoder.onnx").read_bytes())
        data[100] ^= 1
        (path / "decoder.onnx").write_bytes(data)
    else:
        path = rewritten(bundle, change={"decoder.onnx": b"other"})
    refused(path, r"decoder\.onnx does not match its SHA-256", verify=True)
    with pytest.raises(UserError, match="SHA-256"):
        Avatar(path)


def test_a_flipped_bit_within_the_zip_is_noticed(bundle):
    data = bytearray(bundle.read_bytes())
    with zipfile.ZipFile(bundle) as file:
        start = file.getinfo("surface.npz").header_offset
    data[start + 400] ^= 0x10
    bundle.write_bytes(data)
    refused(bundle, r"surface\.npz", verify=True)


@pytest.mark.parametrize("name", ["../evil", "/etc/passwd", "a/b", "", ".hidden", "a\\b"])
def test_a_member_name_that_leaves_the_bundle_is_never_followed(bundle, name):
    path = unzipped(bundle)
    values = json.loads((path / "manifest.json").read_text())
    values["members"][name] = "0"
    (path / "manifest.json").write_text(json.dumps(values))
    refused(path, "missing|not a plain file name")
    with pytest.raises(ValueError, match="plain file names only"):
        write_bundle(path.parent / "b.gavatar", manifest(), members() | {name: b""})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gaussians_points": None}, "lacks the array 'gaussians_points'"),
        ({"gaussians_points": np.zeros((3, 3), np.float32)}, "'gaussians_points' has shape"),
        ({"gaussians_joint_index": np.full((300, 4), 99, np.uint8)}, "'gaussians_joint_index' points outside 0 to 51"),
        ({"gaussians_rank": np.full(300, -1, np.int32)}, "'gaussians_rank' points outside"),
    ],
)
def test_a_surface_that_does_not_hold_together(tmp_path, change, message):
    made = members()
    with np.load(io.BytesIO(made["surface.npz"]), allow_pickle=False) as file:
        arrays = {k: v for k, v in (dict(file) | change).items() if v is not None}
    write_bundle(tmp_path / "a.gavatar", manifest(), made | {"surface.npz": pack_arrays(arrays)})
    with pytest.raises(UserError, match=message):
        read_bundle(tmp_path / "a.gavatar").surfaces()


def test_a_surface_of_another_size_than_the_manifest_says(tmp_path):
    write_bundle(tmp_path / "a.gavatar", manifest(299), members(300))
    with pytest.raises(UserError, match=r"300 points .* 299 Gaussians"):
        Avatar(tmp_path / "a.gavatar")


def test_a_pickle_in_a_member_is_never_executed(tmp_path):
    bomb = np.empty(1, object)
    bomb[0] = "harmless"
    np.savez(tmp_path / "x.npz", joint_names=bomb)
    write_bundle(tmp_path / "a.gavatar", manifest(), members() | {"body.npz": (tmp_path / "x.npz").read_bytes()})
    with pytest.raises(UserError, match=r"body\.npz is not a readable"):
        Avatar(tmp_path / "a.gavatar")
    with pytest.raises(ValueError, match=r"[Oo]bject"):
        pack_arrays({"a": bomb})


def test_networks_that_do_not_load_or_have_other_names(tmp_path):
    write_bundle(tmp_path / "a.gavatar", manifest(), members() | {"decoder.onnx": b"nonsense"})
    with pytest.raises(UserError, match=r"cannot load decoder\.onnx"):
        Avatar(tmp_path / "a.gavatar")
    other = members(dynamic=True)["encoder.onnx"]
    write_bundle(tmp_path / "b.gavatar", manifest(), members() | {"decoder.onnx": other})
    with pytest.raises(UserError, match=r"decoder\.onnx has inputs \('positional_map',\)"):
        Avatar(tmp_path / "b.gavatar")


def test_a_decoder_of_another_number_of_gaussians(tmp_path):
    write_bundle(tmp_path / "a.gavatar", manifest(), members() | {"decoder.onnx": members(20)["decoder.onnx"]})
    with pytest.raises(UserError, match=r"decoder\.onnx returns shapes \(20, 3\).* for 300 Gaussians"):
        Avatar(tmp_path / "a.gavatar").gaussians(np.zeros((52, 3)))


# writing


def test_members_that_make_no_bundle_are_refused_before_anything_is_written(tmp_path):
    made = members()
    made.pop("decoder.onnx")
    with pytest.raises(ValueError, match=r"lacks decoder\.onnx"):
        write_bundle(tmp_path / "a.gavatar", manifest(), made)
    with pytest.raises(ValueError, match=r"manifest\.json"):
        write_bundle(tmp_path / "a.gavatar", manifest(), members() | {"manifest.json": b"{}"})
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_fails_leaves_the_former_bundle_and_nothing_else(bundle, monkeypatch):
    before = bundle.read_bytes()

    def fail(*_):
        raise OSError("no space left")

    monkeypatch.setattr(zipfile.ZipFile, "writestr", fail)
    with pytest.raises(OSError, match="no space"):
        write_bundle(bundle, manifest(), {n: b"" for n in ("surface.npz", "body.npz", "decoder.onnx")})
    assert bundle.read_bytes() == before
    assert list(bundle.parent.iterdir()) == [bundle]


def test_a_place_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for path, message in ((tmp_path / "file" / "a.gavatar", "cannot be written"), (tmp_path / "folder", "directory")):
        with pytest.raises(UserError, match=message):
            write_bundle(path, manifest(), members())


def test_the_surface_of_a_bundle_is_a_surface(bundle):
    assert isinstance(read_bundle(bundle).surfaces()[0], Surface)
