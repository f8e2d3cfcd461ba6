"""What a pose encoder may look at: images of the posed body over the UV atlas, and its joints' rotations.

The inputs of encoder.onnx are named after `INPUTS`; an encoder has any of them, in any order.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from ..errors import UserError
from ..geometry.rotations import matrix_from_axis_angle
from ..geometry.skinning import skin
from ..values.body import SMPL_BODY_JOINTS
from ..values.surface import Atlas
from .uv_maps import normal_map, positional_map, root_relative_transforms, turning_transforms


def joint_rotations(poses: np.ndarray) -> np.ndarray:
    """(..., 22, 3, 3) float32 rotations of the body joints relative to their parents; the root's is the identity.

    poses: (..., J, 3) axis-angle, radians, J >= 22.
    """
    poses = np.array(np.asarray(poses)[..., :SMPL_BODY_JOINTS, :], np.float32)
    poses[..., 0, :] = 0
    return matrix_from_axis_angle(poses).astype(np.float32)


def _channels_first(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.moveaxis(image, -1, -3))


Shape = tuple[int | str, ...]  # of one pose's input; SIDE stands for the texels along a side of the encoder's maps
SIDE = "M"
_MAP: Shape = (3, SIDE, SIDE)


@dataclasses.dataclass(frozen=True)
class InputKind:
    """shape: of one pose's. compute: from the surface of the maps and poses (..., J, 3), float32."""

    shape: Shape
    compute: Callable[[Atlas, np.ndarray], np.ndarray]

    def __call__(self, surface: Atlas, poses: np.ndarray) -> np.ndarray:
        """(..., *shape) float32."""
        return self.compute(surface, poses)


INPUTS: dict[str, InputKind] = {
    # metres, in the frame of the root: neither place nor facing is seen
    "positional_map": InputKind(
        (3, SIDE, SIDE), lambda surface, poses: _channels_first(positional_map(surface, poses))
    ),
    # unit normals in the world: what light falls from is seen
    "normal_map": InputKind(_MAP, lambda surface, poses: _channels_first(normal_map(surface, poses))),
    "joint_rotations": InputKind((SMPL_BODY_JOINTS, 3, 3), lambda surface, poses: joint_rotations(poses)),
}


def input_shapes(*names: str) -> dict[str, Shape]:
    """The shapes of the named inputs, as an encoder declares what it looks at. UserError for a name that is none."""
    check_inputs(names, "the encoder")
    return {name: INPUTS[name].shape for name in names}


def input_shape(name: str, size: int) -> tuple[int, ...]:
    """The shape of one pose's input, its map `size` texels wide and high."""
    return tuple(size if isinstance(side, str) else side for side in INPUTS[name].shape)


def pose_inputs(surface: Atlas, poses: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, ...]:
    """The named inputs of poses (..., J, 3), float32, in the order of the names; maps are of `surface`'s resolution."""
    return tuple(INPUTS[name](surface, poses) for name in names)


class PoseInput:
    """One named input of one pose after another, (1, ...), by the compiled kernel where it is; the next call fills the
    same array again. The same numbers as `pose_inputs`, to rounding."""

    def __init__(self, name: str, surface: Atlas):
        self._name, self._surface = name, surface
        self._map = np.zeros((1, 3, surface.resolution, surface.resolution), np.float32)
        self._skinned = np.empty((len(surface), 3), np.float32)

    def __call__(self, pose: np.ndarray) -> np.ndarray:
        """pose: (J, 3) axis-angle, radians."""
        surface = self._surface
        if self._name == "joint_rotations":
            return joint_rotations(pose)[None]
        if self._name == "positional_map":
            vectors, A = surface.points, root_relative_transforms(surface, pose)
        else:
            vectors, A = surface.normals, turning_transforms(surface, pose)
        out = skin(vectors, surface.joint_index, surface.joint_weight, A, self._skinned)
        if self._name == "normal_map":
            out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-6)
        flat = self._map.reshape(3, -1)
        for channel in range(3):
            flat[channel, surface.texel] = out[:, channel]
        return self._map


def check_inputs(names: Sequence[str], source: str) -> None:
    """UserError naming `source` unless every name is one of `INPUTS`."""
    unknown = [name for name in names if name not in INPUTS]
    if unknown:
        raise UserError(
            f"{source} wants the input '{unknown[0]}', and this gavatar knows {', '.join(INPUTS)}: update gavatar, or "
            "export the avatar again"
        )
