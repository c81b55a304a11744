"""Gain conditions of a law at every corner of what varies: where each of them is nearest to fail.

A condition value < limit is judged by its slack, (limit - value) / max(|value|, |limit|): above 0
it is met, and 0.1 leaves a tenth of the larger number. Windows of gains in which a follower never
loses sight of its leader are those of chapter 6.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy as sp
from scipy.optimize import brentq, minimize_scalar

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.catalogue.laws.follow_leader import FOLLOWERS, TURNS
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import DELAY, SAMPLE_TIME, symbol
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.variation import MOST_VERTICES, Varied
from holdfast.maths.expressions.numeric import evaluated

INTERIOR = 16
"""Random points inside the ranges that are tried beside the corners."""

Point = Mapping[str, float]


@dataclass(frozen=True)
class JudgedCondition:
    """A condition where it is nearest to fail.

    value, limit: its two sides there; slack: their relative distance, negative where it fails.
    corner: the varied numbers of that place; vehicle: whether they are those of the simulated
    vehicle, which its law does not know.
    """

    condition: str
    value: float
    limit: float
    slack: float
    corner: Point
    vehicle: bool
    consequence: str
    source: str

    @property
    def where(self) -> str:
        """The corner in words."""
        if not self.corner:
            return "for the simulated vehicle" if self.vehicle else "everywhere"
        shown = ", ".join(f"{n} = {v:.4g}" for n, v in self.corner.items())
        return f"at {shown}" + (" of the vehicle" if self.vehicle else "")


@dataclass(frozen=True)
class Corners:
    """Every corner of the draws, and places inside: the numbers that differ there, by symbol.

    of: the draws at each place; known: what the law knows there; real: what the vehicle has.
    """

    of: tuple[Point, ...]
    known: tuple[dict[sp.Symbol, float], ...]
    real: tuple[dict[sp.Symbol, float], ...]


def corners_of(
    varied: Varied, plant: Mapping[str, float], parameters: Mapping[str, float], seed: int
) -> Corners:
    """All 2^k corners of the k draws, then `INTERIOR` random places inside.

    plant: numbers of the simulated vehicle that its law does not know. parameters: all others.
    Raises `DefinitionError` for more than ten draws.
    """
    names, ends = [*varied.draws], [*varied.draws.values()]
    if 2 ** len(names) > MOST_VERTICES:
        raise DefinitionError(
            f"{len(names)} draws have {2 ** len(names):,} corners",
            expected=f"at most {MOST_VERTICES:,}",
            remedy="give the draws that do not matter one value",
        )
    places = [[]] if not names else _places(ends, seed)
    of, of_law, real = [], [], []
    for place in places:
        drawn = dict(zip(names, place, strict=True))
        numbers = {symbol(n): v for n, v in {**parameters, **drawn}.items()}
        for name, expression in varied.values.items():
            (numbers[symbol(name)],) = evaluated([expression], numbers)
        law_values = {symbol(n): numbers[symbol(n)] for n in varied.names if n not in varied.cases}
        of.append(drawn)
        of_law.append(law_values)
        figures = dict(zip(varied.plant, evaluated(varied.plant.values(), numbers), strict=True))
        real.append(law_values | {symbol(n): v for n, v in {**plant, **figures}.items()})
    return Corners(tuple(of), tuple(of_law), tuple(real))


def _places(ends: Sequence[tuple[float, float]], seed: int) -> list[list[float]]:
    corners = np.array(np.meshgrid(*ends, indexing="ij")).reshape(len(ends), -1).T
    low, high = np.array(ends, dtype=np.float64).T
    inside = low + np.random.default_rng(seed).random((INTERIOR, len(ends))) * (high - low)
    return [*corners.tolist(), *inside.tolist()]


def judged(
    conditions: Iterable[GainCondition],
    parameters: Mapping[str, float],
    corners: Corners,
    settings: Settings,
) -> tuple[JudgedCondition, ...]:
    """Every condition where its slack is least: as the law knows the numbers, and as they are.

    parameters: of law and vehicle, with their values. Raises `DefinitionError` for a condition
    that has no value.
    """
    timing = {
        SAMPLE_TIME: 0.0 if settings.continuous else settings.sample_time,
        DELAY: settings.delay,
    }
    fixed = {symbol(n): v for n, v in parameters.items()} | timing
    return tuple(_worst(condition, fixed, corners) for condition in conditions)


def _worst(
    condition: GainCondition, fixed: Mapping[sp.Symbol, float], corners: Corners
) -> JudgedCondition:
    involved = (condition.value + condition.limit).free_symbols
    tried: dict[tuple[float, ...], tuple[float, float]] = {}
    worst: JudgedCondition | None = None
    for vehicle, table in ((False, corners.known), (True, corners.real)):
        for drawn, numbers in zip(corners.of, table, strict=True):
            there = {s: numbers.get(s, fixed[s]) for s in involved}
            key = tuple(there.values())
            if key in tried:
                continue
            tried[key] = pair = _sides(condition, there)
            slack = relative_slack(*pair)
            if worst is None or slack < worst.slack:
                matters = bool(involved & set(numbers))
                worst = JudgedCondition(
                    _name(condition), *pair, slack, dict(drawn) if matters else {}, vehicle,
                    condition.consequence, condition.source,
                )  # fmt: skip
    assert worst is not None
    return worst


def _name(condition: GainCondition) -> str:
    """The value, and with a value that is a number the limit: 0.6402 < k2."""
    value, limit = (
        str(e.xreplace({f: sp.Float(f, 4) for f in e.atoms(sp.Float)}))
        for e in (condition.value, condition.limit)
    )
    return f"{value} < {limit}" if condition.value.is_number else value


def _sides(condition: GainCondition, numbers: Mapping[sp.Symbol, float]) -> tuple[float, float]:
    value, limit = evaluated([condition.value, condition.limit], numbers)
    if not (math.isfinite(value) and math.isfinite(limit)):
        raise DefinitionError(
            f"the condition {condition.value} < {condition.limit} has no value",
            expected="finite numbers on both sides, at every corner",
        )
    return value, limit


def relative_slack(value: float, limit: float) -> float:
    """(limit - value) over the larger of both sizes; 0 where both are 0."""
    size = max(abs(value), abs(limit))
    return (limit - value) / size if size else 0.0


SHARP = 1e-6
"""Softness [m] of a law with a sign in place of a saturation."""

SHALLOW = 1e-3
"""Start of the search over bearings, as a share of the half angle: bearing 0 has no limit."""


@dataclass(frozen=True)
class GainWindow:
    """low <= k2 <= high [1/s]; `reason` and `remedy` explain an empty window.

    nearest: the least range [m] to which a leader of that speed can push the follower.
    """

    low: float
    high: float
    nearest: float
    reason: str = ""
    remedy: str = ""

    @property
    def empty(self) -> bool:
        return bool(self.reason)

    def __contains__(self, k2: float) -> bool:
        return not self.empty and self.low <= k2 <= self.high

    def __str__(self) -> str:
        if self.empty:
            return f"no k2 keeps the leader in view: {self.reason}; {self.remedy}"
        return f"{self.low:.4g} <= k2 <= {self.high:.4g} 1/s"


@dataclass(frozen=True)
class _Pair:
    """A follower, its view and its leader."""

    k1: float
    distance: float
    range_max: float
    half_angle: float
    leader_speed: float
    softness: float
    turn: str

    @property
    def nearest(self) -> float:
        """The gap at which backing off, at the half angle, is as fast as the leader's approach."""
        slope = self.k1 + self.leader_speed / self.softness
        within = self.leader_speed / math.cos(self.half_angle) / slope
        if within <= self.softness:
            return self.distance - within
        beyond = self.leader_speed * (1 / math.cos(self.half_angle) - 1) / self.k1
        return self.distance - beyond

    def speed(self, gap: Any) -> Any:
        """uF at ranges of rd + gap."""
        return self.k1 * gap + self.leader_speed * np.clip(gap / self.softness, -1, 1)

    @property
    def low(self) -> float:
        """The side of the view: the bearing may not grow at alpha, at any range.

        Its rate is linear in 1/range between the corners of uF, so that one of these is the worst.
        """
        corners = [self.nearest, self.range_max]
        if self.leader_speed:
            corners += [self.distance - self.softness, self.distance, self.distance + self.softness]
        ranges = np.array([r for r in corners if self.nearest <= r <= self.range_max])
        pushed = self.leader_speed / ranges
        if self.turn == "bearing":
            pushed += self.speed(ranges - self.distance) * math.sin(self.half_angle) / ranges
        return float(pushed.max()) / self.half_angle

    @property
    def high(self) -> float:
        """The far end of the view: the distance ahead may not grow at Ls cos(alpha)."""

        def allowed(bearing: Any) -> Any:
            far = self.range_max * math.cos(self.half_angle) / np.cos(bearing)
            nearer = self.speed(far - self.distance)
            if self.turn == "line_of_sight":
                nearer = nearer * np.cos(bearing) ** 2
            return (nearer - self.leader_speed) / (bearing * far * np.sin(bearing))

        bearings = np.linspace(SHALLOW, 1, 400) * self.half_angle
        k = int(np.argmin(allowed(bearings)))
        inner = bearings[max(k - 1, 0)], bearings[min(k + 1, len(bearings) - 1)]
        minimum = minimize_scalar(allowed, bounds=inner, method="bounded")
        return min(float(allowed(bearings[k])), float(minimum.fun))

    @property
    def room(self) -> float:
        return self.high - self.low


@checked
def visibility_gains(
    *,
    k1: float,
    distance: float,
    range_max: float,
    half_angle: float,
    leader_speed: float = 0.0,
    softness: float = 0.05,
    turn: str = "bearing",
    robot_radius: float = 0.0,
) -> GainWindow:
    """The gains k2 of `approach_leader` and `follow_leader` that never lose sight of the leader.

    With phi the bearing, r the range, and uF as in these laws, the sides and the far end of the
    view are not crossed, whatever the leader does within |uL| <= leader_speed, when

        k2 alpha >= uF sin(alpha) / r + uLM / r                     for every r that occurs
        k2 phi r sin(phi) <= uF - uLM,   r cos(phi) = Ls cos(alpha)   for every |phi| <= alpha

    (turn = "line_of_sight": without the first term, and with uF cos^2(phi)). The least and the
    largest k2 are found over the entire boundary: the corner alone does not decide, in contrast to
    thesis (6.17), (6.18) and section 6.4.2 (errata C6). The leader's turn rate does not matter. The
    follower's own speed limits are not considered, and it must not start nearer than
    `GainWindow.nearest`.

    k1 [1/s], softness [m], turn: of the laws. distance [m]: rd. range_max [m]: Ls. half_angle
    [rad]: alpha. leader_speed [m/s]: uLM, 0 for a leader that stands. robot_radius [m]: r0.

    An empty window gives the reason and the number to change.

    Raises `DefinitionError` for invalid numbers: Ls cos(alpha) <= rd, rd < 2 r0, an angle that is
    not between 0 and pi/2.

    >>> window = hf.visibility_gains(k1=0.6, distance=1.0, range_max=2.5, half_angle=0.6)
    >>> round(window.low, 3), round(window.high, 3)
    (0.339, 1.063)
    """
    if turn not in TURNS:
        raise DefinitionError(f"turn is {turn!r}", expected=" or ".join(map(repr, TURNS)))
    numbers = {
        "k1": k1,
        "distance": distance,
        "range_max": range_max,
        "half_angle": half_angle,
        "leader_speed": leader_speed,
        "softness": softness,
        "robot_radius": robot_radius,
    }
    for name, value in numbers.items():
        least = 0.0 if name in ("leader_speed", "robot_radius") else math.ulp(0.0)
        if not isinstance(value, int | float) or not least <= value < math.inf:
            raise DefinitionError(
                f"{name} is {value!r}", expected="at least 0" if least == 0.0 else "above 0"
            )
    check_view(distance, range_max, half_angle, robot_radius)
    pair = _Pair(k1, distance, range_max, half_angle, leader_speed, softness, turn)
    if not pair.nearest >= 2 * robot_radius:
        return GainWindow(
            math.nan,
            math.nan,
            pair.nearest,
            f"the leader may come as near as {max(pair.nearest, 0.0):.3g} m",
            "take a larger distance or k1, or a slower leader",
        )
    low, high = pair.low, pair.high
    if low <= high:
        return GainWindow(low, high, pair.nearest)
    if high <= 0:
        return GainWindow(
            low,
            0.0,
            pair.nearest,
            "at the far end of the view the follower is not faster than its leader",
            _remedy(pair),
        )
    return GainWindow(
        low,
        high,
        pair.nearest,
        f"k2 has to be at least {low:.4g} 1/s at the sides of the view, and at most {high:.4g} 1/s "
        "at its far end",
        _remedy(pair),
    )


def visibility_conditions(law: Law, region: Region) -> tuple[GainCondition, ...]:
    """The window of k2 as conditions of a follower's law, for the view that `region` gives.

    Empty for other laws and regions. The bounds of the window are numbers, found for the other
    parameters of the law: a parameter that varies from run to run does not move them.
    """
    numbers = {p.name: p.value for p in (*region.parameters, *law.parameters)}
    if law.name not in FOLLOWERS or not {"range_max", "half_angle"} <= set(numbers):
        return ()
    view = {n: numbers[n] for n in ("range_max", "half_angle")}
    robot_radius = numbers.get("robot_radius", 0.0)
    sight = law.outputs["wF"].has(sp.sin)
    window = visibility_gains(
        k1=numbers["k1"], distance=numbers["distance"],
        leader_speed=numbers.get("leader_speed", 0.0) if law.name == "follow_leader" else 0.0,
        softness=numbers.get("softness", SHARP), turn=TURNS[sight], robot_radius=robot_radius,
        **view,
    )  # fmt: skip
    k2, source = symbol("k2"), "derived, hf.visibility_gains; thesis (6.17), (6.18) corrected"

    def condition(value: sp.Expr, limit: sp.Expr, consequence: str) -> GainCondition:
        return GainCondition(value, limit, consequence, source, closed=True)

    apart = condition(
        sp.Float(2 * robot_radius),
        sp.Float(window.nearest),
        "the leader may come as near as the robots touch",
    )
    if math.isnan(window.low):
        return (apart,)
    return (
        apart,
        condition(sp.Float(window.low), k2, "the leader may leave by a side of the view"),
        condition(k2, sp.Float(window.high), "the leader may leave by the far end of the view"),
    )


def check_view(distance: float, range_max: float, half_angle: float, robot_radius: float) -> None:
    """Raises `DefinitionError` for a distance too small for two robots or beyond the view."""
    if not 0 < half_angle < math.pi / 2:
        raise DefinitionError(f"half_angle is {half_angle:g} rad", expected="above 0, below pi/2")
    if not range_max * math.cos(half_angle) > distance:
        raise DefinitionError(
            f"the view ends {range_max * math.cos(half_angle):.4g} m ahead, the leader is to be at "
            f"{distance:g} m",
            expected="range_max cos(half_angle) > distance",
        )
    if distance < 2 * robot_radius:
        raise DefinitionError(
            f"at {distance:g} m two robots of radius {robot_radius:g} m touch",
            expected="distance >= 2 robot_radius",
        )


def _remedy(pair: _Pair) -> str:
    """Alternative values of k1, the range or the leader's speed, each changed by itself."""

    def room(name: str, value: float) -> float:
        changed = replace(pair, **{name: value})  # type: ignore[arg-type]
        return changed.room if changed.nearest > 0 else -math.inf

    ways: list[tuple[str, str, Callable[[float], float], str]] = [
        ("k1", "k1 of at least", lambda f: f, "1/s"),
        ("range_max", "range_max of at least", lambda f: f, "m"),
        ("leader_speed", "leader_speed of at most", lambda f: 1 / f, "m/s"),
    ]
    remedies = []
    for name, words, scale, unit in ways:
        now: float = getattr(pair, name)
        for factor in np.geomspace(1, 100, 41)[1:] if now else ():
            if room(name, now * scale(factor)) > 0:
                near, far = sorted((now, now * scale(factor)))
                limit = brentq(lambda v, name=name: room(name, v), near, far)
                remedies.append(f"{words} {limit:.4g} {unit}")
                break
    if not remedies:
        return "take a smaller distance or half angle"
    return "take " + ", or ".join(remedies)
