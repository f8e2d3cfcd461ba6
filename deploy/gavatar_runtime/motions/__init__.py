"""Motion sources the player can read: files by their format, and built-in motions by name."""

from ..registry import Registry

MOTIONS: Registry = Registry("motion")
