"""The catalogue of regions; membership in `ALL` enrols an entry in the tests."""

from holdfast.maths.regions.camera_view import camera_view
from holdfast.maths.regions.inspection_goal import inspection_goal

ALL = (camera_view, inspection_goal)

__all__ = ["ALL", "camera_view", "inspection_goal"]
