"""What played frames go into, one file a kind of output.

Every module of this folder that registers a class adds one; nothing else has to name it.
"""

import importlib
import pkgutil

from .output import (
    OUTPUTS,
    FrameFormat,
    GaussianOutput,
    ImageOutput,
    Output,
    OutputTraits,
    default_output,
    find_output,
    open_output,
    output_called,
    save_gaussians,
)

__all__ = [
    "OUTPUTS",
    "FrameFormat",
    "GaussianOutput",
    "ImageOutput",
    "Output",
    "OutputTraits",
    "default_output",
    "find_output",
    "open_output",
    "output_called",
    "save_gaussians",
]

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
