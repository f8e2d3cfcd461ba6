"""Parts from other installed packages, by their entry points."""

from __future__ import annotations

import functools
import warnings

from .notes import Note

ENTRY_POINT_GROUP = "gavatar.plugins"


@functools.cache
def load_entry_points(group: str = ENTRY_POINT_GROUP) -> None:
    """Import what any installed package registers under the group, once.

    Called when a name is unknown, never before: plugins may import anything. One that fails is warned of by name with
    its cause, and the rest go on.
    """
    import importlib.metadata

    for point in importlib.metadata.entry_points(group=group):
        try:
            point.load()
        except Exception as error:  # whatever a plugin does at import must not take the others down
            warnings.warn(f"plugin {point.name} was skipped: {type(error).__name__}: {error}", Note, stacklevel=2)
