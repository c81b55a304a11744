"""Blocks of runs that are advanced by compiled functions, and what is read from them."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from holdfast.execution.arrays import AnyArray, Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.codegen.loop_text import LOG
from holdfast.execution.leaf import Leaves, Machine, compiled_leaves, compiled_text
from holdfast.execution.scalar import address
from holdfast.execution.simulation.block_numbers import BlockNumbers, Numbers, Whole, rings_of
from holdfast.execution.simulation.fetching import Fetching
from holdfast.execution.simulation.layout import RECORDS
from holdfast.execution.simulation.loop import KEPT, LOOK_UP, SINGLE, Loop
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.execution.simulation.settings import Settings
from holdfast.execution.simulation.trajectories import Trajectories
from holdfast.execution.simulation.written import NOTED, write_notes, write_records
from holdfast.execution.table_in_parts import TableInParts

MOST_BLOCKS, MOST_NUMBERS = 64, 1 << 22
"""Blocks of runs that one thread advances together, and numbers in their rings."""

STAGES = ("measure", "control", "record", "move")
"""The parts of a sample of a law that others hand a command."""


class Functions(NamedTuple):
    """The compiled functions of a loop, and the addresses of the leaves and parts that it calls."""

    begin: Callable[..., None]
    advance: Callable[..., None]
    finish: Callable[..., None]
    sample: Callable[..., None]
    first: Callable[..., None]
    answer: Callable[..., None]
    addresses: Whole
    stages: list[Callable[..., None]]


def functions_of(loop: Loop, program: Leaves) -> Functions:
    """The compiled functions of a loop; `program`: the leaves of its program."""
    machine, own = _own(loop)
    addresses = []
    for name in loop.called:
        place = program.addresses.get(name) or own.addresses.get(name)
        addresses.append(place if place is not None else _part(name))
    lists = Functions._fields[:-2], STAGES[: 4 * loop.staged]
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
        """Begin the runs from `first` on, of which the first has the number `of_all` of all."""
        self.set_numbers(starts, numbers, first, of_all)
        self._call_all(self.functions.begin)
        if not self.program.constraints:
            return
        c = self.rows("c0")
        self.rows("worst")[:] = c
        outside = c > self.rows("tolerance")
        left = outside.any(axis=1)
        self.rows("outcome")[:, 0][left] = Outcome.LEFT
        self.rows("exit_time")[:, 0][left] = 0.0
        self.rows("exit_constraint")[:, 0][left] = outside.argmax(axis=1)[left]

    def advance(self, out: Trajectories, first: int, stop: Whole) -> bool:
        """The next records to the arrays `out` from the run `first` on; whether there are more."""
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
        self.s[:, LOG] = self.log_at
        return count

    def end_records(self, out: Trajectories, first: int, count: int) -> None:
        """These records to the arrays `out` from the run `first` on."""
        record = self.layout.record
        done = (self.s[:, LOG] - self.log_at) // (record * self.width)
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
        counts = self.layout.counts
        rows = {(n, k): self.of_runs(n, k) for n in NOTED for k in range(counts[n])}
        write_notes(out, rows, slice(first, first + self.runs), len(self.program.inputs))


NEVER = np.zeros(1, dtype=np.int64)
"""Nobody stops the loop."""
