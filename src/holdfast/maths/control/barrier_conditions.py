"""Barrier conditions: the derivatives of a region's inequalities that the inputs act on.

    c_j(q) <= 0,   d/dt c_j = grad c_j . f(q, u, d)                      thesis (5.11)-(5.13)

If no input appears in d/dt c_j, the second derivative takes its place.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.control.outward_rates import check_reads
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest, least, magnitude, select, sgn
from holdfast.maths.expressions.random_points import is_zero
from holdfast.maths.expressions.traversal import derivatives, exchanged

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

    |x| <= 1 and max(a, b) <= 0 are two pieces each. Raises `DefinitionError` when the region
    reads a quantity that the system lacks, an input does not appear affinely, or neither the
    first nor the second derivative contains an input (relative degree above 2).
    """
    check_reads(system, region)
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
    for kink in sorted(expression.atoms(greatest, magnitude), key=sp.default_sort_key):
        inner = sp.Dummy(real=True)
        slope = expression.xreplace({kink: inner}).diff(inner).subs(values)
        if slope.is_number and slope > 0:
            a = kink.args[0]
            b = kink.args[1] if isinstance(kink, greatest) else -a
            yield expression.xreplace({kink: a}), expression.xreplace({kink: b})


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
            f"the inputs of system '{system.name}' do not appear affinely in the rate of '{name}'"
        )
    undriven, drift = exchanged([rate, driven], still)
    carried = tuple(derivatives(drift, disturbances).values())
    mixed = [*effect, *carried, *((rate,) if degree == 2 else ())]
    affine = not any(e.free_symbols & set(disturbances) for e in mixed)
    by_input = tuple(1 if a else 2 * b for a, b in zip(at_once, later, strict=True))
    return ViabilityCondition(
        name=name,
        value=value,
        gradient=tuple(value.diff(q.symbol) for q in system.states),
        rate=undriven,
        effect=effect,
        carried=carried,
        drift=drift,
        affine=affine,
        relative_degree=degree,
        by_input=by_input,
        ties=tuple(
            k.args[0] - k.args[1] if isinstance(k, (least, greatest)) else k.args[0]
            for k in sorted(
                value.atoms(least, greatest, magnitude, select, sgn), key=sp.default_sort_key
            )
        ),
    )
