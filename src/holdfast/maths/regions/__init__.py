"""The catalogue of regions; membership in `ALL` enrols an entry in the tests."""

from holdfast.maths.regions.camera_view import camera_view
from holdfast.maths.regions.inspection_goal import inspection_goal
from holdfast.maths.regions.near_origin import near_origin

ALL = (camera_view, inspection_goal, near_origin)

__all__ = ["ALL", "camera_view", "inspection_goal", "near_origin"]
