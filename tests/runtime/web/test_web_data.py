"""What the page's data hold, read back by a reader of the tests' own."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from web_reading import arrays_of, points_of, read_bin

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.geometry.ordering import progressive_rank
from gavatar_runtime.motions import read_motion
from gavatar_runtime.web.look import StillLook, read_look
from gavatar_runtime.web.web_data import pack

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import make_bundle
from tiered_members import write_tiered


@pytest.fixture(scope="module")
def body(tmp_path_factory) -> Avatar:
    return Avatar(read_bundle(make_bundle(tmp_path_factory.mktemp("web") / "a.gavatar", 9000)), tier=None)


@pytest.fixture(scope="module")
def look(body) -> StillLook:
    return read_look(body)


def packed(look: StillLook, *motions) -> tuple[dict, list[bytes]]:
    return read_bin(pack(look, motions).to_bytes())


def test_points_scales_and_colours_come_back_within_half_a_step(look):
    varied = dataclasses.replace(look, scales=np.linspace(0.001, 0.03, len(look), dtype=np.float32))
    got, order = points_of(*packed(varied)), np.argsort(look.rank)
    span = np.ptp(look.points, axis=0)
    assert np.all(np.abs(got["points"] - look.points[order]) <= span / 65535 / 2 + 1e-7)  # and float32's own rounding
    assert np.abs(got["scales"] - varied.scales[order]).max() <= 0.029 / 65535 / 2 + 1e-8
    assert np.abs(got["colors"] - look.colors[order]).max() <= 0.5 / 255 + 1e-6
    assert np.abs(got["spacing"] - look.spacing[order]).max() <= look.spacing.max() / 255 / 2 + 1e-8


def test_weights_sum_to_255_and_are_the_bodys_within_a_step(look):
    got, order = points_of(*packed(look)), np.argsort(look.rank)
    assert np.all(got["weights"].astype(int).sum(1) == 255)
    dense, theirs = np.zeros((2, len(look), 52))
    np.add.at(dense, (np.arange(len(look))[:, None], got["joints"]), got["weights"] / 255)
    np.add.at(theirs, (np.arange(len(look))[:, None], look.joint_index[order]), look.joint_weight[order])
    assert np.abs(dense - theirs).max() < 1 / 255 + 1e-6  # rounded up or down, by the largest remainders


def test_more_than_four_joints_a_point_take_another_slot(look):
    rng = np.random.default_rng(0)
    index = np.tile(np.arange(7, dtype=np.int32), (len(look), 1))
    weight = rng.dirichlet(np.ones(7), len(look)).astype(np.float32)
    got = points_of(*packed(dataclasses.replace(look, joint_index=index, joint_weight=weight)))
    assert got["weights"].shape[1] == 8
    assert np.all(got["weights"].astype(int).sum(1) == 255)
    dense = np.zeros((len(look), 7))
    np.add.at(dense, (np.arange(len(look))[:, None], got["joints"]), got["weights"] / 255)
    assert np.abs(dense - weight[np.argsort(look.rank)]).max() < 1 / 255 + 1e-6


def test_a_slot_that_nobody_needs_is_left_out(look):
    index = np.tile(np.arange(6, dtype=np.int32), (len(look), 1))
    weight = np.tile(np.float32([0.5, 0.5, 0, 0, 0, 0]), (len(look), 1))
    header, _ = packed(dataclasses.replace(look, joint_index=index, joint_weight=weight))
    assert header["points"]["slots"] == 4


@pytest.mark.parametrize("count", [1, 2, 1024, 1025, 8192, 8193])
def test_any_number_of_points_fills_whole_rows(look, count):
    cut = ("points", "colors", "scales", "spacing", "joint_index", "joint_weight")
    rank = progressive_rank(look.points[:count])
    some = dataclasses.replace(look, rank=rank, **{name: getattr(look, name)[:count] for name in cut})
    header, blocks = packed(some)
    got = points_of(header, blocks)
    assert len(got["points"]) == header["points"]["count"] == count
    assert np.isfinite(got["points"]).all()
    assert np.isfinite(got["scales"]).all()
    assert np.abs(got["points"] - some.points[np.argsort(rank)]).max() < 1e-4


def test_motions_come_back_to_the_bit_and_stand_after_the_first_chunk(body, look):
    motions = [body.fit(read_motion(name))[0] for name in ("turn", "wave")]
    header, blocks = packed(look, *motions)
    assert [m["name"] for m in header["motions"]] == ["turn", "wave"]
    assert [m["block"] for m in header["motions"]] == [1, 2]
    for entry, motion in zip(header["motions"], motions, strict=True):
        arrays = arrays_of(entry, blocks)
        assert np.array_equal(arrays["poses"], motion.poses)
        assert np.array_equal(arrays["trans"], motion.trans)
        assert entry["fps"] == motion.fps


def test_residuals_come_back_to_the_bit(tmp_path):
    look = read_look(Avatar(read_bundle(write_tiered(tmp_path / "t.gavatar")), tier=None))
    header, blocks = packed(look)
    got, order = points_of(header, blocks), np.argsort(look.rank)
    assert look.residual is not None
    assert np.array_equal(got["part"], look.residual["part"][order])
    assert np.array_equal(
        got["basis"], look.residual["basis"][order][:, 0, :7]
    )  # one group; the eighth channel is padding
    weighing = arrays_of(header["look"], blocks)
    for name in ("gains", "low", "high", "joints", "seen", "near", "weight_0", "bias_1"):
        assert np.array_equal(weighing[name].ravel(), look.residual[name].ravel()), name


def test_the_same_look_packs_to_the_same_bytes(look):
    assert pack(look, ()).to_bytes() == pack(look, ()).to_bytes()


def test_the_header_is_strict_json(look):
    json.dumps(packed(look)[0], allow_nan=False)
