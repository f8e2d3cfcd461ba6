"""What a bundle says of how much of its avatar was seen: read with it, checked, and missing in former ones."""

from __future__ import annotations

import numpy as np
import pytest
from make_bundle import make_bundle, manifest, members

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import pack_arrays, write_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.point_evidence import MEMBER, Evidence

COUNT = 300


def evidence(count: int = COUNT) -> Evidence:
    views = np.linspace(0, 8, count).astype(np.float32)
    whole = np.arange(count, dtype=np.int32)
    return Evidence(10 * views, views, views / 8, whole, whole)


def bundle(path, arrays):
    write_bundle(path, manifest(COUNT), members(COUNT) | {MEMBER: pack_arrays(arrays)})
    return path


def test_an_avatar_has_the_evidence_of_its_points(tmp_path):
    path = bundle(tmp_path / "a.gavatar", evidence().to_arrays())
    found = Avatar(path).evidence
    for name, array in evidence().to_arrays().items():
        assert np.array_equal(getattr(found, name), array)
    part = found.take(np.array([7, 3]))
    assert part.poses.tolist() == [7, 3]
    assert len(part) == 2


def test_a_former_bundle_has_none(tmp_path):
    assert Avatar(make_bundle(tmp_path / "a.gavatar", COUNT)).evidence is None


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("views", np.full(COUNT, np.nan, np.float32)),
        ("views", np.full(COUNT, -1, np.float32)),
        ("pixels", np.zeros(COUNT - 1, np.float32)),
        ("pixels", np.full(COUNT, np.inf, np.float64)),
        ("squareness", np.full(COUNT, 1.1, np.float32)),
        ("poses", np.full(COUNT, -1, np.int32)),
        ("directions", np.zeros(COUNT, np.float32)),
    ],
)
def test_evidence_that_breaks_a_rule_is_refused_by_name(tmp_path, name, array):
    path = bundle(tmp_path / "a.gavatar", evidence().to_arrays() | {name: array})
    with pytest.raises(UserError, match=f"a.gavatar: evidence.npz: array '{name}'"):
        Avatar(path)


def test_evidence_that_lacks_an_array_or_is_of_other_points_is_refused(tmp_path):
    arrays = evidence().to_arrays()
    arrays.pop("poses")
    with pytest.raises(UserError, match="lacks the array 'poses'"):
        Avatar(bundle(tmp_path / "a.gavatar", arrays))
    with pytest.raises(UserError, match=r"evidence\.npz"):
        Avatar(bundle(tmp_path / "b.gavatar", evidence(COUNT + 1).to_arrays()))
