"""What a training writes down as it goes: losses, times, verdicts and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torch import Tensor

from gavatar_runtime.errors import UserError

from ..storage import atomic, write_image, write_json
from .preview import LATEST, LIVE, as_image, live_page, side_by_side
from .remedies.evidence_picture import evidence_picture
from .scene import Scene
from .verdicts import Verdicts


class Record:
    """metrics.json and previews/ of a run directory, and a TensorBoard there if one is asked for.

    history: an entry {"stage", "step", "losses"} now and then. seconds: spent in each stage.
    """

    def __init__(self, directory: Path, tensorboard: bool = False):
        self.directory = directory
        self.history: list[dict[str, Any]] = []
        self.seconds = {1: 0.0, 2: 0.0}
        self.verdicts = Verdicts()
        self._board = _tensorboard(directory) if tensorboard else None

    def log(self, stage: int, step: int, losses: dict[str, float]) -> None:
        self.history.append({"stage": stage, "step": step, "losses": losses})
        if self._board is not None:
            for key, value in losses.items():
                self._board.add_scalar(f"stage{stage}/{key}", value, step)

    def preview(self, stage: int, step: int, target: Tensor, render: Tensor, steps: int = 0) -> None:
        """Write footage, avatar and error of a view, (3, H, W) each, side by side, and beside it a page that shows the
        latest such picture while training goes on. steps: of the stage, 0 where that is not known."""
        folder, picture = self.directory / "previews", side_by_side(as_image(target), as_image(render))
        for name in (f"stage{stage}_{step:06d}.png", LATEST):
            write_image(folder / name, picture)
        of = f" of {steps}" if steps else ""
        self._live(f"stage {stage}, step {step + 1}{of}: footage, avatar, error", step)

    def _live(self, title: str, stamp: int, finished: bool = False) -> None:
        with atomic(self.directory / "previews" / LIVE) as temporary:
            temporary.write_text(live_page(title, stamp, finished), encoding="utf-8")

    def evidence(self, scene: Scene) -> None:
        """Draw what the views say of each point: evidence.png, and among the previews."""
        picture = evidence_picture(scene)
        for path in (self.directory / "evidence.png", self.directory / "previews" / "evidence.png"):
            write_image(path, picture)

    def write(self, gaussians: int | None, finished: bool) -> None:
        """Write metrics.json. gaussians: of the avatar, None before it has any."""
        write_json(
            self.directory / "metrics.json",
            {
                "finished": finished,
                "seconds": {f"stage{k}": round(v, 2) for k, v in self.seconds.items()},
                "gaussians": gaussians,
                "verdicts": self.verdicts.as_json(),
                "history": self.history,
            },
        )
        if finished and (self.directory / "previews" / LATEST).exists():
            self._live("the training is finished: footage, avatar, error", len(self.history), finished)

    def state(self) -> dict[str, Any]:
        """Plain values for the checkpoint."""
        return {"history": self.history, "seconds": self.seconds, "verdicts": self.verdicts.as_json()}

    def load_state(self, state: dict[str, Any]) -> None:
        """Go on from what `state` gave."""
        self.history, self.seconds = state["history"], state["seconds"]
        self.verdicts = Verdicts.from_json(state.get("verdicts", {}))


def _tensorboard(directory: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise UserError("tensorboard=true needs the tensorboard package: pip install 'gavatar[tensorboard]'") from None
    return SummaryWriter(str(directory / "tensorboard"))
