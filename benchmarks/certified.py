"""Certificates of published problems, and of sets that are known: how long, how much, and checked.

    python benchmarks/certified.py [--only NAME] [--share 1.0]

writes `benchmarks/certified.json`. Problems:

* vehicle: the path planning of SCOTS (M. Rungger and M. Zamani, HSCC 2016): a car among walls
  reaches a corner of a 10 m square. There it is answered at the samples; here between them too.
* converter: the safety of a DC-DC converter with two modes (the same source, after A. Girard).
* cart, cart3: between two walls, pushed; and pushed by an unknown bias that is a third state. Their
  exact kernels are known: the share of the exact cells that is certified.
* population: its growth is steered and its size is kept (J.-P. Aubin and P. Saint-Pierre, 2007; the
  example of Viabilitree). Its exact kernel is known: the share of its area that is certified,
  beside that of the set which Viabilitree's repository has (`testTest`, depth 10, commit 49676ea).
* lake: a shallow lake whose load of nutrients changes by 0.09 a second at most, and whose
  phosphorus stays below 1.4 (S. Martin, 2004). Its exact kernel ends
  where the load falls as fast as it may: one trajectory, which is integrated here.
* landing: a DC9-30 that has to touch the ground slowly from anywhere in 25 m/s, 3 degrees and 56 m
  (G. Reissig, A. Weber and M. Rungger, 2017; an example of SCOTS and of ROCS, which start it from
  81 m/s, -1 degree, 55 m). landing-noisy: with the disturbances and errors of measurement of
  SCOTS' example.
* hill: a car on a hill, the viability kernel that integralibex (T. Le Mezo, intervals, Ibex) finds
  from inside and from outside: `car_on_the_hill_kernel` of its main.cpp. No figure is published
  with it but its picture.

share: of the entries that `holdfast-check` checks. Seconds are those of this machine; the second of
two runs, after the machine code is made.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp

import holdfast as hf
from holdfast.execution.resources import available_cores
from holdfast.maths.expressions.functions import least, sgn

RECORD = Path(__file__).with_suffix(".json")

WALLS = (
    (1, 1.2, 0, 9), (2.2, 2.4, 0, 5), (2.2, 2.4, 6, 10), (3.4, 3.6, 0, 9), (4.6, 4.8, 1, 10),
    (5.8, 6, 0, 6), (5.8, 6, 7, 10), (7, 7.2, 1, 10), (8.2, 8.4, 0, 8.5), (8.4, 9.3, 8.3, 8.5),
    (9.3, 10, 7.1, 7.3), (8.4, 9.3, 5.9, 6.1), (9.3, 10, 4.7, 4.9), (8.4, 9.3, 3.5, 3.7),
    (9.3, 10, 2.3, 2.5),
)  # fmt: skip
"""Of the path planning problem: least and greatest x and y [m], facts of the source."""

GOAL = (9.0, 9.51, 0.0, 0.51)
START = (0.4, 0.4)


def region(name: str, system: hf.System, limits: list[sp.Expr]) -> hf.Region:
    rows = tuple(hf.Inequality(f"c{k}", e) for k, e in enumerate(limits))
    return hf.Region(name, system.states, rows, empirical="numbers")


def edges(marks: set[float], step: float) -> np.ndarray:
    """Edges at all marks, and between them about `step` apart."""
    found = [min(marks)]
    for a, b in itertools.pairwise(sorted(marks)):
        found += list(np.linspace(a, b, max(1, round((b - a) / step + 0.1)) + 1)[1:])
        found[-1] = b
    return np.array(found)


def vehicle() -> hf.Certificate:
    x, y, theta, v, steer = (hf.symbol(n) for n in ("x", "y", "theta", "v", "steer"))
    slip = sp.atan(sp.tan(steer) / 2)
    car = hf.System(
        "vehicle",
        (hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("theta", "rad")),
        (hf.Quantity("v", "m/s"), hf.Quantity("steer", "rad")),
        {
            "x": v * sp.cos(slip + theta) / sp.cos(slip),
            "y": v * sp.sin(slip + theta) / sp.cos(slip),
            "theta": v * sp.tan(steer),
        },
        input_bounds=hf.Box((-1.0, -1.0), (1.0, 1.0)),
        empirical="numbers",
    )
    free = [reduce(least, (x - a, b - x, y - c, d - y)) for a, b, c, d in WALLS]
    square = region("square", car, [*free, -x, x - 10, -y, y - 10])
    a, b, c, d = GOAL
    goal = region("goal", car, [a - x, x - b, c - y, y - d])
    marks = [{0.0, 10.0, *GOAL[2 * k : 2 * k + 2]} for k in (0, 1)]
    for wall in WALLS:
        for k in (0, 1):
            marks[k] |= {float(m) for m in wall[2 * k : 2 * k + 2]}
    return hf.certify(
        car, square, target=goal, sample_time=0.3, inputs={"v": 2, "steer": 7},
        box={"x": (0, 10), "y": (0, 10), "theta": (-np.pi, np.pi)},
        cells={"x": edges(marks[0], 0.2), "y": edges(marks[1], 0.2), "theta": 50},
    )  # fmt: skip


def converter() -> hf.Certificate:
    """Current and a fifth of the voltage of a boost converter, with the numbers of the source."""
    i, v, mode = (hf.symbol(n) for n in ("i", "v", "mode"))
    xl, xc, rl, rc, ro = 3, 70, sp.Rational(1, 20), sp.Rational(1, 200), 1
    through = sp.Rational(ro) / (ro + rc)
    on = (-rl / xl * i + sp.Rational(1, xl), -1 / (xc * (ro + rc)) * v)
    off = (
        -(rl + rc * through) / xl * i - through / (5 * xl) * v + sp.Rational(1, xl),
        5 * through / xc * i - 1 / (xc * (ro + rc)) * v,
    )
    system = hf.System(
        "converter", (hf.Quantity("i", "1"), hf.Quantity("v", "1")), (hf.Quantity("mode", "1"),),
        {n: (1 - mode) * a + mode * b for n, a, b in zip("iv", on, off, strict=True)},
        input_bounds=hf.Box((0.0,), (1.0,)),
        empirical="numbers",
    )  # fmt: skip
    box = {"i": (1.15, 1.55), "v": (5.45, 5.85)}
    stays = region(
        "safe", system, [box["i"][0] - i, i - box["i"][1], box["v"][0] - v, v - box["v"][1]]
    )
    return hf.certify(system, stays, box=box, cells=800, sample_time=0.5, inputs=2)


def cart(bias: bool) -> hf.Certificate:
    """x'' = a + w between walls at 1 m; w is up to 0.3 m/s^2, or a constant that is a state."""
    x, v, a, w = (hf.symbol(n) for n in ("x", "v", "a", "w"))
    states = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"))
    rates, box = {"x": v, "v": a + w}, {"x": (-1, 1), "v": (-2, 2)}
    more = {} if bias else {
        "disturbances": (hf.Quantity("w", "m/s^2"),), "disturbance_bounds": hf.Box((-0.3,), (0.3,)),
    }  # fmt: skip
    if bias:
        states, rates = (*states, hf.Quantity("w", "m/s^2")), {**rates, "w": sp.S.Zero}
        box["w"] = (-0.3, 0.3)
    system = hf.System(
        "cart",
        states,
        (hf.Quantity("a", "m/s^2"),),
        rates,
        input_bounds=hf.Box((-1.0,), (1.0,)),
        **more,
        empirical="numbers",
    )
    walls = region("walls", system, [-1 - x, x - 1])
    tried = 3 if bias else 9
    return hf.certify(system, walls, box=box, cells=201, sample_time=0.2, inputs=tried)


KEPT = (0.2, 3.0)
"""The least and the greatest size of the population."""

FOUND_BY_KD_TREE = (6.8141, 0.7303)
"""The area of Viabilitree's set of 183 boxes, and the share of it that is in the exact kernel."""


def steered(
    name: str,
    states: tuple[hf.Quantity, hf.Quantity],
    rates: tuple[sp.Expr, sp.Expr],
    input: hf.Quantity,
    most: float,
) -> hf.System:
    """A system of two states and one input within bounds."""
    return hf.System(
        name, states, (input,), {q.name: r for q, r in zip(states, rates, strict=True)},
        input_bounds=hf.Box((-most,), (most,)),
        empirical="numbers",
    )  # fmt: skip


def population() -> hf.Certificate:
    """x' = x y, y' = u: the growth y changes by at most 1/2."""
    x, y, u = (hf.symbol(n) for n in "xyu")
    states = hf.Quantity("x", "1"), hf.Quantity("y", "1/s")
    growth = hf.Quantity("u", "1/s^2")
    system = steered("population", states, (x * y, u), growth, 0.5)
    a, b = KEPT
    size = region("size", system, [a - x, x - b, -2 - y, y - 2])
    box = {"x": KEPT, "y": (-2, 2)}
    return hf.certify(system, size, box=box, cells=800, sample_time=0.1, inputs=3)


def of_exact_population(found: hf.Certificate) -> tuple[float, int]:
    """Of the area of the exact kernel; how many cells are not in it.

    y <= sqrt(log(b/x)) and y >= -sqrt(log(x/a)): the growth ends before the size does.
    """
    a, b = KEPT
    low, high = found.cells.corners(found.kept.members)
    fine = high[:, 1] <= np.sqrt(np.log(b / high[:, 0]))
    fine &= low[:, 1] >= -np.sqrt(np.log(low[:, 0] / a))
    x = a + (b - a) * (np.arange(1_000_000) + 0.5) / 1_000_000
    exact = (b - a) * float(np.mean(np.sqrt(np.log(b / x)) + np.sqrt(np.log(x / a))))
    return float((high - low).prod(axis=1).sum() / exact), int((~fine).sum())


LAKE = {"L": (0.1, 1.0), "P": (0.0, 1.4)}


def lake() -> hf.Certificate:
    """L' = u, P' = -0.8 P + L + P^8/(1 + P^8)."""
    load, p, u = (hf.symbol(n) for n in "LPu")
    states = hf.Quantity("L", "1"), hf.Quantity("P", "1")
    system = steered("lake", states, (u, water(load, p)), hf.Quantity("u", "1/s"), 0.09)
    stays = region(
        "lake", system,
        [sp.Rational(1, 10) - load, load - 1, -p, p - sp.Rational(7, 5)],
    )  # fmt: skip
    return hf.certify(system, stays, box=LAKE, cells=600, sample_time=0.2, inputs=3)


def water(load: Any, p: Any) -> Any:
    """The rate of phosphorus, of symbols or numbers."""
    return -p * 4 / 5 + load + p**8 / (1 + p**8)


def of_exact_lake(found: hf.Certificate) -> tuple[float, int]:
    """Of the area of the exact kernel; how many cells are not in it.

    The kernel ends at the trajectory whose load falls at 0.09 a second and that touches P = 1.4.
    """
    most = LAKE["P"][1]
    touch = -float(water(0.0, most))
    back = solve_ivp(
        lambda t, q: (0.09, -water(q[0], q[1])), (0, (1 - touch) / 0.09), (touch, most),
        rtol=1e-11, atol=1e-12, dense_output=True,
    )  # fmt: skip
    load, p = back.sol(np.linspace(0, back.t[-1], 1_000_001))
    p = np.maximum(p, 0.0)
    exact = (touch - LAKE["L"][0]) * most + float(np.trapezoid(p, load))
    low, high = found.cells.corners(found.kept.members)
    bound = np.interp(high[:, 0], load, p, left=most)
    return float((high - low).prod(axis=1).sum() / exact), int((high[:, 1] > bound + 1e-9).sum())


BEGIN = (81.0, -math.pi / 180, 55.0)
"""From where the aircraft of the sources begins: m/s, rad, m."""


def landing(noisy: bool) -> hf.Certificate:
    """Speed, path angle and height of 60 t under a thrust and an angle of attack."""
    v, path, h, thrust, attack, gust, turn = (
        hf.symbol(n) for n in ("V", "path", "h", "thrust", "attack", "gust", "turn")
    )
    lift, mass, gravity = sp.Rational(5, 4) + 21 * attack / 5, 60000, sp.Rational(981, 100)
    drag = sp.Rational(27, 10) + sp.Rational(77, 25) * lift**2
    rates = {
        "V": (thrust * sp.cos(attack) - drag * v**2) / mass - gravity * sp.sin(path),
        "path": (thrust * sp.sin(attack) / v + sp.Rational(343, 5) * lift * v) / mass
        - gravity * sp.cos(path) / v,
        "h": v * sp.sin(path),
    }
    more: dict[str, Any] = {}
    if noisy:
        rates |= {"V": rates["V"] + gust, "path": rates["path"] + turn}
        more = {
            "disturbances": (hf.Quantity("gust", "m/s^2"), hf.Quantity("turn", "rad/s")),
            "disturbance_bounds": hf.Box((-0.108, -0.002), (0.108, 0.002)),
        }
    plane = hf.System(
        "landing aircraft",
        (hf.Quantity("V", "m/s"), hf.Quantity("path", "rad"), hf.Quantity("h", "m")),
        (hf.Quantity("thrust", "N"), hf.Quantity("attack", "rad")),
        rates,
        input_bounds=hf.Box((0.0, 0.0), (32000.0, 8 * math.pi / 180)),
        **more,
        empirical="numbers",
    )
    steep = 3 * math.pi / 180
    air = region("air", plane, [58 - v, v - 83, -steep - path, path, -h, h - 56])
    touch = [63 - v, v - 75, h - sp.Rational(5, 2), -sp.Rational(91, 100) - v * sp.sin(path)]
    errors = {"V": 0.0125, "path": 0.0025 * math.pi / 180, "h": 0.05} if noisy else {}
    return hf.certify(
        plane, air, target=region("touch", plane, touch), errors=errors, sample_time=1.0,
        box={"V": (58, 83), "path": (-steep, 0), "h": (0, 56)}, horizon=60,
        cells={"V": 80, "path": 50, "h": 334} if noisy else {"V": 100, "path": 66, "h": 112},
        inputs={"thrust": 2, "attack": 10},
    )  # fmt: skip


def hill() -> hf.Certificate:
    """x' = v, v' = -9.81 sin(slope) - 0.7 v + u, with the numbers of the source."""
    x, v, u = (hf.symbol(n) for n in "xvu")
    eleven = sp.Rational(11, 10)
    slope = (-eleven / sp.Rational(6, 5) * sp.sin(x) - sp.Rational(6, 5) * sp.sin(eleven * x)) / 2
    rates = v, -sp.Rational(981, 100) * sp.sin(slope) - sp.Rational(7, 10) * v + u
    states = hf.Quantity("x", "m"), hf.Quantity("v", "m/s")
    car = steered("car", states, rates, hf.Quantity("u", "m/s^2"), 0.5)
    box = {"x": (-1.0, 13.0), "v": (-16.0, 16.0)}
    track = region("track", car, [-1 - x, x - 13, -16 - v, v - 16])
    return hf.certify(car, track, box=box, cells=400, sample_time=0.05, inputs=3)


def exact_share(found: hf.Certificate) -> tuple[float, int]:
    """Certified cells of those in the exact kernel; how many certified ones are not in it."""
    low, high = found.cells.corners(np.arange(int(np.prod(found.cells.counts))))
    fine = np.ones(len(low), dtype=bool)
    for corner in itertools.product((0, 1), repeat=low.shape[1]):
        q = np.where(corner, high, low)
        v = q[:, 1]
        w = 0.3 if q.shape[1] == 2 else np.sign(v) * q[:, 2]
        fine &= np.abs(q[:, 0] + v * np.abs(v) / (2 * (1 - w))) <= 1
        fine &= np.abs(q[:, 0]) <= 1
    return float(fine[found.kept.members].sum() / fine.sum()), int(
        (~fine[found.kept.members]).sum()
    )


def driven(found: hf.Certificate, first: Sequence[float] | None = None) -> dict[str, object]:
    """A thousand runs of the law from certified cells: how many arrive, and how near to a wall.

    first: the state that one of them begins with. Disturbances jump between their bounds, and
    errors of measurement are any; runs begin where each of these is measured in a certified cell.
    """
    system = hf.certified_system(found)
    square, goal = (
        region(name, system, [e for _, _, e in limits])
        for name, limits in (("square", found.constraints), ("goal", found.target))
    )
    generator = np.random.default_rng(0)
    low, high = found.cells.corners(generator.choice(found.kept.members, 1000))
    off = np.array(found.sampling.errors)
    starts = low + off + (high - low - 2 * off) * generator.random(low.shape)
    if first is not None:
        starts[0] = first
    t = hf.symbol("t")
    jumps = {
        name: found.ranges[name][1] * sgn(sp.sin((3 + k) * t))
        for k, (name, _) in enumerate(found.disturbances)
    }
    errors = {n: e for (n, _), e in zip(found.states, found.sampling.errors, strict=True) if e}
    ends, goes_on = (
        hf.simulate(
            system, hf.certified_law(found), starts=starts, region=square, goal=goal,
            horizon=found.kept.holds * found.hold, sample_time=found.hold, disturbance=jumps,
            noise_uniform=errors, record_every=found.hold, substeps=20, until_goal=until_goal,
        )
        for until_goal in (True, False)
    )  # fmt: skip
    took, says = ends.arrays["goal_time"].values, ends.arrays["signal"].values[:, 0, 0]
    row = {
        "arrived": ends.outcomes["reached goal"],
        "arrived_in_time": int((took <= says + 1e-9).sum()),
        "longest_s": float(took.max()),
    }
    if first is not None:  # an aircraft that touched the ground goes on by another law
        return row | {"worst_constraint": float(ends.arrays["worst_constraint"].values.max())}
    return row | {
        "at_the_goal_at_the_end": goes_on.outcomes["reached goal"],
        "worst_constraint": float(goes_on.arrays["worst_constraint"].values.max()),
    }


PROBLEMS: dict[str, Callable[[], hf.Certificate]] = {
    "vehicle": vehicle,
    "converter": converter,
    "cart": lambda: cart(False),
    "cart3": lambda: cart(True),
    "population": population,
    "lake": lake,
    "landing": lambda: landing(False),
    "landing-noisy": lambda: landing(True),
    "hill": hill,
}
PUBLISHED = {"vehicle": 597.96, "converter": 93.06}
"""Seconds of SCOTS, on other hardware."""


def judged(name: str, share: float) -> dict[str, object]:
    seconds = []
    for _ in range(2):
        begun = time.perf_counter()
        found = PROBLEMS[name]()
        seconds.append(time.perf_counter() - begun)
    row = {
        "cells": list(found.cells.counts), "inputs": len(found.candidates),
        "certified": len(found.kept.members), "share": round(found.kept.share, 4),
        "seconds": round(seconds[1], 2),
    }  # fmt: skip
    if name in PUBLISHED:
        row["published_seconds"] = PUBLISHED[name]
    if name == "vehicle":
        low, high = found.cells.corners(found.kept.members)
        begins = (low[:, :2] <= START).all(axis=1) & (high[:, :2] >= START).all(axis=1)
        row |= {"start_headings": int(begins.sum()), "holds": found.kept.holds, **driven(found)}
    if name.startswith("cart"):
        row["of_exact"], row["outside_exact"] = exact_share(found)
        row["of_exact"] = round(row["of_exact"], 4)
    if name == "lake":
        of_exact, row["outside_exact"] = of_exact_lake(found)
        row["of_exact"] = round(of_exact, 4)
    if name.startswith("landing"):
        low, high = found.cells.corners(found.kept.members)
        begins = (low <= BEGIN).all(axis=1) & (high >= BEGIN).all(axis=1)
        row |= {"begins": bool(begins.any()), "holds": int(found.kept.entries[:, 2].max())}
        row |= driven(found, BEGIN)
    if name == "population":
        of_exact, outside = of_exact_population(found)
        area, inside = FOUND_BY_KD_TREE
        row |= {"of_exact": round(of_exact, 4), "outside_exact": outside}
        row |= {"published_area": area, "published_inside": inside}
    with tempfile.TemporaryDirectory() as folder:
        path = found.write(Path(folder) / "some.certificate")
        row["bytes"] = path.stat().st_size
        begun = time.perf_counter()
        code = "from holdfast_check import main; main()"
        given = [sys.executable, "-c", code, str(path), "--share", str(share)]
        row["checked"] = subprocess.run(given, capture_output=True, text=True).stdout.partition(
            "\n"
        )[0]
        row["checked_seconds"] = round(time.perf_counter() - begun, 1)
    print(json.dumps({name: row}))
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", choices=PROBLEMS, default=list(PROBLEMS))
    parser.add_argument("--share", type=float, default=0.02)
    asked = parser.parse_args()
    record = json.loads(RECORD.read_text("utf-8")) if RECORD.exists() else {}
    record["machine"] = {"cores": available_cores(), "python": platform.python_version()}
    for name in asked.only:
        record[name] = judged(name, asked.share)
        RECORD.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
