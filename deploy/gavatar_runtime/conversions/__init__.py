"""What a whole avatar, with motions, can be turned into for other programs: one file a format.

Every module of this folder that registers a class adds one; nothing else has to name it. (What single frames go into
are `play.outputs`.)
"""

import importlib
import pkgutil

from .conversion import CONVERSIONS, Conversion, Request, convert, default_motions, find_conversion

__all__ = ["CONVERSIONS", "Conversion", "Request", "convert", "default_motions", "find_conversion"]

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
