"""Closed loops of a law that another controller hands its command: sample by sample."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.simulation.blocks import Blocks
from holdfast.execution.simulation.trajectories import Trajectories

Command = Callable[[float, Array], Array]
"""A function of t [s] and the states (run, state) to commands (run, input)."""

Alive = npt.NDArray[np.bool_]


class Commander(Protocol):
    """Another controller; most: how many runs it can command at a time."""

    most: int

    def begin(self, runs: range) -> None:
        """Before the first sample of these runs."""

    def command(self, t: float, states: Array, alive: Alive) -> Array:
        """The command of every run, a row each, at the states that are measured."""

    def end(self) -> None:
        """After the last sample of the runs, whatever ended them."""


class _Function:
    """A function as a commander of all runs together."""

    most = sys.maxsize

    def __init__(self, function: Command) -> None:
        self.function = function

    def begin(self, runs: range) -> None:
        pass

    def command(self, t: float, states: Array, alive: Alive) -> Array:
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
        return _Function(command)
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
                answer = commander.command(float(time[0, 0, 0]), states.copy(), alive)
                try:
                    given = np.asarray(answer, dtype=np.float64)
                except (TypeError, ValueError, OverflowError):
                    raise SimulationError(
                        "the controller commands no array of numbers", expected=", ".join(handed)
                    ) from None
                if given.shape != (runs, len(handed)):
                    raise SimulationError(
                        f"the controller commands an array of the shape {given.shape}",
                        expected=f"({runs}, {len(handed)}): {', '.join(handed)}",
                    )
                for i in range(len(handed)):
                    blocks.set_runs("seen", given[:, i], behind + i)
                blocks.stage("control")
                if k == 0:
                    blocks.stage("record")
                if not last:
                    blocks.stage("move")
                sample += 1
                tell(sample)
        blocks.end_records(out, first, count)
