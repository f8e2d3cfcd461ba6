"""The tier `blendshape`: residuals of the pose as linear bases by body part, weighted by a tiny network of the pose."""

from __future__ import annotations

from collections.abc import Mapping
from time import perf_counter

import numpy as np

from ..components import NoOptions
from ..decoding.residuals import Attributes, blendshapes, empty, packed
from ..errors import UserError
from ..geometry.rotations import matrix_from_axis_angle
from ..values.array_rules import ADVICE, lacking
from ..values.body import SMPL_BODY_JOINTS
from . import PLAYER_TIERS, Parts, TierTraits
from .baked import baked_attributes
from .members import BAKED, BLENDSHAPE


def pose_input(poses: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(..., 9 x len(joints)) float32: local rotation matrices of `joints`, less the identity. poses: (..., J, 3)."""
    R = matrix_from_axis_angle(np.asarray(poses, np.float32)[..., joints, :]) - np.eye(3, dtype=np.float32)
    return R.reshape(*R.shape[:-3], -1).astype(np.float32)


def turn_input(poses: np.ndarray, owners: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """(..., P, 55) float32: the world rotation of the joint that owns each part, 9 entries, their 45 products, and 1:
    what the light of a room on a turning surface is linear in, to second order.

    poses: (..., J, 3) axis-angle. owners: (P,) joints below 22. parents: (J,)."""
    world = matrix_from_axis_angle(np.asarray(poses, np.float32)[..., :SMPL_BODY_JOINTS, :])
    for joint, parent in enumerate(parents[:SMPL_BODY_JOINTS]):
        if parent >= 0:
            world[..., joint, :, :] = world[..., parent, :, :] @ world[..., joint, :, :]
    R = world[..., owners, :, :].reshape(*world.shape[:-3], len(owners), 9)
    row, column = np.triu_indices(9)
    return np.concatenate([R, R[..., row] * R[..., column], np.ones_like(R[..., :1])], -1).astype(np.float32)


class Coefficients:
    """The weights of the bases in a pose, from the arrays of blendshape.npz, which obey `members.BLENDSHAPE`.

    parents: (J,) of the body's joints. source: named in errors. Raises UserError for layers that do not follow each
    other."""

    def __init__(self, arrays: Mapping[str, np.ndarray], parents: np.ndarray, source: str):
        self._parts, self._parents = len(arrays["gains"]), np.asarray(parents)
        self._low, self._high = arrays["low"], arrays["high"]
        self._input_range = arrays["input_low"], arrays["input_high"]
        self._joints = arrays["joints"].astype(int)
        self._layers = _layers(arrays, len(self._input_range[0]), len(self._low), source)
        self._turn: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._filmed: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        if "turn" in arrays:
            self._turn = arrays["turn"], arrays["direct"], arrays["owners"].astype(int)
        if "seen" in arrays:
            seen, near = arrays["seen"].astype(np.float32), arrays["near"].astype(np.float32)
            self._filmed = seen, near / np.maximum(near.sum(1, keepdims=True), 1), arrays["fade"]

    def __call__(self, pose: np.ndarray) -> np.ndarray:
        """(P, K) for a pose (J, 3)."""
        given = pose_input(pose, self._joints)
        bounded = x = np.clip(given, *self._input_range)
        for i, (weight, bias) in enumerate(self._layers):
            x = x @ weight + bias
            if i < len(self._layers) - 1:
                x = np.maximum(x, 0)
        if self._turn is not None:
            turn, direct, owners = self._turn
            x = x + bounded @ direct + np.einsum("pf,pfk->pk", turn_input(pose, owners, self._parents), turn).ravel()
        weights = np.clip(x, self._low, self._high).reshape(self._parts, -1)
        return weights if self._filmed is None else weights * self.shares(given)[:, None]

    def shares(self, given: np.ndarray) -> np.ndarray:
        """(P,) in [0, 1]: how much of its residual each part keeps, from the root mean square distance of its joints'
        inputs to those of the nearest filmed pose."""
        if self._filmed is None:
            return np.ones(self._parts, np.float32)
        seen, weight, (near, far) = self._filmed
        square = np.square(seen - given).reshape(len(seen), -1, 9).sum(-1)
        distance = np.sqrt((square @ weight.T).min(0))
        t = np.clip((far - distance) / (far - near), 0, 1)
        return t * t * (3 - 2 * t)


def _layers(arrays: Mapping[str, np.ndarray], inputs: int, outputs: int, source: str) -> list[tuple]:
    """The network's weight and bias by layer, from so many inputs to so many outputs."""
    count = max(sum(name.startswith(kind) for name in arrays) for kind in ("weight_", "bias_"))
    layers, width = [], inputs
    for i in range(count):
        for name in (f"weight_{i}", f"bias_{i}"):
            if name not in arrays:
                raise lacking(source, name)
        weight, bias = arrays[f"weight_{i}"], arrays[f"bias_{i}"]
        following = (width, outputs if i == count - 1 else weight.shape[1])
        if weight.shape != following or bias.shape != following[1:]:
            raise UserError(
                f"{source}: arrays 'weight_{i}' and 'bias_{i}' have shapes {weight.shape} and {bias.shape}, not "
                f"{following} and {following[1:]}; {ADVICE}"
            )
        layers.append((weight, bias))
        width = weight.shape[1]
    if not layers:
        raise lacking(source, "weight_0")
    return layers


@PLAYER_TIERS.register(
    "blendshape", summary="pose residuals as linear bases by body part", traits=TierTraits(linear=True)
)
class Blendshape:
    """The still look, and bases of each body part weighted by `Coefficients`: inputs and coefficients are kept within
    the range of training, so that no pose can leave what was seen, and a part whose joints are far from every filmed
    pose loses its residual; see `members.BLENDSHAPE`."""

    members: tuple[str, ...] = (BLENDSHAPE.file, BAKED.file)
    moves, networks, picks = True, False, False

    def __init__(self, options: NoOptions, *, parts: Parts):
        arrays = parts.arrays(BLENDSHAPE)
        source = f"{parts.bundle.path}: {BLENDSHAPE.file}"
        self._still = baked_attributes(parts)
        self._base = packed(*self._still)
        self._part = np.ascontiguousarray(parts.take(arrays["part"]))
        self._basis = np.ascontiguousarray(parts.take(arrays["basis"]))
        self._gains = arrays["gains"]
        self._arrays = {**arrays, "part": self._part, "basis": self._basis}
        self.coefficients = Coefficients(arrays, parts.surface.parents, source)
        self._out = [empty(len(parts)) for _ in range(3)]
        self._calls = 0
        self.stage_seconds: dict[str, float] = {}

    def __call__(self, pose: np.ndarray) -> Attributes:
        start = perf_counter()
        weights = self.coefficients(pose)
        encoded = perf_counter()
        self._calls += 1
        out = blendshapes(self._base, self._part, self._basis, weights, self._gains, self._out[self._calls % 3])
        self.stage_seconds = {"encode": encoded - start, "decode": perf_counter() - encoded}
        return out

    def linear(self) -> tuple[Attributes, Mapping[str, np.ndarray]]:
        """See `LinearTier`."""
        return self._still, self._arrays
