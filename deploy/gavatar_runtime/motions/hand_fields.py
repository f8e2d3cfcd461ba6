"""Hands among the fields of a file: rotations, or coefficients of a model's principal components."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Faults, UserError, WrongValue
from ..values.motion import HandParameters
from .field_names import FLAT_KEY, HAND_KEYS, PCA_KEY, flat
from .field_reader import FieldReader

HANDS = ("auto", "full", "pca")
HAND_MEANS = ("auto", "flat", "mean")


class HandFields(FieldReader):
    """Hands of 45 numbers are rotations, about the flat hand (AMASS); of fewer, coefficients of a model's principal
    components about its mean hand (smplx). use_pca and flat_hand_mean in the file say otherwise, and so do hands:
    `full`, `pca` or `auto`, and hand_mean: `flat`, `mean` or `auto`. Raises UserError for another word."""

    def __init__(
        self, path: Path, arrays: Mapping[str, Any], *, hands: str = "auto", hand_mean: str = "auto",
        rotations: str = "auto",
    ):  # fmt: skip
        for name, value, known in (("hands", hands, HANDS), ("hand_mean", hand_mean, HAND_MEANS)):
            if value not in known:
                raise WrongValue(f"`{name}={value}`: choose from {', '.join(known)}")
        super().__init__(path, arrays, rotations)
        self.hands, self.hand_mean = hands, hand_mean

    def both_hands(self) -> HandParameters | None:
        """Both hands from fields of their own, or None where there are none."""
        key = next((k for k in HAND_KEYS if all(name in self.arrays for name in flat((k,)))), None)
        if key is None:
            return None
        names, faults = flat((key,)), Faults(collect=True)
        parts = [faults.of(self._hand, name) for name in names]
        faults.stop()
        if len(parts) == 1:
            if parts[0].shape[1] % 2:
                raise UserError(
                    f"{self.path}: {names[0]} holds {parts[0].shape[1]} numbers a frame, which are no two hands"
                )
            parts = np.split(parts[0], 2, 1)
        frames = max(map(len, parts))
        if parts[0].shape[1] != parts[1].shape[1] or any(len(part) not in (1, frames) for part in parts):
            shapes = " and ".join(str(part.shape) for part in parts)
            raise UserError(f"{self.path}: {' and '.join(names)} have shapes {shapes}: both hands must be alike")
        both = np.stack([np.broadcast_to(part, (frames, part.shape[1])) for part in parts], 1)
        return self.understood(" and ".join(names), both)

    def _hand(self, name: str) -> np.ndarray:
        """(T, K) numbers; matrices as axis-angle."""
        array = self.numbers(name)
        return self.turned(name)[0] if array.ndim > 2 and array.shape[-2:] == (3, 3) else self.part(name, None)

    def understood(self, name: str, values: np.ndarray) -> HandParameters:
        """Values (T, 2, K) with what they mean, from their number, the file's own words and the options."""
        width = values.shape[2]
        pca = {"full": False, "pca": True, "auto": self._flag(PCA_KEY, width != 45)}[self.hands]
        relative = {"flat": False, "mean": True, "auto": not self._flag(FLAT_KEY, not pca)}[self.hand_mean]
        if not 1 <= width <= 45 or (not pca and width != 45):
            raise UserError(
                f"{self.path}: {name}: {width} numbers a hand; expected 45, or up to 45 coefficients (`hands=pca`)"
            )
        return HandParameters(values, pca, relative)

    def _flag(self, key: str, default: bool) -> bool:
        if key not in self.arrays:
            return default
        value = np.asarray(self.arrays[key])
        if value.size != 1 or value.dtype.kind not in "biu":
            raise UserError(f"{self.path}: {key} must be true or false")
        return bool(value.reshape(-1)[0])


def with_hands(poses: np.ndarray, hands: HandParameters | None) -> tuple[np.ndarray, HandParameters | None]:
    """Poses (T, J, 3) with the hands that are rotations already, on 52 or 55 joints; those that are not, a row a frame,
    beside them."""
    if hands is None:
        return poses, None
    values = np.broadcast_to(hands.values, (len(poses), *hands.values.shape[1:]))
    if hands.pca or hands.relative:
        return poses, dataclasses.replace(hands, values=values.copy())
    body = poses[:, : 25 if poses.shape[1] == 55 else 22]
    return np.concatenate([body, values.reshape(len(poses), 30, 3)], 1), None
