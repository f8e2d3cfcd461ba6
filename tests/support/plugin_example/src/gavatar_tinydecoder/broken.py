"""A sibling that cannot be imported: it must be reported by name and take nothing down with it."""

raise RuntimeError("this plugin is broken on purpose")
