"""Corners of a leader's course: admissible turning radii, so that its followers pass too.

All robots move from their starts by their laws. At a passage with a corner, the leader moves on an
arc of radius RL until its heading is that of the next cell's field. Radii are tried with the
followers where they are then, and in a straight row at other places of the cell before the passage.

A leader and its followers are simulated many runs at once. The course is data for figures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.catalogue.laws.follow_leader import SEEN
from holdfast.maths.definitions.law import Law
from holdfast.maths.formations.turning_radii import turning_radii
from holdfast.planning.environment import Environment, Leg, Passage, shown
from holdfast.planning.fields import Fields

Flags = npt.NDArray[np.bool_]
Pose = tuple[float, float, float]

RULES = ("arc", "tangent")

FINE = 0.02
"""A step of the leader, as a share of the distance between robots."""

QUICK = 0.5
"""A step in time, as a share of the fastest time constant of a follower."""


@dataclass(frozen=True)
class Convoy:
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
        self, fields: Fields, number: int, poses: Array, curvature: Array, turning: Flags, on: Flags
    ) -> tuple[Array, Flags]:
        """Poses (run, robot, x y theta) one step later, the leader first, and who still turns.

        The leader moves on an arc of that curvature [1/m] while it is `turning`, until its heading
        is that of the leg's field, and otherwise along the field by (6.23). It is stationary where
        it is not `on`. Each follower moves by its law behind the one before it.
        """
        dt, found = self.step, np.empty_like(poses)
        place, theta = poses[:, 0, :2], poses[:, 0, 2]
        wanted = fields.headings(number, place)
        turning = turning & (curvature * wrapped(wanted - theta) > 0)
        after_arc = theta + curvature * self.speed * dt
        onwards = place + self.speed * dt * unit(np.where(turning, (theta + after_arc) / 2, theta))
        off = wrapped(theta - wanted) * math.exp(-self.gain * dt)
        along = fields.headings(number, onwards) + off
        found[:, 0, :2] = np.where(on[:, None], onwards, place)
        found[:, 0, 2] = np.where(on, np.where(turning, after_arc, along), theta)
        for k, answer in enumerate(self._answers, start=1):
            apart = poses[:, k - 1, :2] - poses[:, k, :2]
            bearing = wrapped(np.arctan2(apart[:, 1], apart[:, 0]) - poses[:, k, 2])
            seen = np.stack([np.hypot(apart[:, 0], apart[:, 1]), bearing], axis=1)
            u, w = answer.values(seen).T
            found[:, k, 2] = poses[:, k, 2] + w * dt
            found[:, k, :2] = poses[:, k, :2] + (u * dt)[:, None] * unit(
                poses[:, k, 2] + w * dt / 2
            )
        return found, turning


def unit(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def wrapped(angle: Array) -> Array:
    found: Array = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
    return found


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
    found: list[Corner] = []
    poses = np.array([starts], dtype=float)
    for number in range(len(fields.route.legs)):
        if found and (heading := found[-1].heading) is not None:
            poses[:, 0, 2] = heading
        poses = _driven(fields, number, convoy, poses, found[-1].curvature if found else 0.0)
        if fields.route.legs[number].exit is not None:
            found.append(_corner(fields, number, convoy, poses, radius))
    return tuple(found)


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
    found: Array = before + share * step
    return found


def _gone(fields: Fields, number: int, convoy: Convoy, poses: Array) -> npt.NDArray[np.bool_]:
    """The leaders that have left the cell of a leg, or are at the goal."""
    at, exit = poses[:, 0, :2], fields.route.legs[number].exit
    found: npt.NDArray[np.bool_]
    if exit is None:
        found = (
            np.linalg.norm(at - np.array(fields.route.goal), axis=1)
            < 2 * convoy.speed * convoy.step
        )
    else:
        found = (at - np.array(exit.middle)) @ np.array(exit.normal) > 0
    return found


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
        given = "the given radius" if radius is not None else "no radius"
        raise DefinitionError(
            f"{given} leads the robots around the corner from cell '{leg.cell.name}' to cell "
            f"'{following.cell.name}' at {shown(leg.exit.middle)}: with {radii[best]:.3g} m one of "
            f"them is {-worst[best]:.2g} m inside a wall"
            if np.isfinite(worst[best])
            else f"{given} leads the leader from cell '{leg.cell.name}' to cell "
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
    found = turning_radii(convoy.distance, width, depth, fields.route.environment.robot_radius)
    if found.empty and radius is None:
        raise DefinitionError(
            f"no radius leads the robots around the corner from cell '{leg.cell.name}' to cell "
            f"'{following.cell.name}' at {shown(leg.exit.middle)}: at least {found.low:.3g} m for "
            f"the follower, at most {found.high:.3g} m for the leader",
            remedy="take the rule 'arc', a smaller distance, or a wider cell",
        )
    radii = np.linspace(found.low, found.high, 10) if radius is None else np.array([radius])
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
    found = []
    gaps = np.arange(len(convoy.laws) + 1)[:, None] * convoy.distance
    for angle in leader[2] + np.linspace(-ASIDE, ASIDE, 241):
        places = leader[:2] - gaps * unit(angle)
        if all(leg.cell.contains(place) for place in places[1:]):
            found.append(np.column_stack([places, np.full(len(places), angle)]))
            found[-1][0, 2] = leader[2]
    picked = sorted({round(i) for i in np.linspace(0, len(found) - 1, PLACES)}) if found else []
    return np.array([found[i] for i in picked]).reshape(-1, len(gaps), 3)


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
    found: Array = room.reshape(len(curvatures), len(rows)).min(axis=1)
    return found


@dataclass(frozen=True)
class Course:
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
        found = []
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
            found.append(np.column_stack([places, self.fields.headings(number, places)]))
        return np.vstack(found)
