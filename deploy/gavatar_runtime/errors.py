"""The exceptions for a user's mistake, and what a command does with them."""

from __future__ import annotations

import contextlib
import difflib
import functools
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from .notes import notes_only

MOST_NAMED = 20  # faults of one kind, or frames of one fault, that a message names before it counts the rest
OPTION = re.compile(r"`([\w.]+)(?:=([^`]*))?`")  # as messages of the library name one: `fps`, or `fps=-3`
Spelling = Callable[[str, str], str]  # of an option, from its keyword and value, if that is said; '' leaves it as it is


class UserError(Exception):
    """Something the user can mend: the message names the file or field and the fix, in one sentence.

    sentences: all that is wrong, the message first, where a reader went on after the first fault. Commands print the
    message without a traceback and exit with code 2; anything else is a bug and keeps its traceback.
    """

    def __init__(self, *sentences: str):
        super().__init__(*sentences[:1])
        self.sentences = sentences


class MissingFile(UserError, FileNotFoundError):
    """A file or folder that a user names and that is not there."""


class WrongValue(UserError, ValueError):
    """A value that a user gives and that cannot be."""


def cannot_read(what: object, error: OSError) -> UserError:
    """What to raise for a file that the system did not let be read: `what` names it, as its path or a word before."""
    kind = MissingFile if isinstance(error, FileNotFoundError) else UserError
    return kind(f"{what} cannot be read: {error.strerror or error}")


class Faults:
    """What is wrong with the user's data, sentence by sentence. Alone, the first one ends the reading; a check
    collects."""

    def __init__(self, collect: bool = False):
        self.collect = collect
        self.sentences: list[str] = []

    def of(self, read: Callable, *arguments: Any, **options: Any) -> Any:
        """What `read` returns, or None when it raises UserError and faults are collected."""
        try:
            return read(*arguments, **options)
        except UserError as error:
            if not self.collect:
                raise
            self.sentences += [sentence for sentence in error.sentences if sentence not in self.sentences]
            return None

    def each(self, read: Callable, items: Iterable, more: str) -> Any:
        """`read` of every item; None when any of them failed and faults are collected: the first 20 are then named,
        and `more` says what the others are, as in "and 7 more files of params/ are faulty"."""
        found = [(Faults(self.collect), item) for item in items]
        values = [faults.of(read, item) for faults, item in found]
        failed = [faults.sentences for faults, _ in found if faults.sentences]
        for sentences in failed[:MOST_NAMED]:
            self.sentences += [sentence for sentence in sentences if sentence not in self.sentences]
        if len(failed) > MOST_NAMED:
            self.sentences.append(f"and {len(failed) - MOST_NAMED} more {more}")
        return None if failed else values

    def add(self, *sentences: str) -> None:
        """More faults; the first is raised at once unless they are collected."""
        self.of(_raise, *sentences)

    def add_all(self, sentences: Iterable[str], more: str) -> None:
        """As `add`, the first 20 of them, and `more` for the rest, as `each` has it."""
        sentences = list(dict.fromkeys(sentences))
        if sentences:
            rest = len(sentences) - MOST_NAMED
            self.add(*sentences[:MOST_NAMED], *([f"and {rest} more {more}"] if rest > 0 else []))

    def stop(self) -> None:
        """Raise the faults that were collected: what follows needs what could not be read."""
        if self.sentences:
            raise UserError(*self.sentences)


def _raise(*sentences: str) -> None:
    raise UserError(*sentences)


def listed(numbers: Iterable[int]) -> str:
    """Ascending whole numbers for a message: `3, 5, 7 to 12`; after 20 of these the rest are counted."""
    runs: list[list[int]] = []
    for number in sorted(int(n) for n in numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    named = [f"{a}" if a == b else f"{a} to {b}" if b > a + 1 else f"{a}, {b}" for a, b in runs[:MOST_NAMED]]
    rest = sum(b - a + 1 for a, b in runs[MOST_NAMED:])
    return ", ".join(named) + (f" and {rest} more" if rest else "")


def frames_named(numbers: Iterable[int]) -> str:
    """`frame 3` or `frames 3, 5, 7 to 12`."""
    numbers = list(numbers)
    return f"frame{'s' if len(numbers) > 1 else ''} {listed(numbers)}"


def did_you_mean(name: str, choices: Iterable[str]) -> str:
    """`choose from: a, b, c; did you mean 'b'?` for an unknown `name`."""
    known = sorted(choices)
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    return f"choose from: {', '.join(known) or '(none)'}{hint}"


def spelled(sentence: str, spelling: Spelling) -> str:
    """A sentence of the library with each option, which it names by its keyword in backticks, as `spelling` has it."""
    return OPTION.sub(lambda option: spelling(option[1], option[2] or "") or option[0], sentence)


@contextlib.contextmanager
def options_spelled(spelling: Spelling) -> Iterator[None]:
    """A UserError of the block names options as they are written on a command (`spelled`)."""
    try:
        yield
    except UserError as error:
        error.sentences = tuple(spelled(sentence, spelling) for sentence in error.sentences)
        error.args = error.sentences[:1]
        raise


def exit_cleanly(command: Callable[..., int | None]) -> Callable[..., None]:
    """Decorate a console entry point: `UserError` becomes one line on stderr and exit code 2; of warnings, notes alone
    are shown."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            with notes_only():
                code = command(*args, **kwargs)
        except UserError as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            sys.exit(130)
        sys.exit(code or 0)

    return run
