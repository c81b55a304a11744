"""A batch of initial states to trajectories, in parallel over the runs, or sample by sample.

A law that another controller hands its command is asked sample by sample.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from typing import Protocol

import numpy as np
import numpy.typing as npt

from holdfast.arguments import for_user
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import PREPARED, SHARED, ClosedLoopProgram
from holdfast.execution.codegen.lane_leaves import starts_leaf, varied_leaf
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.device.program import device_named
from holdfast.execution.leaf import Leaves, compiled_leaves
from holdfast.execution.resources import Progress, available_cores, check_memory, run_threads
from holdfast.execution.simulation.blocks import (
    Blocks,
    Functions,
    Numbers,
    Trajectories,
    blank,
    functions_of,
    most_blocks,
)
from holdfast.execution.simulation.built_loop import WIDTH, Kind, Loop, built, shape_of
from holdfast.execution.simulation.device_runs import simulate_on
from holdfast.execution.simulation.settings import Settings
from holdfast.execution.table_in_parts import for_look_ups
from holdfast.maths.definitions.quantity import SAMPLE_TIME, symbol

Command = Callable[[float, Array], Array]
"""A function of t [s] and the states (run, state) to commands (run, input)."""

Alive = npt.NDArray[np.bool_]


class Commander(Protocol):
    """Another controller; most: how many runs it can command at a time."""

    most: int

    def begin(self, runs: range) -> None:
        """Before the first sample of these runs."""

    def command(self, t: float, states: Array, alive: Alive) -> Array:
        """The command of every run, a row each, at the states that are measured. states: shape
        (runs, states). alive: shape (runs,). The commands have the shape (runs, inputs)."""

    def end(self) -> None:
        """After the last sample of the runs, whatever ended them."""


class Function:
    """A function as a commander of all runs together."""

    most = sys.maxsize

    def __init__(self, function: Command) -> None:
        self.function = function

    def begin(self, runs: range) -> None:
        pass

    def command(self, t: float, states: Array, alive: Alive) -> Array:
        """As `Commander.command`: states (runs, states), alive (runs,), commands (runs, inputs)."""
        return self.function(t, states)

    def end(self) -> None:
        pass


def commander_of(
    command: Command | Commander | None, program: ClosedLoopProgram
) -> Commander | None:
    """The controller that hands a law its command; refuses one that the law does not need."""
    if command is None:
        return None
    if not program.handed:
        raise SimulationError(
            "a command is given, and the law is not handed any",
            expected="the law of `commanded` or of a SafetyFilter",
            key="law",
        )
    if callable(command):
        return Function(command)
    if not all(hasattr(command, name) for name in ("most", "begin", "command", "end")):
        raise SimulationError(f"the command is {command!r}", expected="a function, or a Commander")
    return command


def advance_handed(
    blocks: Blocks,
    out: Trajectories,
    first: int,
    commander: Commander,
    tell: Callable[[int], None],
) -> None:
    """Every sample of the runs that begin in `blocks`; `out` has them from the run `first` on.

    tell: it is told how many samples are done.
    """
    program, runs = blocks.program, blocks.runs
    n, handed = len(program.states), program.handed
    seen, time = blocks.rows("seen"), blocks.rows("time")
    behind, sample = n + program.measured, 0
    while blocks.recorded < blocks.records:
        count = blocks.begin_records()
        for record in range(blocks.recorded, blocks.recorded + count):
            last = record == blocks.records - 1
            for k in range(1 if last else blocks.stride):
                blocks.stage("measure")
                alive = blocks.of_runs("alive") != 0.0
                if not alive.any():
                    blocks.end_records(out, first, count)
                    return
                states = seen[:, :n].transpose(0, 2, 1).reshape(-1, n)[:runs]
                with for_user():
                    answer = commander.command(float(time[0, 0, 0]), states.copy(), alive)
                try:
                    commands = np.asarray(answer, dtype=np.float64)
                except (TypeError, ValueError, OverflowError):
                    raise SimulationError(
                        "the controller commands no array of numbers", expected=", ".join(handed)
                    ) from None
                if commands.shape != (runs, len(handed)):
                    raise SimulationError(
                        f"the controller commands an array of the shape {commands.shape}",
                        expected=f"({runs}, {len(handed)}): {', '.join(handed)}",
                    )
                for i in range(len(handed)):
                    blocks.set_runs("seen", commands[:, i], behind + i)
                blocks.stage("control")
                if k == 0:
                    blocks.stage("record")
                if not last:
                    blocks.stage("move")
                sample += 1
                tell(sample)
        blocks.end_records(out, first, count)


ATTEMPTS = 100_000
"""Draws of a random start, of which the first in the region is taken."""

TOGETHER = 4096
"""Draws that are tried at a time."""

OBSERVER = "observer_bandwidth"


class ClosedLoop:
    """A compiled closed loop with its parameter values."""

    def __init__(self, program: ClosedLoopProgram) -> None:
        self.program, self.shape = program, shape_of(program)
        self.leaves = compiled_leaves(program.leaves)
        self._loops: dict[Kind, tuple[Loop, Functions]] = {}

    def loop(self, kind: Kind | None = None) -> tuple[Loop, Functions]:
        """The loop of this kind, and its compiled functions."""
        kind = self._kind(kind or Kind())
        if kind not in self._loops:
            made = built(self.shape, kind)
            self._loops[kind] = made, functions_of(made, self.leaves)
        return self._loops[kind]

    def _kind(self, kind: Kind) -> Kind:
        """With one limit of changes of mode for all programs that have none."""
        return kind if any(self.program.targets) else kind._replace(switch_limit=1)

    def parameter_array(
        self, overrides: Mapping[str, float] | None = None, sample_time: float = 0.0
    ) -> Array:
        """The parameter values in order, with some replaced by name; then the sample time. The
        shape is (parameters,), or (parameters + 1,) with the sample time [s]."""
        values = {p.name: float(p.value) for p in self.program.parameters}
        for name, value in (overrides or {}).items():
            if name not in values:
                raise SimulationError(f"no parameter '{name}' in this closed loop")
            values[name] = float(value)
        if sample_time:
            self.program.check_sample_time(sample_time)
            self._check_gains(values, sample_time)
        if not values.get(OBSERVER, 0.0) * sample_time < 1.0:
            raise SimulationError(
                f"the observer's bandwidth is {values[OBSERVER]:g} 1/s at samples of "
                f"{sample_time:g} s",
                expected="less than one over the sample time",
            )
        return np.array([*values.values(), *self.program.given, sample_time], dtype=np.float64)

    def _check_gains(self, values: Mapping[str, float], sample_time: float) -> None:
        """Refuse gains that the sample time does not bear."""
        by_symbol = {symbol(n): v for n, v in values.items()}
        by_symbol[SAMPLE_TIME] = 0.0 if self.program.continuous else sample_time
        for condition in self.program.conditions:
            if condition.refused and (message := condition.violation(by_symbol)):
                raise SimulationError(message)

    def constraints(self, states: Array) -> Array:
        """c_j of each state, shape (run, constraint)."""
        return self._values("constraints", len(self.program.constraints), q=states)

    def disturbances(
        self, times: Array, states: Array | None = None, p: Array | None = None
    ) -> Array:
        """d(t, q), shape (time, disturbance); states: a row for each time; p: parameters."""
        p = self.parameter_array() if p is None else p
        t = np.asarray(times, dtype=np.float64)[:, np.newaxis]
        q = np.zeros(len(self.program.states)) if states is None else states
        return self._values("disturbance", len(self.program.disturbances), t=t, q=q, p=p)

    def _values(
        self,
        name: str,
        width: int,
        *,
        t: Array | None = None,
        q: Array | None = None,
        p: Array | None = None,
    ) -> Array:
        """The results of a leaf at every given time, state or row of parameters."""
        none = np.zeros(1)
        p = self.parameter_array() if p is None else np.asarray(p, dtype=np.float64)
        t, q = (none if a is None else np.asarray(a, dtype=np.float64) for a in (t, q))
        count = next(len(a) for a in (t, q, p) if a.ndim == 2)
        return self.values(name, count, width, t, q, none, p)

    def values(
        self, name: str, count: int, width: int, t: Array, q: Array, x: Array, p: Array
    ) -> Array:
        """The results of a leaf at `count` points (see `Leaves.values`), shape (count, width)."""
        if not width:
            return np.empty((count, 0))
        rows = {a: len(names) for a, names in self.program.leaves[name].arguments.items()}
        none = np.zeros(1)

        def behind(array: Array, leaf: str, count: int, *arguments: Array) -> Array:
            width = self.program.rows_of(leaf)
            added = self.leaves.values(leaf, count, width, *arguments)
            return np.hstack([array, added[0] if array.ndim == 1 else added])

        if self.program.prepared and rows["p"] > p.shape[-1]:
            p = behind(p, PREPARED, count if p.ndim == 2 else 1, none, none, none, p)
        if self.program.shared and rows["q"] > q.shape[-1]:
            q = behind(q, SHARED, count, t, q, none, p)
        return self.leaves.values(name, count, width, t, q, x, p)

    def varied(self, runs: int, seed: int, first: int = 0) -> Array:
        """The quantities that differ between runs: draws, cases, values, values of the plant.

        first: which of the runs that share the seed is the first of these.

        The shape is (runs, quantities).
        """
        chosen = self.program.varied
        if not chosen:
            return np.empty((runs, 0))
        corners = len(chosen.corners)
        start, turn = np.divmod(np.arange(first, first + runs), chosen.turns)
        case, vertex = np.divmod(turn, corners)
        low, high = (np.array([r[i] for r in chosen.draws.values()]) for i in (0, 1))
        draws = np.empty((runs, 0))
        if chosen.draws:
            leaves = _drawn("varied", varied_leaf, len(low))
            asked = _draws(start * corners + vertex, 0, seed)  # the same in every case
            draws = leaves.values("varied", runs, len(low), asked, low, high, _NONE)
        if chosen.vertices:  # every start at each of them in turn
            places = [list(chosen.draws).index(name) for name in chosen.vertices]
            draws[:, places] = np.array(chosen.corners)[vertex]
        p = np.repeat(self.parameter_array()[np.newaxis], runs, axis=0)
        if chosen.cases:
            draws = np.hstack([draws, np.array([*chosen.cases.values()]).T[case]])
        p[:, self.columns((*chosen.draws, *chosen.cases))] = draws
        width = len(chosen.values) + len(chosen.plant)
        return np.hstack([draws, self._values("varied", width, p=p)])

    def columns(self, names: Iterable[str]) -> npt.NDArray[np.int64]:
        """Where these parameters are among all of them, shape (names,)."""
        order = [p.name for p in self.program.parameters]
        return np.array([order.index(n) for n in names], dtype=np.int64)

    def sample(self, lower: Array, upper: Array, count: int, seed: int, first: int = 0) -> Array:
        """`count` uniform states of a box that satisfy every inequality, from the `first` on.

        lower, upper: shape (states,). The states have the shape (count, states).

        Raises `SimulationError` when `ATTEMPTS` draws find none for some run.
        """
        check_memory(8 * count * len(lower), f"{count} random starts")
        out, waiting = np.empty((count, len(lower))), np.arange(count)
        leaves = _drawn("starts", starts_leaf, len(lower))
        watched = len(self.program.constraints)
        attempt = 0
        while attempt < ATTEMPTS:
            several = min(max(1, TOGETHER // len(waiting)) if attempt else 1, ATTEMPTS - attempt)
            attempts = np.tile(np.arange(attempt, attempt + several), len(waiting))
            asked = _draws(np.repeat(waiting + first, several), attempts, seed)
            some = leaves.values("starts", len(asked), len(lower), asked, lower, upper, _NONE)
            levels = self.constraints(some) if watched else np.zeros((len(some), 1))
            inside = np.all(levels <= 0, axis=1).reshape(-1, several)
            hits, place = inside.any(axis=1), inside.argmax(axis=1)
            out[waiting[hits]] = some[(np.arange(len(waiting)) * several + place)[hits]]
            waiting = waiting[~hits]
            attempt += several
            if not len(waiting):
                return out
        raise SimulationError(
            f"no state of the region found in the box of random starts (run {first + waiting[0]})",
            remedy="check that the box overlaps the region",
        )

    def check_room(self, runs: int, settings: Settings) -> None:
        """Refuse more runs than fit into memory, before anything is allocated."""
        program, rows = self.program, settings.samples // settings.stride + 1
        states, watch = len(program.states), len(program.constraints)
        fed = len(program.inputs) + len(program.actuators)
        moving = states + fed + len(program.signals) + (fed + 1 if program.safeguarded else 0)
        varied = len(program.varied.labels)
        once = 2 * states + varied + watch + fed + 8
        needed = 8 * runs * (rows * (moving + watch + 1) + once)
        check_memory(needed, f"{runs:,} runs of {rows:,} samples")

    def simulate(
        self,
        starts: Array,
        settings: Settings,
        *,
        plant: Mapping[str, float] | None = None,
        varied: Array | None = None,
        first: int = 0,
        progress: Progress | None = None,
        commander: Commander | None = None,
    ) -> Trajectories:
        """Simulate every start; `plant` replaces parameters of the vehicle but not of its law.

        `varied` are the values of `varied()`, by default those. `first`: which of the runs that
        share the seed is the first of these. commander: another controller, where the law is
        handed its command.

        A run's result depends on the seed and its index alone, never on the threads. On
        KeyboardInterrupt the workers stop within one control sample.

        starts: shape (runs, states). varied: shape (runs, quantities).
        """
        program = self.program
        if commander is None:
            program.check_alone()
        runs = len(starts)
        samples, stride = settings.samples, settings.stride
        self.check_room(runs, settings)
        if program.continuous != settings.continuous:
            raise SimulationError(
                "this loop was compiled with another setting of continuous",
                remedy="compile the loop again with it",
            )
        if varied is None:
            varied = self.varied(runs, settings.seed, first)
        shared = len(program.varied.names)
        columns_plant = self.columns((*program.varied.names, *program.varied.plant))

        noise = settings.noise_of([s.name for s in program.states])
        result = blank(program, settings, varied)
        stop = np.zeros(1, dtype=np.int64)
        threads = settings.threads or available_cores()
        blocks = max(1, min(most_blocks(program, settings), runs // (4 * threads * WIDTH)))
        bounds = [(a, min(a + blocks * WIDTH, runs)) for a in range(0, runs, blocks * WIDTH)]
        counters = [np.zeros(1, dtype=np.int64) for _ in bounds]
        numbers = Numbers(
            plant=self.parameter_array(plant, settings.sample_time),
            gains=self.parameter_array(None, settings.sample_time),
            varied_plant=columns_plant,
            varied_gains=columns_plant[:shared],
            own_plant=varied,
            own_gains=varied[:, :shared],
            noise=noise,
        )
        late = settings.delay_samples > 0
        if late and program.measures_process:
            raise SimulationError(
                "the law measures a disturbance with a stochastic process, and sees it late",
                expected="delay = 0",
                remedy="leave the delay out, or the disturbance out of what the law reads",
                key="delay",
            )
        kind = Kind(bool(noise.any()), late, settings.switch_limit, settings.until_goal)
        if settings.device != "cpu":
            device = device_named(settings.device)
            program.check_alone()
            began = time.perf_counter()
            simulate_on(
                device,
                program,
                self._kind(kind),
                starts,
                settings,
                numbers,
                result,
                first,
                progress,
            )
            return replace(result, wall_time=time.perf_counter() - began)
        loop, functions = self.loop(kind)
        if program.table is not None:
            steps = samples * (1 if not program.continuous else len(program.stepper.b) + 2)
            table = for_look_ups(program.table[0], -(-runs // WIDTH) * steps)
            program = replace(program, table=(table, *program.table[1:]))

        def work(start: int, stop_at: int, counter: npt.NDArray[np.int64]) -> None:
            some = Blocks(loop, functions, program, settings, stop_at - start)
            some.begin(starts, numbers, start, first)
            while some.advance(result, start, stop):
                counter[0] = (stop_at - start) * some.recorded * stride
            some.write_notes(result, start)
            counter[0] = (stop_at - start) * (samples + 1)

        def handed(commander: Commander) -> None:
            for start in range(0, runs, commander.most):
                some = min(commander.most, runs - start)
                batch = Blocks(loop, functions, program, settings, some)
                batch.begin(starts, numbers, start, first)

                def tell(sample: int, start: int = start, some: int = some) -> None:
                    if progress is not None:
                        progress((start + some * sample / (samples + 1)) / runs)

                with for_user():
                    commander.begin(range(first + start, first + start + some))
                try:
                    advance_handed(batch, result, start, commander, tell)
                finally:
                    with for_user():
                        commander.end()
                batch.write_notes(result, start)

        began = time.perf_counter()
        if commander is not None:
            handed(commander)
        else:
            run_threads(work, bounds, counters, threads, stop, runs * (samples + 1), progress)
        return replace(result, wall_time=time.perf_counter() - began)


_NONE = np.zeros(1)


@cache
def _drawn(name: str, leaf: Callable[[int], Leaf], count: int) -> Leaves:
    """The compiled leaf that draws so many numbers."""
    return compiled_leaves({name: leaf(count)})


def _draws(runs: npt.NDArray[np.int64], draw: int | npt.NDArray[np.int64], seed: int) -> Array:
    """The rows of `random_leaves.DRAW` for so many numbers."""
    rows = np.empty((len(runs), 4))
    rows[:, 0], rows[:, 1] = runs, draw
    rows[:, 2:] = seed & 0xFFFFFFFF, seed >> 32
    return rows
