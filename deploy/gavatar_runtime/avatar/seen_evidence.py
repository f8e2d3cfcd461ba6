"""The evidence that a bundle holds."""

from __future__ import annotations

from ..bundle import Bundle
from ..values.point_evidence import MEMBER, Evidence


def read_evidence(bundle: Bundle, points: int) -> Evidence | None:
    """Of all points of a bundle, or None where it was written without."""
    if MEMBER not in bundle.manifest.members:
        return None
    return Evidence.from_arrays(bundle.arrays(MEMBER), f"{bundle.path}: {MEMBER}", points)
