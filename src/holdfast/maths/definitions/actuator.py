"""Actuators of a craft on the plane: what each gives, and what they give together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import AllocatedImage, Bounds, Box, LinearImage, product
from holdfast.maths.definitions.quantity import Quantity, symbol
from holdfast.maths.expressions.random_points import full_rank

VELOCITIES = tuple(symbol(n) for n in ("u", "v", "r"))
INPUTS = (
    Quantity("tau_u", "N", "surge force"),
    Quantity("tau_v", "N", "sway force"),
    Quantity("tau_r", "N m", "yaw moment"),
)
DEPENDENT = 1e-9
"""Share of a row that counts as rounding when it is a combination of others."""
Effect = tuple[sp.Expr, sp.Expr, sp.Expr]
"""Surge force, sway force and yaw moment."""


@dataclass(frozen=True)
class Actuator:
    """One actuator: its inputs, what a unit of each gives the body, and the set of all it can do.

    effects: of each input, with x ahead and y to port of the origin of the body; of a rudder it
    depends on the velocities u, v, r through the water.
    """

    inputs: tuple[Quantity, ...]
    effects: tuple[Effect, ...]
    bounds: Bounds


@dataclass(frozen=True)
class ActuatorKind:
    """A kind of actuator, by the tables [NOUNs.NAME] of a vehicle file.

    numbers: name -> (unit, meaning, exclusive lower limit). `optional` names those that a table may
    lack; `fixed` those that are no parameters of the craft, such as a place. The others are
    parameters NAME_number; NAME_lag and NAME_slew act in `hf.lagged`. build: the actuator, by its
    name and its numbers other than the lag and the slew.
    """

    noun: str
    numbers: Mapping[str, tuple[str, str, float]]
    optional: tuple[str, ...]
    fixed: tuple[str, ...]
    build: Callable[..., Actuator]

    @property
    def table(self) -> str:
        """The key of a vehicle file."""
        return self.noun.replace(" ", "_") + "s"


@dataclass(frozen=True)
class Actuation:
    """The inputs of a craft, their set, and the force on each axis of the body.

    full: whether surge, sway and yaw can be chosen.
    """

    inputs: tuple[Quantity, ...]
    bounds: Bounds
    force: Effect
    full: bool


def actuation(actuators: Sequence[Actuator]) -> Actuation:
    """The forces of the actuators together.

    Where each has one input between two limits and its effect does not depend on the velocities,
    the inputs are the sums tau = B f (`_summed`). Else the inputs of the actuators are those of the
    craft, each actuator within its own set: a law, a kernel and a filter choose them. Raises
    `DefinitionError` where surge and yaw cannot be chosen independently.
    """
    matrix = sp.Matrix.hstack(*(sp.Matrix(e) for a in actuators for e in a.effects))
    if all(isinstance(a.bounds, Box) for a in actuators) and not matrix.has(*VELOCITIES):
        return _summed(actuators, matrix)
    if not full_rank(sp.ImmutableMatrix(matrix.extract([0, 2], list(range(matrix.cols))))):
        raise DefinitionError(
            "the actuators cannot give a surge force and a yaw moment independently",
            expected="one that pushes ahead, and one that turns",
        )
    inputs = tuple(q for a in actuators for q in a.inputs)
    surge, sway, yaw = matrix * sp.Matrix([q.symbol for q in inputs])
    sets: list[Bounds | None] = [a.bounds for a in actuators]
    bounds = reduce(product, sets)
    assert bounds is not None
    return Actuation(inputs, bounds, (surge, sway, yaw), full_rank(sp.ImmutableMatrix(matrix)))


def _summed(actuators: Sequence[Actuator], matrix: sp.Matrix) -> Actuation:
    """tau = B f, f in the box of the limits of thrusters.

    B has a column for each. With three independent rows surge, sway and yaw are inputs (fully
    actuated). With two, surge and yaw are, and the sway force that comes with them is their
    combination: 0 without a thruster across, else tau_v = a tau_u + b tau_r, such as that of a
    single tunnel. With more thrusters than inputs the inputs are those that the least-squares
    allocation produces exactly.
    """
    surge, sway, yaw = (list(matrix.row(i)) for i in range(3))
    rows: tuple[int, ...] = (0, 2)
    beside = sp.zeros(1, 2)
    if any(e != 0 for e in sway):
        beside, rest = _combination(sway, surge, yaw)
        if rest:
            rows = (0, 1, 2)
    elif not matrix.free_symbols:
        _combination(sway, surge, yaw)
    inputs = tuple(INPUTS[i] for i in rows)
    by_name = {q.name: q.symbol for q in inputs}
    along, turn = by_name["tau_u"], by_name["tau_r"]
    across = by_name.get("tau_v", beside[0] * along + beside[1] * turn)
    image = LinearImage if matrix.cols == len(rows) else AllocatedImage
    limits = [pair for a in actuators for pair in a.bounds.ranges()]
    bounds = image(
        sp.ImmutableMatrix(matrix.extract(list(rows), list(range(matrix.cols)))),
        Box(tuple(low for low, _ in limits), tuple(high for _, high in limits)),
        tuple(q.name for a in actuators for q in a.inputs),
    )
    return Actuation(inputs, bounds, (along, across, turn), len(rows) == len(INPUTS))


def _combination(
    sway: Sequence[sp.Expr], surge: Sequence[sp.Expr], yaw: Sequence[sp.Expr]
) -> tuple[sp.Matrix, bool]:
    """(a, b) with sway = a surge + b yaw by least squares, and whether something remains."""
    lever = max(abs(float(e)) for e in yaw) or 1.0
    pair = sp.Matrix([list(surge), [e / lever for e in yaw]])
    gram = pair * pair.T
    scale = float(gram[0, 0]) * float(gram[1, 1])
    if not float(gram.det()) > DEPENDENT * scale:
        raise DefinitionError(
            "the thrusters cannot give a surge force and a yaw moment independently",
            expected="two at least, at different distances from the centre line, or one across",
        )
    row = sp.Matrix([list(sway)])
    shares = (row * pair.T * gram.inv()).applyfunc(sp.nsimplify)
    rest = row - shares * pair
    size = max(abs(float(e)) for e in row)
    remains = any(abs(float(e)) > DEPENDENT * size for e in rest)
    return sp.Matrix([[shares[0], shares[1] / lever]]), remains
