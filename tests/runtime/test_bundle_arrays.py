"""Arrays of a bundle that break their rules: one sentence when it is opened, which names the member and the array."""

from __future__ import annotations

import io
import re
import zipfile

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import pack_arrays
from gavatar_runtime.errors import UserError
from gavatar_runtime.tiers.members import BAKED, BLENDSHAPE, COARSE

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from tiered_members import COARSE_COUNT, member_arrays, write_tiered

TIER_OF = {"baked.npz": "baked", "coarse.npz": "coarse", "blendshape.npz": "blendshape"}
ARRAYS = member_arrays()
MAY_BE_MISSING = {"betas", "parents", "joints", "gaussians_normals"} | {"owners", "seen"}  # the last with all of theirs
NAMES = [(member, name) for member, arrays in ARRAYS.items() for name in arrays]


def opened(tmp_path, member, **changes):
    """The avatar with arrays of a member replaced, or (None) left out, opened with the tier that reads it."""
    arrays = {k: v for k, v in (ARRAYS[member] | changes).items() if v is not None}
    path = write_tiered(tmp_path / "a.gavatar", {member: pack_arrays(arrays)})
    return Avatar(path, tier=TIER_OF.get(member, "full"), threads=1)


def refused(tmp_path, member, name, fault, **changes):
    with pytest.raises(UserError, match=fault) as raised:
        opened(tmp_path, member, **changes)
    sentence = str(raised.value)
    assert "\n" not in sentence
    assert re.search(rf"a\.gavatar: {re.escape(member)}.* array '{re.escape(name)}'", sentence), sentence
    assert sentence.endswith("export it again")


@pytest.mark.parametrize("tier", ["full", "baked", "coarse", "blendshape"])
def test_whole_it_plays_with_each_tier(tmp_path, tier):
    avatar = Avatar(write_tiered(tmp_path / "a.gavatar"), tier=tier, threads=1)
    assert np.isfinite(avatar.gaussians(np.zeros((52, 3), np.float32)).means).all()


@pytest.mark.parametrize(("member", "name"), NAMES)
def test_every_array_has_a_kind_and_a_shape(tmp_path, member, name):
    array = ARRAYS[member][name]
    kind = np.zeros(array.shape, "U3") if array.dtype.kind != "U" else np.zeros(array.shape)
    refused(tmp_path, member, name, f"holds {kind.dtype}, expected", **{name: kind})
    if not re.fullmatch(r"(weight|bias)_\d", name):  # whose shapes follow each other, which is another sentence
        refused(tmp_path, member, name, r"has shape \(1,.*\), not \(", **{name: array[None]})


@pytest.mark.parametrize(("member", "name"), [n for n in NAMES if n[1] != "betas"])
def test_an_array_is_not_empty(tmp_path, member, name):
    array = ARRAYS[member][name]
    refused(
        tmp_path,
        member,
        name,
        r"is empty|has shape \(.*0.*\), not",
        **{name: np.zeros((0, *array.shape[1:]), array.dtype)},
    )


@pytest.mark.parametrize(("member", "name"), [n for n in NAMES if n[1] not in MAY_BE_MISSING])
def test_an_array_that_is_missing_is_named(tmp_path, member, name):
    with pytest.raises(UserError, match=rf"{re.escape(member)} lacks the array '{name}'; export it again"):
        opened(tmp_path, member, **{name: None})


REAL = [n for n in NAMES if ARRAYS[n[0]][n[1]].dtype.kind == "f" and ARRAYS[n[0]][n[1]].size]


@pytest.mark.parametrize(("member", "name"), REAL)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_no_number_is_nan_or_infinite(tmp_path, member, name, value):
    array = np.array(ARRAYS[member][name])
    array.reshape(-1)[-1] = value
    refused(tmp_path, member, name, "holds NaN or infinity", **{name: array})


def altered(member, name, place, value):
    array = np.array(ARRAYS[member][name])
    array[place] = value
    return array


@pytest.mark.parametrize(
    ("member", "name", "place", "value", "fault"),
    [
        ("surface.npz", "map_resolution", (), 0, "holds 0, less than 1"),
        ("surface.npz", "map_resolution", (), 2**40, "more than 16384"),
        ("surface.npz", "map_texel", 3, 256, "points outside 0 to 255"),
        ("surface.npz", "map_texel", 0, -1, "points outside 0 to 255"),
        ("surface.npz", "gaussians_rank", 0, 1, "is no order of 60 things"),
        ("surface.npz", "gaussians_rank", 0, -1, "points outside 0 to 59"),
        ("surface.npz", "gaussians_spacing", 0, -0.1, "holds -0.1, less than 0"),
        ("surface.npz", "map_joint_index", (0, 0), 52, "points outside 0 to 51"),
        ("surface.npz", "gaussians_joint_weight", (5, 0), 0.3, "has weights that sum to .*, not 1"),
        ("surface.npz", "gaussians_joint_weight", (5, 0), -0.1, "holds -0.1, less than 0"),
        ("surface.npz", "gaussians_points", (0, 0), 3e38, "holds 3e\\+38, more than 10000"),
        ("surface.npz", "map_parents", 7, -1, "is no skeleton: joint 7 has the parent -1"),
        ("surface.npz", "map_parents", 7, 7, "is no skeleton: joint 7 has the parent 7"),
        ("surface.npz", "gaussians_parents", 3, 40, "is no skeleton: joint 3 has the parent 40"),
        ("surface.npz", "gaussians_parents", 0, 5, "is no skeleton: joint 0 has the parent 5"),
        ("surface.npz", "gaussians_A_canonical", (2, 0, 0), 2.0, "is no rigid transform at joint 2"),
        ("surface.npz", "gaussians_A_canonical", slice(None), 0, "is no rigid transform at joint 0"),
        ("body.npz", "joint_names", 4, "pelvis", "holds 'pelvis' 2 times"),
        ("baked.npz", "scales", 0, -0.01, "less than 0"),
        ("coarse.npz", "index", (0, 0), COARSE_COUNT, f"points outside 0 to {COARSE_COUNT - 1}"),
        ("coarse.npz", "weight", slice(None), 0, "sum to 0, not 1"),
        ("coarse.npz", "ratio", (), -1, "less than 0"),
        ("blendshape.npz", "part", 0, 2, "points outside 0 to 1"),
        ("blendshape.npz", "joints", 0, 52, "points outside 0 to 51"),
        ("blendshape.npz", "owners", 0, 22, "holds 22, more than 21"),
        ("blendshape.npz", "fade", slice(None), 1, "does not ascend"),
        ("blendshape.npz", "weight_0", (0, 0), 1e30, "holds 1e\\+30, more than 1e\\+06"),
    ],
)
def test_a_value_that_cannot_be(tmp_path, member, name, place, value, fault):
    refused(tmp_path, member, name, fault, **{name: altered(member, name, place, value)})


def test_layers_of_the_small_network_follow_each_other(tmp_path):
    for change in ({"weight_1": np.zeros((4, 8), np.float32)}, {"bias_1": np.zeros(7, np.float32)}):
        with pytest.raises(
            UserError, match=r"blendshape\.npz: arrays 'weight_1' and 'bias_1' have shapes .*not \(5, 8\)"
        ):
            opened(tmp_path, "blendshape.npz", **change)


def test_arrays_of_another_width_play_as_they_are(tmp_path):
    wide = {n: ARRAYS["surface.npz"][n].astype(np.float64) for n in ("gaussians_points", "map_joint_weight")}
    pose = np.full((52, 3), 0.1, np.float32)
    (tmp_path / "whole").mkdir()
    before = opened(tmp_path / "whole", "surface.npz").gaussians(pose)
    after = opened(tmp_path, "surface.npz", **wide).gaussians(pose)
    np.testing.assert_array_equal(after.means, before.means)
    assert after.means.dtype == np.float32


def test_weights_that_sum_to_one_but_for_rounding_are_left_as_they_are(tmp_path):
    weight = ARRAYS["surface.npz"]["gaussians_joint_weight"] * np.float32(1 + 9e-4)
    read = opened(tmp_path, "surface.npz", gaussians_joint_weight=weight).surface.joint_weight
    np.testing.assert_array_equal(read, weight)


# what an archive claims


def claiming(shape: tuple[int, ...]) -> bytes:
    """body.npz with another shape in the header of the joints."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        for name, array in ARRAYS["body.npz"].items():
            data = io.BytesIO()
            header = np.lib.format.header_data_from_array_1_0(array)
            np.lib.format.write_array_header_1_0(data, header | ({"shape": shape} if name == "joints" else {}))
            file.writestr(f"{name}.npy", data.getvalue() + array.tobytes())
    return buffer.getvalue()


@pytest.mark.parametrize("shape", [(10**12,), (10**6, 10**7), (-1,), (3,), (0,), ()])
def test_a_size_that_a_header_claims_is_held_against_what_is_there(tmp_path, shape):
    path = write_tiered(tmp_path / "a.gavatar", {"body.npz": claiming(shape)})
    with pytest.raises(
        UserError, match=r"body\.npz is not a readable \.npz \(joints\.npy claims -?\d+ bytes and has 1248\)"
    ):
        Avatar(path)


@pytest.mark.parametrize("where", ["bundle", "member"])
def test_a_small_member_that_would_unpack_to_very_much_is_refused(tmp_path, where):
    zeros = bytes(80 << 20)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("joint_names.npy", zeros)
    bomb = zeros if where == "bundle" else buffer.getvalue()
    path = write_tiered(tmp_path / "a.gavatar", {"body.npz": bomb})
    assert path.stat().st_size < 1 << 20
    with pytest.raises(UserError, match=rf"body\.npz .*would unpack from \d+ to {80 << 20} bytes"):
        Avatar(path)


def test_a_manifest_nested_without_end_is_no_manifest(tmp_path):
    path = tmp_path / "a.gavatar"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("manifest.json", "[" * 100_000)
    with pytest.raises(UserError, match=r"manifest\.json is not JSON"):
        Avatar(path)


def test_the_hand_made_bundle_has_an_array_of_each_rule():
    for member in (BAKED, COARSE, BLENDSHAPE):
        patterns = [*member.arrays, *member.others]
        assert all(any(re.fullmatch(p, name) for name in ARRAYS[member.file]) for p in patterns)
        assert all(any(re.fullmatch(p, name) for p in patterns) for name in ARRAYS[member.file])
