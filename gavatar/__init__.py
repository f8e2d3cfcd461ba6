"""gavatar's research half: learns animatable Gaussian avatars from a single video (GaussianAvatar, CVPR 2024)."""

import os

from gavatar_runtime import __version__

# OpenMP's threads otherwise spin at every barrier: beside another busy process, or our own splatting threads, a
# training step then takes ten to a hundred times as long. Read once, when torch loads it, so it stands here.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# torch then asks the kernel for large pages under tensors of 2 MB and more: fewer page faults (training/memory.py has
# the other half). Read when torch allocates for the first time.
os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")

__all__ = ["__version__"]
