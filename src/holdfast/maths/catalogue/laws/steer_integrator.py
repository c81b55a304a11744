"""Steer Brockett's nonholonomic integrator to the origin: two laws of the thesis."""

from __future__ import annotations

import math

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.nonholonomic_integrator import nonholonomic_integrator
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import TIME_IN_MODE, Parameter, symbol
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.definitions.system import System, check_rates
from holdfast.maths.expressions.functions import greatest, least, length, magnitude, select, sgn

STEER, ESCAPE = "steer", "escape"
LATE = "an input that is held and late overshoots"
_TINY = sp.Float(1e-300)


@checked
def steer_integrator(
    system: System,
    *,
    k1: float = 2.5,
    k2: float = 1.0,
    escape_gain: float = 2.0,
    escape_least: float = 0.05,
    escape_time: float = 0.5,
    input_limit: float = 5.0,
    rest: float = 1e-6,
) -> Switching:
    """Steer the nonholonomic integrator to the origin along the consistency errors x3, x2.

        u1 = -k2 x1 + k1 x3 x2 / rho^2,   u2 = -k2 x2 - k1 x3 x1 / rho^2     (4.20), (4.19)

    with rho^2 = x1^2 + x2^2. Then x3 and rho decay exactly as exp(-k1 t) and exp(-k2 t), so
    the inputs stay bounded only for k1 > k2 (refused otherwise) and the spin k1 x3 / rho^2
    only for k1 > 2 k2 (warned). Where the inputs would pass `input_limit`, as on x1 = x2 = 0,
    u1 = u2 = -escape_gain sgn(x3) max(|x3|, escape_least) is held for `escape_time` [s] first.
    The test is on the size of the input, not x1 = x2 = 0, and the escape has a least length,
    since the later spin would otherwise grow as 1 / |x3|. There |x3| <= `rest` counts as zero and
    causes no escape.
    """
    check_rates("steer_integrator", system, nonholonomic_integrator)
    if not k1 > k2:
        raise DefinitionError(
            f"k1 = {k1:g}, k2 = {k2:g}: the inputs grow as exp((k2 - k1) t)",
            expected="k1 > k2, and k1 > 2 k2 for a bounded spin",
        )
    x1, x2, x3 = (symbol(n) for n in ("x1", "x2", "x3"))
    s = {n: symbol(n) for n in ("k1", "k2", "escape_gain", "escape_time", "input_limit")}
    s |= {n: symbol(n) for n in ("escape_least", "rest")}
    squared = x1**2 + x2**2 + _TINY
    spin = s["k1"] * x3 / squared
    escape = -s["escape_gain"] * sgn(x3) * greatest(magnitude(x3), s["escape_least"])
    excess = s["k1"] * magnitude(x3) - s["input_limit"] * length(x1, x2, _TINY)
    return _switching(
        "steer_integrator",
        system,
        steer={
            "u1": -s["k2"] * x1 + select(-excess, spin * x2, sp.S.Zero),
            "u2": -s["k2"] * x2 - select(-excess, spin * x1, sp.S.Zero),
        },
        escape={"u1": escape, "u2": escape},
        excess=excess,
        rest=magnitude(x3) - s["rest"],
        parameters=(
            Parameter("k1", "1/s", "decay rate of x3", value=k1, above=0, gain=True),
            Parameter("k2", "1/s", "decay rate of x1 and x2", value=k2, above=0, gain=True),
            Parameter("escape_gain", "1/s", "gain while escaping", value=escape_gain, above=0),
            Parameter(
                "escape_least", "1", "least |x3| of the escape", value=escape_least, above=0.0
            ),
            Parameter("rest", "1", "|x3| that counts as zero", value=rest, above=0.0),
            *_escape(escape_time, input_limit),
        ),
        rates=("k1", "k2"),
        condition=GainCondition(
            2 * s["k2"], s["k1"], "the spin k1 x3 / rho^2 grows without bound", "thesis (4.19)"
        ),
        description="go to the origin of the nonholonomic integrator, x3 first",
        source="thesis (4.18)-(4.20), with the timed escape",
    )


@checked
def follow_integrator(
    system: System,
    *,
    k: float = 3.0,
    k1: float = 1.0,
    k2: float = 1.0,
    k3: float = 1.0,
    escape_time: float = 1.0,
    input_limit: float = 10.0,
) -> Switching:
    """Steer the nonholonomic integrator by the output h = x1 x3 of the field F = (p . q) q.

        u1 = -k1 x1,   u2 = -(k - k1) x3 / x1 - k1 x2,    hence hdot = -k h   (2.20), (2.21)

    x3 / x1 decays as exp(-(k - 2 k1) t): k > 2 k1 is refused otherwise (the thesis asks for
    k > k1 only, from which x2 does not converge). Where u2 would pass `input_limit`, as on
    x1 = 0, u1 = -k3 x3, u2 = -k2 x2 is held for at least `escape_time` [s].
    """
    check_rates("follow_integrator", system, nonholonomic_integrator)
    if not k > 2 * k1:
        raise DefinitionError(
            f"k = {k:g}, k1 = {k1:g}: x3 / x1 goes as exp((2 k1 - k) t) and x2 with it",
            expected="k > 2 k1",
        )
    x1, x2, x3 = (symbol(n) for n in ("x1", "x2", "x3"))
    s = {n: symbol(n) for n in ("k", "k1", "k2", "k3", "escape_time", "input_limit")}
    surplus = s["k"] - s["k1"]
    return _switching(
        "follow_integrator",
        system,
        steer={"u1": -s["k1"] * x1, "u2": -surplus * x3 / x1 - s["k1"] * x2},
        escape={"u1": -s["k3"] * x3, "u2": -s["k2"] * x2},
        excess=surplus * magnitude(x3) - s["input_limit"] * magnitude(x1),
        parameters=(
            Parameter("k", "1/s", "decay rate of the output h", value=k, above=0, gain=True),
            Parameter("k1", "1/s", "decay rate of x1", value=k1, above=0, gain=True),
            Parameter("k2", "1/s", "decay rate of x2 while escaping", value=k2, above=0, gain=True),
            Parameter("k3", "1/s", "gain of x3 while escaping", value=k3, above=0),
            *_escape(escape_time, input_limit),
        ),
        rates=("k", "k1"),
        condition=GainCondition(
            2 * s["k1"], s["k"], "x3 / x1 grows and x2 does not converge", "thesis (2.21)"
        ),
        description="go to the origin of the nonholonomic integrator along a radial field",
        source="thesis (2.20), (2.21), with the gain condition corrected",
    )


def _escape(escape_time: float, input_limit: float) -> tuple[Parameter, Parameter]:
    return (
        Parameter("escape_time", "s", "time of escaping", value=escape_time, above=0.0),
        Parameter(
            "input_limit", "1/s", "input that starts an escape", value=input_limit, above=0.0
        ),
    )


def _switching(
    name: str,
    system: System,
    *,
    steer: dict[str, sp.Expr],
    escape: dict[str, sp.Expr],
    excess: sp.Expr,
    rest: sp.Expr = sp.S.One,
    parameters: tuple[Parameter, ...],
    rates: tuple[str, ...],
    condition: GainCondition,
    description: str,
    source: str,
) -> Switching:
    """Two modes; `excess` >= 0 where the steering input would be too large.

    No escape where `rest` < 0.
    """

    conditions = (condition, *held_gain(*rates, consequence=LATE))

    def law(mode: str, outputs: dict[str, sp.Expr]) -> Law:
        return Law(mode, system.states, outputs, parameters, conditions=conditions)

    done = least(TIME_IN_MODE - symbol("escape_time"), -excess - sp.Float(math.ulp(0.0)))
    return Switching(
        name=name,
        modes={STEER: law(STEER, steer), ESCAPE: law(ESCAPE, escape)},
        transitions=(
            Transition(STEER, ESCAPE, least(excess, rest)),
            Transition(ESCAPE, STEER, done),
        ),
        description=description,
        source=source,
    )
