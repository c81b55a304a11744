"""The leader's law along a route (thesis (6.23)), with arcs around its corners."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.expressions.functions import length, magnitude, wrap
from holdfast.maths.formations.cell_field import direction_of
from holdfast.maths.reference_fields.dipole import UNSEEN
from holdfast.planning.corners import Corner
from holdfast.planning.fields import Fields, X, Y

THETA = symbol("thetaL")
POSE = (Quantity("xL", "m"), Quantity("yL", "m"), Quantity("thetaL", "rad", angle=True))

STOPPED = "stop"

ALIGNED = sp.Float(0.01)
"""Headings [rad] closer than this count as equal."""


def lead_along(
    fields: Fields,
    corners: Sequence[Corner],
    *,
    speed: float,
    gain: float = 2.0,
    goal_radius: float = 0.05,
) -> Switching:
    """uL = speed, wL = -kL wrap(thetaL - phi) + d/dt phi along the field of each cell, (6.23).

    From the exit of a cell the leader moves on an arc of the corner's radius, wL = +-speed / RL,
    until its heading is that of the next cell's field; at the goal it stops. A corner with a
    heading starts with a turn on the spot. speed [m/s], kL = `gain` [1/s], lengths in m.
    """
    own = (
        Parameter("cruise", "m/s", "speed of the leader", value=speed, above=0.0),
        Parameter("kL", "1/s", "heading gain of the leader", value=gain, above=0.0),
        Parameter("goal_radius", "m", "stopping distance", value=goal_radius, above=0.0),
        *fields.parameters,
    )
    turns = tuple(
        Parameter(f"turn{n}", "1/m", "curvature of the arc, left positive", value=c.side / c.radius)
        for n, c in enumerate(corners, start=1)
        if c.side
    )
    turns += tuple(
        Parameter(f"turn{n}_heading", "rad", "heading at the beginning of the arc", value=c.heading)
        for n, c in enumerate(corners, start=1)
        if c.heading is not None
    )

    def law(name: str, speed: sp.Expr, turn: sp.Expr) -> Law:
        return Law(name, POSE, {"uL": speed, "wL": turn}, parameters=(*own, *turns))

    cruise = symbol("cruise")
    modes: dict[str, Law] = {}
    transitions = []
    for number, (leg, field) in enumerate(zip(fields.route.legs, fields.fields, strict=True), 1):
        here = f"cell_{number}"
        phi = direction_of(field)
        along = phi.diff(X) * sp.cos(THETA) + phi.diff(Y) * sp.sin(THETA)
        heading = -symbol("kL") * wrap(THETA - phi) + cruise * along
        modes[here] = law(here, cruise, heading)
        if leg.exit is None:
            gone = length(X - symbol("goal_x"), Y - symbol("goal_y"), UNSEEN)
            transitions.append(Transition(here, STOPPED, symbol("goal_radius") - gone))
            break
        x, y, direction = (symbol(f"exit{number}_{n}") for n in ("x", "y", "direction"))
        crossed = (X - x) * sp.cos(direction) + (Y - y) * sp.sin(direction)
        onwards = f"cell_{number + 1}"
        if not corners[number - 1].side:
            transitions.append(Transition(here, onwards, crossed))
            continue
        arc, curve = f"turn_{number}", symbol(f"turn{number}")
        if corners[number - 1].heading is not None:
            spot, off = f"align_{number}", wrap(THETA - symbol(f"turn{number}_heading"))
            modes[spot] = law(spot, sp.S.Zero, -symbol("kL") * off)
            transitions.append(Transition(here, spot, crossed))
            transitions.append(Transition(spot, arc, ALIGNED - magnitude(off)))
        else:
            transitions.append(Transition(here, arc, crossed))
        modes[arc] = law(arc, cruise, cruise * curve)
        past = wrap(THETA - direction_of(fields.fields[number])) * curve
        transitions.append(Transition(arc, onwards, past))
    modes[STOPPED] = law(STOPPED, sp.S.Zero, sp.S.Zero)
    return Switching(
        name="lead_along",
        modes=modes,
        transitions=tuple(transitions),
        description="along the fields of the cells of a route, in arcs around its corners",
        source="thesis (6.23), with the zero of the field beyond the exit and arcs without a jump",
    )
