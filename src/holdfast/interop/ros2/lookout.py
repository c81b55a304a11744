"""Obstacles as ROS 2 tells of them: boxes that a detector found, and the odometry of neighbours.

    vision_msgs/Detection3DArray    every box around something, in the frame of the filter
    nav_msgs/Odometry               a neighbour of a fleet: pose, and twist in its own frame

Detection2DArray is in pixels of an image, and says nothing of places.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.interop.ros_messages import MessageError, heading_of
from holdfast.planning.moving_obstacles import Obstacle

MOST = 500
"""Boxes of a message."""


@checked
@dataclass(frozen=True)
class Lookout:
    """What a node takes for obstacles.

    detections: the topic of vision_msgs/Detection3DArray; without a message of it for the patience
    of the node nothing is promised. None: there is no such topic. neighbours: topic of
    nav_msgs/Odometry -> radius [m] around its position. A neighbour counts from its first message
    on; if it is silent for `lasts` [s] nothing is promised any more, and until then it is where it
    was, moved on, grown by what it may have done. share: the part of a condition that this vehicle
    meets beside a neighbour: 1/2 where the neighbour surely filters with the other half. speed
    [m/s]: what a detected thing may have, of which no velocity is known. radius [m]: added around
    a box. acceleration [m/s^2], velocity_error [m/s]: of neighbours, see `hf.Obstacle`.

    Raises `DefinitionError` for a number below 0, a share that is not above 0 and up to 1, and
    where neither detections nor neighbours are named.
    """

    detections: str | None = "detections"
    neighbours: Mapping[str, float] = field(default_factory=dict)
    share: float = 1.0
    speed: float = 0.0
    radius: float = 0.0
    acceleration: float = 0.0
    velocity_error: float = 0.0
    lasts: float = 5.0

    def __post_init__(self) -> None:
        numbers = {n: getattr(self, n) for n in _NUMBERS}
        numbers |= {f"the radius of '{topic}'": r for topic, r in self.neighbours.items()}
        for name, value in numbers.items():
            if not (math.isfinite(value) and value >= 0):
                raise DefinitionError(f"{name} is {value}", expected="0 or more")
        if not 0 < self.share <= 1:
            raise DefinitionError(f"share is {self.share:g}", expected="above 0, up to 1")
        if self.detections is None and not self.neighbours:
            raise DefinitionError("the lookout names no topic", expected="detections or neighbours")


_NUMBERS = ("speed", "radius", "acceleration", "velocity_error", "lasts")


class Watch:
    """The obstacles of the newest messages. frame: that of the filter; "" for any."""

    def __init__(self, lookout: Lookout, frame: str) -> None:
        self.lookout, self.frame = lookout, frame
        self._boxes: tuple[float, list[Obstacle]] | None = None
        self._neighbours: dict[str, tuple[float, Obstacle]] = {}

    def boxes(self, message: Any) -> list[Obstacle]:
        """The obstacles of a Detection3DArray.

        Raises `MessageError` for one of another frame, and for more than `MOST` boxes.
        """
        if len(message.detections) > MOST:
            raise MessageError(f"{len(message.detections)} boxes", expected=f"up to {MOST}")
        for header in (message.header, *(d.header for d in message.detections)):
            if header is message.header or header.frame_id:
                self._check(header.frame_id, "detections")
        return [self._box(k, d) for k, d in enumerate(message.detections, 1)]

    def neighbour(self, topic: str, message: Any) -> Obstacle:
        """The obstacle that a neighbour's Odometry says. Raises `MessageError` as `boxes`."""
        self._check(message.header.frame_id, "Odometry")
        place, twist = message.pose.pose, message.twist.twist.linear
        heading, look = heading_of(place.orientation), self.lookout
        cos, sin = math.cos(heading), math.sin(heading)
        velocity = (twist.x * cos - twist.y * sin, twist.x * sin + twist.y * cos)
        return Obstacle.disc(
            (place.position.x, place.position.y), look.neighbours[topic], velocity=velocity,
            acceleration=look.acceleration, velocity_error=look.velocity_error, share=look.share,
            name=topic,
        )  # fmt: skip

    def seen(self, boxes: list[Obstacle] | None, now: float) -> None:
        """Boxes of a message, received at `now` [s]; None for none."""
        if boxes is not None:
            self._boxes = now, boxes

    def met(self, topic: str, obstacle: Obstacle | None, now: float) -> None:
        """A neighbour, of a message that was received at `now` [s]; None for none."""
        if obstacle is not None:
            self._neighbours[topic] = now, obstacle

    def around(self, now: float) -> tuple[list[Obstacle], float] | None:
        """All obstacles, and the time of the list; None where something is not known."""
        at, obstacles = now, []
        if self.lookout.detections is not None:
            if self._boxes is None:
                return None
            at, boxes = self._boxes
            obstacles += boxes
        for heard, obstacle in self._neighbours.values():
            if now - heard > self.lookout.lasts:
                return None
            obstacles.append(obstacle.aged(at - heard))
        return obstacles, at

    def _check(self, frame: str, what: str) -> None:
        if self.frame and frame != self.frame:
            raise MessageError(f"{what} in the frame '{frame}'"[:80], expected=self.frame)

    def _box(self, number: int, detection: Any) -> Obstacle:
        """A rectangle around the box; a disc where it has no sides or no heading."""
        box, look = detection.bbox, self.lookout
        x, y = float(box.center.position.x), float(box.center.position.y)
        ahead, left = float(box.size.x) / 2, float(box.size.y) / 2
        heading = heading_of(box.center.orientation)
        name = detection.id or f"box {number}"
        if ahead < 0 or left < 0:
            raise MessageError(
                f"a box of {box.size.x:g} m x {box.size.y:g} m", expected="0 or more"
            )
        if not (ahead > 0 and left > 0 and math.isfinite(ahead + left + heading + x + y)):
            around = math.hypot(ahead, left) + look.radius
            return Obstacle.disc((x, y), around, name=name, velocity_error=look.speed)
        cos, sin = math.cos(heading), math.sin(heading)
        corners = tuple(
            (x + a * cos - b * sin, y + a * sin + b * cos)
            for a, b in ((ahead, left), (-ahead, left), (-ahead, -left), (ahead, -left))
        )
        return Obstacle(((corners, look.radius),), name=name, velocity_error=look.speed)
