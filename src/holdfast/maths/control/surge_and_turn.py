"""Vehicles with surge and turn rate in a current: the systems of chapter 3."""

from __future__ import annotations

import math
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import clip, magnitude, select

_TINY = sp.Float(1e-12)


@dataclass(frozen=True)
class SurgeAndTurn:
    """x' = u cos(psi) + ..., y' = u sin(psi) + ..., psi' = r, with the current added.

    u and r are inputs, or states that inputs track. `current` are its components along x and y,
    `reads` the states that the motion of the position depends on, `limits` the parameters
    speed_limit [m/s] and turn_limit [rad/s].
    """

    system: System
    current: tuple[Quantity, ...]
    reads: tuple[Quantity, ...]
    limits: tuple[Parameter, ...]

    def position_rates(
        self, surge: sp.Expr, current: tuple[sp.Expr, sp.Expr]
    ) -> tuple[sp.Expr, sp.Expr]:
        """(x', y') at a surge and a current, from the system's own rates."""
        moving = (symbol("u"), *(q.symbol for q in self.current))
        values = dict(zip(moving, (surge, *current), strict=True))
        x, y = (self.system.rates[n].subs(values, simultaneous=True) for n in ("x", "y"))
        return x, y

    def within_speed(self, surge: sp.Expr) -> sp.Expr:
        """The surge saturated at speed_limit."""
        return clip(surge, -symbol("speed_limit"), symbol("speed_limit"))

    def within_turn(self, turn: sp.Expr) -> sp.Expr:
        """The turn rate saturated at turn_limit."""
        return clip(turn, -symbol("turn_limit"), symbol("turn_limit"))

    def along(
        self, direction: sp.Expr, surge: sp.Expr, current: tuple[sp.Expr, sp.Expr]
    ) -> tuple[sp.Expr, sp.Expr]:
        """The reduced surge, and d/dt of a direction phi(x, y) at that surge.

            sigma = the largest in [0, 1] with |sigma a + b| <= 0.8 turn_limit

        In d/dt phi = a + b, a is proportional to the surge, and b comes from the current and other
        velocities. If the direction turns faster than the vehicle can, the surge is reduced:
        saturating the turn rate instead would make lines other than the field's attractive.
        """
        slope = [direction.diff(symbol(n)) for n in ("x", "y")]
        zero = sp.S.Zero
        drift = _along(slope, self.position_rates(zero, current))
        moved = _along(slope, self.position_rates(surge, (zero, zero)))
        by_surge = moved - _along(slope, self.position_rates(zero, (zero, zero)))
        most = sp.Rational(4, 5) * symbol("turn_limit")
        room = select(by_surge, most - drift, most + drift)
        slower = clip(room / (magnitude(by_surge) + _TINY), zero, sp.S.One)
        return slower * surge, slower * by_surge + drift


def _along(slope: list[sp.Expr], rates: tuple[sp.Expr, sp.Expr]) -> sp.Expr:
    return sp.Add(*(s * r for s, r in zip(slope, rates, strict=True)))


def measured_current(law: str, system: System) -> tuple[Quantity, ...]:
    """The components of the current along x and y; `DefinitionError` for a system without them."""
    current = system.current_along("x", "y")
    if current is None:
        raise DefinitionError(
            f"{law} has to measure the current, but system '{system.name}' has none",
            expected="disturbances of the role \"current\" that are added to x' and y'",
            remedy='say it of the disturbances: role="current"',
        )
    return current


def surge_and_turn(
    law: str, system: System, speed_limit: float | None, turn_limit: float | None
) -> SurgeAndTurn:
    """The system as a vehicle that surges and turns.

    The limits are the system's parameters if it has them. Otherwise they must be given: the
    largest values that the vehicle can follow. Raises `DefinitionError` for another kind of
    system, or limits that are missing or given twice.
    """
    names = {q.name for q in system.states + system.inputs}
    cos, sin = sp.cos(symbol("psi")), sp.sin(symbol("psi"))
    current = system.current_along("x", "y") or ()
    fits = {"x", "y", "psi", "u", "r"} <= names and bool(current)
    if fits:  # the other velocities depend neither on u nor on states that are inputs
        moved = zip(("x", "y"), (cos, sin), current, strict=True)
        rest = [sp.expand(system.rates[n] - symbol("u") * e - q.symbol) for n, e, q in moved]
        driven = [*system.inputs, *system.disturbances]
        barred = {q.symbol for q in driven} | {symbol("u")}
        fits = not any(e.free_symbols & barred for e in rest)
        fits = fits and sp.expand(system.rates["psi"] - symbol("r")) == 0
    if not fits:
        raise DefinitionError(
            f"law '{law}' is not made for system '{system.name}'",
            expected="x' = u cos(psi) + ..., y' = u sin(psi) + ..., psi' = r, and disturbances "
            "of the role \"current\" that are added to x' and y', as of 'drifting_unicycle' or "
            "'marine_vehicle'",
        )
    used = system.rates["x"].free_symbols | system.rates["y"].free_symbols
    named = {symbol("x"), symbol("y"), symbol("psi")} | (used - {symbol("u")})
    stated = {p.name: p for p in system.parameters}
    limits = []
    for name, unit, value, meaning in (
        ("speed_limit", "m/s", speed_limit, "largest requested surge"),
        ("turn_limit", "rad/s", turn_limit, "largest requested turn rate"),
    ):
        if value is not None and not math.isfinite(value):
            raise DefinitionError(f"{name} of law '{law}' is {value}", expected="a finite number")
        if value is None and name not in stated:
            raise DefinitionError(
                f"law '{law}' needs {name} [{unit}]: system '{system.name}' has none of its own",
                expected="the largest value that the vehicle can follow",
            )
        limit = stated.get(name)
        if value is not None and (limit is None or limit.value != value):
            if limit is not None:
                raise DefinitionError(
                    f"{name} of law '{law}' is {value:g}, system '{system.name}' has "
                    f"{limit.value:g}",
                    remedy="give it only to the system",
                )
            limit = Parameter(name, unit, meaning, value=value, above=0.0)
        assert limit is not None
        limits.append(limit)
    reads = tuple(q for q in system.states if q.symbol in named)
    return SurgeAndTurn(system, current, reads, tuple(limits))
