"""gavatar's research half: learns animatable Gaussian avatars from a single video (GaussianAvatar, CVPR 2024)."""

from gavatar_runtime import __version__

__all__ = ["__version__"]
