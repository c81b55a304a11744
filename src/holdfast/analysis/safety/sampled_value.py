"""The value of the sampled game over a kernel: what is kept where inputs are held.

    W(q) = min(V(q), max over u of min over d of W(the state after u and d were held))

V is the kernel's value. From a state with W >= c some held input leads to W >= c whatever a held d
does, at ridges of V too, where no input raises V at once. W is iterated on the grid; the state
after a sample is `held_motion`, and W between nodes is that of `interpolate.py`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray, Array
from holdfast.execution.evaluate import Evaluator
from holdfast.execution.foreseen import CUTS, numbers_of_search
from holdfast.execution.look_up import values_at
from holdfast.execution.sampled_game import numbers_of_motion
from holdfast.execution.scalar import called
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from holdfast.maths.control.held_motion import HeldMotion, held_motion
from holdfast.maths.definitions.bounds import Bounds
from holdfast.maths.definitions.lookup import Lookup, SampledLookup
from holdfast.maths.definitions.system import System

Whole = npt.NDArray[np.int64]
Points = tuple[tuple[sp.Expr, ...], ...]

ENDS = {"extrapolated": 0, "contained": 0, "periodic": 1, "limited": 2}
MOST_READ = 1 << 25
"""Values that are read from a file, in which they would stay; `load` leaves no fewer there."""
MOST_SWEEPS = 3000
"""Beyond them values still fall by what interpolation loses; what is left is in the margin."""
MOST_WORK = 2e7
"""Nodes times corners of a cell times inputs and disturbances, from which on the game is not
solved."""
MOST_LOOKS = 1e9
"""Corners looked up, from which on the game is given up: some seconds."""
TOGETHER = 1 << 26
"""Numbers of the motions that are held in memory; beyond it they are computed anew."""
DEPTH = 2.0  # cells below 0 from which on a state is lost
LITTLE = 1e-5  # cells by which a value has to fall to count
TRIED, SAMPLES = 2000, 100  # states between nodes from which the filter is tried, and its samples
LONG, LOWEST = 1000, 150  # samples of those that are lowest then, and how many they are
NEAR = 2.0  # cells above 0 from which these begin
KEPT = 0.9  # the share of a set that has not converged below which the game is of no use to it
SUBSTEPS = 8
SPARE = 0.1  # of a cell, by which the level to keep is above the highest that was lost
INPUTS = {1: 9, 2: 5, 3: 3}


@dataclass(frozen=True)
class SampledValue:
    """W at the nodes, and what a filter over it needs.

    points: of the inputs; moves: of the disturbances; errors: of the inputs that act. least:
    the highest W from which a state was seen to be lost, and a tenth of the usual change of W over
    a cell: the level to keep. beyond: the largest change of V over a cell.
    """

    table: AnyArray
    points: Points
    moves: Points
    errors: Points
    least: float
    beyond: float

    def possible_margin(self, late: float, sample_time: float, delay: float) -> float:
        """`least` and what may fall while late; `SimulationError` where no state has it."""
        margin, deepest = self.least + late, float(self.table.max())
        if margin < deepest:
            return margin
        behind = f" and a delay of {delay:g} s" if delay else ""
        raise SimulationError(
            f"V may fall by {margin:.3g} before an input answers, held for {sample_time:g} s"
            f"{behind}, and what held inputs keep is nowhere above {max(deepest, 0.0):.3g}",
            remedy="take a shorter sample time or delay, a finer grid, or give a margin",
        )

    def share(self, value: ValueFunction) -> float:
        """The share of the nodes of the set that held inputs keep in it."""
        return float((self.table > 0).sum() / max((value.values() > 0).sum(), 1))

    def lookup(self, of: Lookup, sample_time: float) -> SampledLookup:
        """The table of a law, on the grid of the kernel's own."""
        table = (self.table, *of.table[1:])  # type: ignore[index]
        return SampledLookup(of.places, table, unit=of.unit, hold=sample_time)


def points_of(bounds: Bounds, dimension: int) -> Points:
    """Points of the bounds of inputs, their ends among them; the middle first."""
    count = INPUTS.get(dimension, 2)
    return tuple(map(tuple, bounds.inscribed_points(count)))


def moves_of(bounds: Bounds | None, dimension: int) -> Points:
    """Points of the bounds of disturbances: their ends, and where they are few between them."""
    if bounds is None or dimension == 0:
        return ((),)
    return tuple(map(tuple, bounds.points(3 if dimension < 3 else 2)))


def sampled_value(
    system: System, value: ValueFunction, sample_time: float, errors: Sequence[float] = ()
) -> SampledValue | None:
    """The value of the game whose inputs are held for `sample_time` [s]; computed once.

    system: with the prescribed disturbances of the value, and its parameters. errors: by how much
    each input that acts may differ from the one that is held. None where the game would take
    longer than some seconds (`MOST_WORK`, `MOST_LOOKS`), the values stay in a file, or are not
    those of all inputs; and of a set that has not converged where it keeps less than `KEPT` of it.
    """
    if value.stored is not None and value.grid.nodes > MOST_READ:
        return None
    if not system.inputs or system.input_bounds is None or system.samples:
        return None
    key = float(sample_time), tuple(map(float, errors))
    if key not in value.games:
        value.games[key] = _Game(system, value, *key).solved()
    game: SampledValue | None = value.games[key]
    if game is None or value.report.converged or game.share(value) >= KEPT:
        return game
    return None


class _Game:
    def __init__(
        self, system: System, value: ValueFunction, sample_time: float, errors: tuple[float, ...]
    ) -> None:
        assert system.input_bounds is not None
        self.system, self.value, self.hold = system, value, sample_time
        numbers = {q.symbol: sp.Float(float(q.value)) for q in system.parameters}
        self.points = points_of(system.input_bounds, len(system.inputs))
        self.moves = moves_of(system.disturbance_bounds, len(system.disturbances))

        self.errors: Points = ((),)
        if any(errors):
            signs = itertools.product((-1, 1), repeat=len(errors))
            self.errors = tuple(
                tuple(sp.Float(s * e) for s, e in zip(one, errors, strict=True)) for one in signs
            )

        def as_floats(points: Points) -> Array:
            rows = [[float(sp.sympify(e).xreplace(numbers)) for e in p] for p in points]
            return np.array(rows, dtype=np.float64).reshape(len(points), -1)

        self.inputs, self.disturbances = as_floats(self.points), as_floats(self.moves)
        self.states = [q.symbol for q in system.states]
        axes = value.grid.axes
        self.low = np.array([a.low for a in axes], dtype=np.float64)
        self.steps = np.array([a.step for a in axes], dtype=np.float64)
        self.shape = np.array([a.count for a in axes], dtype=np.int64)
        self.ends = np.array([ENDS[a.ends] for a in axes], dtype=np.int64)
        self.turns = np.array([a.ends == "periodic" for a in axes], dtype=np.int64)
        self.cell = value.report.cell or 1.0
        n, m = len(axes), len(system.inputs)
        self.n, self.m = n, m
        self.corners = 2.0**n * len(self.points) * len(self.moves) * len(self.errors)

    def solved(self) -> SampledValue | None:
        if self.corners * self.value.grid.nodes > MOST_WORK:
            return None
        system = self.system
        self.motion: HeldMotion = held_motion(system, sp.Float(self.hold), self.moves, self.errors)
        self.moved = Evaluator(self.motion.expressions, self.states, system.parameters)
        self.wide = numbers_of_motion(self.n, self.m, self.motion.moves, self.motion.curved)
        table = self.value.in_memory().values()
        start = np.ascontiguousarray(table, dtype=np.float64).ravel()
        lost = -DEPTH * self.cell
        found = np.maximum(np.where(np.isnan(start), lost, start), lost)
        if not self._iterate(found, lost):
            return None
        least, usual = self._least(found, start)
        if table.dtype == np.float32:
            single = found.astype(np.float32)
            above = single > found
            single[above] = np.nextafter(single[above], np.float32(-np.inf))
            found = single
        return SampledValue(
            found, self.points, self.moves, self.errors, least + SPARE * usual, self.cell
        )

    def _iterate(self, found: Array, lost: float) -> bool:
        """Lower the values until none falls, or for `MOST_SWEEPS`; False where that is too long."""
        count, layer = len(found), math.prod(self.shape[1:].tolist())
        together = max(layer, TOGETHER // self.wide // layer * layer)
        stored: dict[int, Array] = {}
        flags, chosen = np.ones(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        reach = np.ones(self.n, dtype=np.int64)
        points = self.inputs.ravel()
        room, whole = np.empty(8 * self.n), np.zeros(4 * self.n, dtype=np.int64)
        firsts = list(range(0, count, together))
        for first in firsts:
            last = min(first + together, count)
            motions = self._motions(first, last)
            far = self._reach(motions, first, last)
            reach = np.maximum(reach, far)
            if len(firsts) == 1:
                stored[first] = motions
        reach = np.minimum(reach, np.maximum((self.shape - 1) // 2, 1))
        looks = 0.0
        for sweep in range(MOST_SWEEPS):
            fallen, back = 0, sweep % 2
            for first in reversed(firsts) if back else firsts:
                last = min(first + together, count)
                flagged = np.count_nonzero(flags[first:last])
                if not flagged:
                    continue
                looks += flagged * self.corners
                motions = stored[first] if first in stored else self._motions(first, last)
                fallen += called(
                    "sampled_game", "sweep_game", found, flags, chosen, motions.reshape(-1), first,
                    last - first, back, points, len(self.inputs), self.wide, self.low, self.steps,
                    self.shape, self.ends, reach, self.n, self.m, self.motion.moves,
                    int(self.motion.curved), lost, LITTLE * self.cell, room, whole,
                )  # fmt: skip
            if not fallen:
                break
            if looks > MOST_LOOKS:
                return False
        return True

    def _nodes(self, first: int, last: int) -> Array:
        places = np.unravel_index(np.arange(first, last), tuple(self.shape))
        return np.stack(
            [a.nodes[k] for a, k in zip(self.value.grid.axes, places, strict=True)], axis=1
        )

    def _motions(self, first: int, last: int) -> Array:
        found = self.moved.values(self._nodes(first, last))
        return np.where(np.isfinite(found), found, 1e300)

    def _reach(self, motions: Array, first: int, last: int) -> Whole:
        """The cells along each axis by which a sample moves the state, at most."""
        n, m = self.n, self.m
        largest = np.abs(self.inputs).max(axis=0)
        base = np.abs(motions[:, :n] - self._nodes(first, last))
        gains = np.abs(motions[:, n : n + n * m].reshape(len(motions), n, m)) @ largest
        pairs = m * (m + 1) // 2 * int(self.motion.curved)
        behind = n * (1 + m)
        curves = np.abs(motions[:, behind : behind + n * pairs].reshape(len(motions), n, pairs))
        bent = curves.sum(axis=2) * (largest.max() ** 2 if m else 0.0)
        rest = motions[:, behind + n * pairs :].reshape(len(motions), self.motion.moves, n)
        far = (base + gains + bent + np.abs(rest).max(axis=1)) / self.steps
        far = np.where(far < 1e6, far, 0.0)
        found: Whole = np.ceil(far.max(axis=0)).astype(np.int64)
        return found

    # -- what is left out of the game --------------------------------------------------------

    def _least(self, found: Array, start: Array) -> tuple[float, float]:
        """The highest W from which a state was seen to be lost, and by how much W changes a cell.

        The states are between nodes, at the boundary, under the best input of every sample and the
        disturbance that is worst for it.
        """
        over = found.reshape(tuple(self.shape))
        inside = over > 0
        usual, edge = 0.0, np.zeros_like(inside)
        for axis in range(self.n):
            near = np.roll(over, -1, axis)
            both = inside & (near > 0)
            edge |= (inside != (near > 0)) | np.roll(inside != (near > 0), 1, axis)
            if both.any():
                usual = max(usual, float(np.median(np.abs(near - over)[both])))
        band = np.flatnonzero((inside & (edge | (over <= NEAR * usual))).ravel())
        if not len(band):
            return 0.0, usual
        generator = np.random.default_rng(0)
        places = np.stack(
            np.unravel_index(generator.choice(band, TRIED), tuple(self.shape)), axis=1
        )
        states = self.low + (places + generator.uniform(-1, 1, places.shape)) * self.steps
        begun = self._at(found, states)
        states, begun = states[begun > 0], begun[begun > 0]
        lost = np.zeros(len(states), dtype=bool)
        flown = np.arange(len(states))
        for sample in range(LONG):
            if sample == SAMPLES:  # what escapes slowly is by now among the lowest
                order = np.argsort(self._at(found, states[~lost]))
                flown = np.flatnonzero(~lost)[order[:LOWEST]]
            left = flown[~lost[flown]]
            if not len(left):
                break
            q = states[left]
            inputs = self._best(found, q, self._at(found, q))
            middle, after = self._worst(found, q, inputs)
            within = self._at(start, middle)
            value = self._at(found, after)
            states[left] = after
            lost[left] = ~(value > 0) | ~(within > 0)
        return float(begun[lost].max(initial=0.0)), usual

    def _worst(self, found: Array, states: Array, inputs: Array) -> tuple[Array, Array]:
        """The states half a sample and a sample later, with the worst disturbance held."""
        lowest = np.full(len(states), np.inf)
        middle, after = states.copy(), states.copy()
        for error in self.errors:
            acting = inputs + np.array([[float(e) for e in error]]) if error else inputs
            for d in self.disturbances:
                moved = self._moved(states, acting, np.tile(d, (len(states), 1)))
                value = np.nan_to_num(self._at(found, moved[1]), nan=-np.inf)
                worse = value < lowest
                lowest = np.minimum(lowest, value)
                middle[worse], after[worse] = moved[0][worse], moved[1][worse]
        return middle, after

    def _at(self, table: Array, states: Array) -> Array:
        grid = self.low, self.steps, self.shape, self.turns
        return values_at(table, np.ascontiguousarray(states), grid)

    def _best(self, found: Array, states: Array, wanted: Array) -> Array:
        """The inputs that the filter finds at states for a level of W."""
        n, m, moves = self.n, self.m, self.motion.moves
        middle = (self.inputs.min(axis=0) + self.inputs.max(axis=0)) / 2
        half = np.maximum((self.inputs.max(axis=0) - self.inputs.min(axis=0)) / 2, 1e-300)
        rows = np.concatenate([np.eye(m), -np.eye(m)])
        most = np.concatenate([self.inputs.max(axis=0), -self.inputs.min(axis=0)])
        constraints = np.ascontiguousarray(np.hstack([rows, most[:, np.newaxis]])).ravel()
        room, whole = numbers_of_search(n, m, 2 * m, moves), 3 * n
        own, counts = numbers_of_programs(m, 2 * m + CUTS * moves)
        motions = np.ascontiguousarray(self.moved.values(states))
        out = np.empty((len(states), m + 1))
        called(
            "foreseen", "search_many", len(states), found,
            np.ascontiguousarray(np.tile(middle, len(states))), half, constraints,
            motions.reshape(-1), self.wide, self.inputs.ravel(), m, 2 * m, len(self.inputs),
            np.ascontiguousarray(wanted), self.cell, self.low, self.steps, self.shape, self.turns,
            n, moves, int(self.motion.curved), out.reshape(-1), np.empty(room),
            np.zeros(whole, dtype=np.int64), np.empty(own), np.zeros(counts, dtype=np.int64),
        )  # fmt: skip
        return out[:, :m]

    def _moved(self, states: Array, inputs: Array, disturbances: Array) -> tuple[Array, Array]:
        """The states half a sample later, and a sample later, by many Runge-Kutta steps."""
        held = [*self.system.inputs, *self.system.disturbances]
        rates = Evaluator(
            list(self.system.rates.values()),
            [*self.states, *(q.symbol for q in held)],
            self.system.parameters,
        )
        fixed = np.hstack([inputs, disturbances])
        f: Callable[[Array], Array] = lambda q: rates.values(np.hstack([q, fixed]))  # noqa: E731
        q, h = states, self.hold / SUBSTEPS
        middle = q
        for k in range(SUBSTEPS):
            a = f(q)
            b = f(q + h / 2 * a)
            c = f(q + h / 2 * b)
            q = q + h / 6 * (a + 2 * b + 2 * c + f(q + h * c))
            if 2 * (k + 1) == SUBSTEPS:
                middle = q
        return middle, q
