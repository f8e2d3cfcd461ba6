"""An optimiser that is fed NaN once: training stops with a sentence, and nothing that it wrote holds NaN."""

from __future__ import annotations

import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import compose_config
from gavatar.storage import load_tensors
from gavatar.training.run import train
from gavatar.training.stage import Stage
from gavatar_runtime.errors import UserError


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


def tensors(value):
    if isinstance(value, torch.Tensor):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from tensors(item)


@pytest.mark.parametrize(("at", "told"), [(1, "step 1"), (2, "step 3")], ids=["at a checkpoint", "between two"])
def test_a_gradient_of_nan_ends_in_a_sentence_and_in_no_file(capture, tmp_path, monkeypatch, at, told):
    update, asked = Stage._update, []

    def poisoned(self, rows, progress):
        if len(asked) == at:
            parameter = self.optimizers["optimizer"].param_groups[0]["params"][0]
            parameter.grad.view(-1)[0] = float("nan")
        asked.append(rows)
        update(self, rows, progress)

    monkeypatch.setattr(Stage, "_update", poisoned)
    out = tmp_path / "run"
    config = [
        f"capture={capture}",
        f"out={out}",
        *SMALL,
        "stage1.steps=6",
        "checkpoint_every=1" if at == 1 else "checkpoint_every=4",
    ]
    with pytest.raises(UserError, match=rf"stage 1 diverged at {told}: the loss is nan; lower stage1\.lr_decoder"):
        train(compose_config(config), out)
    found = list(out.glob("*.pt"))
    assert bool(found) == (at == 1)  # of the step before
    for path in found:
        assert all(torch.isfinite(t).all() for t in tensors(load_tensors(path)) if t.is_floating_point())


def test_a_gradient_of_nan_in_the_last_step_makes_no_avatar(capture, tmp_path, monkeypatch):
    update, count = Stage._update, []

    def poisoned(self, rows, progress):
        count.append(0)
        if len(count) == self.plan.stage.steps:
            self.optimizers["optimizer"].param_groups[0]["params"][0].grad.view(-1)[0] = float("nan")
        update(self, rows, progress)

    monkeypatch.setattr(Stage, "_update", poisoned)
    with pytest.raises(UserError, match="stage 1 diverged at step 2: the loss is nan"):
        train(
            compose_config([f"capture={capture}", f"out={tmp_path / 'run'}", *SMALL, "stage1.steps=3"]),
            tmp_path / "run",
        )
    assert not list((tmp_path / "run").glob("stage*.pt"))
