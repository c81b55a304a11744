"""The value of the sampled game over a kernel: what is kept where inputs are held.

    W(q) = min(V(q), max over u of min over d of W(the state after u and d were held))

V is the kernel's value. From a state with W >= c some held input leads to W >= c whatever a held d
does, at ridges of V too, where no input raises V at once. W is iterated on the grid; the state
after a sample is `held_motion`, and W between nodes is that of `interpolate.py`. What holds at the
nodes need not hold between them: V is cut off (`BANDS`) as far as trial runs ask for it.

With a delay D of the measurement, q is where the state is predicted to be when the input acts
(`maths/control/prediction.py`), from what was measured and the inputs since. It differs from it by
what the disturbance does in D, so that V is the least that it may be there; and what a disturbance
moves in a sample, the next measurement tells, D later: it is carried on through D.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import sympy as sp
from scipy import ndimage

from holdfast.analysis.reachability.grid import number
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray, Array, Truths
from holdfast.execution.codegen.scalar_llvm import called
from holdfast.execution.foreseen import CUTS, numbers_of_search
from holdfast.execution.leaf import Evaluator
from holdfast.execution.sampled_game import numbers_of_motion
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from holdfast.execution.table_in_parts import values_at
from holdfast.host.files import Stored, code_digest
from holdfast.maths.control.prediction import HeldMotion, held_motion, prediction
from holdfast.maths.definitions.bounds import Bounds
from holdfast.maths.definitions.law import Lookup, SampledLookup
from holdfast.maths.definitions.system import System

Points = tuple[tuple[sp.Expr, ...], ...]

ENDS = {"extrapolated": 0, "contained": 0, "periodic": 1, "limited": 2}
MOST_READ = 1 << 25
"""Values that are read from a file, in which they would stay; `load` leaves no fewer there."""
MOST_SWEEPS = 3000
PATIENCE = 5.0
"""Seconds that each of the games that are tried may take by default, about; those that take longer
end the search together, as often as `GAMES` says."""
LOOKS = 4e7
"""Corners of cells, for every disturbance, that are looked up in a second, with the nodes that are
to be looked at again. What a game may take is counted in these, so that it is the same anywhere."""
FEWEST_SWEEPS = 25.0
"""A set is tried whose nodes have so many times fewer corners than may be looked up."""
GAMES = 3
AT_ONCE = 1 << 16
"""Nodes from one look at that to the next."""
TOGETHER = 1 << 25
"""Numbers of the motions that are held in memory; beyond it they are computed anew."""
BANDS = (
    (1e9, 2.0, 0), (3.0, 2.0, 0), (1.5, 2.0, 0), (1.5, 6.0, 0), (1.5, 20.0, 0), (1.5, 20.0, 1),
)  # fmt: skip
"""Cells above the level beyond which W is cut off, cells below it where a state is lost, and
whether the outermost nodes of what is kept are left out. Where W is cut off it is steep, and what
interpolation loses between nodes is won back within a cell. The narrower the band, and the deeper
what is lost, the less is lost, and the less is kept. An edge that drives states away from itself,
where V jumps, has to be left by a node."""
LEVELS = (0.1, 0.3, 0.6, 1.0)  # cells above the level: the margins that are tried
FIRST_LEVELS = 2  # how many of them before the next band
FALLEN = 0.5  # of a margin, below which no trial run may fall
DRIFT = 0.02  # cells by which the second halves of runs may be lower than the first ones
FLOWN, FEWEST, MOST, LONGEST = 120_000, 60, 300, 3000
"""Samples of all trial runs together, the fewest and most runs, and the most samples of one."""
CROSSINGS = 4.0  # of the grid, that a run may take at least at the highest speed
HELD = 0.75  # the share of a set from which on a longer hold of the game is not tried
FAR = 1.5  # cells that a state moves at most within that longer hold
FARTHEST = 1e3  # cells below what is lost, at most
LITTLE = 1e-5  # cells by which a value has to fall to count
KEPT = 0.75  # the share of a set that has not converged below which the game is of no use to it
LEAN = 1e-3  # of V that W has beside it, where no law says what is wanted
NONE = b"no game"  # in the cache, where none was found
SUBSTEPS = 8
INPUTS = {1: 9, 2: 5, 3: 3}


@dataclass(frozen=True)
class SampledValue:
    """W at the nodes, and what a filter over it needs.

    points: of the inputs; moves: of the disturbances; errors: of the inputs that act. above: the
    set to keep is {V > above}. least: the level of W from which no trial run was lost, or a cell
    above `above` where every game lost one, which `stays` says. beyond: the usual change of V over
    a cell.
    """

    table: AnyArray
    points: Points
    moves: Points
    errors: Points
    above: float
    least: float
    beyond: float
    stays: bool = True

    def possible_margin(self, sample_time: float, delay: float) -> float:
        """`least`; `SimulationError` where no state has it."""
        deepest = float(self.table.max())
        if self.least < deepest:
            return self.least
        behind = f" and a delay of {delay:g} s" if delay else ""
        raise SimulationError(
            f"V may fall by {self.least:.3g} before an input answers, held for {sample_time:g} s"
            f"{behind}, and what held inputs keep is nowhere above {max(deepest, 0.0):.3g}",
            remedy="take a shorter sample time or delay, a finer grid, or give a margin",
        )

    def share(self, value: ValueFunction) -> float:
        """The share of the nodes of {V > above} that held inputs keep in it."""
        inside = (value.values() > self.above).sum()
        return float((self.table > self.above).sum() / max(inside, 1))

    def leaning(self, value: ValueFunction) -> SampledValue:
        """W - `LEAN` (max V - V): where W is cut off, it has the slope of V."""
        v = value.in_memory().values().reshape(self.table.shape)
        low = LEAN * (np.nanmax(v) - np.where(np.isnan(v), np.nanmin(v), v))
        return replace(self, table=(self.table - low).astype(self.table.dtype))

    def lookup(self, of: Lookup, sample_time: float) -> SampledLookup:
        """The table of a law, on the grid of the kernel's own."""
        return on_its_grid(self.table, of, sample_time, unit=of.unit)


def on_its_grid(
    table: AnyArray, of: Lookup, sample_time: float, unit: str, sloped: bool = False
) -> SampledLookup:
    """A table of a law whose inputs are held, shape (nodes,), on the grid of another."""
    numbers = (table, *of.table[1:])  # type: ignore[index]
    return SampledLookup(of.places, numbers, unit=unit, hold=sample_time, sloped=sloped)


def points_of(bounds: Bounds, dimension: int) -> Points:
    """Points of the bounds of inputs, their ends among them; the middle first."""
    count = INPUTS.get(dimension, 2)
    return tuple(map(tuple, bounds.inscribed_points(count)))


def moves_of(bounds: Bounds | None, dimension: int) -> Points:
    """Points of the bounds of disturbances: their ends, and where they are few between them."""
    if bounds is None or dimension == 0:
        return ((),)
    return tuple(map(tuple, bounds.points(3 if dimension < 3 else 2)))


def patience_of(ahead: bool | float) -> float:
    """The seconds that a game may take, about; `SimulationError` for what is no such number."""
    if isinstance(ahead, bool | np.bool_):
        return PATIENCE if ahead else 0.0
    return number("ahead is ", ahead, "seconds, 0 or more", lambda v: 0 <= v < math.inf)


def sampled_value(
    system: System,
    value: ValueFunction,
    sample_time: float,
    errors: Sequence[float] = (),
    above: float = 0.0,
    late: float = 0.0,
    patience: float = PATIENCE,
    delay: float = 0.0,
) -> SampledValue | None:
    """The value of the game whose inputs are held for `sample_time` [s].

    What it comes to is kept beside the value, and a game also in the cache, for those who load the
    same value.
    system: with the prescribed disturbances of the value, and its parameters. errors: by how much
    each input that acts may differ from the one that is held. above: the set to keep is {V > above}
    [unit of V]. late: by how much V may fall before the input answers. patience: seconds that
    each game that is tried may take, about. delay: of a law that sees the state so late [s], the
    game of what it predicts. None where it would take longer, the values stay in a file, or are not
    those of all inputs; and of a set that has not converged where it keeps less than `KEPT` of it.
    """
    if value.stored is not None and value.grid.nodes > MOST_READ:
        return None
    if not system.inputs or system.input_bounds is None or system.samples:
        return None
    bounds = str(system.input_bounds), str(system.disturbance_bounds)
    numbers = tuple((q.name, q.value) for q in system.parameters)
    hold, level, fall, seconds, age = map(float, (sample_time, above, late, patience, delay))
    asked = tuple(map(float, errors)), hold, level, fall, seconds, age
    key = asked, bounds, tuple(map(sp.srepr, system.rates.values())), numbers
    if key not in value.games:
        value.games[key] = _Game(system, value, *asked).solved_once(key)
    game: SampledValue | None = value.games[key]
    if game is None or value.report.converged or game.share(value) >= KEPT:
        return game
    return None


class _Game:
    def __init__(
        self, system: System, value: ValueFunction, errors: tuple[float, ...], sample_time: float,
        above: float, late: float, patience: float, delay: float,
    ) -> None:  # fmt: skip
        assert system.input_bounds is not None
        self.most_looks = LOOKS * patience
        self.system, self.value, self.hold, self.above = system, value, sample_time, above
        self.late, self.delay, self.looks = late, delay, 0.0
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
        self.acting = as_floats(self.errors)
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
        self.corners = 2.0**n * len(self.moves) * len(self.errors)
        held = [*system.inputs, *system.disturbances]
        self.rates = Evaluator(
            list(system.rates.values()),
            [*self.states, *(q.symbol for q in held)],
            system.parameters,
        )

    def solved_once(self, key: object) -> SampledValue | None:
        """As `solved`, or as solved before: of the same values, by the same code.

        key: what else the game follows from.
        """
        values = np.ascontiguousarray(self.value.in_memory().values())
        inside = np.count_nonzero(values > self.above)
        if not 0 < FEWEST_SWEEPS * inside * self.corners <= self.most_looks:
            return None
        axes = [(a.name, a.low, a.high, a.count, a.ends) for a in self.value.grid.axes]
        names = self.system.state_names, self.system.input_names, self.system.disturbance_names
        content = hashlib.sha256(values.data).hexdigest(), str(values.dtype), axes, self.cell, names
        stored, about = Stored("game", code_digest()), (content, str(key))
        if data := stored.load(about):
            if data == NONE:
                return None
            with np.load(io.BytesIO(data)) as arrays:
                least, stays = float(arrays["least"]), bool(arrays["stays"])
                return self._with(arrays["table"], least, stays)
        game = self.solved()
        if game is None:
            stored.save(about, NONE)
        else:
            file = io.BytesIO()
            np.savez_compressed(file, table=game.table, least=game.least, stays=game.stays)
            stored.save(about, file.getvalue())
        return game

    def solved(self) -> SampledValue | None:
        """The first of the games and `LEVELS` of which no trial run is lost, or the last.

        Where interpolation loses more than a short sample moves, a game of a longer hold keeps
        more. What is tried is always the hold of the filter.
        """
        table = self.value.in_memory().values()
        values = np.ascontiguousarray(table, dtype=np.float64).ravel() - self.above
        values = np.where(np.isnan(values), -FARTHEST * self.cell, values)
        self.undisturbed = values
        if self.delay:
            values = self._wherever(values)
        held = _Motions(self, self.hold, self.delay)
        cells = max(float(held.reach.max()), 1e-9)
        last: Array | None = None
        longest = max(self.hold, self.hold * FAR / cells)
        for hold in dict.fromkeys((self.hold, longest)):
            motions = held if hold == self.hold else _Motions(self, hold, self.delay)
            fewest = HELD * np.count_nonzero(values > 0) if hold < longest else 0.0
            games: list[Array] = []
            for game in self._games(motions, values, fewest):
                games.append(game)
                if last is None or game.max() > LEVELS[-1] * self.cell:
                    last = game
                for level in LEVELS[:FIRST_LEVELS]:
                    if self._stays(game, values, level * self.cell, held, cells):
                        return self._of(game, level, table.dtype)
            for level, game in itertools.product(LEVELS[FIRST_LEVELS:], games):
                if self._stays(game, values, level * self.cell, held, cells):
                    return self._of(game, level, table.dtype)
        return None if last is None else self._of(last, LEVELS[-1], table.dtype, stays=False)

    def _wherever(self, values: Array) -> Array:
        """The least value at which a state may be that is predicted to be at a node."""
        motions, least = _Motions(self, self.delay), values.copy()
        for part in motions.parts:
            nodes, moves = motions.nodes(part), motions.moved(motions.of_nodes(part))
            for r in range(motions.moves):
                there = np.nan_to_num(self._at(values, nodes + moves[:, r]), nan=-np.inf)
                there = np.maximum(there, -FARTHEST * self.cell)
                np.minimum(least[part.start : part.stop], there, out=least[part.start : part.stop])
        return least

    def _of(
        self, game: Array, level: float, dtype: npt.DTypeLike, stays: bool = True
    ) -> SampledValue:
        """`game`, above the level of the set, in a precision in which it is no larger."""
        table = (game + self.above).astype(dtype)
        over = table > game + self.above
        table[over] = np.nextafter(table[over], -np.inf, dtype=dtype)
        return self._with(table, self.above + level * self.cell, stays)

    def _with(self, table: AnyArray, least: float, stays: bool) -> SampledValue:
        return SampledValue(
            table, self.points, self.moves, self.errors, self.above, least, self.cell, stays
        )

    def _games(self, motions: _Motions, values: Array, fewest: float) -> Iterator[Array]:
        """W above its level for each of `BANDS`, each begun with the last; as far as they keep
        enough and do not take too long."""
        upper = values
        for band, (top, bottom, worn) in enumerate(BANDS):
            lost, most = -bottom * self.cell, top * self.cell + self.late
            game = np.clip(self._worn(upper) if worn else upper, lost, most)
            if not self._iterate(game, lost, motions, fewest):
                if band == 0:
                    continue  # those that are cut off rest sooner
                return
            yield self._outside(game, values, lost)
            if self.looks >= GAMES * self.most_looks:
                return
            upper = np.where(game <= lost, values, game)

    def _outside(self, game: Array, values: Array, lost: float) -> Array:
        """W that falls as V does, from a cell outside of what is kept on."""
        near = self._around(ndimage.maximum_filter, game > lost)
        return np.where(near, game, np.clip(values, lost - FARTHEST * self.cell, game))

    def _worn(self, values: Array) -> Array:
        """Values without the nodes beside those that are at most 0."""
        inner = self._around(ndimage.minimum_filter, values > 0)
        return np.where((values > 0) & ~inner, -FARTHEST * self.cell, values)

    def _around(self, of: Callable[..., AnyArray], nodes: Truths) -> AnyArray:
        """The most or the least over each node and the nodes around it."""
        modes = ["wrap" if turns else "nearest" for turns in self.turns]
        return of(nodes.reshape(tuple(self.shape)), size=3, mode=modes).ravel()

    def _iterate(self, table: Array, lost: float, motions: _Motions, fewest: float) -> bool:
        """Lower the values until none falls, or for `MOST_SWEEPS`; False where it leaves too few,
        or takes too long."""
        count, parts = len(table), motions.parts
        flags, chosen = np.ones(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        points = self.inputs.ravel()
        room, whole = np.empty(8 * self.n), np.zeros(4 * self.n + 1, dtype=np.int64)
        reach = np.clip(np.ceil(motions.reach), 1, np.maximum((self.shape - 1) // 2, 1))
        reach = reach.astype(np.int64)
        around = float(np.prod(2.0 * reach + 1.0))  # nodes that one which falls has looked at again
        looks, begun = 0.0, np.count_nonzero(table > 0)
        for sweep in range(MOST_SWEEPS):
            fallen, back = 0, sweep % 2
            for part in reversed(parts) if back else parts:
                if not flags[part.start : part.stop].any():
                    continue
                numbers = motions.of_nodes(part)
                for k in range(0, len(part), AT_ONCE)[:: -1 if back else 1]:
                    some = part[k : k + AT_ONCE]
                    whole[-1] = 0
                    fell = called(
                        "sampled_game", "sweep_game", table, flags, chosen,
                        numbers[k : k + AT_ONCE].reshape(-1), some.start, len(some), back, points,
                        len(self.inputs), motions.wide, self.low,
                        self.steps, self.shape, self.ends, reach, self.n, self.m, motions.moves,
                        int(motions.curved), lost, LITTLE * self.cell, room, whole,
                    )  # fmt: skip
                    fallen += fell
                    looks += float(whole[-1]) * self.corners + fell * 2.0 * around
                    if looks > self.most_looks:
                        self.looks += looks
                        left = np.count_nonzero(table > 0)
                        return sweep > 0 and fewest == 0 and bool(left >= HELD * begun)
            if not fallen:
                break
            left = np.count_nonzero(table > 0) if sweep % 20 == 0 else begun
            if left < fewest:
                return False
        return bool(np.count_nonzero(table > 0) >= fewest)

    # -- trial runs ------------------------------------------------------------------------

    def _stays(
        self, table: Array, values: Array, level: float, held: _Motions, cells: float
    ) -> bool:
        """Whether no trial run from right above a level falls below `FALLEN` of it, or goes on
        falling.

        The states are between nodes; the wanted inputs are those that the bounds allow at most and
        least, and the middle; the disturbance is the one that is worst for the next sample.
        """
        samples = int(min(max(300.0, CROSSINGS * self.shape.max() / max(cells, 1e-9)), LONGEST))
        runs = int(min(max(FLOWN / samples, FEWEST), MOST))
        generator = np.random.default_rng(0)
        states = self._between_nodes(table, level, runs, generator)
        if not len(states):
            return False
        ends = np.stack([self.inputs.min(axis=0), self.inputs.max(axis=0)])
        wanted = np.stack([*ends, ends.mean(axis=0)])[generator.integers(0, 3, len(states))]
        lowest = np.full((2, len(states)), np.inf)
        if self.delay:
            heights = self._flown_late(table, states, wanted, level, held, generator)
        else:
            heights = self._flown(table, values, states, wanted, level, held)
        for sample, least in enumerate(itertools.islice(heights, samples)):
            if not np.all(least > FALLEN * level):
                return False
            half = lowest[2 * sample // samples]
            np.minimum(half, least, out=half)
        first, second = lowest.mean(axis=1)
        return bool(second > first - DRIFT * self.cell)

    def _flown(
        self, table: Array, values: Array, states: Array, wanted: Array, level: float,
        held: _Motions,
    ) -> Iterator[Array]:  # fmt: skip
        """The least height of each run, sample by sample: of W, and of the values half a sample
        before."""
        while True:
            inputs = self._filtered(table, states, wanted, level, held)
            middle, states = self._worst(table, states, inputs)
            yield np.minimum(self._at(values, middle), self._at(table, states))

    def _flown_late(
        self, table: Array, states: Array, wanted: Array, level: float, held: _Motions,
        generator: np.random.Generator,
    ) -> Iterator[Array]:  # fmt: skip
        """The same where measurements are late: of V at the state itself, which is flown with the
        inputs that were sent and disturbances that also change within a delay, and of W at what is
        predicted.

        A third of the disturbances are worst for what is predicted next, a third stay, and the
        others are drawn at every sample.
        """
        count, kind = len(states), np.arange(len(states)) % 3
        predicted = prediction(self.system, self.hold, self.delay)
        assert predicted is not None
        names = [q.symbol for q in predicted.memory.quantities]
        places = Evaluator(
            list(predicted.places.values()), [*self.states, *names], self.system.parameters
        )
        spans = len(names) // (1 + self.m)
        behind = spans * self.hold - self.delay  # from a sample to the measurement after it
        between = behind > 1e-9 * self.hold
        memory = np.zeros((count, len(names)))
        measured = [states] * (spans + 1)
        drawn = generator.integers(0, len(self.disturbances), count)
        while True:
            last = measured[-spans if between else -1 - spans]
            seen = places.values(np.hstack([last, memory]))
            inputs = self._filtered(table, seen, wanted, level, held)
            worst = self._disturbed(table, states, inputs)[2] % len(self.disturbances)
            each = generator.integers(0, len(self.disturbances), count)
            error = self.acting[generator.integers(0, len(self.acting), count)]
            acting = inputs + error if error.size else inputs
            acting = np.hstack([acting, self.disturbances[np.choose(kind, [worst, drawn, each])]])
            if between:
                measured.append(self._moved(states, acting, behind)[1])
            middle, states = self._moved(states, acting, self.hold)
            if not between:
                measured.append(states)
            since = np.hstack([np.full((count, 1), self.hold), memory[:, : spans - 1]])
            since[:, -1] = np.minimum(since[:, -1], self.hold - behind)
            memory = np.hstack([since, inputs, memory[:, spans : len(names) - self.m]])
            height = np.minimum(*(self._at(self.undisturbed, q) for q in (middle, states)))
            yield np.minimum(height, self._at(table, seen))

    def _between_nodes(
        self, table: Array, level: float, count: int, generator: np.random.Generator
    ) -> Array:
        """States from which W is above the level by at most a tenth of a cell, or some."""
        near = np.flatnonzero((table > level - self.cell) & (table < level + self.cell))
        if not len(near):
            near = np.flatnonzero(table > level)
        if not len(near):
            return np.empty((0, self.n))
        places = np.unravel_index(generator.choice(near, 50 * count), tuple(self.shape))
        nodes = np.stack(places, axis=1)
        states = self.low + (nodes + generator.uniform(-1, 1, nodes.shape)) * self.steps
        height = self._at(table, states) - level
        states, height = states[height > 0], height[height > 0]
        return states[np.argsort(height)[: 2 * count]][::2]

    def _worst(self, table: Array, states: Array, inputs: Array) -> tuple[Array, Array]:
        """The states half a sample and a sample later, with the worst disturbance held."""
        middle, after, worst = self._disturbed(table, states, inputs)
        there = worst, np.arange(len(states))
        return middle[there], after[there]

    def _disturbed(
        self, table: Array, states: Array, inputs: Array
    ) -> tuple[Array, Array, npt.NDArray[np.intp]]:
        """The states half a sample and a sample later with each error and disturbance, and which
        of these is worst."""
        acts = [
            np.hstack([inputs + e if len(e) else inputs, np.tile(d, (len(states), 1))])
            for e in self.acting
            for d in self.disturbances
        ]
        middle, after = self._moved(
            np.tile(states, (len(acts), 1)), np.concatenate(acts), self.hold
        )
        height = np.nan_to_num(self._at(table, after), nan=-np.inf).reshape(len(acts), -1)
        shape = len(acts), len(states), self.n
        return middle.reshape(shape), after.reshape(shape), height.argmin(axis=0)

    def _at(self, table: Array, states: Array) -> Array:
        grid = self.low, self.steps, self.shape, self.turns
        top = self.low + self.steps * (self.shape - 1)
        limited = np.where(self.ends == ENDS["limited"], np.clip(states, self.low, top), states)
        return values_at(table, np.ascontiguousarray(limited), grid)

    def _filtered(
        self, table: Array, states: Array, wanted: Array, level: float, held: _Motions
    ) -> Array:
        """The inputs that the filter finds at states for a level of W."""
        n, m, moves = self.n, self.m, held.moves
        half = np.maximum((self.inputs.max(axis=0) - self.inputs.min(axis=0)) / 2, 1e-300)
        rows = np.concatenate([np.eye(m), -np.eye(m)])
        most = np.concatenate([self.inputs.max(axis=0), -self.inputs.min(axis=0)])
        constraints = np.ascontiguousarray(np.hstack([rows, most[:, np.newaxis]])).ravel()
        room, whole = numbers_of_search(n, m, 2 * m, moves), 3 * n
        floats, counts = numbers_of_programs(m, 2 * m + CUTS * moves)
        out = np.empty((len(states), m + 1))
        called(
            "foreseen", "search_many", len(states), table, np.ascontiguousarray(wanted).reshape(-1),
            half, constraints, held.at(states).reshape(-1), held.wide, self.inputs.ravel(), m,
            2 * m, len(self.inputs), np.full(len(states), level), self.cell, self.low, self.steps,
            self.shape, self.turns, n, moves, int(held.curved), out.reshape(-1), np.empty(room),
            np.zeros(whole, dtype=np.int64), np.empty(floats), np.zeros(counts, dtype=np.int64),
        )  # fmt: skip
        return out[:, :m]

    def _moved(self, states: Array, held: Array, hold: float) -> tuple[Array, Array]:
        """The states half a hold later, and a hold later, by some Runge-Kutta steps."""
        f: Callable[[Array], Array] = lambda q: self.rates.values(np.hstack([q, held]))  # noqa: E731
        q, h = states, hold / SUBSTEPS
        middle = q
        for k in range(SUBSTEPS):
            a = f(q)
            b = f(q + h / 2 * a)
            c = f(q + h / 2 * b)
            q = q + h / 6 * (a + 2 * b + 2 * c + f(q + h * c))
            if 2 * (k + 1) == SUBSTEPS:
                middle = q
        return middle, q


class _Motions:
    """The numbers of the motion over a hold, at states.

    parts: the nodes, as many together as the memory is to hold. reach: the cells along each axis
    by which a sample moves the state, at most.
    """

    def __init__(self, game: _Game, hold: float, delay: float = 0.0) -> None:
        motion: HeldMotion = held_motion(
            game.system, sp.Float(hold), game.moves, game.errors, delay
        )
        self.expressions = Evaluator(motion.expressions, game.states, game.system.parameters)
        self.moves, self.curved = motion.moves, motion.curved
        self.wide = numbers_of_motion(game.n, game.m, motion.moves, motion.curved)
        self._game, count = game, game.value.grid.nodes
        layer = math.prod(game.shape[1:].tolist())
        together = max(layer, TOGETHER // self.wide // layer * layer)
        self.parts = [range(k, min(k + together, count)) for k in range(0, count, together)]
        self._of_all = self._of(self.parts[0]) if len(self.parts) == 1 else None
        self.reach: Array = np.max([self._reach(p) for p in self.parts], axis=0)

    def at(self, states: Array) -> Array:
        numbers = self.expressions.values(states)
        return np.ascontiguousarray(np.where(np.isfinite(numbers), numbers, 1e300))

    def of_nodes(self, part: range) -> Array:
        """At the nodes of one of `parts`."""
        return self._of(part) if self._of_all is None else self._of_all

    def _of(self, part: range) -> Array:
        return self.at(self.nodes(part))

    def moved(self, numbers: Array) -> Array:
        """By how much each disturbance moves the states."""
        n = self._game.n
        return numbers[:, self.wide - self.moves * n :].reshape(len(numbers), self.moves, n)

    def nodes(self, part: range) -> Array:
        places = np.unravel_index(np.arange(part.start, part.stop), tuple(self._game.shape))
        axes = self._game.value.grid.axes
        return np.stack([a.nodes[k] for a, k in zip(axes, places, strict=True)], axis=1)

    def _reach(self, part: range) -> Array:
        n, m, numbers = self._game.n, self._game.m, self.of_nodes(part)
        largest = np.abs(self._game.inputs).max(axis=0)
        base = np.abs(numbers[:, :n] - self.nodes(part))
        gains = np.abs(numbers[:, n : n + n * m].reshape(len(numbers), n, m)) @ largest
        pairs = m * (m + 1) // 2 * int(self.curved)
        behind = n * (1 + m)
        curves = np.abs(numbers[:, behind : behind + n * pairs].reshape(len(numbers), n, pairs))
        bent = curves.sum(axis=2) * (largest.max() ** 2 if m else 0.0)
        far = (base + gains + bent + np.abs(self.moved(numbers)).max(axis=1)) / self._game.steps
        most: Array = np.where(far < 1e6, far, 0.0).max(axis=0)
        return most
