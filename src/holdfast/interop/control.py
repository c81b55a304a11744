"""Systems and closed loops for python-control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import control  # type: ignore[import-untyped]
import numpy as np
import sympy as sp

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.control_sample import Controller, OneRun
from holdfast.execution.simulation.settings import RK4, Settings
from holdfast.interop.numeric_system import Numeric, closed_expressions
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System


def plant(system: System) -> Any:
    """The open-loop system as a `NonlinearIOSystem`: actuators, then disturbances, to states.

    Parameters are those of the system, by name (`params` of `input_output_response`). Nothing
    saturates the actuators: python-control has its own saturation.
    """
    numeric = Numeric(system)

    def rates(t: float, x: Array, u: Array, params: Mapping[str, float]) -> Array:
        return numeric.rates(np.concatenate([x, np.atleast_1d(u), [t]]), params)

    return control.NonlinearIOSystem(
        rates,
        None,
        name=system.name,
        states=list(system.state_names),
        inputs=[*numeric.actuators, *system.disturbance_names],
        outputs=list(system.state_names),
        params={p.name: p.value for p in system.parameters},
    )


def closed_loop(system: System, law: Law | Switching) -> Any:
    """The closed loop as a `NonlinearIOSystem`: disturbances to states and inputs.

    The inputs follow the state at every instant, within their bounds, as `simulate` does with
    `continuous=True`. Raises `DefinitionError` for a law with modes, a memory, a safeguard or a
    kernel, because these depend on more than the state: see `sampled_loop`.
    """
    rates, inputs, parameters = closed_expressions(system, law)
    arguments = [
        *(q.symbol for q in system.states),
        *(d.symbol for d in system.disturbances),
        TIME,
    ]
    moving = Evaluator(rates, arguments, parameters)
    shown = Evaluator([*(q.symbol for q in system.states), *inputs], arguments, parameters)

    def at(
        evaluator: Evaluator, t: float, x: Array, d: Array, numbers: Mapping[str, float]
    ) -> Array:
        row = np.concatenate([x, np.atleast_1d(d)[: len(system.disturbances)], [t]])
        computed: Array = evaluator.values(row[np.newaxis], numbers)[0]
        return computed

    return control.NonlinearIOSystem(
        lambda t, x, d, params: at(moving, t, x, d, params),
        lambda t, x, d, params: at(shown, t, x, d, params),
        name=f"{system.name}_closed",
        states=list(system.state_names),
        inputs=list(system.disturbance_names),
        outputs=[*system.state_names, *system.input_names],
        params={p.name: p.value for p in parameters},
    )


def sampled_loop(
    system: System, law: Law | Switching, *, sample_time: float = 0.02, substeps: int = 2
) -> Any:
    """The sampled closed loop as a `NonlinearIOSystem` in discrete time, dt = sample_time [s].

    Supports every law, also one with modes, a memory, a safeguard (safety filter) or a kernel. Its
    states are those of the system, the memory of the law, the number of the mode (initially
    `initial_mode` of the result) and the seconds in it; all but the states of the system and the
    mode start at 0. Inputs are the disturbances, held for a sample. Outputs are the states of the
    system, its inputs, with a safeguard the unfiltered request `nominal_INPUT` and the `slack`, and
    last the mode.

    sample_time [s]: dt. substeps: classical Runge-Kutta steps in a sample, as in `simulate`.

    Raises `SimulationError` for invalid times.
    """
    settings = Settings(
        horizon=sample_time, sample_time=sample_time, record_every=sample_time, substeps=substeps
    )
    program = closed_loop_program(
        system, law, region=None, goal=None, stepper=RK4,
        disturbance={name: sp.Float(0.0) for name in system.disturbance_names},
    )  # fmt: skip
    loop = ClosedLoop(program)
    run = OneRun(loop, settings)
    n, remembered = len(program.states), len(program.remembered)
    outputs = list(system.input_names)
    if program.safeguarded:
        outputs += [*(f"nominal_{name}" for name in system.input_names), "slack"]

    def sample(t: float, x: Array, d: Array, numbers: Mapping[str, float]) -> tuple[Array, Array]:
        values = loop.parameter_array(numbers, sample_time)
        values[len(values) - 1 - len(program.given) : -1] = np.atleast_1d(d)[: len(program.given)]
        memory = x[n : n + remembered] if t > 0 else None
        controller = Controller(memory, int(x[-2]), float(x[-1]))
        stepped = run.sample(float(t), x[:n], controller, values)
        _, mode, in_mode = stepped.controller
        memory_after = stepped.controller.memory if remembered else np.empty(0)
        after = np.concatenate([stepped.state, memory_after, [mode, in_mode]])
        filtered = [*stepped.nominal, stepped.slack] if program.safeguarded else []
        return after, np.concatenate([x[:n], stepped.input, filtered, [mode]])

    made = control.NonlinearIOSystem(
        lambda t, x, d, params: sample(t, x, d, params)[0],
        lambda t, x, d, params: sample(t, x, d, params)[1],
        name=f"{system.name}_sampled",
        states=[*system.state_names, *program.remembered, "mode", "time_in_mode"],
        inputs=list(system.disturbance_names),
        outputs=[*system.state_names, *outputs, "mode"],
        params={p.name: p.value for p in program.parameters},
        dt=sample_time,
    )
    made.initial_mode = program.initial_mode
    return made
