"""The value of a problem put together from those of its parts, without a grid of its own; its file.

The root has the decomposition as text, whose expressions are those that were solved, and every
group `part_K` is what the file of that part's value function would be.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from holdfast._version import __version__
from holdfast.analysis.decomposition.decomposition import Decomposition, Part
from holdfast.analysis.reachability.grid import by_name, whole
from holdfast.analysis.reachability.value_function import Tried, ValueFunction
from holdfast.analysis.simulation.files import MARK, NamedArray, NamedArrays, write_groups
from holdfast.arguments import checked
from holdfast.errors import DefinitionError, HoldfastError, OutputError, SimulationError
from holdfast.execution.arrays import Array, Truths
from holdfast.execution.leaf import Evaluator
from holdfast.maths.decomposition.prediction import Prediction
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.written import read, written
from holdfast.maths.expressions.traversal import derivatives
from holdfast.maths.games.hamiltonian import hamiltonian

DECOMPOSITION = "decomposition"
"""The variable of the root with the text."""

LAYOUT = 1
RECORDS = (Prediction, Part, Decomposition)


def group_names(decomposition: Decomposition) -> list[str]:
    """The group of every part."""
    return [f"part_{k}" for k in range(1, len(decomposition.parts) + 1)]


def write_parts(
    decomposition: Decomposition, values: Iterable[ValueFunction], path: str | Path
) -> Path:
    """The file; `OutputError` where a part of the decomposition cannot be written."""
    text = _text(decomposition)
    array = NamedArray(("text",), np.array([text]), {"long_name": "what was taken apart, as JSON"})
    about = {
        MARK: __version__,
        "kind": decomposition.kind,
        "system": decomposition.system.name,
        "verdict": decomposition.verdict,
    }
    groups = {
        name: NamedArrays.of(value.dataset)
        for name, value in zip(group_names(decomposition), values, strict=True)
    }
    return write_groups(NamedArrays({DECOMPOSITION: array}, (), about), groups, path)


def decomposition_of(dataset: xr.Dataset) -> Decomposition:
    """The decomposition of the root; `ValueError` for a text that is none."""
    said = json.loads(str(dataset[DECOMPOSITION].values[0]))
    if (layout := said["layout"]) != LAYOUT:
        raise ValueError(f"the decomposition has the layout {layout!r:.20}, not {LAYOUT}")
    try:
        decomposition: Decomposition = read(said, Decomposition, *RECORDS)
    except HoldfastError as error:
        raise ValueError(error.cause) from None
    return decomposition


def check_part(part: Part, value: ValueFunction, name: str) -> None:
    """Refuse values that are not over the states of their part (`ValueError`)."""
    if value.names != part.system.state_names:
        raise ValueError(
            f"{name} is over {', '.join(value.names)}, not {', '.join(part.system.state_names)}"
        )


def _text(decomposition: Decomposition) -> str:
    """The text, from which the same decomposition is read: this is tried before it is kept."""
    try:
        said = _said(decomposition)
        again = _said(read(json.loads(json.dumps(said)), Decomposition, *RECORDS))
        if again != said:
            raise DefinitionError("what is read from its text is not the same")
    except HoldfastError as error:
        raise OutputError(
            f"the decomposition of '{decomposition.system.name}' cannot be written: {error.cause}",
            expected=error.expected,
            remedy="save the values of the parts, and take the problem apart again",
        ) from None
    return json.dumps({"layout": LAYOUT, **said}, separators=(",", ":"))


def _said(decomposition: Decomposition) -> dict[str, Any]:
    return written(decomposition, *RECORDS)


ROUNDING = 1e-9
"""Share of an end of the domain that a state may be beyond it, as one that rests there is."""


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
        """V of the part at states of the whole, shape (count, states): shape (count,)."""
        return self.value.at(self.coordinates(states), time)

    def gradient(self, states: Array, time: float | None) -> Array:
        """dV/dq along the states of the whole, by the chain rule; both have the shape (count,
        states)."""
        of_part = self.value.gradient(self.coordinates(states), time)
        slopes = self._slopes.values(states).reshape(len(states), of_part.shape[1], -1)
        of_whole: Array = np.einsum("ni,nij->nj", of_part, slopes)
        return of_whole

    def inputs(self, states: Array, time: float | None) -> dict[str, Array]:
        """The optimal inputs of the part, by name, each of the shape (count,), at states (count,
        states)."""
        points = self.coordinates(states)
        columns = self._optimal.values(np.hstack([points, self.value.gradient(points, time)]))
        return {n: columns[:, i] for i, n in enumerate(self.part.system.input_names)}


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

    @classmethod
    def of(cls, decomposition: Decomposition, values: Iterable[ValueFunction]) -> PartsValue:
        """The value of these value functions, one for each part in the order of the parts."""
        whole, left = decomposition.system, iter(values)
        lists = [
            [SolvedPart(p, next(left), whole) for p in ps] for ps in decomposition.alternatives
        ]
        return cls(decomposition, tuple(map(tuple, lists)))

    def reported(self, **changes: Any) -> PartsValue:
        """The same with some entries of every part's report replaced; None removes an entry."""
        return PartsValue.of(self.decomposition, [v.reported(**changes) for v in self.values])

    def tried(self, promise: Tried) -> PartsValue:
        """The same with what a closed-loop validation came to in the report of every part."""
        return PartsValue.of(self.decomposition, [v.tried(promise) for v in self.values])

    @property
    def converged(self) -> bool:
        """Whether the march of every part has converged."""
        return all(v.report.converged for v in self.values)

    @checked
    def at(self, states: npt.ArrayLike, time: float | None = None) -> Array:
        """V at states of shape (count, states); NaN outside a grid.

        Where a state lies outside the domain of the decomposition V is at most minus the excess.
        Of a kernel V is at most the margin of a region that does not move, exact between nodes too.
        """
        points = self._points(states)
        return self.within(points, self._alternatives(points, time).max(axis=0))

    @checked
    def contains(
        self, states: npt.ArrayLike, margin: float = 0.0, time: float | None = None
    ) -> Truths:
        """Whether V > margin; a state outside a grid or the domain is not contained. states: shape
        (count, states). The answers have the shape (count,)."""
        inside: Truths = self.at(states, time) > margin
        return inside

    @checked
    def gradient(self, states: npt.ArrayLike, time: float | None = None) -> Array:
        """dV/dq at states of shape (count, states): of the part that decides."""
        points = self._points(states)
        best = self._alternatives(points, time).argmax(axis=0)
        slopes = np.full(points.shape, np.nan)
        for k, parts in enumerate(self.parts):
            here = np.flatnonzero(best == k)
            if not len(here):
                continue
            levels = np.stack([s.at(points[here], time) for s in parts])
            least = np.where(np.isnan(levels), -np.inf, levels).argmin(axis=0)
            for j, s in enumerate(parts):
                mine = here[least == j]
                if len(mine):
                    slopes[mine] = s.gradient(points[mine], time)
        return slopes

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
        chosen = np.tile(np.array([float(v) for v in idle]), (len(points), 1))
        best = self._alternatives(points, time).argmax(axis=0)
        for k, parts in enumerate(self.parts):
            here = np.flatnonzero(best == k)
            for s in parts if len(here) else ():
                for n, column in s.inputs(points[here], time).items():
                    chosen[here, system.input_names.index(n)] = column
        return self._commands(points, chosen)

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

    @checked
    def save(self, path: str | Path) -> Path:
        """Write a NetCDF-4 file, which `load` reads: the decomposition, and a group for each part.

        A group is the file that its value function would have. Raises `OutputError` if the folder
        cannot be written, and for expressions that a file cannot have.
        """
        return write_parts(self.decomposition, self.values, path)

    def _commands(self, points: Array, chosen: Array) -> Array:
        """The inputs that bring about what the parts choose."""
        prediction = self.decomposition.prediction
        if prediction is None:
            return chosen
        system = self.decomposition.system
        names = [*(q.symbol for q in system.inputs), *(q.symbol for q in system.states)]
        commands = Evaluator(list(prediction.command.values()), names, ())
        return commands.values(np.hstack([chosen, points]))

    def _alternatives(self, points: Array, time: float | None) -> Array:
        """The value of every alternative; -infinity where it is not known."""
        alternatives = [np.stack([s.at(points, time) for s in parts]) for parts in self.parts]
        least = np.stack([levels.min(axis=0) for levels in alternatives])
        if len(least) == 1:
            return least
        return np.where(np.isnan(least), -np.inf, least)

    @cached_property
    def _domain(self) -> Evaluator | None:
        rows = [c.expression for c in self.decomposition.domain]
        system = self.decomposition.system
        symbols = [q.symbol for q in system.states]
        return Evaluator(rows, symbols, system.parameters) if rows else None

    @cached_property
    def _margin(self) -> Evaluator | None:
        region = self.decomposition.kept
        symbols = [q.symbol for q in self.decomposition.system.states]
        if region is None or region.moves:
            return None
        return Evaluator([region.margin], symbols, region.parameters)

    def excess(self, points: Array) -> Array:
        """By how much states (count, states) are outside the domain of the decomposition; or 0."""
        if self._domain is None:
            return np.zeros(len(points))
        levels = self._domain.values(points)
        beyond: Array = np.where(levels > self._rounding, levels, 0.0).max(axis=1)
        return beyond

    @cached_property
    def _rounding(self) -> Array:
        """Of every inequality of the domain; two in turn are the ends of one interval."""
        ends = [abs(float(c.expression.as_coeff_Add()[0])) for c in self.decomposition.domain]
        return ROUNDING * np.repeat(np.reshape(ends, (-1, 2)).max(axis=1), 2)

    def within(self, points: Array, levels: Array) -> Array:
        """V at states (count, states) where its parts are `levels`: see `at`."""
        if self._margin is not None:
            levels = np.minimum(levels, self._margin.values(points)[:, 0])
        excess = self.excess(points)
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
