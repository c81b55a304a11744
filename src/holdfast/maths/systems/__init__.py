"""The catalogue of systems: one noun, one file; membership in `ALL` enrols it in the tests."""

from holdfast.maths.systems.marine_vehicle import marine_vehicle
from holdfast.maths.systems.unicycle import unicycle

ALL = (marine_vehicle, unicycle)

__all__ = ["ALL", "marine_vehicle", "unicycle"]
