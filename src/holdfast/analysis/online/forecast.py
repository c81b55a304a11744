"""When a vehicle whose input is held would leave its constraints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.execution.simulation.settings import Settings
from holdfast.execution.simulation.steppers import RK4
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

HORIZON = 10.0
"""How far ahead it looks [s]."""

RECORDS = 500


class Forecast:
    """Motions of a system whose input is held from a state on, with disturbances held or 0."""

    def __init__(self, system: System, region: Region | None) -> None:
        self.system, self.region = system, region
        held = tuple(
            Parameter(f"held_{q.name}", q.unit, value=0.0)
            for q in (*system.inputs, *system.disturbances)
        )
        self.names = [p.name for p in held]
        count = len(system.inputs)
        law = Law(
            "held", system.states,
            {q.name: p.symbol for q, p in zip(system.inputs, held, strict=False)},
            parameters=held,
        )  # fmt: skip
        program = closed_loop_program(
            system, law, region=region, goal=None, stepper=RK4,
            disturbance={
                q.name: p.symbol for q, p in zip(system.disturbances, held[count:], strict=True)
            },
        )  # fmt: skip
        self._program = program
        self._loop = ClosedLoop(program)
        step = HORIZON / RECORDS
        self._settings = Settings(
            horizon=HORIZON, sample_time=step, record_every=step, threads=1, tolerance=1e-9
        )

    def motion(self, state: Array, held: Sequence[float]) -> tuple[Array, Array, float, int]:
        """Times, states, the time at which the region is left (NaN: not), and by which c_j."""
        values = dict(zip(self.names, map(float, held), strict=True))
        parameters = tuple(
            replace(p, value=values.get(p.name, p.value)) for p in self._program.parameters
        )
        self._loop.program = replace(self._program, parameters=parameters)
        found = self._loop.simulate(np.asarray(state, dtype=np.float64)[np.newaxis], self._settings)
        left = found.outcome[0] == Outcome.LEFT
        return (
            found.time, found.state[0], float(found.exit_time[0]) if left else math.nan,
            int(found.exit_constraint[0]),
        )  # fmt: skip
