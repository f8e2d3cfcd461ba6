"""The BVH format (Biovision hierarchy): a skeleton of offsets, and Euler angles a frame."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np

from ..errors import UserError, frames_named
from ..geometry.rotations import matrix_from_axis_angle

CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")
_AXES = np.eye(3)


@dataclasses.dataclass
class Bvh:
    """A parsed file of T frames and J joints, in its own units and axes.

    names: J. parents: (J,) int, -1 for the root; a parent stands before its children. offsets: (J, 3) from the parent.
    tips: (J, 3) the offset of a joint's End Site, NaN without one. rotations: (T, J, 3, 3) relative to the parent; the
    identity is the rest pose. root: (T, 3) place of the root. fps: frames per second.
    """

    names: list[str]
    parents: np.ndarray
    offsets: np.ndarray
    tips: np.ndarray
    rotations: np.ndarray
    root: np.ndarray
    fps: float

    def world_rotations(self) -> np.ndarray:
        """(T, J, 3, 3) orientation of every joint relative to its own at rest."""
        world = self.rotations.copy()
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                world[:, j] = world[:, parent] @ self.rotations[:, j]
        return world

    def places(self, world: np.ndarray | None = None) -> np.ndarray:
        """(T, J, 3) joints of posed skeletons, or (1, J, 3) of the one at rest, the root at the origin."""
        world = np.broadcast_to(np.eye(3), (1, len(self.names), 3, 3)) if world is None else world
        out = np.zeros((len(world), len(self.names), 3))
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                out[:, j] = out[:, parent] + world[:, parent] @ self.offsets[j]
        return out

    def rested(self, frame: int = 0) -> Bvh:
        """The same motion with the pose of a frame, root orientation included, as the rest pose that the OFFSETs
        draw."""
        world = self.world_rotations()
        start = world[frame]
        turned = world @ np.swapaxes(start, -1, -2)
        rotations, offsets = turned.copy(), self.offsets.astype(np.float64)
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                rotations[:, j] = np.swapaxes(turned[:, parent], -1, -2) @ turned[:, j]
                offsets[j] = start[parent] @ self.offsets[j]
        tips = np.einsum("jab,jb->ja", start, self.tips)
        return dataclasses.replace(self, rotations=rotations, offsets=offsets, tips=tips)


def read_bvh(path: str | os.PathLike) -> Bvh:
    """Parse a file. Raises UserError naming the file and the line or field."""
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
    return _Parser(path, text).bvh()


class _Parser:
    def __init__(self, path: Path, text: str):
        self.path, self.lines, self.line = path, text.splitlines(), 0
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.channels: list[list[str]] = []
        self.tips: dict[int, list[float]] = {}

    def fail(self, what: str) -> UserError:
        return UserError(f"{self.path}, line {self.line}: {what}")

    def words(self) -> list[str]:
        """The next line that is not blank."""
        while self.line < len(self.lines):
            self.line += 1
            words = self.lines[self.line - 1].split()
            if words:
                return words
        raise self.fail("the file ends early")

    def bvh(self) -> Bvh:
        if not self.lines or self.words()[0].upper() != "HIERARCHY":
            raise UserError(f"{self.path} is not a BVH file: it does not begin with HIERARCHY")
        self.hierarchy()
        count = self.number(self.words(), "Frames:", 1)
        if count < 1 or count != int(count):
            raise self.fail("Frames: must be a whole number, at least 1")
        step = self.number(self.words(), "Time:", 2)
        if not (np.isfinite(step) and step > 0):
            raise self.fail("Frame Time: must be a positive number of seconds")
        return self.motion(int(count), 1 / step)

    def number(self, words: list[str], key: str, place: int) -> float:
        if len(words) <= place or words[place - 1].lower() != key.lower():
            raise self.fail(f"expected '{'Frame Time:' if key == 'Time:' else key} NUMBER'")
        try:
            return float(words[place])
        except ValueError:
            raise self.fail(f"'{words[place]}' is not a number") from None

    def hierarchy(self) -> None:
        stack: list[int] = []  # joints that are open; -1 stands for an End Site
        pending = None
        while True:
            words = self.words()
            key = words[0].upper()
            if key in ("ROOT", "JOINT"):
                if key == "ROOT" and self.names:
                    raise self.fail("a second ROOT: one person a file is read")
                if key == "JOINT" and (not stack or stack[-1] < 0):
                    raise self.fail("a JOINT outside of a skeleton")
                self.names.append(" ".join(words[1:]) or f"joint{len(self.names)}")
                self.parents.append(stack[-1] if stack else -1)
                self.offsets.append([])
                self.channels.append([])
                pending = len(self.names) - 1
            elif key == "END":
                pending = -1
            elif key == "{":
                if pending is None:
                    raise self.fail("'{' without a joint")
                stack.append(pending)
                pending = None
            elif key == "}":
                if not stack:
                    raise self.fail("'}' without '{'")
                stack.pop()
            elif key == "OFFSET":
                self.offset(words, stack)
            elif key == "CHANNELS":
                self.channel(words, stack)
            elif key == "MOTION":
                break
            else:
                raise self.fail(f"'{words[0]}' is not a word of the hierarchy")
        if stack or not self.names:
            raise self.fail("the hierarchy is empty or not closed before MOTION")
        missing = [n for n, offset in zip(self.names, self.offsets, strict=True) if not offset]
        if missing:
            raise UserError(f"{self.path}: joint '{missing[0]}' has no OFFSET")

    def offset(self, words: list[str], stack: list[int]) -> None:
        try:
            values = [float(w) for w in words[1:]]
        except ValueError:
            values = []
        if len(values) != 3 or not np.isfinite(values).all() or not stack:
            raise self.fail("OFFSET needs three numbers inside a joint")
        if stack[-1] >= 0:
            self.offsets[stack[-1]] = values
        elif len(stack) > 1:
            self.tips[stack[-2]] = values

    def channel(self, words: list[str], stack: list[int]) -> None:
        known = {c.lower(): c for c in CHANNELS}
        names = [known.get(w.lower(), "") for w in words[2:]]
        if not stack or stack[-1] < 0 or "" in names or len(words) < 2 or words[1] != str(len(names)):
            raise self.fail(f"CHANNELS needs a count and as many of {', '.join(CHANNELS)}")
        self.channels[stack[-1]] = names

    def motion(self, count: int, fps: float) -> Bvh:
        width = sum(map(len, self.channels))
        numbers = " ".join(self.lines[self.line :]).split()
        if len(numbers) < count * width or width == 0:
            raise UserError(
                f"{self.path}: {count} frames of {width} channels are {count * width} numbers, the file holds "
                f"{len(numbers)}: it is cut short"
            )
        try:
            values = np.array(numbers[: count * width], np.float64).reshape(count, width)
        except ValueError:
            raise UserError(f"{self.path}: MOTION holds something that is not a number") from None
        bad = ~np.isfinite(values).all(1)
        if bad.any():
            raise UserError(f"{self.path}: MOTION holds NaN or infinite values at {frames_named(np.flatnonzero(bad))}")
        joints, place = len(self.names), 0
        rotations = np.broadcast_to(np.eye(3), (count, joints, 3, 3)).copy()
        root = np.tile(np.asarray(self.offsets[0]), (count, 1))
        for j, names in enumerate(self.channels):
            for name in names:
                column, axis = values[:, place], "XYZ".index(name[0])
                place += 1
                if name.endswith("rotation"):  # applied in the order of the channels, each about the turned axes
                    rotations[:, j] = rotations[:, j] @ matrix_from_axis_angle(
                        np.radians(column)[:, None] * _AXES[axis]
                    )
                elif j == 0:
                    root[:, axis] = column
        tips = np.full((joints, 3), np.nan)
        for j, tip in self.tips.items():
            tips[j] = tip
        return Bvh(self.names, np.array(self.parents), np.array(self.offsets), tips, rotations, root, fps)
