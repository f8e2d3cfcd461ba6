"""The version of both halves."""

__version__ = "0.1.0"
