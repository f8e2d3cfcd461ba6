"""Progress: a bar in a terminal, a plain line now and then in a log, and nothing more than that."""

from __future__ import annotations

import io

import pytest

from gavatar_runtime import progress
from gavatar_runtime.progress import Progress, duration, shown


class Clock:
    """Time that passes when told to."""

    def __init__(self):
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def run(stream: io.StringIO, steps: int, seconds: float, **options) -> list[str]:
    """What `steps` steps of `seconds` each write, line by line."""
    clock = Clock()
    with Progress("stage 1", steps, "step", stream=stream, clock=clock, **options) as bar:
        for step in range(steps):
            clock.now += seconds
            bar.advance(loss=1 / (step + 1))
    return stream.getvalue().split("\n")[:-1]


def test_a_log_has_a_line_every_ten_seconds_with_what_is_done_the_loss_and_the_time_left():
    lines = run(io.StringIO(), 100, 1.0, lasting=True)
    assert len(lines) == 11
    assert lines[0] == "stage 1: 10/100 steps (10 %), loss 0.1, 1:30 min left"
    assert lines[8] == "stage 1: 90/100 steps (90 %), loss 0.01111, 10 s left"
    assert lines[-1] == "stage 1: 100/100 steps, loss 0.01, took 1:40 min"


def test_thousands_of_quick_steps_are_one_line_or_none():
    quick = 1 / 1024  # seconds that floats add up without rounding
    assert run(io.StringIO(), 5000, quick) == []
    assert run(io.StringIO(), 5000, quick, lasting=True) == ["stage 1: 5000/5000 steps, loss 0.0002, took 5 s"]
    assert len(run(io.StringIO(), 50_000, quick)) == 5


def test_the_time_left_follows_the_speed_of_late():
    clock, stream = Clock(), io.StringIO()
    bar = Progress("fit", 1000, "step", stream=stream, clock=clock)
    for step in range(960):
        clock.now += 0.125 if step < 880 else 1.0
        bar.advance()
    assert stream.getvalue().splitlines()[-1] == "fit: 960/1000 steps (96 %), 40 s left"


def test_a_terminal_has_one_line_that_is_drawn_again():
    stream = Terminal()
    lines = run(stream, 100, 1 / 16, lasting=True)
    assert len(lines) == 1
    drawn = lines[0].split("\r")[1:]
    assert len(drawn) == 51  # a tenth of a second has passed after every second step
    assert drawn[24].startswith("stage 1 [############............] 50/100 steps, 3 s left, loss 0.02")
    assert drawn[-1].rstrip() == "stage 1: 100/100 steps, loss 0.01, took 6 s"


def test_a_bar_that_does_not_last_leaves_nothing():
    stream = Terminal()
    run(stream, 100, 0.05)
    *_, last, end = stream.getvalue().split("\r")
    assert (last.strip(), end) == ("", "")
    assert "\n" not in stream.getvalue()


def test_a_line_never_wraps_and_covers_the_one_before(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    stream, clock = Terminal(), Clock()
    bar = Progress("a long title", 10**6, "step", stream=stream, clock=clock)
    for count in (999_990, 1):
        clock.now += 1
        bar.advance(count)
    lines = stream.getvalue().split("\r")[1:]
    assert max(map(len, lines)) < 40
    assert len(lines[1]) >= len(lines[0].rstrip())


def test_what_is_resumed_counts_from_where_it_was():
    clock, stream = Clock(), io.StringIO()
    bar = Progress("stage 1", 100, "step", done=80, stream=stream, clock=clock)
    clock.now = 10.0
    bar.advance(10)
    assert stream.getvalue() == "stage 1: 90/100 steps (90 %), 10 s left\n"


def test_silence_where_it_is_not_to_be_shown():
    assert run(io.StringIO(), 100, 1.0, show=False, lasting=True) == []


@pytest.mark.parametrize(
    ("items", "total"), [([1, 2, 3], None), (iter([1, 2, 3]), 3), (iter([1, 2, 3]), None), ([], None)]
)
def test_the_items_pass_through_unchanged(items, total, capsys):
    expected = list(items) if isinstance(items, list) else [1, 2, 3]
    assert list(shown(items, "reading", "file", total=total, lasting=True)) == expected
    count = len(expected)
    of = f"/{count}" if count and (total or isinstance(items, list)) else ""
    assert capsys.readouterr().err == f"reading: {count}{of} files, took 0 s\n"


def test_one_unit_is_singular():
    assert run(io.StringIO(), 1, 0.5, lasting=True) == ["stage 1: 1/1 step, loss 1, took 0 s"]


def test_an_error_within_ends_the_line():
    stream = Terminal()
    with pytest.raises(KeyError), Progress("stage 1", 10, "step", stream=stream, lasting=True):
        raise KeyError
    assert stream.getvalue().endswith("stage 1: 0/10 steps, took 0 s\n")


def test_processes_that_share_a_terminal_write_lines_with_their_name():
    progress.lines_only("runs/anna")
    try:
        assert run(Terminal(), 20, 1.0)[0] == "runs/anna: stage 1: 10/20 steps (50 %), loss 0.1, 10 s left"
    finally:
        progress.lines_only(None)
    assert "runs/anna" not in "".join(run(Terminal(), 20, 1.0))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "0 s"), (59.4, "59 s"), (59.6, "1:00 min"), (185, "3:05 min"), (3599.6, "1:00 h"), (7380, "2:03 h")],
)
def test_durations_are_in_the_unit_that_one_would_say(seconds, text):
    assert duration(seconds) == text


def test_bars_of_a_chapter_begin_with_it():
    with progress.chapter("2/4"):
        inside = run(io.StringIO(), 2, 1.0, lasting=True)
    assert inside == ["2/4 stage 1: 2/2 steps, loss 0.5, took 2 s"]
    assert run(io.StringIO(), 2, 1.0, lasting=True) == ["stage 1: 2/2 steps, loss 0.5, took 2 s"]
