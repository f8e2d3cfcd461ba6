"""The player's rasterizers, by name."""

from ..registry import Registry

PLAYER_RASTERIZERS: Registry = Registry("rasterizer")
