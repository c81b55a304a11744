"""ROS 2 without an installation of it: nodes on the wire of rmw_zenoh, with standard messages.

Needs eclipse-zenoh, rosbags and xxhash (`holdfast[interop]`).
"""

from holdfast.errors import DefinitionError

try:
    import rosbags  # noqa: F401
    import xxhash  # noqa: F401
    import zenoh  # noqa: F401
except ModuleNotFoundError as error:
    raise DefinitionError(
        f"ROS 2 needs the package '{error.name}'",
        remedy='python -m pip install "holdfast[interop]"',
    ) from None

from holdfast.interop.ros2.lookout import Lookout
from holdfast.interop.ros2.node import (
    ControllerNode,
    FilterNode,
    Network,
    Node,
    VehicleNode,
    router,
    serve,
)
from holdfast.interop.ros_messages import Interface, MessageError

__all__ = [
    "ControllerNode",
    "FilterNode",
    "Interface",
    "Lookout",
    "MessageError",
    "Network",
    "Node",
    "VehicleNode",
    "router",
    "serve",
]
