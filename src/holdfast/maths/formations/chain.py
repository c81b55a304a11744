"""The law and the region of a chain of robots: each sees only the robot before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.chain import chain, in_view, place, robot_names
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.region import Footprint, Inequality, Region, Segment
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System, by_measurements
from holdfast.maths.expressions.functions import angle, length, magnitude
from holdfast.maths.formations.footprint import triangle
from holdfast.maths.formations.walls import sight_distance, wall_distance
from holdfast.maths.reference_fields.dipole import GUARD, UNSEEN

Walls = Sequence[tuple[tuple[float, float], tuple[float, float]]]


def joint_law(system: System, leader: Switching, followers: Sequence[Law]) -> Switching:
    """The leader's law (all its modes) and every follower's law as one law of the chain.

    A follower's law reads `range` and `bearing` and gives uF and wF; the k-th law gets those of
    the k-th follower. Its parameter `leader_speed` is its assumed speed of the robot before it.
    """
    placed = []
    for k, law in enumerate(followers, start=1):
        names = {n: f"{n}{k}" for n in ("range", "bearing", "leader_speed")}
        mine = by_measurements(system, _renamed_law(law, names, str(k)))
        assert isinstance(mine, Law)
        placed.append(mine)

    def with_followers(mode: Law) -> Law:
        return replace(
            mode,
            reads=system.states,
            outputs={**mode.outputs, **{n: e for law in placed for n, e in law.outputs.items()}},
            parameters=(*mode.parameters, *(p for law in placed for p in law.parameters)),
        )

    return leader.map_laws(with_followers, f"{leader.name}, {followers[0].name}")


def chain_in_view(
    followers: int,
    walls: Walls,
    *,
    range_max: float,
    half_angle: float,
    robot_radius: float,
) -> Region:
    """Every robot sees the one before it, past all walls; none touches another or a wall.

    For follower k: bearing{k}, range{k} as in `leader_in_view`, sight{k}, minus the distance of
    the line of sight to the walls (positive where a wall is in between); for every robot clear_*,
    its radius less its distance to the walls; for every two apart_*, twice the radius less theirs.
    """
    names = robot_names(followers)
    reach, alpha, radius = (symbol(n) for n in ("range_max", "half_angle", "robot_radius"))
    ends, corners = _walls(walls)
    seen: list[Inequality] = []
    for k, (before, of) in enumerate(pairwise(names), start=1):
        ahead, left = in_view(of, before)
        line = sight_distance(place(before), place(of), ends)
        seen += [
            Inequality(f"bearing{k}", magnitude(angle(left, ahead, GUARD**2)) - alpha, "rad"),
            Inequality(f"range{k}", ahead - reach * sp.cos(alpha), "m"),
            Inequality(f"sight{k}", -line, "m"),
        ]
    clear = [
        Inequality(f"clear_{of}", radius - wall_distance(place(of), ends), "m") for of in names
    ]
    apart = [
        Inequality(f"apart_{one}_{other}", 2 * radius - _between(one, other), "m")
        for i, one in enumerate(names)
        for other in names[i + 1 :]
    ]
    states = chain(followers).states
    return Region(
        name="chain_in_view",
        reads=states,
        inequalities=(*seen, *clear, *apart),
        parameters=(
            Parameter("range_max", "m", "range Ls of the cameras", value=range_max, above=0.0),
            Parameter("half_angle", "rad", "half angle of view", value=half_angle, above=0.0),
            Parameter("robot_radius", "m", "radius r0 of a robot", value=robot_radius, above=0.0),
            *corners,
        ),
        scene=(
            *(
                Segment("wall", (ends[i], ends[i + 1]), (ends[i + 2], ends[i + 3]))
                for i in range(0, len(ends), 4)
            ),
            *(
                Footprint("view", place(of), symbol(f"theta{of}"), triangle(reach, alpha))
                for of in names[1:]
            ),
        ),
        description="every robot sees the one before it, none touches another or a wall",
        source="thesis (6.8), section 6.5",
    )


def _walls(walls: Walls) -> tuple[list[sp.Symbol], tuple[Parameter, ...]]:
    corners = [
        Parameter(f"wall{i}_{name}", "m", "end of a wall", value=value)
        for i, ((ax, ay), (bx, by)) in enumerate(walls, start=1)
        for name, value in (("x0", ax), ("y0", ay), ("x1", bx), ("y1", by))
    ]
    return [p.symbol for p in corners], tuple(corners)


def _between(one: str, other: str) -> sp.Expr:
    (ax, ay), (bx, by) = place(one), place(other)
    return length(bx - ax, by - ay, UNSEEN)


def _renamed_law(law: Law, names: Mapping[str, str], of: str) -> Law:
    """The law with its reads and parameters renamed; outputs u{of}, w{of}."""
    new = {symbol(old): symbol(wanted) for old, wanted in names.items()}
    outputs = {"uF": f"u{of}", "wF": f"w{of}"}
    if law.safeguard is not None or set(law.outputs) != set(outputs):
        raise DefinitionError(
            f"law '{law.name}' is not for a chain",
            expected="one of 'approach_leader', 'follow_leader', or one with outputs uF and wF "
            "and without a safeguard",
        )
    return replace(
        law,
        reads=tuple(replace(q, name=names.get(q.name, q.name)) for q in law.reads),
        outputs={outputs[n]: e.xreplace(new) for n, e in law.outputs.items()},
        parameters=tuple(replace(p, name=names.get(p.name, p.name)) for p in law.parameters),
    )
