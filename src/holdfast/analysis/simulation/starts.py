"""Starts of runs: given states, random ones of a box; states on the edges of a region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from holdfast.arguments import Count, OfStates, RangesOfStates, checked
from holdfast.errors import SimulationError, check_name
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.quantity import UnitError, to_si, warn_of_turns
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.value import Value

_DRAWS = 200  # batches of random states tried for each group of active inequalities
_INSIDE = 1e-9  # how far inside the boundary a start on it lies
_BLOCK = 4096  # starts of a group that are found together


@checked
@dataclass(frozen=True, eq=False)
class Starts(Value):
    """Initial states: those that are given, then random ones.

    states: each a mapping, state -> its value in its unit, or a text with another, such as
    "90 deg"; those left out are 0. random: how many, uniform over the states of the box that lie in
    the region. box: state -> (lowest, highest), likewise; those left out are 0. active: groups of
    names of inequalities; the random states are moved to where those of a group are 0 together, the
    groups taking turns.

    >>> start = hf.Starts(states=[{"x": 0.5}], random=3, box={"x": (-1, 1)})
    >>> hf.simulate(cart, brake, starts=start, region=track, horizon=2.0)
    <Result of 4 runs: 4 stayed>
    """

    states: Sequence[OfStates] = ()
    random: Count = 0
    box: RangesOfStates = field(default_factory=dict)
    active: Sequence[Sequence[str]] = ()

    @property
    def count(self) -> int:
        """The number of starts."""
        return len(self.states) + self.random

    def in_units_of(self, system: System) -> Starts:
        """The same in numbers; `SimulationError` for what is no value of a state, naming it."""
        units = {q.name: q.unit for q in system.states}

        for name in (n for named in (*self.states, self.box) for n in named):
            cause = f"'{name}' is not a state of system '{system.name}'"
            check_name(name, list(units), SimulationError, cause)

        def number_of(name: str, value: object) -> float:
            try:
                return to_si(value, units[name]) if isinstance(value, str) else float(value)  # type: ignore[arg-type]
            except (UnitError, TypeError, ValueError):
                raise SimulationError(
                    f"a start has {name} = {value!r}",
                    expected=f"a number in {units[name]}, or a text with its unit",
                ) from None

        def ends_of(name: str, ends: object) -> tuple[float, float]:
            if not (isinstance(ends, (tuple, list, np.ndarray)) and len(ends) == 2):
                raise SimulationError(
                    f"the box of '{name}' is {ends!r}", expected="two values, (lowest, highest)"
                )
            return number_of(name, ends[0]), number_of(name, ends[1])

        return replace(
            self,
            states=[{n: number_of(n, v) for n, v in s.items()} for s in self.states],
            box={n: ends_of(n, v) for n, v in self.box.items()},
        )


def warn_of_degrees(system: System, starts: Starts | Array) -> None:
    """Warn of starts of angles that are more than a turn, without a unit; an array has the shape
    (runs, states)."""
    for i, q in enumerate(system.states):
        if not q.angle:
            continue
        if isinstance(starts, Starts):
            values = [s.get(q.name, 0.0) for s in starts.states] + list(
                starts.box.get(q.name) or ()
            )
            values = [v for v in values if not isinstance(v, str)]
        else:
            values = [float(np.abs(starts[:, i]).max(initial=0.0))]
        most = float(max(values, key=abs, default=0.0))
        warn_of_turns(f"the start of '{q.name}'", most, f"math.radians({most:g})", stacklevel=5)


def on_boundary(
    system: System,
    region: Region | None,
    starts: Starts,
    drawn: range,
    low: Array,
    high: Array,
    seed: int,
) -> Array:
    """Random states of the box at which the inequalities of a group are active together.

    low, high: shape (states,); the states have the shape (drawn, states). drawn: indices of the
    wanted ones. Every block has its own random numbers, so that the states are the same in any
    part.
    """
    if region is None:
        raise SimulationError("starts where inequalities are active need a region")
    names = region.inequality_names
    for name in (n for group in starts.active for n in group):
        check_name(name, names, SimulationError, f"no inequality '{name}'")
    if not all(starts.active):
        raise SimulationError("a group of active inequalities is empty")
    states = [q.symbol for q in system.states]
    free = [i for i in range(len(states)) if low[i] < high[i]]
    values = [c.expression for c in region.inequalities]
    slopes = [v.diff(states[i]) for v in values for i in free]
    evaluate = Evaluator([*values, *slopes], states, (*system.parameters, *region.parameters))

    def find(chosen: list[int], count: int, generator: np.random.Generator) -> Array:
        """At most `count` states where the chosen inequalities are active together."""
        points = np.empty((0, len(states)))
        for _ in range(_DRAWS):
            if len(points) >= count:
                break
            q = generator.uniform(low, high, (4 * count + 64, len(states)))
            q = _moved(evaluate, q, chosen, free, len(values))
            value = evaluate.values(q)[:, : len(values)]
            good = (np.abs(value[:, chosen] + _INSIDE) < _INSIDE / 2).all(axis=1)
            good &= (value <= 0).all(axis=1) & ((q >= low) & (q <= high)).all(axis=1)
            points = np.vstack([points, q[good]])
        return points[:count]

    out = np.empty((len(drawn), len(states)))
    groups = len(starts.active)
    for turn, group in enumerate(starts.active):
        of_group = range(turn, starts.random, groups)
        chosen = [names.index(n) for n in group]
        for block in range(-(-len(of_group) // _BLOCK)):
            rows = np.array(of_group[block * _BLOCK : (block + 1) * _BLOCK])
            wanted = (rows >= drawn.start) & (rows < drawn.stop)
            if not wanted.any():
                continue
            random = np.random.Philox(key=[seed, turn], counter=[0, 0, 0, block])
            points = find(chosen, len(rows), np.random.Generator(random))
            if len(points) < len(rows):
                raise SimulationError(
                    f"no states of the box found where {' and '.join(group)} are active together",
                    remedy="check that they meet in the box",
                )
            out[rows[wanted] - drawn.start] = points[wanted]
    return out


def _moved(evaluate: Evaluator, q: Array, chosen: list[int], free: list[int], count: int) -> Array:
    """Gauss-Newton steps of least size to states where the chosen inequalities are -`_INSIDE`."""
    with np.errstate(all="ignore"):
        for _ in range(12):
            table = evaluate.values(q)
            residual = table[:, chosen] + _INSIDE
            jacobian = table[:, count:].reshape(len(q), count, len(free))[:, chosen]
            usable = np.isfinite(residual).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
            q, residual, jacobian = q[usable], residual[usable], jacobian[usable]
            q[:, free] -= np.einsum("kij,kj->ki", np.linalg.pinv(jacobian), residual)
    return q
