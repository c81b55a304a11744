"""Random kernels with ridges in one to three states, and filters over them in a closed loop.

The closed loop is plain NumPy: states, rates and constraints are written down here a second time,
so that nothing of the product judges itself. Constraints are |a . q| <= b for several rows a, so
that V, the least of them, has ridges where one input has to trade them.
"""

from dataclasses import dataclass

import numpy as np

import holdfast as hf

FOES = ("gradient", "constant", "switching", "greedy", "random")


@dataclass(frozen=True)
class Problem:
    """dq/dt = a q + g u + e d within |rows q| <= limits; u in a box or a ball, d in a box."""

    a: np.ndarray
    g: np.ndarray
    e: np.ndarray
    rows: np.ndarray
    limits: np.ndarray
    low: np.ndarray
    high: np.ndarray
    ball: float
    most: np.ndarray
    nodes: int
    scheme: str
    sample_time: float

    def rates(self, q, u, d):
        return q @ self.a.T + u @ self.g.T + d @ self.e.T

    def step(self, q, u, d, h):
        k1 = self.rates(q, u, d)
        k2 = self.rates(q + h / 2 * k1, u, d)
        k3 = self.rates(q + h / 2 * k2, u, d)
        k4 = self.rates(q + h * k3, u, d)
        return q + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def room(self, q):
        return (self.limits - np.abs(q @ self.rows.T)).min(axis=1)

    def pushes(self, count, rng):
        return rng.uniform(-1, 1, (count, len(self.most))) * self.most

    def built(self):
        """The system, the region and the grid of the product."""
        n, m, k = len(self.a), self.g.shape[1], self.e.shape[1]
        q, u, d = (
            [hf.symbol(f"{c}{i}") for i in range(size)]
            for c, size in zip("xud", (n, m, k), strict=True)
        )
        named = {s.name: s for s in (*q, *u, *d)}

        def line(row, symbols):
            return (
                " + ".join(f"({c!r})*{s}" for c, s in zip(map(float, row), symbols, strict=True))
                or "0"
            )

        rates = {
            f"x{i}": hf.parse_expression(
                " + ".join((line(self.a[i], q), line(self.g[i], u), line(self.e[i], d))), named
            )
            for i in range(n)
        }
        bounds = hf.Ball(self.ball, m) if self.ball else hf.Box(tuple(self.low), tuple(self.high))
        system = hf.System(
            "ridges", tuple(hf.Quantity(s.name) for s in q),
            tuple(hf.Quantity(s.name) for s in u), rates,
            disturbances=tuple(hf.Quantity(s.name) for s in d), input_bounds=bounds,
            disturbance_bounds=hf.Box(tuple(-self.most), tuple(self.most)) if k else None,
        )  # fmt: skip
        inequalities = [
            hf.Inequality(
                f"c{j}", hf.parse_expression(f"abs({line(row, q)}) - ({float(b)!r})", named)
            )
            for j, (row, b) in enumerate(zip(self.rows, self.limits, strict=True))
        ]
        region = hf.Region("rows", system.states, tuple(inequalities))
        box = {s.name: (-w, w) for s, w in zip(q, self.widths(), strict=True)}
        return system, region, hf.grid(system, box, nodes=self.nodes)

    def widths(self):
        """How far the region goes along each axis, and a tenth more."""
        corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * len(self.a))).reshape(len(self.a), -1).T
        square = np.linalg.solve(self.rows[: len(self.a)], (corners * self.limits[: len(self.a)]).T)
        return 1.1 * np.abs(square).max(axis=1)


def drawn(rng, states=None):
    """A problem of 1 to 3 states: integrators that couple, with a row that leans against them."""
    n = states or int(rng.integers(1, 4))
    a = np.diag(rng.uniform(0.6, 1.4, n - 1), 1) + np.diag(rng.uniform(-0.3, 0.1, n))
    two = n > 1 and rng.random() < 0.4
    g = np.zeros((n, 2 if two else 1))
    g[-1, 0] = rng.uniform(0.7, 1.3)
    if two:
        g[0, 1] = rng.uniform(0.2, 0.5)
    k = int(rng.integers(0, 2))
    e = np.zeros((n, k))
    e[-1:, :] = 1.0
    rows = np.eye(n)
    if n > 1:
        rows[0, 1] = rng.choice([-1, 1]) * rng.uniform(0.05, 0.4)
    limits = np.r_[1.0, rng.uniform(1.2, 2.0, n - 1)] if n > 1 else np.ones(1)
    low, high = -rng.uniform(0.8, 1.0, g.shape[1]), rng.uniform(0.8, 1.0, g.shape[1])
    ball = float(rng.uniform(0.8, 1.0)) if two and rng.random() < 0.5 else 0.0
    most = rng.uniform(0.05, 0.45, k) * g[-1, 0]
    return Problem(
        a, g, e, rows, limits, low, high, ball, most,
        nodes={1: 81, 2: 61, 3: 31}[n], scheme=str(rng.choice(["upwind", "eno2", "eno3", "weno5"])),
        sample_time=float(rng.choice([0.002, 0.01, 0.02, 0.05])),
    )  # fmt: skip


@dataclass(frozen=True)
class Ran:
    """What became of the starts: how many, how many were lost, and the largest input beyond."""

    starts: int
    lost: int
    beyond: float
    infeasible: int
    kept: float


def ran(problem, rng, starts=40, seconds=6.0, most=400):
    """Starts with V above the margin, under commands and disturbances of every kind; None where
    the kernel is too small to have any."""
    system, region, grid = problem.built()
    solve = hf.discriminating_kernel if problem.e.shape[1] else hf.viability_kernel
    value = solve(system, region, grid, horizon=60, scheme=problem.scheme, threads=1)
    if not value.report.converged or value.fraction() < 0.05:
        return None
    keep = hf.SafetyFilter(system, value, sample_time=problem.sample_time)
    margin = next(p.value for p in keep.law.parameters if p.name == "safety_margin")
    n, m, h = len(problem.a), problem.g.shape[1], problem.sample_time
    half = np.array([a.high for a in grid.axes])
    q = rng.uniform(-half, half, (8000, n))
    told = keep.step_many(q, np.zeros((len(q), m)))
    inside = value.at(q) > 0
    kept = float((told.value[inside] > margin).mean())
    q = q[told.value > margin][: starts * len(FOES)]
    count = len(q)
    if not count:
        return Ran(0, 0, 0.0, 0, kept)
    foe = np.arange(count) % len(FOES)
    ends = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * len(problem.most))).reshape(
        len(problem.most), -1
    ).T * problem.most if len(problem.most) else np.zeros((1, 0))  # fmt: skip
    constant, switching = problem.pushes(count, rng), problem.pushes(count, rng)
    wanted = rng.uniform(-1.2, 1.2, (count, m))
    lowest, beyond, infeasible = np.full(count, np.inf), 0.0, 0
    for sample in range(min(int(seconds / h), most)):
        fresh = rng.random(count) < 0.05
        wanted[fresh] = rng.choice([-1.2, 0.0, 1.2], (int(fresh.sum()), m))
        told = keep.step_many(q, wanted, t=sample * h)
        u = told.input
        infeasible += sum(s is hf.Status.INFEASIBLE for s in told.status)
        over = (
            np.linalg.norm(u, axis=1) - problem.ball
            if problem.ball
            else np.maximum(u - problem.high, problem.low - u).max(axis=1)
        )
        beyond = max(beyond, float(over.max()))
        now = rng.random(count) < 0.1
        switching[now] = ends[rng.integers(len(ends), size=int(now.sum()))]
        after = np.stack([problem.step(q, u, np.tile(e, (count, 1)), h) for e in ends])
        next_values = np.stack([np.nan_to_num(value.at(x), nan=-9.0) for x in after])
        slopes = np.nan_to_num(value.gradient(np.clip(q, -half, half)))
        falls = np.stack(
            [(slopes * problem.rates(q, u, np.tile(e, (count, 1)))).sum(1) for e in ends]
        )
        d = np.select(
            [(foe == k)[:, None] for k in range(len(FOES))],
            [
                ends[falls.argmin(axis=0)], constant, switching, ends[next_values.argmin(axis=0)],
                problem.pushes(count, rng),
            ],
        )  # fmt: skip
        for _ in range(4):
            q = problem.step(q, u, d, h / 4)
            lowest = np.minimum(lowest, problem.room(q))
    return Ran(count, int((lowest < -1e-9).sum()), beyond, infeasible, kept)
