"""The value of a problem put together from those of its parts, without a grid of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.decomposition.decomposition import Decomposition, Part
from holdfast.analysis.reachability import sets
from holdfast.analysis.reachability.given import by_name, whole
from holdfast.analysis.reachability.grid import TURN, grid
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import checked
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.execution.resources import Progress
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import derivatives
from holdfast.maths.games.hamiltonian import hamiltonian


@dataclass(frozen=True)
class SolvedPart:
    """A part, its value function, and the coordinates as functions of the whole state."""

    part: Part
    value: ValueFunction
    whole: System

    @cached_property
    def _coordinates(self) -> Evaluator:
        symbols = [q.symbol for q in self.whole.states]
        return Evaluator(list(self.part.coordinates.values()), symbols, self.whole.parameters)

    @cached_property
    def _slopes(self) -> Evaluator:
        symbols = [q.symbol for q in self.whole.states]
        rows = [derivatives(e, symbols) for e in self.part.coordinates.values()]
        every = [row[s] for row in rows for s in symbols]
        return Evaluator(every, symbols, self.whole.parameters)

    @cached_property
    def _optimal(self) -> Evaluator:
        h = hamiltonian(self.part.system)
        states = [q.symbol for q in self.part.system.states]
        return Evaluator(
            list(h.inputs.values()), [*states, *h.costates], self.part.system.parameters
        )

    def coordinates(self, states: Array) -> Array:
        """The states of the part, shape (count, states of the part)."""
        return self._coordinates.values(states)

    def at(self, states: Array, time: float | None) -> Array:
        return self.value.at(self.coordinates(states), time)

    def gradient(self, states: Array, time: float | None) -> Array:
        """dV/dq along the states of the whole, by the chain rule."""
        own = self.value.gradient(self.coordinates(states), time)
        slopes = self._slopes.values(states).reshape(len(states), own.shape[1], -1)
        found: Array = np.einsum("ni,nij->nj", own, slopes)
        return found

    def inputs(self, states: Array, time: float | None) -> dict[str, Array]:
        """The optimal inputs of the part, by name."""
        points = self.coordinates(states)
        found = self._optimal.values(np.hstack([points, self.value.gradient(points, time)]))
        return {n: found[:, i] for i, n in enumerate(self.part.system.input_names)}


@dataclass(frozen=True)
class PartsValue:
    """V = max over alternatives of min over parts of V_part; the set is { V > 0 }.

    It is evaluated where it is asked for, and has no grid. `decomposition` says what the set is
    worth: exact, or inner. parts: the value functions, by alternative.
    """

    decomposition: Decomposition
    parts: tuple[tuple[SolvedPart, ...], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The states, in the order of the columns of `at`."""
        return self.decomposition.system.state_names

    @property
    def values(self) -> tuple[ValueFunction, ...]:
        """The value functions of all parts."""
        return tuple(s.value for parts in self.parts for s in parts)

    @property
    def converged(self) -> bool:
        """Whether the march of every part has converged."""
        return all(v.report.converged for v in self.values)

    @checked
    def at(self, states: npt.ArrayLike, time: float | None = None) -> Array:
        """V at states of shape (count, states); NaN outside a grid.

        Where a state lies outside the domain of the decomposition V is at most minus the excess.
        """
        points = self._points(states)
        return self._within(points, self._alternatives(points, time).max(axis=0))

    @checked
    def contains(
        self, states: npt.ArrayLike, margin: float = 0.0, time: float | None = None
    ) -> npt.NDArray[np.bool_]:
        """Whether V > margin; a state outside a grid or the domain is not contained."""
        inside: npt.NDArray[np.bool_] = self.at(states, time) > margin
        return inside

    @checked
    def gradient(self, states: npt.ArrayLike, time: float | None = None) -> Array:
        """dV/dq at states of shape (count, states): of the part that decides."""
        points = self._points(states)
        best = self._alternatives(points, time).argmax(axis=0)
        found = np.full(points.shape, np.nan)
        for k, parts in enumerate(self.parts):
            here = np.flatnonzero(best == k)
            if not len(here):
                continue
            levels = np.stack([s.at(points[here], time) for s in parts])
            least = np.where(np.isnan(levels), -np.inf, levels).argmin(axis=0)
            for j, s in enumerate(parts):
                mine = here[least == j]
                if len(mine):
                    found[mine] = s.gradient(points[mine], time)
        return found

    @checked
    def inputs(self, states: npt.ArrayLike, time: float | None = None) -> Array:
        """The optimal inputs of the system, shape (count, inputs): every part has its own.

        Of several alternatives those of the one with the largest value. An input that no part
        needs is 0, or as near to it as its bounds allow.
        """
        points = self._points(states)
        system = self.decomposition.system
        numbers = {q.symbol: q.value for q in system.parameters}
        idle: list[Any] = [0.0] * len(system.inputs)
        if system.input_bounds is not None:
            idle = list(system.input_bounds.at(numbers).saturate(idle))
        found = np.tile(np.array([float(v) for v in idle]), (len(points), 1))
        best = self._alternatives(points, time).argmax(axis=0)
        for k, parts in enumerate(self.parts):
            here = np.flatnonzero(best == k)
            for s in parts if len(here) else ():
                for n, column in s.inputs(points[here], time).items():
                    found[here, system.input_names.index(n)] = column
        return self._commands(points, found)

    @checked
    def share(
        self, box: Mapping[str, tuple[float, float]], runs: int = 10_000, seed: int = 0
    ) -> float:
        """The share of random states of a box that is in the set."""
        whole("runs: ", runs, 1)
        whole("seed: ", seed, 0)
        for n in self.names:
            if n not in by_name("box", box, '{"x": (0, 1)}'):
                raise SimulationError(f"the box has no interval for '{n}'")
        low, high = (np.array([box[n][k] for n in self.names]) for k in (0, 1))
        states = np.random.default_rng(seed).uniform(low, high, (runs, len(low)))
        return float(self.contains(states).mean())

    def _commands(self, points: Array, chosen: Array) -> Array:
        """The inputs that bring about what the parts choose."""
        found = self.decomposition.prediction
        if found is None:
            return chosen
        system = self.decomposition.system
        names = [*(q.symbol for q in system.inputs), *(q.symbol for q in system.states)]
        commands = Evaluator(list(found.command.values()), names, ())
        return commands.values(np.hstack([chosen, points]))

    def _alternatives(self, points: Array, time: float | None) -> Array:
        """The value of every alternative; -infinity where it is not known."""
        found = [np.stack([s.at(points, time) for s in parts]) for parts in self.parts]
        least = np.stack([levels.min(axis=0) for levels in found])
        if len(least) == 1:
            return least
        return np.where(np.isnan(least), -np.inf, least)

    @cached_property
    def _domain(self) -> Evaluator | None:
        rows = [c.expression for c in self.decomposition.domain]
        system = self.decomposition.system
        symbols = [q.symbol for q in system.states]
        return Evaluator(rows, symbols, system.parameters) if rows else None

    def _within(self, points: Array, levels: Array) -> Array:
        if self._domain is None:
            return levels
        excess = self._domain.values(points).max(axis=1)
        return np.where(excess > 0, np.fmin(levels, -excess), levels)

    def _points(self, states: npt.ArrayLike) -> Array:
        points = np.atleast_2d(np.asarray(states, dtype=np.float64))
        if points.ndim != 2 or points.shape[1] != len(self.names):
            raise SimulationError(
                f"states have the shape {points.shape}",
                expected=f"(count, {len(self.names)}), in the order {', '.join(self.names)}",
            )
        if not np.isfinite(points).all():
            raise SimulationError("a state is not finite", expected="finite numbers")
        return points


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
    counts where a part has one of its states. Where actuators are predicted, the grid reaches over
    the box of the decomposition, within which states are kept, by a cell at least; without a
    box by one cell. Raises `SimulationError` as the problems do.
    """
    box = _around(decomposition, nodes) if box is None else box
    by_name("box", box, '{"x": (0, 1)}')
    _check_room(decomposition, box, nodes)
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
    done = 0
    lists = []
    for parts in decomposition.alternatives:
        solved = []
        for part in parts:

            def tell(fraction: float, before: int = done) -> None:
                if progress is not None:
                    progress((before + fraction) / count)

            value = _solved(part, decomposition, box, nodes, ends or {}, horizon, tell, options)
            solved.append(SolvedPart(part, value, decomposition.system))
            done += 1
        lists.append(tuple(solved))
    return PartsValue(decomposition, tuple(lists))


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
    for name, (low, high) in decomposition.box.items():
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
) -> None:
    """Refuse a grid without room around the box of the decomposition."""
    for name, (low, high) in decomposition.box.items():
        if name not in box or _whole_turn(decomposition, name):
            continue
        a, b = box[name]
        if name not in decomposition.within:
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
    function = getattr(sets, part.kind.replace("-", "_"))
    about: tuple[Any, ...] = (part.about,)
    if part.kind == "capture-basin":
        about = (part.goal, part.region)
        chosen.setdefault("arrival_steps", 0)
    if part.kind.startswith(("backward", "forward")):
        chosen["disturbances"] = whole.disturbances
    found: ValueFunction = function(part.system, *about, over, horizon, progress=tell, **chosen)
    return found
