"""What a run is asked and how it may end: times, Runge-Kutta method, noise, seed; outcomes.

A Runge-Kutta method is a tableau. One with a second row of weights estimates its error and may
choose its own steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TypedDict

import numpy as np
import numpy.typing as npt

from holdfast.arguments import OfStates, Seconds, checked
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.device.program import DEVICES


class Outcome(IntEnum):
    """The outcome of a trajectory, with the label that users read.

    A run that left the grid stayed in its region, but reached a state where the value function of
    its law is not known.
    """

    STAYED = 0, "stayed"
    REACHED = 1, "reached goal"
    LEFT = 2, "left region"
    DIVERGED = 3, "diverged"
    CHATTERED = 4, "chattered"
    OFF_GRID = 5, "left grid"

    label: str

    def __new__(cls, number: int, label: str = "") -> Outcome:
        made = int.__new__(cls, number)
        made._value_, made.label = number, label
        return made


OUTCOMES = tuple(one.label for one in Outcome)
"""The labels, in the order of `Outcome`."""


class SafeguardAnswer(IntEnum):
    """The action of a safeguard on the command of its law at a sample."""

    KEPT = 0
    OVERRULED = 1
    INFEASIBLE = 2

    @property
    def label(self) -> str:
        return ("kept", "overruled", "no admissible input")[self]


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau: stage i is at c[i] with a[i]; the step is b; b - b_low the error."""

    name: str
    order: int
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    b_low: tuple[float, ...] | None = None

    @property
    def c(self) -> tuple[float, ...]:
        return tuple(sum(row) for row in self.a)

    @property
    def adaptive(self) -> bool:
        return self.b_low is not None

    def weights(self) -> npt.NDArray[np.float64]:
        """The rows of a, then b, b - b_low and c, each with an entry for every stage. The shape is
        (stages + 3, stages)."""
        stages = len(self.b)
        table = np.zeros((stages + 3, stages))
        for row, weights in zip(table, self.a, strict=False):
            row[: len(weights)] = weights
        table[stages] = self.b
        if self.b_low is not None:
            table[stages + 1] = np.subtract(self.b, self.b_low)
        table[stages + 2] = self.c
        return table


RK4 = Tableau(
    "rk4",
    4,
    a=((), (1 / 2,), (0, 1 / 2), (0, 0, 1)),
    b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
)
"""Kutta 1901, the classical fourth-order method."""

BOGACKI_SHAMPINE = Tableau(
    "bogacki-shampine",
    3,
    a=((), (1 / 2,), (0, 3 / 4), (2 / 9, 1 / 3, 4 / 9)),
    b=(2 / 9, 1 / 3, 4 / 9, 0),
    b_low=(7 / 24, 1 / 4, 1 / 3, 1 / 8),
)
"""P. Bogacki, L. F. Shampine, Appl. Math. Lett. 2(4), 1989: a 3(2) pair."""

DORMAND_PRINCE = Tableau(
    "dormand-prince",
    5,
    a=(
        (),
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        (35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    ),
    b=(35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0),
    b_low=(
        5179 / 57600,
        0,
        7571 / 16695,
        393 / 640,
        -92097 / 339200,
        187 / 2100,
        1 / 40,
    ),
)
"""J. R. Dormand, P. J. Prince, J. Comput. Appl. Math. 6(1), 1980: a 5(4) pair."""

ALL = (RK4, BOGACKI_SHAMPINE, DORMAND_PRINCE)
BY_NAME = {tableau.name: tableau for tableau in ALL}


@checked
@dataclass(frozen=True)
class Settings:
    """Settings of a simulation.

    horizon [s]: what is simulated. sample_time [s]: between control samples; the input is held in
    between. continuous: whether the law is evaluated at every stage instead. substeps: Runge-Kutta
    steps in one sample time, of a stepper of fixed steps. absolute, relative: tolerances of an
    adaptive pair. record_every [s]: between recorded samples. tolerance [unit of c_j]: c_j above
    this counts as leaving the region. noise_uniform, noise_normal: half-width and standard
    deviation of the measurement noise of each state. switch_limit: changes of mode within one
    second beyond which a run counts as chattering. delay [s]: by how much the law sees everything
    late. until_goal: whether a run ends at its first sample in the goal. seed: of every random
    number. threads: 0 for one per core. device: "cpu"; "gpu", a run for each thread of a graphics
    processor, by way of CuPy; "c++", the same kernel compiled by the C++ compiler of this machine.

    Raises `SimulationError` for a value out of range, for times that are no multiples of the sample
    time, and for noise or a delay with continuous control.
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
