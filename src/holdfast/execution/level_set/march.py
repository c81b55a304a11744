"""A value on a grid marched in time, in parallel, skipping what is settled.

    dW/dtau = H(tau, q, grad W),   limited to one sign where the problem says so,
    and after every stage   lower <= W <= upper,   floor <= W <= ceiling

A stretch of nodes is computed again only if something that it depends on has changed since. Where
nothing has, the same numbers would come out, so the answer is that of the full march. Where the
Hamiltonian or a bound depends on time t, of a clock that runs with tau or against it, all is
computed, with steps that are stable at every stage.

Its steps are Runge-Kutta methods that are convex combinations of Euler steps. With a step dt and
the rate R of the value, a stage of the share h of the step is

    W <- W_0 + weight ((W - W_0) + h dt R(W)),    W_0 the value that the step begins with

so that what an Euler step of length h dt keeps, such as the order of two values, the whole step
keeps. Of the methods of an order with few stages these have the longest steps for their stages
(J. F. B. M. Kraaijevanger, BIT 31, 1991; D. I. Ketcheson, SIAM J. Sci. Comput. 30, 2008).

Expressions have values at every node of the grid, and largest speeds.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.arrays import Array as Doubles
from holdfast.execution.codegen.lowering import leaf_of
from holdfast.execution.device.program import Device
from holdfast.execution.leaf import Leaves, compiled_leaves, padded
from holdfast.execution.level_set.device_sweeping import DeviceSweeping, device_layout
from holdfast.execution.level_set.fold import Fold
from holdfast.execution.level_set.schemes import Scheme, schemes
from holdfast.execution.level_set.stage_leaf import Stage, rate_leaves
from holdfast.execution.level_set.sweeping import (
    ANYWHERE,
    Bounds,
    StageOrder,
    Stages,
    Streaming,
    Sweeping,
    Within,
    layout,
    sweep_code,
)
from holdfast.execution.resources import Room
from holdfast.maths.definitions.quantity import TIME, Parameter
from holdfast.maths.expressions.traversal import symbols_of
from holdfast.maths.games.hamiltonian import Hamiltonian

TOGETHER = 1 << 14
"""Nodes that are computed at a time, if a row of the last axis is not longer."""

ALL = slice(None)


class AtTime(Protocol):
    """An expression at the nodes of a grid."""

    def __call__(self, time: float, of: slice = ALL) -> npt.NDArray[Any]:
        """At a time, at all nodes or at some that follow one another, shape (nodes,)."""


class OverGrid:
    """Expressions of states, parameters and time on a grid; `symbols` are those of the axes, whose
    nodes are `axes`, each of shape (nodes of the axis,)."""

    def __init__(
        self,
        expressions: Sequence[sp.Expr],
        symbols: Sequence[sp.Symbol],
        parameters: Sequence[Parameter],
        axes: Sequence[Doubles],
    ) -> None:
        same = (TIME, *(q.symbol for q in parameters))
        self._leaves = _leaves_of(tuple(expressions), tuple(symbols), same)
        self._u = np.array([0.0, *(float(q.value) for q in parameters)])
        self._count = len(expressions)
        inner = len(axes) - 1
        while inner > 0 and math.prod(len(a) for a in axes[inner - 1 :]) <= TOGETHER:
            inner -= 1
        self._outer = axes[:inner]
        # Inner axes stand in w once for all parts; of the outer ones a part has one place each.
        within = np.meshgrid(*axes[inner:], indexing="ij")
        self._nodes = within[0].size
        self._w = np.zeros((len(axes), padded(self._nodes)))
        for row, values in zip(self._w[inner:], within, strict=True):
            # A leaf computes whole registers: what stands behind the nodes repeats the last.
            row[: self._nodes], row[self._nodes :] = values.ravel(), values.ravel()[-1]
        self.size = self._nodes * math.prod(len(a) for a in self._outer)

    def parts(self, time: float, of: slice = ALL) -> Iterator[tuple[slice, Doubles]]:
        """Nodes that follow one another, of the grid or of some of its nodes, and the expressions
        at these, shape (expressions, nodes); they are overwritten with the next."""
        u, out = self._u.copy(), np.empty((self._count, self._w.shape[1]))
        u[0] = time
        first, last, _ = of.indices(self.size)
        parts = range(first // self._nodes, -(-last // self._nodes))
        places = itertools.islice(itertools.product(*self._outer), parts.start, parts.stop)
        for k, place in zip(parts, places, strict=True):
            self._w[: len(place)] = np.array(place)[:, np.newaxis]
            self._leaves.call("values", self._w, u, out)
            begin = k * self._nodes
            low, high = max(first, begin), min(last, begin + self._nodes)
            yield slice(low, high), out[:, low - begin : high - begin]


@lru_cache(maxsize=64)
def _leaves_of(
    expressions: tuple[sp.Expr, ...], symbols: tuple[sp.Symbol, ...], same: tuple[sp.Symbol, ...]
) -> Leaves:
    """The same margin is wanted at all nodes, beyond every end, and by both marches of a kernel."""
    leaf = leaf_of({"w": symbols, "u": same}, expressions, uniform=("u",))
    return compiled_leaves({"values": leaf})


def over_grid(
    expression: sp.Expr,
    symbols: Sequence[sp.Symbol],
    parameters: Sequence[Parameter],
    axes: Sequence[npt.NDArray[np.float64]],
    *,
    band: float = math.inf,
    precision: str = "float64",
    room: Callable[[int], npt.NDArray[Any]] | None = None,
) -> AtTime:
    """At a time: the expression at every node, or at some, shape (nodes,), cut off at +-band.

    `symbols` are those of the axes; axes: each (nodes of the axis,). room: of a count of nodes an
    array (nodes,).
    """
    values = OverGrid([expression], symbols, parameters, axes)

    def at(time: float, of: slice = ALL) -> npt.NDArray[Any]:
        first, last, _ = of.indices(values.size)
        out = (
            room(values.size)
            if room is not None and of is ALL
            else np.empty(last - first, dtype=precision)
        )
        for nodes, (part,) in values.parts(time, of):
            to = out[nodes.start - first : nodes.stop - first]
            np.clip(part, -band, band, out=to, casting="same_kind")
        return out

    return at


class Fastest:
    """The largest speed along every axis, and the largest sum of them over the steps.

    A speed that is NaN at a node is NaN over the grid. axes: each (nodes of the axis,); steps:
    (axes,).
    """

    def __init__(
        self,
        speeds: Sequence[sp.Expr],
        symbols: Sequence[sp.Symbol],
        parameters: Sequence[Parameter],
        axes: Sequence[Doubles],
        steps: Doubles,
    ) -> None:
        matters = symbols_of(speeds)
        some = [a if s in matters else a[:1] for s, a in zip(symbols, axes, strict=True)]
        self._values, self._steps = OverGrid(speeds, symbols, parameters, some), steps

    def at(self, times: Sequence[float]) -> tuple[Doubles, float]:
        """Over these times; the largest speeds have the shape (axes,)."""
        largest, total = np.zeros(len(self._steps)), 0.0
        for instant in times:
            for _, part in self._values.parts(instant):
                largest = np.maximum(largest, part.max(axis=1))
                total = max(total, float((part / self._steps[:, np.newaxis]).sum(axis=0).max()))
        return largest, total


def padded_rows(axes: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """The nodes of every axis as the rows of one array, shape (axes, nodes of the longest).

    A sweep takes one address for all axes, and the length of a row.
    """
    rows = np.zeros((len(axes), max(len(a) for a in axes)))
    for row, axis in zip(rows, axes, strict=True):
        row[: len(axis)] = axis
    return rows


LIMITS = {"free": (-math.inf, math.inf), "shrink": (-math.inf, 0.0), "grow": (0.0, math.inf)}
"""The limits of dW/dt: none, never above zero, never below."""

Numbers = npt.NDArray[np.int64]


class MarchLeaves:
    """The leaves of a Hamiltonian with a scheme.

    limit: a name in `LIMITS`; one_stage: whether a step has one; filtered: whether the rate is held
    close to that of a monotone step (`stage_leaf.py`).
    """

    def __init__(
        self,
        hamiltonian: Hamiltonian,
        parameters: Sequence[Parameter],
        scheme: Scheme,
        *,
        dissipation: str,
        limit: str,
        one_stage: bool,
        precision: str,
        filtered: bool,
    ) -> None:
        self._rates = rate_leaves(
            hamiltonian,
            parameters,
            dissipation=dissipation,
            filtered=filtered,
            one_slope=scheme.one_slope,
            precision=precision,
        )
        self._scheme, self._limit, self._one_stage = scheme, limit, one_stage
        self._precision, self._filtered = precision, filtered
        self._axes = len(hamiltonian.costates)

    @property
    def of_row(self) -> int:
        """How many numbers depend on a row of the last axis, or on outer axes."""
        return self._rates.of_row + self._rates.outer

    def stage(self, *, lower: bool, upper: bool) -> Stage:
        """The arithmetic of a stage; lower, upper: whether there are such bounds at nodes."""
        return Stage(
            self._rates,
            axes=self._axes,
            one_slope=self._scheme.one_slope,
            filtered=self._filtered,
            limits=LIMITS[self._limit],
            side=1.0 if self._limit == "shrink" else -1.0,
            from_start=self._one_stage,
            lower=lower,
            upper=upper,
        )

    def found(self, *, lower: bool, upper: bool) -> tuple[Numbers, Numbers, Numbers]:
        """The addresses of leaves, with a stage and one that measures, shape (4,); the sizes of a
        sweep, shape (6,)."""
        stage, scheme = self.stage(lower=lower, upper=upper), self._scheme
        of_scheme = {}
        if not scheme.one_slope:
            of_scheme["scheme"] = scheme.leaf(self._precision, plain=stage.filtered)
        self._leaves = compiled_leaves({**self._rates.leaves, **of_scheme})  # they hold the code
        self._stage = compiled_leaves(stage.leaves())
        of = {**self._leaves.addresses, **self._stage.addresses}
        plain, measured = (  # in the order in which `sweep.py` reads them, as the sizes are
            np.array([of["along"], of["rows"], of[name], of.get("scheme", 0)])
            for name in ("stage", "measured")
        )
        rates = self._rates
        of_nodes = [rates.along, rates.of_row, rates.outer]
        sizes = [*of_nodes, scheme.ghosts, stage.lanes, int(stage.filtered)]
        return plain, measured, np.array(sizes)


EIGHTHS = 8
"""Parts of a doubling of the steps for which the largest speed is kept."""

LEAST_DECAY = 0.25
"""The speed of what slows down falls at least as t to the power of minus this."""


@dataclass
class Done:
    """time [s], steps; speeds: how fast the set moved [cells/s], at most, in each eighth of a
    doubling of the steps; last: when that was looked at last; still_since: the step since
    which it is still, 0 where it is not; fixed: whether no node changed in the last step;
    measured: whether it was looked how fast the set moved in it;
    computed: stretches of nodes computed, of how many a full march would
    have; marched: nodes of all grids, where there are several; seconds: of wall time."""

    time: float = 0.0
    steps: int = 0
    speeds: list[float] = field(default_factory=list)
    last: float = math.inf
    still_since: int = 0
    computed: int = 0
    of: int = 0
    marched: float = 0.0
    seconds: float = 0.0
    stopped: bool = False
    converged: bool = False
    fixed: bool = False
    measured: bool = False

    def moved(self, speed: float) -> None:
        """Take down how fast the set moved in the last step."""
        self.last = speed
        place = int(EIGHTHS * math.log2(self.steps))
        self.speeds += [0.0] * (place + 1 - len(self.speeds))
        self.speeds[place] = max(self.speeds[place], speed)

    @property
    def speed(self) -> float:
        """The recent speed of the set [cells/s], over an eighth of a doubling or more."""
        return max(self.speeds[-2:], default=math.inf)

    @property
    def slows(self) -> bool:
        """Whether the set moves slower than it did a doubling, half and a quarter of one ago.

        A drift that is small beside all speeds goes on for ever at the same speed, while what
        comes to rest, or is worn off by the scheme, slows down.
        """
        now = self.speed
        for back in (EIGHTHS, EIGHTHS // 2, EIGHTHS // 4):
            then = max(self.speeds[:-back][-2:], default=0.0)
            if now > then * 2.0 ** (-LEAST_DECAY * back / EIGHTHS):
                return False
        return True

    def settled(self, still: bool) -> bool:
        """Whether the march has been still for a quarter of a doubling of the steps, until now.

        To be called after every step that is measured.
        """
        if not still:
            self.still_since = 0
        elif not self.still_since:
            self.still_since = self.steps
        return still and self.steps >= 2.0 ** (2 / EIGHTHS) * self.still_since


@dataclass(frozen=True)
class RungeKutta:
    """stages: of each the weight, and the share of the step at which its rate is taken; lengths:
    how many times an Euler step a step is as long."""

    stages: tuple[tuple[float, float], ...]
    lengths: int

    @property
    def share(self) -> float:
        """Of the step, that of a stage."""
        return 1.0 / self.lengths


def second_order(stages: int) -> RungeKutta:
    """So many stages, steps as long as one Euler step less."""
    lengths = stages - 1
    weights = [1.0] * lengths + [lengths / stages]
    return RungeKutta(tuple((w, k / lengths) for k, w in enumerate(weights)), lengths)


METHODS = {
    1: RungeKutta(((1.0, 0.0),), 1),
    2: second_order(3),
    3: RungeKutta(((1.0, 0.0), (1.0, 0.5), (1.0 / 3.0, 1.0), (1.0, 0.5)), 2),
}
"""By order."""

LONG = second_order(4)
"""Of second order, as long as three Euler steps."""


ENDS = {"contained": 0, "extrapolated": 0, "periodic": 1, "limited": 2}
"""The continuation beyond the ends of an axis; the numbers of `stencils.py`."""

ALL_MEASURED, MEASURED = 64, 4
"""Steps from the first for which it is measured how fast the set moves, then one in so many."""

LEAST_STEPS = 128
"""Steps of a march in which anything depends on time: what lasts for less may pass unseen."""

MOST_STEPS = 10**9
"""Steps of a march: it would take days on the smallest grid."""

FEW = 30_000
"""Nodes below which one thread is faster than several."""


@dataclass(frozen=True)
class Method:
    """scheme: of the derivatives, a name in `schemes`; order: of the Runge-Kutta
    method, 1 to 3; dissipation: of the Lax-Friedrichs flux ("global", "local", "local-local");
    cfl: share of the largest stable Euler step; skip: leave out what is settled; long: whether a
    step of second order has as many stages as one of third, and is longer."""

    scheme: str = "weno5"
    order: int = 3
    dissipation: str = "local-local"
    cfl: float = 0.75
    skip: bool = True
    long: bool = False

    @property
    def steps(self) -> RungeKutta:
        return LONG if self.long else METHODS[self.order]

    @property
    def stages(self) -> int:
        """Of a step."""
        return len(self.steps.stages)


_march_leaves = lru_cache(maxsize=8)(MarchLeaves)
"""Marches over other grids, and with leaving the grid taken for something else, have the same."""

Advances = Callable[[Sequence[float], Within, Done], Iterator[float | None]]
"""Has values marched to each of some times, and says, after every step or after a few of them,
which of the times it has come to."""


class March:
    """Compiled sweeps of one Hamiltonian over one grid.

    axes: their nodes in rows, shape (axes, nodes of the longest); shape, kinds, steps, speeds:
    (axes,); cut: (4,), as `layout` says.
    """

    def __init__(
        self,
        hamiltonian: Hamiltonian,
        parameters: Sequence[Parameter],
        axes: Sequence[Array],
        steps: Sequence[float],
        kinds: Sequence[str],
        *,
        method: Method,
        limit: str,
        clock: tuple[float, float] = (0.0, 1.0),
        reflected: Sequence[npt.NDArray[np.int64]] | None = None,
        precision: str = "float64",
        threads: int = 1,
        device: Device | None = None,
        cut: tuple[int, int, int, int] | None = None,
        fastest: Callable[[Sequence[float]], tuple[Array, float]] | None = None,
        filtered: bool = False,
        start_rate: float = math.inf,
        leeway: tuple[float, float] = (0.0, 0.0),
        falls: Array | None = None,
    ) -> None:
        """axes: each (nodes of the axis,).
        clock: the time t at tau = 0, and how fast it runs, 1 or -1. reflected: for every axis,
        at which place of it the node is that always has the same value, shape (nodes of the axis,);
        half is computed then.
        device: where the stages are carried out, if not by the threads of this machine.
        cut: the units of the last two axes, where they are not those of `layout`. fastest: the
        largest speeds at times t, shape (axes,), and the largest sum of them over the steps, from
        elsewhere.
        filtered: whether the rate of a scheme of high order is held close to that of a monotone
        step (`stage_leaf.py`). start_rate: the largest rate of the start value, for that.
        leeway: for that, the share of it by which rates may be apart, and how much a kink counts.
        falls: of every axis, how steeply what a set is kept within falls beyond
        the lower and the upper end [its unit per unit of the state], and down to what: (axes, 4).
        """
        scheme = self.scheme = schemes()[method.scheme]
        self.precision, self.device = precision, device
        self.filtered = filtered and not scheme.one_slope
        self.code = sweep_code(precision, one_slope=scheme.one_slope)
        self.limit = limit
        self.hamiltonian, self.parameters = hamiltonian, parameters
        self.method = method
        self.shape = np.array([len(a) for a in axes], dtype=np.int64)
        self.axes = padded_rows(axes)
        self.steps = np.array(steps, dtype=np.float64)
        self.kinds = np.array([ENDS[k] for k in kinds], dtype=np.int64)
        self.p = np.array([float(q.value) for q in parameters])
        self.nodes = math.prod(len(a) for a in axes)
        self.threads = threads if self.nodes > FEW else 1
        if device is not None:
            cut = device_layout([len(a) for a in axes], self.leaves.of_row)
        cut = cut or layout([len(a) for a in axes])
        self.cut = np.array(cut, dtype=np.int64)
        local = cut[1] * cut[2]
        self.units = math.prod(len(a) for a in axes[:-2]) * local
        self.places = len(axes[0]) if len(axes) > 2 else local  # what threads share
        self.fold = Fold(reflected, kinds, cut, scheme.ghosts) if reflected is not None else None
        self.clock = clock
        self.varying = any(e.has(TIME) for e in (hamiltonian.value, *hamiltonian.speeds))
        self.speeds = np.zeros(len(axes))  # largest along every axis, for a global dissipation
        self.crossing = 0.0  # the time to cross a cell at the largest along the slowest axis [s]
        symbols = [q.symbol for q in hamiltonian.system.states]
        largest = Fastest(hamiltonian.speeds, symbols, parameters, axes, self.steps)
        self.fastest = fastest or largest.at
        self.share, self.bent = leeway
        self.leeway = self.share * start_rate if filtered else math.inf
        ends = np.zeros((len(axes), 4)) if falls is None else falls
        self._numbers: dict[float, tuple[tuple[float, float, Within], Array]] = {}
        # One row (axes,) for each of the four: a stage has its numbers of all axes side by side.
        self.falls = [*(ends[:, :2].T * self.steps), *ends[:, 2:].T]

    @property
    def name(self) -> str:
        """Which program gives these bits."""
        return self.code.name if self.device is None else f"{self.code.name} as kernels"

    @cached_property
    def leaves(self) -> MarchLeaves:
        """What the sweep calls: where another carries out the stages they are not needed."""
        method = self.method
        return _march_leaves(
            self.hamiltonian, tuple(self.parameters), self.scheme, dissipation=method.dissipation,
            limit=self.limit, one_stage=method.stages == 1, precision=self.precision,
            filtered=self.filtered,
        )  # fmt: skip

    @cached_property
    def longest_step(self) -> float:
        """The largest stable step at the beginning [s]; see `_longest_step`."""
        return self._longest_step((0.0,))

    def _longest_step(self, at: Sequence[float]) -> float:
        """The largest step [s]: as many Euler steps as the method has, each the chosen share of
        what is stable with the speeds at those tau.

        Infinite where nothing moves. Raises `SimulationError` where a rate is not finite.
        """
        self.speeds[:], total = self.fastest([self._time(tau) for tau in at])
        moving = self.speeds > 0
        self.crossing = float((self.steps[moving] / self.speeds[moving]).max(initial=0.0))
        for i in np.flatnonzero(~np.isfinite(self.speeds)):
            bad = [tau for tau in at if not np.isfinite(self._speed(int(i), tau)).all()]
            raise self._not_finite(int(i), bad[0])
        return self.method.cfl * self.method.steps.lengths / total if total > 0 else math.inf

    def _speed(self, i: int, tau: float) -> Array:
        """The largest speed along an axis at every node, in the shape of the grid."""
        at = over_grid(
            self.hamiltonian.speeds[i],
            [q.symbol for q in self.hamiltonian.system.states],
            self.parameters,
            [axis[:count] for axis, count in zip(self.axes, self.shape, strict=True)],
        )
        return at(self._time(tau)).reshape(self.shape)

    def _not_finite(self, i: int, tau: float) -> SimulationError:
        speed = self._speed(i, tau)
        bad = ~np.isfinite(speed)
        name = self.hamiltonian.system.states[i].name
        return SimulationError(
            f"the rate of '{name}' is not finite at {self.node(int(np.argmax(bad)))}"
            + (f", and at {bad.sum() - 1:,} nodes more" if bad.sum() > 1 else ""),
            expected="a rate that is finite at every node of the grid",
            remedy="take an interval, or a number of nodes, that leaves these states out",
        )

    def node(self, place: int) -> str:
        """The states at a node, by its place among all, as text."""
        index = np.unravel_index(place, tuple(self.shape))
        states = self.hamiltonian.system.states
        return ", ".join(
            f"{q.name} = {self.axes[i, k]:.6g}"
            for i, (q, k) in enumerate(zip(states, index, strict=True))
        )

    def not_finite(self, place: int, count: int, time: float) -> SimulationError:
        """So many nodes are not finite at a time; place: of the first among all."""
        return SimulationError(
            f"the value is not finite at {self.node(place)} after {time:g} s"
            + (f", and at {count - 1:,} nodes more" if count > 1 else ""),
            expected="rates that are finite and speeds that are bounded there",
            remedy="leave these states out of the grid, or take a smaller cfl or a lower order",
        )

    def _time(self, tau: float) -> float:
        return self.clock[0] + self.clock[1] * tau

    def run(
        self,
        values: Array,
        times: Sequence[float],
        *,
        upper: Array | None = None,
        lower: Array | None = None,
        within: Within = ANYWHERE,
    ) -> Done:
        """March `values` (changed in place) to each of `times`; they and the bounds at nodes have
        the shape (nodes,)."""
        done = Done()
        sweeping, advances = self.sweeping(values, upper, lower)
        with sweeping:
            for _ in advances(times, within, done):
                pass
        return done

    def advances(
        self,
        stages: Stages,
        moves: bool,
        times: Sequence[float],
        within: Within,
        done: Done,
    ) -> Iterator[float | None]:
        """As `Advances` says of the values whose `stages` these are, after every step.

        moves: whether bounds at nodes move. done: what has been done of the march, up to these
        values, which is taken down in it; it goes on from there.
        """
        shares, step = self.method.steps.stages, math.nan
        for start, dt, end in itertools.islice(self.steps_to(times, moves), done.steps, None):
            again = dt != step or not self.method.skip or self.varying or moves
            step = dt
            done.measured = (
                done.steps < ALL_MEASURED or done.steps % MEASURED == 0 or end is not None
            )
            for s, (weight, fraction) in enumerate(shares):
                last = s == len(shares) - 1
                then = 1.0 if last else shares[s + 1][1]  # what comes out is for the next stage
                answer = stages.stage(
                    StageOrder(
                        s,
                        self.u(start + fraction * dt),
                        self.numbers(dt, weight, within),
                        last and done.measured and within.nearest > 0,
                        self._time(start + then * dt) if moves else None,
                        again and s == 0,
                    )
                )
                done.computed += answer.computed
                if answer.wrong:
                    raise self.not_finite(answer.first, answer.wrong, start + dt)
            done.of += self.units * len(shares)
            done.steps += 1
            done.time = start + dt if end is None else end
            if done.measured:
                done.moved(answer.move / dt)
            done.fixed = answer.fixed
            yield end

    def sweeping(
        self,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        room: Room | None = None,
        bounds: Bounds | None = None,
    ) -> tuple[Sweeping | DeviceSweeping, Advances]:
        """What holds the values of a march, shape (nodes,) as upper and lower, and carries out its
        stages. bounds: those that move."""
        sweeping: Sweeping | DeviceSweeping
        if self.device is not None:
            sweeping = DeviceSweeping(self, self.device, values, upper, lower, bounds)
        else:
            kind = Streaming if room is not None and room.on_disk else Sweeping
            sweeping = kind(self, values, upper, lower, room, bounds)
        return sweeping, partial(self.advances, sweeping, bounds is not None)

    def u(self, tau: float) -> Array:
        """What is the same at all nodes: the time, the parameters, the largest speeds, shape
        (1 + parameters + axes,)."""
        u = np.empty(1 + len(self.p) + len(self.speeds))
        u[0], u[1 : 1 + len(self.p)], u[1 + len(self.p) :] = self._time(tau), self.p, self.speeds
        return u

    def numbers(self, dt: float, weight: float, within: Within) -> Array:
        """Those of a stage of a step of dt, shape (8 + 6 * axes,), in the order of
        `names_of_numbers` (`stage_leaf.py`)."""
        step = dt, weight, within
        last, numbers = self._numbers.get(weight, (None, None))
        if numbers is None or last != step:  # most steps of a march are equally long
            per_axis = (0.5 / self.steps, self.steps, *self.falls)
            of_filter = (self.leeway, self.share, self.bent)
            of_step = (dt * self.method.steps.share, weight, *within)
            numbers = np.array([*of_step, *of_filter, *np.concatenate(per_axis)])
            self._numbers[weight] = step, numbers
        return numbers

    def steps_to(
        self, times: Sequence[float], moves: bool = False
    ) -> Iterator[tuple[float, float, float | None]]:
        """Start and length of every step [s], and which of `times` it ends at.

        moves: whether bounds at nodes move.
        """
        now, longest = 0.0, times[-1] / LEAST_STEPS if self.varying or moves else math.inf
        for end in times:
            while now < end:
                count = self._count(now, end, longest)
                dt = (end - now) / count
                several = 1 if self.varying else count
                for k in range(several):
                    yield now + k * dt, dt, end if k == count - 1 else None
                now = end if several == count else now + dt

    def _count(self, now: float, end: float, longest: float) -> int:
        """The number of steps no longer than that; with speeds that vary, so that the first is
        short enough."""
        count, needed = 0, 1
        while needed > count:
            count = needed
            if count > MOST_STEPS:
                raise self._too_many(count, (end - now) / count, now)
            dt = (end - now) / count
            at = (now, now + 0.5 * dt, now + dt)
            step = self._longest_step(at) if self.varying else self.longest_step
            needed = math.ceil((end - now) / min(step, longest) - 1e-9)
        return count

    def _too_many(self, count: int, longest: float, tau: float) -> SimulationError:
        i = int(np.argmax(self.speeds / self.steps))
        speed = self._speed(i, tau)
        state = self.hamiltonian.system.states[i]
        return SimulationError(
            f"the march would take {count:.3g} steps of {longest:.3g} s: '{state.name}' moves at "
            f"up to {speed.max():.3g} {state.unit}/s at {self.node(int(np.argmax(speed)))}, the "
            f"median over the grid is {np.median(speed):.3g}",
            expected=f"at most {MOST_STEPS:.0e} steps",
            remedy="leave these states out of the grid, take a coarser grid or a shorter horizon",
        )
