"""Trainings that end in the middle, as a killed process would leave them."""

import contextlib

import pytest

from gavatar.training.stage import Stage


class Stopped(Exception):
    """In place of a signal."""


@contextlib.contextmanager
def stopped_after(checkpoint: tuple[str, int] | None = None):
    """The training in this block ends once `checkpoint`, a stage's name and step, is written (None: the first)."""
    save = Stage.save

    def save_and_stop(stage, step):
        save(stage, step)
        if checkpoint in (None, (f"stage{stage.plan.number}", step)):
            raise Stopped

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Stage, "save", save_and_stop)
        with pytest.raises(Stopped):
            yield
