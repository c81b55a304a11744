"""A system under a law as the leaves of its closed loop, which `simulation/loop.py` calls.

A leaf takes the parameters as columns, so that a sweep over gains or currents compiles once.

Values that several leaves need are computed once, as rows of their own. prepared: what depends on
the parameters alone and has a quotient or a root in it; it is computed once for each run. shared:
what the leaves of several modes, and those of no mode, need of one sample, such as the sine of a
heading or the gradient of a field; it is computed once for each sample. A leaf reads these rows
behind those of its parameters `p` and of what the law sees, `q`.

A disturbance is a number, a function of time, or a field d(t, q, p). A field is evaluated at the
true state of the plant: its rates at every stage of a step, what a law measures of it at the state
and the time that the law sees, without noise.

The program of the controller, its measurements, memory and commands, is printed by every target.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import sympy as sp

from holdfast.errors import DefinitionError, SimulationError, suggestion
from holdfast.execution.arithmetic.steps import FLOAT, Step, Steps, Value
from holdfast.execution.codegen.lane_leaves import DRAW, WANDER, normal, two_uniforms
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import leaf_of, lowered
from holdfast.execution.simulation.settings import Tableau
from holdfast.maths.definitions.law import (
    CellLookup,
    GainCondition,
    Law,
    Lookup,
    Safeguard,
    SampledLookup,
)
from holdfast.maths.definitions.quantity import (
    SAMPLE_TIME,
    TIME,
    TIME_IN_MODE,
    Parameter,
    Quantity,
    expression_of,
    merge_parameters,
    symbol,
)
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching, as_switching
from holdfast.maths.definitions.system import System, by_measurements, check_outputs
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.functions import Process
from holdfast.maths.expressions.traversal import exchanged, symbols_of


@dataclass(frozen=True)
class ControllerProgram:
    """A law with its modes for a system: its arguments, its expressions, and their order.

    seen: the states, then the disturbances that the law measures, then what others hand it at
    every sample. remembered: its discrete-time state. parameters: those of the system and of the
    law, each once.
    """

    system: System
    switching: Switching
    measured: tuple[Quantity, ...]
    parameters: tuple[Parameter, ...]

    @property
    def seen(self) -> tuple[Quantity, ...]:
        return (*self.measurements, *self.handed)

    @property
    def measurements(self) -> tuple[Quantity, ...]:
        """The states and the measured disturbances."""
        return (*self.system.states, *self.measured)

    @property
    def handed(self) -> tuple[Quantity, ...]:
        return self.switching.handed

    @property
    def remembered(self) -> tuple[Quantity, ...]:
        return self.switching.memory.quantities if self.switching.memory else ()

    @property
    def inputs(self) -> list[sp.Symbol]:
        return [q.symbol for q in self.system.inputs]

    @property
    def actuators(self) -> tuple[str, ...]:
        """The names of the actuators: of the inputs where the system declares none."""
        return self.system.actuators or self.system.input_names

    @cached_property
    def modes(self) -> tuple[str, ...]:
        return tuple(self.switching.modes)

    @property
    def initial_mode(self) -> int:
        return self.modes.index(self.switching.initial)

    @cached_property
    def lookup(self) -> Lookup | None:
        return self.switching.lookup

    @property
    def safeguards(self) -> dict[str, Safeguard]:
        """The safety filter of every mode that has one."""
        return {n: law.safeguard for n, law in self.switching.modes.items() if law.safeguard}

    def commands(self, mode: str) -> list[sp.Expr]:
        """The outputs of a mode, in the order of the inputs."""
        outputs = self.switching.modes[mode].outputs
        return [outputs[name] for name in self.system.input_names]

    @property
    def transitions(self) -> dict[str, list[tuple[sp.Expr, int]]]:
        """Every mode that can be left: its guards with the numbers of their targets, in order."""
        by_source: dict[str, list[tuple[sp.Expr, int]]] = {name: [] for name in self.modes}
        for x in self.switching.transitions:
            by_source[x.source].append((x.when, self.modes.index(x.target)))
        return {name: leaving for name, leaving in by_source.items() if leaving}

    @property
    def initial_memory(self) -> list[sp.Expr]:
        memory = self.switching.memory
        return [memory.initial[q.name] for q in memory.quantities] if memory else []

    @property
    def next_memory(self) -> list[sp.Expr]:
        memory = self.switching.memory
        return [memory.following[q.name] for q in memory.quantities] if memory else []

    def actuation(self) -> list[sp.Expr]:
        """The limited values of the actuators at a command, as expressions of the inputs."""
        return self.system.limited(self.allocated())

    def allocated(self) -> list[sp.Expr]:
        """The actuator values that produce the inputs, before they are limited."""
        return self.system.allocated(self.inputs)

    def limited(self) -> list[sp.Expr]:
        """The admissible actuator values in place of the requested ones."""
        return self.system.limited(self.requested)

    def produced(self) -> list[sp.Expr]:
        """The inputs that the actuators produce."""
        return self.system.produced(self.requested)

    @property
    def requested(self) -> list[sp.Symbol]:
        """The actuators as symbols."""
        return [symbol(name) for name in self.actuators] if self.system.actuators else self.inputs

    @property
    def expressions(self) -> list[sp.Expr]:
        """Everything that is evaluated at a sample."""
        commands = [e for mode in self.modes for e in self.commands(mode)]
        filters = [e for safeguard in self.safeguards.values() for e in safeguard.expressions]
        guards = [t.when for t in self.switching.transitions]
        memory = [*self.initial_memory, *self.next_memory]
        actuation = [*self.actuation(), *(self.produced() if memory else ())]
        return [*commands, *filters, *guards, *memory, *actuation, *self.places]

    @property
    def places(self) -> tuple[sp.Expr, ...]:
        """The coordinates at which the law looks up its table."""
        return self.lookup.places if self.lookup else ()

    def check_function_of_state(self) -> None:
        """Refuse a law that depends on more than the state and time."""
        kind = (
            "has modes" if len(self.modes) > 1
            else "remembers" if self.remembered
            else "solves a quadratic program at every sample" if self.safeguards
            else "looks up a kernel" if self.lookup
            else "is handed quantities by others" if self.handed
            else ""
        )  # fmt: skip
        if kind:
            raise DefinitionError(
                f"law '{self.switching.name}' {kind}",
                expected="a law that is a function of the state and of t",
            )


def controller_program(system: System, law: Law | Switching) -> ControllerProgram:
    """The program of that law for that system; its measurements are replaced by expressions.

    Raises `DefinitionError` where the law does not give the inputs of the system, reads a quantity
    that the system does not have, or remembers one that it has.
    """
    switching = as_switching(by_measurements(system, law))
    check_outputs(system, switching)
    memory = switching.memory
    remembered = [q.name for q in memory.quantities] if memory else []
    for name in remembered:
        if name in (*system.state_names, *system.input_names, *system.disturbance_names):
            raise DefinitionError(
                f"'{name}' is both a quantity of system '{system.name}' and in the memory of the "
                "law",
                expected="different names",
            )
    for q in switching.handed:
        if q.name in (*system.state_names, *system.disturbance_names, *remembered):
            raise DefinitionError(
                f"'{q.name}' is handed to law '{switching.name}' and a quantity of system "
                f"'{system.name}'",
                expected="different names",
            )
    reads = [q.name for q in (*switching.reads, *(memory.reads if memory else ()))]
    for name in reads:
        if name not in (*system.state_names, *system.disturbance_names, *remembered):
            raise DefinitionError(
                f"law '{switching.name}' reads '{name}', which is neither a state nor a "
                f"disturbance of system '{system.name}'",
                remedy=suggestion(name, [*system.state_names, *system.disturbance_names]),
            )
    return ControllerProgram(
        system=system,
        switching=switching,
        measured=tuple(d for d in system.disturbances if d.name in reads),
        parameters=merge_parameters(system.parameters, switching.parameters),
    )


@dataclass(frozen=True)
class FeltDisturbance:
    """What a plant feels of each disturbance, in the order of the system.

    expressions: of t, states, parameters and the symbols of `given`, numbers that are handed over
    as parameters are, so that another current needs no new program. processes: those of
    chance, by their values, which are the last of those numbers, each with a number of its own.
    in_run: whether it varies within a run; of_state: whether it is a field of the state. bounded:
    how many have to be watched during a run, since only the run tells whether a field or a process
    keeps its bounds.
    """

    expressions: tuple[sp.Expr, ...]
    given: Mapping[sp.Symbol, float]
    in_run: bool
    of_state: bool
    bounded: int
    processes: Mapping[sp.Symbol, tuple[Process, int]] = field(default_factory=dict)

    def excess(self, system: System) -> list[sp.Expr]:
        """How far the disturbance is outside its bounds, above 0 where it is, then its values."""
        if not self.bounded:
            return []
        assert system.disturbance_bounds is not None
        nearest = system.disturbance_bounds.saturate(self.expressions)
        pairs = zip(self.expressions, nearest, strict=True)
        beyond = sp.Add(*((e - n) ** 2 for e, n in pairs))
        size = sp.Add(*(e**2 for e in self.expressions))
        return [beyond - SLACK**2 * size, *self.expressions]


MOST_PROCESSES = 64
"""The processes of one disturbance are less: each has a number of its own."""

SLACK = sp.Float(1e-9)
"""The share of its size by which a value may exceed its bounds: that of `Bounds.contains`."""


def felt_disturbance(
    system: System, disturbance: Mapping[str, sp.Expr], parameters: Iterable[sp.Symbol]
) -> FeltDisturbance:
    """The given disturbances, those not named 0.

    Raises `SimulationError` for an expression of anything but t, states and parameters.
    """
    expressions = [expression_of(disturbance.get(q.name, 0)) for q in system.disturbances]
    processes: dict[sp.Symbol, tuple[Process, int]] = {}
    for k, e in enumerate(expressions):
        for number, process in enumerate(sorted(e.atoms(Process), key=str)):
            value = sp.Symbol(f"_process{len(processes)}", real=True)
            processes[value] = process, MOST_PROCESSES * k + number
            expressions[k] = expressions[k].xreplace({process: value})
    states, declared = {q.symbol for q in system.states}, set(parameters)
    for q, expression in zip(system.disturbances, expressions, strict=True):
        used = expression.free_symbols - processes.keys()
        unknown = sorted(map(str, used - declared - states - {TIME}))
        if unknown:
            raise SimulationError(
                f"disturbance '{q.name}' uses '{unknown[0]}'",
                expected="an expression of t, states of the plant and declared parameters",
                remedy=suggestion(unknown[0], sorted(map(str, declared | states))),
            )
    for process, number in processes.values():
        if any(a.has(Process) or a.is_finite is False for a in process.args):
            raise SimulationError(
                f"{process} is no process", expected="finite numbers in it", key="disturbance"
            )
        if number % MOST_PROCESSES == MOST_PROCESSES - 1:
            raise SimulationError(
                f"a disturbance has {MOST_PROCESSES} or more processes", key="disturbance"
            )
        used = set().union(*(a.free_symbols for a in process.args))
        if unknown := sorted(map(str, used - declared)):
            raise SimulationError(
                f"{process} uses '{unknown[0]}'",
                expected="an expression of declared parameters",
                remedy=suggestion(unknown[0], sorted(map(str, declared))),
                key="disturbance",
            )
    names = [q.name for q in system.disturbances]
    numbers = [
        n in disturbance and e.is_Number and e.is_finite
        for n, e in zip(names, expressions, strict=True)
    ]
    used = set().union(*(e.free_symbols for e in expressions)) if expressions else set()
    of_state = bool(used & states)
    watched = of_state or processes
    as_symbols = {n: sp.Symbol(f"_given_{n}", real=True) for n in names}  # no user name begins so
    return FeltDisturbance(
        expressions=tuple(
            as_symbols[n] if is_number else e
            for n, e, is_number in zip(names, expressions, numbers, strict=True)
        ),
        given={
            as_symbols[n]: float(e)
            for n, e, is_number in zip(names, expressions, numbers, strict=True)
            if is_number
        }
        | dict.fromkeys(processes, 0.0),
        in_run=of_state or TIME in used or bool(processes),
        of_state=of_state,
        bounded=len(expressions) if watched and system.disturbance_bounds is not None else 0,
        processes=processes,
    )


PREPARED, SHARED = "prepared", "shared"
COSTLY = frozenset(("div", "sqrt", "rare"))
REPEATED = "repeated"
"""A user of values at a sample that is several."""
FEW = 2
"""Operations that are not worth a row."""


def with_shared_rows(
    leaves: Mapping[str, Leaf],
    prepared: Iterable[str],
    users: Mapping[str, object],
    moving: Iterable[str] = (),
) -> dict[str, Leaf]:
    """The leaves, of the same steps, with those that compute rows for several of them.

    prepared: the leaves whose parameters are rows of a block; moving: inputs among the parameters
    that change during a run. users: the leaves that are computed
    at a sample, each with who uses it; what two users need is shared, or one that is `REPEATED`.
    """
    rewritten = dict(leaves)
    steps = next(iter(leaves.values())).steps
    about = _About(steps, frozenset(moving))
    ready = [name for name in prepared if name in leaves]
    constant = {
        k for name in ready for k in _needed(rewritten[name]) if about.is_prepared(k)
    }  # fmt: skip
    _cut(rewritten, ready, constant, about, PREPARED, "p", ("p",))
    sharing = [name for name in users if name in leaves]
    by: dict[int, set[object]] = defaultdict(set)
    for name in sharing:
        for k in _needed(rewritten[name]):
            by[k].add(users[name])
    common = {
        k
        for k, owners in by.items()
        if (len(owners) > 1 or REPEATED in owners) and "x" not in about.reads[k]
    }
    _cut(rewritten, sharing, common, about, SHARED, "q", ("t", "q", "p"))
    return rewritten


class _About:
    """What each step depends on: the arrays that it reads, and the operations below it."""

    def __init__(self, steps: Steps, moving: frozenset[str] = frozenset()) -> None:
        self.list: list[Step] = steps.list
        self.reads: list[frozenset[str]] = []
        self.costly: list[bool] = []
        self.size: list[int] = []
        for step in self.list:
            arrays = frozenset(step.given[0]) if step.operation == "input" else frozenset()
            if arrays and step.given in moving:
                arrays |= {"t"}
            self.reads.append(arrays.union(*(self.reads[a] for a in step.arguments)))
            below = [self.costly[a] for a in step.arguments]
            self.costly.append(step.operation in COSTLY or any(below))
            work = step.operation not in ("input", "constant")
            self.size.append(work + sum(self.size[a] for a in step.arguments))

    def is_prepared(self, k: int) -> bool:
        return self.costly[k] and self.reads[k] == {"p"}


def _needed(leaf: Leaf) -> list[int]:
    return leaf.steps.needed([v.number for v in leaf.results], leaf.read)


def _cut(
    leaves: dict[str, Leaf], names: Sequence[str], inner: set[int], about: _About, new: str,
    array: str, arguments: Sequence[str],
) -> None:  # fmt: skip
    """Let the leaves read the values of `inner` that they use from rows of the leaf `new`."""
    rows: dict[int, str] = {}
    for name in names:
        leaf = leaves[name]
        waiting, done = [v.number for v in leaf.results], set[int]()
        while waiting:
            k = waiting.pop()
            if k in done or k in leaf.read:
                continue
            done.add(k)
            step = about.list[k]
            if k in inner and step.kind == FLOAT and about.size[k] > FEW:
                rows.setdefault(k, f"{new}{len(rows)}")
            else:
                waiting.extend(step.arguments)
    if not rows:
        return
    some = leaves[names[0]]
    values = [Value(some.steps, k, FLOAT) for k in rows]
    inputs = {a: next(v for n in names if (v := leaves[n].arguments[a])) for a in arguments}
    inputs |= {a: () for a in some.arguments if a not in inputs}
    order = {a: inputs[a] for a in some.arguments}
    read = {k: row for n in names for k, row in leaves[n].read.items()}
    for name in names:
        leaf = leaves[name]
        behind = {
            **leaf.arguments,
            array: (*(leaf.arguments[array] or inputs[array]), *rows.values()),
        }
        leaves[name] = replace(leaf, arguments=behind, read={**leaf.read, **rows})
    leaves[new] = Leaf(some.steps, order, values, read=read)


@dataclass(frozen=True)
class ClosedLoopProgram:
    """The leaves of one closed loop and the meaning of each of its array columns.

    leaves: see `_leaves`. targets: for each mode those of its guards, in order.
    conditions_of_modes: how many conditions its safeguard has, and how many are hard;
    levels_of_modes: where its levels of priority end; foresight_of_modes: `Foresight.counts`.
    measured: how many disturbances the law measures; handed: what others hand it at every
    sample; things: of those that its safeguard has repeated conditions for, of which the numbers
    are handed last, how many there are at most, the numbers and the conditions of one; limited: how
    many values its actuators have.
    places: how many axes its table has; timed: whether the first of them is the remaining time.
    found: how many numbers a look-up finds; hold: the sampling period that a table of cells is for.
    given: numbers that follow the parameters, those of the disturbances; in_run, bounded: see
    `FeltDisturbance`. measures_process: whether the law measures a disturbance of chance, of which
    no former value is kept. slack_units: the units of
    the conditions that a safeguard relaxes, each once. value_signal: the signal that is the value
    of a kernel.
    """

    leaves: Mapping[str, Leaf]
    targets: tuple[tuple[int, ...], ...]
    conditions_of_modes: tuple[tuple[int, int], ...]
    levels_of_modes: tuple[tuple[int, ...], ...]
    foresight_of_modes: tuple[tuple[int, ...], ...]
    measured: int
    handed: tuple[str, ...]
    things: tuple[int, int, int]
    limited: int
    timed: bool
    places: int
    stepper: Tableau
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
    in_run: bool = False
    bounded: int = 0
    remembered: tuple[str, ...] = ()
    safeguarded: bool = False
    slack_units: tuple[str, ...] = ()
    signal_units: tuple[str, ...] = ()
    value_signal: str = ""
    continuous: bool = False
    table: Any = None
    found: int = 0
    hold: float | None = None
    measures_process: bool = False

    def rows_of(self, leaf: str) -> int:
        """How many rows a leaf fills; 0 where there is none."""
        return len(self.leaves[leaf].results) if leaf in self.leaves else 0

    def check_alone(self) -> None:
        """Refuse a law that cannot run without another controller."""
        if self.handed:
            raise SimulationError(
                f"the law is handed {', '.join(self.handed)} by others at every sample",
                remedy="give simulate a command=, call it by SafetyFilter.step, or export it",
            )

    def check_sample_time(self, sample_time: float) -> None:
        """Refuse inputs that are held for another time than the law's table is for."""
        if self.hold is not None and not abs(sample_time - self.hold) <= 1e-9 * self.hold:
            raise SimulationError(
                f"the sample time is {sample_time:g} s", expected=f"{self.hold:g} s, of its law"
            )

    @property
    def prepared(self) -> int:
        """The rows behind those of the parameters."""
        return self.rows_of(PREPARED)

    @property
    def wandering(self) -> int:
        """The processes of its disturbances, whose values are the last of `given`."""
        return self.rows_of("wander")

    @property
    def shared(self) -> int:
        """The rows behind those that a law sees."""
        return self.rows_of(SHARED)


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
    `disturbance` gives each disturbance as an expression of time, states and parameters (those
    not named are zero), `varied` what differs from run to run. Raises `DefinitionError` for a law
    that does not fit the system (`controller_program`), and `SimulationError` for a disturbance
    or a variation that does not.
    """
    controller = controller_program(system, law)
    switching = controller.switching
    if region is not None:
        region.check_states(system.name, system.states)
    if goal is not None:
        goal.check_reads(system.name, system.states)
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
    if continuous and (controller.remembered or controller.handed):
        kind = "a law with memory" if controller.remembered else "a command of another controller"
        raise SimulationError(f"{kind} needs sampled control", remedy="use continuous = false")
    p = [q.symbol for q in parameters]
    d = [s.symbol for s in system.disturbances]
    felt = felt_disturbance(system, disturbance, p)
    still = list(felt.expressions)
    p += felt.given
    of_disturbance = dict(zip(system.disturbances, still, strict=True))
    measured = [of_disturbance[d] for d in controller.measured]
    used = [*still, *varied.values.values(), *varied.plant.values(), *controller.expressions]
    used += [process for process, _ in felt.processes.values()]
    used += [*system.rates.values(), *switching.signals.values(), *([goal.worst] if goal else [])]
    symbols = symbols_of(used)
    for bounds in (system.input_bounds, system.disturbance_bounds):
        symbols |= bounds.free_symbols if bounds else set()
    for name in varied.draws:
        if symbol(name) not in symbols:
            raise SimulationError(
                f"'{name}' is drawn, and nothing depends on it",
                remedy=suggestion(name, sorted(map(str, symbols & set(p) - felt.processes.keys()))),
                key=f"varied.draws.{name}",
            )
    lookup = controller.lookup
    values = [n for n, e in switching.signals.items() if lookup and e == lookup.value]
    guards = controller.safeguards
    c = [x.expression for x in region.inequalities] if region else []
    return ClosedLoopProgram(
        leaves=_leaves(
            controller,
            rates=[e.xreplace(dict(zip(d, still, strict=True))) for e in system.rates.values()],
            measured=measured,
            constraints=c,
            goal=goal.worst if goal else sp.S.One,
            varied=list(varied.expressions),
            felt=felt,
            parameters=p,
        ),
        targets=tuple(
            tuple(target for _, target in controller.transitions.get(mode, ()))
            for mode in controller.modes
        ),
        conditions_of_modes=tuple(
            (len(guards[mode].offsets), guards[mode].hard) if mode in guards else (0, 0)
            for mode in controller.modes
        ),
        levels_of_modes=tuple(
            guards[mode].ends if mode in guards else () for mode in controller.modes
        ),
        foresight_of_modes=tuple(
            ahead.counts if mode in guards and (ahead := guards[mode].foresight) else ()
            for mode in controller.modes
        ),
        measured=len(measured),
        measures_process=any(e.free_symbols & felt.processes.keys() for e in measured),
        handed=tuple(q.name for q in controller.handed),
        things=_things(guards),
        limited=len(controller.requested),
        timed=bool(lookup and lookup.timed),
        stepper=stepper,
        places=len(controller.places),
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
        given=tuple(felt.given.values()),
        in_run=felt.in_run,
        bounded=felt.bounded,
        remembered=tuple(z.name for z in controller.remembered),
        safeguarded=bool(guards),
        slack_units=tuple(dict.fromkeys(u for guard in guards.values() for u in guard.units)),
        signal_units=tuple(
            lookup.unit if lookup and n in values else "1" for n in switching.signals
        ),
        value_signal=values[0] if values else "",
        continuous=continuous,
        table=lookup.table if lookup else None,
        found=len(lookup.symbols) if lookup else 0,
        hold=lookup.hold if isinstance(lookup, CellLookup | SampledLookup) else None,
    )


def _things(guards: Mapping[str, Safeguard]) -> tuple[int, int, int]:
    """How many things the safeguards repeat conditions for, their numbers, their conditions."""
    for guard in guards.values():
        if each := guard.repeated:
            return each.count, len(each.numbers), each.conditions
    return 0, 0, 0


def _check_still(region: Region, varied: Varied) -> None:
    """Refuse to vary what the region is made of: starts are drawn in one and the same region."""
    used = set().union(*(x.expression.free_symbols for x in region.inequalities))
    for name in (*varied.names, *varied.plant):
        if symbol(name) in used:
            raise SimulationError(f"'{name}' is varied, and the region depends on it", key="varied")


def _leaves(
    controller: ControllerProgram,
    *,
    rates: Sequence[sp.Expr],
    measured: Sequence[sp.Expr],
    constraints: Sequence[sp.Expr],
    goal: sp.Expr,
    varied: Sequence[sp.Expr],
    felt: FeltDisturbance,
    parameters: Sequence[sp.Symbol],
) -> dict[str, Leaf]:
    """The leaves of a closed loop: each is a function of four arrays, of which it may ignore some.

    | leaf | t | q | x | p | result |
    |---|---|---|---|---|---|
    | rates | time | state | input | of the plant | dq/dt |
    | felt, disturbance | time | state | | of the plant | what the law measures, all of them |
    | excess | time | state | | of the plant | by how much they exceed their bounds, all of them |
    | begin | time | seen | | believed | the first memory |
    | places | time | seen | | believed | where the law looks up its table |
    | law k | time | seen | found in the table | believed | command, conditions, scales |
    | thing k | time | seen | numbers of a thing | believed | its conditions |
    | guards k | time | seen | time in the mode | believed | levels |
    | signals | time | seen | found in the table | believed | signals |
    | actuate | | command | believed | of the plant | requested, limited, input |
    | remember | time | seen | requested | believed | the next memory |
    | constraints | time | state | | of the plant | c_j |
    | constraint_rates | time | state | dq/dt | of the plant | dc_j/dt |
    | goal | | state | | of the plant | level |
    | wander | run, sample, seed | | processes | of the plant | the processes a sample later |
    | varied | | | | of the plant | values |
    | prepared, shared | time | seen | | both | see the top |
    """
    system, switching = controller.system, controller.switching
    q = [s.symbol for s in system.states]
    u, seen = controller.inputs, [s.symbol for s in (*controller.seen, *controller.remembered)]
    p = [*parameters, SAMPLE_TIME]
    look = controller.lookup.symbols if controller.lookup else ()
    requested = controller.requested
    qdot = [sp.Symbol(f"_qdot{i}", real=True) for i in range(len(q))]  # no user name begins so
    rise = [
        sum((e.diff(s) * r for s, r in zip(q, qdot, strict=True)), e.diff(TIME))
        for e in constraints
    ]
    believed = [sp.Symbol(f"_believed{i}", real=True) for i in range(len(p))]
    limits = dict(zip(requested, controller.limited(), strict=True))
    produced = dict(zip(u, exchanged(controller.produced(), limits), strict=True))

    steps = Steps(expanded=True)

    def leaf(
        results: Sequence[sp.Expr],
        q: Sequence[sp.Symbol] = (),
        x: Sequence[sp.Symbol] = (),
        p: Sequence[sp.Symbol] = p,
    ) -> Leaf:
        return leaf_of({"t": (TIME,), "q": q, "x": x, "p": p}, results, steps=steps)

    leaves = {
        "rates": leaf(rates, q, u),
        "felt": leaf(measured, q if felt.of_state else ()),
        "disturbance": leaf(felt.expressions, q if felt.of_state else ()),
        "excess": leaf(felt.excess(system), q),
        "begin": leaf(controller.initial_memory, seen),
        "places": leaf(controller.places, seen),
        "signals": leaf(list(switching.signals.values()), seen, look),
        "remember": leaf(exchanged(controller.next_memory, produced), seen, requested),
        "constraints": leaf(constraints, q),
        "constraint_rates": leaf(rise, q, qdot),
        "goal": leaf([goal], q),
        "varied": leaf(varied),
    }
    # the controller requests by its own parameters, the plant limits by those that are true
    asked = exchanged(controller.allocated(), dict(zip(p, believed, strict=True)))
    limited = exchanged(controller.limited(), dict(zip(requested, asked, strict=True)))
    done = exchanged(controller.produced(), dict(zip(requested, limited, strict=True)))
    leaves["actuate"] = leaf([*asked, *limited, *done], u, believed)
    for number, mode in enumerate(controller.modes):
        guard = controller.safeguards.get(mode)
        rows = guard.rows(system.input_names) if guard else []
        leaves[f"law{number}"] = leaf([*controller.commands(mode), *rows], seen, look)
        if guard and (each := guard.repeated):
            leaves[f"thing{number}"] = leaf(each.rows, seen, each.numbers)
        levels = [when for when, _ in controller.transitions.get(mode, ())]
        leaves[f"guards{number}"] = leaf(levels, seen, (TIME_IN_MODE,))
    leaves = {name: one for name, one in leaves.items() if one.results}
    moving = [f"p{p.index(value)}" for value in felt.processes]
    plant = ("rates", "constraints", "constraint_rates", "goal")
    numbers = range(len(controller.modes))
    users: dict[str, object] = {f"{kind}{k}": k for kind in ("law", "guards") for k in numbers}
    users |= {name: name for name in ("places", "signals", "remember")}
    users |= {f"thing{k}": REPEATED for k in numbers}
    leaves = with_shared_rows(leaves, (*plant, *users), users, moving)
    if felt.processes:
        leaves["wander"] = _wander(felt.processes, p)
    return leaves


def _wander(processes: Mapping[sp.Symbol, tuple[Process, int]], p: Sequence[sp.Symbol]) -> Leaf:
    """The processes x after a sample, each with a normal number of its own for a sample."""
    steps, widths = Steps(expanded=True), {"t": len(DRAW), "q": 0, "x": len(processes), "p": len(p)}
    names = {a: [f"{a}{i}" for i in range(count)] for a, count in widths.items()}
    run, sample, *seed = (steps.input(name) for name in names["t"])
    values = {s: steps.input(name) for s, name in zip(p, names["p"], strict=True)}
    results, number = [], sp.Symbol("_normal", real=True)
    for i, (value, (process, channel)) in enumerate(processes.items()):
        drawn = normal(*two_uniforms((seed[0], seed[1]), run, sample, channel, WANDER))
        at = values | {value: steps.input(names["x"][i]), number: drawn}
        results += lowered(steps, [process.following(value, SAMPLE_TIME, number)], at)
    return Leaf(steps, names, results)
