"""What a user should know though nothing failed: warnings of ours, which a command shows as one line each."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Iterator
from typing import Any


class Note(UserWarning):
    """A warning to the user of gavatar, in one sentence: `warnings.warn(sentence, Note)`."""


@contextlib.contextmanager
def notes_only() -> Iterator[None]:
    """In a command: notes are lines on stderr, and what libraries warn of, which users cannot act on, is not shown,
    unless Python was asked to show it (-W, PYTHONWARNINGS)."""
    import logging  # takes as long to import as all of this package

    last = logging.lastResort
    with warnings.catch_warnings():
        if not sys.warnoptions:
            quiet_libraries()
        try:
            yield
        finally:
            logging.lastResort = last


def quiet_libraries() -> None:
    """As `notes_only`, for the rest of a process."""
    import logging

    warnings.simplefilter("ignore")
    warnings.simplefilter("default", Note)
    warnings.showwarning = _say
    # what prints the warnings of loggers that have no handler
    logging.lastResort = logging.StreamHandler()
    logging.lastResort.setLevel(logging.WARNING)
    logging.lastResort.addFilter(lambda record: record.name.startswith("gavatar"))
    logging.lastResort.setFormatter(logging.Formatter("note: %(message)s"))


def _say(message: Warning | str, *place: Any, **rest: Any) -> None:
    print(f"note: {message}", file=sys.stderr)
