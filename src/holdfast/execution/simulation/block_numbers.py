"""The numbers of blocks of runs, as they are before the first sample.

A block has an array w of numbers, in rows of `width` lanes, an array s of whole numbers, and behind
the rows of w a log, to which the loop appends a record of all lanes at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.codegen.loop_text import LANES_OF_BLOCK, LOG, RING, WIDTH
from holdfast.execution.simulation.layout import (
    FORGOTTEN,
    LATE,
    SAFEGUARD_ENTRIES,
    STRIDE,
    TABLE_ENTRIES,
    Layout,
)
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.execution.simulation.settings import Settings
from holdfast.execution.table_in_parts import read_at
from holdfast.maths.definitions.law import MOST_LEVELS

Whole = npt.NDArray[np.int64]

LOG_SIZE = 1 << 20
"""Numbers of the logs of all blocks, if each is to have more than one record."""


ONE_SECOND = 1.0 - 1e-9
"""Changes of mode that are so many seconds apart do not count as chattering together."""


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
        self.log_at, record = rows, layout.record * self.width
        self.room = max(1, min(self.records, LOG_SIZE // (count * record)))
        size = rows + self.room * record
        memory = np.zeros(count * (size + 8) + 8)
        first = -(memory.ctypes.data // 8) % 8  # rows begin where the processor's lines do
        size += -size % 8
        self.w = memory[first : first + count * size].reshape(count, size)
        self.s = np.zeros((count, layout.entries), dtype=np.int64)
        self.s[:, LOG], self.s[:, LANES_OF_BLOCK] = self.log_at, self.width
        self.s[:, STRIDE] = settings.stride
        for ring, (slots, _) in rings.items():
            self.s[:, RING + 3 * ring : RING + 3 * ring + 3] = 0, slots, starts[ring]
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

    def rows(self, name: str) -> Array:
        """The rows of a quantity: block, row, lane."""
        count, place = self.layout.counts[name], self.layout.at[name]
        part = self.w[:, place : place + count * self.width]
        return part.reshape(len(self.w), count, self.width)

    def empty_rings(self) -> None:
        """Nothing was late, and no mode changed."""
        self.w[:, self._rings] = 0.0

    def of_runs(self, name: str, row: int = 0) -> Array:
        """A row of a quantity, for each run."""
        return self.rows(name)[:, row].reshape(-1)[: self.runs]

    def set_runs(self, name: str, values: Array, row: int = 0) -> None:
        """A row of a quantity, from the value of each run."""
        repeated = np.full(len(self.w) * self.width, values[-1])
        repeated[: self.runs] = values
        self.rows(name)[:, row] = repeated.reshape(-1, self.width)

    def set_numbers(self, starts: Array, numbers: Numbers, first: int, of_all: int) -> None:
        """Those of the runs from `first` on, of which the first has the number `of_all` of all."""
        own = slice(first, first + self.runs)
        for name, values, varied, each in (
            ("plant", numbers.plant, numbers.varied_plant, numbers.own_plant),
            ("gains", numbers.gains, numbers.varied_gains, numbers.own_gains),
        ):
            self.rows(name)[:, : len(values)] = values[:, np.newaxis]
            for j, column in enumerate(varied):
                self.set_runs(name, each[own, j], column)
        for i in range(starts.shape[1]):
            self.set_runs("q", starts[own, i], i)
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
