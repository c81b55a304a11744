"""States and inputs of a system as standard messages of ROS 2.

    nav_msgs/OccupancyGrid a map of occupied cells, in the frame of the pose
    nav_msgs/Odometry      pose: x, y [m] and the heading [rad]; twist: surge, sway, yaw rate
    geometry_msgs/Wrench   inputs that are forces [N] and moments [N m]
    geometry_msgs/Twist    inputs that are velocities [m/s] and turn rates [rad/s]
    geometry_msgs/Accel    inputs that are accelerations [m/s^2] and [rad/s^2]

The axes are those of REP 103: z is up, headings and yaw rates are about it, and the twist is in the
frame of the vehicle (`child_frame_id`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, HoldfastError, check_name, suggestion
from holdfast.maths.definitions.system import System
from holdfast.planning.occupancy_map import OccupancyMap, Unknown

NANO = 1_000_000_000
GRID = "nav_msgs/msg/OccupancyGrid"
ODOMETRY = "nav_msgs/msg/Odometry"
COMMANDS = {
    "Wrench": {"force": "N", "torque": "N m"},
    "Twist": {"linear": "m/s", "angular": "rad/s"},
    "Accel": {"linear": "m/s^2", "angular": "rad/s^2"},
}
"""Message of geometry_msgs -> its vectors, and their units."""

DETECTIONS = "vision_msgs/msg/Detection3DArray"
_VISION = {
    "Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
    "Detection3D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\n"
    "BoundingBox3D bbox\nstring id",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "ObjectHypothesis": "string class_id\nfloat64 score",
}
"""The fields of vision_msgs 4.1.1, which is no part of the standard messages."""

STORE: Any = get_typestore(Stores.ROS2_JAZZY)
for _name, _fields in _VISION.items():
    STORE.register(get_types_from_msg(_fields, f"vision_msgs/msg/{_name}"))
_NOTHING = np.zeros(36)
_AXES = ("x", "y", "z")


class MessageError(HoldfastError):
    """A message that is not what its topic is for."""


def made(kind: str, **fields: Any) -> Any:
    """A message of "nav_msgs/msg/Odometry" or another standard type."""
    return STORE.types[kind](**fields)


def encoded(message: Any) -> bytes:
    """The CDR of a message, with its encapsulation header."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def decoded(data: bytes, kind: str) -> Any:
    """The message of a type. Raises `MessageError` for bytes that are none."""
    try:
        return STORE.deserialize_cdr(data, kind)
    except Exception as error:
        # whatever the bytes make the generated reader do
        raise MessageError(f"{len(data)} bytes are no {kind} ({type(error).__name__})") from None


def digest(kind: str) -> str:
    """The hash of a type's definition, RIHS01. Raises `DefinitionError` for an unknown type."""
    check_name(kind, STORE.types, DefinitionError, f"'{kind}' is no standard message of ROS 2")
    return str(STORE.hash_rihs01(kind))


def grid_of(world: OccupancyMap, stamp: int, frame: str) -> Any:
    """nav_msgs/OccupancyGrid of a map, 100 where occupied; stamp in ns since 1970."""
    x, y, yaw = world.origin
    rows, columns = world.shape
    turned = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    corner = made(
        "geometry_msgs/msg/Pose",
        position=made("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
        orientation=made("geometry_msgs/msg/Quaternion", **turned),
    )
    top = header(stamp, frame)
    about = made(
        "nav_msgs/msg/MapMetaData", map_load_time=top.stamp, resolution=world.resolution,
        width=columns, height=rows, origin=corner,
    )  # fmt: skip
    data = np.where(world.cells, 100, 0).astype(np.int8).ravel()
    return made(GRID, header=top, info=about, data=data)


def header(stamp: int, frame: str) -> Any:
    """stamp: ns since 1970."""
    time = made("builtin_interfaces/msg/Time", sec=stamp // NANO, nanosec=stamp % NANO)
    return made("std_msgs/msg/Header", stamp=time, frame_id=frame)


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return made("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def odometry(
    pose: tuple[float, float, float],
    twist: tuple[float, float, float],
    stamp: int,
    frame: str,
    child: str,
) -> Any:
    """Odometry of x, y, heading and of surge, sway, yaw rate; covariances are 0, unknown."""
    x, y, heading = pose
    surge, sway, turn = twist
    turned = {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}
    place = made(
        "geometry_msgs/msg/Pose",
        position=made("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
        orientation=made("geometry_msgs/msg/Quaternion", **turned),
    )
    moving = made("geometry_msgs/msg/Twist", linear=vector(surge, sway), angular=vector(z=turn))
    return made(
        ODOMETRY,
        header=header(stamp, frame),
        child_frame_id=child,
        pose=made("geometry_msgs/msg/PoseWithCovariance", pose=place, covariance=_NOTHING),
        twist=made("geometry_msgs/msg/TwistWithCovariance", twist=moving, covariance=_NOTHING),
    )


def heading_of(orientation: Any) -> float:
    """The angle of a rotation about z [rad]; NaN if the quaternion is none."""
    x, y, z, w = (getattr(orientation, n) for n in ("x", "y", "z", "w"))
    size = x * x + y * y + z * z + w * w
    if not (math.isfinite(size) and size > 1e-6):
        return math.nan
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


class Interface:
    """How the states and the inputs of a system stand in messages, at both ends.

    pose: the states that are x, y [m] and the heading [rad]; by default "x", "y" and the only state
    that is an angle. twist: the states that are surge and sway velocity [m/s] and yaw rate [rad/s],
    None for one that the system does not have; by default "u", "v" and "r" where these are states.
    fields: input -> the field of the command, as {"tau_u": "force.x"}. The units of the inputs say
    which message it is. By default the first and second of a linear unit are x and y, and the first
    of an angular unit is z. stamped: whether the command has a header (WrenchStamped).
    frame: the `frame_id` of the pose; Odometry in another one is refused, unless frame is "".
    child: the `child_frame_id`, and that of stamped commands.

    Raises `DefinitionError` for names and units that do not fit.
    """

    @checked
    def __init__(
        self,
        system: System,
        *,
        pose: tuple[str, str, str] | None = None,
        twist: tuple[str | None, str | None, str | None] | None = None,
        fields: Mapping[str, str] | None = None,
        stamped: bool = False,
        frame: str = "map",
        child: str = "base_link",
    ) -> None:
        names = system.state_names
        if pose is None:
            angles = [q.name for q in system.states if q.angle]
            if len(angles) != 1 or not {"x", "y"} <= set(names):
                raise DefinitionError(
                    f"system '{system.name}' does not say which states are its pose",
                    expected="pose=(x, y, heading), names of states",
                )
            pose = ("x", "y", angles[0])
        if twist is None:
            u, v, r = (n if n in names else None for n in ("u", "v", "r"))
            twist = u, v, r
        if len(pose) != 3 or len(twist) != 3:
            raise DefinitionError(
                f"pose has {len(pose)} names and twist {len(twist)}", expected="3 of each"
            )
        units = {q.name: q.unit for q in system.states}
        wanted = zip((*pose, *twist), ("m", "m", "rad", "m/s", "m/s", "rad/s"), strict=True)
        for name, unit in wanted:
            if name is not None and name not in names:
                raise DefinitionError(f"no state '{name}'", remedy=suggestion(name, names))
            if name is not None and units[name] != unit:
                raise DefinitionError(f"state '{name}' is in {units[name]}", expected=unit)
        self.system, self.pose, self.twist = system, pose, twist
        self.frame, self.child, self.stamped = frame, child, stamped
        measured = {name for name in (*pose, *twist) if name is not None}
        self.states = tuple(n for n in names if n in measured)
        self.base, self.fields = _command_fields(system, fields)
        self.command = f"geometry_msgs/msg/{self.base}" + "Stamped" * stamped

    # -- the state ---------------------------------------------------------------------------

    def odometry(self, state: Mapping[str, float], stamp: int) -> Any:
        """nav_msgs/Odometry of the states; stamp in ns since 1970."""
        x, y, heading = (float(state[n]) for n in self.pose)
        u, v, r = (float(state[n]) if n is not None else 0.0 for n in self.twist)
        return odometry((x, y, heading), (u, v, r), stamp, self.frame, self.child)

    def state(self, message: Any) -> dict[str, float]:
        """The states of a nav_msgs/Odometry. Raises `MessageError` for one of another frame."""
        if self.frame and message.header.frame_id != self.frame:
            raise MessageError(
                f"Odometry in the frame '{message.header.frame_id}'"[:80], expected=self.frame
            )
        place, moving = message.pose.pose, message.twist.twist
        pose = place.position.x, place.position.y, heading_of(place.orientation)
        twist = moving.linear.x, moving.linear.y, moving.angular.z
        pairs = zip((*self.pose, *self.twist), (*pose, *twist), strict=True)
        return {name: float(value) for name, value in pairs if name is not None}

    # -- the map -----------------------------------------------------------------------------

    def map(
        self, message: Any, unknown: Unknown = "occupied", before: OccupancyMap | None = None
    ) -> OccupancyMap:
        """The map of a nav_msgs/OccupancyGrid; `before` with new cells where only they differ.

        unknown: as of `OccupancyMap`. Raises `MessageError` for a map without a frame, in another
        one than the pose, tilted, or with cells that are none.
        """
        frame, about = message.header.frame_id, message.info
        if not frame:
            raise MessageError("a map with no frame", expected=self.frame or "a frame_id")
        if self.frame and frame != self.frame:
            raise MessageError(f"a map in the frame '{frame}'"[:80], expected=self.frame)
        place, turned = about.origin.position, about.origin.orientation
        if not abs(turned.x) + abs(turned.y) <= 1e-6:
            raise MessageError("a map that is tilted", expected="a turn about z alone")
        if len(message.data) != about.height * about.width:
            raise MessageError(
                f"a map of {about.height} x {about.width} cells has {len(message.data)}"
            )
        cells = np.asarray(message.data).reshape(about.height, about.width)
        origin = float(place.x), float(place.y), heading_of(turned)
        side = float(about.resolution)
        side = float(f"{side:.7g}")  # of single precision
        try:
            if before is not None and (before.shape, before.resolution, before.origin) == (
                cells.shape, side, origin
            ):  # fmt: skip
                before.update(cells)
                return before
            return OccupancyMap(cells, side, origin, unknown=unknown)
        except DefinitionError as error:
            raise MessageError(f"a map: {error.cause}", expected=error.expected) from None

    # -- the command -------------------------------------------------------------------------

    def wrap(
        self, inputs: Mapping[str, float], stamp: int, rest: Mapping[str, float] | None = None
    ) -> Any:
        """The message of a command; stamp in ns since 1970, rest: field -> value of `inputs`."""
        values: dict[str, dict[str, float]] = {n: {} for n in COMMANDS[self.base]}
        by_field = {field: inputs[name] for name, field in self.fields.items()}
        for field, value in {**(rest or {}), **by_field}.items():
            where, axis = field.split(".")
            values[where][axis] = float(value)
        bare = made(f"geometry_msgs/msg/{self.base}", **{n: vector(**v) for n, v in values.items()})
        if not self.stamped:
            return bare
        return made(self.command, header=header(stamp, self.child), **{self.base.lower(): bare})

    def inputs(self, message: Any) -> tuple[dict[str, float], dict[str, float]]:
        """The inputs of a command; and its fields out of the plane of motion, by name.

        Those (z, and about x and y) concern no filter of a planar vehicle: depth, for example.
        Raises `MessageError` where a field in the plane that no input is differs from 0, and where
        one out of the plane is not finite.
        """
        bare = getattr(message, self.base.lower()) if self.stamped else message
        by_field = {
            f"{where}.{axis}": float(getattr(getattr(bare, where), axis))
            for where in COMMANDS[self.base]
            for axis in _AXES
        }
        by_input = {name: by_field.pop(field) for name, field in self.fields.items()}
        linear, angular = COMMANDS[self.base]
        for field in (f"{linear}.x", f"{linear}.y", f"{angular}.z"):
            if by_field.pop(field, 0.0) != 0.0:
                raise MessageError(
                    f"a command of {field}, which no input is", expected="0 in this field"
                )
        for field, value in by_field.items():
            if not math.isfinite(value):
                raise MessageError(f"{field} of a command is {value}", expected="a finite number")
        return by_input, by_field


def _command_fields(system: System, fields: Mapping[str, str] | None) -> tuple[str, dict[str, str]]:
    """The message of geometry_msgs that has the units of the inputs, and the field of each."""
    units = {q.name: q.unit for q in system.inputs}
    fitting = [m for m, has in COMMANDS.items() if set(units.values()) <= set(has.values())]
    if not units or not fitting:
        raise DefinitionError(
            "no standard message has the units of the inputs: "
            + ", ".join(f"{n} [{u}]" for n, u in units.items()),
            expected="N and N m (Wrench), m/s and rad/s (Twist), m/s^2 and rad/s^2 (Accel)",
        )
    message = fitting[0]
    vectors = {unit: where for where, unit in COMMANDS[message].items()}
    linear, _ = COMMANDS[message].values()
    if fields is None:
        free = {u: ["x", "y", "z"] if u == linear else ["z"] for u in vectors}
        if any(list(units.values()).count(u) > len(axes) for u, axes in free.items()):
            raise DefinitionError(
                f"{message} has not enough fields for {', '.join(units)}",
                remedy="fields={input: 'force.x', ...} says which are meant",
            )
        return message, {n: f"{vectors[u]}.{free[u].pop(0)}" for n, u in units.items()}
    if set(fields) != set(units):
        raise DefinitionError(
            f"fields are given for {', '.join(fields) or 'nothing'}", expected=", ".join(units)
        )
    for name, field in fields.items():
        allowed = [f"{vectors[units[name]]}.{axis}" for axis in _AXES]
        if field not in allowed:
            raise DefinitionError(
                f"'{field}' for input '{name}' in {units[name]}", expected=" or ".join(allowed)
            )
    if len(set(fields.values())) < len(fields):
        raise DefinitionError("two inputs have one field", expected="a field for every input")
    return message, {n: fields[n] for n in units}
