"""How sharply a leader may turn from one cell into the next, so that those behind it pass too.

The leader comes to the passage as its law brings it there from its start, then goes in an arc of
radius RL until it heads as the field of the next cell does there, then along the field. Each
follower goes by its law behind the one before it; its place at first is anywhere in the cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import shapely

from holdfast.errors import DefinitionError
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.law import Law
from holdfast.maths.laws.follow_leader import SEEN
from holdfast.maths.turning import turning_radii
from holdfast.planning.environment import CLOSE, Passage, shown
from holdfast.planning.fields import Fields
from holdfast.planning.route import Leg, Route

Array = npt.NDArray[np.float64]
Pose = tuple[float, float, float]

CANDIDATES = 50
PLACES = 7
"""How many radii, and how many places of the followers at first, are tried."""

STEP = 0.04
MOST_STEPS = 100_000
"""Seconds of what is looked at, and how often."""

TOUCH = 1e-3
"""Into a wall by less [m] is not: places at first may be beside one."""

NEAR_GOAL = 0.1

SQUARE = 0.05
"""Cosines below this are those of right angles."""

STRAIGHT = math.radians(5)
"""Below this change of heading there is no corner."""


RULES = ("arc", "tangent")


@dataclass(frozen=True)
class Corner:
    """low <= RL <= high [m] take all robots through; side +1 turns left, -1 right, 0 goes straight.

    radius: the one of them that leaves the most room to robots that come along the middle.
    heading: what the leader turns to on the spot before the arc, with the rule "tangent".
    """

    side: int
    low: float
    high: float
    radius: float
    heading: float | None = None


@dataclass(frozen=True)
class Convoy:
    """Who is to pass: the leader's `speed` [m/s] and `gain` kL [1/s], and the followers.

    laws: one for each; distance [m]: of each behind the one before it. rule: "arc", from the
    heading that the leader has, or "tangent", that of the thesis for corners of right angles: from
    the tangent to the circle about whose centre the follower would go round the corner.
    """

    speed: float
    gain: float
    laws: tuple[Law, ...]
    distance: float
    rule: str = "arc"

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise DefinitionError(f"rule is {self.rule!r}", expected=" or ".join(map(repr, RULES)))

    @cached_property
    def answers(self) -> tuple[Evaluator, ...]:
        """(u, w) of every follower by its range and bearing."""
        arguments = [q.symbol for q in SEEN]
        return tuple(
            Evaluator([law.outputs["uF"], law.outputs["wF"]], arguments, law.parameters)
            for law in self.laws
        )


def route_corners(
    fields: Fields, convoy: Convoy, start: Pose, *, radius: float | None = None
) -> tuple[Corner, ...]:
    """The corners from leg to leg for a leader that starts there; `radius` [m] is taken if given.

    Raises `DefinitionError`, naming the corner, where no radius takes all robots through without
    touching a wall, or the given one does not.
    """
    found = []
    pose = start
    for number in range(len(fields.route.legs) - 1):
        pose = _driven(fields, number, convoy, pose)
        found.append(_corner(fields, number, convoy, pose, radius))
        pose = _turned(fields, number, convoy, pose, found[-1])
    return tuple(found)


def _driven(fields: Fields, number: int, convoy: Convoy, pose: Pose) -> Pose:
    """Where the leader leaves a cell, by (6.23) from a pose in it."""
    exit = fields.route.legs[number].exit
    assert exit is not None
    place, theta = np.array([pose[:2]]), pose[2]
    wanted = float(fields.headings(number, place)[0])
    for _ in range(MOST_STEPS):
        if float((place[0] - np.array(exit.middle)) @ np.array(exit.normal)) >= 0:
            return float(place[0, 0]), float(place[0, 1]), theta
        place = place + convoy.speed * STEP * _unit(np.array([theta]))
        before, wanted = wanted, float(fields.headings(number, place)[0])
        off = math.remainder(theta - before, math.tau)
        theta += math.remainder(wanted - before, math.tau) - convoy.gain * STEP * off
    raise DefinitionError(
        f"the leader does not get out of cell '{fields.route.legs[number].cell.name}'",
        remedy="let it start with its heading along the field, or raise its gain",
    )


def _turned(fields: Fields, number: int, convoy: Convoy, pose: Pose, taken: Corner) -> Pose:
    """Where the arc of a corner ends."""
    x, y, theta = pose
    theta = theta if taken.heading is None else taken.heading
    for _ in range(MOST_STEPS if taken.side else 0):
        wanted = float(fields.headings(number + 1, np.array([[x, y]]))[0])
        if taken.side * math.remainder(wanted - theta, math.tau) <= 0:
            break
        x, y = x + convoy.speed * STEP * math.cos(theta), y + convoy.speed * STEP * math.sin(theta)
        theta += taken.side * convoy.speed * STEP / taken.radius
    return x, y, theta


def _corner(
    fields: Fields, number: int, convoy: Convoy, pose: Pose, radius: float | None
) -> Corner:
    route = fields.route
    leg, following = route.legs[number], route.legs[number + 1]
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
        headings = np.full(len(radii), pose[2])
    room = _clearance(fields, number, side, radii, convoy, pose, headings)
    worst = room.min(axis=1)
    good = np.flatnonzero(worst >= -TOUCH)
    if not good.size:
        best = int(np.argmax(worst))
        given = "the given radius" if radius is not None else "no radius"
        raise DefinitionError(
            f"{given} takes the robots around the corner from cell '{leg.cell.name}' to cell "
            f"'{following.cell.name}' at {shown(leg.exit.middle)}: on {radii[best]:.3g} m one of "
            f"them goes {-worst[best]:.2g} m into a wall"
            if np.isfinite(worst[best])
            else f"{given} takes the leader from cell '{leg.cell.name}' to cell "
            f"'{following.cell.name}' at {shown(leg.exit.middle)}: its arc does not end",
            remedy="take a smaller distance, fewer followers or other gains, or widen the cells",
        )
    ends = np.flatnonzero(np.diff(good) > 1)
    good = good[: ends[0] + 1] if ends.size else good  # the smallest ones that belong together
    along_the_middle = room[good, room.shape[1] // 2]
    best = good[int(np.argmax(along_the_middle))]
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
            f"from cell '{leg.cell.name}' to cell '{following.cell.name}' it is no right angle",
            remedy="take the rule 'arc'",
        )
    width = leg.exit.width
    found = turning_radii(convoy.distance, width, depth, fields.route.environment.robot_radius)
    if found.empty and radius is None:
        raise DefinitionError(
            f"no radius takes the robots around the corner from cell '{leg.cell.name}' to cell "
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


def _clearance(
    fields: Fields,
    number: int,
    side: int,
    radii: Array,
    convoy: Convoy,
    pose: Pose,
    headings: Array,
) -> Array:
    """The least distance of any robot to where it would touch a wall, (radius, row).

    Negative where it is in the wall. Rows are places of the followers at first: in a line from the
    leader to wherever in the cell, from one side to the other.
    """
    route = fields.route
    leg, following = route.legs[number], route.legs[number + 1]
    assert leg.exit is not None
    rows, facing = _rows(leg, pose, convoy.distance, len(convoy.laws))
    count = len(radii) * len(rows)
    curve = np.repeat(side / radii, len(rows)) * convoy.speed
    at = np.tile(np.array(pose[:2]), (count, 1))
    theta = np.repeat(headings, len(rows))
    chain = np.tile(rows, (len(radii), 1, 1))  # (run, follower, 2)
    headed = np.tile(facing[:, None], (len(radii), len(convoy.laws)))
    turning, gone = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    seen = []
    length = (len(convoy.laws) + 1) * convoy.distance + math.pi / 2 * float(radii.max())
    for _ in range(math.ceil(length / convoy.speed / STEP)):
        wanted = fields.headings(number + 1, at)
        turning &= side * _wrapped(wanted - theta) > 0
        theta = np.where(turning, theta + curve * STEP, wanted)
        gone |= _gone(following, route.goal, at)  # what it does then is not of this corner
        at = at + np.where(gone, 0.0, convoy.speed * STEP)[:, None] * _unit(theta)
        before = at
        for k, answer in enumerate(convoy.answers):
            apart = before - chain[:, k]
            far = np.linalg.norm(apart, axis=1)
            bearing = _wrapped(np.arctan2(apart[:, 1], apart[:, 0]) - headed[:, k])
            speed, turn = answer.values(np.stack([far, bearing], axis=1)).T
            before = chain[:, k].copy()
            chain[:, k] += (speed * STEP)[:, None] * _unit(headed[:, k])
            headed[:, k] += turn * STEP
        seen.append(np.concatenate([at[:, None], chain], axis=1))
    room = _room(route, np.array(seen)).min(axis=(0, 2))
    room[turning] = -np.inf  # an arc that does not end
    return room.reshape(len(radii), len(rows))


def _room(route: Route, places: Array) -> Array:
    """How far places of shape (..., 2) are from where a robot touches a wall."""
    cells = [c.shape.buffer(CLOSE, join_style="mitre") for c in route.environment.inner]
    inner = shapely.union_all(cells)
    border = inner.boundary
    shapely.prepare(inner)
    shapely.prepare(border)
    x, y = places[..., 0], places[..., 1]
    gap = shapely.distance(shapely.points(x, y), border)
    return np.where(shapely.contains_xy(inner, x, y), gap, -gap)


def _unit(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _wrapped(angle: Array) -> Array:
    return np.angle(np.exp(1j * angle))


def _gone(leg: Leg, goal: tuple[float, float], at: Array) -> npt.NDArray[np.bool_]:
    """Which leaders have left the next cell, or are at the goal."""
    if leg.exit is None:
        near: npt.NDArray[np.bool_] = np.linalg.norm(at - np.array(goal), axis=1) < NEAR_GOAL
        return near
    out: npt.NDArray[np.bool_] = (at - np.array(leg.exit.middle)) @ np.array(leg.exit.normal) > 0
    return out


def _rows(leg: Leg, pose: Pose, distance: float, followers: int) -> tuple[Array, Array]:
    """Places (row, follower, 2) in a line behind the leader in the passage, and the headings."""
    found, headings = [], []
    for angle in pose[2] + np.linspace(-1.2, 1.2, 241):
        row = np.array(pose[:2]) - np.outer(np.arange(1, followers + 1), _unit(angle)) * distance
        if all(leg.cell.contains(place) for place in row):
            found.append(row)
            headings.append(angle)
    if not found:
        raise DefinitionError(
            f"cell '{leg.cell.name}' is too short for {followers} robots, {distance:g} m each "
            "behind the one before"
        )
    picked = np.unique(np.linspace(0, len(found) - 1, PLACES).astype(int))
    return np.array([found[i] for i in picked]), np.array([headings[i] for i in picked])
