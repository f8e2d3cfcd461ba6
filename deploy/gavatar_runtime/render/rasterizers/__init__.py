"""The player's rasterizers, by name."""

from ...components import Registry

PLAYER_RASTERIZERS: Registry = Registry("rasterizer")

# Switches that an avatar is trained with and therefore played with, kept in its bundle's manifest. Not `resolution`:
# that is a part of a size which the player chooses itself.
SWITCHES = ("antialiased", "fast", "backface", "depth_cut")
