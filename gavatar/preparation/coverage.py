"""Which parts of the person the footage shows. What it does not show has no say in the fit, and rests."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gavatar_runtime.values.camera import Camera

from .landmarks import INDEX, Landmarks

CERTAIN = 0.3  # least visibility of a landmark that counts: of limbs out of the picture the network says 0.01 to 0.15
SHOWN = 0.05  # least share of the frames with a landmark for which it counts as shown
# What turns a joint: without one of these landmarks its rotation is a guess. From the trunk outwards.
_TURNED_BY = {
    "hip": ("knee",), "knee": ("ankle",), "ankle": ("heel", "foot_index"), "foot": ("foot_index",),
    "shoulder": ("elbow",), "elbow": ("wrist",), "wrist": ("index", "pinky"),
}  # fmt: skip
_CHAINS = (("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist"))
# The first joint of a limb that rests -> what that is, on one side and on both.
_PARTS = {"hip": ("leg", "legs"), "knee": ("shin and foot", "shins and feet"), "ankle": ("foot", "feet"),
          "foot": ("foot", "feet"), "shoulder": ("arm", "arms"), "elbow": ("forearm and hand", "forearms and hands"),
          "wrist": ("hand", "hands")}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Coverage:
    """resting: names of the joints whose rotation no frame shows, on the body of the SMPL family, as `left_knee`.
    hips, shoulders: whether the footage shows those."""

    resting: tuple[str, ...] = ()
    hips: bool = True
    shoulders: bool = True

    @property
    def whole(self) -> bool:
        """Whether every limb is shown, at least once."""
        return not self.resting and self.hips

    @property
    def fitted(self) -> str:
        """What is shown, for people: `whole body`, `upper body`, `head and shoulders`, else `part of the body`."""
        if self.whole:
            return "whole body"
        both = {name for name in _TURNED_BY if {f"left_{name}", f"right_{name}"} <= set(self.resting)}
        if "hip" in both or "knee" in both:
            return "head and shoulders" if "elbow" in both and not self.hips else "upper body"
        return "part of the body" if both or not self.hips else "whole body"

    def sentence(self) -> str | None:
        """What was fitted and what was not, for people; None where every limb is shown."""
        if self.whole:
            return None
        parts = list(dict.fromkeys(part for chain in _CHAINS for part in self._parts(chain)))
        what = f"never seen, so at rest: {', '.join(parts)}" if parts else "the hips are never seen"
        return f"fitted: {self.fitted}; {what}"

    def _parts(self, chain: Sequence[str]) -> list[str]:
        found = []
        for side in ("left", "right"):
            first = next((name for name in chain if f"{side}_{name}" in self.resting), None)
            if first is not None:
                found.append((side, _PARTS[first]))
        if len(found) == 2 and found[0][1] == found[1][1]:
            return [found[0][1][1]]
        return [f"{side} {part[0]}" for side, part in found]


def in_picture(camera: Camera, image: np.ndarray) -> np.ndarray:
    """(...) bool: which points (..., 2) lie in the camera's picture."""
    return np.all((image >= 0) & (image <= [camera.width, camera.height]), axis=-1)


def covered(cameras: Sequence[Camera], landmarks: Sequence[Landmarks]) -> Coverage:
    """What the landmarks of all cameras show of the person."""
    sure = [(m.visibility > CERTAIN) & in_picture(c, m.image) for c, m in zip(cameras, landmarks, strict=True)]
    shown = np.any(sure, axis=0).mean(0) >= SHOWN

    def has(side: str, names: Sequence[str]) -> bool:
        return any(shown[INDEX[f"{side}_{name}"]] for name in names)

    resting = []
    for chain in _CHAINS:
        for side in ("left", "right"):
            seen = [has(side, _TURNED_BY[name]) for name in chain]
            # what is beyond a joint that is a guess is one too
            resting += [f"{side}_{name}" for k, name in enumerate(chain) if not any(seen[k:])]
    sides = ("left", "right")
    return Coverage(
        tuple(resting),
        hips=all(has(side, ["hip"]) for side in sides),
        shoulders=any(has(side, ["shoulder"]) for side in sides),
    )
