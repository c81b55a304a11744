"""What is recorded of a batch of runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.simulation.settings import Settings


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
    values then, of a field only, varied (run, name): what the run had values of its own for,
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
    wall_time: float = 0.0


def blank(program: ClosedLoopProgram, settings: Settings, varied: Array) -> Trajectories:
    """What runs fill; varied: what each of them has values of its own for."""
    runs, n, watch = len(varied), len(program.states), len(program.constraints)
    stride = settings.stride
    rows = settings.samples // stride + 1

    def of(*shape: int) -> Array:
        return np.full((runs, *shape), np.nan)

    kept = rows if program.safeguarded else 0
    return Trajectories(
        time=np.arange(rows, dtype=np.float64) * (stride * settings.sample_time),
        state=of(rows, n),
        input=of(rows, len(program.inputs)),
        actuator=of(rows, len(program.actuators)),
        mode=np.full((runs, rows), -1, dtype=np.int16),
        signal=of(rows, len(program.signals)),
        constraint=of(rows, watch),
        nominal=of(kept, len(program.inputs)),
        nominal_actuator=of(kept, len(program.actuators)),
        sample_slack=of(kept),
        safeguard=np.full((runs, kept), -1, dtype=np.int8),
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
    )
