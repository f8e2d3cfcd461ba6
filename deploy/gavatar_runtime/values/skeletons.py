"""The joint names of the SMPL family: which rotation of a motion belongs to which joint of a body.

SMPL, SMPL-H and SMPL-X agree on the first 22 joints and on nothing after them: joint 22 is a hand, a finger or the jaw.
"""

from __future__ import annotations

from .body import FACE_JOINTS

BODY = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
FINGERS = tuple(
    f"{side}_{finger}{i}"
    for side in ("left", "right")
    for finger in ("index", "middle", "pinky", "ring", "thumb")
    for i in (1, 2, 3)
)
SMPL = (*BODY, "left_hand", "right_hand")
SMPLH = (*BODY, *FINGERS)
SMPLX = (*BODY, *FACE_JOINTS, *FINGERS)
_BY_COUNT = {len(names): names for names in (BODY, SMPL, SMPLH, SMPLX)}


SKELETONS = {"body": BODY, "smpl": SMPL, "smplh": SMPLH, "smplx": SMPLX}


def skeleton_of(count: int) -> tuple[str, tuple[str, ...]]:
    """The name of the skeleton of so many joints and the joints' names; `unknown` and numbers when it is none."""
    for name, names in SKELETONS.items():
        if len(names) == count:
            return name, names
    return "unknown", tuple(f"joint {j}" for j in range(count))
