"""The body of a bundle: its joints, and what of a motion it can take."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..bundle import Bundle
from ..errors import UserError, WrongValue
from ..motions.fitting import fit_motion, scaled_to_legs
from ..values.body import Hands
from ..values.motion import Motion

MEMBER = "body.npz"


@dataclasses.dataclass(frozen=True, eq=False)
class PlayedBody:
    """joint_names: J names. joints: (J, 3) rest joints of its shape, metres. rest_pose: (J, 3) axis-angle of joints
    that no motion moves, None where it is zero. hands: None where there is no data of any. num_expression: how many
    coefficients its face has."""

    joint_names: tuple[str, ...]
    joints: np.ndarray
    rest_pose: np.ndarray | None
    hands: Hands | None
    num_expression: int

    def fit(self, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
        """The motion brought to this body's joints, and the names of what moves in it that the body lacks.

        Raises WrongValue for a NaN or infinite pose, translation or expression.
        """
        motion, ignored = fit_motion(
            motion, self.joint_names, self.rest_pose, hands=self.hands, num_expression=self.num_expression
        )
        motion = scaled_to_legs(motion, self.joint_names, self.joints)
        rows = {"pose": motion.poses, "translation": motion.trans, "expression": motion.expression}
        for key, array in rows.items():
            if array is None:
                continue
            bad = ~np.isfinite(array.reshape(len(array), -1)).all(1)
            if bad.any():
                raise WrongValue(f"motion '{motion.name}' has a NaN or infinite {key} at frame {int(np.argmax(bad))}")
        return motion, ignored


def read_body(bundle: Bundle, joints: np.ndarray, num_expression: int) -> PlayedBody:
    """joints: (J, 3) of the bundle's surface. UserError for a body.npz that does not fit them."""
    arrays = bundle.arrays(MEMBER)
    names, rest = tuple(str(name) for name in arrays.get("joint_names", ())), arrays.get("rest_pose")
    if len(names) != len(joints):
        raise UserError(
            f"{bundle.path}: {MEMBER} names {len(names)} joints and surface.npz has {len(joints)}; export the avatar "
            "again"
        )
    if rest is not None and (rest.shape != (len(names), 3) or not np.isfinite(rest).all()):
        raise UserError(f"{bundle.path}: rest_pose in {MEMBER} is not (J, 3) numbers; export the avatar again")
    return PlayedBody(names, joints, rest, _read_hands(bundle, arrays), num_expression)


def _read_hands(bundle: Bundle, arrays: dict[str, np.ndarray]) -> Hands | None:
    if "hands_components" not in arrays:
        return None
    mean, components = np.asarray(arrays.get("hands_mean")), arrays["hands_components"]
    if mean.shape != (2, 15, 3) or components.ndim != 3 or components.shape[::2] != (2, 45):
        raise UserError(
            f"{bundle.path}: {MEMBER}: hands_mean and hands_components are not (2, 15, 3) and (2, K, 45) numbers; "
            "export the avatar again"
        )
    return Hands(mean.astype(np.float64), components.astype(np.float64))
