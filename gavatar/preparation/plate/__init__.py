"""The empty room behind a person whom a still camera films, and masks that it makes better."""
