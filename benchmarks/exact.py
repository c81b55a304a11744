"""Problems of viability whose value is known in closed form, at every state.

V is the margin that is left at the worst moment of the best way, so it follows from how far that
way goes. Numbered as in the list of exact kernels that the tests know them from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy as sp

import holdfast as hf
from holdfast.analysis.reachability.grid import Grid

Array = np.ndarray

X, Y, V, U, W, D, TH = (hf.symbol(n) for n in ("x", "y", "v", "u", "w", "d", "theta"))


@dataclass(frozen=True)
class Exact:
    """`value` of the states is that of `find` on the grids, each twice as fine as the one before.

    near: how far from zero a node still counts as one near the boundary. volume: of the set.
    points: states where V = 0, looked at in place of nodes.
    """

    name: str
    what: str
    find: Callable[..., hf.ValueFunction]
    system: hf.System
    regions: tuple[Any, ...]
    box: Mapping[str, tuple[float, float]]
    cells: tuple[tuple[int, ...], ...]
    horizon: float
    value: Callable[..., Array] | None = None
    near: float = 0.1
    volume: float | None = None
    points: Array | None = None
    ends: Mapping[str, str] = field(default_factory=dict)

    def grid(self, level: int) -> Grid:
        counts = {
            q.name: n + ((self.box[q.name][1] - self.box[q.name][0] < 6.28) or not q.angle)
            for q, n in zip(self.system.states, self.cells[level], strict=True)
        }
        return hf.grid(self.system, self.box, counts, self.ends)

    def march(self, level: int, scheme: str, **options: Any) -> hf.ValueFunction:
        return self.find(
            self.system, *self.regions, self.grid(level), self.horizon, scheme=scheme, **options
        )

    def exactly(self, grid: Grid) -> Array:
        assert self.value is not None
        at = np.meshgrid(*(a.nodes for a in grid.axes), indexing="ij", sparse=True)
        return np.broadcast_to(self.value(*at), grid.shape)


def quantities(*names: str) -> tuple[hf.Quantity, ...]:
    return tuple(hf.Quantity(n, "1") for n in names)


def region(*expressions: sp.Expr, reads: tuple[str, ...] = ("x",)) -> hf.Region:
    rows = tuple(hf.Inequality(f"c{i}", e) for i, e in enumerate(expressions))
    return hf.Region("K", quantities(*reads), rows, empirical="numbers")


def doubled(*coarsest: int, levels: int = 3) -> tuple[tuple[int, ...], ...]:
    return tuple(tuple(n << k for n in coarsest) for k in range(levels))


def drift() -> Exact:
    """x' = 1 towards x + 0.3 sin 2x <= 0: a value without a kink, for the orders themselves."""
    system = hf.System(
        "drift", quantities("x", "y"), quantities("u"), {"x": sp.Integer(1), "y": U},
        input_bounds=hf.Box((-1,), (1,)),
        empirical="numbers",
    )  # fmt: skip
    return Exact(
        "smooth", "a drift to a wall, in two dimensions", hf.viability_kernel, system,
        (region(X + 0.3 * sp.sin(2 * X)),), {"x": (-3, 3), "y": (-1, 1)}, doubled(24, 8, levels=4),
        1.0, lambda x, y: -(x + 1 + 0.3 * np.sin(2 * (x + 1))), near=0.5,
        ends={"x": "extrapolated", "y": "extrapolated"},
    )  # fmt: skip


def nearly_balanced(rng: np.random.Generator) -> Array:
    """Two velocities of which each raises one of two states and lowers the other; along some
    positive direction both fall, by .005 to .2, so that no mix of them stays in a square."""
    while True:
        a = rng.uniform(0.2, 1.0, 2)
        a /= np.hypot(*a)
        along, fall = rng.uniform(-1.5, 1.5, 2), np.exp(rng.uniform(*np.log((0.005, 0.2)), 2))
        pair = along[:, None] * np.array([-a[1], a[0]]) - fall[:, None] * a
        if (pair.max(axis=0) > 0.05).all() and (pair.min(axis=0) < -0.05).all():
            return np.asarray(pair)


def population() -> Exact:
    """A1: J.-P. Aubin, P. Saint-Pierre; x is at x exp(y |y| / 2c) when y has been stopped."""
    a, b, c = 0.2, 3.0, 0.5
    system = hf.System(
        "population", quantities("x", "y"), quantities("u"), {"x": X * Y, "y": U},
        input_bounds=hf.Box((-c,), (c,)),
        empirical="numbers",
    )  # fmt: skip

    def value(x: Array, y: Array) -> Array:
        end = x * np.exp(y * np.abs(y) / (2 * c))
        return np.minimum(np.minimum(x, end) - a, b - np.maximum(x, end))

    return Exact(
        "A1", "population", hf.viability_kernel, system, (region(a - X, X - b),),
        {"x": (0.05, 3.15), "y": (-2.2, 2.2)}, doubled(50, 50), 12.0, value, volume=6.051494,
    )  # fmt: skip


def braking() -> Exact:
    """A2: |x| <= 1 with v' = u + d; x is at x + v |v| / 2w when v has been stopped."""
    left = 0.5
    system = hf.System(
        "braking", quantities("x", "v"), quantities("u"), {"x": V, "v": U + D},
        disturbances=quantities("d"), input_bounds=hf.Box((-1,), (1,)),
        disturbance_bounds=hf.Box((-0.5,), (0.5,)),
        empirical="numbers",
    )  # fmt: skip
    return Exact(
        "A2", "braking before two walls, disturbed", hf.discriminating_kernel, system,
        (region(X - 1, -1 - X),), {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}, doubled(50, 50), 4.0,
        lambda x, v: 1 - np.maximum(np.abs(x), np.abs(x + v * np.abs(v) / (2 * left))),
        volume=16 / 3 * math.sqrt(left),
    )  # fmt: skip


def unstable(dimension: int, cells: int, levels: int) -> Exact:
    """A4: x_i' = lambda_i x_i + u_i + d_i; of |x_i| <= 1 is left m + (1 - m) exp(-lambda_i).

    m = w / lambda is where the best input holds its own. 100 points on every face.
    """
    names = [f"x{i}" for i in range(dimension)]
    lam = np.array([1.0, 0.5, 1.5, 0.8, 1.2, 0.6])[:dimension]
    most = np.array([0.6, 0.5, 0.8, 0.7, 0.9, 0.5])[:dimension]
    against = np.array([0.1, 0.2, 0.2, 0.3, 0.3, 0.1])[:dimension]
    system = hf.System(
        "unstable", quantities(*names), quantities(*(f"u{i}" for i in range(dimension))),
        {n: float(k) * hf.symbol(n) + hf.symbol(f"u{i}") + hf.symbol(f"d{i}")
         for i, (n, k) in enumerate(zip(names, lam, strict=True))},
        disturbances=quantities(*(f"d{i}" for i in range(dimension))),
        input_bounds=hf.Box(tuple(-most), tuple(most)),
        disturbance_bounds=hf.Box(tuple(-against), tuple(against)),
        empirical="numbers",
    )  # fmt: skip
    rest, seconds = (most - against) / lam, 1.0
    left = rest + (1 - rest) * np.exp(-lam * seconds)
    points = np.random.default_rng(4).uniform(-left, left, (2 * dimension, 100, dimension))
    for face, at in enumerate(points):
        at[:, face // 2] = (-1) ** face * left[face // 2]
    rows = [sign * hf.symbol(n) - 1 for n in names for sign in (1, -1)]
    return Exact(
        f"A4, {dimension}-D", "unstable lines, disturbed, 1 s", hf.discriminating_kernel, system,
        (region(*rows, reads=tuple(names)),), dict.fromkeys(names, (-1.25, 1.25)),
        doubled(*[cells] * dimension, levels=levels), seconds, points=points.reshape(-1, dimension),
    )  # fmt: skip


def turning() -> Exact:
    """A5: y <= 0.5 for a vehicle that drifts towards the wall while it turns; y gains g(theta)."""
    speed, current, wall, low = 1.0, 0.5, 0.5, -2.5
    theta = hf.Quantity("theta", "rad", angle=True)
    system = hf.System(
        "turning", (hf.Quantity("y", "m"), theta), quantities("u"),
        {"y": speed * sp.sin(TH) + current, "theta": U}, input_bounds=hf.Box((-1,), (1,)),
        empirical="numbers",
    )  # fmt: skip
    still = -math.asin(current / speed)

    def gain(angle: Array) -> Array:
        turned = np.where(angle >= still, angle, angle + 2 * math.pi)
        right = math.cos(still) - np.cos(turned) + current * (turned - still)
        left = np.cos(turned) + math.cos(still) + current * (math.pi - still - turned)
        return np.where(turned < math.pi - still, np.minimum(right, left), 0.0)

    middle = -math.pi + 2 * math.pi * (np.arange(1_000_000) + 0.5) / 1_000_000
    return Exact(
        "A5", "turning before a wall in a current", hf.viability_kernel, system,
        (region(Y - wall, reads=("y",)),), {"y": (low, 1.0), "theta": (-math.pi, math.pi)},
        doubled(50, 48), 6.0, lambda y, angle: wall - y - gain(angle),
        volume=float(2 * math.pi * (wall - low - gain(middle)).mean()), ends={"y": "limited"},
    )  # fmt: skip


def zermelo() -> Exact:
    """A6: a boat in a current to a disc; from (x, y) the discs around (x + V t, y) are in reach."""
    current, radius, seconds = 0.5, 0.4, 1.2
    system = hf.System(
        "boat", quantities("x", "y"), quantities("u", "w"), {"x": current + U, "y": W},
        input_bounds=hf.Ball(sp.Float(1.0), 2),
        empirical="numbers",
    )  # fmt: skip
    disc = region(sp.sqrt(X**2 + Y**2) - radius, reads=("x", "y"))
    return Exact(
        "A6", "a boat in a current to a disc", hf.capture_basin, system, (disc, None),
        {"x": (-3.5, 2.5), "y": (-2.5, 2.5)}, doubled(60, 50), seconds,
        lambda x, y: radius - np.maximum(np.hypot(x + current * seconds, y) - seconds, 0.0),
        volume=math.pi * (radius + seconds) ** 2,
    )  # fmt: skip


def cart() -> hf.System:
    return hf.System(
        "cart", quantities("x", "v"), quantities("u"), {"x": V, "v": U},
        input_bounds=hf.Box((-1,), (1,)),
        empirical="numbers",
    )  # fmt: skip


def double_integrator() -> Exact:
    """A7 (M. Athans, P. Falb, 7-26): within 1 s of the states within 1 s of rest at 0.

    Those within T are between x = +-(T^2 -+ 2 T v - v^2) / 4; the margin is that along x.
    """
    x = (1 - 2 * V - V**2) / 4 - X, X + (1 + 2 * V - V**2) / 4
    v = np.linspace(-1.9, 1.9, 77)
    right, left = (4 - 4 * v - v**2) / 4, -(4 + 4 * v - v**2) / 4
    return Exact(
        "A7", "double integrator to rest", hf.capture_basin, cart(),
        (region(*(-margin for margin in x), reads=("x", "v")), None),
        {"x": (-2.5, 2.5), "v": (-2.2, 2.2)}, doubled(50, 50), 1.0, volume=2 / 3 * 2.0**3,
        points=np.concatenate([np.stack([side, v], axis=1) for side in (right, left)]),
    )  # fmt: skip


def double_integrator_by_time() -> Exact:
    """The same with 1 s less the least time for the margin: its slope is without bound."""
    least = hf.parse_expression(
        "v + sqrt(max(4*x + 2*v**2, 0)) if x > -0.5*v*abs(v) else -v + sqrt(max(-4*x + 2*v**2, 0))",
        {"x": X, "v": V},
    )

    def value(x: Array, v: Array) -> Array:
        side = np.where(x > -0.5 * v * np.abs(v), 1.0, -1.0)
        time = side * v + np.sqrt(np.maximum(4 * side * x + 2 * v**2, 0.0))
        return 1 - np.maximum(time - 1, 0.0)

    return Exact(
        "A7, by time", "the same, from the least time", hf.capture_basin, cart(),
        (region(least - 1, reads=("x", "v")), None), {"x": (-2.5, 2.5), "v": (-2.2, 2.2)},
        doubled(50, 50), 1.0, value, volume=2 / 3 * 2.0**3,
    )  # fmt: skip


def aircraft() -> Exact:
    """A9: points of the left barrier, by ways back from the edge of the usable part (air3D)."""
    psi, turn, other = (hf.symbol(n) for n in ("psi", "a", "b"))
    system = hf.System(
        "air3d", (*quantities("x", "y"), hf.Quantity("psi", "rad", angle=True)), quantities("a"),
        {"x": -5 + 5 * sp.cos(psi) + turn * Y, "y": 5 * sp.sin(psi) - turn * X,
         "psi": other - turn},
        disturbances=quantities("b"),
        input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-1,), (1,)),
        empirical="numbers",
    )  # fmt: skip
    points = []
    for start in (math.pi / 3, math.pi / 2, 2.0):
        for back in np.linspace(0.1, 0.45, 8):  # before it meets the right one
            way = np.exp(1j * back) - 1 + np.exp(1j * start) * (np.exp(-1j * back) - 1)
            z = 5 * np.exp(-1j * back) * (np.exp(0.5j * start) - 1j * way)
            points.append([z.real, z.imag, (start - 2 * back) % (2 * math.pi)])
    return Exact(
        "A9", "barrier of two aircraft, 2.8 s", hf.discriminating_kernel, system,
        (region(5 - sp.sqrt(X**2 + Y**2), reads=("x", "y")),),
        {"x": (-6, 20), "y": (-10, 10), "psi": (0, 2 * math.pi)}, doubled(26, 20, 24), 2.8,
        points=np.array(points), ends={"x": "extrapolated", "y": "extrapolated"},
    )  # fmt: skip


PROBLEMS = {
    "smooth": drift,
    "A1": population,
    "A2": braking,
    "A4-2": lambda: unstable(2, 20, 3),
    "A4-3": lambda: unstable(3, 20, 3),
    "A4-4": lambda: unstable(4, 10, 3),
    "A4-5": lambda: unstable(5, 8, 2),
    "A4-6": lambda: unstable(6, 6, 2),
    "A5": turning,
    "A6": zermelo,
    "A7": double_integrator,
    "A7-time": double_integrator_by_time,
    "A9": aircraft,
}
