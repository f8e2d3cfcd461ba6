"""Preparing footage for training: a video, or landmarks and masks, in; a capture with a fitted body out."""

from .detect import Detector
from .fit import BodyFitter, Fit, FitOptions
from .footage_source import Source, SourceOptions, open_source
from .landmarks import Landmarks, read_landmarks
from .pipeline import Quality, prepare
from .write import CaptureFacts, write_capture

__all__ = [
    "BodyFitter", "CaptureFacts", "Detector", "Fit", "FitOptions", "Landmarks", "Quality", "Source", "SourceOptions",
    "open_source", "prepare", "read_landmarks", "write_capture",
]  # fmt: skip
