"""The catalogue of laws: a verb each; membership in `ALL` enrols it in the tests."""

from typing import TYPE_CHECKING

from holdfast.errors import refused_attribute
from holdfast.maths.catalogue.laws.driftless import (
    align_unicycle,
    follow_integrator,
    steer_by_chained_form,
    steer_chained,
    steer_integrator,
    steer_unicycle,
)
from holdfast.maths.catalogue.laws.follow_field import follow_field
from holdfast.maths.catalogue.laws.follow_leader import (
    approach_leader,
    follow_leader,
    keep_footprint,
)
from holdfast.maths.catalogue.laws.hold_station import hold_station, hold_station_unknown
from holdfast.maths.catalogue.laws.keep_range import back_off, move_ahead
from holdfast.maths.catalogue.laws.legs_in_view import inspect_target, rest_in_current
from holdfast.maths.catalogue.laws.marine_craft import (
    dock_marine,
    face_target,
    hold_pose,
    project_marine,
    steer_marine,
    weathervane,
)

ALL = (
    steer_marine,
    face_target,
    back_off,
    move_ahead,
    steer_unicycle,
    align_unicycle,
    steer_integrator,
    follow_integrator,
    steer_chained,
    steer_by_chained_form,
    follow_field,
    dock_marine,
    project_marine,
    hold_station,
    hold_station_unknown,
    weathervane,
    inspect_target,
    rest_in_current,
    approach_leader,
    follow_leader,
    keep_footprint,
    hold_pose,
)

__all__ = [
    "ALL",
    "align_unicycle",
    "approach_leader",
    "back_off",
    "dock_marine",
    "face_target",
    "follow_field",
    "follow_integrator",
    "follow_leader",
    "hold_pose",
    "hold_station",
    "hold_station_unknown",
    "inspect_target",
    "keep_footprint",
    "move_ahead",
    "project_marine",
    "rest_in_current",
    "steer_by_chained_form",
    "steer_chained",
    "steer_integrator",
    "steer_marine",
    "steer_unicycle",
    "weathervane",
]

if not TYPE_CHECKING:
    __getattr__ = refused_attribute("holdfast.laws", [f.__name__ for f in ALL])
