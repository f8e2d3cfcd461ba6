"""What a job of many leaves beside the runs, to be looked up afterwards: OUT/jobs/NAME.json and NAME.log."""

from __future__ import annotations

import io
import os
import socket
import sys
import time
import traceback
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from ..storage import write_json

FOLDER = "jobs"
RUNNING, ENDED = "running", "ended"


class JobRecord:
    """Writes how a job goes, from its first moment: a job that is killed is left as `running`, with what it said.

    out: the folder of all runs. directory: of the job's own run, in it. The .json has state, code, message, host,
    process, started (UTC) and seconds; the .log every line that the job wrote, of all its attempts.
    """

    def __init__(self, out: Path, directory: Path) -> None:
        name = Path(os.path.relpath(directory, out))
        self.path = out / FOLDER / name.parent / f"{name.name}.json"
        self.said: dict[str, Any] = {
            "state": RUNNING, "run": name.as_posix(), "code": None, "message": "", "host": socket.gethostname(),
            "process": os.getpid(), "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        }  # fmt: skip

    def __enter__(self) -> JobRecord:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._began = time.monotonic()
        write_json(self.path, self.said)
        self._log = open(self.path.with_suffix(".log"), "a", encoding="utf-8", buffering=1)
        self._log.write(f"--- {self.said['started']} on {self.said['host']}, process {self.said['process']}\n")
        self._streams = sys.stdout, sys.stderr
        sys.stdout, sys.stderr = (Copied(stream, self._log) for stream in self._streams)
        return self

    def end(self, code: int, message: str) -> None:
        """How the job ended."""
        self.said |= {"state": ENDED, "code": code, "message": message}
        self.said["seconds"] = round(time.monotonic() - self._began, 1)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        sys.stdout, sys.stderr = self._streams
        if error is not None:  # Ctrl-C, or a time limit that a launcher tells by an exception
            self._log.write("".join(traceback.format_exception(error)))
            self.said["message"] = f"{type(error).__name__}: {error}"
        elif self.said["message"]:
            self._log.write(self.said["message"].rstrip() + "\n")
        self._log.write(f"--- {self.said['state']}, exit code {self.said['code']}\n")
        self._log.close()
        write_json(self.path, self.said)


class Copied(io.TextIOBase):
    """A stream whose lines are also written to a log; of a bar that is drawn again and again, only how it ends."""

    def __init__(self, stream: TextIO, log: TextIO) -> None:
        self._stream, self._log, self._line = stream, log, ""

    def write(self, text: str) -> int:
        *whole, self._line = (self._line + text).split("\n")
        for line in whole:
            self._log.write(line.rstrip("\r").rsplit("\r", 1)[-1] + "\n")
        self._line = self._line.rsplit("\r", 1)[-1]
        return self._stream.write(text)

    def flush(self) -> None:
        self._stream.flush()

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()
