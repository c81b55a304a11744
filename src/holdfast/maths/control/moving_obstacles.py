"""The condition of an obstacle that moves: one function of numbers that are handed over.

A disc on the vehicle, at a lever l in the axes of the body, and a disc in the plane keep apart,

    c = R - |P - b| <= 0,    P = (x, y) + rotation(psi) l,    db/dt = v,  |dv/dt| <= a

R is the sum of their radii. What a filter asks of c is derived from the rates of the vehicle as for
every other constraint (`safety_filter.py`), with b and v as states that the inputs do not reach.
The numbers of a pair of discs are symbols in it, so that a filter has one condition, and as many
pairs of discs as it is handed. Where two bodies have corners and sides, the pairs of discs that
touch like them, a side as a disc whose radius is large, come from
`execution/obstacle_pairs.py`.

What the obstacle may do is counted with its worst: over a hold T its velocity changes by up to a T,
by half of it in the mean, and a velocity that is known to w may be another by w,

    n . u >= ... + a T / 2 + w            the condition bounds dc/dt
    n . u >= ... + a + (k1 + k2) w        the condition bounds d2c/dt2

Of another vehicle whose kernel is at hand (`analysis/online/pair_kernel.py`) a row of the inputs
itself may be handed over, in the place of such a pair.

share: the part of a condition that this vehicle meets where the obstacle is another one that
filters too. With a half each the sum of both is the whole condition, while each answers for the
derivative of its own motion. A vehicle whose own derivative is not known, in an unknown current or
with uncertain parameters, or whose later inputs act, meets the whole condition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.control.parameter_box import ParameterBox
from holdfast.maths.control.safety_filter import (
    K1,
    K2,
    Asked,
    asked_of,
    check_held,
    conditions,
    input_rows,
    input_scales,
    over_time,
    usual_gains,
)
from holdfast.maths.control.velocity_tracking import believed_disturbances
from holdfast.maths.definitions.law import FoundPairs, Law, Repeated, Safeguard
from holdfast.maths.definitions.quantity import SAMPLE_TIME, Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import select
from holdfast.maths.expressions.random_points import full_rank, is_zero
from holdfast.maths.expressions.traversal import exchanged

PAIR = {
    "here": "1",
    "ahead": "m",
    "left": "m",
    "x": "m",
    "y": "m",
    "reach": "m",
    "vx": "m/s",
    "vy": "m/s",
    "change": "m/s^2",
    "unsure": "m/s",
    "share": "1",
}
"""The numbers of a pair of discs, and their units: whether there is one; the lever; the centre b;
R; its velocity; a; w; share."""

ROW_ITSELF = 2.0
"""The first number of what is no pair of discs, but a normal and an offset of the inputs."""

NUMBERS = {name: symbol(f"pair_{name}") for name in PAIR}


@dataclass(frozen=True)
class PairConditions:
    """What a filter asks of one pair: rows n . u <= b of the inputs, as functions of its numbers.

    orders: of the derivative that each row bounds.
    """

    rows: tuple[tuple[tuple[sp.Expr, ...], sp.Expr], ...]
    orders: tuple[int, ...]

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """The normal and the offset of each row in turn."""
        return tuple(e for normal, offset in self.rows for e in (*normal, offset))


def pair_conditions(
    system: System,
    position: tuple[str, str],
    heading: str,
    *,
    worst: Sequence[str],
    disturbance_measured: bool,
    box: ParameterBox,
    rows_handed: bool = False,
) -> PairConditions:
    """The conditions of a pair, with the gains `kappa1` and `kappa2`.

    rows_handed: whether a row itself may be handed over in the place of a pair. position, heading:
    the names of the states; an empty heading is that of a point, whose lever is 0. worst,
    disturbance_measured, box: see `asked_of`, which raises `DefinitionError`.
    """
    n, place = NUMBERS, _place(system, position, heading)
    gap = [p - n[name] for p, name in zip(place, ("x", "y"), strict=True)]
    level = n["reach"] - sp.sqrt(gap[0] ** 2 + gap[1] ** 2)
    moving = {"x": n["vx"], "y": n["vy"]}
    others = tuple(Quantity(n[name].name, PAIR[name]) for name in PAIR)
    beside = replace(
        system,
        states=(*system.states, *others),
        rates={
            **system.rates,
            **{n[name].name: moving.get(name, sp.S.Zero) for name in PAIR},
        },
        measurements=(), pfaffian=(), flat_output=None,
    )  # fmt: skip
    apart = Region(
        "apart", beside.states, (Inequality("obstacle", level, "m", "clearance of an obstacle"),)
    )
    (asked,) = asked_of(beside, apart, (), worst, disturbance_measured, box)
    ours = None
    if asked.later is None and not box.uncertain and not worst:
        ours = _part_of_ours(system, asked, place)
    rows = tuple(
        (normal, _shared(asked, offset, order, ours)) for normal, offset, order in asked.rows
    )
    if rows_handed:
        rows = tuple(_or_itself(normal, offset) for normal, offset in rows)
    return PairConditions(rows, asked.orders)


def _or_itself(normal: Sequence[sp.Expr], offset: sp.Expr) -> tuple[tuple[sp.Expr, ...], sp.Expr]:
    """The row of a pair, or the one that is handed over in its place."""
    here, *numbers = NUMBERS.values()
    if len(normal) >= len(numbers):
        raise DefinitionError(
            f"{len(normal)} inputs, and the kernel of two vehicles",
            expected=f"at most {len(numbers) - 1} inputs",
        )
    itself = here - sp.Float((1.0 + ROW_ITSELF) / 2)
    chosen = [select(itself, a, b) for a, b in zip(numbers, (*normal, offset), strict=False)]
    return tuple(chosen[:-1]), chosen[-1]


def both_ways(
    system: System, position: tuple[str, str], heading: str, lever: tuple[float, float]
) -> bool:
    """Whether the inputs move a point of the vehicle in two directions.

    By the first derivative that an input reaches; an input that reaches a later one is used by a
    condition of its own (`barrier_conditions.kept_possible`).
    """
    inputs = [q.symbol for q in system.inputs]
    at = {NUMBERS["ahead"]: sp.Float(lever[0]), NUMBERS["left"]: sp.Float(lever[1])}
    rates = [system.derivative(p) for p in _place(system, position, heading)]
    slopes = [[r.diff(u) for u in inputs] for r in rates]
    acts = [not all(is_zero(row[i]) for row in slopes) for i in range(len(inputs))]
    if not any(acts):
        rates = [system.derivative(r) for r in rates]
        slopes = [[r.diff(u) for u in inputs] for r in rates]
    here = [[e.xreplace(at) for e in row] for row in slopes]
    if any(acts) and not all(acts):  # later inputs turn what the first ones do
        late = {u for u, at_once in zip(inputs, acts, strict=True) if not at_once}
        return any(system.derivative(e).free_symbols & late for row in here for e in row)
    return full_rank(sp.ImmutableMatrix(here))


def _pose(
    system: System, position: tuple[str, str], heading: str
) -> tuple[sp.Expr, sp.Expr, sp.Expr, sp.Expr]:
    """x, y, and the cosine and the sine of the heading."""
    states = {q.name: q.symbol for q in system.states}
    angle = states[heading] if heading else sp.S.Zero
    return states[position[0]], states[position[1]], sp.cos(angle), sp.sin(angle)


def _place(system: System, position: tuple[str, str], heading: str) -> list[sp.Expr]:
    """The centre of the disc on the vehicle."""
    states = {q.name: q for q in system.states}
    x, y = (states[name].symbol for name in position)
    if not heading:
        return [x, y]
    psi, n = states[heading].symbol, NUMBERS
    cos, sin = sp.cos(psi), sp.sin(psi)
    return [x + n["ahead"] * cos - n["left"] * sin, y + n["ahead"] * sin + n["left"] * cos]


def _part_of_ours(system: System, asked: Asked, place: Sequence[sp.Expr]) -> sp.Expr:
    """What the motion of this vehicle alone adds to the derivative that the condition bounds."""
    still = dict.fromkeys((q.symbol for q in system.inputs), sp.S.Zero)
    derivative = [system.derivative(p) for p in place]
    if asked.condition.relative_degree == 2:
        derivative = [system.derivative(d) for d in derivative]
    away = [asked.condition.value.diff(NUMBERS[name]) for name in ("x", "y")]
    free = exchanged(derivative, still)
    return -sp.Add(*(a * d for a, d in zip(away, free, strict=True)))


def _shared(asked: Asked, offset: sp.Expr, order: int, ours: sp.Expr | None) -> sp.Expr:
    """The offset with what the obstacle may do, and with the share of this vehicle.

    Where the part of its own motion is not known, it meets the whole condition.
    """
    n = NUMBERS
    if order == 1:
        counted = n["change"] * SAMPLE_TIME / 2 + n["unsure"]
    elif asked.later is None:
        counted = n["change"] + (K1 + K2) * n["unsure"]
    else:  # of dP/dt, where P has dc/dt in it
        counted = n["change"] + K2 * n["unsure"]
    if ours is None:
        return offset - counted
    # offset = -(ours + others), of which the share is that of the others
    return -ours - n["share"] * (-offset - ours + counted)


def avoiding(
    system: System,
    law: Law,
    pairs: int,
    position: tuple[str, str],
    heading: str,
    hull: Sequence[float],
    parts: int,
    clearance: float,
    *,
    gains: tuple[float, float] | None,
    disturbance_measured: bool,
    worst: Sequence[str],
    box: ParameterBox,
    scales: Mapping[str, float],
    sample_time: float,
    rows_handed: bool = False,
) -> Law:
    """`law` with a safety filter that keeps so many pairs of discs apart.

    It is handed the numbers `PAIR` of each pair, behind what else it is handed. Where no input
    keeps all apart, all give way by the same least amount. hull, parts, clearance, rows_handed:
    see `FoundPairs`.
    """
    each = pair_conditions(
        system, position, heading, worst=worst, disturbance_measured=disturbance_measured, box=box,
        rows_handed=rows_handed,
    )  # fmt: skip
    gains = usual_gains(sample_time) if gains is None else gains
    bearable = conditions([each.orders])
    check_held(bearable, gains, sample_time)
    sensed = [d for d in system.disturbances if disturbance_measured and d.name not in worst]
    numbers = [
        Quantity(f"pair{k}_{name}", unit, f"{name} of pair {k}")
        for k in range(1, pairs + 1)
        for name, unit in PAIR.items()
    ]
    law = replace(
        law,
        reads=tuple({q.name: q for q in (*law.reads, *system.states, *sensed)}.values()),
        handed=(*law.handed, *numbers),
    )
    still = believed_disturbances(system, law)
    if disturbance_measured:
        still = {symbol(n): sp.S.Zero for n in worst}
    rows = exchanged(each.expressions, still)
    units = tuple(over_time("m", order) for order in each.orders)
    bounds = exchanged((e for n, b in input_rows(system) for e in (*n, b)), still)
    m, count = len(system.inputs), pairs * len(units)
    hard = len(bounds) // (m + 1)
    empty = (sp.S.Zero,) * count
    return replace(
        law,
        name=f"{law.name}, clear of what moves",
        parameters=(
            *law.parameters, *system.parameters,
            Parameter("kappa1", "1/s", "slower gain of the safeguard", value=gains[0], above=0),
            Parameter("kappa2", "1/s", "faster gain of the safeguard", value=gains[1], above=0),
            *box.parameters,
        ),
        conditions=(*law.conditions, *bearable),
        safeguard=Safeguard(
            normals={
                name: (*bounds[i :: m + 1], *empty) for i, name in enumerate(system.input_names)
            },
            offsets=(*bounds[m :: m + 1], *(sp.S.One,) * count),
            hard=hard,
            scales=input_scales(system, scales),
            units=units * pairs,
            names=tuple(f"pair {k}" for k in range(1, pairs + 1) for _ in units),
            repeated=Repeated(
                tuple(NUMBERS.values()), tuple(rows), units, pairs,
                FoundPairs(
                    _pose(system, position, heading), tuple(hull), parts, clearance,
                    set(each.orders) == {1}, rows_handed,
                ),
            ),
        ),
    )  # fmt: skip
