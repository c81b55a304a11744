"""The order of cells from a start to a goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import networkx as nx

from holdfast.errors import DefinitionError
from holdfast.planning.environment import Cell, Environment, Passage, Point, shown

ALMOST = 0.8


@dataclass(frozen=True)
class Leg:
    """A cell for the robots' centres, and its exit passage; None in the cell of the goal."""

    cell: Cell
    exit: Passage | None


@dataclass(frozen=True)
class Route:
    """The legs in order; `goal` lies in the last."""

    environment: Environment
    legs: tuple[Leg, ...]
    goal: Point

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(leg.cell.name for leg in self.legs)


def plan_route(environment: Environment, start: Sequence[float], goal: Sequence[float]) -> Route:
    """The shortest way over the cells, by the middles of the passages.

    start, goal: (x, y) [m] of the centre of a robot. Raises `DefinitionError` if one of them is
    outside the robots' free space, or if no way leads from one to the other.
    """
    places = [_place(environment, p, what) for p, what in ((start, "start"), (goal, "goal"))]
    graph = nx.DiGraph()
    # edges connect passages of one cell, weighted by length; a passage joins two cells
    for (i, j), passage in environment.passages.items():
        for (a, b), onwards in environment.passages.items():
            if a == j and b != i:
                far = math.dist(passage.middle, onwards.middle)
                graph.add_edge((i, j), (a, b), length=far)
        if i in places[0]:
            graph.add_edge("start", (i, j), length=math.dist(start, passage.middle))
        if j in places[1]:
            graph.add_edge((i, j), "goal", length=math.dist(goal, passage.middle))
    if places[0] & places[1]:
        graph.add_edge("start", "goal", length=math.dist(start, goal))
    try:
        nodes = nx.shortest_path(graph, "start", "goal", weight="length")[1:-1]
    except (nx.NetworkXNoPath, nx.NodeNotFound):
        names = [environment.cells[min(p)].name for p in places]
        why = f" ({'; '.join(environment.closed)})" if environment.closed else ""
        raise DefinitionError(
            f"no way leads from cell '{names[0]}' to cell '{names[1]}'{why}"
        ) from None
    last = nodes[-1][1] if nodes else min(places[0] & places[1])
    legs = [_leg(environment.inner[i], environment.passages[i, j]) for i, j in nodes]
    legs.append(Leg(environment.inner[last], None))
    return Route(environment, tuple(legs), (float(goal[0]), float(goal[1])))


def _leg(cell: Cell, exit: Passage) -> Leg:
    """The cell, cut back to the passage if that is nearly all of its face.

    The field then has to change its sense on a face only if the wall beside a door is long.
    """
    a, b = cell.side(exit.face)
    if exit.width < ALMOST * math.dist(a, b):
        return Leg(cell, exit)
    ends = sorted((exit.a, exit.b), key=lambda end: math.dist(end, a))
    corners = list(cell.corners)
    corners[exit.face], corners[(exit.face + 1) % len(corners)] = ends
    return Leg(Cell(cell.name, tuple(corners)), exit)


def _place(environment: Environment, point: Sequence[float], what: str) -> set[int]:
    found = environment.cells_at(point)
    if found:
        return found
    if any(cell.contains(point) for cell in environment.cells):
        raise DefinitionError(
            f"at the {what} {shown(point)} a robot would touch a wall",
            expected=f"at least {environment.robot_radius:g} m from all walls",
        )
    raise DefinitionError(f"the {what} {shown(point)} is outside the free space")
