"""The built-in motions `walk` and `run`: one cycle of steps, with the numbers of either."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...errors import WrongValue
from ...values.motion import Motion
from ..source import MOTIONS, MotionSource
from .curves import cyclic, eased, hermite
from .figure import ANKLE, SIDES, SOLE, Figure, Foot, clearing, rolled
from .standing import loop_phase

Keys = tuple[tuple[float, float], ...]


@dataclasses.dataclass(frozen=True)
class Gait:
    """How a person steps. Phases are shares of a stride, two steps, from the moment when that foot lands.

    slowest, fastest: metres a second that it is made for. usual: speed at which a stride takes `stride` seconds; it
    takes less when faster, by the power `quickens`. bearing: share of a stride for which a foot is on the floor,
    and farthest: metres that the body goes meanwhile, at most. ahead: share of that by which the middle of it comes
    later than the body's passing. pitch: of a foot, by phase. lift: metres that a foot rises above its straight
    way, and when. clear: metres between a free foot and the floor. bob: metres that the body rises and falls to
    either side of its height, highest halfway between two landings; negative: lowest there. sway: metres to the
    standing leg. lean, list, twist, chest: degrees of trunk forwards, of the pelvis' drop to the free side, of its
    turn with the leg and of the chest's against it. arms, arms_back, elbows: degrees of their swing, of how far
    back its middle is, of the elbow's bend and its swing. narrow: metres that the feet land nearer to the middle
    than they stand.
    """

    slowest: float
    fastest: float
    usual: float
    stride: float
    quickens: float
    bearing: float
    farthest: float
    ahead: float
    pitch: Keys
    lift: Keys
    clear: float
    bob: float
    sway: float
    lean: float
    list: float
    twist: float
    chest: float
    arms: float
    arms_back: float
    elbows: tuple[float, float]
    narrow: float


WALK = Gait(
    slowest=0.3, fastest=2.2, usual=1.35, stride=1.06, quickens=0.45, bearing=0.62, farthest=0.95, ahead=-0.03,
    pitch=((0, -19), (0.08, 0), (0.32, 0), (0.48, 17), (0.62, 50), (0.68, 56), (0.84, 8), (0.93, -16)),
    lift=((0, 0), (0.62, 0), (0.76, 0.045), (0.9, 0.02)), clear=0.02,
    bob=-0.02, sway=0.022, lean=2.5, list=3.5, twist=5, chest=5, arms=22, arms_back=9, elbows=(2, 11), narrow=0.05,
)  # fmt: skip
RUN = Gait(
    slowest=1.5, fastest=5.5, usual=2.8, stride=0.72, quickens=0.25, bearing=0.36, farthest=0.74, ahead=0.03,
    pitch=((0, -9), (0.05, 0), (0.17, 0), (0.26, 16), (0.36, 52), (0.45, 82), (0.6, 78), (0.78, 20), (0.93, -10)),
    lift=((0, 0), (0.36, 0), (0.53, 0.26), (0.7, 0.2), (0.88, 0.05)), clear=0.03,
    bob=0.034, sway=0.01, lean=9, list=4, twist=7, chest=11, arms=32, arms_back=4, elbows=(72, 16), narrow=0.09,
)  # fmt: skip


@dataclasses.dataclass
class WalkOptions:
    """seconds: one loop, about; it holds whole strides. fps: frames per second. speed: metres a second, of a person
    whose legs are 0.9 m. travel: go ahead rather than stay in place, as on a treadmill."""

    seconds: float = 4.0
    fps: float = 30.0
    speed: float = 1.35
    travel: bool = False


@dataclasses.dataclass
class RunOptions(WalkOptions):
    """As of `walk`."""

    seconds: float = 2.8
    speed: float = 2.8


@MOTIONS.register("walk", config=WalkOptions, summary="walks, in place or ahead; loops")
class Walk(MotionSource):
    """Walks towards +z, the left foot landing first. The frame after the last would be the first, in place or, when it
    travels, as far ahead as it went."""

    gait, name = WALK, "walk"

    def __init__(self, config: WalkOptions):
        low, high, speed = self.gait.slowest, self.gait.fastest, config.speed
        if isinstance(speed, bool) or not (isinstance(speed, (int, float)) and low <= speed <= high):
            raise WrongValue(f"`speed={speed}`: motion '{self.name}' is made for {low:g} to {high:g} metres a second")
        if not isinstance(config.travel, bool):
            raise WrongValue(f"`travel={config.travel}`: give true or false")
        self.config = config

    def load(self) -> Motion:
        loop = loop_phase(self.name, self.config.seconds, self.config.fps)
        seconds = len(loop) / self.config.fps
        wanted = self.gait.stride * (self.gait.usual / self.config.speed) ** self.gait.quickens
        strides = max(1, round(seconds / wanted))
        figure = stepping(self.gait, strides * loop, self.config.speed * seconds / strides, self.config.speed)
        if self.config.travel:
            figure.place[:, 2] += self.config.speed * seconds * loop
        return figure.motion(self.name, self.config.fps)


@MOTIONS.register("run", config=RunOptions, summary="runs, in place or ahead; loops")
class Running(Walk):
    """Runs towards +z, both feet off the floor between steps; see `Walk`."""

    gait, name = RUN, "run"


def stepping(gait: Gait, phase: np.ndarray, length: float, speed: float) -> Figure:
    """A figure that steps in place over a floor that comes towards it. phase: (T,) strides done. length: metres of one.
    speed: metres a second, which says how far all swings."""
    figure = Figure(len(phase))
    vigour = (speed / gait.usual) ** 0.6
    lean, swing = gait.lean * vigour, min(1.25, vigour)
    wave = np.cos(2 * np.pi * phase)  # 1 when the left foot lands
    bearing = min(gait.bearing, gait.farthest / length)
    middle, high = bearing / 2, (bearing + 0.5) / 2
    beside = np.cos(2 * np.pi * (phase - middle))  # 1 when the left leg stands under the body
    drop = gait.list * swing * np.cos(2 * np.pi * (phase - 0.6 * middle))
    figure.tilt(x=0.35 * lean)
    figure.tilt(z=drop)
    figure.tilt(y=-gait.twist * swing * wave)
    figure.place[:, 0] = gait.sway * beside
    figure.place[:, 1] = gait.bob * swing * np.cos(4 * np.pi * (phase - high))
    feet = tuple(_foot(gait, side, phase + 0.5 * i, length, bearing, swing) for i, side in enumerate(SIDES))
    figure.settle(feet, np.stack([np.mod(phase + 0.5 * i, 1) <= bearing for i in range(2)], -1))
    figure.stand(feet)
    _upper_body(figure, gait, phase, swing, lean)
    return figure


def _upper_body(figure: Figure, gait: Gait, phase: np.ndarray, swing: float, lean: float) -> None:
    late = np.cos(2 * np.pi * (phase - 0.03))  # the chest and the arms follow the pelvis
    drop = gait.list * swing * np.cos(2 * np.pi * (phase - 0.3 * gait.bearing))
    nod = np.cos(4 * np.pi * (phase - 0.08))
    figure.bend_spine(x=0.65 * lean + 0.8 * swing * nod, y=(gait.twist + gait.chest) * swing * late, z=-1.15 * drop)
    figure.turn_head(x=-0.9 * lean - 0.8 * swing * nod, y=-gait.chest * swing * late, z=0.15 * drop)
    for side, sign in (("left", 1), ("right", -1)):
        back = sign * np.cos(2 * np.pi * (phase - 0.04))  # 1 where that arm is furthest back
        ahead = (1 - sign * np.cos(2 * np.pi * (phase - 0.1))) / 2
        figure.turn(f"{side}_shoulder", x=swing * gait.arms * back + gait.arms_back, y=-sign * 0.15 * gait.arms * ahead)
        figure.turn(f"{side}_collar", y=sign * 0.12 * gait.arms * swing * back)
        figure.turn(f"{side}_elbow", y=-sign * (gait.elbows[0] + gait.elbows[1] * swing * ahead))


def _foot(gait: Gait, side: str, phase: np.ndarray, length: float, bearing: float, swing: float) -> Foot:
    """The path of a foot whose own phase is `phase`, over a floor that comes towards it by `length` a stride. bearing:
    share of a stride that it is on the floor; the gait's keys are stretched to that."""
    phase = np.mod(phase, 1)
    ease = min(1.0, 0.4 + 0.6 * swing)

    def keyed(p: np.ndarray, keys: Keys) -> np.ndarray:
        return cyclic(np.interp(p, (0, bearing, 1), (0, gait.bearing, 1)), keys)

    def on_floor(p: np.ndarray | float) -> np.ndarray:
        """(..., 2) up and ahead of the ankle while it bears weight."""
        way = rolled(ease * keyed(np.asarray(p), gait.pitch))
        way[..., 1] += length * (bearing * (0.5 + gait.ahead) - p)
        return way

    free, step = 1 - bearing, 1e-5
    t = np.clip((phase - bearing) / free, 0, 1)
    leaving = (on_floor(bearing) - on_floor(bearing - step)) / step * free
    arriving = (on_floor(step) - on_floor(0.0)) / step * free
    swung = hermite(t[:, None], on_floor(bearing), on_floor(0.0), leaving, arriving)
    pitch = ease * keyed(phase, gait.pitch)
    # toes stay bent until the heel has come down behind them
    toes = -np.maximum(pitch, 0) * (1 - eased(t / 0.7))
    swung[:, 0] += swing * keyed(phase, gait.lift)
    clear = gait.clear * np.minimum(1, 4 * t * (1 - t)) ** 0.75
    swung[:, 0] = np.maximum(swung[:, 0], clearing(pitch, toes) - SOLE + clear)
    way = np.where((phase <= bearing)[:, None], on_floor(phase), swung)
    x = np.full_like(phase, (1 if side == "left" else -1) * (ANKLE[0] - gait.narrow))
    return Foot(np.stack([x, ANKLE[1] + way[:, 0], ANKLE[2] + way[:, 1]], -1), pitch, np.zeros_like(phase), toes)
