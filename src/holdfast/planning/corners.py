"""Corners of a leader's course: admissible turning radii, so that its followers pass too.

All robots move from their starts by their laws. At a passage with a corner, the leader moves on an
arc of radius RL until its heading is that of the next cell's field. Radii are tried with the
followers where they are then, and in a straight row at other places of the cell before the passage.

A leader and its followers are simulated many runs at once. The course is data for figures.

The leader's law along a route is thesis (6.23), with arcs around its corners. A leader that
turns in a circle of radius RL drags the follower, held at `distance` rd and pointing
at it, as a tractor does a trailer. Widths are those available to the robots' centres (the
corridor's less 2 r0). Lengths in m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array, Truths
from holdfast.execution.leaf import Evaluator
from holdfast.maths.catalogue.laws.follow_leader import SEEN
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.definitions.value import Value
from holdfast.maths.expressions.functions import length, magnitude, wrap
from holdfast.maths.formations.footprint import direction_of
from holdfast.maths.reference_fields.dipole import UNSEEN
from holdfast.planning.environment import Environment, Fields, Leg, Passage, X, Y, shown


@dataclass(frozen=True)
class TurningRadii:
    """low <= RL <= high [m], and the follower's radius at `low`."""

    low: float
    high: float
    follower: float

    @property
    def empty(self) -> bool:
        return not self.low <= self.high

    def __contains__(self, radius: float) -> bool:
        return self.low <= radius <= self.high


def critical_radius(
    distance: float, width: float, robot_radius: float, *, as_printed: bool = False
) -> float:
    """The follower's least radius around a corner that it starts beside, at the wall [m].

    The leader is in the middle of the exit of a corridor of that width and jumps to the tangent of
    the circle whose centre lies behind the follower, perpendicular to its heading. With
    s = sqrt(rd^2 - w^2/4), sb = w / (2 rd), cb = s / rd, the circle touches the rounded corner when

        RF = (s - r0)^2 / (2 ((s - r0) sb - r0 (1 - cb)))

    as_printed: (6.24), which takes the middle of the rounded corner as the contact point, and lets
    the follower into the wall if the corridor is narrow or wide (errata C6). Raises
    `DefinitionError` if no such circle exists.
    """
    _check(distance, width, robot_radius)
    s = math.sqrt(distance**2 - width**2 / 4)
    sine, cosine = width / (2 * distance), s / distance
    if as_printed:
        cut = robot_radius * (math.sqrt(0.5) - 1)
        above = (cut + s) ** 2 + cut**2
        below = (width * s + width * cut - 2 * s * cut) / distance
    else:
        above = (s - robot_radius) ** 2
        below = 2 * ((s - robot_radius) * sine - robot_radius * (1 - cosine))
    if not below > 0 or not s > robot_radius:
        raise DefinitionError(
            f"no circular arc leads a follower {distance:g} m behind around a corner of a corridor "
            f"{width:g} m wide",
            expected="a smaller robot, or a wider corridor",
        )
    return above / below


def turning_radii(
    distance: float,
    width: float,
    next_width: float,
    robot_radius: float,
    *,
    as_printed: bool = False,
) -> TurningRadii:
    """The leader's radii with the jump to the tangent of the circle: (6.25).

        sqrt(rd^2 + RF^2) <= RL,   RL - s + sqrt(RL^2 - rd^2) w / (2 rd) <= w_next

    RF is `critical_radius`; the second keeps the leader in the next corridor, `next_width` wide.
    The centre of the leader's circle is at x = -s + RF w / (2 rd). The thesis adds that last term
    to the bound instead of subtracting it (RL <= w_next + s + RF w / (2 rd)), and uses the least
    RF for sqrt(RL^2 - rd^2); `as_printed` reproduces both. Raises `DefinitionError` if no circle
    exists.
    """
    if not 0 < next_width < math.inf:
        raise DefinitionError(f"next_width is {next_width!r}", expected="above 0")
    follower = critical_radius(distance, width, robot_radius, as_printed=as_printed)
    s = math.sqrt(distance**2 - width**2 / 4)
    sine = width / (2 * distance)
    low = math.hypot(distance, follower)
    if as_printed:
        return TurningRadii(low, next_width + follower * sine + s, follower)
    far, rest = next_width + s, 1 - sine**2
    if far < distance:  # no circle keeps the leader within the next corridor
        return TurningRadii(low, -math.inf, follower)
    high = (far - math.sqrt(far**2 - rest * (far**2 + (sine * distance) ** 2))) / rest
    return TurningRadii(low, high, follower)


def follower_radius(radius: float, distance: float, bearing: float = 0.0) -> float:
    """RF = r sin(phi) + sqrt(RL^2 - r^2 cos^2(phi)): the circle of a follower behind a circle.

    It sees the leader at `distance` r and `bearing` phi, 0 for one that points at it (the thesis's
    sqrt(RL^2 - rd^2)). Raises `DefinitionError` for a circle smaller than that.
    """
    inside = radius**2 - (distance * math.cos(bearing)) ** 2
    if inside < 0:
        raise DefinitionError(
            f"a follower {distance:g} m behind a leader on a circle of {radius:g} m has no circle",
            expected=f"a radius of at least {distance * math.cos(bearing):g} m",
        )
    return distance * math.sin(bearing) + math.sqrt(inside)


def chain_radii(radius: float, distance: float, followers: int) -> tuple[float, ...]:
    """The circles of the followers of a chain, each pointing at the one before it."""
    radii = [radius]
    for _ in range(followers):
        radii.append(follower_radius(radii[-1], distance))
    return tuple(radii[1:])


def zero_off_tracking_gain(leader_speed: float, radius: float, distance: float) -> float:
    """k2 = (uL / RL) / asin(rd / (2 RL)): wF = k2 bearing keeps a follower on the leader's circle.

    Its bearing is then asin(rd / (2 RL)), which has to be within the half angle of view with room
    for what comes before. Raises `DefinitionError` for rd > 2 RL.
    """
    if not 0 < distance <= 2 * radius:
        raise DefinitionError(
            f"distance {distance:g} m on a circle of {radius:g} m",
            expected="above 0, at most twice the radius",
        )
    return leader_speed / radius / math.asin(distance / (2 * radius))


def _check(distance: float, width: float, robot_radius: float) -> None:
    for name, value in (("distance", distance), ("width", width), ("robot_radius", robot_radius)):
        if not 0 < value < math.inf:
            raise DefinitionError(f"{name} is {value!r}", expected="above 0")
    if not width < 2 * distance:
        raise DefinitionError(
            f"width {width:g} m, distance {distance:g} m: the follower may be beside the leader",
            expected="width < 2 distance",
        )


Pose = tuple[float, float, float]

RULES = ("arc", "tangent")

FINE = 0.02
"""A step of the leader, as a share of the distance between robots."""

QUICK = 0.5
"""A step in time, as a share of the fastest time constant of a follower."""


@dataclass(frozen=True, eq=False)
class Convoy(Value):
    """The robots: the leader's `speed` [m/s] and `gain` kL [1/s], and the followers.

    laws: one for each follower; distance [m]: of each behind the one before it. rule: "arc" starts
    from the leader's present heading; "tangent", the thesis's rule for right-angled corners, starts
    from the tangent to the circle on which the follower would round the corner.
    """

    speed: float
    gain: float
    laws: tuple[Law, ...]
    distance: float
    rule: str = "arc"

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise DefinitionError(f"rule is {self.rule!r}", expected=" or ".join(map(repr, RULES)))

    @property
    def length(self) -> float:
        """The length from the leader to the last robot [m] with all in their places."""
        return len(self.laws) * self.distance

    @cached_property
    def step(self) -> float:
        """A step [s] in which the leader moves little of the distance, without overshoot."""
        gaps = np.linspace(0.5, 1.5, 41) * self.distance
        angles = np.linspace(-0.5, 0.5, 41)
        steepest = 0.0
        for answer in self._answers:
            speeds = answer.values(np.stack([gaps, np.zeros(41)], axis=1))[:, 0]
            turns = answer.values(np.stack([np.full(41, self.distance), angles], axis=1))[:, 1]
            rates = (np.abs(np.diff(v) / np.diff(x)) for v, x in ((speeds, gaps), (turns, angles)))
            steepest = max(steepest, *(float(r.max()) for r in rates))
        return min(FINE * self.distance / self.speed, QUICK / max(steepest, 1e-9))

    @cached_property
    def _answers(self) -> tuple[Evaluator, ...]:
        """(u, w) of every follower by its range and bearing."""
        arguments = [q.symbol for q in SEEN]
        return tuple(
            Evaluator([law.outputs["uF"], law.outputs["wF"]], arguments, law.parameters)
            for law in self.laws
        )

    def moved(
        self,
        fields: Fields,
        number: int,
        poses: Array,
        curvature: Array,
        turning: Truths,
        on: Truths,
    ) -> tuple[Array, Truths]:
        """Poses (run, robot, x y theta) one step later, the leader first, and who still turns.

        The leader moves on an arc of that curvature [1/m] while it is `turning`, until its heading
        is that of the leg's field, and otherwise along the field by (6.23). It is stationary where
        it is not `on`. Each follower moves by its law behind the one before it.
        """
        dt, after = self.step, np.empty_like(poses)
        place, theta = poses[:, 0, :2], poses[:, 0, 2]
        wanted = fields.headings(number, place)
        turning = turning & (curvature * wrapped(wanted - theta) > 0)
        after_arc = theta + curvature * self.speed * dt
        onwards = place + self.speed * dt * unit(np.where(turning, (theta + after_arc) / 2, theta))
        off = wrapped(theta - wanted) * math.exp(-self.gain * dt)
        along = fields.headings(number, onwards) + off
        after[:, 0, :2] = np.where(on[:, None], onwards, place)
        after[:, 0, 2] = np.where(on, np.where(turning, after_arc, along), theta)
        for k, answer in enumerate(self._answers, start=1):
            apart = poses[:, k - 1, :2] - poses[:, k, :2]
            bearing = wrapped(np.arctan2(apart[:, 1], apart[:, 0]) - poses[:, k, 2])
            seen = np.stack([np.hypot(apart[:, 0], apart[:, 1]), bearing], axis=1)
            u, w = answer.values(seen).T
            after[:, k, 2] = poses[:, k, 2] + w * dt
            after[:, k, :2] = poses[:, k, :2] + (u * dt)[:, None] * unit(
                poses[:, k, 2] + w * dt / 2
            )
        return after, turning


def unit(angle: Array) -> Array:
    """The unit vectors (..., 2) of angles (...,)."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def wrapped(angle: Array) -> Array:
    """Angles (...,) within -pi and pi."""
    within: Array = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
    return within


CANDIDATES = 50
PLACES = 7
"""Numbers of radii, and of initial places of the followers, that are tried."""

ASIDE = 1.2
"""Angles [rad] of the rows of followers from the direction the leader comes from."""

TOUCH = 1e-3
"""A smaller overlap [m] with a wall is ignored: initial places may touch one."""

ASTRAY = 10
"""A leader that has gone around its cell this many times counts as unable to leave it."""

SQUARE = 0.05
"""Cosines below this are those of right angles."""

STRAIGHT = math.radians(5)
"""A smaller change of heading is not a corner."""


@dataclass(frozen=True)
class Corner:
    """Radii low <= RL <= high [m] take all robots through; side: +1 left, -1 right, 0 straight.

    radius: the middle one of those tried.
    heading: the leader turns to it on the spot before the arc, with the rule "tangent".
    """

    side: int
    low: float
    high: float
    radius: float
    heading: float | None = None

    @property
    def curvature(self) -> float:
        return self.side / self.radius


def route_corners(
    fields: Fields, convoy: Convoy, starts: Sequence[Pose], *, radius: float | None = None
) -> tuple[Corner, ...]:
    """The corners from leg to leg for robots that start there; `radius` [m] is taken if given.

    Raises `DefinitionError`, naming the corner, if no radius (or not the given one) takes all
    robots through without touching a wall; and if a robot touches a wall on its way.
    """
    corners: list[Corner] = []
    poses = np.array([starts], dtype=float)
    for number in range(len(fields.route.legs)):
        if corners and (heading := corners[-1].heading) is not None:
            poses[:, 0, 2] = heading
        poses = _driven(fields, number, convoy, poses, corners[-1].curvature if corners else 0.0)
        if fields.route.legs[number].exit is not None:
            corners.append(_corner(fields, number, convoy, poses, radius))
    return tuple(corners)


def _driven(fields: Fields, number: int, convoy: Convoy, poses: Array, curvature: float) -> Array:
    """The robots' poses when the leader leaves the cell, or when all are at the goal."""
    route = fields.route
    leg = route.legs[number]
    stride = convoy.speed * convoy.step
    most = ASTRAY * (leg.cell.shape.length + convoy.length) / stride
    rest = convoy.length / stride  # after the leader is at the goal
    curve, turning, on = np.array([curvature]), np.array([True]), np.array([True])
    for _ in range(math.ceil(most)):
        before = poses
        poses, turning = convoy.moved(fields, number, poses, curve, turning, on)
        room = route.environment.room(poses[0, :, :2])
        if room.min() < -TOUCH:
            k = int(np.argmin(room))
            who = f"follower {k}" if k else "the leader"
            raise DefinitionError(
                f"{who} goes into a wall at {shown(poses[0, k, :2])}, with the leader in cell "
                f"'{leg.cell.name}'",
                remedy="start it elsewhere, or take other gains or a smaller distance",
            )
        if on[0] and _gone(fields, number, convoy, poses)[0]:
            if leg.exit is not None:
                return _at_passage(leg.exit, before, poses)
            on[0] = False
        rest -= not on[0]
        if rest < 0:
            return poses
    raise DefinitionError(
        f"the leader does not get out of cell '{leg.cell.name}'",
        remedy="let it start with its heading along the field, or raise its gain",
    )


def _at_passage(exit: Passage, before: Array, after: Array) -> Array:
    """The leader's pose in the passage, between two steps."""
    far = [
        float((p[0, 0, :2] - np.array(exit.middle)) @ np.array(exit.normal))
        for p in (before, after)
    ]
    share = far[0] / (far[0] - far[1])
    step = after - before
    step[..., 2] = wrapped(step[..., 2])
    pose: Array = before + share * step
    return pose


def _gone(fields: Fields, number: int, convoy: Convoy, poses: Array) -> Truths:
    """The leaders that have left the cell of a leg, or are at the goal."""
    at, exit = poses[:, 0, :2], fields.route.legs[number].exit
    gone: Truths
    if exit is None:
        gone = (
            np.linalg.norm(at - np.array(fields.route.goal), axis=1)
            < 2 * convoy.speed * convoy.step
        )
    else:
        gone = (at - np.array(exit.middle)) @ np.array(exit.normal) > 0
    return gone


def _corner(
    fields: Fields, number: int, convoy: Convoy, poses: Array, radius: float | None
) -> Corner:
    leg, following = fields.route.legs[number : number + 2]
    assert leg.exit is not None
    side = _side(leg.exit, fields, number + 1)
    if side == 0:
        return Corner(0, 0.0, math.inf, math.inf)
    ahead = np.array(following.cell.corners) - np.array(leg.exit.middle)
    depth = float((ahead @ np.array(leg.exit.normal)).max())
    if convoy.rule == "tangent":
        radii, headings = _tangents(fields, number, convoy, side, depth, radius)
    else:
        radii = np.linspace(1 / CANDIDATES, 1.0, CANDIDATES) * depth
        radii = radii if radius is None else np.array([radius])
        headings = np.full(len(radii), poses[0, 0, 2])
    rows = np.concatenate([poses, _rows(leg, poses[0, 0], convoy)])
    worst = _clearance(fields, number + 1, side / radii, convoy, rows, headings)
    good = np.flatnonzero(worst >= -TOUCH)
    if not good.size:
        best = int(np.argmax(worst))
        which = "the given radius" if radius is not None else "no radius"
        raise DefinitionError(
            f"{which} leads the robots around the corner from cell '{leg.cell.name}' to cell "
            f"'{following.cell.name}' at {shown(leg.exit.middle)}: with {radii[best]:.3g} m one of "
            f"them is {-worst[best]:.2g} m inside a wall"
            if np.isfinite(worst[best])
            else f"{which} leads the leader from cell '{leg.cell.name}' to cell "
            f"'{following.cell.name}' at {shown(leg.exit.middle)}: its arc does not end",
            remedy="take a smaller distance, fewer followers or other gains, or widen the cells",
        )
    ends = np.flatnonzero(np.diff(good) > 1)
    good = good[: ends[0] + 1] if ends.size else good  # the smallest contiguous ones
    best = good[len(good) // 2]
    heading = float(headings[best]) if convoy.rule == "tangent" else None
    return Corner(side, float(radii[good[0]]), float(radii[good[-1]]), float(radii[best]), heading)


def _tangents(
    fields: Fields, number: int, convoy: Convoy, side: int, depth: float, radius: float | None
) -> tuple[Array, Array]:
    """Radii of (6.25), corrected, and the headings of the tangents at the exit."""
    leg, following = fields.route.legs[number : number + 2]
    assert leg.exit is not None
    normal = np.array(leg.exit.normal)
    beyond = normal if following.exit is None else np.array(following.exit.normal)
    if following.exit is not None and abs(float(normal @ beyond)) > SQUARE:
        raise DefinitionError(
            f"from cell '{leg.cell.name}' to cell '{following.cell.name}': the corner is not a "
            "right angle",
            remedy="take the rule 'arc'",
        )
    width = leg.exit.width
    interval = turning_radii(convoy.distance, width, depth, fields.route.environment.robot_radius)
    if interval.empty and radius is None:
        raise DefinitionError(
            f"no radius leads the robots around the corner from cell '{leg.cell.name}' to cell "
            f"'{following.cell.name}' at {shown(leg.exit.middle)}: at least {interval.low:.3g} m "
            f"for the follower, at most {interval.high:.3g} m for the leader",
            remedy="take the rule 'arc', a smaller distance, or a wider cell",
        )
    radii = np.linspace(interval.low, interval.high, 10) if radius is None else np.array([radius])
    if radii.min() < convoy.distance:
        raise DefinitionError(
            f"radius {radii.min():g} m with the rule 'tangent'", expected="above the distance"
        )
    behind = np.sqrt(radii**2 - convoy.distance**2)
    sine = width / (2 * convoy.distance)
    cosine = math.sqrt(1 - sine**2)
    inwards = np.arctan2(convoy.distance * cosine - behind * sine, width / 2 + behind * cosine)
    return radii, math.atan2(normal[1], normal[0]) + side * inwards


def _side(exit: Passage, fields: Fields, following: int) -> int:
    heading = math.atan2(exit.normal[1], exit.normal[0])
    wanted = float(fields.headings(following, np.array([exit.middle]))[0])
    turn = math.remainder(wanted - heading, math.tau)
    return 0 if abs(turn) < STRAIGHT else (1 if turn > 0 else -1)


def _rows(leg: Leg, leader: Array, convoy: Convoy) -> Array:
    """Poses (row, robot, x y theta) with all followers in a line to the leader, in its cell."""
    rows = []
    gaps = np.arange(len(convoy.laws) + 1)[:, None] * convoy.distance
    for angle in leader[2] + np.linspace(-ASIDE, ASIDE, 241):
        places = leader[:2] - gaps * unit(angle)
        if all(leg.cell.contains(place) for place in places[1:]):
            rows.append(np.column_stack([places, np.full(len(places), angle)]))
            rows[-1][0, 2] = leader[2]
    picked = sorted({round(i) for i in np.linspace(0, len(rows) - 1, PLACES)}) if rows else []
    return np.array([rows[i] for i in picked]).reshape(-1, len(gaps), 3)


def _clearance(
    fields: Fields, number: int, curvatures: Array, convoy: Convoy, rows: Array, headings: Array
) -> Array:
    """The least clearance of any robot to a wall, by curvature.

    Negative if it is in the wall; minus infinity if the arc does not end. The leader enters
    the leg `number`, from the heading of its curvature.
    """
    environment = fields.route.environment
    poses = np.tile(rows, (len(curvatures), 1, 1))
    poses[:, 0, 2] = np.repeat(headings, len(rows))
    curvature = np.repeat(curvatures, len(rows))
    turning, on = np.ones(len(poses), dtype=bool), np.ones(len(poses), dtype=bool)
    room = np.full(len(poses), np.inf)
    nearest = np.full(poses.shape[:2], -np.inf)  # at least so far from a wall is each robot
    length = convoy.length + convoy.distance + math.pi / 2 / float(np.abs(curvatures).min())
    for _ in range(math.ceil(length / convoy.speed / convoy.step)):
        before = poses
        poses, turning = convoy.moved(fields, number, poses, curvature, turning, on)
        on &= ~_gone(fields, number, convoy, poses)  # beyond this corner
        nearest -= np.linalg.norm(poses[..., :2] - before[..., :2], axis=-1)
        near = nearest < room[:, None]  # others cannot be the least
        nearest[near] = environment.room(poses[near, :2])
        room = np.minimum(room, nearest.min(axis=1))
    room[turning] = -np.inf
    least: Array = room.reshape(len(curvatures), len(rows)).min(axis=1)
    return least


@dataclass(frozen=True, eq=False)
class Course(Value):
    """The result of planning: the fields of the route, and the arcs around its corners."""

    fields: Fields
    corners: tuple[Corner, ...]
    followers: int

    @property
    def environment(self) -> Environment:
        return self.fields.route.environment

    @property
    def goal(self) -> tuple[float, float]:
        return self.fields.route.goal

    def arrows(self, apart: float = 0.4) -> Array:
        """(x, y, direction) of the leader's fields at points `apart` [m] from each other."""
        by_leg = []
        for number, leg in enumerate(self.fields.route.legs):
            corners = np.array(leg.cell.corners)
            low, high = corners.min(axis=0), corners.max(axis=0)
            counts = np.maximum(np.ceil((high - low) / apart), 1).astype(int)
            x, y = (
                a + (b - a) * (np.arange(n) + 0.5) / n
                for a, b, n in zip(low, high, counts, strict=True)
            )
            places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            places = places[[leg.cell.contains(place) for place in places]]
            by_leg.append(np.column_stack([places, self.fields.headings(number, places)]))
        return np.vstack(by_leg)


THETA = symbol("thetaL")
POSE = (Quantity("xL", "m"), Quantity("yL", "m"), Quantity("thetaL", "rad", angle=True))

STOPPED = "stop"

ALIGNED = sp.Float(0.01)
"""Headings [rad] closer than this count as equal."""


def lead_along(
    fields: Fields,
    corners: Sequence[Corner],
    *,
    speed: float,
    gain: float = 2.0,
    goal_radius: float = 0.05,
) -> Switching:
    """uL = speed, wL = -kL wrap(thetaL - phi) + d/dt phi along the field of each cell, (6.23).

    From the exit of a cell the leader moves on an arc of the corner's radius, wL = +-speed / RL,
    until its heading is that of the next cell's field; at the goal it stops. A corner with a
    heading starts with a turn on the spot. speed [m/s], kL = `gain` [1/s], lengths in m.
    """
    constants = (
        Parameter("cruise", "m/s", "speed of the leader", value=speed, above=0.0),
        Parameter("kL", "1/s", "heading gain of the leader", value=gain, above=0.0),
        Parameter("goal_radius", "m", "stopping distance", value=goal_radius, above=0.0),
        *fields.parameters,
    )
    turns = tuple(
        Parameter(f"turn{n}", "1/m", "curvature of the arc, left positive", value=c.side / c.radius)
        for n, c in enumerate(corners, start=1)
        if c.side
    )
    turns += tuple(
        Parameter(f"turn{n}_heading", "rad", "heading at the beginning of the arc", value=c.heading)
        for n, c in enumerate(corners, start=1)
        if c.heading is not None
    )

    def law(name: str, speed: sp.Expr, turn: sp.Expr) -> Law:
        return Law(name, POSE, {"uL": speed, "wL": turn}, parameters=(*constants, *turns))

    cruise = symbol("cruise")
    modes: dict[str, Law] = {}
    transitions = []
    for number, (leg, field) in enumerate(zip(fields.route.legs, fields.fields, strict=True), 1):
        here = f"cell_{number}"
        phi = direction_of(field)
        along = phi.diff(X) * sp.cos(THETA) + phi.diff(Y) * sp.sin(THETA)
        heading = -symbol("kL") * wrap(THETA - phi) + cruise * along
        modes[here] = law(here, cruise, heading)
        if leg.exit is None:
            gone = length(X - symbol("goal_x"), Y - symbol("goal_y"), UNSEEN)
            transitions.append(Transition(here, STOPPED, symbol("goal_radius") - gone))
            break
        x, y, direction = (symbol(f"exit{number}_{n}") for n in ("x", "y", "direction"))
        crossed = (X - x) * sp.cos(direction) + (Y - y) * sp.sin(direction)
        onwards = f"cell_{number + 1}"
        if not corners[number - 1].side:
            transitions.append(Transition(here, onwards, crossed))
            continue
        arc, curve = f"turn_{number}", symbol(f"turn{number}")
        if corners[number - 1].heading is not None:
            spot, off = f"align_{number}", wrap(THETA - symbol(f"turn{number}_heading"))
            modes[spot] = law(spot, sp.S.Zero, -symbol("kL") * off)
            transitions.append(Transition(here, spot, crossed))
            transitions.append(Transition(spot, arc, ALIGNED - magnitude(off)))
        else:
            transitions.append(Transition(here, arc, crossed))
        modes[arc] = law(arc, cruise, cruise * curve)
        past = wrap(THETA - direction_of(fields.fields[number])) * curve
        transitions.append(Transition(arc, onwards, past))
    modes[STOPPED] = law(STOPPED, sp.S.Zero, sp.S.Zero)
    return Switching(
        name="lead_along",
        modes=modes,
        transitions=tuple(transitions),
        description="along the fields of the cells of a route, in arcs around its corners",
        source="thesis (6.23), with the zero of the field beyond the exit and arcs without a jump",
    )
