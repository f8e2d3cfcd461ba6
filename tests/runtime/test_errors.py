"""A user's mistake is one exception for a command and the fitting one of Python's own for a program."""

from __future__ import annotations

import errno

import pytest

from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import MissingFile, UserError, WrongValue, cannot_read, exit_cleanly


@pytest.mark.parametrize(("kind", "builtin"), [(MissingFile, FileNotFoundError), (WrongValue, ValueError)])
def test_an_error_of_a_users_is_also_pythons_and_keeps_its_sentences(kind, builtin):
    error = kind("a.npz does not exist", "and neither does b.npz")
    assert isinstance(error, UserError)
    assert isinstance(error, builtin)
    assert str(error) == "a.npz does not exist"
    assert error.sentences == ("a.npz does not exist", "and neither does b.npz")


@pytest.mark.parametrize("kind", [UserError, MissingFile, WrongValue])
def test_a_command_says_it_in_one_line_and_exits_with_2(kind, capsys):
    @exit_cleanly
    def command():
        raise kind("give another name", "and more")

    with pytest.raises(SystemExit) as raised:
        command()
    assert raised.value.code == 2
    assert capsys.readouterr().err == "error: give another name\n"


def test_a_file_that_is_not_there_is_told_from_one_that_may_not_be_read(tmp_path):
    missing = cannot_read("a.json", FileNotFoundError(errno.ENOENT, "No such file or directory", "a.json"))
    assert isinstance(missing, FileNotFoundError)
    assert str(missing) == "a.json cannot be read: No such file or directory"
    closed = cannot_read("a.json", PermissionError(errno.EACCES, "Permission denied", "a.json"))
    assert not isinstance(closed, FileNotFoundError)
    assert str(cannot_read("a.json", OSError("odd"))) == "a.json cannot be read: odd"


def test_an_avatar_that_is_not_there_is_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"avatar .*absent\.gavatar does not exist"):
        read_bundle(tmp_path / "absent.gavatar")
