"""Preparing footage for training: a video, or landmarks and masks, in; a capture with a fitted body out."""
