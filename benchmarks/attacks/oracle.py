"""What is surely lost and surely kept: two brackets by value iteration on sets of small cells.

    outer  the cells that may hold a state of the set: some input, for each of some constant
           disturbances, may lead on to a cell of the outer set
    inner  the cells of which every state is in the set: one held input leads all of the cell, along
           a path inside the region, to inner cells, whatever the disturbance does in the meantime

Both follow from enclosures. Let z be the solution from the middle of a cell (Runge-Kutta, with its
error estimated by half steps and counted), M a Metzler matrix with M_ii >= df_i/dx_i and
M_ij >= |df_i/dx_j| over an a priori box of the step. Then a solution x from the cell obeys

    |x(dt) - z(dt)| <= e^{M dt} h/2 + what other inputs and disturbances do (componentwise)

(Mueller's comparison; W. Walter, Differential and Integral Inequalities, 1970). An input that
varies over the step differs from its mean by a motion that comes back, which counts with
dt^2/3 |df/dx| |df/du| R. So everything outside `outer` is lost and everything in `inner` is kept,
for the sampled and for the continuous game; between them nothing is said. Only NumPy is used.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from attacks.enclosures import NUMBERS, between, enclose_all, read
from attacks.problems import Problem

Array = np.ndarray
REACH = 1 / 3
"""Of the domain, that a step may go at most."""
COUNTS = {1: 5000, 2: 140, 3: 30}
"""Cells along an axis, by the number of states."""


@dataclass(frozen=True)
class Brackets:
    """Cells (as arrays of bool over the axes) of which states may be, and surely are, in the set.

    low, size: of the first cell, and of every cell.
    """

    low: Array
    size: Array
    outer: Array
    inner: Array
    angles: tuple[bool, ...]

    def _box(self, which: Array, low: Array, high: Array, beyond: bool) -> tuple[Array, Array]:
        """(cells of `which`, all cells) that boxes (n, boxes) meet."""
        shape = which.shape
        pads = [(n, n) if t else (1, 1) for n, t in zip(shape, self.angles, strict=True)]
        padded = _padded(which, pads, self.angles, beyond)
        first = np.floor((low - self.low[:, None]) / self.size[:, None]).astype(int)
        last = np.floor((high - self.low[:, None]) / self.size[:, None]).astype(int)
        turn = np.array(self.angles)
        count = np.array(shape)[:, None]
        whole = np.where(turn[:, None], first // count * count, 0)
        first, last = first - whole, np.minimum(last - whole, first - whole + count)
        return counted(_summed(padded), first, last, pads)

    def none_outer(self, low: Array, high: Array) -> Array:
        """Whether no state of the boxes can be in the set."""
        return self._box(self.outer, low, high, beyond=False)[0] == 0

    def all_inner(self, low: Array, high: Array) -> Array:
        """Whether every state of the boxes is in the set."""
        some, every = self._box(self.inner, low, high, beyond=False)
        return some == every


def _padded(
    s: Array, pads: Sequence[tuple[int, int]], turns: Sequence[bool], beyond: bool
) -> Array:
    for axis, (pad, turn) in enumerate(zip(pads, turns, strict=True)):
        widths = [pad if i == axis else (0, 0) for i in range(s.ndim)]
        s = np.pad(s, widths, mode="wrap") if turn else np.pad(s, widths, constant_values=beyond)
    return s


def _summed(s: Array) -> Array:
    """Sums over all boxes that begin at the first cell."""
    total = np.zeros([n + 1 for n in s.shape], dtype=np.int32)
    total[(slice(1, None),) * s.ndim] = s
    for axis in range(s.ndim):
        np.cumsum(total, axis=axis, out=total)
    return total


def counted(
    sums: Array, first: Array, last: Array, pads: Sequence[tuple[int, int]]
) -> tuple[Array, Array]:
    """(cells of the set, cells) in boxes of cells, both ends included."""
    n = sums.ndim
    begin, end, every = [], [], np.ones(first.shape[1:], dtype=np.int64)
    for i in range(n):
        size, pad = sums.shape[i] - 1, pads[i][0]
        a = np.clip(first[i].astype(np.int64) + pad, 0, size - 1)
        b = np.clip(last[i].astype(np.int64) + pad, 0, size - 1) + 1
        begin.append(a)
        end.append(b)
        every = every * (b - a)
    found = np.zeros(first.shape[1:], dtype=np.int64)
    strides = [int(np.prod(sums.shape[i + 1 :])) for i in range(n)]
    flat = sums.ravel()
    for corner in itertools.product((0, 1), repeat=n):
        place = sum((end[i] if c else begin[i]) * strides[i] for i, c in enumerate(corner))
        sign = (-1) ** (n - sum(corner))
        found += sign * flat[place]
    return found, every


# -- sets of inputs ---------------------------------------------------------------------------


def pieces(bound: list[Any] | None, many: int) -> tuple[Array, Array]:
    """Middles and half-widths (pieces, m) of boxes that cover a bound, and reach little beyond."""
    if bound is None:
        return np.zeros((1, 0)), np.zeros((1, 0))
    if bound[0] == "ball" and bound[2] == 1:
        return pieces(["box", [-bound[1]], [bound[1]]], many)
    if bound[0] == "ball":
        middles, half = pieces(["box", [-bound[1]] * 2, [bound[1]] * 2], many)
        least = np.maximum(np.abs(middles) - half, 0.0)
        met = (least**2).sum(axis=1) < bound[1] ** 2
        middles, half, least = middles[met], half[met], least[met]
        rim = np.sqrt(bound[1] ** 2 - least[:, ::-1] ** 2)  # the part of each that is in the disc
        low = np.maximum(middles - half, -rim)
        high = np.minimum(middles + half, rim)
        return (low + high) / 2, (high - low) / 2
    low, high = np.array(bound[-2], float), np.array(bound[-1], float)
    half = (high - low) / (2 * many)
    lines = [a + w * (2 * np.arange(many) + 1) for a, w in zip(low, half, strict=True)]
    middles = np.array(list(itertools.product(*lines)))
    if bound[0] == "image":
        matrix = np.array(bound[1])
        middles, half = middles @ matrix.T, np.abs(matrix) @ half
    return middles, np.broadcast_to(half, middles.shape)


def points(bound: list[Any] | None, many: int) -> Array:
    """Members of a bound, its corners or its rim among them."""
    if bound is None:
        return np.zeros((1, 0))
    if bound[0] == "ball" and bound[2] == 1:
        return points(["box", [-bound[1]], [bound[1]]], many)
    if bound[0] == "ball":
        angles = np.arange(8) * 2 * np.pi / 8
        rim = bound[1] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return np.vstack([np.zeros((1, 2)), rim])
    low, high = bound[-2:]
    lines = [np.linspace(a, b, many) for a, b in zip(low, high, strict=True)]
    corners = np.array(list(itertools.product(*lines)))
    return corners @ np.array(bound[1]).T if bound[0] == "image" else corners


def hull_of(bound: list[Any] | None) -> tuple[Array, Array]:
    """The least box around a bound."""
    if bound is None:
        return np.zeros(0), np.zeros(0)
    if bound[0] == "ball":
        return np.full(bound[2], -bound[1]), np.full(bound[2], float(bound[1]))
    corners = points(["box", bound[-2], bound[-1]], 2)
    if bound[0] == "image":
        corners = corners @ np.array(bound[1]).T
    return corners.min(axis=0), corners.max(axis=0)


# -- motion -----------------------------------------------------------------------------------


def names_at(p: Problem, x: Any, u: Any, d: Any, t: Any = 0.0) -> dict[str, Any]:
    """What formulas read."""
    names: dict[str, Any] = dict(p.numbers)
    names.update(zip(p.states, x, strict=True))
    names.update({f"u{i}": v for i, v in enumerate(u)}, t=t)
    names.update({f"d{i}": v for i, v in enumerate(d)})
    return names


def rates_at(p: Problem, x: Array, u: Array, d: Array) -> Array:
    """f(x, u, d) for columns of states (n, ...)."""
    names = names_at(p, x, u, d)
    shape = np.broadcast_shapes(x[0].shape, *(np.shape(v) for v in (*u, *d)))
    return np.array([np.broadcast_to(read(r, names, NUMBERS), shape) for r in p.rates])


def moved(p: Problem, x: Array, u: Array, d: Array, dt: float, steps: int = 1) -> Array:
    """The states a time later, by the classical method of Runge and Kutta."""
    h = dt / steps
    for _ in range(steps):
        a = rates_at(p, x, u, d)
        b = rates_at(p, x + h / 2 * a, u, d)
        c = rates_at(p, x + h / 2 * b, u, d)
        e = rates_at(p, x + h * c, u, d)
        x = x + h / 6 * (a + 2 * b + 2 * c + e)
    return x


def worst(p: Problem, x: Array, what: str = "region", t: Any = 0.0) -> Array:
    """The largest of the inequalities: a state is inside where it is at most 0."""
    names = names_at(p, x, (), (), t)
    texts = p.region if what == "region" else p.goal
    return np.max([read(c, names, NUMBERS) + 0 * x[0] for c in texts], axis=0)


def worst_over(
    p: Problem, low: Array, high: Array, what: str, t: tuple[float, float]
) -> tuple[Array, Array]:
    """Bounds of the largest inequality over boxes (n, boxes)."""
    texts = p.region if what == "region" else p.goal
    boxes = [between(a, b) for a, b in zip(low, high, strict=True)]
    time = between(np.array(t[0]), np.array(t[1]))
    (least, most), _ = enclose_all(texts, names_at(p, boxes, (), (), time), low.shape[1:], 0)
    return least.max(axis=0), most.max(axis=0)


class Flow:
    """How cells move in one step: where their middles go, and how far from there a state may be."""

    def __init__(self, p: Problem, middles: Array, half: Array, dt: float) -> None:
        self.p, self.middles, self.half, self.dt = p, middles, half, dt
        self.u, self.d = hull_of(p.inputs), hull_of(p.disturbances)
        n = len(middles)
        wide = np.broadcast_to(half[:, None], middles.shape)
        speed = self._enclosed(wide)[0]
        speed = 1.2 * np.maximum(np.abs(speed[0]), np.abs(speed[1]))
        self.sure = np.zeros(middles.shape[1], bool)
        for _ in range(8):
            around = wide + dt * speed
            value, slopes = self._enclosed(around)
            most = np.maximum(np.abs(value[0]), np.abs(value[1]))
            self.sure = (most <= speed).all(axis=0)
            if self.sure.all():
                break
            speed = np.where(self.sure, speed, 1.2 * np.maximum(most, speed))
        self.speed, self.around = speed, around
        low, high = slopes
        size = np.maximum(np.abs(low), np.abs(high))
        jac = np.moveaxis(size[:, :n], -1, 0)
        metzler = jac.copy()
        for i in range(n):
            metzler[:, i, i] = high[i, i]
        self.jacobian = jac
        self.by_input = np.moveaxis(size[:, n : n + len(self.u[0])], -1, 0)
        self.by_push = np.moveaxis(size[:, n + len(self.u[0]) :], -1, 0)
        spread = (high - low)[:, n : n + len(self.u[0])]
        self.varied = np.moveaxis(spread, -1, 0)
        self.growth = exponential(metzler * dt)
        self.most = np.maximum(exponential(np.maximum(metzler, 0) * dt), np.eye(n))

    def _enclosed(self, around: Array) -> Any:
        """Bounds of the rates and of all their slopes over boxes around the middles."""
        n, low, high = len(self.middles), self.middles - around, self.middles + around
        shape = self.middles.shape[1:]
        x = [between(a, b, i) for i, (a, b) in enumerate(zip(low, high, strict=True))]
        u = [between(a, b, n + i) for i, (a, b) in enumerate(zip(*self.u, strict=True))]
        d = [between(a, b, n + len(u) + i) for i, (a, b) in enumerate(zip(*self.d, strict=True))]
        return enclose_all(self.p.rates, names_at(self.p, x, u, d), shape, n + len(u) + len(d))

    def _start(self) -> Array:
        return self.growth @ self.half

    def radius_of_any_input(self, half: Array) -> Array:
        """Of states that any varying input with its mean in a piece may lead to, (n, cells)."""
        wide = (self.u[1] - self.u[0]) / 2
        returning = self.dt**2 / 3 * applied(self.jacobian, self.by_input @ wide)
        rest = returning + self.dt * (self.by_input @ half)
        varied = self.dt / 2 * self.varied @ wide
        return (self._start() + applied(self.most, rest) + varied).T

    def radii_of_any_push(self) -> tuple[Array, Array]:
        """Of states that any varying disturbance may lead to, an input held: at the end of the
        step, and at any time of it, (n, cells) each."""
        wide = (self.d[1] - self.d[0]) / 2
        rest = self.dt * (self.by_push @ wide)
        at_end = self._start() + applied(self.most, rest)
        return at_end.T, applied(self.most, self.half + rest).T

    def bulge(self) -> Array:
        """How far a path of a quarter of a step may leave the box of its ends, (n, cells)."""
        return (self.dt / 4) ** 2 / 8 * applied(self.jacobian, self.speed.T).T


def applied(matrices: Array, vectors: Array) -> Array:
    """Each matrix (cells, i, j) times the vector (cells, j) of its cell."""
    return np.einsum("cij,cj->ci", matrices, vectors)


def exponential(m: Array) -> Array:
    """An upper bound of the exponential of Metzler matrices (..., n, n), entry by entry."""
    n = m.shape[-1]
    shift = np.maximum(0.0, -np.min(np.diagonal(m, axis1=-2, axis2=-1), axis=-1))
    raised = m + shift[..., None, None] * np.eye(n)
    term = total = np.broadcast_to(np.eye(n), m.shape).copy()
    for k in range(1, 15):
        term = term @ raised / k
        total = total + term
    return np.exp(-shift)[..., None, None] * (total + 2 * term) * (1 + 1e-9)


# -- the brackets -----------------------------------------------------------------------------


def brackets(
    p: Problem,
    count: int | None = None,
    horizon: float | None = None,
    most: int = 4000,
    narrower: Array | float = 0.0,
    wider: Array | float = 0.0,
) -> Brackets | None:
    """Outer and inner cells of the set of a problem; None where its region is empty.

    horizon: of the claim, math.inf for ever. count: cells along each axis. A step is as long as
    keeps the spread of a step small against its way. most: steps at most, after which the outer set
    is what it is (it only shrinks) and an inner set for ever that still shrinks is empty. narrower:
    the inner set is that of a region narrower by so much along each axis: all states that are so
    near have to be in the region. wider: the outer set is that of a region wider by so much along
    each axis, within the part of the grid where the region is.
    """
    if p.kind == "invariance":
        return brackets(_all_against(p), count, horizon, most, narrower, wider)
    n = len(p.rates)
    count = count or COUNTS[n]
    reach = p.kind in ("basin", "tube")
    ends = _domain(p, count)
    if ends is None:
        return None
    low, high, counts = ends
    size = (high - low) / counts
    lines = [a + w * (np.arange(c) + 0.5) for a, w, c in zip(low, size, counts, strict=True)]
    every = np.array([m.ravel() for m in np.meshgrid(*lines, indexing="ij")])
    time = p.horizon if horizon is None else horizon
    start = (0.0, 0.0)
    if p.kind == "tube":
        may_stay = np.ones(every.shape[1], bool)
        grid_low, grid_high = np.array(p.low)[:, None], np.array(p.high)[:, None]
        line = ~np.array(p.angles)[:, None]
        inside = (every - size[:, None] / 2 >= grid_low) & (every + size[:, None] / 2 <= grid_high)
        stays = (inside | ~line).all(axis=0)
    else:
        span = (0.0, time) if p.moves else start
        half = (size / 2)[:, None]
        more = half + np.broadcast_to(narrower, size.shape)[:, None]
        widened = half + np.broadcast_to(wider, size.shape)[:, None]
        may_stay = worst_over(p, every - widened, every + widened, "region", span)[0] <= 0
        stays = worst_over(p, every - more, every + more, "region", span)[1] < 0
    live = np.flatnonzero(may_stay)
    if not len(live):
        return None
    middles = every[:, live]
    dt = _step(p, middles, size, counts, time)
    steps = most if not np.isfinite(time) else int(np.floor(time / dt + 1e-9))
    flow = Flow(p, middles, size / 2, dt)
    shape = tuple(int(c) for c in counts)
    where = _Places(p, low, size, shape)
    goal_low = goal_high = None
    if reach:
        swept = flow.around
        goal_low = worst_over(p, middles - swept, middles + swept, "goal", start)[0] <= 0
        goal_high = (
            worst_over(p, middles - size[:, None] / 2, middles + size[:, None] / 2, "goal", start)[
                1
            ]
            < 0
        )
    outer = _outer(p, flow, where, live, shape, steps, goal_low)
    inner = _inner(
        p,
        flow,
        where,
        live,
        shape,
        steps + (0 if reach else 1),
        stays[live],
        goal_high,
        np.isfinite(time),
        np.broadcast_to(narrower, size.shape)[:, None],
    )
    return Brackets(low, size, outer.reshape(shape), inner.reshape(shape), p.angles)


def _all_against(p: Problem) -> Problem:
    """Every input and disturbance as one disturbance: a box around both, or none."""
    from dataclasses import replace

    low, high = (
        np.concatenate(v) for v in zip(hull_of(p.inputs), hull_of(p.disturbances), strict=True)
    )
    count = len(hull_of(p.inputs)[0])
    names = {f"d{i}": f"d{i + count}" for i in reversed(range(len(low) - count))}
    names |= {f"u{i}": f"d{i}" for i in range(count)}

    def renamed(text: str) -> str:
        for old, new in names.items():
            text = text.replace(old, new.replace("d", "#"))
        return text.replace("#", "d")

    rounded = [
        b
        for b in (p.inputs, p.disturbances)
        if b and b[0] != "box" and not (b[0] == "ball" and b[2] == 1)
    ]
    against: list[Any] = ["box", list(low), list(high)]
    if rounded:  # the outer set looks at members of the bounds alone
        against = ["listed", [list(v) for v in _members(p)], list(low), list(high)]
    return replace(
        p, kind="kernel", inputs=None, disturbances=against, rates=tuple(map(renamed, p.rates))
    )


def _members(p: Problem) -> list[Array]:
    return [np.concatenate([u, d]) for u in points(p.inputs, 3) for d in points(p.disturbances, 3)]


def _pushes(p: Problem) -> Array:
    """Constant disturbances that the outer set looks at."""
    if p.disturbances and p.disturbances[0] == "listed":
        return np.array(p.disturbances[1])
    return points(p.disturbances, 2)


def _domain(p: Problem, count: int) -> tuple[Array, Array, Array] | None:
    """(low, high, cells along each axis): the part of the grid where the region is."""
    low, high = np.array(p.low, float), np.array(p.high, float)
    line = ~np.array(p.angles)
    if p.kind == "tube":
        wide = np.where(line, 0.5 * (high - low), 0.0)
        return low - wide, high + wide, np.full(len(low), count)
    lines = [np.linspace(a, b, 42) for a, b in zip(low, high, strict=True)]
    corners = np.meshgrid(*lines, indexing="ij")
    half = np.array([(v[1] - v[0]) / 2 for v in lines])
    x = np.array([m.ravel() for m in corners])
    span = (0.0, p.horizon) if p.moves else (0.0, 0.0)
    near = worst_over(p, x - half[:, None], x + half[:, None], "region", span)[0] <= 0
    if not near.any():
        return None
    for i in np.flatnonzero(line):
        low[i] = max(low[i], x[i][near].min() - half[i])
        high[i] = min(high[i], x[i][near].max() + half[i])
    return low, high, np.full(len(low), count)


def _step(p: Problem, middles: Array, size: Array, counts: Array, time: float) -> float:
    """Long enough that a way is many cells, short enough that its spread is a few."""
    probe = middles[:, :: max(1, middles.shape[1] // 2000)]
    flow = Flow(p, probe, size / 2, 1e-6)
    fastest = flow.speed.max(axis=1) / 1.2
    wide = (flow.u[1] - flow.u[0]) / 2
    kappa = applied(flow.jacobian, flow.by_input @ wide).max(axis=0)
    by_spread = np.sqrt(np.min(size / np.maximum(kappa / 3, 1e-9)))
    by_way = np.min(REACH * counts * size / np.maximum(fastest, 1e-9))
    norm = flow.jacobian.sum(axis=2).max()
    dt = min(by_spread, by_way, 0.5 / max(norm, 1e-9), time / 6 if np.isfinite(time) else np.inf)
    return float(dt)


class _Places:
    """Boxes of states as boxes of cells."""

    def __init__(self, p: Problem, low: Array, size: Array, shape: tuple[int, ...]) -> None:
        self.low, self.size, self.shape, self.angles = low, size, shape, p.angles
        self.pads = [(pad, pad) for pad in (n // 2 + 8 for n in shape)]

    def of(self, middle: Array, radius: Array) -> tuple[Array, Array]:
        slack = 1e-6 * self.size[:, None]
        first = np.floor((middle - radius - slack - self.low[:, None]) / self.size[:, None])
        last = np.floor((middle + radius + slack - self.low[:, None]) / self.size[:, None])
        limit = [(-pad[0], c + pad[0] - 1) for c, pad in zip(self.shape, self.pads, strict=True)]
        return tuple(
            np.array([np.clip(v[i], *limit[i]) for i in range(len(limit))]).astype(np.int16)
            for v in (first, last)
        )  # type: ignore[return-value]

    def sums(self, s: Array, beyond: bool) -> Array:
        return _summed(_padded(s.reshape(self.shape), self.pads, self.angles, beyond))


def _ends(p: Problem, flow: Flow, u: Array, d: Array) -> tuple[Array, Array]:
    """Where middles go, and the error of that."""
    ones = np.ones(flow.middles.shape[1])
    columns = [v * ones for v in u], [v * ones for v in d]
    fine = moved(p, flow.middles, *columns, flow.dt, 2)
    return fine, np.abs(fine - moved(p, flow.middles, *columns, flow.dt, 1)) + 1e-9 * np.abs(fine)


def _outer(
    p: Problem,
    flow: Flow,
    where: _Places,
    live: Array,
    shape: tuple[int, ...],
    steps: int,
    goal: Array | None,
) -> Array:
    middles, half = pieces(p.inputs, _many(flow))
    boxes = []
    for d in _pushes(p):
        row = []
        for u, wide in zip(middles, half, strict=True):
            end, error = _ends(p, flow, u, d)
            row.append(where.of(end, flow.radius_of_any_input(wide) + error))
        boxes.append(tuple(np.stack([b[i] for b in row]) for i in (0, 1)))
    beyond = p.kind == "tube"
    total = int(np.prod(shape))
    state = np.zeros(total, bool)
    state[live] = True if goal is None else goal | ~flow.sure
    witness = np.zeros((len(boxes), len(live)), dtype=np.int32)
    for _ in range(steps if goal is None else steps + 1):
        sums = where.sums(state, beyond)
        asked = np.flatnonzero(state[live] if goal is None else ~state[live])
        asked = asked[flow.sure[asked]]
        good = np.ones(len(asked), bool)
        for k, (first, last) in enumerate(boxes):
            rest = np.flatnonzero(good)
            good[rest] = _some(sums, first, last, witness[k], asked[rest], where.pads)
        new = state.copy()
        if goal is None:
            new[live[asked[~good]]] = False
        else:
            new[live[asked[good]]] = True
        if (new == state).all():
            break
        state = new
    return state


def _many(flow: Flow) -> int:
    """Pieces of each input, such that a piece leads to little more than its cells."""
    count = len(flow.u[0])
    if count != 1:
        return {0: 1, 2: 7}[count]
    way = flow.dt * flow.by_input[:, :, 0].max(axis=0) * (flow.u[1] - flow.u[0])[0]
    cells = np.sort(way / (2 * flow.half))
    return int(np.clip(np.ceil(cells[-2] if len(cells) > 1 else 1), 8, 96))


def _some(sums: Array, first: Array, last: Array, witness: Array, asked: Array, pads: Any) -> Array:
    """Whether some piece of inputs leads to a cell of the set; it is remembered."""
    good = np.zeros(len(asked), bool)
    left = np.arange(len(asked))
    mine = witness[asked]
    good = counted(sums, first[mine, :, asked].T, last[mine, :, asked].T, pads)[0] > 0
    left = np.flatnonzero(~good)
    for k in range(len(first)):
        if not len(left):
            break
        cells = asked[left]
        hit = counted(sums, first[k][:, cells], last[k][:, cells], pads)[0] > 0
        witness[cells[hit]] = k
        good[left[hit]] = True
        left = left[~hit]
    return good


def _inner(
    p: Problem,
    flow: Flow,
    where: _Places,
    live: Array,
    shape: tuple[int, ...],
    steps: int,
    stays: Array,
    goal: Array | None,
    finite: bool,
    narrower: Array,
) -> Array:
    middle = (flow.d[0] + flow.d[1]) / 2
    radius, on_the_way = flow.radii_of_any_push()
    boxes, allowed = [], []
    chosen = points(p.inputs, {0: 1, 1: 5, 2: 3}[len(flow.u[0])])
    ones = np.ones(len(live))
    for u in chosen:
        end, error = _ends(p, flow, u, middle)
        boxes.append(where.of(end, radius + error))
        path, at = stays & flow.sure, flow.middles
        near = np.flatnonzero(path)
        if p.kind != "tube" and len(near):
            sure = (
                worst_over(
                    p,
                    (flow.middles - flow.around - narrower)[:, near],
                    (flow.middles + flow.around + narrower)[:, near],
                    "region",
                    (0.0, p.horizon) if p.moves else (0.0, 0.0),
                )[1]
                < 0
            )
            near = near[~sure]
            at, bulge = flow.middles[:, near], flow.bulge()[:, near]
            held = [v * ones[near] for v in u], [v * ones[near] for v in middle]
            spread = (on_the_way + error)[:, near] + bulge + narrower
            for _ in range(4):
                then = moved(p, at, *held, flow.dt / 4, 1)
                low, high = np.minimum(at, then) - spread, np.maximum(at, then) + spread
                path[near] &= (
                    worst_over(p, low, high, "region", (0.0, p.horizon) if p.moves else (0.0, 0.0))[
                        1
                    ]
                    < 0
                )
                at = then
        allowed.append(path)
    first, last = (np.stack([b[i] for b in boxes]) for i in (0, 1))
    may = np.stack(allowed)
    total = int(np.prod(shape))
    state = np.zeros(total, bool)
    state[live] = stays & may.any(axis=0) if goal is None else goal & stays
    witness = np.argmax(may, axis=0).astype(np.int32)
    settled = False
    for _ in range(steps):
        sums = where.sums(state, False)
        asked = np.flatnonzero(state[live] if goal is None else ~state[live] & stays)
        good = _every(sums, first, last, may, witness, asked, where.pads)
        new = state.copy()
        if goal is None:
            new[live[asked[~good]]] = False
        else:
            new[live[asked[good]]] = True
        settled = bool((new == state).all())
        if settled:
            break
        state = new
    if goal is None and not finite and not settled:
        state[:] = False
    return state


def _every(
    sums: Array, first: Array, last: Array, may: Array, witness: Array, asked: Array, pads: Any
) -> Array:
    """Whether some held input leads to cells of the set only."""

    def leads(k: Any, cells: Array) -> Array:
        found, every = counted(sums, first[k, :, cells].T, last[k, :, cells].T, pads)
        return (found == every) & may[k, cells]

    good = leads(witness[asked], asked)
    left = np.flatnonzero(~good)
    for k in range(len(first)):
        if not len(left):
            break
        cells = asked[left]
        hit = leads(np.full(len(cells), k), cells)
        witness[cells[hit]] = k
        good[left[hit]] = True
        left = left[~hit]
    return good
