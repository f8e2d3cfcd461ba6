"""What is played unless asked for otherwise. Loads nothing, so that --help comes at once."""

DEFAULT_FPS = 30.0  # at most, of a motion that has its own
DEFAULT_SIZE, MAX_SIZE = 512, 8192  # pixels
BLEND = 0.4  # seconds from one motion to the next
AUTO = "auto"  # level of detail by the person's size in the images; the fastest rasterizer that is there
COLORS = {"white": (1, 1, 1), "black": (0, 0, 0), "grey": (0.5, 0.5, 0.5), "gray": (0.5, 0.5, 0.5), "green": (0, 1, 0)}
