"""A grid over the states of a system: its nodes, what its axes have at their ends, checks, and how
much values change from node to node."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.arguments import RangesOfStates, checked
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import ENDS
from holdfast.maths.definitions.quantity import Quantity, UnitError, to_si
from holdfast.maths.definitions.system import System


def as_number(value: object) -> float | None:
    """The value as a float; None if it is not a number, such as True, "3" or a list."""
    if isinstance(value, sp.Expr):
        return float(value) if value.is_number and value.is_extended_real else None
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        return float(value)
    return None


def number(what: str, value: object, expected: str, holds: Callable[[float], bool]) -> float:
    """The value as a float; refused if it is not a number or does not satisfy `holds`.

    NaN is refused, because every comparison with it is false.
    """
    as_float = as_number(value)
    if as_float is None or not holds(as_float):
        raise SimulationError(f"{what}{value!r}", expected=expected)
    return as_float


def whole(what: str, value: object, least: int, most: float = float("inf")) -> int:
    """The value as a whole number within [least, most]; True and 3.0 are refused."""
    kind = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if kind and least <= cast(int, value) <= most:
        return int(cast(int, value))
    expected = f"a whole number of at least {least}"
    if most < float("inf"):
        expected = f"a whole number from {least} to {most:g}"
    raise SimulationError(f"{what}{value!r}", expected=expected)


def by_name(what: str, value: object, example: str) -> Mapping[str, Any]:
    """The value as a table by name."""
    if not isinstance(value, Mapping):
        raise SimulationError(f"{what}: {value!r}", expected=f"a table by name, such as {example}")
    return value


TURN = 2.0 * math.pi

VARIABLES = ("value", "arrival", "outside", "time")
"""The variables of a value function; its axes have the names of the states."""

LARGEST_DIMENSION = 6


@dataclass(frozen=True)
class Axis:
    """`count` nodes from low to high; a periodic axis, whose ends coincide, has no node at high.

    ends, the boundary condition that gives the ghost cells: "extrapolated" (linearly, away from
    zero), "contained": the same, and the region has to lie within, "periodic", or "limited": the
    state itself is limited there, and no trajectory leaves.
    """

    state: Quantity
    low: float
    high: float
    count: int
    ends: str

    @property
    def name(self) -> str:
        return self.state.name

    @property
    def step(self) -> float:
        return (self.high - self.low) / (self.count - (self.ends != "periodic"))

    @property
    def nodes(self) -> npt.NDArray[np.float64]:
        """The states at the nodes, in the unit of the state, shape (count,)."""
        return self.low + self.step * np.arange(self.count, dtype=np.float64)

    @property
    def reflected(self) -> npt.NDArray[np.int64]:
        """The index of the node whose state is -1 times that of this one.

        The shape is (count,).

        Raises `SimulationError` if it does not exist.
        """
        middle = -2.0 * self.low / self.step  # the sum of the indices of a node and its reflection
        whole = round(middle)
        fits = self.ends == "periodic" or whole == self.count - 1
        if not fits or abs(middle - whole) > 1e-9 * self.count:
            raise SimulationError(
                f"the nodes along '{self.name}' are not symmetric about 0",
                expected="an interval with 0 in its middle, as the symmetry needs",
            )
        return (whole - np.arange(self.count, dtype=np.int64)) % self.count


@dataclass(frozen=True)
class Grid:
    """The axes in the order of the system's states."""

    axes: tuple[Axis, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(a.count for a in self.axes)

    @property
    def nodes(self) -> int:
        return math.prod(self.shape)


@checked
def grid(
    system: System,
    box: RangesOfStates,
    nodes: int | Mapping[str, int],
    ends: Mapping[str, str] | None = None,
) -> Grid:
    """The grid over a box of all states.

    box: state -> (low, high), numbers in its unit, or texts with another, such as "-180 deg".
    nodes: along every axis, or state -> how many. ends: the boundary conditions, state ->
    "contained" (the default: the region of a kernel has to lie within), "periodic" (the default of
    an angle over a whole turn), "extrapolated", "limited". An angle over part of a turn has no
    default.

    Raises `SimulationError` for a state with the name of one of `VARIABLES` or without an interval,
    for an interval that is empty or unbounded, an angle over more than a turn, a
    periodic axis that is not one turn of an angle, fewer than two nodes, and more than six states.

    >>> place = {"x": (-2, 2), "y": (-2, 2), "psi": (-np.pi, np.pi)}
    >>> hf.grid(robot, place, {"x": 21, "y": 21, "psi": 16}).shape
    (21, 21, 16)
    """
    if not isinstance(system, System):
        raise SimulationError(f"got {system!r}", expected="a System")
    names = system.state_names
    by_name("box", box, '{"x": (0, 1)}')
    ends = dict(by_name("ends", {} if ends is None else ends, '{"x": "limited"}'))
    if len(names) > LARGEST_DIMENSION:
        raise SimulationError(
            f"system '{system.name}' has {len(names)} states",
            expected=f"at most {LARGEST_DIMENSION} for a grid",
            remedy="take the problem apart (hf.decompose; [decompose] in a scenario), or promote "
            "some states to bounded inputs (promote)",
        )
    for name in names:
        if name in VARIABLES:
            raise SimulationError(
                f"a state has the name '{name}' of a variable of value functions",
                expected=f"states of other names than {', '.join(VARIABLES)}",
                remedy="rename the state",
            )
    tables: list[tuple[str, Mapping[str, object]]] = [("box", box), ("ends", ends)]
    if isinstance(nodes, Mapping):
        tables.append(("nodes", nodes))
    for what, table in tables:
        for name in table:
            if name not in names:
                raise SimulationError(
                    f"{what} of '{name}', which is not a state", remedy=suggestion(name, names)
                )
    return Grid(tuple(_axis(q, box, nodes, ends.get(q.name)) for q in system.states))


def _end(value: object, unit: str) -> float | None:
    """A number, or a text with its unit; None for anything else."""
    if not isinstance(value, str):
        return as_number(value)
    try:
        return to_si(value, unit)
    except UnitError:
        return None


def _axis(
    q: Quantity,
    box: Mapping[str, tuple[float, float]],
    nodes: int | Mapping[str, int],
    ends: str | None,
) -> Axis:
    if q.name not in box:
        raise SimulationError(f"the grid has no interval for '{q.name}'")
    wanted = nodes.get(q.name) if isinstance(nodes, Mapping) else nodes
    count = whole(f"nodes along '{q.name}': ", wanted, 2)
    interval = box[q.name]
    pair = isinstance(interval, (tuple, list, np.ndarray)) and len(interval) == 2
    low, high = (_end(v, q.unit) for v in interval) if pair else (None, None)
    if low is None or high is None:
        raise SimulationError(
            f"the interval of '{q.name}' is {interval!r}",
            expected=f'two numbers, (low, high), or texts with a unit such as "1 {q.unit}"',
        )
    sides = zip(interval, (low, high), strict=True)
    shown = f"[{', '.join(v if isinstance(v, str) else f'{n:g}' for v, n in sides)}]"
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise SimulationError(f"the interval of '{q.name}' is {shown}", expected="low < high")
    once = q.angle and math.isclose(high - low, TURN, rel_tol=1e-9)
    if q.angle and high - low > TURN * (1 + 1e-9):
        raise SimulationError(
            f"the interval of the angle '{q.name}', {shown}, is {high - low:g} rad",
            expected="at most 2 pi",
        )
    if q.angle and not once and ends is None:
        raise SimulationError(
            f"the interval of the angle '{q.name}', {shown}, is {high - low:g} rad, not a whole "
            "turn",
            expected="2 pi",
            remedy='or give a boundary condition: ends = {"' + q.name + '": "contained"}',
        )
    ends = ends or ("periodic" if once else "contained")
    if not isinstance(ends, str) or ends not in ENDS:
        raise SimulationError(f"ends of '{q.name}': '{ends}'", remedy=suggestion(str(ends), ENDS))
    if ends == "periodic" and not once:
        raise SimulationError(f"'{q.name}' is periodic over {shown}", expected="an angle over 2 pi")
    return Axis(q, low, high, count, ends)


def largest_change(values: Array) -> float:
    """The largest difference between neighbours, at the nodes in the set or next to it.

    values: shape (some of the first axis, nodes of the others, ...).
    """

    def largest(ahead: Array, behind: Array) -> float:
        near = (ahead > 0) | (behind > 0)
        return float(np.abs(ahead - behind)[near].max(initial=0.0))

    change = 0.0
    for k, slab in enumerate(values):  # slab by slab, to save memory
        if k:
            change = max(change, largest(slab, values[k - 1]))
        for i in range(slab.ndim):
            rows = np.moveaxis(slab, i, 0)
            change = max(change, largest(rows[1:], rows[:-1]))
    return change
