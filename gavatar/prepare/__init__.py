"""Preparing footage for training: landmarks and masks in, a capture with a fitted body out."""

from .fit import BodyFitter, Fit, FitOptions
from .landmarks import Landmarks, read_landmarks
from .pipeline import Quality, prepare
from .source import Source, SourceOptions, open_source
from .write import CaptureFacts, write_capture

__all__ = [
    "BodyFitter", "CaptureFacts", "Fit", "FitOptions", "Landmarks", "Quality", "Source", "SourceOptions",
    "open_source", "prepare", "read_landmarks", "write_capture",
]  # fmt: skip
