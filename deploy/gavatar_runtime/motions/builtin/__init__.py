"""Motions that need no file: enough to look at an avatar from all sides and to see it move.

Every module of this folder that registers a class adds one; nothing else has to name it.
"""

import importlib
import pkgutil

from .standing import relaxed_pose

__all__ = ["relaxed_pose"]

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
