"""Steer driftless systems to the origin: unicycle, nonholonomic integrator, chained form.

Others are steered through chained coordinates that are found by search.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.driftless import (
    chained_form,
    nonholonomic_integrator,
    unicycle,
)
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import TIME_IN_MODE, Parameter, symbol
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.definitions.system import System, check_rates
from holdfast.maths.expressions.functions import (
    greatest,
    least,
    length,
    magnitude,
    select,
    sgn,
    wrap,
)
from holdfast.maths.nonholonomic.chained_feedback import (
    Pole,
    slowed_down,
    steer_in_chained_coordinates,
)
from holdfast.maths.nonholonomic.chained_search import find_chained_form
from holdfast.maths.nonholonomic.structure import structure
from holdfast.maths.reference_fields.dipole import UNSEEN, dipolar_field, field_angle

DISTANCE = "a speed that is held and late overshoots the origin"


@checked
def steer_unicycle(
    system: System, *, k1: float = 1.0, k: float = 4.0, lam: float = 3.0, freeze: float = 1e-4
) -> Law:
    """Steer a unicycle to the origin with heading 0 along a dipolar field.

        v = -k1 sgn(x cos(psi) + y sin(psi)) rho sigma                            (4.14)
        r = -k wrap(psi - phi) + d/dt phi,   phi the direction of F               (4.13)
        sigma = min(1, 0.8 turn_limit / |d/dt phi|)

    rho = |(x, y)|, at most speed_limit / k1. The factor sigma slows the vehicle where the
    field turns faster than the vehicle can: without it a bounded turn rate makes the line
    x cos(psi) + y sin(psi) = 0 attractive and many starts do not converge. For rho < `freeze`
    [m], where phi is not defined, v = 0 and r = -k psi. Gains k1, k [1/s], lam > 1.
    """
    x, y, psi = _pose("steer_unicycle", system)
    s = {n: symbol(n) for n in ("k1", "k", "lam", "freeze", "speed_limit", "turn_limit")}
    rho = length(x, y, UNSEEN)
    forward = -_towards(x, y, psi) * least(s["k1"] * rho, s["speed_limit"])
    field = dipolar_field((x, y), s["lam"], (1, 0))
    phi = field_angle(field, UNSEEN)
    turn = forward * (phi.diff(x) * sp.cos(psi) + phi.diff(y) * sp.sin(psi))
    slower = least(1, sp.Rational(4, 5) * s["turn_limit"] / (magnitude(turn) + sp.Float(1e-12)))
    outside = rho - s["freeze"]
    return Law(
        name="steer_unicycle",
        reads=system.states,
        outputs={
            "v": select(outside, slower * forward, sp.S.Zero),
            "r": select(outside, -s["k"] * wrap(psi - phi) + slower * turn, -s["k"] * wrap(psi)),
        },
        parameters=(
            Parameter("k1", "1/s", "gain of the distance", value=k1, above=0, gain=True),
            Parameter("k", "1/s", "heading gain", value=k, above=0, gain=True),
            Parameter("lam", "1", "exponent lambda of the dipolar field", value=lam, above=1),
            Parameter("freeze", "m", "distance of the final turn", value=freeze, above=0),
            *system.quantities(("speed_limit", "turn_limit"), "steer_unicycle"),  # type: ignore[arg-type]
        ),
        conditions=held_gain("k1", consequence=DISTANCE) + held_gain("k"),
        description="go to the origin with heading 0 along a dipolar field, within input limits",
        source="thesis (4.13), (4.14), with speed scaling",
    )


@checked
def align_unicycle(
    system: System,
    *,
    k: float = 2.0,
    epsilon: float = 0.05,
    freeze: float = 1e-4,
    output: str = "angle",
    travel: str = "toward",
) -> Law:
    """Steer a unicycle along the field (2.14) at the speed tanh(rho).

        F = (2 cos^2 phi - sin^2 phi, 3 sin phi cos phi),  phi = atan2(y, x)     (2.14)

    output: "h" is hdot = -k h for h = <a, F> (2.15), with the sign of the second term corrected to
    plus; where |dh/dpsi| <= `epsilon`, r = k wrap(psi_F - psi) (2.16). h = 0 also means the
    opposite heading, and the vehicle may arrive with it. "angle": r = -k wrap(psi - psi_F) + d/dt
    psi_F, which is free of both. travel: "forward" is the thesis's v = tanh(rho), with which some
    starts leave on lines that lead far away; "toward" takes the sense of (4.14). freeze [m]: for a
    rho below it, v = 0 and r = -k psi. k in 1/s.

    Raises `DefinitionError` for another system, output or travel.
    """
    for what, value, choices in (
        ("output", output, ("h", "angle")),
        ("travel", travel, ("toward", "forward")),
    ):
        if value not in choices:
            raise DefinitionError(
                f"{what} of align_unicycle is {value!r}", expected=" or ".join(map(repr, choices))
            )
    x, y, psi = _pose("align_unicycle", system)
    s = {n: symbol(n) for n in ("k", "epsilon", "freeze")}
    rho = length(x, y, UNSEEN)
    speed = sp.tanh(rho)
    forward = speed if travel == "forward" else -_towards(x, y, psi) * speed
    squared = x**2 + y**2 + UNSEEN
    field = ((2 * x**2 - y**2) / squared, 3 * x * y / squared)
    heading = field_angle(field, UNSEEN)
    error = wrap(psi - heading)

    def rate(e: sp.Expr) -> sp.Expr:
        return forward * (e.diff(x) * sp.cos(psi) + e.diff(y) * sp.sin(psi))

    turn = -s["k"] * error + rate(heading)
    if output == "h":
        h = -sp.sin(psi) * field[0] + sp.cos(psi) * field[1]
        slope = h.diff(psi)
        regular = magnitude(slope) - s["epsilon"]
        aligned = (-s["k"] * h - rate(h)) / select(regular, slope, sp.S.One)
        turn = select(regular, aligned, -s["k"] * error)
    outside = rho - s["freeze"]
    return Law(
        name="align_unicycle",
        reads=system.states,
        outputs={
            "v": select(outside, forward, sp.S.Zero),
            "r": select(outside, turn, -s["k"] * wrap(psi)),
        },
        parameters=(
            Parameter("k", "1/s", "decay rate of the misalignment", value=k, above=0, gain=True),
            Parameter("epsilon", "1", "least |dh/dpsi| to divide by", value=epsilon, above=0),
            Parameter("freeze", "m", "distance of the final turn", value=freeze, above=0),
        ),
        conditions=held_gain("k"),
        description="go to the origin along the field of a point dipole, at bounded speed",
        source="thesis (2.14)-(2.16), corrected, and (4.14)",
        empirical="the speed of the thesis is tanh of a distance in metres",
    )


def _pose(law: str, system: System) -> tuple[sp.Symbol, sp.Symbol, sp.Symbol]:
    check_rates(law, system, unicycle)
    return symbol("x"), symbol("y"), symbol("psi")


def _towards(x: sp.Expr, y: sp.Expr, psi: sp.Expr) -> sp.Expr:
    return sgn(x * sp.cos(psi) + y * sp.sin(psi))


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

    Raises `DefinitionError` for another system, and unless k1 > k2.
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

    Raises `DefinitionError` for another system, and unless k > 2 k1.
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


@checked
def steer_chained(
    system: System,
    *,
    k1: float = 1.0,
    poles: Pole | Sequence[Pole] | None = None,
    gains: Sequence[float] | None = None,
    threshold: float = 0.9,
    escape_speed: float = 3.0,
    escape_time: float = 1.0,
    escape: str = "steer",
    stop: float = 1e-9,
) -> Switching:
    """Steer a chained form of any dimension to the origin.

        u1 = -k1 x1,    u2 = -k2 x2 + sum_(j = 3 ... n) (-1)^(j+1) kj xj / x1^(j-2)

    Thesis (4.29) for n = 3 (where k3 = k1 + k2) and (4.30) for n = 4. The ratios xj / x1^(j-2) obey
    an exactly linear closed loop, whose poles are chosen. poles [1/s]: one number for all (-2 by
    default), or a list of n - 1 (a complex one as a pair [re, im]). gains: (k2, ..., kn) in their
    place, which are refused unless that loop is stable. From |x1| < `threshold` the law first
    drives x1 away at `escape_speed` for `escape_time` [s]; it stops at |x1| <= `stop`. escape: what
    it does meanwhile: "steer" brings the other states to zero, "coast" is the thesis's u2 = 0.
    """
    n = len(system.states)
    check_rates("steer_chained", system, chained_form, n)
    one, zero = sp.S.One, sp.S.Zero
    return steer_in_chained_coordinates(
        "steer_chained",
        system.states,
        [q.symbol for q in system.states],
        {"u1": (one, zero), "u2": (zero, one)},
        k1=k1,
        poles=poles,
        gains=gains,
        threshold=threshold,
        escape_speed=escape_speed,
        escape_time=escape_time,
        escape=escape,
        stop=stop,
        description="go to the origin of a chained form of any dimension",
        source="thesis (4.29), (4.30), with the exact gain condition",
    )


@checked
def steer_by_chained_form(
    system: System,
    *,
    k1: float = 1.0,
    poles: Pole | Sequence[Pole] | None = None,
    gains: Sequence[float] | None = None,
    threshold: float = 0.9,
    escape_speed: float = 3.0,
    escape_time: float = 1.0,
    escape: str = "steer",
    stop: float = 1e-9,
) -> Switching:
    """Steer a system to the origin through chained coordinates z(q), found by search.

        v1 = -k1 z1,   v2 = -k2 z2 + sum_(j = 3 ... n) (-1)^(j+1) kj zj / z1^(j-2)

    with z1 and zn two of the states and z_(j-1) = L_g1 z_j / L_g1 z1 (`chained_search`), and poles,
    gains and escape as in `steer_chained`. Local: to the states where the transformation is regular
    (for cars and trailers, angles between bodies and to the x axis below 90 deg), which the closed
    loop does not leave.

    Where the system has bounds of its inputs, all inputs are slowed by one factor, so that the
    largest is within them: the path is the same, and takes longer.

    poles [1/s], gains, escape: as in `steer_chained`.

    Raises `DefinitionError` when no pair of states begins and ends a chain, with the reason.
    """
    constraint = structure(system)
    search = find_chained_form(constraint)
    if search.found is None:
        raise DefinitionError(
            f"no chained coordinates found for system '{system.name}': {search.reason}"
        )
    form = search.found.written_out()
    law = steer_in_chained_coordinates(
        "steer_by_chained_form",
        constraint.coordinates,
        form.coordinates,
        {u.name: ab for u, ab in zip(constraint.inputs, form.coefficients, strict=True)},
        k1=k1,
        poles=poles,
        gains=gains,
        threshold=threshold,
        escape_speed=escape_speed,
        escape_time=escape_time,
        escape=escape,
        stop=stop,
        parameters=system.parameters,
        description="go to the origin through chained coordinates that are derived",
        source="R. M. Murray and S. S. Sastry, IEEE TAC 38(5), 1993 (chained form); "
        "thesis (4.30) with the exact gain condition",
    )
    if system.input_bounds is None:
        return law
    return law.map_laws(
        lambda mode: replace(mode, outputs=slowed_down(system, mode.outputs)), law.name
    )
