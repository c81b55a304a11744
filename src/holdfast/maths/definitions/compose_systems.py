"""Several vehicles as one system, and the motion of one relative to another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import reduce

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, check_name
from holdfast.maths.definitions.bounds import product
from holdfast.maths.definitions.quantity import Quantity, symbol
from holdfast.maths.definitions.system import PfaffianRow, System, vanishes

Pose = tuple[str, str, str]
"""The names of a planar position and of a heading."""


@checked
def renamed(system: System, names: Mapping[str, str], name: str = "") -> System:
    """The same system with other names for its quantities.

    names: the present name -> the new one. name: of the new system, by default that of the present
    one.

    Raises `DefinitionError` for a name that the system does not have.

    >>> hf.renamed(cart, {"x": "place"}).state_names
    ('place', 'v')
    """
    quantities = (*system.states, *system.inputs, *system.disturbances, *system.parameters)
    declared = [q.name for q in quantities]
    for old in names:
        check_name(old, declared, DefinitionError, f"system '{system.name}' has no '{old}'")
    new = {symbol(old): symbol(wanted) for old, wanted in names.items()}

    def called(quantity: Quantity) -> str:
        return names.get(quantity.name, quantity.name)

    return System(
        name=name or system.name,
        empirical=system.empirical,
        states=tuple(replace(q, name=called(q)) for q in system.states),
        inputs=tuple(replace(q, name=called(q)) for q in system.inputs),
        disturbances=tuple(replace(q, name=called(q)) for q in system.disturbances),
        parameters=tuple(replace(p, name=called(p)) for p in system.parameters),
        rates={names.get(n, n): r.xreplace(new) for n, r in system.rates.items()},
        input_bounds=system.input_bounds.at(new) if system.input_bounds else None,
        disturbance_bounds=system.disturbance_bounds.at(new) if system.disturbance_bounds else None,
        pfaffian=tuple(
            PfaffianRow(
                {names.get(n, n): c.xreplace(new) for n, c in row.coefficients.items()},
                row.rhs.xreplace(new),
            )
            for row in system.pfaffian
        ),
        description=system.description,
        source=system.source,
        samples=system.samples,
        measurements=tuple(
            replace(m, expression=m.expression.xreplace(new)) for m in system.measurements
        ),
    )


@checked
def side_by_side(*systems: System, name: str) -> System:
    """One system of several uncoupled ones; a parameter of the same name is the same number.

    systems: two or more.

    Raises `DefinitionError` where two have a quantity of the same name.

    >>> hf.side_by_side(robot, hf.renamed(cart, {"x": "s", "v": "u"}), name="both").state_names
    ('x', 'y', 'psi', 's', 'u')
    """
    return System(
        name=name,
        empirical="; ".join(dict.fromkeys(s.empirical for s in systems if s.empirical)),
        states=tuple(q for s in systems for q in s.states),
        inputs=tuple(q for s in systems for q in s.inputs),
        disturbances=tuple(q for s in systems for q in s.disturbances),
        parameters=tuple(p for s in systems for p in s.parameters),
        rates={n: r for s in systems for n, r in s.rates.items()},
        input_bounds=reduce(product, [s.input_bounds for s in systems if s.inputs]),
        disturbance_bounds=reduce(
            product, [s.disturbance_bounds for s in systems if s.disturbances], None
        )
        if any(s.disturbances for s in systems)
        else None,
        pfaffian=tuple(row for s in systems for row in s.pfaffian),
        description=" and ".join(dict.fromkeys(s.description for s in systems)),
        source="; ".join(dict.fromkeys(s.source for s in systems)),
        measurements=tuple(m for s in systems for m in s.measurements),
    )


@checked
def seen_from(
    leader: System, leader_pose: Pose, follower: System, follower_pose: Pose, *, pose: Pose
) -> System:
    """The follower's motion in the leader's frame; the leader's inputs are disturbances.

        (x, y) = R(-theta_L) (r_F - r_L),   beta = theta_F - theta_L

    Both are planar vehicles of three states.

    leader_pose, follower_pose: of each the names of its place and heading, (x, y, theta). pose: the
    names of x, y and beta. leader, follower: systems with no name in common.

    The rates are derived from theirs: differentiated, and written in x, y and beta, which must be
    possible whatever the leader's pose.

    Raises `DefinitionError` where it is not.

    >>> names = ("x", "y", "psi", "v", "r", "speed_limit", "turn_limit")
    >>> first = hf.renamed(robot, {name: name + "1" for name in names})
    >>> poses = (("x1", "y1", "psi1"), robot, ("x", "y", "psi"))
    >>> hf.seen_from(first, *poses, pose=("ahead", "left", "turn")).rates["turn"]
    r - r1
    """
    both = side_by_side(leader, follower, name=f"{follower.name} seen from {leader.name}")
    if set(both.state_names) != {*leader_pose, *follower_pose} or both.disturbances:
        raise DefinitionError(
            f"'{leader.name}' and '{follower.name}' have other states than their poses, or "
            "disturbances",
            expected="vehicles whose inputs are velocities",
        )
    x_l, y_l, theta_l = (symbol(n) for n in leader_pose)
    x_f, y_f, theta_f = (symbol(n) for n in follower_pose)
    ahead, aside = x_f - x_l, y_f - y_l
    relative = dict(
        zip(
            pose,
            (
                sp.cos(theta_l) * ahead + sp.sin(theta_l) * aside,
                -sp.sin(theta_l) * ahead + sp.cos(theta_l) * aside,
                theta_f - theta_l,
            ),
            strict=True,
        )
    )
    # the leader at the origin of its own frame
    there = dict.fromkeys((x_l, y_l, theta_l), sp.S.Zero)
    there |= {symbol(f): symbol(n) for f, n in zip(follower_pose, pose, strict=True)}
    back = {symbol(n): e for n, e in relative.items()}

    def in_the_frame(expression: sp.Expr) -> sp.Expr:
        return sp.expand(expression.subs(there, simultaneous=True))

    rates = {}
    values = {p.symbol: sp.Float(p.value) for p in both.parameters}
    for name, expression in relative.items():
        rate = both.derivative(expression)
        rates[name] = in_the_frame(rate)
        if not vanishes(rate - rates[name].subs(back, simultaneous=True), values):
            raise DefinitionError(
                f"the rate of '{name}' depends on where the leader is",
                expected="vehicles that move alike wherever they are",
            )
    names = dict(zip(follower_pose, pose, strict=True))
    rows = []
    for row in follower.pfaffian:
        coefficients = {names[n]: in_the_frame(c) for n, c in row.coefficients.items()}
        moved = sp.Add(*(c * rates[n] for n, c in coefficients.items()))
        rows.append(PfaffianRow(coefficients, sp.trigsimp(sp.expand(moved))))
    unit = follower.states[0].unit
    return System(
        name=both.name,
        empirical=both.empirical,
        states=(
            Quantity(pose[0], unit, "position of the follower, ahead of the leader"),
            Quantity(pose[1], unit, "position of the follower, to the left of the leader"),
            Quantity(pose[2], "rad", "heading of the follower less the leader's", angle=True),
        ),
        inputs=follower.inputs,
        disturbances=leader.inputs,
        rates=rates,
        parameters=both.parameters,
        input_bounds=follower.input_bounds,
        disturbance_bounds=leader.input_bounds,
        pfaffian=tuple(rows),
    )
