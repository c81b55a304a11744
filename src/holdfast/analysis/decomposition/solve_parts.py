"""The marches of the parts of a problem, each on a grid of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.analysis.decomposition.decomposition import Decomposition, Part
from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability import solve
from holdfast.analysis.reachability.grid import TURN, by_name, grid, whole
from holdfast.analysis.reachability.problem import CutOffError
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import checked
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.resources import Progress
from holdfast.maths.games.hamiltonian import without_closed_form


@checked
def solve_parts(
    decomposition: Decomposition,
    box: Mapping[str, tuple[float, float]] | None,
    nodes: int | Mapping[str, int],
    horizon: float,
    *,
    ends: Mapping[str, str] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> PartsValue:
    """The value of a problem from those of its parts, each on a grid of its own.

    box, nodes, ends: of all states of the parts, as for `grid`; options: of every march. A symmetry
    counts where a part has one of its states, and samples where a part has no closed form. Where
    actuators are predicted, the grid reaches over the box of the decomposition, within which states
    are kept, by a cell at least; without a box by one cell. Raises `SimulationError` as the
    problems do.
    """
    box = _around(decomposition, nodes) if box is None else box
    by_name("box", box, '{"x": (0, 1)}')
    _check_room(decomposition, box, nodes, ends or {})
    for name in ("parameters", "disturbance", "disturbances"):
        if name in options:
            raise SimulationError(
                f"{name} of a march over parts",
                expected="those of the system that was taken apart",
                remedy="give them to decompose, or change the system",
            )
    known = {n for p in decomposition.parts for n in p.system.state_names}
    tables: list[Mapping[str, Any]] = [box, ends or {}]
    if isinstance(nodes, Mapping):
        tables.append(nodes)
    for table in tables:
        for name in table:
            if name not in known:
                raise SimulationError(
                    f"'{name}' is not a state of a part", remedy=suggestion(name, known)
                )
    count = len(decomposition.parts)
    values = []
    for done, part in enumerate(decomposition.parts):

        def tell(fraction: float, before: int = done) -> None:
            if progress is not None:
                progress((before + fraction) / count)

        try:
            solved = _solved(part, decomposition, box, nodes, ends or {}, horizon, tell, options)
        except CutOffError as cut:
            name, far = cut.beyond
            if name in decomposition.within or name not in decomposition.box:
                raise
            raise SimulationError(
                f"a region of predicted states reaches beyond the box of '{name}'",
                remedy=f"give decompose a box in which '{name}' reaches to {far:.6g}",
            ) from cut
        values.append(solved)
    return PartsValue.of(decomposition, values)


ROOM = 1
"""Cells of a grid beyond the box that the states are kept within, on either side."""


def _count(nodes: int | Mapping[str, int], name: str) -> int:
    found = nodes.get(name) if isinstance(nodes, Mapping) else nodes
    return whole(f"nodes along '{name}': ", found, 2)


def _whole_turn(decomposition: Decomposition, name: str) -> bool:
    low, high = decomposition.box[name]
    angle = any(q.name == name and q.angle for q in decomposition.system.states)
    return angle and high - low >= TURN * (1 - 1e-9)


def _around(
    decomposition: Decomposition, nodes: int | Mapping[str, int]
) -> dict[str, tuple[float, float]]:
    """The box of the decomposition with room around it."""
    if not decomposition.box:
        raise SimulationError("no box", expected="the intervals of all states of the parts")
    found = {}
    known = {n for p in decomposition.parts for n in p.system.state_names}
    for name, (low, high) in decomposition.box.items():
        if name not in known:
            continue
        cells = _count(nodes, name) - 1 - 2 * ROOM
        if name not in decomposition.within or _whole_turn(decomposition, name):
            found[name] = (low, high)
            continue
        if cells < 1:
            raise SimulationError(
                f"{cells + 1 + 2 * ROOM} nodes along '{name}'", expected=f"at least {2 + 2 * ROOM}"
            )
        more = ROOM * (high - low) / cells
        found[name] = (low - more, high + more)
    return found


def _check_room(
    decomposition: Decomposition,
    box: Mapping[str, tuple[float, float]],
    nodes: int | Mapping[str, int],
    ends: Mapping[str, str],
) -> None:
    """Refuse a grid that is not that of the box: with room around it where it is kept, else in it.

    What the region reads ends within the grid, which is checked where the ends are "contained".
    """
    for name, (low, high) in decomposition.box.items():
        if name not in box or _whole_turn(decomposition, name):
            continue
        a, b = box[name]
        if name not in decomposition.within:
            if ends.get(name, "contained") != "contained":
                raise SimulationError(
                    f"ends of '{name}': '{ends[name]}'",
                    expected='"contained", where actuators are predicted',
                )
            if a < low * (1 - 1e-9 * np.sign(low)) or b > high * (1 + 1e-9 * np.sign(high)):
                raise SimulationError(
                    f"the grid along '{name}' is [{a:g}, {b:g}]",
                    expected=f"an interval within that of the decomposition, [{low:g}, {high:g}]",
                )
            continue
        cell = (b - a) / (_count(nodes, name) - 1) * (1 - 1e-9)
        if a > low - cell or b < high + cell:
            raise SimulationError(
                f"the grid along '{name}' is [{a:g}, {b:g}], and '{name}' is kept within "
                f"[{low:g}, {high:g}]",
                expected="a grid that reaches a cell further on either side",
                remedy="leave out the box of the grid",
            )


def _sampled(parts: Sequence[Part]) -> bool:
    """Whether the Hamiltonian of some part needs points of a set."""
    return any(without_closed_form(p.system) for p in parts)


def _solved(
    part: Part,
    whole: Decomposition,
    box: Mapping[str, tuple[float, float]],
    nodes: int | Mapping[str, int],
    ends: Mapping[str, str],
    horizon: float,
    tell: Progress,
    options: Mapping[str, Any],
) -> ValueFunction:
    names = part.system.state_names
    over = grid(
        part.system,
        {n: box[n] for n in names if n in box},
        {n: c for n, c in nodes.items() if n in names} if isinstance(nodes, Mapping) else nodes,
        {n: e for n, e in ends.items() if n in names},
    )
    chosen = dict(options)
    if (symmetry := chosen.get("symmetry")) is not None:
        mine = {n: s for n, s in symmetry.items() if n in names}
        chosen["symmetry"] = mine if -1 in mine.values() else None
    if chosen.get("samples") and _sampled(whole.parts) and not _sampled([part]):
        del chosen["samples"]
    function = getattr(solve, part.kind.replace("-", "_"))
    about: tuple[Any, ...] = (part.about,)
    if part.kind == "capture-basin":
        about = (part.goal, part.region)
        chosen.setdefault("arrival_steps", 0)
    if part.kind.startswith(("backward", "forward")):
        chosen["disturbances"] = whole.disturbances
    found: ValueFunction = function(part.system, *about, over, horizon, progress=tell, **chosen)
    return found
