"""How far something is: a bar in a terminal; in a log, a plain line every ten seconds."""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sized
from types import TracebackType
from typing import TextIO, TypeVar

T = TypeVar("T")

REDRAWN_EVERY, SAID_EVERY = 0.1, 10.0  # seconds, in a terminal and in a log
SPEED_OVER = 30.0  # seconds that the speed is taken over: steps grow slower as a training grows finer
BAR_WIDTH = 24

_label: str | None = None
_chapter = ""


def lines_only(label: str | None) -> None:
    """From here on this process writes plain lines that begin with `label`, even to a terminal: others write there
    too. None takes it back."""
    global _label
    _label = label


@contextlib.contextmanager
def chapter(title: str) -> Iterator[None]:
    """Inside, every bar and line begins with `title`: which part of something longer it is."""
    global _chapter
    former, _chapter = _chapter, title
    try:
        yield
    finally:
        _chapter = former


def shown(
    items: Iterable[T], title: str, unit: str, *, total: int | None = None, show: bool = True, lasting: bool = False
) -> Iterator[T]:
    """The items, shown as they are gone through. total: how many, where `items` has no length."""
    count = len(items) if total is None and isinstance(items, Sized) else total
    with Progress(title, count or 0, unit, show=show, lasting=lasting) as bar:
        for item in items:
            yield item
            bar.advance()


class Progress:
    """Shows `done` of `total` units, the speed, the time left, and figures such as a loss, on stderr.

    In a terminal one line is drawn again and again; it is gone at the end unless `lasting`. Elsewhere a line is written
    every ten seconds, and one at the end if it took that long or is `lasting`. done: what an earlier process did.
    show: False for silence.
    """

    def __init__(
        self,
        title: str,
        total: int,
        unit: str,
        *,
        done: int = 0,
        show: bool = True,
        lasting: bool = False,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ):
        self.title, self.total, self.unit, self.done = f"{_chapter} {title}".strip(), total, unit, done
        self.show, self.lasting = show, lasting
        self.figures: dict[str, float] = {}
        self._stream, self._clock = stream or sys.stderr, clock
        self._terminal = _label is None and self._stream.isatty()
        self._started = self._shown = clock()
        self._marks = deque([(self._started, done)])
        self._drawn = 0  # characters of the line that stands in the terminal

    def advance(self, count: int = 1, **figures: float) -> None:
        """`count` more are done. figures: shown from now on."""
        self.done += count
        self.figures |= figures
        now = self._clock()
        if self.show and now - self._shown >= (REDRAWN_EVERY if self._terminal else SAID_EVERY):
            self._shown = now
            self._mark(now)
            if self._terminal:
                self._draw(self._bar())
            else:
                self._say(f"{self.title}: {self._count()}{self._share()}{self._told()}{self._left()}")

    def close(self) -> None:
        """The end, of all or before it. Closing again does nothing."""
        if not self.show:
            return
        self.show, took = False, self._clock() - self._started
        ended = f"{self.title}: {self._count()}{self._told()}, took {duration(took)}"
        if self._terminal:
            self._draw(ended if self.lasting else "", "\n" if self.lasting else "\r")
        elif self.lasting or took >= SAID_EVERY:
            self._say(ended)

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _mark(self, now: float) -> None:
        self._marks.append((now, self.done))
        while len(self._marks) > 2 and now - self._marks[1][0] > SPEED_OVER:
            self._marks.popleft()

    def _left(self) -> str:
        """The time left at the speed of the last half minute."""
        (start, before), (now, done) = self._marks[0], self._marks[-1]
        if not self.total or done <= before:
            return ""
        return f", {duration((self.total - self.done) * (now - start) / (done - before))} left"

    def _count(self) -> str:
        of = f"/{self.total}" if self.total else ""
        return f"{self.done}{of} {self.unit}{'' if (self.total or self.done) == 1 else 's'}"

    def _told(self) -> str:
        return "".join(f", {name} {value:.4g}" for name, value in self.figures.items())

    def _share(self) -> str:
        return f" ({100 * self.done // self.total} %)" if self.total else ""

    def _bar(self) -> str:
        filled = BAR_WIDTH * min(self.done, self.total) // self.total if self.total else 0
        return f"{self.title} [{'#' * filled}{'.' * (BAR_WIDTH - filled)}] {self._count()}{self._left()}{self._told()}"

    def _draw(self, line: str, end: str = "") -> None:
        """Over the line that stands there."""
        line = line[: shutil.get_terminal_size().columns - 1]
        self._write("\r" + line.ljust(self._drawn) + end)
        self._drawn = len(line)

    def _say(self, line: str) -> None:
        self._write(f"{_label + ': ' if _label else ''}{line}\n")

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


def duration(seconds: float) -> str:
    """`42 s`, `3:05 min` or `2:03 h`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02d} h"
