"""Skinning weights whose rows do not sum to one: given back what storage took, else refused by a sentence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.geometry.skinning import whole_weights
from gavatar_runtime.values.body import BodyData


def rows(count: int = 200, joints: int = 24, seed: int = 0) -> np.ndarray:
    """(V, J) float64, four weights a vertex."""
    rng = np.random.default_rng(seed)
    weights = np.zeros((count, joints))
    for row in weights:
        row[rng.choice(joints, 4, replace=False)] = rng.dirichlet(np.ones(4))
    return weights


def body(weights: np.ndarray) -> BodyData:
    V, J = weights.shape
    return BodyData(
        name="made", v_template=np.random.default_rng(1).normal(size=(V, 3)), shapedirs=np.zeros((V, 3, 0)),
        J_regressor=np.full((J, V), 1 / V), parents=np.arange(-1, J - 1), lbs_weights=weights,
        faces=np.array([[0, 1, 2]]), uv=np.zeros((3, 2)), uv_faces=np.array([[0, 1, 2]]),
        joint_names=tuple(f"j{k}" for k in range(J)),
    )  # fmt: skip


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_good_weights_are_kept_to_the_last_bit(dtype):
    weights = rows().astype(dtype)
    assert whole_weights(weights, "x") is weights
    assert body(weights).lbs_weights is weights


@pytest.mark.parametrize("stored", ["float16", "uint8", "0.999", "1.005"])
def test_what_storage_took_is_given_back(stored, recwarn):
    exact = rows()
    kept = {
        "float16": exact.astype(np.float16), "uint8": np.round(exact * 255) / 255, "0.999": exact * 0.999,
        "1.005": exact * 1.005,
    }[stored]  # fmt: skip
    whole = whole_weights(kept, "x")
    assert whole.dtype.itemsize >= 4
    np.testing.assert_allclose(whole.sum(1), 1, atol=1e-6)  # float32 sums of four
    np.testing.assert_allclose(whole, exact, atol=4e-3)  # half a step of eight bits, and the sum's part
    # a body whose joints all move by one metre moves by one metre, wherever it stands
    made = body(kept)
    vertices, _ = made.posed(np.zeros((24, 3)), trans=np.ones(3))
    np.testing.assert_allclose(vertices, made.v_template + 1, atol=1e-5)
    assert not recwarn


def test_whole_numbers_of_one_joint_each_are_weights():
    one = np.eye(5, dtype=np.int64)
    assert whole_weights(one, "x") is one


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (0.0, "are all zero (vertex 7 first, sum 0)"),
        (np.nan, "hold NaN or infinity (vertex 7 first"),
        (np.inf, "hold NaN or infinity"),
        (-1.0, "hold negative numbers (vertex 7 first, sum -1)"),
        (0.5, "do not sum to 1 (vertex 7 first, sum 0.5)"),
        (1.02, "do not sum to 1 (vertex 7 first, sum 1.02)"),
        (255.0, "do not sum to 1"),
    ],
)
def test_other_rows_are_refused_with_their_vertex(change, message):
    weights = rows()
    with np.errstate(invalid="ignore"):
        weights[7] *= change
    with pytest.raises(WrongValue) as caught:
        whole_weights(weights, "a.npz: 'weights'")
    assert str(caught.value).startswith("a.npz: 'weights': the skinning weights of 1 of 200 vertices ")
    assert message in str(caught.value)
    with pytest.raises(UserError, match="body 'made'"):
        dataclasses.replace(body(rows()), lbs_weights=weights)


def test_noise_below_zero_becomes_zero():
    weights = rows()
    weights[3, weights[3] == 0] = -1e-7
    whole = whole_weights(weights, "x")
    assert whole.min() == 0
    np.testing.assert_allclose(whole, rows(), atol=1e-6)


@pytest.mark.parametrize("shape", [(0, 24), (1, 1)])
def test_no_vertex_and_one_joint(shape):
    weights = np.ones(shape)
    assert whole_weights(weights, "x") is weights
