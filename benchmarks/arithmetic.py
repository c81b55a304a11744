"""The error of every elementary function, and the time of one value beside NumPy's.

    python benchmarks/arithmetic.py [--count 1e8]

Random arguments are compared with extended precision (64 bits of mantissa), and the worst of every
batch with multiple precision. The largest error is in units of the last place (ulp).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import mpmath
import numpy as np

from holdfast.execution.arithmetic import elementary
from holdfast.execution.arithmetic.steps import Steps
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.leaf import Leaves, columns, compiled_leaves

BATCH = 1_000_000
WORST = 20
Draw = Callable[[np.random.Generator, int], np.ndarray]


def uniform(low: float, high: float) -> Draw:
    return lambda g, n: g.uniform(low, high, n)


def spread(low: float, high: float, negative: bool = True) -> Draw:
    """Uniform in the logarithm, half of them negative."""

    def draw(g: np.random.Generator, n: int) -> np.ndarray:
        sizes = np.exp(g.uniform(np.log(low), np.log(high), n))
        return sizes * g.choice([-1.0, 1.0], n) if negative else sizes

    return draw


TURNS = (uniform(-10, 10), uniform(-1e6, 1e6), spread(1e-20, 1e300))
ROWS = {
    "sin": (lambda x: elementary.sine_and_cosine(x)[0], (TURNS,)),
    "cos": (lambda x: elementary.sine_and_cosine(x)[1], (TURNS,)),
    "tan": (elementary.tangent, (TURNS,)),
    "arcsin": (elementary.arcsine, ((uniform(-1, 1), spread(1e-20, 1)),)),
    "arccos": (elementary.arccosine, ((uniform(-1, 1), spread(1e-20, 1)),)),
    "arctan": (elementary.arctangent, ((uniform(-4, 4), spread(1e-20, 1e20)),)),
    "arctan2": (elementary.angle_of, ((uniform(-1, 1), spread(1e-20, 1e20)),) * 2),
    "exp": (elementary.exponential, ((uniform(-708, 709), uniform(-1, 1)),)),
    "log": (
        elementary.logarithm,
        ((uniform(0.5, 2), spread(1e-300, 1e300, negative=False)),),
    ),
    "power": (
        elementary.power,
        ((uniform(0, 3), spread(1e-60, 1e60, negative=False)), (uniform(-5, 5), uniform(0, 2))),
    ),
    "sinh": (elementary.hyperbolic_sine, ((uniform(-709, 709), uniform(-2, 2)),)),
    "cosh": (elementary.hyperbolic_cosine, ((uniform(-709, 709), uniform(-2, 2)),)),
    "tanh": (elementary.hyperbolic_tangent, ((uniform(-20, 20), uniform(-1, 1)),)),
}
"""NumPy's name -> (steps, the ways to draw each argument)."""

EXACT = {"arcsin": "asin", "arccos": "acos", "arctan": "atan", "arctan2": "atan2"}


def compiled(function: Callable, count: int) -> Leaves:
    steps = Steps(expanded=True)
    names = [f"x{i}" for i in range(count)]
    result = function(*map(steps.input, names))
    return compiled_leaves({"function": Leaf(steps, {"q": names}, [result])})


def ulps(found: np.ndarray, extended: np.ndarray) -> np.ndarray:
    unit = np.spacing(np.abs(extended.astype(np.float64)))
    return np.abs((found.astype(np.longdouble) - extended) / unit).astype(np.float64)


def exact_ulps(name: str, found: float, arguments: list[float]) -> float:
    with mpmath.workprec(1400):
        exact = getattr(mpmath, EXACT.get(name, name))(*(mpmath.mpf(a) for a in arguments))
        unit = float(np.spacing(abs(float(exact))))
        return float(abs(mpmath.mpf(found) - exact) / unit)


def measured(name: str, count: int, generator: np.random.Generator) -> tuple[float, list[float]]:
    """The largest error by multiple precision, and its arguments."""
    function, ways = ROWS[name]
    leaves, libm = compiled(function, len(ways)), getattr(np, name)
    largest, place, done = 0.0, [0.0] * len(ways), 0
    while done < count:
        n = min(BATCH, count - done) // 8 * 8
        turn = done // BATCH
        points = np.stack([draws[turn % len(draws)](generator, n) for draws in ways])
        out = np.empty((1, n))
        leaves.call("function", points, out)
        with np.errstate(all="ignore"):
            errors = ulps(out[0], libm(*points.astype(np.longdouble)))
        usable = np.isfinite(errors) & (np.abs(out[0]) > 1e-300)
        errors[~usable] = 0
        for k in np.argsort(errors)[-WORST:]:
            if errors[k] > largest - 0.01:
                error = exact_ulps(name, float(out[0, k]), points[:, k].tolist())
                if error > largest:
                    largest, place = error, points[:, k].tolist()
        done += max(n, 8)
    return largest, place


def timed(name: str, generator: np.random.Generator) -> tuple[float, float]:
    """Nanoseconds of a value, ours and NumPy's, on one core."""
    function, ways = ROWS[name]
    leaves, libm = compiled(function, len(ways)), getattr(np, name)
    points = np.stack([draws[0](generator, 1024) for draws in ways])
    points, out = columns(points.T, 1024), np.empty((1, 1024))
    best = [np.inf, np.inf]
    for _ in range(7):
        for k, work in enumerate(
            (lambda: leaves.call("function", points, out), lambda: libm(*points, out=out[0]))
        ):
            began = time.perf_counter()
            for _ in range(200):
                with np.errstate(all="ignore"):
                    work()
            best[k] = min(best[k], (time.perf_counter() - began) / 200 / 1024)
    return best[0] * 1e9, best[1] * 1e9


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=float, default=1e6)
    chosen = parser.parse_args()
    generator = np.random.default_rng(2024)
    print("| function | largest error, ulp | at | ns a value | NumPy's |")
    print("|---|---|---|---|---|")
    for name in ROWS:
        error, place = measured(name, int(chosen.count), generator)
        ours, libm = timed(name, generator)
        at = ", ".join(f"{a:.17g}" for a in place)
        print(f"| {name} | {error:.3f} | {at} | {ours:.1f} | {libm:.1f} |", flush=True)


if __name__ == "__main__":
    main()
