"""What finds a person's pose in pictures as they come. The player has none of its own: the training half brings one."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ..components import Registry
from ..errors import UserError
from ..plugins import load_entry_points

ENTRY_POINT_GROUP = "gavatar.drivers"
INSTALL = "pip install 'gavatar[train]'"


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """A person in one picture.

    pose: (J, 3) axis-angle relative to the parent joint, radians, J that of a skeleton of the SMPL family. trans: (3,)
    metres, y up, zero where the person stood first with the feet on the floor. leg_length: metres from hip to ankle.
    points: (K, 2) landmarks in pixels of the picture. visibility: (K,) in [0, 1].
    """

    pose: np.ndarray
    trans: np.ndarray
    leg_length: float
    points: np.ndarray
    visibility: np.ndarray


class Driver(abc.ABC):
    """What a registered class derives from; constructed as `factory(options)`. It looks at nothing that comes later.

    lines: pairs of landmarks between which a picture of them has a line.
    """

    lines: ClassVar[tuple[tuple[int, int], ...]] = ()

    @abc.abstractmethod
    def __call__(self, image: np.ndarray, time: float) -> Seen | None:
        """The person in a picture (H, W, 3) uint8, blue first, taken at `time` seconds; None where there is nobody."""

    @abc.abstractmethod
    def reset(self) -> None:
        """Forget the person: what comes next are other pictures."""


DRIVERS: Registry[Driver] = Registry("driver", base=Driver)


def why_not() -> str:
    """Why nothing here can drive an avatar by a camera, in a sentence, or ''."""
    if not DRIVERS.names():
        load_entry_points(ENTRY_POINT_GROUP)
    if not DRIVERS.names():
        return f"driving an avatar by a camera needs the part of gavatar that finds people in pictures: {INSTALL}"
    return DRIVERS[DRIVERS.default].missing()


def build_driver(options: Mapping[str, Any] | None = None) -> Driver:
    """The driver that is taken where none is named, with options of its own. Raises UserError where there is none
    (`why_not`), and for an option that it lacks or cannot have."""
    reason = why_not()
    if reason:
        raise UserError(reason)
    return DRIVERS.build(DRIVERS.default, options)
