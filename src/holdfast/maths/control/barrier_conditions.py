"""Barrier conditions: the derivatives of a region's inequalities that the inputs act on.

    c_j(q) <= 0,   d/dt c_j = grad c_j . f(q, u, d)                      thesis (5.11)-(5.13)

If no input appears in d/dt c_j, the second derivative takes its place.

Inputs that enter a constraint later than others have conditions that keep the earlier ones able:

    a condition   n(q) . u <= b(q)   of a constraint,   P(q) = min over the bounds of n . u  -  b

The brakes of a vehicle that is steered at once are in no first derivative of a distance: a
condition of first order asks the steering alone, which has no effect on an obstacle dead ahead. P
is by how much the best input misses the condition, and P <= 0 are the states at which one meets it.
P is a function of the states, and the later inputs act on its rate: it is a constraint itself,

    dP/dt + k P <= 0,        n . u <= max(b, min over the bounds of n . u)

The first keeps the condition possible; where it is not, the second asks for the best input, and P
falls at the rate k, as far as the bounds admit it. Where no input has an effect yet, n = 0 and
P = -b, this is the condition of high order (W. Xiao, C. Belta, IEEE Trans. Automatic Control 67,
2022); for n other than 0 it is the same step for a condition that some inputs meet and others keep
possible. An input without bounds counts as 0 in P, or as the bound nearest to it.

Outward rates are the speed of a system towards the boundary of a region.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import Bounds, Box, LinearImage
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest, least, magnitude, select, sgn
from holdfast.maths.expressions.random_points import is_zero
from holdfast.maths.expressions.traversal import (
    at_numbers,
    derivatives,
    exchanged,
    parts,
    symbols_of,
)


@checked
def outward_rates(system: System, region: Region, law: Law | None = None) -> dict[str, sp.Expr]:
    """d/dt c_j along the system, for every inequality: { name: grad c_j . f(q, u, d) }.

    With a `law`, its outputs take the place of the inputs. Raises `DefinitionError` when
    the region reads a state that the system does not have.

    >>> hf.outward_rates(cart, slow, brake)
    {'fast': (-c*v - k*x)*sgn(v)}
    """
    region.check_states(system.name, system.states)
    rates = {c.name: system.derivative(c.expression) for c in region.inequalities}
    if law is None:
        return rates
    closed = {q.symbol: law.outputs[q.name] for q in system.inputs}
    return {name: rate.subs(closed) for name, rate in rates.items()}


MOST_PIECES = 64


@dataclass(frozen=True)
class ViabilityCondition:
    """One smooth piece c of an inequality, and its first derivative that an input reaches.

        d^k c / dt^k = effect . u + carried . d + drift,   k = relative_degree (1 or 2)

    `rate` is dc/dt without the inputs, `gradient` dc/dq, one entry for each state. For k = 2 the
    second derivative is that under a disturbance that does not change. `drift` contains the
    disturbance; `carried` are its coefficients where it enters affinely and, for k = 2, does not
    enter dc/dt: only then (`affine`) has the worst disturbance a closed form. `by_input` is the
    relative degree with respect to each input, 0 for an input that appears in neither derivative.
    `ties` vanish where c has a kink that is not an intersection of half-spaces; no condition is
    """

    name: str
    value: sp.Expr
    gradient: tuple[sp.Expr, ...]
    rate: sp.Expr
    effect: tuple[sp.Expr, ...]
    carried: tuple[sp.Expr, ...]
    drift: sp.Expr
    affine: bool
    relative_degree: int
    by_input: tuple[int, ...]
    ties: tuple[sp.Expr, ...]


@checked
def viability_conditions(system: System, region: Region) -> tuple[ViabilityCondition, ...]:
    """One condition for each smooth piece of each inequality of `region`.

    |x| <= 1 and max(a, b) <= 0 are two pieces each.

    Raises `DefinitionError` when the region reads a quantity that the system lacks, an input does
    not appear affinely, or neither the first nor the second derivative contains an input (relative
    degree above 2).

    >>> [condition.relative_degree for condition in hf.viability_conditions(cart, track)]
    [2, 2]
    """
    region.check_states(system.name, system.states)
    values = {p.symbol: p.value for p in (*system.parameters, *region.parameters)}
    return tuple(
        _condition(system, inequality.name, piece)
        for inequality in region.inequalities
        for piece in _pieces(inequality.expression, inequality.name, values)
    )


def _pieces(expression: sp.Expr, name: str, values: Mapping[sp.Symbol, float]) -> list[sp.Expr]:
    """Smooth expressions whose largest is `expression`, as far as its kinks are convex."""
    waiting, done = [expression], []
    while waiting:
        current = waiting.pop(0)
        branches = next(_branches(current, values), None)
        if branches is None:
            done.append(current)
        else:
            waiting = [*branches, *waiting]
        if len(waiting) + len(done) > MOST_PIECES:
            raise DefinitionError(
                f"inequality '{name}' has more than {MOST_PIECES} smooth pieces",
                remedy="write it as several inequalities",
            )
    return done


def _branches(
    expression: sp.Expr, values: Mapping[sp.Symbol, float]
) -> Iterator[tuple[sp.Expr, sp.Expr]]:
    """The two expressions whose larger one is `expression`, for a kink that it increases with."""
    kinks = sorted(_kinks(expression, greatest, magnitude), key=sp.default_sort_key)
    if kinks and kinks[0] == expression:
        yield _sides(expression)
        return
    decided = {  # a condition of the states is no number, whatever it is
        e.args[0]: sp.Dummy(real=True)
        for e in parts([expression])
        if isinstance(e, select) and symbols_of([e.args[0]]) - values.keys()
    }
    short, *shorter = exchanged([expression, *kinks], decided)
    for kink, of_short in zip(kinks, shorter, strict=True):
        inner = sp.Dummy(real=True)
        (smooth,) = exchanged([short], {of_short: inner})
        slope = at_numbers(derivatives(smooth, [inner])[inner], values)
        if slope.is_number and slope > 0:
            a, b = (exchanged([expression], {kink: side})[0] for side in _sides(kink))
            yield a, b


def _sides(kink: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """The two expressions whose larger one is the kink."""
    a = kink.args[0]
    return a, kink.args[1] if isinstance(kink, greatest) else -a


def _kinks(expression: sp.Expr, *kinds: type[sp.Expr]) -> list[sp.Expr]:
    """The parts of these kinds, each once, without those that only decide between two branches."""
    seen: dict[sp.Basic, None] = {}
    waiting: list[sp.Basic] = [expression]
    while waiting:
        part = waiting.pop()
        if part not in seen:
            seen[part] = None
            waiting += part.args[1:] if isinstance(part, select) else part.args
    return [part for part in seen if isinstance(part, kinds)]


def as_states(effects: Mapping[sp.Symbol, sp.Expr]) -> str:
    """The remedy for an expression that is not affine in the inputs.

    effects: its derivatives by all inputs.
    """
    names, called = _curved(effects)
    return (
        f"command the rate of {names} instead: hf.dynamic_extension(system, {called}), with the "
        f"bounds hf.input_limits(system, {called}) in the region"
    )


def _in_place_of(effects: Mapping[sp.Symbol, sp.Expr]) -> str:
    """The remedy where a rate of an input would act too late."""
    names, called = _curved(effects)
    return (
        f"take another input than {names}, such as the tangent of a steering angle, or keep a "
        f"kernel of hf.dynamic_extension(system, {called})"
    )


def _curved(effects: Mapping[sp.Symbol, sp.Expr]) -> tuple[str, str]:
    """Inputs such that an expression is affine in the others: in a sentence, and as an argument."""
    others = {u for u, e in effects.items() if u not in e.free_symbols}
    for u in effects:
        if u in others and effects[u].free_symbols & others:
            others.remove(u)
    names = [f"'{u.name}'" for u in effects if u not in others]
    return " and ".join(names), f"({', '.join(names)}{',' * (len(names) == 1)})"


def _condition(system: System, name: str, value: sp.Expr) -> ViabilityCondition:
    inputs = [q.symbol for q in system.inputs]
    disturbances = [q.symbol for q in system.disturbances]
    still = dict.fromkeys(inputs, sp.S.Zero)
    rate = system.derivative(value)
    slopes = derivatives(rate, inputs)
    at_once = [not is_zero(slopes[u]) for u in inputs]
    degree, driven = 1, rate
    if not any(at_once):
        degree, driven = 2, system.derivative(rate)
        slopes = derivatives(driven, inputs)
    effect = tuple(slopes[u] for u in inputs)
    later = [degree == 2 and not is_zero(e) for e in effect]
    if degree == 2 and not any(later):
        raise DefinitionError(
            f"no input of system '{system.name}' is in the first two derivatives of "
            f"'{name}': its relative degree is above 2",
            remedy="choose a constraint nearer to the inputs, or promote a state to an input",
        )
    if any(e.free_symbols & set(inputs) for e in effect):
        raise DefinitionError(
            f"the inputs of system '{system.name}' do not appear affinely in the rate of '{name}'",
            remedy=as_states(slopes) if degree == 1 else _in_place_of(slopes),
        )
    undriven, drift = exchanged([rate, driven], still)
    carried = tuple(derivatives(drift, disturbances).values())
    mixed = [*effect, *carried, *((rate,) if degree == 2 else ())]
    affine = not any(e.free_symbols & set(disturbances) for e in mixed)
    by_input = tuple(1 if a else 2 * b for a, b in zip(at_once, later, strict=True))
    return ViabilityCondition(
        name=name,
        value=value,
        gradient=tuple(derivatives(value, [q.symbol for q in system.states]).values()),
        rate=undriven,
        effect=effect,
        carried=carried,
        drift=drift,
        affine=affine,
        relative_degree=degree,
        by_input=by_input,
        ties=tuple(
            k.args[0] - k.args[1] if isinstance(k, (least, greatest)) else k.args[0]
            for k in _kinks(value, least, greatest, magnitude, select, sgn)
        ),
    )


Row = tuple[tuple[sp.Expr, ...], sp.Expr]
"""normal . u <= offset"""


def kept_possible(
    system: System, c: ViabilityCondition, row: Row, drift: sp.Expr
) -> tuple[Row, ViabilityCondition | None]:
    """The condition of c as it is to be asked, and P <= 0 as a constraint if later inputs act on P.

    row: the condition of c. drift: of dc/dt, at the worst disturbance; where it is 0 and 0 is an
    input, that input meets the condition at every state with c <= 0, and nothing need keep it
    possible. A condition of the second derivative is left as it is (`unused_inputs`).

    Raises `DefinitionError` for an input that acts on c and neither on dc/dt nor on dP/dt.
    """
    late = _later(system, c)
    if c.relative_degree > 1 or not late or _meets_always(system, drift):
        return row, None
    normal, offset = row
    least, limited = _least(system.input_bounds, normal)
    condition = _later_condition(system, c, least - offset)
    beyond = [
        n
        for n, degree in zip(system.input_names, condition.by_input, strict=True)
        if n in late and not degree
    ]
    still = {d.symbol: sp.S.Zero for d in system.disturbances}
    if beyond and not _meets_always(system, drift.xreplace(still)):
        raise DefinitionError(
            f"input '{beyond[0]}' of system '{system.name}' acts on '{c.name}', but on no rate of "
            "it that a condition has, while other inputs are in its first derivative",
            expected="inputs that a constraint depends on within two derivatives",
            remedy="promote the state that it changes to an input, or compute a kernel",
        )
    if len(beyond) == len(late):
        return row, None
    return (normal, greatest(offset, least) if limited else offset), condition


@checked
def unused_inputs(system: System, region: Region) -> dict[str, tuple[str, ...]]:
    """Inequality -> inputs that act on it later than by two derivatives: no filter uses them.

    An inequality on whose second derivative another input acts alike at every state has none.
    """
    moving = {q.symbol for q in (*system.states, *system.disturbances)}
    unused = {}
    for c in viability_conditions(system, region):
        alike = any(not e.free_symbols & moving and not is_zero(e) for e in c.effect)
        if c.relative_degree > 1 and not alike and (late := _later(system, c)):
            unused[c.name] = tuple(late)
    return unused


def _later(system: System, c: ViabilityCondition) -> list[str]:
    """The inputs that c depends on by a chain of rates, and that its condition has not."""
    reaching = _reaching(system, c.value)
    degrees = zip(system.input_names, c.by_input, strict=True)
    return [n for n, degree in degrees if not degree and n in reaching]


def _meets_always(system: System, drift: sp.Expr) -> bool:
    """Whether 0 is an input, and leaves dc/dt = 0."""
    if not is_zero(drift):
        return False
    bounds = system.input_bounds
    values = {p.symbol: p.value for p in system.parameters}
    rows = [] if bounds is None else bounds.inscribed()
    return all(float(sp.sympify(b).xreplace(values)) >= 0 for _, b in rows)


def _reaching(system: System, expression: sp.Expr) -> set[str]:
    """The inputs from which a chain of rates leads to an expression of the states."""
    rates = {q.symbol: sp.sympify(system.rates[q.name]) for q in system.states}
    inputs = {q.symbol: q.name for q in system.inputs}
    waiting, seen = set(expression.free_symbols), set()
    while waiting:
        symbol = waiting.pop()
        seen.add(symbol)
        if symbol in rates:
            waiting |= rates[symbol].free_symbols - seen
    return {name for symbol, name in inputs.items() if symbol in seen}


def _least(bounds: Bounds | None, weights: Sequence[sp.Expr]) -> tuple[sp.Expr, bool]:
    """The least of weights . u over the bounds, and whether they limit it."""
    if isinstance(bounds, LinearImage):
        return _least(bounds.of, list(bounds.matrix.T * sp.Matrix(weights)))
    if bounds is None:
        return sp.S.Zero, False
    if not isinstance(bounds, Box):
        return bounds.support(weights, -1)[0], True
    total, limited = sp.S.Zero, True
    for w, low, high in zip(weights, bounds.lower, bounds.upper, strict=True):
        if w == 0:
            continue
        if low.is_finite is not False and high.is_finite is not False:
            total += Box((low,), (high,)).support([w], -1)[0]
            continue
        limited = False
        total += w * sp.Max(low, sp.Min(high, 0))
    return total, limited


def _later_condition(system: System, c: ViabilityCondition, value: sp.Expr) -> ViabilityCondition:
    """P <= 0 as a constraint of relative degree 1, under disturbances that do not change."""
    inputs = [q.symbol for q in system.inputs]
    rate = system.derivative(value)
    slopes = derivatives(rate, inputs)
    effect = tuple(slopes.values())
    if symbols_of(effect) & set(inputs):
        raise DefinitionError(
            f"the inputs of system '{system.name}' do not appear affinely in the derivatives of "
            f"'{c.name}', of which some have an input in the first and others in the second",
            remedy=_in_place_of(slopes),
        )
    (drift,) = exchanged([rate], dict.fromkeys(inputs, sp.S.Zero))
    disturbances = [q.symbol for q in system.disturbances]
    carried = tuple(derivatives(drift, disturbances).values())
    return ViabilityCondition(
        name=c.name,
        value=value,
        gradient=tuple(derivatives(value, [q.symbol for q in system.states]).values()),
        rate=drift,
        effect=effect,
        carried=carried,
        drift=drift,
        affine=not symbols_of([*effect, *carried]) & set(disturbances),
        relative_degree=1,
        by_input=tuple(0 if is_zero(e) else 1 for e in effect),
        ties=(),
    )
