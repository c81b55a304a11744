"""Several vehicles as one system, and the motion of one relative to another."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, check_name, suggestion
from holdfast.maths.definitions.bounds import Ball, Bounds, Product, product, section
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


class _Frame:
    """The axes of one vehicle, in which another one is seen.

    both: the system of both. pose, other: of each the names of its place and of its heading, "" for
    a vehicle without one, whose axes do not turn. names: of the relative place, and of the relative
    heading where the other vehicle has one.
    """

    def __init__(self, both: System, pose: Pose, other: Pose, names: Sequence[str]) -> None:
        self.both = both
        x, y, *angle = (symbol(n) for n in pose if n)
        x_o, y_o, *angle_o = (symbol(n) for n in other if n)
        turned = angle[0] if angle else sp.S.Zero
        ahead, aside = x_o - x, y_o - y
        seen = [
            sp.cos(turned) * ahead + sp.sin(turned) * aside,
            -sp.sin(turned) * ahead + sp.cos(turned) * aside,
            *(a - turned for a in angle_o),
        ]
        self.relative: dict[str, sp.Expr] = dict(zip(names, seen, strict=True))
        # the vehicle at the origin of its own axes
        self._there = dict.fromkeys((x, y, *angle), sp.S.Zero)
        self._there |= dict(zip((x_o, y_o, *angle_o), map(symbol, names), strict=True))
        self._back = {symbol(n): e for n, e in self.relative.items()}

    def seen(self, expression: sp.Expr) -> sp.Expr:
        """An expression that does not depend on the pose of the vehicle, in its axes."""
        return sp.expand(expression.subs(self._there, simultaneous=True))

    def not_alike(self, rates: Mapping[str, sp.Expr]) -> list[str]:
        """Those of `rates`, which are `seen`, that depend on the pose of the vehicle after all."""
        values = {p.symbol: sp.Float(p.value) for p in self.both.parameters}
        return [
            name
            for name, rate in rates.items()
            if not vanishes(
                self.both.derivative(self.relative.get(name, symbol(name)))
                - rate.subs(self._back, simultaneous=True),
                values,
            )
        ]


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
    frame = _Frame(both, leader_pose, follower_pose, pose)
    in_the_frame = frame.seen
    rates = {name: in_the_frame(both.derivative(e)) for name, e in frame.relative.items()}
    if moved := frame.not_alike(rates):
        raise DefinitionError(
            f"the rate of '{moved[0]}' depends on where the leader is",
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


OTHER = "other_"
"""Before the names of the other vehicle's quantities in a relative system."""


@checked
def relative_system(
    ours: System,
    theirs: System,
    *,
    position: tuple[str, str] = ("x", "y"),
    heading: str | None = None,
    common: tuple[str, ...] = (),
) -> System:
    """The motion of another vehicle in the axes of ours: a game of pursuit and evasion.

        (x_r, y_r) = R(-psi) ((x, y) of theirs - (x, y)),   psi_r = psi of theirs - psi

    The rates are derived from both. Inputs are ours; what the other vehicle does, and the
    disturbances of both, are disturbances. The further states of both follow, theirs with `other_`
    before their names, as all of theirs. The kernel of a distance that is kept in this system is
    that of both vehicles (R. Isaacs, Differential games, 1965).

    ours, theirs: planar vehicles that move alike wherever they are and head. position: the states
    that are the place. heading: the state that is the heading, by default psi or the first angle; a
    vehicle without it has axes that do not turn. common: disturbances that are the same for both,
    such as the current of the water around both; what cancels is no disturbance of this system. A
    disturbance of a fixed direction, such as a current of one of them alone, has to be bounded by a
    ball, which is the same set in axes that turn.

    Raises `DefinitionError` for a rate that depends on where a vehicle is or on where it heads, for
    a name that a vehicle does not have, and for another vehicle whose inputs have no bounds.

    >>> print(hf.relative_system(robot, robot).rates["x_r"])
    other_v*cos(psi_r) + r*y_r - v
    """
    headings = [_heading(system, heading) for system in (ours, theirs)]
    if heading is not None and not any(headings):
        raise DefinitionError(
            f"neither vehicle has a heading '{heading}'",
            remedy=suggestion(heading, (*ours.state_names, *theirs.state_names)),
        )
    for system in (ours, theirs):
        for name in position:
            check_name(
                name, system.state_names, DefinitionError,
                f"system '{system.name}' has no place '{name}'",
            )  # fmt: skip
        for name in common:
            check_name(
                name, system.disturbance_names, DefinitionError,
                f"system '{system.name}' has no disturbance '{name}', which is said to be common",
            )  # fmt: skip
    if theirs.input_bounds is None:
        raise DefinitionError(
            f"the inputs of '{theirs.name}' have no bounds",
            expected="bounds of what the other vehicle may do",
        )
    every = (*theirs.states, *theirs.inputs, *theirs.disturbances, *theirs.parameters)
    names = {q.name: OTHER + q.name for q in every if q.name not in common}
    other = renamed(theirs, names)
    unshared = [q.name not in common for q in theirs.disturbances]
    acting = [
        (ours.disturbances, ours.disturbance_bounds),
        (other.inputs, other.input_bounds),
        (tuple(q for q in other.disturbances if q.name not in common),
         section(other.disturbance_bounds, unshared)),
    ]  # fmt: skip
    poses: tuple[Pose, Pose] = (
        (*position, headings[0]),
        (OTHER + position[0], OTHER + position[1], headings[1] and OTHER + headings[1]),
    )
    relative = [f"{name}_r" for name in (*position, *headings[1:]) if name]
    both = System(
        name=f"{theirs.name} seen from {ours.name}",
        empirical="; ".join(dict.fromkeys(e for e in (ours.empirical, theirs.empirical) if e)),
        states=(*ours.states, *other.states),
        inputs=ours.inputs,
        disturbances=tuple(q for members, _ in acting for q in members),
        parameters=(*ours.parameters, *other.parameters),
        rates={**ours.rates, **other.rates},
    )
    further = [q for q in both.states if q.name not in (*poses[0], *poses[1])]
    rates = _alike(both, poses, relative, [q.name for q in further], acting)
    used = set().union(*(e.free_symbols for e in rates.values()))
    members = tuple(q for some, _ in acting for q in some)
    bounds = reduce(product, [b for some, b in acting if some])
    needed = _needed(members, bounds, used)
    place = next(q for q in ours.states if q.name == position[0])
    return replace(
        both,
        states=(
            Quantity(relative[0], place.unit, "place of the other vehicle, ahead of this one"),
            Quantity(relative[1], place.unit, "place of the other vehicle, to the left"),
            *(Quantity(n, "rad", "heading of the other vehicle, less ours", angle=True)
              for n in relative[2:]),
            *further,
        ),
        disturbances=tuple(q for q in members if q in needed),
        rates=rates,
        input_bounds=ours.input_bounds,
        disturbance_bounds=section(bounds, [q in needed for q in members]),
        samples=max(ours.samples, theirs.samples),
        description="two vehicles, the other one in the axes of ours",
        source="R. Isaacs, Differential games, 1965",
    )  # fmt: skip


def _heading(system: System, name: str | None) -> str:
    """The state that is the heading; empty where there is none."""
    angles = [q.name for q in system.states if q.angle]
    if name is not None:
        return name if name in system.state_names else ""
    return "psi" if "psi" in angles else angles[0] if angles else ""


def _needed(
    members: Sequence[Quantity], bounds: Bounds | None, used: set[sp.Symbol]
) -> list[Quantity]:
    """The disturbances that act, with those that are bounded together with one that does."""
    groups = [members] if bounds is None else bounds.groups(members)
    return [q for group in groups if any(q.symbol in used for q in group) for q in group]


def _alike(
    both: System,
    poses: Sequence[Pose],
    names: Sequence[str],
    further: Sequence[str],
    acting: Sequence[tuple[tuple[Quantity, ...], Bounds | None]],
) -> dict[str, sp.Expr]:
    """The rates in the axes of the first vehicle, whatever its pose.

    What acts along fixed directions within a ball acts within the same ball along the axes of the
    vehicle, so that its two members are turned into these axes where that is needed.
    """
    angle = symbol(poses[0][2]) if poses[0][2] else sp.S.Zero
    balls = [pair for members, bounds in acting for pair in _in_balls(members, bounds)]

    def rates_with(values: Mapping[sp.Symbol, sp.Expr]) -> tuple[dict[str, sp.Expr], list[str]]:
        """The rates with other disturbances, and those that depend on the pose after all."""
        seen = replace(both, rates={n: e.xreplace(values) for n, e in both.rates.items()})
        frame = _Frame(seen, poses[0], poses[1], names)
        wanted = {**frame.relative, **{n: symbol(n) for n in further}}
        rates = {n: frame.seen(seen.derivative(e)) for n, e in wanted.items()}
        return rates, frame.not_alike(rates)

    for count in range(len(balls) + 1):
        for some in itertools.combinations(balls, count):
            turned: dict[sp.Symbol, sp.Expr] = {}
            for a, b in some:
                turned[a] = sp.cos(angle) * a - sp.sin(angle) * b
                turned[b] = sp.sin(angle) * a + sp.cos(angle) * b
            rates, odd = rates_with(turned)
            if not odd:
                return rates
    for name, rate in both.rates.items():
        for place in (n for pose in poses for n in pose[:2]):
            if symbol(place) in rate.free_symbols:
                raise DefinitionError(
                    f"the rate of '{name}' depends on the place '{place}'",
                    expected="vehicles that move alike wherever they are",
                )
    felt = [q for members, _ in (acting[0], acting[2]) for q in members]
    _, still = rates_with({q.symbol: sp.S.Zero for q in felt})
    if felt and not still:
        raise DefinitionError(
            f"the disturbances {', '.join(q.name for q in felt)} act along fixed directions, while "
            "the axes of the vehicle turn",
            expected="two that are bounded by a ball, or common to both vehicles",
        )
    raise DefinitionError(
        f"the rates of '{both.name}' depend on where the vehicles head",
        expected="vehicles that move alike wherever they head",
    )


def _in_balls(
    members: Sequence[Quantity], bounds: Bounds | None
) -> list[tuple[sp.Symbol, sp.Symbol]]:
    """The pairs of members that are bounded by a disc."""
    if isinstance(bounds, Product):
        parts = bounds.split(members)
    else:
        parts = [(bounds, members)] if bounds is not None else []
    return [
        (some[0].symbol, some[1].symbol)
        for part, some in parts
        if isinstance(part, Ball) and part.dimension == 2
    ]
