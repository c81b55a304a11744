"""The catalogue of laws: one verb, one file; membership in `ALL` enrols it in the tests."""

from holdfast.maths.laws.face_target import face_target
from holdfast.maths.laws.keep_range import back_off, move_ahead
from holdfast.maths.laws.steer_marine import steer_marine

ALL = (steer_marine, face_target, back_off, move_ahead)

__all__ = ["ALL", "back_off", "face_target", "move_ahead", "steer_marine"]
