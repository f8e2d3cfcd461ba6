"""Decoding only what the camera can see, and opening the body alone."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.values.motion import Motion


@pytest.mark.parametrize("tier", ["full", "int8"])
@pytest.mark.parametrize("count", [None, 4000])
def test_decoding_what_is_seen_changes_nothing_of_what_is_decoded(fine_bundle, tier, count):
    level = {"tier": tier, "gaussians": count}
    whole, seen = Avatar(fine_bundle, **level), Avatar(fine_bundle, **level, seen_only=True)
    assert seen.seen_only
    pose = np.random.default_rng(0).normal(0, 0.2, (52, 3)).astype(np.float32)
    motion = Motion(pose[None], np.zeros((1, 3), np.float32), 30.0)
    camera = frame_motion(whole, motion, 96, 96)
    for _ in range(2):  # the first call finds the shapes, the next ones fill what is there
        every, some = whole.gaussians(pose), seen.gaussians(pose, camera=camera)
        assert 0.4 * len(whole) < len(some) < 0.95 * len(whole)
        place = {tuple(mean): i for i, mean in enumerate(every.means.round(4).tolist())}
        rows = [place.get(tuple(mean), -1) for mean in some.means.round(4).tolist()]
        known = np.array(rows) >= 0  # rounding may part a few
        assert known.mean() > 0.98
        np.testing.assert_allclose(some.colors[known], every.colors[np.array(rows)[known]], atol=1e-5)
    assert len(seen.gaussians(pose)) == len(whole)  # without a camera all are decoded
    away = dataclasses.replace(camera, T_camera_world=np.diag([1.0, -1, -1, 1]) @ camera.T_camera_world)
    assert len(seen.gaussians(pose, camera=away)) == 0
    rasterizer = build_rasterizer()
    assert (rasterizer.render(seen.gaussians(pose, camera=away), away, (1, 1, 1)).color == 1).all()


def test_only_networks_of_one_decode_a_frame_leave_out_what_is_not_seen(fine_bundle):
    assert not Avatar(fine_bundle, tier="baked", seen_only=True).seen_only
    assert not Avatar(fine_bundle, tier="int8", seen_only=True, reuse=2).seen_only


def test_the_body_alone_is_what_framing_needs_and_gives_no_gaussians(fine_bundle):
    body, avatar = Avatar(fine_bundle, tier=None), Avatar(fine_bundle)
    assert len(body) == len(avatar)
    assert not body.networks
    assert avatar.networks
    motion = Motion(np.zeros((2, 52, 3), np.float32), np.float32([[0, 0, 0], [0, 0, 1.0]]), 30.0)
    assert frame_motion(body, motion, 64, 64).fx == frame_motion(avatar, motion, 64, 64).fx
    with pytest.raises(ValueError, match="tier=None"):
        body.gaussians(np.zeros((52, 3), np.float32))


def test_the_player_takes_detail_and_seen_only_or_says_why_not(fine_bundle, tmp_path, capsys):
    from gavatar_runtime.cli.play import main

    def run(*options) -> tuple[int, dict, str]:
        report = tmp_path / "r.json"
        arguments = ["--size", "64", "--frames", "0:3", "--out", str(tmp_path / "f"), "--json", str(report), *options]
        with pytest.raises(SystemExit) as done:
            main([str(fine_bundle.path), *arguments])
        return done.value.code, json.loads(report.read_text()) if report.exists() else {}, capsys.readouterr().err

    code, report, _ = run("--gaussians", "auto", "--tier", "baked")
    assert code == 0
    assert report["gaussians"] < fine_bundle.manifest.gaussians
    code, report, error = run("--detail", "64", "--tier", "full", "--seen-only")
    assert code == 0
    assert f"note: --uv 64 is the former way to say --gaussians {report['gaussians']}" in error
    code, _, error = run("--tier", "baked", "--seen-only")
    assert code == 2
    assert "tier baked has nothing to leave out" in error
    code, _, error = run("--tier", "int8", "--seen-only", "--reuse", "2")
    assert code == 2
    assert "leave --reuse out" in error
    assert "--seen-only out" in run("--budget-ms", "5", "--seen-only")[2]
