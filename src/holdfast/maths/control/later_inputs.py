"""Inputs that enter a constraint later than others: conditions that keep the earlier ones able.

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
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.control.barrier_conditions import ViabilityCondition, viability_conditions
from holdfast.maths.definitions.bounds import Bounds, Box, LinearImage
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest
from holdfast.maths.expressions.random_points import is_zero
from holdfast.maths.expressions.traversal import derivatives, exchanged, symbols_of

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
    found = _condition(system, c, least - offset)
    beyond = [
        n
        for n, degree in zip(system.input_names, found.by_input, strict=True)
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
    return (normal, greatest(offset, least) if limited else offset), found


@checked
def unused_inputs(system: System, region: Region) -> dict[str, tuple[str, ...]]:
    """Inequality -> inputs that act on it later than by two derivatives: no filter uses them.

    An inequality on whose second derivative another input acts alike at every state has none.
    """
    moving = {q.symbol for q in (*system.states, *system.disturbances)}
    found = {}
    for c in viability_conditions(system, region):
        alike = any(not e.free_symbols & moving and not is_zero(e) for e in c.effect)
        if c.relative_degree > 1 and not alike and (late := _later(system, c)):
            found[c.name] = tuple(late)
    return found


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


def _condition(system: System, c: ViabilityCondition, value: sp.Expr) -> ViabilityCondition:
    """P <= 0 as a constraint of relative degree 1, under disturbances that do not change."""
    inputs = [q.symbol for q in system.inputs]
    rate = system.derivative(value)
    effect = tuple(derivatives(rate, inputs).values())
    if symbols_of(effect) & set(inputs):
        raise DefinitionError(
            f"the inputs of system '{system.name}' do not appear affinely in the derivatives of "
            f"'{c.name}', of which some have an input in the first and others in the second"
        )
    (drift,) = exchanged([rate], dict.fromkeys(inputs, sp.S.Zero))
    disturbances = [q.symbol for q in system.disturbances]
    carried = tuple(derivatives(drift, disturbances).values())
    return ViabilityCondition(
        name=c.name,
        value=value,
        gradient=tuple(value.diff(q.symbol) for q in system.states),
        rate=drift,
        effect=effect,
        carried=carried,
        drift=drift,
        affine=not symbols_of([*effect, *carried]) & set(disturbances),
        relative_degree=1,
        by_input=tuple(0 if is_zero(e) else 1 for e in effect),
        ties=(),
    )
