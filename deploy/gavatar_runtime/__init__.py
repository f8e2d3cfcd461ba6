"""gavatar's deployment half: plays an exported avatar with NumPy and ONNX Runtime alone (no torch, ever).

    import gavatar_runtime as gr

    avatar = gr.load("anna.gavatar")
    image = avatar.render()
    avatar.play("wave", "wave.mp4", fps=30)

What stands in `__all__` is loaded when it is first asked for: to import this package takes milliseconds.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .version import __version__

if TYPE_CHECKING:
    from .errors import UserError
    from .motions import read_motion
    from .play.company import Companion, Place
    from .play.outputs import open_output
    from .player_face import Avatar, load
    from .render.renderer import Renderer
    from .values.camera import Camera, look_at
    from .values.gaussians import Gaussians, Rendering
    from .values.motion import Motion

__all__ = [
    "Avatar", "Camera", "Companion", "Gaussians", "Motion", "Place", "Renderer", "Rendering", "UserError",
    "__version__", "load", "look_at", "open_output", "read_motion",
]  # fmt: skip

_HOME = {
    "Avatar": "player_face",
    "Camera": "values.camera",
    "Companion": "play.company",
    "Gaussians": "values.gaussians",
    "Motion": "values.motion",
    "Place": "play.company",
    "Renderer": "render.renderer",
    "Rendering": "values.gaussians",
    "UserError": "errors",
    "load": "player_face",
    "look_at": "values.camera",
    "open_output": "play.outputs",
    "read_motion": "motions",
}


if not TYPE_CHECKING:  # type checkers would take any name for one that it knows

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
        value = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
        globals()[name] = value  # found at once from here on
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
