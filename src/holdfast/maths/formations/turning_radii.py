"""Turning radii of a leader around a corner, and the path of its follower.

A leader that turns in a circle of radius RL drags the follower, held at `distance` rd and pointing
at it, as a tractor does a trailer. Widths are those available to the robots' centres (the
corridor's less 2 r0). Lengths in m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from holdfast.errors import DefinitionError


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
    found = [radius]
    for _ in range(followers):
        found.append(follower_radius(found[-1], distance))
    return tuple(found[1:])


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
