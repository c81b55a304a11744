"""One control sample of a closed loop, for other simulators: the loop of `simulate`, on one run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.execution.simulation.block_numbers import Numbers
from holdfast.execution.simulation.blocks import Blocks
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.settings import Settings

_NONE = np.empty(0, dtype=np.int64)


class Controller(NamedTuple):
    """What a controller carries from one sample to the next; no memory: it begins."""

    memory: Array | None
    mode: int
    in_mode: float


class Sample(NamedTuple):
    """The input of a sample, with the unfiltered command and the slack of a safeguard; the end."""

    state: Array
    controller: Controller
    input: Array
    nominal: Array
    slack: float


class OneRun:
    """A closed loop that is advanced by one control sample at a time."""

    def __init__(self, loop: ClosedLoop, settings: Settings) -> None:
        loop.program.check_alone()
        self.program, self.sample_time = loop.program, settings.sample_time
        self.blocks = Blocks(*loop.loop(), loop.program, settings, runs=1)

    def sample(self, t: float, state: Array, before: Controller, p: Array) -> Sample:
        """One control sample as `simulate` computes it; `p` ends with the sample time [s]."""
        program, blocks, limited = self.program, self.blocks, self.program.limited
        none = np.empty((1, 0))
        numbers = Numbers(p, p, _NONE, _NONE, none, none, np.zeros((2, len(state))))
        blocks.rows("time")[:] = blocks.rows("seen_at")[:] = t
        blocks.rows("mode")[:], blocks.rows("since")[:] = before.mode, t - before.in_mode
        blocks.begin(state[np.newaxis], numbers, 0, 0)
        if before.memory is not None:
            blocks.rows("memory")[:] = before.memory[:, np.newaxis]
        blocks.sample()

        def row(name: str) -> Array:
            found: Array = blocks.rows(name)[0, :, 0].copy()
            return found

        mode, u = int(row("mode")[0]), row("actuation")[2 * limited :]
        nominal = row("nominal") if program.safeguarded else row("command")
        slack = float(row("slack")[0])
        stays = before.in_mode if mode == before.mode else 0.0
        controller = Controller(row("memory"), mode, stays + self.sample_time)
        return Sample(row("q"), controller, u, nominal, slack)
