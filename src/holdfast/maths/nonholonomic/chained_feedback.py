"""Steering in chained coordinates: the exact linear closed loop, its gains, its modes.

For z1' = v1, z2' = v2, zj' = z(j-1) v1 the feedback

    v1 = -k1 z1,    v2 = -k2 z2 + sum_(j = 3 ... n) (-1)^(j+1) kj zj / z1^(j-2)

makes y = (z2, z3/z1, ..., zn/z1^(n-2)) obey y' = M y with constant M, exactly:

    row of z2: (-k2, k3, -k4, ...),     row of zj: -k1 below the diagonal, (j-2) k1 on it.

Thesis (4.29), (4.30) are the cases n = 3, 4; it asks that the matrix with z1 frozen be
Hurwitz, which is M without the diagonal entries (j-2) k1 and does not decide stability.

Inputs are kept within their bounds by one factor for all of them: the path stays, the pace falls.

    u' = sigma u,   sigma = min(1, b_i / (n_i . u))  over half-spaces n_i . u <= b_i, n_i . u > 0

A system without drift, q' = G(q) u, follows the same path under sigma(q) u > 0 as under u, at
another pace. Limiting input by input would make it another path.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mpmath
import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.control.gain_conditions import MOST, held_gain
from holdfast.maths.definitions.extension import per_second
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import (
    DELAY,
    SAMPLE_TIME,
    TIME,
    TIME_IN_MODE,
    Parameter,
    Quantity,
    symbol,
)
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.units import Units, unit_text
from holdfast.maths.expressions.functions import greatest, least, magnitude, sgn


def can_stop(system: System) -> bool:
    """Whether the bounds of the inputs, if there are any, have 0 inside."""
    numbers = {p.symbol: p.value for p in system.parameters}
    rows = system.input_bounds.half_spaces() if system.input_bounds is not None else []
    return all(float(sp.sympify(limit).xreplace(numbers)) > 0 for _, limit in rows)


def slowed_down(system: System, inputs: Mapping[str, sp.Expr]) -> dict[str, sp.Expr]:
    """`inputs`, by name, times the largest factor up to 1 that keeps them within their bounds.

    A system without bounds gives the inputs as they are. Raises `DefinitionError` for bounds that
    are no polytope, or that do not have 0 inside.
    """
    if not can_stop(system):
        raise DefinitionError(
            f"the inputs of system '{system.name}' cannot be slowed down",
            expected="bounds with 0 inside: a vehicle that can stop",
        )
    rows = system.input_bounds.half_spaces() if system.input_bounds is not None else []
    values = [inputs[name] for name in system.input_names]
    share: sp.Expr = sp.S.One
    for normal, limit in rows:
        along = sp.Add(*(n * u for n, u in zip(normal, values, strict=True)))
        share = least(share, limit / greatest(limit, along))
    return {name: share * inputs[name] for name in system.input_names}


ESCAPE, STEER, STOP = "escape", "steer", "stop"

Pole = float | complex | Sequence[float]

POLE = -2.0
"""The default of all poles of M [1/s]."""


def closed_loop_matrix(k1: sp.Expr, gains: Sequence[sp.Expr], *, frozen: bool = False) -> sp.Matrix:
    """M of the module's first lines, for gains (k2, ..., kn); with `frozen`, the matrix the
    thesis examines: z1 held still (its entries scaled to z1 = 1, which keeps the spectrum)."""
    size = len(gains)
    m = sp.zeros(size, size)
    for column, gain in enumerate(gains):
        m[0, column] = -gain if column % 2 == 0 else gain
    for row in range(1, size):
        m[row, row - 1] = -k1
        m[row, row] = 0 if frozen else row * k1
    return m


def eigenvalues(matrix: sp.Matrix) -> list[complex]:
    """The eigenvalues of a matrix of numbers, by decreasing real part."""
    with mpmath.workdps(40):
        values, _ = mpmath.eig(mpmath.matrix(matrix.tolist()))
    numbers = [complex(v) for v in values]
    return sorted(
        (complex(round(z.real, 12) + 0.0, round(z.imag, 12) + 0.0) for z in numbers),
        key=lambda z: (-z.real, z.imag),
    )


def gains_for_poles(k1: float, poles: Sequence[Pole]) -> tuple[float, ...]:
    """The gains (k2, ..., kn) that give M the n - 1 `poles` [1/s], exactly.

    With P_n = 1, P_(j-1) = -(s - (j-2) k1) P_j / k1 the characteristic polynomial of M is,
    up to its leading coefficient, s P_2 + k2 P_2 - sum (-1)^(j+1) kj P_j: a triangular system
    for the gains. A complex pole is a complex number or a pair [re, im] and comes with its
    conjugate. Raises `DefinitionError` for fewer than two poles, poles without their
    conjugates or not in the left half-plane, or k1 <= 0.
    """
    _check_rate(k1)
    values = [_as_pole(p) for p in poles]
    if len(values) < 2:
        raise DefinitionError(f"{len(values)} poles", expected="one for each state but x1")
    for z in values:
        if values.count(z) != values.count(z.conjugate()):
            raise DefinitionError(f"the pole {_listed([z])} comes without its conjugate")
        if not z.real < 0:
            raise DefinitionError(f"the pole {_listed([z])}", expected="a negative real part")
    s = sp.Symbol("s")
    exact = [sp.Rational(z.real) + sp.I * sp.Rational(z.imag) for z in values]
    n, rate = len(values) + 1, sp.Rational(k1)
    p = {n: sp.Poly(1, s)}
    for j in range(n, 2, -1):
        p[j - 1] = p[j] * sp.Poly(-(s - (j - 2) * rate) / rate, s)
    wanted = sp.Poly(sp.expand(sp.prod([s - z for z in exact])), s) * p[2].LC()
    rest = wanted - sp.Poly(s, s) * p[2]
    gains = []
    for j in range(2, n + 1):
        sign = 1 if j == 2 else -((-1) ** (j + 1))
        gain = sp.re(rest.coeff_monomial(s ** (n - j))) / (sign * p[j].LC())
        rest -= sp.Poly(sign * gain, s) * p[j]
        gains.append(float(gain))
    return tuple(gains)


def polynomial(roots: Sequence[complex]) -> tuple[float, ...]:
    """The coefficients of prod (s - root) after the leading one, by falling power."""
    coefficients = [1.0 + 0.0j]
    for root in roots:
        shifted = [-root * c for c in coefficients]
        coefficients = [a + b for a, b in zip([*coefficients, 0.0j], [0.0j, *shifted], strict=True)]
    return tuple(c.real for c in coefficients[1:])


def _check_rate(k1: object) -> None:
    if not (isinstance(k1, (int, float)) and math.isfinite(k1) and k1 > 0):
        raise DefinitionError(f"k1 is {k1}", expected="k1 > 0")


def _as_pole(value: object) -> complex:
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2:
        parts = list(value)
    elif isinstance(value, (int, float, complex)) and not isinstance(value, bool):
        parts = [complex(value).real, complex(value).imag]
    else:
        parts = [math.nan]
    numbers = [p for p in parts if isinstance(p, (int, float)) and math.isfinite(p)]
    if len(numbers) != 2:
        raise DefinitionError(f"the pole {value!r}", expected="a number or a pair [re, im]")
    return complex(*numbers)


def checked_gains(k1: float, gains: Sequence[float], n: int) -> tuple[float, ...]:
    """The gains (k2, ..., kn) as they are, if they make M Hurwitz.

    Raises `DefinitionError` with the true eigenvalues otherwise, and with those of the
    frozen matrix where that one is Hurwitz and misleads.
    """
    listed = list(gains) if isinstance(gains, Sequence) and not isinstance(gains, str) else []
    numbers = [
        float(g)
        for g in listed
        if isinstance(g, (int, float)) and not isinstance(g, bool) and math.isfinite(g)
    ]
    if len(numbers) != n - 1 or len(listed) != n - 1:
        raise DefinitionError(f"the gains are {gains!r}", expected=f"{n - 1} numbers, k2 to k{n}")
    _check_rate(k1)
    rational = [sp.Rational(g) for g in numbers]
    true = eigenvalues(closed_loop_matrix(sp.Rational(k1), rational))
    if true[0].real < 0:
        return tuple(numbers)
    frozen = eigenvalues(closed_loop_matrix(sp.Rational(k1), rational, frozen=True))
    note = (
        f" (with x1 frozen, as the thesis argues, they are {_listed(frozen)}: that does not decide)"
        if frozen[0].real < 0
        else ""
    )
    raise DefinitionError(
        f"with k1 = {k1:g} and gains ({', '.join(f'{g:g}' for g in numbers)}) the closed loop "
        f"has the eigenvalues {_listed(true)}{note}",
        expected="all in the left half-plane",
        remedy="give poles instead of gains (--set law.gains= takes them away)",
    )


def _listed(values: Sequence[complex]) -> str:
    return ", ".join(f"{z.real:.4g}" if z.imag == 0 else f"{z:.4g}" for z in values)


def chained_feedback(z: Sequence[sp.Expr], gains: Sequence[sp.Expr]) -> sp.Expr:
    """v2 of the module's first lines for gains (k2, ..., kn), in the coordinates z."""
    terms = [-gains[0] * z[1]]
    for j in range(3, len(z) + 1):
        terms.append((-1) ** (j + 1) * gains[j - 2] * z[j - 1] / z[0] ** (j - 2))
    return sp.Add(*terms)


def steer_in_chained_coordinates(
    name: str,
    reads: tuple[Quantity, ...],
    z: Sequence[sp.Expr],
    inputs: Mapping[str, tuple[sp.Expr, sp.Expr]],
    *,
    k1: float,
    poles: Pole | Sequence[Pole] | None,
    gains: Sequence[float] | None,
    threshold: float,
    escape_speed: float,
    escape_time: float,
    escape: str,
    stop: float,
    parameters: Sequence[Parameter] = (),
    description: str = "",
    source: str = "",
) -> Switching:
    """The law of this module in coordinates z(q), as a `Switching` with three modes.

    `inputs` maps each input of the system to its coefficients (a, b): u = a v1 + b v2.
    escape: where |z1| < `threshold` at the start, v1 = escape_speed sgn(z1) for `escape_time`,
    since the feedback divides by z1; meanwhile v2 brings the chain z2 ... zn, which is linear
    at constant v1, to zero with the poles of M (`escape` = "steer"), or is zero as in the
    thesis ("coast"). steer: the feedback. stop: inputs zero once |z1| <= `stop`: flooring the
    division instead leaves an error for ever.

    `poles` is one number for all or a list, by default `POLE`; or `gains` are (k2, ..., kn).
    Raises `DefinitionError` when both are given or the gains do not stabilise.
    """
    n = len(z)
    if escape not in ("steer", "coast"):
        raise DefinitionError(f"escape of '{name}' is {escape!r}", expected="'steer' or 'coast'")
    if gains is not None and poles is not None:
        raise DefinitionError(f"law '{name}' has both poles and gains", expected="one of them")
    if gains is not None:
        chosen = checked_gains(k1, gains, n)
    else:
        poles = POLE if poles is None else poles
        listed = [poles] * (n - 1) if isinstance(poles, (int, float)) else list(_poles(poles))
        if len(listed) != n - 1:
            raise DefinitionError(
                f"{len(listed)} poles for {n} states", expected=f"{n - 1}, or one number for all"
            )
        chosen = _rounded_gains(k1, gains_for_poles(k1, listed), n)
    k = [symbol(f"k{j}") for j in range(1, n + 1)]
    e = [symbol(f"e{j}") for j in range(2, n + 1)]
    true = eigenvalues(closed_loop_matrix(sp.Rational(k1), list(map(sp.Rational, chosen))))
    decay = polynomial(true)
    fastest = sp.Float(max(abs(z) for z in true))
    unit = unit_text(Units(f"law '{name}'", (*reads, *parameters)).of(z[0], "z1"))
    fast, least_size, tiny = (symbol(s) for s in ("escape_speed", "threshold", "stop"))

    def law(mode: str, v1: sp.Expr, v2: sp.Expr) -> Law:
        return Law(
            name=mode,
            reads=reads,
            outputs={u: a * v1 + b * v2 for u, (a, b) in inputs.items()},
            parameters=(
                Parameter("k1", "1/s", "decay rate of z1", value=k1, above=0, gain=True),
                *(
                    Parameter(f"k{j}", "1/s", f"gain of z{j}", value=g)
                    for j, g in enumerate(chosen, start=2)
                ),
                *(
                    Parameter(s.name, f"1/s^{j}", f"gain of z{j + 1} while escaping", value=g)
                    for j, (s, g) in enumerate(zip(e, decay, strict=True), start=1)
                    if escape == "steer"
                ),
                Parameter("threshold", unit, "least |z1| to start from", value=threshold, above=0),
                Parameter(
                    "escape_speed",
                    per_second(unit),
                    "v1 while escaping",
                    value=escape_speed,
                    above=0.0,
                ),
                Parameter("escape_time", "s", "time of escaping", value=escape_time, above=0.0),
                Parameter("stop", unit, "|z1| that counts as arrived", value=stop, above=0.0),
                Parameter("slowest", "1/s", "slowest decay of M", value=-true[0].real, above=0.0),
                *parameters,
            ),
            conditions=(
                GainCondition(
                    k[0],
                    3 * symbol("slowest"),
                    "z1 arrives, and the law stops, before the other states have",
                    "exact linear closed loop",
                ),
                *held_gain("k1", consequence="z1, held and late, overshoots and x1 changes sides"),
                GainCondition(
                    sp.Mul(fastest, SAMPLE_TIME + DELAY, evaluate=False),
                    MOST,
                    "the fastest mode of M, held and late, overshoots",
                    "derived for e' = -k e at the largest |eigenvalue| of M",
                    closed=True,
                ),
            ),
        )

    size, away = magnitude(z[0]), fast * sgn(z[0])
    zero = sp.S.Zero
    straighten = -sp.Add(*(g * c / away**j for j, (g, c) in enumerate(zip(e, z[1:], strict=True))))
    return Switching(
        name=name,
        modes={
            STEER: law(STEER, -k[0] * z[0], chained_feedback(z, k[1:])),
            ESCAPE: law(ESCAPE, away, straighten if escape == "steer" else zero),
            STOP: law(STOP, zero, zero),
        },
        transitions=(
            Transition(STEER, ESCAPE, least(least_size - size, -TIME)),
            Transition(STEER, STOP, tiny - size),
            Transition(ESCAPE, STEER, TIME_IN_MODE - symbol("escape_time")),
        ),
        initial=STEER,
        description=description,
        source=source,
    )


def _rounded_gains(k1: float, gains: tuple[float, ...], n: int) -> tuple[float, ...]:
    """The gains, if rounding them to double precision leaves the loop stable."""
    try:
        return checked_gains(k1, gains, n)
    except DefinitionError as error:
        raise DefinitionError(
            f"the poles cannot be placed in double precision: {error.cause}",
            remedy=f"faster poles (several times k1 = {k1:g}), or fewer states",
        ) from None


def _poles(value: object) -> Sequence[Pole]:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return value
    raise DefinitionError(f"the poles are {value!r}", expected="a number or a list")
