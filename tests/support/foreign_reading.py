"""Opening captures in other people's layouts in tests: what was noted, and whether the body falls where it should."""

from __future__ import annotations

import warnings

import numpy as np

from gavatar.capture.opening import open_capture
from gavatar_runtime.notes import Note


def change(path, function):
    """Rewrite the dictionary of an .npy file."""
    content = np.load(path, allow_pickle=True).item()
    function(content)
    np.save(path, content, allow_pickle=True)


def opened(folder):
    """The capture and the notes of opening it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", Note)
        capture = open_capture(folder)
    return capture, [str(w.message) for w in said if w.category is Note]


def check_pixels(capture, expected, atol=2e-3):
    """The body falls where the data set's own reader puts it, in every view."""
    capture = capture.placed(expected["body"])
    motion = capture.motion
    for view in (v for views in capture.splits.values() for v in views):
        posed, _ = expected["body"].posed(
            motion.poses[view.frame].astype(float), motion.betas, motion.trans[view.frame]
        )
        pixels = capture.camera(view).project(posed)[:, :2]
        # as in test_foreign_captures: float32 poses over a metre at a focal length of 60
        np.testing.assert_allclose(pixels, expected["pixels"][view.camera, view.frame], atol=atol)
