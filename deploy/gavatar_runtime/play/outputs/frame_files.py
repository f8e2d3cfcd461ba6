"""Files that hold a frame each, and appear when all of them are written."""

from __future__ import annotations

import re
import shutil
import tempfile
from pathlib import Path

from ...errors import UserError
from ...formats.files import put_in_place, temporary_beside
from .output import NUMBER


class OneFile:
    """The file of the only frame. Raises UserError where it cannot be written."""

    def __init__(self, path: Path):
        self.path, self.count = path, 0
        self._temporary = temporary_beside(path)

    def next(self) -> Path:
        """Where it is to be written."""
        self.count += 1
        return self._temporary

    def close(self) -> None:
        """Put it in place. UserError where nothing was written."""
        if not self.count:
            raise UserError(f"{self.path}: there is no frame to write")
        put_in_place(self._temporary, self.path)

    def discard(self) -> None:
        """Leave nothing behind; harmless after `close`."""
        self._temporary.unlink(missing_ok=True)


class NumberedFiles:
    """Files 000000.png, 000001.png, ... in a folder of their own, which replaces one of earlier frames.

    path: the folder and the name of its files, the number as in `%06d.png`.
    Raises UserError where the folder holds anything else or cannot be written.
    """

    def __init__(self, path: Path):
        self.folder = path.parent
        numbers = list(NUMBER.finditer(path.name))
        if len(numbers) != 1:
            raise UserError(f"{path}: give the files of the frames one number in their name, as in %06d{path.suffix}")
        (number,) = numbers
        self._before, self._digits, self._after = path.name[: number.start()], number[1], path.name[number.end() :]
        self.count = 0
        self._check_replaceable()
        mode = self.folder.stat().st_mode & 0o777 if self.folder.exists() else 0o755
        try:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            self._temporary = Path(tempfile.mkdtemp(prefix=f".{self.folder.name}-", dir=self.folder.parent))
            self._temporary.chmod(mode)
        except OSError as error:
            raise UserError(f"{self.folder} cannot be written: {error.strerror or error}") from error

    def next(self) -> Path:
        """Where the next file is to be written."""
        number = str(self.count).zfill(int(self._digits or 1))
        self.count += 1
        return self._temporary / f"{self._before}{number}{self._after}"

    def close(self) -> None:
        """Put the folder in place."""
        self._check_replaceable()
        if self.folder.exists():
            shutil.rmtree(self.folder)
        self._temporary.replace(self.folder)

    def discard(self) -> None:
        """Leave nothing behind; harmless after `close`."""
        shutil.rmtree(self._temporary, ignore_errors=True)

    def _check_replaceable(self) -> None:
        folder, here = self.folder.resolve(), Path.cwd()
        if folder == here or folder in here.parents:
            raise UserError(f"{self.folder} is where you are: frames take a folder of their own, give its name")
        if not self.folder.exists():
            return
        if not self.folder.is_dir():
            raise UserError(f"{self.folder} is a file, not a folder for frames: give another name")
        name = re.compile(rf"{re.escape(self._before)}\d{{{self._digits or 1},}}{re.escape(self._after)}")
        for entry in self.folder.iterdir():
            if not name.fullmatch(entry.name):
                raise UserError(
                    f"{self.folder} holds '{entry.name}', which is no frame of an earlier run: give another folder"
                )
