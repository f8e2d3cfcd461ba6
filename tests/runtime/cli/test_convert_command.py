"""`gavatar-convert` and `gavatar-view`, as people call them."""

from __future__ import annotations

import signal
import subprocess
import sys
import urllib.request

import pytest

from gavatar_runtime.cli import convert, view


def call(main, *arguments) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return int(ended.value.code or 0)


def test_one_command_writes_a_page(static, tmp_path, capsys):
    assert call(convert.main, static, tmp_path / "anna.html", "--motions", "wave") == 0
    assert "anna.html" in capsys.readouterr().out
    assert (tmp_path / "anna.html").stat().st_size > 50000


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["a.mp4"], "gavatar-play"), (["a.html", "--motions", "waltz"], "waltz"), (["a.html", "--tier", "int8"], "--tier"),
     (["a.html", "--gaussians", "0"], "--gaussians")],
)  # fmt: skip
def test_what_cannot_be_is_one_line(static, tmp_path, capsys, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert call(convert.main, static, *arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--tier", "gold"], "--tier gold"), (["--motion", "waltz"], "waltz"), (["--port", "70000"], "70000"),
     (["--host", "256.0.0.1"], "256.0.0.1")],
)  # fmt: skip
def test_a_viewer_that_cannot_be_is_one_line(static, capsys, arguments, said):
    assert call(view.main, static, "--no-browser", *arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_the_viewer_prints_its_address_and_ends_by_ctrl_c(static):
    command = [sys.executable, "-m", "gavatar_runtime.cli.view", str(static), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        address = process.stdout.readline().split()[-1]
        with urllib.request.urlopen(address, timeout=20) as page:
            assert b"<canvas" in page.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        assert process.stderr.read() == ""
