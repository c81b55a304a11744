"""What kernels put together from parts give away: docs/decomposition.md.

    python benchmarks/parts.py [--nodes 11] [--runs 2000] [--skip-vehicle]

The first table compares with the kernel on the grid of all states, the second with simulations of
the vehicle whose two propellers lag by 0.1 s (8 states): optimal inputs for 3 s, inputs held 10 ms.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
from tests.parted_systems import box, late_cart, plane, towed, walls

import holdfast as hf
from holdfast.execution.leaf import Evaluator
from holdfast.maths.expressions.functions import magnitude

LAG = 0.1  # s
SHARE = 0.1
BOX = {
    "x": (-2.3, -0.1), "y": (-1.8, 1.8), "psi": (-np.pi / 2, np.pi / 2),
    "u": (-0.8, 0.8), "v": (-0.4, 0.4), "r": (-1.5, 1.5),
}  # fmt: skip
SPEEDS = (0.3, 0.15, 0.5)
"""m/s, m/s, rad/s: the largest velocities of the starts."""
MARCH = {"scheme": "upwind", "cfl": 0.95, "precision": "float32", "band": 0.1}
STILL = {"Vx": 0.0, "Vy": 0.0}


def small() -> None:
    """Share of the full kernel kept, and states outside it by more than half a cell."""
    print("| problem | states | parts | verdict | kept of the full kernel | outside it |")
    print("|---|---|---|---|---|---|")
    four = box("x", "vx", "y", "vy")
    plain = box("x", "v")
    wide = box("x", "v", at=2.0)
    force = {"actual_u": (-1.0, 1.0)}
    winch = {"w": (-0.9, 0.9)}
    cases = [
        ("two carts, one push", plane(), "x y", {}, four, four, 31, {}, 31),
        ("cart on a winch", towed(), "x", {"cut": {"w": None}}, plain, {**plain, **winch}, 61,
         {"w": 15}, 61),
        *(
            (f"cart, lag {lag:g} s", late_cart(lag), "x", {"lag_share": 1.0, "box": wide}, None,
             {**plain, **force}, 61, {"actual_u": 21}, 91)
            for lag in (0.1, 0.2, 0.4)
        ),
    ]  # fmt: skip
    for title, system, names, how, over, whole, count, fewer, nodes in cases:
        region = walls(*names.split())
        kind = "discriminating-kernel" if system.disturbances else "viability-kernel"
        parted = hf.decompose(system, region, kind=kind, **how)
        found = hf.solve_parts(parted, over, nodes, 4.0)
        ends = dict.fromkeys(fewer, "limited")
        grid = hf.grid(system, whole, {n: fewer.get(n, count) for n in whole}, ends)
        solve = hf.discriminating_kernel if system.disturbances else hf.viability_kernel
        full = solve(system, region, grid, 4.0)
        low, high = np.array(list(whole.values())).T
        states = np.random.default_rng(0).uniform(low, high, (40_000, len(low)))
        inside, there = found.contains(states), full.contains(states)
        outside = (inside & (full.at(states) < -full.report.cell / 2)).sum()
        kept = (inside & there).sum() / there.sum()
        sizes = " + ".join(str(len(p.system.states)) for p in parted.parts)
        row = [title, len(whole), sizes, parted.verdict, f"{100 * kept:.0f} %", outside]
        print("| " + " | ".join(map(str, row)) + " |", flush=True)


def swaying() -> None:
    """The vehicle in six states, and with its sway as a disturbance of the other five."""
    system = hf.systems.marine_vehicle()
    view = hf.regions.camera_and_lasers()
    u, r = hf.symbol("u"), hf.symbol("r")
    region = replace(
        view,
        reads=(*view.reads, hf.Quantity("u", "m/s"), hf.Quantity("r", "rad/s")),
        inequalities=(
            *view.inequalities,
            hf.Inequality("surge", magnitude(u) - 0.5, "m/s"),
            hf.Inequality("turn", magnitude(r) - 0.7, "rad/s"),
        ),
    )
    sway = (-0.21, 0.21)
    parted = hf.decompose(system, region, cut={"v": sway}, disturbance=STILL)
    over = {**{n: BOX[n] for n in ("x", "y", "psi")}, "u": (-0.65, 0.65), "r": (-0.9, 0.9)}
    found = hf.solve_parts(parted, over, 13, 3.0, ends={"psi": "contained"}, **MARCH)
    whole = {n: {**over, "v": sway}[n] for n in system.state_names}
    nodes = {n: 5 if n == "v" else 13 for n in whole}
    grid = hf.grid(system, whole, nodes, {"psi": "contained", "v": "limited"})
    full = hf.viability_kernel(system, region, grid, 3.0, disturbance=STILL, **MARCH)
    low, high = np.array(list(whole.values())).T
    states = np.random.default_rng(0).uniform(low, high, (200_000, 6))
    inside, there = found.contains(states), full.contains(states)
    outside = (inside & (full.at(states) < -full.report.cell / 2)).sum()
    kept = f"{100 * (inside & there).sum() / there.sum():.0f} %"
    print(f"| vehicle, sway | 6 | 5 | {parted.verdict} | {kept} | {outside} |")
    starts = states[found.contains(states, 0.02)]
    print(f"{stayed(system, hf.parts_law(found), starts, region).sum()} of {len(starts)} stay")


def stayed(system, law, starts, region) -> np.ndarray:
    result = hf.simulate(
        system, law, starts=starts, region=region, horizon=3.0, sample_time=0.01, record_every=3.0,
        start_outside=True,
    )  # fmt: skip
    return result.arrays["outcome"].values == 0


def vehicle(nodes: int, runs: int) -> None:
    """Promised and kept, with the propellers' thrust within the share, and what others keep."""
    plain = hf.systems.marine_vehicle()
    late = hf.lagged(plain, {"port": LAG, "starboard": LAG})
    region = hf.regions.camera_and_lasers()
    parted = hf.decompose(late, region, lag_share=SHARE, box=BOX, disturbance=STILL)
    print(parted)
    begun = time.monotonic()
    found = hf.solve_parts(parted, None, nodes, 3.0, ends={"psi": "contained"}, **MARCH)
    print(f"{nodes}^6 nodes, {time.monotonic() - begun:.0f} s", flush=True)
    ends = {"psi": "contained", "u": "limited", "v": "limited", "r": "limited"}
    at_once = hf.viability_kernel(
        plain, region, hf.grid(plain, BOX, nodes, ends), 3.0, disturbance=STILL, **MARCH
    )
    prompt = hf.safety_law(plain, at_once)
    law = hf.parts_law(found)
    rest = hf.Law("rest", late.states, {"tau_u": 0, "tau_r": 0})
    generator = np.random.default_rng(1)
    low, high = np.array([BOX[n] for n in ("x", "y", "psi")]).T
    poses = generator.uniform(low, high, (40 * runs, 3))
    symbols = [hf.symbol(n) for n in ("x", "y", "psi")]
    safe = Evaluator([region.margin], symbols, region.parameters).values(poses)[:, 0] > 0
    poses = poses[safe][:runs]
    head = "velocities,thrust,promised,of these lost,promised at once,of these lost,not promised"
    print("| " + " | ".join([*head.split(","), "of these kept by some law"]) + " |")
    print("|---" * 8 + "|")
    for share in (1.0, 0.3, 0.0):
        speeds = share * np.array(SPEEDS) * generator.uniform(-1, 1, (runs, 3))
        for thrust in (0.0, 5.0 * SHARE):
            force = thrust * generator.choice([-1.0, 1.0], (runs, 2))
            starts = np.hstack([poses, speeds, force])
            mine = found.contains(starts)
            prompted = at_once.contains(starts[:, :6])
            own, other, idle = (stayed(late, one, starts, region) for one in (law, prompt, rest))
            any_law = own | other | idle
            print(
                f"| {share:g} | {thrust:g} N | {mine.sum()} | {(mine & ~own).sum()} "
                f"| {prompted.sum()} | {(prompted & ~other).sum()} | {(~mine).sum()} "
                f"| {(~mine & any_law).sum()} |",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nodes", type=int, default=11)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--skip-vehicle", action="store_true")
    given = parser.parse_args()
    small()
    swaying()
    if not given.skip_vehicle:
        vehicle(given.nodes, given.runs)


if __name__ == "__main__":
    main()
