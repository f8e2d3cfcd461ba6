"""SMPL, SMPL-H and SMPL-X against the `smplx` package on the same files."""

from __future__ import annotations

import pytest
import torch

pytest.importorskip("smplx")
from smplx_parity import CASES, distance, gradients, open_pair

# The aim of the project. Their Rodrigues adds 1e-8 rad to every angle, which arms of a metre turn into 1e-7 m or less.
TOLERANCE = 1e-5


@pytest.fixture(scope="module", params=CASES)
def pair(request, tmp_path_factory):
    return open_pair(request.param, tmp_path_factory.mktemp("model"))


@pytest.mark.parametrize(("batch", "angle"), [(1, 0.5), (3, 0.0), (2, 2.0)])
def test_vertices_and_joints_agree(pair, batch, angle):
    assert distance(pair, batch, seed=batch, angle=angle).worst < TOLERANCE


def test_gradients_to_pose_shape_and_expression_agree(pair):
    # relative to the largest entry; their 1e-8 rad again, in the derivative
    assert max(gradients(pair).values()) < 1e-6


def test_float32_agrees_too(tmp_path):
    pair = open_pair("SMPL-X, axis-angle hands, mean", tmp_path, torch.float32)
    assert distance(pair, 2).worst < TOLERANCE
