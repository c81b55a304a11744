"""A law or a function behind a filter of a certificate, as the controller of many runs."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from holdfast.analysis.online.decision import Status
from holdfast.errors import ArgumentError, SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.simulation.closed_loop import Alive, Command
from holdfast.execution.simulation.control_sample import ControlSamples
from holdfast.execution.simulation.steppers import RK4
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.switching import Switching

if TYPE_CHECKING:
    from holdfast.analysis.online.certified_filter import CertifiedFilter


class Filtered:
    """What `simulate` asks for the commands of runs: those of a controller, filtered.

    counts: how many samples of all runs have had each `Status`.
    """

    most = sys.maxsize

    def __init__(self, keep: CertifiedFilter, controller: Law | Switching | Command) -> None:
        self.keep, self.counts = keep, Counter[Status]()
        self._law = controller if isinstance(controller, Law | Switching) else None
        self._wished: Callable[[float, Array], Array]
        if not isinstance(controller, Law | Switching):
            if not callable(controller):
                raise ArgumentError(
                    f"around: controller is {controller!r:.60}", expected="a law or a function"
                )
            self._wished = controller
        self._sample = 0

    def begin(self, runs: range) -> None:
        """Before the first sample of these runs."""
        self._sample = 0
        if self._law is None:
            return
        program = closed_loop_program(
            self.keep.system, self._law, region=None, goal=None, disturbance={}, stepper=RK4
        )
        if program.measured or program.handed:
            raise SimulationError(
                f"law '{self._law.name}' reads more than the states", expected="one of the states"
            )
        samples = ControlSamples(program, self.keep.sample_time, len(runs))
        self._wished = lambda t, q: samples.answers(t, q)[:, samples.rows.command]

    def command(self, t: float, states: Array, alive: Alive) -> Array:
        """The filtered command of every run, at the states that are measured."""
        due = self._sample * self.keep.sample_time
        if not abs(t - due) <= 1e-6 * self.keep.sample_time * (1 + self._sample):
            raise SimulationError(
                f"sample {self._sample} is at {t:g} s, and the filter has samples of "
                f"{self.keep.sample_time:g} s",
                expected=f"sample_time={self.keep.sample_time:g}",
            )
        self._sample += 1
        seen = states[:, : len(self.keep.system.states)]
        told = self.keep.step_many(seen, self._wished(t, seen.copy()))
        self.counts.update(np.array(told.status)[alive].tolist())
        return told.input

    def end(self) -> None:
        """After the last sample."""
