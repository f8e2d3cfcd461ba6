"""The BVH format (Biovision hierarchy): a skeleton of offsets, and Euler angles a frame."""

from __future__ import annotations

import dataclasses
import itertools
import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import UserError, cannot_read, frames_named
from ..geometry.rotations import matrix_from_axis_angle
from .foreign import foreign_start

CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")
_SCALES = tuple(f"{axis}scale" for axis in "XYZ")  # some exporters write them; bones keep their length here
_AXES = np.eye(3)
_COMMENT = re.compile(r"(^|\s)(#|//|;).*$")
_END = ("END", "ENDSITE", "END_SITE", "ENDEFFECTOR")


@dataclasses.dataclass
class Bvh:
    """A parsed file of T frames and J joints, in its own units and axes.

    names: J. parents: (J,) int, -1 for the root; a parent stands before its children. offsets: (J, 3) from the parent.
    tips: (J, 3) the offset of a joint's End Site, NaN without one. rotations: (T, J, 3, 3) relative to the parent; the
    identity is the rest pose. root: (T, 3) place of the root. fps: frames per second, 0 where the file states none.
    moves: (T, 3) place relative to the parent, by joint, of joints below the root that have position channels; their
    offset is the median of it. turning: (J,) bool, which joints have rotation channels, None where that is not known.
    placed: whether any joint has position channels. largest: of the rotations, as they stand in the file. notes: what
    is odd about the file.
    """

    names: list[str]
    parents: np.ndarray
    offsets: np.ndarray
    tips: np.ndarray
    rotations: np.ndarray
    root: np.ndarray
    fps: float
    moves: dict[int, np.ndarray] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()
    turning: np.ndarray | None = None
    placed: bool = True
    largest: float = 0.0

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

    def track(self, joint: int, world: np.ndarray) -> np.ndarray:
        """(T, 3) the way of a joint through the world, by the positions of all joints above it."""
        line = self.line(joint)
        place = self.root.copy()
        for parent, j in itertools.pairwise(line):
            move = self.moves.get(j, self.offsets[j])
            place += (world[:, parent] @ np.broadcast_to(move, place.shape)[..., None])[..., 0]
        return place

    def line(self, joint: int) -> list[int]:
        """The joints from the root down to `joint`, itself included."""
        line = []
        while joint >= 0:
            line.append(int(joint))
            joint = self.parents[joint]
        return line[::-1]

    def rested(self, start: np.ndarray) -> Bvh:
        """The same motion with another rest pose, which the OFFSETs then draw: start (J, 3, 3) are the orientations of
        its joints, in the axes of this one's."""
        turned = self.world_rotations() @ np.swapaxes(start, -1, -2)
        rotations, offsets = turned.copy(), self.offsets.astype(np.float64)
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                rotations[:, j] = np.swapaxes(turned[:, parent], -1, -2) @ turned[:, j]
                offsets[j] = start[parent] @ self.offsets[j]
        tips = np.einsum("jab,jb->ja", start, self.tips)
        moves = {j: move @ start[self.parents[j]].T for j, move in self.moves.items()}
        return dataclasses.replace(self, rotations=rotations, offsets=offsets, tips=tips, moves=moves)


def read_bvh(path: str | os.PathLike, *, radians: bool = False) -> Bvh:
    """Parse a file. radians: its angles are in radians, not in degrees. Raises UserError naming the file and the line
    or field."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise cannot_read(path, error) from None
    foreign = "" if data.lstrip(b"\xef\xbb\xbf \t\r\n")[:9].upper() == b"HIERARCHY" else foreign_start(data[:64])
    if foreign:
        raise UserError(f"{path} is not a BVH file: it {foreign}")
    text = _decoded(data)
    return _Parser(path, text, 1.0 if radians else np.pi / 180).bvh()


def _decoded(data: bytes) -> str:
    """Text of UTF-8 or UTF-16, with or without a byte order mark, or else of Latin-1."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    if b"\0" in data[:64]:
        return data.decode("utf-16-le" if data[1:2] == b"\0" else "utf-16-be", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin1")


class _Parser:
    def __init__(self, path: Path, text: str, unit: float):
        self.unit = unit  # radians of an angle's
        self.path, self.lines, self.line = path, text.splitlines(), 0
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.channels: list[list[str]] = []
        self.tips: dict[int, list[float]] = {}
        self.notes: list[str] = []

    def fail(self, what: str) -> UserError:
        return UserError(f"{self.path}, line {self.line}: {what}")

    def pieces(self) -> Iterator[list[str]]:
        """The words of the next lines; a brace is a line of its own, comments and blank lines are passed over."""
        while self.line < len(self.lines):
            self.line += 1
            for piece in re.split(r"([{}])", _COMMENT.sub("", self.lines[self.line - 1])):
                if piece.strip():
                    yield piece.split()
        raise self.fail("the file ends early")

    def bvh(self) -> Bvh:
        pieces = self.pieces()
        if not any(line.strip() for line in self.lines) or next(pieces)[0].upper().rstrip(":") != "HIERARCHY":
            raise UserError(f"{self.path} is not a BVH file: it does not begin with HIERARCHY")
        self.hierarchy(pieces)
        said: dict[str, float] = {}
        for words in pieces:
            match = re.match(r"(frames|frame\s*time)\s*[:=]?\s*(\S+)", " ".join(words), re.I)
            if match is None:
                raise self.fail(f"expected '{'Frame Time' if 'frames' in said else 'Frames'}: NUMBER'")
            said["time" if match[1].lower() != "frames" else "frames"] = self.number(match[2])
            if said.get("frames", 1) < 1 or said.get("frames", 1) % 1:
                raise self.fail("Frames: must be a whole number, at least 1")
            if len(said) == 2:
                break
        step = said["time"]
        return self.motion(int(said["frames"]), 1 / step if np.isfinite(step) and step > 1e-9 else 0.0)

    def number(self, word: str) -> float:
        try:
            return float(word.replace(",", "."))  # the comma of some countries
        except ValueError:
            raise self.fail(f"'{word}' is not a number") from None

    def hierarchy(self, pieces: Iterator[list[str]]) -> None:
        stack: list[int] = []  # joints that are open; -1 stands for an End Site
        pending = None
        for words in pieces:
            key = words[0].upper().rstrip(":")
            if key in ("ROOT", "JOINT"):
                pending = self.joint(key, words, stack)
            elif key in _END:
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
                self.offset(words, [*stack, -1] if pending == -1 else stack)
                pending = None if pending == -1 else pending
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

    def joint(self, key: str, words: list[str], stack: list[int]) -> int:
        if key == "ROOT" and self.names:
            raise self.fail("a second ROOT: one person a file is read")
        if key == "JOINT" and (not stack or stack[-1] < 0):
            raise self.fail("a JOINT outside of a skeleton")
        self.names.append(" ".join(words[1:]) or f"joint{len(self.names)}")
        self.parents.append(stack[-1] if stack else -1)
        self.offsets.append([])
        self.channels.append([])
        return len(self.names) - 1

    def offset(self, words: list[str], stack: list[int]) -> None:
        try:
            values = [float(w.rstrip(",").replace(",", ".")) for w in words[1:]]
        except ValueError:
            values = []
        if len(values) != 3 or not np.isfinite(values).all() or not stack:
            raise self.fail("OFFSET needs three numbers inside a joint")
        if stack[-1] >= 0:
            self.offsets[stack[-1]] = values
        elif len(stack) > 1:
            self.tips[stack[-2]] = values

    def channel(self, words: list[str], stack: list[int]) -> None:
        known = {c.lower(): c for c in (*CHANNELS, *_SCALES)}
        names = [known.get(w.lower(), "") for w in words[2:]]
        if not stack or stack[-1] < 0 or "" in names or len(words) < 2 or words[1] != str(len(names)):
            raise self.fail(f"CHANNELS needs a count and as many of {', '.join(CHANNELS)}")
        self.channels[stack[-1]] = names

    def motion(self, count: int, fps: float) -> Bvh:
        width = sum(map(len, self.channels))
        values = self.table(count, width)
        joints, place = len(self.names), 0
        rotations = np.broadcast_to(np.eye(3), (count, joints, 3, 3)).copy()
        offsets = np.array(self.offsets)
        root, moves, largest = np.tile(offsets[0], (count, 1)), {}, 0.0
        for j, names in enumerate(self.channels):
            columns = dict(zip(names, values[:, place : place + len(names)].T, strict=True))
            place += len(names)
            places = np.tile(offsets[j], (count, 1))
            for name, column in columns.items():
                axis = "XYZ".index(name[0])
                if name.endswith("rotation"):  # applied in the order of the channels, each about the turned axes
                    largest = max(largest, float(np.abs(column).max()))
                    turn = matrix_from_axis_angle((column * self.unit)[:, None] * _AXES[axis])
                    rotations[:, j] = rotations[:, j] @ turn
                elif name.endswith("position"):
                    places[:, axis] = column
            if j == 0:
                root = places
            elif any(name.endswith("position") for name in names):
                moves[j] = _moves(places, offsets[j])
                offsets[j] = np.median(moves[j], 0)
        tips = np.full((joints, 3), np.nan)
        for j, tip in self.tips.items():
            tips[j] = tip
        turning = np.array([any(name.endswith("rotation") for name in names) for names in self.channels])
        placed = any(name.endswith("position") for names in self.channels for name in names)
        return Bvh(
            self.names, np.array(self.parents), offsets, tips, rotations, root, fps, moves, tuple(self.notes), turning,
            placed, largest,
        )  # fmt: skip

    def table(self, count: int, width: int) -> np.ndarray:
        """(count, width) the numbers of MOTION; more than those are noted and left out."""
        text = " ".join(self.lines[self.line :])
        if ";" in text or ("," in text and ("." in text or ", " in text)):  # else the comma of some countries
            text = text.replace(",", "." if ";" in text and "." not in text else " ").replace(";", " ")
        numbers = text.split()
        if len(numbers) < count * width or width == 0:
            raise UserError(
                f"{self.path}: {count} frames of {width} channels are {count * width} numbers, the file holds "
                f"{len(numbers)}: it is cut short"
            )
        if len(numbers) > count * width:
            rest = len(numbers) - count * width
            what = f"{rest // width} frames" if rest % width == 0 else f"{rest} numbers"
            self.notes.append(f"the file holds {what} more than 'Frames: {count}' says: they are left out")
        numbers = numbers[: count * width]
        try:
            values = np.array(numbers, np.float64)
        except ValueError:
            try:
                values = np.array([word.replace(",", ".") for word in numbers], np.float64)
            except ValueError:
                raise UserError(f"{self.path}: MOTION holds something that is not a number") from None
        values = values.reshape(count, width)
        bad = ~np.isfinite(values).all(1)
        if bad.any():
            raise UserError(f"{self.path}: MOTION holds NaN or infinite values at {frames_named(np.flatnonzero(bad))}")
        return values


def _moves(places: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(T, 3) relative to the parent from position channels (T, 3). Most exporters write the place, some what is to be
    added to the OFFSET: told by the axes that move little for their OFFSET, which then all lie nearer to zero."""
    steady = np.abs(offset) > 2 * np.ptp(places, axis=0) + 1e-9
    middle = np.median(places, axis=0)
    adds = steady.any() and (np.abs(middle) < np.abs(middle - offset))[steady].all()
    return places + offset if adds else places
