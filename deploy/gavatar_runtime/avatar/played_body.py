"""The body of a bundle: its joints, and what of a motion it can take."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..bundle import Bundle
from ..errors import WrongValue
from ..motions.fitting import fit_motion, scaled_to_legs
from ..values.array_rules import FAR, Rule, a_tree, all_different, checked
from ..values.body import Hands
from ..values.motion import Motion

MEMBER = "body.npz"
RULES = {  # of J joints, B coefficients of the shape and K of a hand
    "joint_names": Rule(("J",), np.str_, tests=(all_different,)),
    "parents": Rule(("J",), np.int32, low=-1, optional=True, tests=(a_tree,)),
    "joints": Rule(("J", 3), np.float64, low=-FAR, high=FAR, optional=True),
    "betas": Rule(("B",), np.float64, optional=True, empty=True),
    "rest_pose": Rule(("J", 3), np.floating, optional=True),
    "hands_mean": Rule((2, 15, 3), np.float64, optional=True, beside=("hands_components",)),
    "hands_components": Rule((2, "K", 45), np.float64, optional=True, beside=("hands_mean",)),
}


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

        Raises WrongValue for a motion without frames and for a NaN or infinite pose, translation or expression.
        """
        if not len(motion):
            raise WrongValue(f"motion '{motion.name}' has no frames")
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
    arrays = checked(bundle.arrays(MEMBER), RULES, f"{bundle.path}: {MEMBER}", sizes={"J": len(joints)})
    names = tuple(str(name) for name in arrays["joint_names"])
    hands = Hands(arrays["hands_mean"], arrays["hands_components"]) if "hands_components" in arrays else None
    return PlayedBody(names, joints, arrays.get("rest_pose"), hands, num_expression)
