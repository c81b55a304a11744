"""The part of a system that measurements depend on, with its sensitivities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import DefinitionError, check_name, suggestion
from holdfast.maths.definitions.quantity import TIME, Parameter, Quantity
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import derivatives, symbols_of


@dataclass(frozen=True)
class MeasuredMotion:
    """Rates f and outputs h of the states that a log says something of.

        xdot = f(x, u, v; p),      y = h(x, v)

    states x: those that the outputs depend on, directly or through the rates. unknown v: what is
    estimated, parameters and disturbances. parameters p: known numbers. rates, outputs: f and h, in
    the order of states and of names.
    """

    states: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    unknown: tuple[Quantity, ...]
    parameters: tuple[Parameter, ...]
    rates: tuple[sp.Expr, ...]
    names: tuple[str, ...]
    outputs: tuple[sp.Expr, ...]

    @property
    def columns(self) -> list[sp.Symbol]:
        """The symbols of x, u and v."""
        return [q.symbol for q in (*self.states, *self.inputs, *self.unknown)]

    @property
    def sensitivities(self) -> list[sp.Expr]:
        """f, then df/dx and df/dv row by row."""
        return [*self.rates, *self._slopes(self.rates)]

    @property
    def output_sensitivities(self) -> list[sp.Expr]:
        """h, then dh/dx and dh/dv row by row."""
        return [*self.outputs, *self._slopes(self.outputs)]

    def _slopes(self, of: Sequence[sp.Expr]) -> list[sp.Expr]:
        all_slopes: list[sp.Expr] = []
        for group in (self.states, self.unknown):
            symbols = [q.symbol for q in group]
            for expression in of:
                slopes = derivatives(expression, symbols)
                all_slopes += [slopes[s] for s in symbols]
        return all_slopes


def measured_motion(
    system: System,
    measured: Iterable[str],
    unknown: Iterable[str],
    outputs: Mapping[str, sp.Expr] | None = None,
) -> MeasuredMotion:
    """What the measured quantities of a log depend on.

    measured: names of the signals; each is the state of that name unless `outputs` gives its
    expression of states and disturbances, such as "u + Vx*cos(psi) + Vy*sin(psi)" for a speed over
    ground. unknown: names of parameters and disturbances that are estimated; those that no rate
    and no output depends on are left out. All other disturbances are zero.

    Raises `DefinitionError` for unknown names, and for rates that depend on time.
    """
    names = tuple(measured)
    wanted = _quantities(system, unknown)
    by_signal = dict(outputs or {})
    for name in (*names, *by_signal):
        if (name not in system.rates and name not in by_signal) or name not in names:
            raise DefinitionError(
                f"'{name}' is no state of system '{system.name}'"
                if name in names
                else f"the log has no signal '{name}'",
                remedy=suggestion(name, system.rates if name in names else names),
            )
    estimated = {q.symbol for q in wanted}
    still = {d.symbol: sp.S.Zero for d in system.disturbances if d.symbol not in estimated}
    states = {q.symbol: q for q in system.states}
    seen = [sp.sympify(by_signal.get(n, states_symbol(system, n))).xreplace(still) for n in names]
    allowed = states.keys() | {p.symbol for p in system.parameters} | estimated
    for name, expression in zip(names, seen, strict=True):
        if odd := sorted(str(s) for s in symbols_of([expression]) - allowed):
            raise DefinitionError(
                f"signal '{name}' uses the undeclared name '{odd[0]}'",
                expected="states, parameters and disturbances that are estimated",
            )
    rates = {s: system.rates[q.name].xreplace(still) for s, q in states.items()}
    needed = symbols_of(seen) & states.keys()
    while more := (symbols_of(rates[s] for s in needed) & states.keys()) - needed:
        needed |= more
    used = [q for s, q in states.items() if s in needed]
    expressions = tuple(rates[q.symbol] for q in used)
    if TIME in symbols_of(expressions):
        raise DefinitionError(
            f"the rates of system '{system.name}' depend on time",
            expected="rates of states, inputs and disturbances",
        )
    present = symbols_of([*expressions, *seen])
    return MeasuredMotion(
        states=tuple(used),
        inputs=tuple(q for q in system.inputs if q.symbol in present),
        unknown=tuple(q for q in wanted if q.symbol in present),
        parameters=tuple(p for p in system.parameters if p.symbol not in estimated),
        rates=expressions,
        names=names,
        outputs=tuple(seen),
    )


def states_symbol(system: System, name: str) -> sp.Symbol:
    """The symbol of a state, or of a signal that is none."""
    return next((q.symbol for q in system.states if q.name == name), sp.Symbol(name, real=True))


def _quantities(system: System, names: Iterable[str]) -> list[Quantity]:
    by_name = {q.name: q for q in (*system.parameters, *system.disturbances)}
    quantities = []
    for name in names:
        check_name(
            name, by_name, DefinitionError, f"system '{system.name}' has no parameter '{name}'"
        )
        quantities.append(by_name[name])
    return quantities
