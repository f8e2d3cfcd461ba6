"""Linear blend skinning of many points: compiled where the kernel is, NumPy otherwise."""

from __future__ import annotations

import numpy as np

from .. import native_library as nl
from ..errors import WrongValue
from . import kinematics

# By storage alone a row of weights may sum to so much more or less than one: 5e-4 in float16, 8e-3 from four weights in
# 8 bits. What float32 leaves, 1e-7 a weight, is kept to the last bit.
STORED, EXACT = 1e-2, 1e-5


def whole_weights(weights: np.ndarray, what: str) -> np.ndarray:
    """Skinning weights whose rows sum to one, or WrongValue.

    weights: (V, J), of any number type. Returns them as they are where all rows sum to one within `EXACT`; else floats
    whose rows that are off by at most `STORED` were divided by their sums, without a note, as storage explains that
    much. Negative weights of at most `EXACT` become zero. WrongValue says of `what` (file and field) which row is not
    finite, negative, all zero, or sums to something else: points would be drawn towards the origin or away from it.
    `skin` and its like take weights as they are, so bodies are checked by this once, when they are made, and bundles
    by `read_bundle`'s rules for their arrays.
    """
    weights = np.asarray(weights)
    values = weights.astype(np.promote_types(weights.dtype, np.float32), copy=False)
    sums = values.sum(-1, dtype=np.float64)
    smallest = values.min(-1, initial=0.0)
    for wrong, fault in (
        (~np.isfinite(sums), "hold NaN or infinity"),
        (smallest < -EXACT, "hold negative numbers"),
        (np.abs(sums) <= EXACT, "are all zero"),
        (np.abs(sums - 1) > STORED, "do not sum to 1"),
    ):
        if wrong.any():
            row, rows = int(np.argmax(wrong)), int(wrong.sum())
            raise WrongValue(
                f"{what}: the skinning weights of {rows} of {len(sums)} vertices {fault} (vertex {row} first, sum "
                f"{sums[row]:.4g}): each row must be the parts of 1 that the joints have in a vertex"
            )
    if (np.abs(sums - 1) <= EXACT).all() and not (smallest < 0).any():
        return weights
    values = np.maximum(values, 0)
    sums = values.sum(-1, keepdims=True, dtype=np.float64)
    return np.where(np.abs(sums - 1) <= EXACT, values, values / sums).astype(values.dtype)


def skin(
    points: np.ndarray, joint_index: np.ndarray, joint_weight: np.ndarray, A: np.ndarray, out: np.ndarray | None = None
) -> np.ndarray:
    """Linear blend skinning with sparse weights; the same as `kinematics.skin`, many times faster in float32.

    points: (N, 3) metres, in the frame A maps from. joint_index: (N, K) int; joint_weight: (N, K), rows sum to 1
    (`whole_weights`), unused entries have weight 0; a row of zeros puts its point at the origin. A: (J, 4, 4) or
    (J, 3, 4). out: (N, 3) float32 to fill, or None for a new array. Returns (N, 3), of the points' dtype.
    Raises ValueError for shapes that do not belong together and IndexError for a joint that A does not have. int32
    indices, float32 weights and contiguous arrays spare a conversion.
    """
    if points.dtype != np.float32 or not nl.available()[0]:
        result = kinematics.skin(points, joint_index, joint_weight, A)
        if out is None:
            return result
        out[...] = result
        return out
    count, slots = joint_index.shape
    if points.shape != (count, 3) or joint_weight.shape != (count, slots) or A.shape[1:] not in ((4, 4), (3, 4)):
        shapes = (
            f"points {points.shape}, joint_index {joint_index.shape}, joint_weight {joint_weight.shape}, A {A.shape}"
        )
        raise ValueError(f"skin: shapes do not belong together: {shapes}")
    if out is None:
        out = np.empty((count, 3), np.float32)
    elif out.shape != (count, 3) or out.dtype != np.float32 or not out.flags.c_contiguous:
        raise ValueError("skin: out must be a contiguous float32 array of the points' shape")
    points, weight, A = (np.ascontiguousarray(x, np.float32) for x in (points, joint_weight, A))
    index = np.ascontiguousarray(joint_index, np.int32)
    stride = 4 * A.shape[1]
    inputs = (x.ctypes.data for x in (points, index, weight, A))
    code = nl.library().gv_skin(count, slots, len(A), stride, *inputs, out.ctypes.data)
    if code == -2:
        raise IndexError(f"skin: joint_index has entries outside 0..{len(A) - 1}")
    nl.check(code)
    return out


def skin_gradients(
    points: np.ndarray, joint_index: np.ndarray, joint_weight: np.ndarray, A: np.ndarray, grad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of `skin` by points, (N, 3), and by A, of its shape, from `grad` (N, 3), the gradient by its result.

    float32. Needs the compiled kernel (UserError). The same to the last bit whatever the number of threads.
    """
    points, weight, A, grad = (np.ascontiguousarray(x, np.float32) for x in (points, joint_weight, A, grad))
    index = np.ascontiguousarray(joint_index, np.int32)
    count, slots = index.shape
    if points.shape != (count, 3) or weight.shape != (count, slots) or grad.shape != (count, 3):
        raise ValueError("skin_gradients: shapes do not belong together")
    grad_points, grad_A = np.empty_like(points), np.empty_like(A)
    arrays = (x.ctypes.data for x in (points, index, weight, A, grad, grad_points, grad_A))
    code = nl.library().gv_skin_backward(count, slots, len(A), 4 * A.shape[1], *arrays)
    if code == -2:
        raise IndexError(f"skin_gradients: joint_index has entries outside 0..{len(A) - 1}")
    nl.check(code)
    return grad_points, grad_A
