"""A law, and the vehicle that it steers, called sample by sample in a loop of one's own.

The law has its modes and its memory; the steps of the vehicle are those of `simulate`.

What a controller is given at a sample is one row of numbers; what is wrong with it is said.
"""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import ArgumentError, SimulationError, check_name
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram, closed_loop_program
from holdfast.execution.simulation.control_sample import ControlSamples, PlantSamples
from holdfast.execution.simulation.settings import RK4
from holdfast.maths.control.velocity_tracking import commanded
from holdfast.maths.definitions.law import CellLookup, Law, SampledLookup
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.value import FrozenDict, content, picklable

Given = Mapping[str, float] | Sequence[float] | Array
"""Numbers by name, or in the order of their names."""


QUICK = (list, tuple)
"""Types that are numbers in order."""


NO_NUMBERS = (TypeError, ValueError, OverflowError)


class Measurements:
    """The rows of what is seen: the measured states, the measured disturbances, the command.

    Other states, which an observer estimates, are 0 in them and are not used.
    """

    def __init__(
        self,
        program: ClosedLoopProgram,
        states: tuple[str, ...],
        disturbances: tuple[str, ...],
        handed: tuple[str, ...] = (),
        behind: int = 0,
    ) -> None:
        """behind: numbers at the end of a row that others write."""
        all_states = [q.name for q in program.states]
        n, measured = len(all_states), program.measured
        self.states, self.disturbances, self.handed = states, disturbances, handed
        self.row = np.zeros(n + measured + len(program.handed))
        places = [all_states.index(name) for name in states]
        whole = places == list(range(n))
        self._states: slice | list[int] = slice(0, n) if whole else places
        self._disturbances = slice(n, n + measured)
        self._handed = slice(n + measured, len(self.row) - behind)
        self._ones = np.ones(len(self.row))
        self.names = (*all_states, *disturbances, *handed)

    @property
    def commanded(self) -> slice:
        """Where the command is in a row."""
        return self._handed

    def fill(self, state: Given, disturbance: Given | None, command: Given | None = None) -> bool:
        """Write the row; whether all numbers of it are finite."""
        row = self.row
        self._fill(self._states, self.states, state, "state")
        if self.handed:
            if command is None:
                raise SimulationError("the command is None", expected=", ".join(self.handed))
            self._fill(self._handed, self.handed, command, "command")
        if self.disturbances:
            if disturbance is None:
                raise SimulationError(
                    f"the law measures {', '.join(self.disturbances)}",
                    expected="disturbance=..., by name or in that order",
                )
            self._fill(self._disturbances, self.disturbances, disturbance, "disturbance")
        elif disturbance is not None:
            raise SimulationError(
                "a disturbance is given, and the law measures none",
                remedy="leave it out, or make the law measure it (disturbance_measured=True)",
            )
        return math.isfinite(row.dot(self._ones)) or bool(np.isfinite(row).all())

    def _fill(
        self, places: slice | list[int], names: tuple[str, ...], values: Given, what: str
    ) -> None:
        quick = type(values) in QUICK or (type(values) is np.ndarray and values.dtype.kind in "fiu")
        try:
            if quick and len(values) == len(names):
                self.row[places] = values  # type: ignore[assignment]
                return
        except NO_NUMBERS:
            pass  # it is said below what is wrong
        self.row[places] = numbers(values, names, what)

    def rows(
        self,
        states: npt.ArrayLike,
        disturbances: npt.ArrayLike | None,
        commands: npt.ArrayLike | None = None,
    ) -> Array:
        """Rows for many vehicles: arrays with a row for each of them. states: shape (count,
        states). disturbances: shape (count, disturbances). commands: shape (count, inputs). The
        rows have the shape (count, numbers)."""
        groups: list[tuple[str, Any, slice | list[int], tuple[str, ...]]]
        groups = [("states", states, self._states, self.states)]
        if self.disturbances:
            if disturbances is None:
                raise SimulationError(f"the law measures {', '.join(self.disturbances)}")
            groups.append(("disturbances", disturbances, self._disturbances, self.disturbances))
        if self.handed:
            groups.append(("commands", commands, self._handed, self.handed))
        table: Array | None = None
        for what, numbers, places, names in groups:
            try:
                array = np.asarray(_real(numbers), dtype=np.float64)
            except NO_NUMBERS:
                raise SimulationError(f"{what} is not an array of numbers") from None
            count = len(table) if table is not None else "any number"
            if (
                array.ndim != 2
                or array.shape[1] != len(names)
                or (table is not None and len(array) != len(table))
            ):
                raise SimulationError(
                    f"{what} has the shape {array.shape}",
                    expected=f"({count}, {len(names)}): {', '.join(names)}",
                )
            if table is None:
                table = np.zeros((len(array), len(self.row)))
            table[:, places] = array
        assert table is not None
        return table

    def faulty(self, row: Array) -> str:
        """The names of the numbers of a row that are not finite: row has the shape (numbers,)."""
        return ", ".join(
            f"{name} is {value}"
            for name, value in zip(self.names, row, strict=False)
            if not math.isfinite(value)
        )


def numbers(values: Given, names: tuple[str, ...], what: str) -> Array:
    """The numbers in the order of their names; `SimulationError` for others. Their shape is
    (names,)."""
    if isinstance(values, Mapping):
        for name in values:
            check_name(name, names, SimulationError, f"unknown {what} '{name}'")
        if missing := [name for name in names if name not in values]:
            raise SimulationError(f"the {what} lacks {', '.join(missing)}")
        values = [values[name] for name in names]
    try:
        array = np.array(_real(values), dtype=np.float64)
    except NO_NUMBERS:
        shown = repr(values)
        shown = shown if len(shown) < 80 else f"{shown[:77]}..."
        raise SimulationError(f"the {what} is {shown}", expected="numbers") from None
    if array.shape != (len(names),):
        raise SimulationError(
            f"the {what} has the shape {array.shape}",
            expected=f"{len(names)} numbers: {', '.join(names)}",
        )
    return array


def _real(values: Any) -> Any:
    """What is given, unless it is complex or has no value at some place."""
    if np.iscomplexobj(values) or isinstance(values, np.ma.MaskedArray):
        raise TypeError
    return values


def time_of(t: float | None, count: int, sample_time: float) -> float:
    """The time of a sample [s]: as given, or by the number of samples before it."""
    if t is None:
        return count * sample_time
    try:
        return float(t)
    except NO_NUMBERS:
        raise SimulationError(f"t is {t!r}"[:80], expected="a number of seconds") from None


class Remade:
    """What is copied, compared, hashed and pickled by the arguments that it was made of.

    A copy goes on from the sample at which it was taken; whether two are equal does not depend on
    that. In another process it is made anew, with the code that is compiled there.
    """

    _arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *arguments: Any, **by_name: Any) -> Self:
        made = super().__new__(cls)
        try:
            bound = inspect.signature(cls.__init__).bind(made, *arguments, **by_name)
        except TypeError:  # which `__init__` refuses, or has another name of
            made._arguments = tuple(map(_fixed, arguments)), _fixed(by_name)
            return made
        bound.apply_defaults()
        made._arguments = (), _fixed(dict(list(bound.arguments.items())[1:]))
        return made

    def _now(self) -> Any:
        """What changes from sample to sample."""
        raise NotImplementedError

    def _resume(self, earlier: Any) -> None:
        raise NotImplementedError

    def __copy__(self) -> Self:
        copied: Self = _remade(type(self), self._arguments, self._now())
        return copied

    def __reduce__(self) -> tuple[Any, ...]:
        return _remade, (type(self), picklable(self._arguments), self._now())

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return self is other or content(self._arguments) == content(other._arguments)

    def __hash__(self) -> int:
        return hash((type(self), content(self._arguments)))


def _fixed(value: Any) -> Any:
    """The same numbers, which the caller cannot change any more."""
    match value:
        case np.ndarray():
            return _fixed(value.tolist())
        case list() | tuple() if type(value) in QUICK:
            return tuple(map(_fixed, value))
        case dict():
            return FrozenDict({name: _fixed(held) for name, held in value.items()})
    return value


def _remade(of: type[Any], arguments: tuple[Any, dict[str, Any]], earlier: Any) -> Any:
    by_place, by_name = arguments
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they were given where it was made first
        made = of(*by_place, **by_name)
    made._resume(earlier)
    return made


class Plant(Remade):
    """A system that moves by one control sample at a time, with its inputs held and limited.

    start: the states, shape (states,). sample_time [s]: how long an input is held. substeps:
    classical Runge-Kutta steps in that time, as in `simulate`.

    `state` and `t` [s] are where it is, and when.

    Raises `SimulationError` for invalid arguments.

    >>> plant = hf.Plant(cart, [0.5, 0.0])
    >>> plant.step([1.0])
    array([0.5002, 0.02  ])
    """

    @checked
    def __init__(
        self,
        system: System,
        start: Sequence[float] | Array,
        *,
        sample_time: float = 0.02,
        substeps: int = 2,
    ) -> None:
        """start: shape (states,)."""
        if not (math.isfinite(sample_time) and sample_time > 0):
            raise SimulationError(f"sample_time is {sample_time}", expected="seconds, above 0")
        self.system, self.sample_time = system, float(sample_time)
        program = closed_loop_program(
            system, commanded(system), region=None, goal=None, stepper=RK4,
            disturbance={name: sp.Float(0.0) for name in system.disturbance_names},
        )  # fmt: skip
        self._samples = PlantSamples(program, self.sample_time, substeps)
        self.reset(start)

    def reset(self, start: Sequence[float] | Array) -> None:
        """Begin at other states, at the time 0; start has the shape (states,)."""
        self._state, self.t = numbers(start, self.system.state_names, "start"), 0.0
        self._count = 0

    def step(self, input: Given, disturbance: Given | None = None) -> Array:
        """The states after one sample, with the input and the disturbance held.

        Inputs beyond their bounds are limited as the actuators limit them. Raises
        `SimulationError` for wrong names or shapes, for numbers that are not finite, and where the
        plant diverges; it stays where it was.

        input: shape (inputs,). disturbance: shape (disturbances,). The states have the shape
        (states,).
        """
        inputs = numbers(input, self.system.input_names, "input")
        felt = np.zeros(len(self.system.disturbances))
        if disturbance is not None:
            felt = numbers(disturbance, self.system.disturbance_names, "disturbance")
        for what, row in (("input", inputs), ("disturbance", felt), ("state", self._state)):
            if not np.isfinite(row).all():
                raise SimulationError(f"the {what} is {row.tolist()}", expected="finite numbers")
        after = self._samples.after(self.t, self._state, inputs, felt)
        if not np.isfinite(after).all():
            raise SimulationError(
                f"the plant diverges at {self.t:g} s from {self._state.tolist()}",
                remedy="take a shorter sample_time, or more substeps",
            )
        self._state = after
        self._count += 1
        self.t = self._count * self.sample_time
        return self.state

    @property
    def state(self) -> Array:
        """The states now, shape (states,)."""
        return self._state.copy()

    def _now(self) -> Any:
        return self._state, self.t, self._count

    def _resume(self, earlier: Any) -> None:
        state, self.t, self._count = earlier
        self._state = state.copy()


class Composed(Protocol):
    """A scenario of closed loops."""

    @property
    def model(self) -> System: ...

    @property
    def law(self) -> Law | Switching: ...

    @property
    def settings(self) -> Mapping[str, Any]: ...

    def kept(self) -> Composed: ...


class Command(NamedTuple):
    """What a controller commands at a sample.

    input: in the order and units of the system's inputs, within their bounds. actuators: the
    limited values of the actuators. mode: its name. nominal: the request before a safeguard; slack:
    by how much the safeguard's conditions are missed, 0 where an input is admissible. value: V of
    the law's kernel, or how long its certificate keeps the state [s], else NaN. outside: whether
    the state is outside the grid of the kernel, or in no certified cell. valid: False where the
    time, a measurement or the input is not finite; nothing is remembered of such a sample.
    """

    input: Array
    actuators: Array
    mode: str
    nominal: Array
    slack: float
    value: float
    outside: bool
    valid: bool


class Controller(Remade):
    """Any law, with modes, a memory, a safeguard or a kernel, for one vehicle.

    of: a scenario (`load_scenario`), whose kernel is computed if its law has one; or a system, with
    a law. law: of that system. sample_time [s]: by default that of the scenario or of the law's
    certificate, else 0.02.

    It computes what `simulate` computes at every sample, bit for bit.

    Raises `DefinitionError` for a law that does not fit the system, `SimulationError` for a system
    without a law, a law beside that of a scenario, and a sample time that is not positive,
    `ArgumentError` for what is neither scenario nor system.

    >>> hf.Controller(cart, brake).step([0.5, 0.0]).input
    array([-0.5])
    """

    @checked
    def __init__(
        self,
        of: System | Composed,
        law: Law | Switching | None = None,
        *,
        sample_time: float | None = None,
    ) -> None:
        if isinstance(of, System):
            if law is None:
                raise SimulationError("a system without a law", expected="Controller(system, law)")
            self.system, self.law = of, law
        elif not hasattr(of, "kept"):
            raise ArgumentError(
                f"Controller: of is {of!r}", expected="a scenario of closed loops, or a System"
            )
        else:
            if law is not None:
                raise SimulationError("a scenario has its own law", expected="no other law")
            if of.settings.get("continuous"):
                raise SimulationError(
                    "the scenario has continuous control, and a controller samples"
                )
            scenario = of.kept()
            self.system, self.law = scenario.model, scenario.law
            sample_time = scenario.settings["sample_time"] if sample_time is None else sample_time
        lookup = self.law.lookup
        usual = lookup.hold if isinstance(lookup, CellLookup | SampledLookup) else 0.02
        self.sample_time = usual if sample_time is None else float(sample_time)
        if not (math.isfinite(self.sample_time) and self.sample_time > 0):
            raise SimulationError(f"sample_time is {sample_time}", expected="seconds, above 0")
        if handed := self.law.handed:
            raise SimulationError(
                f"law '{self.law.name}' is handed {', '.join(q.name for q in handed)} by others",
                remedy="use hf.SafetyFilter",
            )
        self._program = closed_loop_program(
            self.system, self.law, region=None, goal=None, disturbance={}, stepper=RK4
        )
        self._samples = ControlSamples(self._program, self.sample_time)
        reads = {q.name for q in self.law.reads}
        felt = tuple(n for n in self.system.disturbance_names if n in reads)
        self._told = Measurements(self._program, self.system.state_names, felt)
        self._count = 0
        self._arguments = (self.system, self.law), FrozenDict(sample_time=self.sample_time)

    @property
    def measured(self) -> tuple[str, ...]:
        """The disturbances that the law measures: `step` needs them."""
        return self._told.disturbances

    @property
    def modes(self) -> tuple[str, ...]:
        """The names of its modes."""
        return self._program.modes

    def step(
        self, measurement: Given, t: float | None = None, disturbance: Given | None = None
    ) -> Command:
        """The command at a sample, from the states of the system, by name or in order.

        States that the law does not read may be 0. t [s]: by default the number of samples since
        `reset` times the sample time. Raises `SimulationError` for wrong names or shapes.
        """
        readings, samples = self._told, self._samples
        finite = readings.fill(measurement, disturbance)
        t = time_of(t, self._count, self.sample_time)
        self._count += 1
        rows, names = samples.rows, self._program.modes
        if not (finite and math.isfinite(t)):
            nothing = samples.nothing()
            return Command(
                nothing[rows.input], nothing[rows.actuators], "", nothing[rows.nominal],
                math.nan, math.nan, False, False,
            )  # fmt: skip
        row = samples.answer(t, readings.row)
        valid = math.isfinite(row[rows.input].sum())
        if not valid:
            samples.forget()
        return Command(
            row[rows.input],
            row[rows.actuators],
            names[int(row[rows.mode])],
            row[rows.nominal],
            float(row[rows.slack]),
            float(row[rows.value]) if self._program.places else math.nan,
            not math.isnan(row[rows.outside]),
            valid,
        )

    def reset(self) -> None:
        """Begin anew: the first mode, no memory, the time 0."""
        self._samples.reset()
        self._count = 0

    def _now(self) -> Any:
        return self._count, self._samples.now()

    def _resume(self, earlier: Any) -> None:
        self._count, samples = earlier
        self._samples.resume(samples)
