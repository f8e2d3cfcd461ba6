"""Motion sources the player can read: files by their format, and built-in motions by name.

Every module of this folder that registers a class adds one source; nothing else has to name it.
"""

import importlib
import pkgutil

from .source import MOTIONS, MotionSource, built_in_motions, motions_named, read_motion, read_motions

__all__ = ["MOTIONS", "MotionSource", "built_in_motions", "motions_named", "read_motion", "read_motions"]

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
