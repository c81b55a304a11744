"""Safety filter (CBF-QP): a quadratic program changes a law's inputs as little as possible.

    minimise  sum_i ((u_i - w_i) / scale_i)^2  over the inputs u within their bounds, subject to

    dc_j/dt + k1 (c_j + m_j) <= 0                                    relative degree 1
    d2c_j/dt2 + (k1 + k2) dc_j/dt + k1 k2 (c_j + m_j) <= 0           relative degree 2

for every inequality c_j <= 0 of a region; w is the input that the law requests. The conditions
are those of a control barrier function (A. D. Ames et al., European Control Conference 2019) and
of one of high order (W. Xiao, C. Belta, IEEE Trans. Automatic Control 67, 2022). As long as the
input bounds admit them, a c_j that starts with c_j <= 0 and dc_j/dt + k1 c_j <= 0 never crosses 0.

Several filters around one law have an order of priority.

A gain is bounded by sampling: by what an input that is held can bear. A condition bounds a
derivative of a constraint c at a sample, and the input is held until the next, T later. Where that
derivative does not change meanwhile,

    dc/dt <= -k c                         c(i+1) <= (1 - k T) c(i),
    d2c/dt2 <= -(k1 + k2) dc/dt - k1 k2 c      a sampled double integrator,

and the condition keeps c <= 0, from c <= 0 and dc/dt + k1 c <= 0, at every instant, whatever else
the input does, exactly for

    k T <= 1                                                          order one
    s (s + r) T^2 - 2 r T - 2 <= 0,  s = k1 + k2,  r^2 = k1^2 + k2^2       order two

The second is the hold after the one that begins on the limit, at any speed inwards: its parabola
touches c = 0. All states that follow from the start are in the cone between these two, and an
input that does more than the condition asks only lowers c. For k1 -> 0 it is
k2 T <= (1 + 5^(1/2)) / 2, for equal gains k T <= .787. A condition that is kept possible for later
inputs (`barrier_conditions.py`) has both, and k T <= 1 for each gain.

With a measurement that is late as well no margin helps beyond a delay at which the loop of the
condition, d2c/dt2 = -(k1 + k2) dc/dt - k1 k2 c or dc/dt = -k c, diverges: a held input counts as
half a sample late.

Limits on how fast inputs and states change are conditions of it as well:

    |u_i(k) - u_i(k - 1)| <= R_i h        an input, held for h, never faster than R_i
    |f_s(q, u)| <= A_s                    the rate of a state that the inputs reach: an acceleration

The first are as hard as the bounds of the inputs; the second are relaxed like the conditions of a
region where no input meets them all.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Annotated, TypeVar, cast

import sympy as sp

from holdfast.arguments import RangesOfParameters, Seconds, Two, UnitsOf, checked, renamed
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.control.barrier_conditions import (
    ViabilityCondition,
    as_states,
    kept_possible,
    viability_conditions,
)
from holdfast.maths.control.parameter_box import ParameterBox, parameter_box
from holdfast.maths.control.velocity_tracking import believed_disturbances
from holdfast.maths.definitions.extension import both
from holdfast.maths.definitions.law import MOST_LEVELS, Foresight, GainCondition, Law, Safeguard
from holdfast.maths.definitions.quantity import (
    DELAY,
    SAMPLE_TIME,
    Parameter,
    Quantity,
    merge_parameters,
    symbol,
)
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Memory, Switching, as_switching, joined
from holdfast.maths.definitions.system import System, check_outputs
from holdfast.maths.expressions.random_points import is_zero
from holdfast.maths.expressions.traversal import at_numbers, derivatives, exchanged, symbols_of

USUAL = (1.0, 4.0)
"""Gains of a safety filter [1/s] where none are given and the sample time bears them."""

K1, K2 = symbol("kappa1"), symbol("kappa2")
ROUNDING = 1e-9  # of a hold that is exactly the longest


@dataclass(frozen=True)
class HeldGains(GainCondition):
    """A condition on the gains of a safety filter.

    orders: of the conditions that have the gains.
    """

    orders: tuple[int, ...] = ()

    def violation(self, parameters: Mapping[sp.Symbol, float]) -> str | None:
        values = {DELAY: 0.0, **parameters}
        value, limit = (float(at_numbers(e, values)) for e in (self.value, self.limit))
        if value <= limit * (1.0 + ROUNDING):
            return None
        gains = [float(values[k]) for k in ((K1, K2) if self.orders != (1,) else (K1,))]
        shown = " and ".join(f"{k:g}" for k in gains)
        if not self.refused:
            late = f"late by {values[DELAY]:g} s and held for {values[SAMPLE_TIME]:g} s"
            return (
                f"gains of {shown} 1/s of the safety filter, {late}: {self.consequence}, beyond a "
                f"delay of {limit - values[SAMPLE_TIME] / 2:.3g} s ({self.source})"
            )
        share = limit / value
        most = " and ".join(f"{_rounded_down(k * share)}" for k in gains)
        return (
            f"gains of {shown} 1/s of the safety filter, held for {value:g} s: {self.consequence}; "
            f"expected at most {most} 1/s, or a sample time of at most {_rounded_down(limit)} s"
        )


def conditions(orders: Iterable[tuple[int, ...]]) -> tuple[HeldGains, ...]:
    """The conditions on the gains.

    orders: of the conditions of every constraint, (1,), (2,), or (1, 2) with later inputs.
    """
    crossed = "a constraint is crossed between two samples although its condition is kept"
    limits = []
    for kind in sorted(set(orders)):
        limits += [
            HeldGains(
                value=SAMPLE_TIME, limit=_longest(kind), consequence=crossed, closed=True,
                source="derived for a held input", refused=True, orders=kind,
            ),
            HeldGains(
                value=DELAY + SAMPLE_TIME / 2, limit=_latest(kind), closed=True, orders=kind,
                consequence="a constraint is crossed ever further, whatever its margin",
                source="phase margin of the condition",
            ),
        ]  # fmt: skip
    return tuple(limits)


def check_held(limits: Sequence[HeldGains], gains: tuple[float, float], sample_time: float) -> None:
    """Raises `DefinitionError` for gains that a sample time does not bear."""
    values = {K1: gains[0], K2: gains[1], SAMPLE_TIME: sample_time}
    crossed = [c for c in limits if c.refused and c.violation(values)]
    if crossed:  # what the shortest hold asks is enough for the others
        shortest = min(crossed, key=lambda c: float(c.limit.subs(values)))
        of_all = replace(shortest, orders=max(c.orders for c in limits))
        raise DefinitionError(of_all.violation(values) or "")


def longest_hold(gains: tuple[float, float], orders: tuple[int, ...]) -> float:
    """The longest sample time that bears the gains [s]; orders: see `conditions`."""
    return float(_longest(orders).subs({K1: gains[0], K2: gains[1]}))


def usual_gains(sample_time: float | None) -> tuple[float, float]:
    """`USUAL`, or as many times less as the faster one is above 1 / sample_time."""
    share = 1.0 if sample_time is None else min(1.0, 1.0 / (USUAL[1] * sample_time))
    return USUAL[0] * share, USUAL[1] * share


def _longest(orders: tuple[int, ...]) -> sp.Expr:
    """The longest hold [s]."""
    if orders == (1,):
        return 1 / K1
    s, r = K1 + K2, sp.sqrt(K1**2 + K2**2)
    second = (r + sp.sqrt(r**2 + 2 * s * (s + r))) / (s * (s + r))
    return second if orders == (2,) else sp.Min(second, 1 / K1, 1 / K2)


def _latest(orders: tuple[int, ...]) -> sp.Expr:
    """The delay at which the loop of the condition neither grows nor decays [s]."""
    if orders == (1,):
        return sp.pi / (2 * K1)
    s, p = K1 + K2, K1 * K2
    w = sp.sqrt((s**2 + sp.sqrt(s**4 + 4 * p**2)) / 2)
    return sp.atan(s * w / p) / w


def _rounded_down(value: float) -> str:
    """Four digits that are not above the value."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{math.floor(value / unit * (1 + 1e-12)) * unit:.4g}"


@checked
def in_order(filters: Sequence[Law]) -> Law:
    """One law with the safety filters of several, the most important first.

    filters: the same law with different safety filters (`safeguard`, `safety_law`), of one system.

    The input is the admissible one nearest to the command. Where not all conditions can be met,
    those of the last filter give way first: each level in turn is relaxed by the least amount that
    the levels before it allow.

    Raises `DefinitionError` for a law without a safety filter, more than one kernel, two filters
    with an inequality or a parameter of the same name, and more than six filters.

    >>> both = hf.in_order([hf.safeguard(cart, brake, track), hf.safeguard(cart, brake, slow)])
    >>> both.safeguard.levels
    (2, 2)
    """
    if not 1 <= len(filters) <= MOST_LEVELS:
        raise DefinitionError(f"{len(filters)} filters", expected=f"1 to {MOST_LEVELS}")
    guards: list[Safeguard] = []
    for law in filters:
        if law.safeguard is None:
            raise DefinitionError(f"law '{law.name}' has no safety filter")
        guards.append(law.safeguard)
    first = filters[0]
    if any(law.outputs != first.outputs or law.handed != filters[-1].handed for law in filters[1:]):
        raise DefinitionError("the filters are of different laws", expected="of one and the same")
    hard = guards[0].hard
    for guard in guards:
        bounds = [guard.offsets[:hard], *(n[:hard] for n in guard.normals.values())]
        of_first = [guards[0].offsets[:hard], *(n[:hard] for n in guards[0].normals.values())]
        if guard.hard != hard or bounds != of_first or guard.scales != guards[0].scales:
            raise DefinitionError("the filters have different bounds or scales of the inputs")
    if any(guard.repeated for guard in guards[1:]):
        raise DefinitionError("moving obstacles are not first", expected="them before all others")
    tables = [law.lookup for law in filters if law.lookup is not None]
    if len(tables) > 1:
        raise DefinitionError("there is more than one kernel", expected="one, and regions")
    names = [n for guard in guards for n in dict.fromkeys(guard.names)]
    if twice := [n for n in names if names.count(n) > 1]:
        raise DefinitionError(f"two filters have an inequality '{twice[0]}'")
    reads = {q.name: q for law in filters for q in law.reads}
    return replace(
        first,
        name=f"{first.name}, then {len(filters) - 1} more" if len(filters) > 1 else first.name,
        reads=tuple(reads.values()),
        parameters=merge_parameters(*(law.parameters for law in filters)),
        signals={n: e for law in filters for n, e in law.signals.items()},
        conditions=tuple({c: None for law in filters for c in law.conditions}),
        lookup=tables[0] if tables else None,
        safeguard=Safeguard(
            {
                name: (*of_first[:hard], *(e for g in guards for e in g.normals[name][hard:]))
                for name, of_first in guards[0].normals.items()
            },
            (*guards[0].offsets[:hard], *(e for g in guards for e in g.offsets[hard:])),
            hard,
            guards[0].scales,
            tuple(u for g in guards for u in g.units),
            tuple(n for g in guards for n in g.names),
            _levels([len(g.offsets) - hard for g in guards]),
            next((_placed(g.foresight, k) for k, g in enumerate(guards) if g.foresight), None),
            guards[0].repeated,
        ),
    )


def _levels(counts: Sequence[int]) -> tuple[int, ...]:
    """The half-spaces of each level; a kernel that looks ahead has none."""
    return tuple(n for n in counts if n) or (0,)


def _placed(foresight: Foresight, place: int) -> Foresight:
    return replace(foresight, first=place == 0)


L = TypeVar("L", bound=Law | Switching)
Row = tuple[tuple[sp.Expr, ...], sp.Expr]


@renamed(measured="disturbance_measured")
@checked
def safeguard(
    system: System,
    law: L,
    region: Region,
    *,
    constraints: Region | None = None,
    gains: Annotated[tuple[float, float], Two("k1, k2")] | None = None,
    margins: Annotated[Mapping[str, float], UnitsOf("constraints")] | None = None,
    scales: Mapping[str, float] | None = None,
    disturbance_measured: bool = False,
    worst: Sequence[str] = (),
    uncertain: RangesOfParameters | None = None,
    sample_time: Seconds | None = None,
) -> L:
    """`law` with a safety filter: the least change of its inputs that keeps `region` viable.

    constraints: further inequalities, enforced like those of the region. A run that violates one of
    them has not left the region. gains: (k1, k2) in 1/s, above 0, by default (1, 4), or as much
    less as a `sample_time` [s] bears that is known. margins: name of an inequality -> m_j >= 0 in
    its own unit, how far inside the boundary to stay. scales: input -> the change of it that counts
    as much as a change of another by its own scale; half the width of its bounds where they are
    finite, else 1. disturbance_measured: whether the law measures the disturbances, but those of
    `worst`; if not, it uses its believed values, or zero. worst: disturbances against which the
    conditions hold wherever in their bounds they are (robust control barrier function), such as
    what a model leaves unexplained: the condition of a constraint c has the support function of the
    bounds at the coefficients of d in it. uncertain: parameter of the system or the region ->
    (least, largest), in its unit: the conditions hold for every model of this box; a parameter that
    multiplies an input makes two of one (`parameter_box`).

    If no input is admissible, all conditions are relaxed by the same least amount, and the run
    counts such samples.

    An input that enters a constraint later than others is used
    (`maths/control/barrier_conditions.py`). A closed loop whose sample time does not bear the gains
    is refused.

    A `Switching` is treated mode by mode. Raises `DefinitionError` for a law that does not give
    the system's inputs, a condition of relative degree above 2, inputs bounded by a ball of more
    than three dimensions or by more actuators than inputs, a condition that is not affine in a
    disturbance of `worst` or not rational in an uncertain parameter, and invalid names or numbers.

    >>> kept = hf.safeguard(cart, brake, track, gains=(1.0, 4.0))
    >>> hf.simulate(cart, kept, starts=[[0.9, 0.3]], region=track, horizon=8.0)
    <Result of 1 runs: 1 stayed>
    """
    gains = usual_gains(sample_time) if gains is None else gains
    pair = isinstance(gains, Sequence) and len(gains) == 2
    if not (pair and all(_is_number(k) and k > 0 for k in gains)):
        raise DefinitionError(
            f"gains of the safeguard are {gains!r}", expected="two numbers above 0, in 1/s"
        )
    if not isinstance(disturbance_measured, bool):
        raise DefinitionError(
            f"disturbance_measured of the safeguard is {disturbance_measured!r}",
            expected="true or false",
        )
    region = region if constraints is None else both(region, constraints)
    box = parameter_box(uncertain, system, region)
    margin_of = _table("margins", margins)
    for name, value in margin_of.items():
        if name not in region.inequality_names:
            raise DefinitionError(
                f"margin of '{name}', which is not an inequality of region '{region.name}'",
                remedy=suggestion(str(name), region.inequality_names),
            )
        if not (_is_number(value) and value >= 0):
            raise DefinitionError(
                f"margin of '{name}' is {value!r}", expected="a number, 0 or more"
            )
    parameters = (
        Parameter("kappa1", "1/s", "slower gain of the safeguard", value=float(gains[0]), above=0),
        Parameter("kappa2", "1/s", "faster gain of the safeguard", value=float(gains[1]), above=0),
        *(
            Parameter(
                f"margin_{c.name}", c.unit, "how far inside to stay", value=float(margin_of[c.name])
            )
            for c in region.inequalities
            if c.name in margin_of
        ),
        *box.parameters,
    )
    bounds = input_rows(system)
    pieces = asked_of(system, region, tuple(margin_of), worst, disturbance_measured, box)
    asked = [row for piece in pieces for row in piece.rows]
    bearable = conditions(piece.orders for piece in pieces)
    if sample_time is not None:
        check_held(bearable, gains, sample_time)
    rows = [*bounds, *((normal, offset) for normal, offset, _ in asked)]
    names_of_rows = tuple(piece.condition.name for piece in pieces for _ in piece.rows)
    unit_of = {c.name: c.unit for c in region.inequalities}
    units = tuple(
        over_time(unit_of[n], order) for n, (*_, order) in zip(names_of_rows, asked, strict=True)
    )
    chosen = input_scales(system, _table("scales", scales))

    def guarded(law: Law) -> Law:
        check_fit(system, law)
        sensed = [d for d in system.disturbances if disturbance_measured and d.name not in worst]
        reads = {q.name: q for q in (*law.reads, *system.states, *sensed)}
        law = replace(law, reads=tuple(reads.values()))
        still = believed_disturbances(system, law)
        if disturbance_measured:
            still = {symbol(n): sp.S.Zero for n in worst}
        numbers = exchanged((e for n, b in rows for e in (*n, b)), still)
        columns = [tuple(numbers[i :: len(names) + 1]) for i in range(len(names) + 1)]
        return replace(
            law,
            name=f"{law.name}, safeguarded",
            parameters=(*law.parameters, *system.parameters, *region.parameters, *parameters),
            conditions=(*law.conditions, *bearable),
            safeguard=Safeguard(
                normals=dict(zip(names, columns[:-1], strict=True)),
                offsets=columns[-1],
                hard=len(bounds),
                scales=chosen,
                units=units,
                names=names_of_rows,
            ),
        )

    names = system.input_names
    if isinstance(law, Switching):
        return cast(L, law.map_laws(guarded, f"{law.name}, safeguarded"))
    return cast(L, guarded(law))


@dataclass(frozen=True)
class Asked:
    """What a filter asks of a constraint: its condition, and P <= 0 where later inputs act on P.

    rows: normal and offset of the half-spaces of the inputs, and the order of their derivative; one
    for every case of a box of parameters. kept: what is kept at 0 or below from a start at which it
    is: c, and dc/dt + k1 c or P.
    """

    condition: ViabilityCondition
    later: ViabilityCondition | None
    rows: tuple[tuple[tuple[sp.Expr, ...], sp.Expr, int], ...]
    kept: tuple[sp.Expr, ...]

    @property
    def orders(self) -> tuple[int, ...]:
        return tuple(order for *_, order in self.rows)


def asked_of(
    system: System,
    region: Region,
    margins: Sequence[str],
    worst: Sequence[str],
    disturbance_measured: bool,
    box: ParameterBox,
) -> list[Asked]:
    """What the filter of `safeguard` asks; margins: names of inequalities that have one."""
    unknown = _Unknown(system, worst, disturbance_measured)
    believed = {} if disturbance_measured else {d.symbol: sp.S.Zero for d in system.disturbances}
    pieces = []
    for c in viability_conditions(system, region):
        depth, weights = _depth(c, c.name in margins), unknown.weights(c)
        condition = (c.effect, weights, unknown.without(_level(c, depth), weights))
        cases = [(n, -g - unknown.most(w)) for n, w, g in box.worst(c.name, condition)]
        rows = [(*row, c.relative_degree) for row in cases]
        drift = unknown.without(c.drift, weights) + unknown.most(weights)
        row, later = kept_possible(system, c, cases[0], drift.xreplace(believed))
        below_zero = [depth]
        if later is not None:
            if box.uncertain:
                raise DefinitionError(
                    f"inputs act on '{c.name}' by derivatives of different order, and "
                    f"'{box.uncertain[0].name}' is uncertain",
                    expected="one of the two",
                    remedy="leave uncertain out, and give a margin for it",
                )
            w = unknown.weights(later)
            level = unknown.without(later.drift + symbol("kappa2") * later.value, w)
            rows = [(*row, 1), (later.effect, -level - unknown.most(w), 2)]
            below_zero.append(later.value)
        elif c.relative_degree == 2:
            below_zero.append(c.rate + symbol("kappa1") * depth)
        pieces.append(Asked(c, later, tuple(rows), tuple(below_zero)))
    return pieces


def _level(c: ViabilityCondition, depth: sp.Expr) -> sp.Expr:
    """The part of a condition without inputs: level + effect . u <= 0."""
    k1, k2 = symbol("kappa1"), symbol("kappa2")
    if c.relative_degree == 1:
        return c.drift + k1 * depth
    return c.drift + (k1 + k2) * c.rate + k1 * k2 * depth


def _depth(c: ViabilityCondition, kept_away: bool) -> sp.Expr:
    """c + m."""
    return c.value + (symbol(f"margin_{c.name}") if kept_away else 0)


class _Unknown:
    """The disturbances against which the conditions hold wherever in their bounds they are."""

    def __init__(self, system: System, names: Sequence[str], disturbance_measured: bool) -> None:
        if isinstance(names, str) or any(n not in system.disturbance_names for n in names):
            odd = (
                names
                if isinstance(names, str)
                else next(n for n in names if n not in system.disturbance_names)
            )
            raise DefinitionError(
                f"worst of the safeguard names '{odd}', which is not a disturbance",
                remedy=suggestion(str(odd), system.disturbance_names),
            )
        if names and disturbance_measured and set(names) == set(system.disturbance_names):
            raise DefinitionError(
                f"'{names[0]}' is measured, and is to be the worst within its bounds",
                expected="one of the two",
            )
        if names and system.disturbance_bounds is None:
            raise DefinitionError(f"system '{system.name}' has no bounds of {', '.join(names)}")
        self.bounds = system.disturbance_bounds
        self.all = [d.symbol for d in system.disturbances]
        self.still = {symbol(n): sp.S.Zero for n in names}

    def weights(self, c: ViabilityCondition) -> tuple[sp.Expr, ...]:
        """The coefficients of all disturbances in a condition, 0 of those that are not meant."""
        weights = [
            w if d in self.still else sp.S.Zero for w, d in zip(c.carried, self.all, strict=True)
        ]
        free = symbols_of([*c.effect, *weights, *([c.rate] if c.relative_degree == 2 else [])])
        if free & set(self.still):
            odd = ", ".join(sorted(s.name for s in self.still))
            raise DefinitionError(
                f"the condition of '{c.name}' is not affine in {odd}",
                expected="disturbances of rates that are not yet in its first derivative",
            )
        return tuple(exchanged(weights, self.still))

    def without(self, rest: sp.Expr, weights: Sequence[sp.Expr]) -> sp.Expr:
        """What is left of a condition where they are zero."""
        return exchanged([rest], self.still)[0] if any(w != 0 for w in weights) else rest

    def most(self, weights: Sequence[sp.Expr]) -> sp.Expr:
        """The most that they add."""
        if self.bounds is None or all(w == 0 for w in weights):
            return sp.S.Zero
        return self.bounds.support(weights, 1)[0]


def over_time(unit: str, order: int) -> str:
    """The unit of a rate of change of that order."""
    return f"{unit}/s" if order == 1 else f"{unit}/s^{order}"


def check_fit(system: System, law: Law) -> None:
    """Refuse a law whose inputs cannot have a safety filter."""
    check_outputs(system, law)
    if law.safeguard is not None:
        raise DefinitionError(f"law '{law.name}' has a safeguard already")


def input_rows(system: System) -> list[Row]:
    """Half-spaces within the input bounds, as expressions of the parameters."""
    if system.input_bounds is None:
        return []
    return system.input_bounds.inscribed()


def input_scales(system: System, scales: Mapping[str, float]) -> Mapping[str, sp.Expr]:
    """The scale of every input: changes by one scale count equally."""
    for name, value in scales.items():
        if name not in system.input_names:
            raise DefinitionError(
                f"scale of '{name}', which is not an input of system '{system.name}'",
                remedy=suggestion(str(name), system.input_names),
            )
        if not (_is_number(value) and value > 0):
            raise DefinitionError(f"scale of '{name}' is {value!r}", expected="a number above 0")
    widths = dict.fromkeys(system.input_names, sp.oo)
    if system.input_bounds is not None:
        widths = dict(zip(system.input_names, system.input_bounds.half_widths(), strict=True))
    return {
        name: sp.Float(scales[name])
        if name in scales
        else (w if w.is_finite is not False and w != 0 else sp.S.One)
        for name, w in widths.items()
    }


def _table(what: str, table: object) -> dict[str, float]:
    """`table` if it is a mapping of names; its values are not checked."""
    if table is not None and not isinstance(table, Mapping):
        raise DefinitionError(f"{what} of the safeguard are {table!r}", expected="names to numbers")
    return dict(table or {})


def _is_number(value: object) -> bool:
    """Whether it is a finite real number; True and False are not."""
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


@checked
def limit_rates(
    system: System, law: Law | Switching, rates: Annotated[Mapping[str, float], UnitsOf("rates")]
) -> Law | Switching:
    """`law` with its inputs, or the rates of states, kept from changing faster.

    rates: name of an input, or of a state in whose rate an input is, -> the largest magnitude of
    its rate, in its unit per second.

    The law may have a safety filter; it keeps its conditions. The input before the first sample
    counts as 0. A law whose inputs are limited remembers the last ones, and is a `Switching`.

    Where the limit of an input leaves no input that meets the other conditions, these are
    relaxed by the least amount, and runs count it: a region's conditions know nothing of it.

    Raises `DefinitionError` for an unknown name, a number that is not above 0, and a state whose
    rate no input reaches, or not affinely.

    >>> hf.limit_rates(cart, brake, {"a": 2.0}).memory.following
    {'last_a': a}
    """
    check_outputs(system, law)
    if not rates:
        raise DefinitionError("there are no rates", expected="name -> the largest rate")
    for name, value in rates.items():
        if name not in (*system.input_names, *system.state_names):
            raise DefinitionError(
                f"rate of '{name}', which is neither an input nor a state of '{system.name}'",
                remedy=suggestion(str(name), (*system.input_names, *system.state_names)),
            )
        number = isinstance(value, Real) and not isinstance(value, bool)
        if not (number and 0 < float(value) < math.inf):
            raise DefinitionError(f"rate of '{name}' is {value!r}", expected="a number above 0")
    quantities = {q.name: q for q in (*system.inputs, *system.states)}
    parameters = tuple(
        Parameter(f"rate_{n}", over_time(quantities[n].unit, 1), "largest rate", value=float(v))
        for n, v in rates.items()
    )
    limited = [q for q in system.inputs if q.name in rates]
    last = {q.name: Quantity(f"last_{q.name}", q.unit, f"last {q.name}") for q in limited}
    hard = [row for q in limited for row in _steps(system, q.name, last[q.name].symbol)]
    fast = [q for q in system.states if q.name in rates]
    soft = [row for q in fast for row in _rates(system, q.name)]
    units = tuple(over_time(q.unit, 1) for q in fast for _ in range(2))
    names = tuple(f"rate of {q.name}" for q in fast for _ in range(2))

    def rate_limited(mode: Law) -> Law:
        guard = mode.safeguard or _bounds(system)
        still = believed_disturbances(system, mode)
        inputs = system.input_names
        more = [
            [exchanged((e for n, b in rows for e in (*n, b)), still)[i :: len(inputs) + 1]
             for i in range(len(inputs) + 1)]
            for rows in (hard, soft)
        ]  # fmt: skip
        columns = {n: guard.normals[n] for n in inputs} | {"": guard.offsets}
        wider = {
            name: (*column[: guard.hard], *more[0][i], *column[guard.hard :], *more[1][i])
            for i, (name, column) in enumerate(columns.items())
        }
        reads = {q.name: q for q in (*mode.reads, *system.states, *last.values())}
        return replace(
            mode,
            name=f"{mode.name}, rates limited",
            reads=tuple(reads.values()),
            parameters=(*mode.parameters, *system.parameters, *parameters),
            safeguard=replace(
                guard,
                normals={n: wider[n] for n in inputs},
                offsets=wider[""],
                hard=guard.hard + len(hard),
                units=(*guard.units, *units),
                names=(*guard.names, *names),
                levels=(*guard.levels[:-1], guard.levels[-1] + len(soft)) if guard.levels else (),
            ),
        )

    if isinstance(law, Law) and not limited:
        return rate_limited(law)
    modes = as_switching(law)
    changed = modes.map_laws(rate_limited, f"{law.name}, rates limited")
    if not limited:
        return changed
    memory = Memory(
        quantities=tuple(last.values()),
        initial={q.name: sp.S.Zero for q in last.values()},
        following={last[q.name].name: q.symbol for q in limited},
        reads=(),
        inputs=system.inputs,
    )
    return replace(changed, memory=joined(modes.memory, memory))


def _steps(system: System, name: str, last: sp.Symbol) -> list[Row]:
    """|u - last| <= R h."""
    step = symbol(f"rate_{name}") * SAMPLE_TIME
    unit = [sp.Integer(n == name) for n in system.input_names]
    return [(tuple(unit), last + step), (tuple(-e for e in unit), step - last)]


def _rates(system: System, name: str) -> list[Row]:
    """|f + g . u| <= A."""
    inputs = [q.symbol for q in system.inputs]
    rate = sp.sympify(system.rates[name])
    slopes = derivatives(rate, inputs)
    effect = tuple(slopes.values())
    if all(is_zero(e) for e in effect):
        raise DefinitionError(
            f"no input is in the rate of '{name}'",
            remedy="limit it by a constraint of the region, of its velocities",
        )
    if any(e.free_symbols & set(inputs) for e in effect):
        raise DefinitionError(
            f"the inputs do not appear affinely in the rate of '{name}'", remedy=as_states(slopes)
        )
    drift = rate.xreplace(dict.fromkeys(inputs, sp.S.Zero))
    most = symbol(f"rate_{name}")
    return [(effect, most - drift), (tuple(-e for e in effect), most + drift)]


def _bounds(system: System) -> Safeguard:
    """A safety filter of the bounds of the inputs alone."""
    rows = input_rows(system)
    return Safeguard(
        {n: tuple(row[i] for row, _ in rows) for i, n in enumerate(system.input_names)},
        tuple(b for _, b in rows),
        len(rows),
        input_scales(system, {}),
    )
