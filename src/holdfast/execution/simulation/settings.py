"""Settings of a simulation (times, steps, noise, seed), and what is recorded of a batch of runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypedDict

import numpy as np
import numpy.typing as npt

from holdfast.arguments import OfStates, Seconds, checked
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.device.program import DEVICES


@checked
@dataclass(frozen=True)
class Settings:
    """Settings of a simulation.

    horizon: seconds simulated. sample_time: seconds between control samples; the input is
    held in between unless `continuous`. substeps: Runge-Kutta steps in one sample time (fixed
    steps) or tolerances `absolute` and `relative` (adaptive pair). record_every: seconds
    between recorded samples. tolerance: c_j above this counts as leaving the region.
    noise_uniform, noise_normal: half-width and standard deviation of the measurement noise
    of each state. switch_limit: changes of mode within one second beyond which a run counts
    as chattering. delay: seconds by which the law sees everything late. until_goal: whether a run
    ends at its first sample in the goal. seed: of every random number. threads: 0 for one per core.
    device: "cpu"; "gpu", a run for each thread of a graphics processor, by way of CuPy; "c++", the
    same kernel compiled by the C++ compiler of this machine.
    """

    horizon: Seconds
    sample_time: Seconds = 0.02
    substeps: int = 2
    record_every: Seconds = 0.1
    continuous: bool = False
    absolute: float = 1e-9
    relative: float = 1e-9
    tolerance: float = 0.0
    noise_uniform: OfStates = field(default_factory=dict)
    noise_normal: OfStates = field(default_factory=dict)
    switch_limit: int = 10
    delay: Seconds = 0.0
    until_goal: bool = False
    seed: int = 0
    threads: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        for name in ("horizon", "sample_time", "record_every", "absolute", "relative"):
            value = getattr(self, name)
            if not (_is_number(value) and value > 0):
                raise SimulationError(f"{name} is {value!r}", expected="a positive number")
        if not (_is_number(self.tolerance) and self.tolerance >= 0):
            raise SimulationError(f"tolerance is {self.tolerance!r}", expected="0 or more")
        if not (_is_number(self.delay) and 0 <= self.delay <= self.horizon):
            raise SimulationError(f"delay is {self.delay!r}", expected="0 s up to the horizon")
        if self.device not in DEVICES:
            raise SimulationError(
                f"device is {self.device!r}", remedy=suggestion(str(self.device), DEVICES)
            )
        if self.continuous and self.delay:
            raise SimulationError(
                "a delay with continuous control", remedy="sample the control", key="delay"
            )
        if not isinstance(self.until_goal, bool):
            raise SimulationError(f"until_goal is {self.until_goal!r}", expected="true or false")
        for name, least in (("substeps", 1), ("switch_limit", 1), ("threads", 0)):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= least):
                raise SimulationError(f"{name} is {value!r}", expected=f"a whole number >= {least}")
        for name, unit in (
            ("horizon", "sample_time"),
            ("record_every", "sample_time"),
            ("horizon", "record_every"),
            ("delay", "sample_time"),
        ):
            ratio = getattr(self, name) / getattr(self, unit)
            least = 0 if name == "delay" else 1
            if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < least:
                raise SimulationError(
                    f"{name} is {getattr(self, name):g} s, {unit} {getattr(self, unit):g} s",
                    expected=f"{name} a whole multiple of {unit}",
                )
        if not (isinstance(self.seed, int) and 0 <= self.seed < 2**64):
            raise SimulationError(f"seed is {self.seed!r}", expected="0 to 2^64 - 1")
        for noise in (self.noise_uniform, self.noise_normal):
            for state, size in noise.items():
                if not (_is_number(size) and size >= 0):
                    raise SimulationError(
                        f"noise of '{state}' is {size!r}", expected="0 or more", key="noise"
                    )
            if self.continuous and any(noise.values()):
                raise SimulationError(
                    "measurement noise with continuous control",
                    remedy="sample the control: white noise has no continuous meaning here",
                    key="noise",
                )

    @property
    def samples(self) -> int:
        return round(self.horizon / self.sample_time)

    @property
    def delay_samples(self) -> int:
        return round(self.delay / self.sample_time)

    @property
    def stride(self) -> int:
        return round(self.record_every / self.sample_time)

    def noise_of(self, states: Sequence[str]) -> Array:
        """Half-widths and standard deviations of the noise of these states, shape (2, state)."""
        noise = np.zeros((2, len(states)))
        for row, sizes in enumerate((self.noise_uniform, self.noise_normal)):
            for name, size in sizes.items():
                if name not in states:
                    raise SimulationError(f"noise of '{name}', which is not a state", key="noise")
                noise[row, states.index(name)] = size
        return noise


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return bool(np.isfinite(value))


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


class SettingsOptions(TypedDict, total=False):
    """The fields of `Settings` but the horizon, as options of a function."""

    sample_time: Seconds
    substeps: int
    record_every: Seconds
    continuous: bool
    absolute: float
    relative: float
    tolerance: float
    noise_uniform: OfStates
    noise_normal: OfStates
    switch_limit: int
    delay: Seconds
    until_goal: bool
    seed: int
    threads: int
    device: str
