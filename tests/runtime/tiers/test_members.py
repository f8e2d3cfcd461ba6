"""The members of tiers: who writes them and who reads them mean the same arrays."""

from __future__ import annotations

import io

import numpy as np
import pytest

from gavatar_runtime.bundle import pack_arrays
from gavatar_runtime.tiers import members_read, player_tiers
from gavatar_runtime.tiers.members import BAKED, BLENDSHAPE, ArrayMember


def test_a_member_is_packed_as_its_arrays_are_given():
    arrays = {"offsets": np.zeros((2, 3)), "colors": np.ones((2, 3)), "scales": np.ones(2)}
    assert BAKED.pack(arrays) == pack_arrays(arrays)
    with np.load(io.BytesIO(BAKED.pack(arrays)), allow_pickle=False) as file:
        assert sorted(file.files) == sorted(BAKED.arrays)


@pytest.mark.parametrize(
    ("arrays", "fault"),
    [
        ({"a": 0}, r"arrays \['b'\] are missing, arrays \[\] are unknown"),
        ({"a": 0, "b": 0, "c": 0}, r"arrays \[\] are missing, arrays \['c'\] are unknown"),
        ({}, r"arrays \['a', 'b'\] are missing"),
        ({"a": 0, "b": 0, "layer_1x": 0}, "'layer_1x'"),
    ],
)
def test_an_array_that_is_missing_or_that_no_reader_knows_is_the_writers_mistake(arrays, fault):
    member = ArrayMember("x.npz", ("a", "b"), (r"layer_\d+",))
    with pytest.raises(ValueError, match=fault):
        member.pack({name: np.zeros(1) for name in arrays})
    assert member.pack({name: np.zeros(1) for name in ("a", "b", "layer_12")})


def test_the_blendshapes_network_may_have_any_number_of_layers():
    arrays = dict.fromkeys(BLENDSHAPE.arrays, np.zeros(1))
    layers = {f"{kind}_{i}": np.zeros(1) for i in range(12) for kind in ("weight", "bias")}
    assert BLENDSHAPE.pack(arrays | layers | {"turn": np.zeros(1), "fade": np.zeros(2)})


def test_of_a_bundles_members_each_tier_reads_its_own_and_those_that_are_nobodys():
    tiers = player_tiers()
    own = {name: set(tiers[name].factory.members) for name in tiers.names()}
    members = {"surface.npz", "body.npz", "anything.npz"}.union(*own.values())
    for name in tiers.names():
        read = members_read(members, tiers.names(), [name])
        assert read == {"surface.npz", "body.npz", "anything.npz"} | own[name]
    assert members_read(members, tiers.names(), tiers.names()) == members
    assert members_read([], tiers.names(), tiers.names()) == set()
