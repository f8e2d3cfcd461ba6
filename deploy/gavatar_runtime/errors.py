"""The one exception for a user's mistake, and what a command does with it."""

from __future__ import annotations

import difflib
import functools
import sys
from collections.abc import Callable, Iterable


class UserError(Exception):
    """Something the user can mend: the message names the file or field and the fix, in one sentence.

    Commands print it without a traceback and exit with code 2; anything else is a bug and keeps its traceback.
    """


def did_you_mean(name: str, choices: Iterable[str]) -> str:
    """`choose from: a, b, c; did you mean 'b'?` for an unknown `name`."""
    known = sorted(choices)
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    return f"choose from: {', '.join(known) or '(none)'}{hint}"


def exit_cleanly(command: Callable[..., int | None]) -> Callable[..., None]:
    """Decorate a console entry point: `UserError` becomes one line on stderr and exit code 2."""

    @functools.wraps(command)
    def run(*args, **kwargs) -> None:
        try:
            code = command(*args, **kwargs)
        except UserError as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            sys.exit(130)
        sys.exit(code or 0)

    return run
