"""A system under a law to the source text of its closed loop.

The text defines the functions that `driver.py` leaves open; each takes the state and the
inputs as tuples and the parameters as arrays, so that a sweep over gains or currents compiles once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import sympy as sp

from holdfast.errors import SimulationError, suggestion
from holdfast.execution.codegen.controller_program import controller_program
from holdfast.execution.codegen.law_source import (
    guard_source,
    law_source,
    nominal_source,
    signals_source,
)
from holdfast.execution.codegen.printer import function_source
from holdfast.execution.simulation.steppers import Tableau, stepper_source
from holdfast.maths.control.outward_rates import check_reads
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import (
    TIME,
    Parameter,
    Quantity,
    merge_parameters,
    symbol,
)
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.traversal import symbols_of


@dataclass(frozen=True)
class ClosedLoopProgram:
    """The text of one closed loop and the meaning of each of its array columns.

    given: numbers that follow the parameters, those of the disturbances. slack_units: the units of
    the conditions that a safeguard relaxes, each once. value_signal: the signal that is the value
    of a kernel.
    """

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
    varied: Varied = field(default_factory=Varied)
    given: tuple[float, ...] = ()
    remembered: tuple[str, ...] = ()
    safeguarded: bool = False
    slack_units: tuple[str, ...] = ()
    signal_units: tuple[str, ...] = ()
    value_signal: str = ""
    continuous: bool = False
    table: Any = None


def closed_loop_program(
    system: System,
    law: Law | Switching,
    *,
    region: Region | None,
    goal: Region | None,
    disturbance: Mapping[str, sp.Expr],
    stepper: Tableau,
    continuous: bool = False,
    varied: Varied | None = None,
) -> ClosedLoopProgram:
    """The program that simulates `system` under `law`, watching `region` and `goal`.

    `continuous`: the inputs follow the state at every instant, not once per control sample.
    `disturbance` gives each disturbance as an expression of time and parameters (those not
    named are zero), `varied` what differs from run to run. Raises `DefinitionError` for a law that
    does not fit the system (`controller_program`), and `SimulationError` for a disturbance or a
    variation that does not.
    """
    controller = controller_program(system, law)
    switching = controller.switching
    for watched in (region, goal):
        if watched is not None:
            check_reads(system, watched)
    parameters = merge_parameters(
        controller.parameters,
        region.parameters if region else (),
        goal.parameters if goal else (),
    )
    varied = varied or Varied()
    moving = (*system.states, *system.inputs, *system.disturbances)
    for name in (*(s.name for s in moving), *system.actuators):
        if name in varied.draws or name in [q.name for q in parameters]:
            raise SimulationError(
                f"'{name}' is a state, an input, an actuator or a disturbance, not a parameter",
                key="varied" if name in varied.draws else "",
            )
    parameters += varied.new_parameters({q.name: q for q in parameters})
    varied.check({q.name: q for q in parameters}, {q.name: q for q in system.parameters})
    if region is not None:
        _check_still(region, varied)
    if controller.remembered and continuous:
        raise SimulationError(
            "a law with memory needs sampled control", remedy="use continuous = false"
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
    # numbers are handed over as parameters are: another current needs no new program
    given = {s.name: e for s, e in zip(system.disturbances, still, strict=True) if e.is_Number}
    given = {n: e for n, e in given.items() if n in disturbance and e.is_finite}
    handed = {n: sp.Symbol(f"_given_{n}", real=True) for n in given}  # no user name begins so
    still = [handed.get(s.name, e) for s, e in zip(system.disturbances, still, strict=True)]
    p += handed.values()
    felt = dict(zip(system.disturbances, still, strict=True))
    measured = [felt[d] for d in controller.measured]
    # the functions of a law without measured disturbances receive one zero in their place
    seen = [q.symbol for q in controller.seen] + ([] if measured else [sp.Dummy()])
    seen += [z.symbol for z in controller.remembered]
    used = [*still, *varied.values.values(), *varied.plant.values(), *controller.expressions]
    used += [*system.rates.values(), *switching.signals.values(), *([goal.worst] if goal else [])]
    symbols = symbols_of(used)
    for bounds in (system.input_bounds, system.disturbance_bounds):
        symbols |= bounds.free_symbols if bounds else set()
    for name in varied.draws:
        if symbol(name) not in symbols:
            raise SimulationError(
                f"'{name}' is drawn, and nothing depends on it",
                remedy=suggestion(name, sorted(map(str, symbols & set(p)))),
                key=f"varied.draws.{name}",
            )
    a, lookup = controller.requested, controller.lookup
    values = [n for n, e in switching.signals.items() if lookup and e == lookup.value]
    guards = controller.safeguards.values()
    c = [x.expression for x in region.inequalities] if region else []
    qdot = [sp.Symbol(f"_qdot{i}", real=True) for i in range(len(q))]  # no user name begins so
    cdot = [sum((e.diff(s) * r for s, r in zip(q, qdot, strict=True)), sp.S.Zero) for e in c]
    constants = {
        "WATCHED": len(c),
        "SIGNALS": len(switching.signals),
        "ACTUATORS": len(system.actuators),
        "SAFEGUARDED": bool(guards),
        "CONTINUOUS": continuous,
        "ADAPTIVE": stepper.adaptive,
        "ORDER": stepper.order,
        "LOOKED_UP": len(controller.places),
        "FIRST_STATE": int(lookup.timed) if lookup else 0,
    }
    functions = [
        "\n".join(f"{name} = {value!r}" for name, value in constants.items()),
        function_source(
            "rates",
            ("t", "q", "u", "d", "p"),
            {"q": q, "u": u, "d": d, "p": p},
            list(system.rates.values()),
            several=True,
        ),
        function_source("disturbance", ("t", "p"), {"p": p}, still),
        function_source("allocate", ("u", "p"), {"u": u, "p": p}, controller.allocated()),
        function_source("limit", ("a", "p"), {"a": a, "p": p}, controller.limited()),
        function_source("produce", ("a", "p"), {"a": a, "p": p}, controller.produced()),
        function_source("felt", ("t", "p"), {"p": p}, measured),
        function_source(
            "first_memory",
            ("q", "p"),
            {"q": seen, "p": p},
            controller.initial_memory,
        ),
        function_source(
            "next_memory",
            ("t", "q", "u", "p", "sample_time"),
            {"q": seen, "u": u, "p": p},
            controller.next_memory,
        ),
        function_source(
            "places",
            ("t", "q", "p"),
            {"q": seen, "p": p},
            controller.places,
        ),
        law_source(controller, seen, p),
        nominal_source(controller),
        guard_source(controller, seen, p),
        signals_source(controller, seen, p),
        function_source("constraints", ("q", "p"), {"q": q, "p": p}, c, several=True),
        function_source(
            "constraint_rates",
            ("q", "qdot", "p"),
            {"q": q, "qdot": qdot, "p": p},
            cdot,
            several=True,
        ),
        function_source(
            "goal_level",
            ("q", "p"),
            {"q": q, "p": p},
            [goal.worst if goal else sp.S.One],
            scalar=True,
        ),
        function_source("varied", ("p",), {"p": p}, list(varied.expressions)),
        _load_source("as_tuple", len(q)),
        _load_source("as_memory", len(controller.remembered)),
        stepper_source(stepper, len(q)),
    ]
    return ClosedLoopProgram(
        source="\n\n\n".join(functions) + "\n",
        states=system.states,
        inputs=system.inputs,
        disturbances=system.disturbances,
        actuators=system.actuators,
        actuator_unit=system.inputs[0].unit if system.actuators else "1",
        modes=controller.modes,
        initial_mode=controller.initial_mode,
        signals=tuple(switching.signals),
        constraints=tuple((x.name, x.unit) for x in region.inequalities) if region else (),
        parameters=parameters,
        conditions=switching.conditions,
        varied=varied,
        given=tuple(float(e) for e in given.values()),
        remembered=tuple(z.name for z in controller.remembered),
        safeguarded=bool(constants["SAFEGUARDED"]),
        slack_units=tuple(dict.fromkeys(u for guard in guards for u in guard.units)),
        signal_units=tuple(
            lookup.unit if lookup and n in values else "1" for n in switching.signals
        ),
        value_signal=values[0] if values else "",
        continuous=continuous,
        table=lookup.table if lookup else None,
    )


def _check_still(region: Region, varied: Varied) -> None:
    """Refuse to vary what the region is made of: starts are drawn in one and the same region."""
    used = set().union(*(x.expression.free_symbols for x in region.inequalities))
    for name in (*varied.names, *varied.plant):
        if symbol(name) in used:
            raise SimulationError(f"'{name}' is varied, and the region depends on it", key="varied")


def _load_source(name: str, dimension: int) -> str:
    entries = "".join(f"values[{i}], " for i in range(dimension)) or "0.0, "  # as `body` has it
    return f"@inlined\ndef {name}(values):\n    return ({entries})"
