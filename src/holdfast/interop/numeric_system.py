"""Numerical systems, for libraries that call a function of arrays at every instant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import controller_program
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME, Parameter, symbol
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System


@dataclass(frozen=True)
class Numeric:
    """The rates of a system at (states, actuators, disturbances, t), and its limits.

    Actuators are the coordinates of the box of input bounds: thrusters, or the inputs themselves.
    """

    system: System

    @property
    def actuators(self) -> tuple[str, ...]:
        """The names of the actuators."""
        return self.system.actuators or self.system.input_names

    @cached_property
    def _rates(self) -> Evaluator:
        s = self.system
        a = [symbol(n) for n in self.actuators]
        made = self.system.produced(a) if self.system.actuators else a
        fed = dict(zip([u.symbol for u in s.inputs], made, strict=True))
        rates = [sp.sympify(e).xreplace(fed) for e in s.rates.values()]
        moving = [*(q.symbol for q in s.states), *a, *(d.symbol for d in s.disturbances), TIME]
        return Evaluator(rates, moving, s.parameters)

    def rates(self, row: Array, parameters: Mapping[str, float] | None = None) -> Array:
        """The rates at one row of states, actuators, disturbances and t. row: shape (states +
        actuators + disturbances + 1,). The rates have the shape (states,)."""
        derivative: Array = self._rates.values(row[np.newaxis], parameters)[0]
        return derivative

    @cached_property
    def _inputs(self) -> Evaluator:
        a = [symbol(n) for n in self.actuators]
        made = self.system.produced(a) if self.system.actuators else a
        return Evaluator([sp.sympify(e) for e in made], a, self.system.parameters)

    def inputs(self, actuators: Array) -> Array:
        """The inputs that the actuators produce: shapes (actuators,) and (inputs,)."""
        produced: Array = self._inputs.values(actuators[np.newaxis])[0]
        return produced

    def limits(self) -> tuple[Array, Array]:
        """The least and the largest of every actuator; `DefinitionError` for other bounds. Both
        have the shape (actuators,)."""
        bounds = self.system.actuator_bounds
        if not isinstance(bounds, Box):
            raise DefinitionError(
                f"the inputs of system '{self.system.name}' have no least and largest values",
                expected="input bounds that are a box, or the image of one",
            )
        values = {p.symbol: sp.Float(p.value) for p in self.system.parameters}
        low, high = (
            np.array([float(e.xreplace(values)) for e in ends])
            for ends in (bounds.lower, bounds.upper)
        )
        return low, high


def closed_expressions(
    system: System, law: Law | Switching
) -> tuple[list[sp.Expr], list[sp.Expr], tuple[Parameter, ...]]:
    """Rates and inputs of the closed loop in states, disturbances and t, and the parameters.

    The inputs follow the state at every instant, within their bounds. `DefinitionError` for a law
    that is not a function of the state: one with modes, a memory, a safeguard or a kernel.
    """
    program = controller_program(system, law)
    program.check_function_of_state()
    asked = dict(zip(program.inputs, program.commands(*program.modes), strict=True))
    actuators = [sp.sympify(e).xreplace(asked) for e in program.actuation()]
    inputs = system.produced(actuators)
    fed = dict(zip(program.inputs, inputs, strict=True))
    rates = [sp.sympify(e).xreplace(fed) for e in system.rates.values()]
    return rates, inputs, program.parameters
