"""Blocks of runs: their numbers, the compiled functions that advance them, what is read from them.

A block has an array w of numbers, in rows of `width` lanes, an array s of whole numbers, and behind
the rows of w a log, to which the loop appends a record of all lanes at a time.

The loop calls its parts through their addresses. Of a table of which only what is read is in memory
that of the look-up is the address of a function of Python, which fetches what the lanes will read,
and then calls the look-up itself; so the loop, and every bit that it computes, are the same as for
a table in memory.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import AnyArray, Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.codegen.scalar_llvm import address
from holdfast.execution.leaf import Leaves, Machine, compiled_leaves, compiled_text
from holdfast.execution.simulation.built_loop import (
    FORGOTTEN,
    KEPT,
    LANES_OF_BLOCK,
    LATE,
    LOG,
    LOG_AT,
    LOOK_UP,
    PITCH,
    RECORDS,
    RING,
    RINGS_AT,
    SAFEGUARD_ENTRIES,
    SINGLE,
    STAGES,
    STRIDE,
    TABLE_ENTRIES,
    WHOLE_RUNS,
    WIDTH,
    Layout,
    Loop,
)
from holdfast.execution.simulation.settings import Outcome, Settings
from holdfast.execution.table_in_parts import TableInParts, read_at
from holdfast.maths.definitions.law import MOST_LEVELS

Whole = npt.NDArray[np.int64]

LOG_SIZE = 1 << 20
"""Numbers of the logs of all blocks, if each is to have more than one record."""


ONE_SECOND = 1.0 - 1e-9
"""Changes of mode that are so many seconds apart do not count as chattering together."""


@dataclass(frozen=True)
class Trajectories:
    """The trajectories of a batch of runs; the first axis of every array but `time` is the run.

    state, input, actuator, signal, constraint: (run, time, ...); mode: (run, time).
    nominal, nominal_actuator (run, time, ...): the command of the law before its safeguard, as
    inputs and as actuators; sample_slack (run, time): how far its conditions were relaxed;
    safeguard (run, time): a `SafeguardAnswer`, -1 after the end of a run. They have no samples
    where there is no safeguard.
    outcome, exit_time [s], exit_constraint (-1: none), goal_time [s] (since when the run is
    in the goal at its end), worst (run, constraint): the largest c_j over all of time,
    peak_input, peak_actuator: the largest magnitudes, switches: changes of mode,
    shortest_dwell [s]: between two of them (infinite where there are not two), overruled: control
    samples at which the safeguard changed the command, infeasible: those at which it found no
    admissible input, largest_slack: the most it needed, rejected: adaptive steps refused,
    off_grid [s]: when the law first asked its table outside the grid or the cells (NaN: never),
    beyond (run, 1 + disturbances): when a field first exceeded its bounds (NaN: never) and its
    values then, of a field only, wander (run, time, process): of the disturbance,
    varied (run, name): what the run had values of its own for,
    wall_time: seconds of simulation, without compilation.
    """

    time: Array
    state: Array
    input: Array
    actuator: Array
    mode: npt.NDArray[np.int16]
    signal: Array
    constraint: Array
    nominal: Array
    nominal_actuator: Array
    sample_slack: Array
    safeguard: npt.NDArray[np.int8]
    outcome: npt.NDArray[np.int8]
    exit_time: Array
    exit_constraint: npt.NDArray[np.int16]
    goal_time: Array
    worst: Array
    peak_input: Array
    peak_actuator: Array
    switches: npt.NDArray[np.int64]
    shortest_dwell: Array
    overruled: npt.NDArray[np.int64]
    infeasible: npt.NDArray[np.int64]
    largest_slack: Array
    rejected: npt.NDArray[np.int64]
    off_grid: Array
    beyond: Array
    varied: Array
    wander: Array
    wall_time: float = 0.0


def blank(program: ClosedLoopProgram, settings: Settings, varied: Array) -> Trajectories:
    """What runs fill; varied: what each of them has values of its own for. varied: shape (runs,
    quantities)."""
    runs, n, watch = len(varied), len(program.states), len(program.constraints)
    stride = settings.stride
    rows = settings.samples // stride + 1

    def of(*shape: int) -> Array:
        return np.full((runs, *shape), np.nan)

    guarded = rows if program.safeguarded else 0
    return Trajectories(
        time=np.arange(rows, dtype=np.float64) * (stride * settings.sample_time),
        state=of(rows, n),
        input=of(rows, len(program.inputs)),
        actuator=of(rows, len(program.actuators)),
        mode=np.full((runs, rows), -1, dtype=np.int16),
        signal=of(rows, len(program.signals)),
        constraint=of(rows, watch),
        nominal=of(guarded, len(program.inputs)),
        nominal_actuator=of(guarded, len(program.actuators)),
        sample_slack=of(guarded),
        safeguard=np.full((runs, guarded), -1, dtype=np.int8),
        outcome=np.zeros(runs, dtype=np.int8),
        exit_time=of(),
        exit_constraint=np.full(runs, -1, dtype=np.int16),
        goal_time=of(),
        worst=np.full((runs, watch), -np.inf),
        peak_input=np.zeros((runs, len(program.inputs))),
        peak_actuator=np.zeros((runs, len(program.actuators))),
        switches=np.zeros(runs, dtype=np.int64),
        shortest_dwell=np.full(runs, np.inf),
        overruled=np.zeros(runs, dtype=np.int64),
        infeasible=np.zeros(runs, dtype=np.int64),
        largest_slack=np.zeros(runs),
        rejected=np.zeros(runs, dtype=np.int64),
        off_grid=of(),
        beyond=of(1 + program.bounded if program.bounded else 0),
        varied=varied,
        wander=of(rows, program.wandering),
    )


class Numbers(NamedTuple):
    """The numbers with which the expressions of a closed loop are evaluated.

    plant: the parameters of the simulated vehicle; gains: those that its controller believes, in
    the same order. varied_plant: columns of `plant` for which every run has its own values, in
    its row of `own_plant`; likewise for the gains. noise: (uniform or normal, state).
    """

    plant: Array
    gains: Array
    varied_plant: Whole
    varied_gains: Whole
    own_plant: Array
    own_gains: Array
    noise: Array


def rings_of(
    program: ClosedLoopProgram, settings: Settings, width: int = WIDTH
) -> dict[int, tuple[int, int]]:
    """The slots of each ring of a block, and the numbers in one."""
    second = int(np.ceil(ONE_SECOND / settings.sample_time)) if any(program.targets) else 0
    return {
        LATE: (settings.delay_samples + 1, len(program.states) * width),
        FORGOTTEN: (second + 1, width),
    }


class BlockNumbers:
    """As many blocks as `runs` need; the last lanes without a run repeat the last one."""

    def __init__(
        self,
        layout: Layout,
        program: ClosedLoopProgram,
        settings: Settings,
        runs: int,
    ) -> None:
        self.layout, self.width = layout, layout.width
        self.program, self.runs = program, runs
        self.stride, self.recorded = settings.stride, 0
        self.records = settings.samples // settings.stride + 1
        count = -(-runs // self.width)
        rings = rings_of(program, settings, self.width)
        starts, rows = {}, layout.size
        for ring, (slots, size) in rings.items():
            starts[ring] = rows
            rows += slots * size
        self.rings_at, self.log_at, record = layout.size, rows, layout.record * self.width
        self.room = max(1, min(self.records, LOG_SIZE // (count * record)))
        size = rows + self.room * record
        memory = np.zeros(count * (size + 8) + 8)
        first = -(memory.ctypes.data // 8) % 8  # rows begin where the processor's lines do
        size += -size % 8
        self.w = memory[first : first + count * size].reshape(count, size)
        self.s = np.zeros((count, layout.entries), dtype=np.int64)
        self.s[:, LANES_OF_BLOCK] = self.s[:, PITCH] = self.width
        self.s[:, STRIDE] = settings.stride
        addresses = self.w.ctypes.data + 8 * size * np.arange(count)
        self.s[:, LOG_AT] = addresses + 8 * self.log_at
        self.s[:, RINGS_AT] = addresses + 8 * self.rings_at
        for ring, (slots, _) in rings.items():
            first = (starts[ring] - self.rings_at) // self.width
            self.s[:, RING + 3 * ring : RING + 3 * ring + 3] = 0, slots, first
        self._late = slice(starts[LATE], starts[FORGOTTEN]), rings[LATE][0]
        self._rings = slice(starts[LATE], rows)
        self._fill_parts()
        constants = {
            "length": settings.sample_time / settings.substeps,
            "last_index": settings.substeps - 1, "tolerance": settings.tolerance,
            "sample_time": settings.sample_time, "delay": settings.delay_samples,
            "absolute": settings.absolute, "relative": settings.relative,
            "trial": settings.sample_time, "exit_time": np.nan, "exit_constraint": -1.0,
            "shortest": np.inf, "inside_since": np.nan, "off_at": np.nan, "beyond": np.nan,
            "mode": program.initial_mode, "outcome": Outcome.STAYED,
            "seed_low": settings.seed & 0xFFFFFFFF, "seed_high": settings.seed >> 32,
        }  # fmt: skip
        for name, value in constants.items():
            self.rows(name)[:] = value

    def now(self) -> tuple[Array, Whole]:
        """All that these numbers are now; blocks of the same layout `resume` it, in another process
        too. w: shape (blocks, numbers); s: shape (blocks, entries)."""
        return self.w.copy(), self.s.copy()

    def resume(self, earlier: tuple[Array, Whole]) -> None:
        """The numbers are as they were; addresses stay. earlier: of the shapes (blocks, numbers)
        and (blocks, entries)."""
        w, s = earlier
        places = [LOG_AT, RINGS_AT, *(self.layout.tables if self.program.table is not None else ())]
        addresses = self.s[:, places].copy()
        self.w[:], self.s[:] = w, s
        self.s[:, places] = addresses

    def rows(self, name: str) -> Array:
        """The rows of a quantity, shape (blocks, rows, width): each row has a number for every
        lane."""
        count, place = self.layout.counts[name], self.layout.at[name]
        part = self.w[:, place : place + count * self.width]
        return part.reshape(len(self.w), count, self.width)

    def empty_rings(self) -> None:
        """Nothing was late, and no mode changed."""
        self.w[:, self._rings] = 0.0

    def of_runs(self, name: str, row: int = 0) -> Array:
        """A row of a quantity, for each run, shape (runs,)."""
        return self.rows(name)[:, row].reshape(-1)[: self.runs]

    def set_runs(self, name: str, values: Array, row: int = 0) -> None:
        """A row of a quantity, from the value of each run, shape (runs,)."""
        repeated = np.full(len(self.w) * self.width, values[-1])
        repeated[: self.runs] = values
        self.rows(name)[:, row] = repeated.reshape(-1, self.width)

    def set_numbers(self, starts: Array, numbers: Numbers, first: int, of_all: int) -> None:
        """Those of the runs from `first` on, of which the first has the number `of_all` of all.
        starts: shape (runs, states)."""
        runs = slice(first, first + self.runs)
        for name, values, varied, each in (
            ("plant", numbers.plant, numbers.varied_plant, numbers.own_plant),
            ("gains", numbers.gains, numbers.varied_gains, numbers.own_gains),
        ):
            self.rows(name)[:, : len(values)] = values[:, np.newaxis]
            for j, column in enumerate(varied):
                self.set_runs(name, each[runs, j], column)
        for i in range(starts.shape[1]):
            self.set_runs("q", starts[runs, i], i)
        self.rows("noise")[:] = numbers.noise.reshape(-1, 1)
        self.set_runs("run", of_all + first + np.arange(self.runs, dtype=np.float64))
        alive = np.arange(len(self.w) * self.width) < self.runs
        self.rows("alive")[:, 0] = alive.reshape(-1, self.width)
        part, slots = self._late
        place, n = self.layout.at["q"], self.layout.counts["q"] * self.width
        self.w[:, part] = np.tile(self.w[:, place : place + n], (1, slots))

    def _fill_parts(self) -> None:
        """The entries of s and the places in w that the parts read."""
        layout, program, at = self.layout, self.program, self.layout.at
        for mode, k in layout.safeguards.items():
            (count, hard), ends = program.conditions_of_modes[mode], program.levels_of_modes[mode]
            self.s[:, k : k + SAFEGUARD_ENTRIES] = (
                len(program.inputs), count, hard, at["answer"], at["command"], at["slack"],
                at["overruled"], at["held"], at["room"], layout.whole, len(ends),
                *ends, *(0 for _ in range(MOST_LEVELS - len(ends))),
                *(program.foresight_of_modes[mode] or (0, 0, 0, 0, 0)), layout.tables[0],
            )  # fmt: skip
        if program.table is None:
            return
        values, low, steps, shape, periodic, *of_cells = program.table
        numbers, rows = of_cells or ((), 0)
        self.w[:, at["cells"] : at["cells"] + len(numbers)] = numbers
        for k in layout.tables:
            noted = k == layout.tables[0]
            self.s[:, k : k + TABLE_ENTRIES] = (
                read_at(values), program.timed, noted, program.places, at["look_at"],
                at["look"], at["alive"], at["time"], at["off_at"], at["outcome"], at["exit_time"],
                at["grid"], layout.whole, at["cells"], rows, program.found,
            )  # fmt: skip
            self.s[:, k + TABLE_ENTRIES :][:, : 2 * program.places] = *shape, *periodic
        self.w[:, at["grid"] : at["grid"] + 2 * program.places] = *low, *steps


_PART = ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64


@dataclass
class _Noted:
    """What was raised, and how many look-ups were done."""

    failure: BaseException | None = None
    done: int = 0


class Fetching:
    """The look-up of the loops of some blocks in `table`, over a grid.

    look_up: the address of the look-up of a table in memory. address: that of the one that fetches.
    """

    def __init__(
        self, table: TableInParts, grid: tuple[AnyArray, ...], layout: Layout, look_up: int
    ) -> None:
        """grid: lowest nodes, steps, shape and whether periodic, each of the shape (axes,)."""
        self._noted = _Noted()
        # no method of this object, or the table would stay until a collection
        self._function = ctypes.CFUNCTYPE(None, *_PART)(
            _fetching(table, grid, layout, ctypes.PYFUNCTYPE(None, *_PART)(look_up), self._noted)
        )
        address = ctypes.c_void_p.from_buffer(self._function).value  # a cast would keep it
        assert address is not None
        self.address = address

    def in_place_of(self, addresses: npt.NDArray[np.int64], number: int) -> npt.NDArray[np.int64]:
        """The addresses of what a loop calls, with this one at the place `number`. Both have the
        shape (functions,)."""
        replaced = addresses.copy()
        replaced[number] = self.address
        return replaced

    def begin(self) -> None:
        """Before the loop is called, for as many look-ups as are told at `end`.

        What was raised in an earlier call that was interrupted before its end is forgotten.
        """
        self._noted.failure, self._noted.done = None, 0

    def end(self, look_ups: int = 0) -> None:
        """After the loop was called: raises what was raised in it.

        look_ups: at least so many have to be done since `begin`. An interruption of the main thread
        may come before the first line of the function that fetches: the loop goes on then without
        the look-up, and what Python raised is lost, so that it is raised here.
        """
        failure, self._noted.failure = self._noted.failure, None
        if failure is not None:
            raise failure
        if self._noted.done < look_ups:
            raise KeyboardInterrupt


def _fetching(
    table: TableInParts,
    grid: tuple[AnyArray, ...],
    layout: Layout,
    look_up: Callable[[int, int, int], None],
    noted: _Noted,
) -> Callable[[int, int, int], None]:
    """The function that the loop calls with the addresses of s and w, and the place of entries."""
    axes, width = layout.counts["look_at"], layout.width
    looked_at, alive = 8 * layout.at["look_at"], 8 * layout.at["alive"]
    rows, row = ctypes.c_double * (axes * width), ctypes.c_double * width

    def called(s: int, w: int, entries: int) -> None:
        if noted.failure is not None:
            return
        try:
            goes = np.ctypeslib.as_array(row.from_address(w + alive)) != 0.0
            places = np.ctypeslib.as_array(rows.from_address(w + looked_at)).reshape(axes, width)
            with table.using:
                table.fetch_looked_up(places.T[goes], grid)
                look_up(s, w, entries)
            noted.done += 1
        except BaseException as error:
            noted.failure = error

    return called


NOTES = {
    "outcome": "outcome", "goal_time": "inside_since", "exit_time": "exit_time",
    "exit_constraint": "exit_constraint", "switches": "switches",
    "shortest_dwell": "shortest", "overruled": "overrules", "infeasible": "infeasible",
    "largest_slack": "largest_slack", "rejected": "rejected", "off_grid": "off_at",
}  # fmt: skip
"""Arrays of the result, with the rows that they come from."""

NOTED = (*NOTES.values(), "worst", "peaks", "beyond")
"""The rows that are read at the end of a run."""


def write_records(
    out: Trajectories,
    layout: Layout,
    log: Array,
    done: Whole,
    runs: slice,
    recorded: int,
    *,
    safeguarded: bool,
) -> None:
    """Records from the number `recorded` on.

    log: (block, record, row, lane), of which the first `done` of each block are there; the others,
    and those of lanes that have ended, are NaN.
    """
    many, count = runs.stop - runs.start, log.shape[1]
    alive = log[:, :, 0] != 0.0
    alive &= (np.arange(count) < done[:, np.newaxis])[:, :, np.newaxis]
    alive = alive.transpose(0, 2, 1).reshape(-1, count)[:many]
    ended = None if alive.all() else ~alive
    place = runs, slice(recorded, recorded + count)

    def of(name: str) -> Array:
        """(run, record, row)"""
        rows = log[:, :, layout.records[name]]
        by_run = rows.transpose(0, 3, 1, 2).reshape(-1, count, rows.shape[2])[:many]
        if ended is not None:
            by_run[ended] = np.nan
        return by_run

    for name in layout.records:
        if name in ("alive", "mode", "safeguard", "sample_slack"):
            continue
        getattr(out, name)[place] = of(name)
    mode = of("mode")[:, :, 0]
    out.mode[place] = mode if ended is None else np.where(ended, -1.0, mode)
    if safeguarded:
        slack = of("sample_slack")[:, :, 0]
        answer = np.where(slack > 0.0, 2.0, of("safeguard")[:, :, 0])
        out.sample_slack[place] = slack
        out.safeguard[place] = answer if ended is None else np.where(ended, -1.0, answer)


def write_notes(
    out: Trajectories, rows: Mapping[tuple[str, int], Array], runs: slice, inputs: int
) -> None:
    """What is known of each run at its end. rows[name, k]: the k-th row of a quantity, by run. Each
    row has the shape (runs,)."""
    for name, of in NOTES.items():
        getattr(out, name)[runs] = rows[of, 0]
    for array, of, before in (
        (out.worst, "worst", 0), (out.peak_input, "peaks", 0),
        (out.peak_actuator, "peaks", inputs), (out.beyond, "beyond", 0),
    ):  # fmt: skip
        for i in range(array.shape[1]):
            array[runs, i] = rows[of, before + i]


MOST_BLOCKS, MOST_NUMBERS = 64, 1 << 22
"""Blocks of runs that one thread advances together, and numbers in their rings."""


class Functions(NamedTuple):
    """The compiled functions of a loop, and the addresses of the leaves and parts that it calls."""

    begin: Callable[..., None]
    advance: Callable[..., None]
    finish: Callable[..., None]
    end: Callable[..., None]
    sample: Callable[..., None]
    first: Callable[..., None]
    answer: Callable[..., None]
    addresses: Whole
    stages: list[Callable[..., None]]


def functions_of(loop: Loop, program: Leaves) -> Functions:
    """The compiled functions of a loop; `program`: the leaves of its program."""
    machine, leaves = _own(loop)
    addresses = []
    for name in loop.called:
        place = program.addresses.get(name) or leaves.addresses.get(name)
        addresses.append(place if place is not None else _part(name))
    lists = WHOLE_RUNS, STAGES * loop.staged
    first, stages = ([machine.function(f"holdfast_{n}", 4) for n in names] for names in lists)
    return Functions._make([*first, np.array(addresses, dtype=np.int64), stages])


@lru_cache(KEPT)
def _own(loop: Loop) -> tuple[Machine, Leaves]:
    """The compiled text of a loop, and its own leaves."""
    return compiled_text(loop.text), compiled_leaves(loop.leaves)


def _part(name: str) -> int:
    """The address of a part of the loop; a table in single precision has a part of its own."""
    plain = name.removesuffix(SINGLE)
    return address("simulation/parts", plain, single=plain != name)


def most_blocks(program: ClosedLoopProgram, settings: Settings) -> int:
    """Blocks that one thread advances together: few, if their rings are long."""
    numbers = sum(slots * size for slots, size in rings_of(program, settings).values())
    return max(1, min(MOST_BLOCKS, MOST_NUMBERS // numbers))


class Blocks(BlockNumbers):
    """Blocks that are advanced by the compiled functions of their loop."""

    def __init__(
        self,
        loop: Loop,
        functions: Functions,
        program: ClosedLoopProgram,
        settings: Settings,
        runs: int,
    ) -> None:
        super().__init__(loop.layout, program, settings, runs)
        self.functions = functions
        self.fetching: Fetching | None = None
        if program.table is not None and isinstance(program.table[0], TableInParts):
            self._fetch(loop, program.table[0], program.table[1:5])

    def _fetch(self, loop: Loop, table: TableInParts, grid: tuple[AnyArray, ...]) -> None:
        """Let the loop fetch what it looks up."""
        number = next(k for k, n in enumerate(loop.called) if n.removesuffix(SINGLE) == LOOK_UP)
        addresses = self.functions.addresses
        fetching = Fetching(table, grid, self.layout, int(addresses[number]))
        addresses = fetching.in_place_of(addresses, number)
        self.functions, self.fetching = self.functions._replace(addresses=addresses), fetching

    def begin(self, starts: Array, numbers: Numbers, first: int, of_all: int) -> None:
        """Begin the runs from `first` on, of which the first has the number `of_all` of all.
        starts: shape (runs, states)."""
        self.set_numbers(starts, numbers, first, of_all)
        self._call_all(self.functions.begin)

    def advance(self, out: Trajectories, first: int, stop: Whole) -> bool:
        """The next records to the arrays `out` from the run `first` on; whether there are more.
        stop: 1 ends the runs, shape (1,)."""
        count = self.begin_records()
        ends = self.recorded + count == self.records
        self.s[:, RECORDS] = count - ends
        if count > ends:
            self._call_all(self.functions.advance, stop)
        if ends and not stop[0]:
            self._call_all(self.functions.finish, stop)
        self.end_records(out, first, count)
        return not ends and not stop[0] and bool(self.rows("alive").any())

    def stage(self, name: str) -> None:
        """One part of a sample of every block."""
        look_ups = len(self.w) if name == "control" else 0
        self._call_all(self.functions.stages[STAGES.index(name)], look_ups=look_ups)

    def begin_records(self) -> int:
        """Room for the next records, written by the stage `record`; how many."""
        count = min(self.room, self.records - self.recorded)
        self.s[:, LOG] = 0
        return count

    def end_records(self, out: Trajectories, first: int, count: int) -> None:
        """These records to the arrays `out` from the run `first` on."""
        record = self.layout.record
        done = self.s[:, LOG] // (record * self.width)
        log = self.w[:, self.log_at : self.log_at + count * record * self.width]
        log = log.reshape(len(self.w), count, record, self.width)
        runs = slice(first, first + self.runs)
        safeguarded = self.program.safeguarded
        write_records(out, self.layout, log, done, runs, self.recorded, safeguarded=safeguarded)
        self.recorded += count

    def sample(self, *, first: bool = False) -> None:
        """One sample of every block, at its rows `time`; first: after new parameters."""
        if first:
            self._call_all(self.functions.first)
        self._call_all(self.functions.sample)

    def _call_all(
        self, function: Callable[..., None], stop: Whole | None = None, look_ups: int = 0
    ) -> None:
        stop = NEVER if stop is None else stop
        if self.fetching is not None:
            self.fetching.begin()
        for w, s in zip(self.w, self.s, strict=True):
            function(
                w.ctypes.data, s.ctypes.data, self.functions.addresses.ctypes.data, stop.ctypes.data
            )
        if self.fetching is not None:
            self.fetching.end(look_ups)

    def write_notes(self, out: Trajectories, first: int) -> None:
        """What is known of each run at its end, to the arrays `out` from the run `first` on."""
        self._call_all(self.functions.end)
        counts = self.layout.counts
        rows = {(n, k): self.of_runs(n, k) for n in NOTED for k in range(counts[n])}
        write_notes(out, rows, slice(first, first + self.runs), len(self.program.inputs))


NEVER = np.zeros(1, dtype=np.int64)
"""Nobody stops the loop."""
