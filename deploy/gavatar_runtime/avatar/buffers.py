"""Arrays that are filled again, so that playing makes none of the avatar's size in any frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")
TURNS = 3  # one is drawn, one waits to be drawn, one is filled


class InTurn(Generic[T]):
    """Buffers that take turns: what `next` gave is given again by the third call after it. They are made when first
    wanted."""

    def __init__(self, make: Callable[[], T]):
        self._make, self._calls = make, 0
        self._made: list[T] = []

    def next(self) -> T:
        """The buffer whose turn it is."""
        if len(self._made) < TURNS:
            self._made.append(self._make())
            return self._made[-1]
        self._calls += 1
        return self._made[(self._calls - 1) % TURNS]
