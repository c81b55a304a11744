"""Flowpipes of published problems: what is proved from one box, how long it takes, and checked.

    python benchmarks/flowpipes.py [--only NAME]

writes `benchmarks/flowpipes.json`. Problems of the ARCH competition (nonlinear continuous systems):

* van-der-pol: x' = y, y' = (1 - x^2) y - x from [1.25, 1.55] x [2.35, 2.45] has y <= 2.75 for 7 s.
* lotka-volterra: x' = 3 x - 3 x y, y' = x y - y from 1.3 +- 0.012, 1 ends after 3.64 s in a box;
  the guard of the original is left out, and with it the time that is spent inside a circle.
* robertson: x' = -0.4 x + 100 y z, z' = 1000 y^2, y' = -x' - z' from (1, 0, 0) keeps
  |x + y + z - 1| small for 40 s (the least stiff of three).
* docking: a spacecraft approaches from 25 m about (-900, -400) m with one gain until x = -100 m,
  then with another: after that it stays in a cone and below 3.3 m/min, until 200 min. The switch is
  that of the original, at x = -100 m exactly: `docking-far` proves that all pass it within a box of
  y and velocities, and `docking-near` that all from this box at x = -100 m do what is asked.

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
MU, RADIUS, MASS = 3.986e14 * 60**2, 42164e3, 500.0
FAR = [[-28.8287, 0.1005, -1449.9754, 0.0046], [-0.087, -33.2562, 0.00462, -1451.5013]]
NEAR = [[-288.0288, 0.1312, -9614.9898, 0.0], [-0.1312, -288.0, 0.0, -9614.9883]]
PASSING = {"y": (-35.0, -26.0), "vx": (1.8, 2.05), "vy": (0.6, 0.85)}
x, y, z, vx, vy = map(hf.symbol, ("x", "y", "z", "vx", "vy"))


def system(name: str, rates: dict[str, Any]) -> hf.System:
    return hf.System(name, tuple(hf.Quantity(n, "") for n in rates), (), rates)


def region(of: hf.System, *limits: Any) -> hf.Region:
    rows = tuple(hf.Inequality(f"c{k}", e) for k, e in enumerate(limits))
    return hf.Region("bounds", of.states, rows)


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


def robertson() -> hf.Flowpipe:
    first, last = -0.4 * x + 100 * y * z, 1000 * y**2
    of = system("robertson", {"x": first, "y": -first - last, "z": last})
    return hf.flowpipe(
        of, region(of, magnitude(x + y + z - 1) - 1e-4),
        start={"x": (1, 1), "y": (0, 0), "z": (0, 0)}, horizon=40, degrees=(1, 5), tolerance=1e-12,
    )  # fmt: skip


def docking_far() -> hf.Flowpipe:
    of = spacecraft("far", FAR)
    beside = [
        e for s in (y, vx, vy) for low, high in [PASSING[s.name]] for e in (low - s, s - high)
    ]
    return hf.flowpipe(
        of, region(of, least(x + 100, reduce(greatest, beside))), target=region(of, -x - 100),
        start={"x": (-925, -875), "y": (-425, -375), "vx": (0, 0), "vy": (0, 0)}, horizon=112,
        degrees=(1, 6), tolerance=1e-3,
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


PROBLEMS = {
    "van-der-pol": van_der_pol, "lotka-volterra": lotka_volterra, "robertson": robertson,
    "docking-far": docking_far, "docking-near": docking_near,
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
