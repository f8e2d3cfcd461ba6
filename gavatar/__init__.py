"""gavatar's training half: learns animatable Gaussian avatars from a single video (GaussianAvatar, CVPR 2024).

    import gavatar

    run = gavatar.train(gavatar.prepare("clip.mp4", "captures/anna"))
    run.export("anna.gavatar")

    gavatar.make("clip.mp4", "anna")     # all of it, and a page that plays: anna/anna.html

Importing it is quick; what trains is imported when it is first asked for (`gavatar.face`), and says in one sentence
which extra it needs where PyTorch is not installed.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from gavatar_runtime import __version__
from gavatar_runtime.cpus import cpu_quota, usable_cpus
from gavatar_runtime.errors import UserError

from .optional import import_from_extra

if TYPE_CHECKING:
    from .face import ExportedAvatar, PreparedCapture, TrainedRun, open_capture, open_run, prepare, train
    from .making import MadeAvatar, make

# OpenMP's threads otherwise spin at every barrier: beside another busy process, or our own splatting threads, a
# training step then takes ten to a hundred times as long. Read once, when torch loads it, so it stands here.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# torch then asks the kernel for large pages under tensors of 2 MB and more: fewer page faults (training/memory.py has
# the other half). Read when torch allocates for the first time.
os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")

# OpenCV's own lines on damaged files name lines of its source; what is wrong with which file is said in a sentence.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")

# OpenMP and torch keep to the affinity by themselves, but know nothing of a container's quota.
if cpu_quota() is not None:
    os.environ.setdefault("OMP_NUM_THREADS", str(usable_cpus()))

__all__ = [
    "ExportedAvatar", "MadeAvatar", "PreparedCapture", "TrainedRun", "UserError", "__version__", "make", "open_capture",
    "open_run", "prepare", "train",
]  # fmt: skip
_MAKING = ("MadeAvatar", "make")


if not TYPE_CHECKING:  # type checkers would take any name for one that it knows

    def __getattr__(name: str) -> Any:
        if name not in __all__:
            raise AttributeError(f"module 'gavatar' has no attribute '{name}'")
        home = "gavatar.making" if name in _MAKING else "gavatar.face"
        return getattr(import_from_extra(home, f"gavatar.{name}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
