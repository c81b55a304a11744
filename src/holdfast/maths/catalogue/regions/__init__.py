"""The catalogue of regions; membership in `ALL` enrols an entry in the tests."""

from typing import TYPE_CHECKING

from holdfast.errors import refused_attribute
from holdfast.maths.catalogue.regions.camera_and_lasers import camera_and_lasers
from holdfast.maths.catalogue.regions.camera_view import camera_view
from holdfast.maths.catalogue.regions.hitch_angles import hitch_angles
from holdfast.maths.catalogue.regions.inspection_goal import inspection_goal
from holdfast.maths.catalogue.regions.leader_in_view import leader_in_footprint, leader_in_view
from holdfast.maths.catalogue.regions.near_origin import near_origin
from holdfast.maths.catalogue.regions.near_pose import near_pose
from holdfast.maths.catalogue.regions.steering_angle import steering_angle

ALL = (
    camera_and_lasers,
    camera_view,
    hitch_angles,
    inspection_goal,
    leader_in_footprint,
    leader_in_view,
    near_origin,
    near_pose,
    steering_angle,
)

__all__ = [
    "ALL",
    "camera_and_lasers",
    "camera_view",
    "hitch_angles",
    "inspection_goal",
    "leader_in_footprint",
    "leader_in_view",
    "near_origin",
    "near_pose",
    "steering_angle",
]

if not TYPE_CHECKING:
    __getattr__ = refused_attribute("holdfast.regions", [f.__name__ for f in ALL])
