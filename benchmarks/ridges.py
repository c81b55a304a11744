"""Kernels beside hj_reachability: where a scheme stands still though the equation does not.

The same grid, margin, dissipation and horizon, fifth-order slopes with Runge-Kutta of third order,
double precision, in one process; ours ends at its rest, which it confirms by the filtered scheme,
theirs has no rest and goes to the horizon. docs/benchmarks.md has the table.

python -m pip install -e ".[benchmark]" && python benchmarks/ridges.py
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import jax
import numpy as np
from exact import PROBLEMS, Exact, nearly_balanced, region
from level_sets import LevelSet, Peer

import holdfast as hf

SEEDS, MOST = 40, 30.0
"""Random pairs of velocities, of which those count that lose all within so many seconds; they are
marched for twice as long."""

Array = np.ndarray


@dataclass(frozen=True)
class Kernel(LevelSet):
    """The kernel for ever, asked for with a horizon [s]; steps are not counted.

    judge: of the share of the region that is kept, and the values, what is to be said of them.
    """

    horizon: float = 0.0
    judge: Callable[[Array], str] = lambda values: ""

    @property
    def final(self) -> float:
        return self.horizon

    def share(self, values: Array) -> float:
        return float((values > 0).sum() / (self.margin > 0).sum())


def modes(name: str, first: tuple[float, float], other: tuple[float, float], nodes: int) -> Kernel:
    """The unit square under a mix of two velocities of which a combination of states falls."""
    m, x, y = (hf.symbol(n) for n in ("m", "x", "y"))
    system = hf.System(
        "modes", (hf.Quantity("x"), hf.Quantity("y")), (hf.Quantity("m"),),
        {n: a + (b - a) * m for n, a, b in zip("xy", first, other, strict=True)},
        input_bounds=hf.Box((0,), (1,)),
    )  # fmt: skip
    square = region(-x, x - 1, -y, y - 1, reads=("x", "y"))
    grid = hf.grid(system, {"x": (-0.1, 1.1), "y": (-0.113, 1.1)}, nodes=nodes)
    return Kernel(
        name, hf.viability_kernel, system, square, grid, 0, horizon=70.0,
        judge=lambda values: "empty is right" if (values <= 0).all() else "false",
    )  # fmt: skip


def converter(nodes: int) -> Kernel:
    """DC-DC boost converter of A. Girard, G. Poessl, M. Zamani; one of its corners is lost."""
    i, v, m = (hf.symbol(n) for n in ("i", "v", "m"))
    system = hf.System(
        "converter", (hf.Quantity("i"), hf.Quantity("v")), (hf.Quantity("m"),),
        {
            "i": 1 / 3 - 0.05 / 3 * i - m * ((0.005 / 1.005) / 3 * i + v / (1.005 * 15)),
            "v": -v / (70 * 1.005) + m * 5 * i / (1.005 * 70),
        },
        input_bounds=hf.Box((0,), (1,)),
    )  # fmt: skip
    limits = region(1.15 - i, i - 1.55, 5.45 - v, v - 5.85, reads=("i", "v"))
    grid = hf.grid(system, {"i": (1.13, 1.57), "v": (5.43, 5.87)}, nodes=nodes)
    at = [round((s - a.low) / a.step) for s, a in zip((1.16, 5.455), grid.axes, strict=True)]

    def judge(values: Array) -> str:
        return "false: keeps the corner" if values[tuple(at)] > 0 else "loses the corner"

    return Kernel(
        "DC-DC converter", hf.viability_kernel, system, limits, grid, 0, horizon=60.0, judge=judge
    )


def exact(problem: Exact, level: int) -> Kernel:
    """A kernel whose value is known; judged by the mean error of the value near the boundary."""
    grid = problem.grid(level)
    exactly = problem.exactly(grid)

    def judge(values: Array) -> str:
        return f"error {np.abs(values - exactly)[np.abs(exactly) <= problem.near].mean():.1e}"

    return Kernel(
        problem.what, problem.find, problem.system, problem.regions[0], grid, 0,
        horizon=problem.horizon, judge=judge,
    )  # fmt: skip


def lost(seed: int) -> Kernel | None:
    """A random pair of velocities that takes all from the square within `MOST` seconds."""
    pair = nearly_balanced(np.random.default_rng(seed)).round(3)
    fall = np.linalg.solve(pair, (-1.0, -1.0))  # this combination falls by 1 a second
    after = float(fall.sum())
    if after > MOST or (fall < 0).any():
        return None
    first, other = ((float(x), float(y)) for x, y in pair)
    return replace(modes(f"pair {seed}", first, other, 41), horizon=2 * after)


def pairs() -> list[str]:
    """How many of all pairs both keep, though all is lost, in place of what one keeps."""
    kernels = [k for seed in range(SEEDS) if (k := lost(seed))]
    both = [row(k) for k in kernels]
    ours, theirs = (sum(r[place] == "false" for r in both) for place in (3, 6))
    taken, longer = (sum(float(r[place]) for r in both) for place in (4, 7))
    of = f"of {len(both)}"
    return [
        "random pairs of velocities", "41 x 41", "", f"{ours} {of} false", f"{taken:.1f}",
        "", f"{theirs} {of} false", f"{longer:.1f}", f"{longer / taken:.1f}",
    ]  # fmt: skip


def kernels() -> Iterator[Kernel]:
    yield modes("two modes", (1, -0.3), (-0.3, 0.05), 61)
    yield converter(41)
    yield converter(81)
    for name in ("A1", "A2", "A5"):
        yield exact(PROBLEMS[name](), 1)


def seconds(march: Callable[[], Array]) -> tuple[Array, float]:
    """The values, and the seconds of a call, after one that compiles."""
    march()
    began = time.perf_counter()
    values = march()
    return values, time.perf_counter() - began


def row(kernel: Kernel) -> list[str]:
    """What both keep of the region, what is to be said of it, and how long it took."""

    def ours() -> Array:
        posed = kernel.system, kernel.region, kernel.grid, kernel.horizon
        return kernel.find(*posed, dissipation="local").values()

    values, taken = seconds(ours)
    peer = Peer(kernel, "weno5")
    others, longer = seconds(lambda: peer.march()[0])
    return [
        kernel.name, " x ".join(map(str, kernel.grid.shape)),
        f"{100 * kernel.share(values):.1f} %", kernel.judge(values), f"{taken:.2f}",
        f"{100 * kernel.share(others):.1f} %", kernel.judge(others), f"{longer:.2f}",
        f"{longer / taken:.1f}",
    ]  # fmt: skip


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    head = ["kernel", "nodes", "kept", "", "s", "peer keeps", "", "s", "ratio"]
    for line in (head, ["---"] * len(head)):
        print("| " + " | ".join(line) + " |", flush=True)
    for kernel in kernels():
        print("| " + " | ".join(row(kernel)) + " |", flush=True)
    print("| " + " | ".join(pairs()) + " |", flush=True)


if __name__ == "__main__":
    main()
