"""What .splat, .spz, .sog and .glb have in common, and the bytes of each; others' readers: tests/peers."""

from __future__ import annotations

import dataclasses
import gzip
import json
import struct
import zipfile

import numpy as np
import pytest
from gltf_reader import read_glb
from make_bundle import SCALE, manifest, members, still
from splats import C0, long_ones, read_ply, some

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import write_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.play.outputs import FrameFormat, open_output, save_gaussians
from gavatar_runtime.play.performance import perform
from gavatar_runtime.play.player import play_gaussians

FORMATS = ("splat", "spz", "sog", "glb")


def written(folder, suffix, gaussians) -> bytes:
    save_gaussians(folder / f"a.{suffix}", gaussians)
    return (folder / f"a.{suffix}").read_bytes()


def numbers_of(content: bytes, suffix: str) -> list[np.ndarray]:
    """Every number of the file that is no byte."""
    if suffix == "splat":
        return [np.frombuffer(content, "<f4").reshape(-1, 8)[:, :6]]
    if suffix == "spz":
        return []
    if suffix == "sog":
        import io

        meta = json.loads(zipfile.ZipFile(io.BytesIO(content)).read("meta.json"))
        return [np.array(meta[k][f]) for k, f in (("means", "mins"), ("scales", "codebook"), ("sh0", "codebook"))]
    file = read_glb(content)
    return [file.accessor(i) for i in range(len(file.document.get("accessors", ())))]


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("make", [some, long_ones])
@pytest.mark.parametrize("count", [0, 1, 2, 300])
def test_any_number_of_gaussians_is_a_file_of_finite_numbers(suffix, make, count, tmp_path):
    extremes = {
        "opacities": np.resize([0.0, 1.0, 0.5], count),
        "scales": np.resize([0.0, 1e-12, 3.0], (count, 3) if make is long_ones else count),
        "colors": np.resize([-3.0, 0.0, 1.0, 7.0], (count, 3)),
    }
    content = written(tmp_path, suffix, make(count, **extremes))
    assert content or (suffix, count) == ("splat", 0)
    for numbers in numbers_of(content, suffix):
        assert np.isfinite(numbers).all()


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_turn_of_length_zero_is_none(suffix, tmp_path):
    zero = written(tmp_path, suffix, long_ones(3, quaternions=np.zeros((3, 4))))
    assert zero == written(tmp_path, suffix, long_ones(3, quaternions=np.tile([1, 0, 0, 0], (3, 1))))


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_same_gaussians_are_the_same_bytes(suffix, tmp_path):
    assert written(tmp_path, suffix, long_ones()) == written(tmp_path, suffix, long_ones())


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_is_not_finite_is_left_out_with_a_note(suffix, tmp_path):
    given = some(4)
    given.means[2] = np.nan
    notes = save_gaussians(tmp_path / f"a.{suffix}", given)
    assert notes == (f"{tmp_path}/a.{suffix}: 1 Gaussians are left out, whose numbers are not finite",)
    rest = some(4)
    for name in ("means", "scales", "colors"):
        object.__setattr__(rest, name, getattr(rest, name)[[0, 1, 3]])
    assert (tmp_path / f"a.{suffix}").read_bytes() == written(tmp_path, suffix, rest)


@pytest.mark.parametrize("suffix", FORMATS)
def test_one_file_a_frame_and_one_of_the_first(suffix, dynamic, tmp_path):
    avatar, motion = Avatar(dynamic), still(3)
    motion.trans[:] = [[0, 0, 0], [0.5, 0, 0], [0, 0, 1]]
    output = open_output(tmp_path / "f" / f"%06d.{suffix}", FrameFormat(30))
    assert len(play_gaussians(avatar, motion, output)) == 3
    files = sorted((tmp_path / "f").iterdir())
    assert [file.name for file in files] == [f"{i:06d}.{suffix}" for i in range(3)]
    for i, file in enumerate(files):
        assert file.read_bytes() == written(tmp_path, suffix, avatar.gaussians(*motion.at(i)))
    output = open_output(tmp_path / f"b.{suffix}", FrameFormat(30))
    play_gaussians(avatar, motion, output)
    assert (tmp_path / f"b.{suffix}").read_bytes() == files[0].read_bytes()
    assert output.notes == [
        f"{tmp_path}/b.{suffix} holds the first of 3 frames; {tmp_path}/b/%06d.{suffix} would hold each in a file"
    ]


# the bytes of each


def test_a_splat_is_32_bytes(tmp_path):
    given = some(1, means=[[1, 2, 3]], scales=[0.25], colors=[[0, 0.5, 1]], opacities=[0.2])
    content = written(tmp_path, "splat", given)
    assert struct.unpack("<6f8B", content) == (-1, -2, 3, 0.25, 0.25, 0.25, 0, 128, 255, 51, 255, 128, 128, 128)


def test_an_spz_is_a_gzip_stream_of_arrays(tmp_path):
    given = some(2, means=[[1, 2, -3]] * 2, scales=[1.0, 1.0], colors=[[0.5, 0.5, 0.5]] * 2, opacities=[0.2, 1])
    content = gzip.decompress(written(tmp_path, "spz", given))
    assert struct.unpack("<3I4B", content[:16]) == (0x5053474E, 3, 2, 0, 12, 0, 0)
    place = b"\x00\x10\x00" + b"\x00\x20\x00" + b"\x00\xd0\xff"  # 1, 2 and -3 in 4096ths, the lowest byte first
    # the quaternion xyzw has its largest in place 3, the others are zero
    assert content[16:] == place * 2 + bytes([51, 254]) + bytes([128] * 6) + bytes([160] * 6) + b"\0\0\0\xc0" * 2


def test_an_spz_of_somebody_far_away_has_fewer_bits_below_a_metre_and_a_limit(tmp_path):
    content = gzip.decompress(written(tmp_path, "spz", some(1, means=[[5000.0, 0, 0]])))
    assert content[13] == 10
    assert int.from_bytes(content[16:19], "little") == 5000 << 10
    with pytest.raises(
        UserError, match=r"a\.spz: a Gaussian is 1e\+07 m away, and \.spz holds 8388607 m: write a \.ply"
    ):
        written(tmp_path, "spz", some(1, means=[[1e7, 0, 0]]))


def test_a_sog_names_its_images_and_their_number(tmp_path):
    written(tmp_path, "sog", some(5))
    with zipfile.ZipFile(tmp_path / "a.sog") as file:
        meta = json.loads(file.read("meta.json"))
        named = [name for value in meta.values() if isinstance(value, dict) for name in value["files"]]
        assert sorted(file.namelist()) == sorted(["meta.json", *named])
    assert (meta["version"], meta["count"]) == (2, 5)
    assert [len(meta[k]["codebook"]) for k in ("scales", "sh0")] == [256, 256]


def test_a_glb_holds_splats_as_the_extension_has_them_and_points_in_linear_light(tmp_path):
    given = long_ones(5, colors=np.linspace(0, 1, 15).reshape(5, 3))
    file = read_glb(written(tmp_path, "glb", given))
    (primitive,) = file.document["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert file.document["extensionsUsed"] == ["KHR_gaussian_splatting"]
    assert primitive["extensions"] == {
        "KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    }
    got = {name.rpartition(":")[2]: file.accessor(i) for name, i in primitive["attributes"].items()}
    np.testing.assert_array_equal(got["POSITION"], given.means)
    np.testing.assert_allclose(got["ROTATION"], given.quaternions[:, [1, 2, 3, 0]], atol=1e-7)  # float32
    np.testing.assert_array_equal(got["SCALE"], given.scales)
    np.testing.assert_array_equal(got["OPACITY"], given.opacities)
    np.testing.assert_allclose(0.5 + C0 * got["SH_DEGREE_0_COEF_0"], given.colors, atol=1e-6)  # float32
    back = np.where(got["COLOR_0"] <= 0.0031308, got["COLOR_0"] * 12.92, 1.055 * got["COLOR_0"] ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(back[:, :3], given.colors, atol=1e-6)  # float32
    np.testing.assert_array_equal(got["COLOR_0"][:, 3], given.opacities)


def test_a_glb_without_gaussians_has_no_mesh(tmp_path):
    document = read_glb(written(tmp_path, "glb", some(0))).document
    assert "meshes" not in document
    assert "buffers" not in document
    assert document["scenes"] == [{"nodes": [0]}]


# what the training images added to each


@pytest.mark.parametrize(
    ("suffix", "options", "added"),
    [("glb", {}, 1), ("glb", {"filmed": False}, 0), ("ply", {}, 1), ("ply", {"filmed": False}, 0), ("splat", {}, 1)],
)
def test_splats_are_as_large_as_the_training_images_showed_them(suffix, options, added, tmp_path):
    """A pixel of 9 mm there: drawing added 0.3 square pixels of variance, which other programs know nothing of."""
    filmed = dataclasses.replace(manifest(60), training={"pixel_m": 0.009})
    write_bundle(tmp_path / "a.gavatar", filmed, members(60))
    avatar = Avatar(tmp_path / "a.gavatar")
    path = tmp_path / f"a.{suffix}"
    perform(avatar, still(), path, output_options=options)
    if suffix == "ply":
        scales = read_ply(path).scales
    elif suffix == "splat":
        scales = np.frombuffer(path.read_bytes(), "<f4").reshape(-1, 8)[:, 3:6]
    else:
        scales = read_glb(path.read_bytes()).primitive()["KHR_gaussian_splatting:SCALE"]
    wanted = np.sqrt(SCALE**2 + added * 0.3 * 0.009**2)
    np.testing.assert_allclose(scales, wanted, rtol=2e-6)  # float32, of .ply its logarithm
