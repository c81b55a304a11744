"""Systems and closed loops for python-control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import control  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from holdfast.execution.evaluate import Evaluator
from holdfast.interop.numeric import Numeric, closed_expressions
from holdfast.maths.law import Law
from holdfast.maths.quantity import TIME
from holdfast.maths.switching import Switching
from holdfast.maths.system import System

Array = npt.NDArray[np.float64]


def plant(system: System) -> Any:
    """The system alone as a `NonlinearIOSystem`: actuators, then disturbances, to states.

    Parameters are those of the system, by name (`params` of `input_output_response`). Nothing
    limits the actuators: python-control has its own saturation.
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
    kernel: those are functions of more than the state.
    """
    rates, inputs, parameters = closed_expressions(system, law)
    arguments = [
        *(q.symbol for q in system.states),
        *(d.symbol for d in system.disturbances),
        TIME,
    ]
    moving = Evaluator(rates, arguments, parameters)
    shown = Evaluator([*(q.symbol for q in system.states), *inputs], arguments, parameters)

    def at(evaluator: Evaluator, t: float, x: Array, d: Array, given: Mapping[str, float]) -> Array:
        row = np.concatenate([x, np.atleast_1d(d)[: len(system.disturbances)], [t]])
        found: Array = evaluator.values(row[np.newaxis], given)[0]
        return found

    return control.NonlinearIOSystem(
        lambda t, x, d, params: at(moving, t, x, d, params),
        lambda t, x, d, params: at(shown, t, x, d, params),
        name=f"{system.name}_closed",
        states=list(system.state_names),
        inputs=list(system.disturbance_names),
        outputs=[*system.state_names, *system.input_names],
        params={p.name: p.value for p in parameters},
    )
