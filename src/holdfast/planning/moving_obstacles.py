"""Obstacles that are known at run time: what a safety filter is told of them at a sample.

Shapes become corners and a radius: a disc, a capsule, the convex parts of a polygon.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import shapely

from holdfast.analysis.online.obstacle_slots import Clearing, Paired, Parts
from holdfast.arguments import checked
from holdfast.errors import DefinitionError, check_name
from holdfast.maths.definitions.value import Value
from holdfast.planning.obstacles import convex_parts, polygon_of

Point = Sequence[float]

SIDES_OF_ELLIPSE = 24
"""The polygon around an ellipse: it is outside by at most 1 - cos(pi / 24) = .9 % of an axis."""


@checked
@dataclass(frozen=True)
class Obstacle(Value):
    """Something in the plane that a vehicle keeps clear of: `SafetyFilter.step(obstacles=[...])`.

    Made by `Obstacle.disc`, `ellipse`, `capsule` and `polygon`, whose keywords are these:

    velocity [m/s]: (vx, vy), by default it stands. acceleration [m/s^2]: how fast the velocity may
    change, in any direction. velocity_error [m/s]: by how much the velocity may be another.
    age [s]: how old the numbers are: it has moved on since, and is grown by what it may have done
    meanwhile. share: the part of a condition that this vehicle meets; 1, or 1/2 for another vehicle
    that surely filters with the other half. name: for `Decision.why`. state: of another vehicle
    (`vehicle`).

    bodies: of each its corners (x, y) [m] in the order of its outline, and the radius [m] around
    them. A number that is not finite is no error here: `step` then answers NOT_A_NUMBER.

    Raises `DefinitionError` for a shape that is none, a negative number where none can be, and a
    share that is not above 0 and up to 1.

    >>> hf.Obstacle.disc((2, 1), 0.4, velocity=(-0.3, 0), name="buoy").count
    1
    """

    bodies: Parts
    velocity: tuple[float, float] = (0.0, 0.0)
    acceleration: float = 0.0
    velocity_error: float = 0.0
    age: float = 0.0
    share: float = 1.0
    name: str = ""
    state: tuple[float, ...] = ()
    records: bytes = field(init=False, repr=False, compare=False, default=b"")

    def __post_init__(self) -> None:
        numbers = {
            "acceleration": self.acceleration, "velocity_error": self.velocity_error,
            "age": self.age,
        }  # fmt: skip
        for name, value in numbers.items():
            if value < 0:
                raise DefinitionError(f"{name} of an obstacle is {value:g}", expected="0 or more")
        if not 0 < self.share <= 1:
            raise DefinitionError(
                f"share of an obstacle is {self.share:g}", expected="a number above 0, up to 1"
            )
        if len(self.velocity) != 2:
            raise DefinitionError(f"velocity of an obstacle is {self.velocity!r}", expected="two")
        if any(radius < 0 for _, radius in self.bodies):
            raise DefinitionError("the radius of an obstacle is below 0", expected="0 or more")
        try:
            object.__setattr__(self, "records", self._records())
        except (struct.error, OverflowError):
            raise DefinitionError(
                f"the numbers of an obstacle are {self!r}"[:80], expected="numbers"
            ) from None

    @property
    def count(self) -> int:
        """The convex bodies that it is made of."""
        return len(self.bodies)

    @property
    def radius(self) -> float:
        """The radius of its first body [m]."""
        return self.bodies[0][1]

    def _records(self) -> bytes:
        """In the layout of `execution/obstacle_pairs.py`."""
        said = (*self.velocity, self.acceleration, self.share, self.age, self.velocity_error)
        return b"".join(
            struct.pack(
                f"<{8 + 2 * len(corners)}d", len(corners), radius, *said,
                *(x for corner in corners for x in corner),
            )
            for corners, radius in self.bodies
        )  # fmt: skip

    @checked
    def aged(self, seconds: float) -> Self:
        """The same, known so much later [s]; itself, where it surely stands.

        What was known later than that is moved back along its velocity, with the age 0.

        >>> hf.Obstacle.disc((2, 1), 0.4, velocity=(-0.3, 0)).aged(0.1).age
        0.1
        """
        moves = any(self.velocity) or self.acceleration or self.velocity_error or self.state
        if not seconds or not moves:
            return self
        later = object.__new__(type(self))  # its arguments were checked when it was made
        age = self.age + seconds
        vars(later).update(vars(self), age=max(age, 0.0))
        if age < 0:
            vx, vy = self.velocity
            vars(later)["bodies"] = tuple(
                (tuple((x + vx * age, y + vy * age) for x, y in corners), radius)
                for corners, radius in self.bodies
            )
        vars(later)["records"] = later._records()
        return later

    @classmethod
    @checked
    def of_table(cls, table: Mapping[str, Any]) -> Self:
        """An obstacle of a table, as of JSON or TOML: a shape, and keywords of its motion.

            disc       [x, y, radius]
            capsule    [x, y, x, y, radius]
            ellipse    [x, y, half axis ahead, half axis across, heading]
            polygon    [[x, y], [x, y], [x, y], ...], and a radius where it has one

        None for a number is one that is not known. Raises `DefinitionError` for a table that is
        none of these.

        >>> hf.Obstacle.of_table({"disc": [2, 1, 0.4], "velocity": [-0.3, 0]}).velocity
        (-0.3, 0.0)
        """
        if not isinstance(table, Mapping):
            raise DefinitionError(f"an obstacle is {table!r}"[:80], expected=_TABLE)
        shapes = [name for name in SHAPES if name in table]
        if len(shapes) != 1:
            what = " and ".join(shapes) or "no shape"
            raise DefinitionError(f"an obstacle has {what}", expected=_TABLE)
        (shape,) = shapes
        for name in table:
            check_name(str(name), (shape, *MOTION), DefinitionError, f"unknown key '{name}'")
        motion: dict[str, Any] = {}
        for name in MOTION[:-2]:
            if name in table:
                motion[name] = _number(table[name], name)
        if "velocity" in table:
            motion["velocity"] = tuple(_row(table["velocity"], "velocity", 2))
        if "name" in table:
            if not isinstance(table["name"], str):
                raise DefinitionError(f"the name is {table['name']!r}"[:80], expected="a text")
            motion["name"] = table["name"]
        radius = motion.pop("radius", None)
        if shape == "polygon":
            corners = table[shape]
            if not isinstance(corners, Sequence) or isinstance(corners, str) or len(corners) < 3:
                raise DefinitionError(
                    f"the polygon is {corners!r}"[:80], expected="three or more corners [x, y]"
                )
            points = [_row(corner, "corner", 2) for corner in corners]
            return cls.polygon(points, 0.0 if radius is None else radius, **motion)
        if radius is not None:
            raise DefinitionError(f"radius beside a {shape}", expected=_TABLE)
        row = _row(table[shape], shape, SHAPES[shape])
        if shape == "disc":
            return cls.disc(row[:2], row[2], **motion)
        if shape == "capsule":
            return cls.capsule(row[:2], row[2:4], row[4], **motion)
        return cls.ellipse(row[:2], row[2:4], row[4], **motion)

    @classmethod
    def disc(cls, centre: Point, radius: float, **motion: Any) -> Self:
        """A disc. centre: (x, y) [m]. radius [m]. motion: the keywords of `Obstacle`.

        >>> hf.Obstacle.disc((2, 1), 0.4).bodies
        ((((2.0, 1.0),), 0.4),)
        """
        return cls((((_point(centre),), _length(radius)),), **motion)

    @classmethod
    def vehicle(
        cls, place: Point, heading: float, radius: float, more: Sequence[float] = (), **motion: Any
    ) -> Self:
        """Another vehicle, of whose kernel with ours a filter may be told (`Obstacles(pair=...)`).

        place: (x, y) [m]. heading [rad]: of a vehicle that has one. radius [m]. more: its further
        states in their order, such as its speed. motion: velocity, age and name. Where no kernel
        counts, and where its numbers are old, it is a disc with this velocity.

        >>> hf.Obstacle.vehicle((3, 0), 1.57, 0.4, velocity=(0, 0.5), name="ferry").state
        (3.0, 0.0, 1.57)
        """
        x, y = _point(place)
        state = (x, y, float(heading), *(float(value) for value in more))
        return cls.disc(place, radius, state=state, **motion)

    @classmethod
    def capsule(cls, start: Point, end: Point, radius: float, **motion: Any) -> Self:
        """The points within a radius of a line. start, end: (x, y) [m]. radius [m].

        motion: the keywords of `Obstacle`.

        >>> hf.Obstacle.capsule((0, 2), (3, 2), 0.1, name="boom").count
        1
        """
        return cls((((_point(start), _point(end)), _length(radius)),), **motion)

    @classmethod
    @checked
    def polygon(cls, corners: Sequence[Point], radius: float = 0.0, **motion: Any) -> Self:
        """A polygon. corners: (x, y) [m] in order, not closed. radius [m]: around it.

        motion: the keywords of `Obstacle`. One that is not convex becomes convex parts, each of
        which is an obstacle of its own in the count of a filter.

        >>> hf.Obstacle.polygon([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]).count
        2
        """
        try:
            points = [_point(corner) for corner in corners]
        except TypeError:
            raise DefinitionError(
                f"the corners are {corners!r}"[:80], expected="three or more (x, y)"
            ) from None
        if not all(math.isfinite(x) for point in points for x in point):
            return cls(((tuple(points), float(radius)),), **motion)
        shape = polygon_of(motion.get("name") or "obstacle", points)
        bodies = tuple((_outline(part), float(radius)) for part in convex_parts(shape))
        return cls(bodies, **motion)

    @classmethod
    @checked
    def ellipse(cls, centre: Point, axes: Point, heading: float = 0.0, **motion: Any) -> Self:
        """An ellipse, as a polygon around it that is wider by up to .9 %.

        centre: (x, y) [m]. axes: its half axes [m], along the heading and across it. heading
        [rad]. motion: the keywords of `Obstacle`.

        >>> hf.Obstacle.ellipse((4, 0), (2.5, 0.8), heading=0.3, name="barge").count
        1
        """
        (x, y), (a, b) = _point(centre), _point(axes)
        if a < 0 or b < 0:
            raise DefinitionError(f"the half axes are {a:g} and {b:g}", expected="0 or more")
        cos = sin = math.nan
        if math.isfinite(heading):
            cos, sin = math.cos(heading), math.sin(heading)
        wider = 1.0 / math.cos(math.pi / SIDES_OF_ELLIPSE)
        turns = [2.0 * math.pi * k / SIDES_OF_ELLIPSE for k in range(SIDES_OF_ELLIPSE)]
        corners = tuple(
            (
                x + wider * (a * math.cos(s) * cos - b * math.sin(s) * sin),
                y + wider * (a * math.cos(s) * sin + b * math.sin(s) * cos),
            )
            for s in turns
        )
        return cls(((corners, 0.0),), **motion)


@checked
@dataclass(frozen=True)
class Obstacles(Clearing):
    """How a `SafetyFilter` keeps clear of obstacles that are known at run time.

    most: how many convex bodies are counted with at a sample; of more the nearest, and
    `Decision.left_out` names the others. hull: the vehicle, in its own axes, ahead and to the left
    of its position [m]: a radius, the corners (x, y) of a polygon, or discs (x, y, radius).
    lead [m]: of a hull that is a disc around the position: how far ahead of it the point is that
    keeps clear, with so much more radius. A point on the axle of a vehicle with wheels can only
    brake; one ahead of it can also be turned away, if lead x rate of turn is above the speed of the
    obstacle. By default 1.25 speed over the largest rate of turn, and 0 where the inputs move the
    position both ways. speed [m/s]: of the fastest obstacle, by default that of the vehicle; a lead
    that is too short for it is refused, and `Decision.too_fast` names the obstacles that are faster
    than turning evades. clearance [m]: kept besides. position, heading: names of
    states, by default x, y and the angle psi, or the first angle. pair: the kernel of this vehicle
    and another one, in the place of the condition of each `Obstacle.vehicle`.

    Raises `DefinitionError` for a number that cannot be, and for a hull whose sides cross.

    >>> hf.Obstacles(20, hull=[(0.5, 0.3), (-0.5, 0.3), (-0.5, -0.3), (0.5, -0.3)]).pairs
    80
    """

    def __init__(
        self,
        most: int,
        hull: float | Sequence[Sequence[float]] = 0.0,
        *,
        lead: float | None = None,
        speed: float | None = None,
        clearance: float = 0.0,
        position: tuple[str, str] = ("x", "y"),
        heading: str | None = None,
        pair: Paired | None = None,
    ) -> None:
        if pair is not None and not hasattr(pair, "check_ours"):
            raise DefinitionError(f"pair is {pair!r}"[:80], expected="an hf.PairKernel")
        for name, value in (("lead", lead), ("speed", speed), ("clearance", clearance)):
            if value is not None and not (math.isfinite(value) and value >= 0):
                raise DefinitionError(f"{name} is {value:g}", expected="0 or more")
        super().__init__(
            most, _parts(hull), lead, speed, float(clearance), position, heading, pair=pair
        )


def _parts(hull: float | Sequence[Sequence[float]]) -> Parts:
    """The convex parts of a hull, with their radii."""
    if isinstance(hull, int | float):
        if not (math.isfinite(hull) and hull >= 0):
            raise DefinitionError(f"the radius of the hull is {hull:g} m", expected="0 or more")
        return ((((0.0, 0.0),), float(hull)),)
    rows = [tuple(float(x) for x in row) for row in hull]
    if rows and all(len(row) == 3 for row in rows):
        if not all(math.isfinite(x) for row in rows for x in row) or any(r < 0 for *_, r in rows):
            raise DefinitionError("a disc of the hull is none", expected="finite (x, y, radius)")
        return tuple((((x, y),), radius) for x, y, radius in rows)
    if len(rows) < 3 or any(len(row) != 2 for row in rows):
        raise DefinitionError(
            f"the hull is {hull!r}"[:80],
            expected="a radius, three or more corners (x, y), or discs (x, y, radius)",
        )
    return tuple((_outline(part), 0.0) for part in convex_parts(polygon_of("hull", rows)))


def _outline(part: shapely.Polygon) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in part.exterior.coords[:-1])


SHAPES = {"disc": 3, "capsule": 5, "ellipse": 5, "polygon": 0}
"""The shapes of `Obstacle.of_table`, and how many numbers they have."""
MOTION = ("acceleration", "velocity_error", "age", "share", "radius", "velocity", "name")
_TABLE = '{"disc": [x, y, radius], "velocity": [vx, vy]}, or a capsule, an ellipse or a polygon'


def _number(said: Any, what: str) -> float:
    """A number; NaN for None."""
    if said is None:
        return math.nan
    if isinstance(said, bool) or not isinstance(said, int | float):
        raise DefinitionError(f"{what} of an obstacle is {said!r}"[:80], expected="a number")
    return float(said)


def _row(said: Any, what: str, count: int) -> list[float]:
    """So many numbers."""
    if not isinstance(said, Sequence) or isinstance(said, str) or len(said) != count:
        raise DefinitionError(
            f"{what} of an obstacle is {said!r}"[:80], expected=f"{count} numbers"
        )
    return [_number(number, what) for number in said]


def _length(radius: Any) -> float:
    try:
        return float(radius)
    except (TypeError, ValueError, OverflowError):
        raise DefinitionError(f"a radius is {radius!r}"[:80], expected="metres") from None


def _point(point: Point) -> tuple[float, float]:
    try:
        x, y = (float(c) for c in point)
    except (TypeError, ValueError, OverflowError):
        raise DefinitionError(f"a point is {point!r}"[:80], expected="(x, y)") from None
    return x, y
