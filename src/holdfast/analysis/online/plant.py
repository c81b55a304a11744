"""The vehicle in a loop of one's own: the steps of `simulate`, one sample at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import sympy as sp

from holdfast.analysis.online.measurements import Given, numbers
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.simulation.control_sample import PlantSamples
from holdfast.execution.simulation.steppers import RK4
from holdfast.maths.control.command import commanded
from holdfast.maths.definitions.system import System


class Plant:
    """A system that moves by one control sample at a time, with its inputs held and limited.

    start: the states. sample_time [s]: `substeps` classical Runge-Kutta steps each, as in
    `simulate`. state, t [s]: where it is, and when.

    Raises `SimulationError` for invalid arguments.
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
        """Begin at other states, at the time 0."""
        self._state, self.t = numbers(start, self.system.state_names, "start"), 0.0
        self._count = 0

    def step(self, input: Given, disturbance: Given | None = None) -> Array:
        """The states after one sample, with the input and the disturbance held.

        Inputs beyond their bounds are limited as the actuators limit them. Raises
        `SimulationError` for wrong names or shapes, for numbers that are not finite, and where the
        plant diverges; it stays where it was.
        """
        given = numbers(input, self.system.input_names, "input")
        felt = np.zeros(len(self.system.disturbances))
        if disturbance is not None:
            felt = numbers(disturbance, self.system.disturbance_names, "disturbance")
        for what, row in (("input", given), ("disturbance", felt), ("state", self._state)):
            if not np.isfinite(row).all():
                raise SimulationError(f"the {what} is {row.tolist()}", expected="finite numbers")
        after = self._samples.after(self.t, self._state, given, felt)
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
        """The states now."""
        return self._state.copy()
