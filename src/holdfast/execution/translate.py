"""SymPy to source text: the only printer. Common subexpressions are shared.

The text defines the functions that `driver.py` leaves open; each takes the state and the
inputs as tuples and the parameters as arrays, so that a sweep over gains compiles once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from holdfast.errors import SimulationError
from holdfast.execution.steppers import Tableau, stepper_source
from holdfast.maths.bounds import LinearImage
from holdfast.maths.law import GainCondition, Law
from holdfast.maths.quantity import (
    TIME,
    TIME_IN_MODE,
    Parameter,
    Quantity,
    merge_parameters,
    symbol,
)
from holdfast.maths.region import Region
from holdfast.maths.switching import Switching, as_switching
from holdfast.maths.system import System
from holdfast.maths.tangency import check_reads


class Printer(PythonCodePrinter):
    """Numba-compilable text for every expression holdfast can build."""

    def _print_sgn(self, e: sp.Expr) -> str:
        return f"sgn({self._print(e.args[0])})"

    def _print_wrap(self, e: sp.Expr) -> str:
        return f"wrap({self._print(e.args[0])})"

    def _print_select(self, e: sp.Expr) -> str:
        x, a, b = (self._print(arg) for arg in e.args)
        return f"select({x}, {a}, {b})"

    def _print_least(self, e: sp.Expr) -> str:
        a, b = (self._print(arg) for arg in e.args)
        return f"least({a}, {b})"

    def _print_greatest(self, e: sp.Expr) -> str:
        a, b = (self._print(arg) for arg in e.args)
        return f"greatest({a}, {b})"

    def _print_angle(self, e: sp.Expr) -> str:
        return f"math.atan2({self._print(e.args[0])}, {self._print(e.args[1])})"

    def _print_length(self, e: sp.Expr) -> str:
        x, y = (self._print(arg) for arg in e.args[:2])
        return f"length({x}, {y})"

    def _print_magnitude(self, e: sp.Expr) -> str:
        return f"abs({self._print(e.args[0])})"

    def _print_sign(self, e: sp.Expr) -> str:
        return f"sign({self._print(e.args[0])})"

    def _print_Integer(self, e: sp.Expr) -> str:  # noqa: N802
        return f"{int(e)}.0"

    def _print_Rational(self, e: sp.Expr) -> str:  # noqa: N802
        return repr(float(e))

    def _print_Float(self, e: sp.Expr) -> str:  # noqa: N802
        return repr(float(e))

    def _print_Pow(self, e: sp.Expr, rational: bool = False) -> str:  # noqa: N802
        base, exponent = e.as_base_exp()
        text = f"({self._print(base)})"
        if exponent.is_Integer and 1 <= abs(int(exponent)) <= 8:
            power = " * ".join([text] * abs(int(exponent)))
            return f"({power})" if exponent > 0 else f"(1.0 / ({power}))"
        if exponent == sp.Rational(1, 2):
            return f"math.sqrt({text})"
        if exponent == sp.Rational(-1, 2):
            return f"(1.0 / math.sqrt({text}))"
        return f"({text} ** ({self._print(exponent)}))"


_PRINTER = Printer({"fully_qualified_modules": True})


def function_source(
    name: str,
    arguments: Sequence[str],
    unpack: Mapping[str, Sequence[sp.Symbol]],
    results: Sequence[sp.Expr],
    *,
    scalar: bool = False,
) -> str:
    """Source of one function; `unpack` maps an argument to the symbols it holds, in order."""
    head = f"@compiled\ndef {name}({', '.join(arguments)}):"
    return head + "\n" + _body(unpack, results, scalar=scalar)


def _body(
    unpack: Mapping[str, Sequence[sp.Symbol]],
    results: Sequence[sp.Expr],
    *,
    scalar: bool = False,
    indent: str = "    ",
    give: str = "return",
) -> str:
    used: set[sp.Symbol] = set().union(*(e.free_symbols for e in results)) if results else set()
    lines = []
    for argument, symbols in unpack.items():
        for i, s in enumerate(symbols):
            if s in used:
                lines.append(f"{indent}{_name(s)} = {argument}[{i}]")
    renamed = {s: sp.Symbol(_name(s), real=True) for s in used}
    results = [e.xreplace(renamed) for e in results]
    turning = set(renamed.values()).intersection(
        *({call.args[0] for e in results for call in e.atoms(f)} for f in (sp.sin, sp.cos))
    )
    for a in sorted(turning, key=str):
        pair = {f(a): sp.Symbol(f"{a}{f.__name__}", real=True) for f in (sp.sin, sp.cos)}
        lines.append(f"{indent}{', '.join(map(str, pair.values()))} = sine_and_cosine({a})")
        results = [e.xreplace(pair) for e in results]
    shared, reduced = sp.cse(
        results,
        symbols=sp.numbered_symbols("c_", real=True),
        order="none",
    )
    lines += [f"{indent}{s} = {_PRINTER.doprint(e)}" for s, e in shared]
    texts = [_PRINTER.doprint(e) for e in reduced]
    if scalar:
        lines.append(f"{indent}{give} {texts[0]}")
    else:
        lines.append(f"{indent}{give} ({', '.join(texts or ['0.0'])},)")
    return "\n".join(lines)


def _name(s: sp.Symbol) -> str:
    """The name in the source: it ends in '_', as no argument and no name made here does."""
    return s.name if s in (TIME, TIME_IN_MODE) else f"{s.name}_"


@dataclass(frozen=True)
class ClosedLoopProgram:
    """The text of one closed loop and the meaning of each of its array columns."""

    source: str
    states: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    disturbances: tuple[Quantity, ...]
    actuators: tuple[str, ...]
    actuator_unit: str
    modes: tuple[str, ...]
    initial_mode: int
    signals: tuple[str, ...]
    constraints: tuple[tuple[str, str], ...]
    parameters: tuple[Parameter, ...]
    conditions: tuple[GainCondition, ...] = field(default=())


def closed_loop_program(
    system: System,
    law: Law | Switching,
    *,
    region: Region | None,
    goal: Region | None,
    disturbance: Mapping[str, sp.Expr],
    stepper: Tableau,
) -> ClosedLoopProgram:
    """The program that simulates `system` under `law`, watching `region` and `goal`.

    `disturbance` gives each disturbance as an expression of time and parameters (those not
    named are zero). Raises `SimulationError` when the law does not give the system's inputs
    or reads what the system does not have.
    """
    switching = as_switching(law)
    _check_fit(system, switching)
    for watched in (region, goal):
        if watched is not None:
            check_reads(system, watched)
    parameters = merge_parameters(
        system.parameters,
        switching.parameters,
        region.parameters if region else (),
        goal.parameters if goal else (),
    )
    p = [q.symbol for q in parameters]
    q = [s.symbol for s in system.states]
    u = [s.symbol for s in system.inputs]
    d = [s.symbol for s in system.disturbances]
    still = [sp.sympify(disturbance.get(s.name, 0)) for s in system.disturbances]
    for s, expression in zip(system.disturbances, still, strict=True):
        unknown = expression.free_symbols - set(p) - {TIME}
        if unknown:
            raise SimulationError(
                f"disturbance '{s.name}' uses '{sorted(map(str, unknown))[0]}'",
                expected="an expression of t and declared parameters",
            )
    bounds = system.input_bounds
    image = bounds if isinstance(bounds, LinearImage) else None
    limits = image.of if image else bounds
    a = [symbol(n) for n in image.actuators] if image else u
    signals = list(switching.signals)
    c = [x.expression for x in region.inequalities] if region else []
    qdot = [sp.Symbol(f"_qdot{i}", real=True) for i in range(len(q))]  # no user name begins so
    cdot = [sum((e.diff(s) * r for s, r in zip(q, qdot, strict=True)), sp.S.Zero) for e in c]
    state = {"q": q}
    functions = [
        function_source(
            "rates",
            ("t", "q", "u", "d", "p"),
            {"q": q, "u": u, "d": d, "p": p},
            list(system.rates.values()),
        ),
        function_source("disturbance", ("t", "p"), {"p": p}, still),
        function_source(
            "allocate", ("u", "p"), {"u": u, "p": p}, image.allocate(u) if image else u
        ),
        function_source("limit", ("a", "p"), {"a": a, "p": p}, limits.saturate(a) if limits else a),
        function_source("produce", ("a", "p"), {"a": a, "p": p}, image.produce(a) if image else u),
        _law_source(switching, system.input_names, state, p),
        _guard_source(switching, state, p),
        function_source(
            "signals", ("t", "q", "p"), {**state, "p": p}, [switching.signals[n] for n in signals]
        ),
        function_source("constraints", ("q", "p"), {**state, "p": p}, c),
        function_source(
            "constraint_rates", ("q", "qdot", "p"), {**state, "qdot": qdot, "p": p}, cdot
        ),
        function_source(
            "goal_level",
            ("q", "p"),
            {**state, "p": p},
            [goal.worst if goal else sp.S.One],
            scalar=True,
        ),
        _load_source(len(q)),
        stepper_source(stepper, len(q)),
    ]
    modes = tuple(switching.modes)
    return ClosedLoopProgram(
        source="\n\n\n".join(functions) + "\n",
        states=system.states,
        inputs=system.inputs,
        disturbances=system.disturbances,
        actuators=image.actuators if image else (),
        actuator_unit=system.inputs[0].unit if image else "1",
        modes=modes,
        initial_mode=modes.index(switching.initial),
        signals=tuple(signals),
        constraints=tuple((x.name, x.unit) for x in region.inequalities) if region else (),
        parameters=parameters,
        conditions=switching.conditions,
    )


def _check_fit(system: System, switching: Switching) -> None:
    missing = [n for n in system.input_names if n not in switching.output_names]
    if missing or len(switching.output_names) != len(system.inputs):
        velocities = set(switching.output_names) <= set(system.state_names)
        raise SimulationError(
            f"law '{switching.name}' gives {', '.join(switching.output_names)}",
            expected=f"the inputs of system '{system.name}': " + ", ".join(system.input_names),
            remedy="its outputs are velocities: let the inputs track them (track_velocity, or "
            "[tracking] in a scenario)"
            if velocities
            else "",
        )
    for quantity in switching.reads:
        if quantity.name not in system.state_names:
            raise SimulationError(
                f"law '{switching.name}' reads '{quantity.name}', which is no state of system "
                f"'{system.name}'"
            )


def _law_source(
    switching: Switching,
    inputs: Sequence[str],
    state: Mapping[str, Sequence[sp.Symbol]],
    p: Sequence[sp.Symbol],
) -> str:
    lines = ["@compiled", "def law(t, q, mode, p, table):"]
    for number, mode in enumerate(switching.modes.values()):
        last = number == len(switching.modes) - 1
        if not last:
            lines.append(f"    if mode == {number}:")
        results = [mode.outputs[n] for n in inputs]
        lines.append(_body({**state, "p": p}, results, indent="    " if last else "        "))
    return "\n".join(lines)


def _guard_source(
    switching: Switching, state: Mapping[str, Sequence[sp.Symbol]], p: Sequence[sp.Symbol]
) -> str:
    numbers = {name: i for i, name in enumerate(switching.modes)}
    lines = ["@compiled", "def next_mode(t, q, mode, time_in_mode, p):"]
    for name, number in numbers.items():
        leaving = [x for x in switching.transitions if x.source == name]
        if not leaving:
            continue
        lines.append(f"    if mode == {number}:")
        guards = [x.when for x in leaving]
        lines.append(_body({**state, "p": p}, guards, indent="        ", give="levels ="))
        for i, transition in enumerate(leaving):
            lines.append(f"        if levels[{i}] >= 0.0:")
            lines.append(f"            return {numbers[transition.target]}")
    lines.append("    return mode")
    return "\n".join(lines)


def _load_source(dimension: int) -> str:
    entries = ", ".join(f"values[{i}]" for i in range(dimension))
    return f"@compiled\ndef as_tuple(values):\n    return ({entries},)"
