"""More points where people look closely: on the head and the hands."""

from __future__ import annotations

import dataclasses

import numpy as np

from gavatar.avatar.points import HANDS, HEAD, sample_points, share_of
from gavatar.protocols import PointPolicy
from gavatar.registry import POINTS
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Surface


@dataclasses.dataclass
class DetailOptions:
    """head, hands: points on a length there, for each one elsewhere; on an area it is their square."""

    head: float = 2.0
    hands: float = 1.5

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not 0.1 <= value <= 10:
                raise UserError(f"points.{name} must be within 0.1 and 10, not {value}")


@POINTS.register("detail", config=DetailOptions, summary="closer together on head and hands", default=True)
class DetailPoints(PointPolicy):
    """Evenly apart, but closer together on the head and the hands; between body and head the density goes over as the
    skinning weights do."""

    def __init__(self, options: DetailOptions):
        self.options = options

    def sample(self, body: BodyData, betas: np.ndarray | None, count: int) -> Surface:
        density = np.ones(len(body.v_template))
        for joints, closer in ((HEAD, self.options.head), (HANDS, self.options.hands)):
            density += (closer**2 - 1) * share_of(body, joints)
        return sample_points(body, betas, count, density)
