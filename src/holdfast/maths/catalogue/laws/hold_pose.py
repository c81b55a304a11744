"""Dynamic positioning: velocities that bring a fully actuated craft to a pose."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import wrap

VELOCITIES = ("u", "v", "r")


@checked
def hold_pose(
    system: System,
    *,
    goal_x: float = 0.0,
    goal_y: float = 0.0,
    goal_psi: float = 0.0,
    current_x: float = 0.0,
    current_y: float = 0.0,
    k1: float = 0.2,
    k2: float = 0.4,
    approach_speed: float = 0.2,
    approach_turn: float = 0.2,
) -> Law:
    """Bring a craft with a sway force to a pose, and hold it there: dynamic positioning.

        w = -k1 d / sqrt(1 + |k1 d|^2 / approach_speed^2) - V,     d = (x, y) - goal
        (u, v) = R(psi)^T w,   r = -k2 e / sqrt(1 + (k2 e / approach_turn)^2),
        e = wrap(psi - goal_psi)

    The distance falls at min(k1 |d|, approach_speed) or a little less, the heading error likewise,
    wherever the craft starts. V = (current_x, current_y) [m/s] is the current that the law
    believes in. k1, k2 in 1/s, approach_speed in m/s, approach_turn in rad/s. Outputs: surge u,
    sway v [m/s], yaw rate r [rad/s], which `track_velocity` follows.

    Raises `DefinitionError` for a craft without three inputs: its sway force cannot be chosen.
    """
    if len(system.inputs) < len(VELOCITIES) or not set(VELOCITIES) <= set(system.state_names):
        raise DefinitionError(
            f"law 'hold_pose' needs surge, sway and yaw to be chosen, system '{system.name}' "
            f"has the inputs {', '.join(system.input_names)}",
            expected="a fully actuated craft, such as 'marine_craft' with a bow thruster",
            remedy="for an underactuated one, a law that `holdfast explain` names",
        )
    felt = system.current_along("x", "y") or ()
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    k1_, k2_, speed, turn = (symbol(n) for n in ("k1", "k2", "approach_speed", "approach_turn"))
    away = (x - symbol("goal_x"), y - symbol("goal_y"))
    slow = sp.sqrt(1 + k1_**2 * (away[0] ** 2 + away[1] ** 2) / speed**2)
    wx, wy = (
        -k1_ * d / slow - symbol(current)
        for d, current in zip(away, ("current_x", "current_y"), strict=True)
    )
    error = k2_ * wrap(psi - symbol("goal_psi"))
    sin, cos = sp.sin(psi), sp.cos(psi)
    return Law(
        name="hold_pose",
        reads=system.quantities(("x", "y", "psi"), "hold_pose"),
        outputs={
            "u": cos * wx + sin * wy,
            "v": cos * wy - sin * wx,
            "r": -error / sp.sqrt(1 + (error / turn) ** 2),
        },
        parameters=(
            Parameter("goal_x", "m", "x of the pose", value=goal_x),
            Parameter("goal_y", "m", "y of the pose", value=goal_y),
            Parameter("goal_psi", "rad", "heading of the pose", value=goal_psi),
            Parameter("current_x", "m/s", "current the law believes in", value=current_x),
            Parameter("current_y", "m/s", "current the law believes in", value=current_y),
            Parameter("k1", "1/s", "gain of the distance", value=k1, above=0),
            Parameter("k2", "1/s", "heading gain", value=k2, above=0),
            Parameter("approach_speed", "m/s", "largest speed", value=approach_speed, above=0),
            Parameter("approach_turn", "rad/s", "largest yaw rate", value=approach_turn, above=0),
        ),
        believed={q.name: symbol(f"current_{n}") for n, q in zip("xy", felt, strict=False)},
        description="bring a fully actuated craft to a pose and hold it: dynamic positioning",
        source="a bounded proportional law for positions; Fossen 2021, chapter 15, has others",
    )
