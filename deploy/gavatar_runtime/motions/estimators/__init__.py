"""Results of pose estimators and data sets of motions: how each lays its fields out, and the persons in them."""

from .found import Found, Person
from .recognise import people_in

__all__ = ["Found", "Person", "people_in"]
