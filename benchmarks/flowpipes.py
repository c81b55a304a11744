"""Flowpipes of published problems: what is proved from one box, how long it takes, and checked.

    python benchmarks/flowpipes.py [--only NAME]

writes `benchmarks/flowpipes.json`. Problems of the ARCH competition (nonlinear continuous systems):

* van-der-pol: x' = y, y' = (1 - x^2) y - x from [1.25, 1.55] x [2.35, 2.45] has y <= 2.75 for 7 s.
* lotka-volterra: x' = 3 x - 3 x y, y' = x y - y from 1.3 +- 0.012, 1 ends after 3.64 s in a box;
  `lotka-volterra-guard` is that of 2020: from 1.3 +- 0.008 it is within 0.15 of (1, 1), which it
  touches, for 0.2 s at most. Time is counted there by a rate that rises from 0 to 1 across the
  circle, which is 1 all over it. That of later years counts crossings, which no region says.
* robertson: x' = -0.4 x + 100 y z, z' = 1000 y^2, y' = -x' - z' from (1, 0, 0) keeps
  |x + y + z - 1| small for 40 s (the least stiff of three).
* docking: a spacecraft approaches from 25 m about (-900, -400) m with one gain until x = -100 m,
  then with another: after that it stays in a cone and below 3.3 m/min until 200 min; at some time
  from 120 to 150 min it drifts, and comes nowhere near its target. The switch is that of the
  original, at x = -100 m exactly: none pass it before 108 min (`docking-before`), all do by 112
  min, in a set of y and velocities (`docking-far`). From a box around that set `docking-near` keeps
  cone and speed. 8 min later all are in a box (`docking-braked`), and for 34 min more near a ray
  that leads past the target (`docking-abort`): whenever one drifts from there, it stays 1 m off the
  target for 80 min (`docking-drift`), whose box has sides of 0.2 m.
* unicycle: a car, steered by a network of 500 neurons (`unicycle_network.json`) at samples of
  0.2 s while its acceleration is off by up to 1e-4 at any instant, is at its goal after 10 s.

Seconds are those of this machine.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
import time
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

import holdfast as hf
from holdfast.maths.expressions.functions import greatest, least, magnitude
from holdfast_check.checker import checked

RECORD = Path(__file__).with_suffix(".json")
NETWORK = Path(__file__).with_name("unicycle_network.json")
FIRST = {"x": (-925, -875), "y": (-425, -375), "vx": (0, 0), "vy": (0, 0)}
MU, RADIUS, MASS = 3.986e14 * 60**2, 42164e3, 500.0
FAR = [[-28.8287, 0.1005, -1449.9754, 0.0046], [-0.087, -33.2562, 0.00462, -1451.5013]]
NEAR = [[-288.0288, 0.1312, -9614.9898, 0.0], [-0.1312, -288.0, 0.0, -9614.9883]]
PASSING = {"y": (-35.0, -28.5), "vx": (1.99, 2.01), "vy": (0.64, 0.82)}
"""A box of all that pass x = -100 m."""
ALONG, ASIDE, LATER = 0.02, 0.0231, 0.03
"""Velocities are near -k (x, y): these k of x and of y where x is -100 m, and of both later."""
OFF = 0.01
"""By how much they are off that [m/min]."""
BRAKED = {"x": (-79.5, -77.5), "q": (-28.0, -22.0), "sx": (-OFF, OFF), "sy": (-OFF, OFF)}
"""Where all are 8 min after they pass x = -100 m: q = y, sx = vx + k x, sy = vy + k y."""
SLOPE, ASKEW = 0.32, 0.06
"""y / x afterwards, and by how much it is off."""
AWRY = 2 * OFF
ABORTED = {
    "x": (-80.0, -27.0), "q": (-80 * ASKEW, 80 * ASKEW), "sx": (-AWRY, AWRY), "sy": (-AWRY, AWRY),
}  # fmt: skip
"""Where they drift from, q = y - SLOPE x."""
x, y, z, vx, vy, q, sx, sy = map(hf.symbol, ("x", "y", "z", "vx", "vy", "q", "sx", "sy"))
THETA, V, COUNT = map(hf.symbol, ("theta", "v", "count"))


def system(name: str, rates: dict[str, Any]) -> hf.System:
    return hf.System(name, tuple(hf.Quantity(n, "") for n in rates), (), rates, empirical="numbers")


def region(of: hf.System, *limits: Any) -> hf.Region:
    rows = tuple(hf.Inequality(f"c{k}", e) for k, e in enumerate(limits))
    return hf.Region("bounds", of.states, rows, empirical="numbers")


def spacecraft(name: str, gains: list[list[float]]) -> hf.System:
    n = (MU / RADIUS**3) ** 0.5
    cubed = ((1 + x / RADIUS) ** 2 + (y / RADIUS) ** 2) ** sp.Rational(-3, 2)
    ux, uy = np.array(gains) @ np.array([x, y, vx, vy]) / MASS
    pull = MU / RADIUS**2
    return system(name, {
        "x": vx, "y": vy,
        "vx": n**2 * x + 2 * n * vy + pull * (1 - cubed * (1 + x / RADIUS)) + ux,
        "vy": n**2 * y - 2 * n * vx - MU / RADIUS**3 * cubed * y + uy,
    })  # fmt: skip


def van_der_pol() -> hf.Flowpipe:
    of = system("van-der-pol", {"x": y, "y": (1 - x**2) * y - x})
    start = {"x": (1.25, 1.55), "y": (2.35, 2.45)}
    return hf.flowpipe(of, region(of, y - 2.75), start=start, horizon=7)


def lotka_volterra() -> hf.Flowpipe:
    of = system("lotka-volterra", {"x": 3 * x - 3 * x * y, "y": x * y - y})
    start = {"x": (1.288, 1.312), "y": (1.0, 1.0)}
    return hf.flowpipe(of, region(of, x - 2, y - 2), start=start, horizon=3.64)


def lotka_volterra_guard() -> hf.Flowpipe:
    within = 0.15**2 - (x - 1) ** 2 - (y - 1) ** 2
    of = system("lotka-volterra", {
        "x": 3 * x - 3 * x * y, "y": x * y - y, "count": greatest(0, least(1, 1 + 3000 * within)),
    })  # fmt: skip
    start = {"x": (1.292, 1.308), "y": (1.0, 1.0), "count": (0.0, 0.0)}
    return hf.flowpipe(of, region(of, COUNT - 0.2), start=start, horizon=3.64, tolerance=1e-4)


def robertson() -> hf.Flowpipe:
    first, last = -0.4 * x + 100 * y * z, 1000 * y**2
    of = system("robertson", {"x": first, "y": -first - last, "z": last})
    return hf.flowpipe(
        of, region(of, magnitude(x + y + z - 1) - 1e-4),
        start={"x": (1, 1), "y": (0, 0), "z": (0, 0)}, horizon=40, degrees=(1, 5), tolerance=1e-12,
    )  # fmt: skip


def between(e: Any, low: float, high: float) -> list[Any]:
    return [low - e, e - high]


def docking_before() -> hf.Flowpipe:
    of = spacecraft("far", FAR)
    return hf.flowpipe(
        of, region(of, x + 100), start=FIRST, horizon=108, degrees=(1, 6), tolerance=0.01
    )


def docking_far() -> hf.Flowpipe:
    of = spacecraft("far", FAR)
    passing = [
        *between(y - 0.32 * (x + 100), *PASSING["y"]),
        *between(vx + ALONG * x, -OFF, OFF), *between(vy + ASIDE * y, -OFF, OFF),
    ]  # fmt: skip
    return hf.flowpipe(
        of, region(of, least(x + 100.001, reduce(greatest, passing))), target=region(of, -x - 100),
        start=FIRST, horizon=112, degrees=(1, 6), tolerance=0.01,
    )  # fmt: skip


def docking_near() -> hf.Flowpipe:
    of = spacecraft("near", NEAR)
    most, corner = (0.055 * 60 * f(np.pi / 8) for f in (np.cos, np.sin))
    ways = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
    slow = [a * vx + b * vy - (most + corner if a and b else most) for a, b in ways]
    slope = float(np.tan(np.pi / 6))
    cone = [-100 - x, slope * x - y, slope * x + y]
    return hf.flowpipe(
        of, region(of, *slow, *cone), start={"x": (-100, -100), **PASSING}, horizon=92,
        degrees=(1, 6), tolerance=1e-3,
    )  # fmt: skip


def beside(name: str, gains: list[list[float]], kx: float, ky: float, slope: float) -> hf.System:
    """The spacecraft in x, q = y - slope x, sx = vx + kx x and sy = vy + ky y."""
    of = spacecraft(name, gains)
    there = {y: q + slope * x, vx: sx - kx * x, vy: sy - ky * (q + slope * x)}
    rates = {n: sp.sympify(e).subs(there, simultaneous=True) for n, e in of.rates.items()}
    return system(name, {
        "x": rates["x"], "q": rates["y"] - slope * rates["x"],
        "sx": rates["vx"] + kx * rates["x"], "sy": rates["vy"] + ky * rates["y"],
    })  # fmt: skip


def docking_braked() -> hf.Flowpipe:
    of = beside("near", NEAR, ALONG, ASIDE, 0.0)
    later = {"x": x, "q": q, "sx": sx + (LATER - ALONG) * x, "sy": sy + (LATER - ASIDE) * q}
    ends = [e for n, value in later.items() for e in between(value, *BRAKED[n])]
    start = {"x": (-100, -100), "q": PASSING["y"], "sx": (-OFF, OFF), "sy": (-OFF, OFF)}
    return hf.flowpipe(
        of, region(of, x), target=region(of, *ends), start=start, horizon=8,
        degrees=(1, 6), tolerance=1e-3,
    )  # fmt: skip


def docking_abort() -> hf.Flowpipe:
    of = beside("near", NEAR, LATER, LATER, 0.0)
    ahead = [q - (SLOPE - ASKEW) * x, (SLOPE + ASKEW) * x - q, *between(x, *ABORTED["x"])]
    slow = [*between(sx, *ABORTED["sx"]), *between(sy, *ABORTED["sy"])]
    return hf.flowpipe(
        of, region(of, *ahead, *slow), start=BRAKED, horizon=34, degrees=(1, 6), tolerance=1e-3
    )


def docking_drift() -> hf.Flowpipe:
    of = beside("drifting", [[0.0] * 4] * 2, LATER, LATER, SLOPE)
    there = q + SLOPE * x
    near = reduce(least, (1 + x, 1 - x, 1 + there, 1 - there))
    return hf.flowpipe(
        of, region(of, near), start=ABORTED, horizon=80, degrees=(1, 6), tolerance=0.01
    )


def unicycle() -> hf.Flowpipe:
    units = {"x": "m", "y": "m", "theta": "rad", "v": "m/s", "u1": "m/s^2", "u2": "rad/s"}
    *states, u1, u2 = (hf.Quantity(name, unit) for name, unit in units.items())
    w = hf.Quantity("w", "m/s^2")
    rates = {"x": V * sp.cos(THETA), "y": V * sp.sin(THETA)}
    of = hf.System(
        "unicycle", tuple(states), (u1, u2),
        {**rates, "theta": u2.symbol, "v": u1.symbol + w.symbol},
        disturbances=(w,), disturbance_bounds=hf.Box((-1e-4,), (1e-4,)),
        empirical="numbers",
    )  # fmt: skip
    network = json.loads(NETWORK.read_text())

    def layer(rows: list[list[float]], values: Any) -> list[Any]:
        return [
            greatest(0, sp.Add(*(a * q for a, q in zip(r, values, strict=False)), r[-1]))
            for r in rows
        ]

    hidden = layer(network["hidden"], [q.symbol for q in states])
    turn = [e - 20 for e in layer(network["outputs"], hidden)]
    law = hf.Law(
        "network",
        of.states,
        dict(zip(("u1", "u2"), turn, strict=True)),
        empirical="numbers",
    )
    goal = {x: 0.6, y: 0.2, THETA: 0.06, V: 0.3}
    there = [e for q, most in goal.items() for e in between(q, -most, most)]
    start = {"x": (9.5, 9.55), "y": (-4.5, -4.45), "theta": (2.1, 2.11), "v": (1.5, 1.51)}
    return hf.flowpipe(
        of, region(of, x - 20), target=region(of, *there), start=start, horizon=10, law=law,
        sample_time=0.2, degrees=(1, 4), tolerance=1e-3, parts=64,
    )  # fmt: skip


PROBLEMS = {
    "van-der-pol": van_der_pol, "lotka-volterra": lotka_volterra,
    "lotka-volterra-guard": lotka_volterra_guard, "robertson": robertson,
    "docking-before": docking_before, "docking-far": docking_far, "docking-near": docking_near,
    "docking-braked": docking_braked, "docking-abort": docking_abort,
    "docking-drift": docking_drift, "unicycle": unicycle,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=PROBLEMS)
    only = parser.parse_args().only
    record = json.loads(RECORD.read_text()) if only and RECORD.exists() else {}
    record["machine"] = f"{platform.machine()}, Python {platform.python_version()}"
    for name in [only] if only else PROBLEMS:
        begun = time.perf_counter()
        pipe = PROBLEMS[name]()
        row: dict[str, Any] = {"found": round(time.perf_counter() - begun, 1), **pipe.summary()}
        if pipe.proved:
            with tempfile.TemporaryDirectory() as folder:
                path = pipe.write(Path(folder) / "a.flowpipe")
                begun = time.perf_counter()
                row["valid"] = checked(str(path))["valid"]
                row |= {"checked": round(time.perf_counter() - begun, 1)}
                row["bytes"] = path.stat().st_size
        record[name] = row
        print(name, row, file=sys.stderr, flush=True)
        RECORD.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
