"""What `hf.identify` makes of logs of plants that others wrote, and of logs with known truth.

    python benchmarks/foreign_logs.py LOGS
    python benchmarks/identification.py LOGS [--known 100]

writes `benchmarks/identification.json`, of which docs/identify.md is the table. LOGS are those of
`foreign_logs.py`; first guesses are the vehicle files of this package, which were not made from
these plants but for the Otter's. `--known N` adds N logs of an Otter with known numbers, 200 s at
10 Hz with noise, from a first guess that is wrong by up to 40 %: how often do intervals contain the
truth, and how often is a second log within the bound?
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.interop.logs.read import read_log

RECORD = Path(__file__).with_name("identification.json")
PLANTS = {
    "otter": ("`otter`", lambda: hf.load_vehicle("otter")),
    "rov": ("`bluerov2`", lambda: hf.load_vehicle("bluerov2")),
    "ship": ("`cybership_ii`, 20 N at 0.5 m",
             lambda: hf.load_vehicle("cybership_ii", thrust_limit=20.0, thruster_arm=0.5)),
    "wheels": ("`unicycle`", hf.systems.unicycle),
}  # fmt: skip


def foreign(folder: Path, name: str) -> dict[str, Any]:
    """The row of a plant."""
    shown, build = PLANTS[name]
    system = build()
    first = read_log(folder / f"{name}-fit.csv", system)
    second = read_log(folder / f"{name}-held-out.csv", system)
    begun = time.perf_counter()
    found = hf.identify(system, first, held_out=second)
    seconds = time.perf_counter() - begun
    left = found.unexplained
    widths = [
        100 * e.half_width / abs(e.value) for e in found.parameters if e.status == "identified"
    ]
    assert found.held_out is not None
    return {
        "guess": shown,
        "seconds": round(seconds, 1),
        "windows": found.windows,
        "window": round(found.window, 2),
        "identified": len(widths),
        "held": sum(e.low != e.low for e in found.parameters),
        "median_width": round(float(np.median(widths)), 1) if widths else None,
        "outliers": round(100 * found.outliers, 1),
        "bound": {
            n: [float(f"{a:.2g}"), float(f"{b:.2g}"), u]
            for n, a, b, u in zip(left.names, left.low, left.high, left.units, strict=True)
        },
        "over": round(left.length, 2),
        "by_noise": {n: round(100 * s) for n, s in zip(left.names, left.noise_share, strict=True)},
        "second": len(found.held_out.needed.start),
        "outside": found.held_out.outside,
        "beyond": found.held_out.beyond,
    }


def known(count: int) -> dict[str, Any]:
    """How often intervals contain the truth, and a second log is within the bound."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from tests.boats import vehicle_log

    otter = hf.load_vehicle("otter")
    true = {p.name: p.value for p in otter.parameters}
    inside = total = covered = 0
    for seed in range(count):
        random = np.random.default_rng(seed)
        wrong = tuple(
            replace(p, value=p.value * random.uniform(0.7, 1.4)) if p.name[0] in "XYN" else p
            for p in otter.parameters
        )
        found = hf.identify(
            replace(otter, parameters=wrong),
            vehicle_log(otter, seed=seed, seconds=200.0),
            held_out=vehicle_log(otter, seed=seed + 5000, seconds=200.0),
            hold=["mass", "Iz", "x_g"],
        )
        for e in found.parameters:
            if e.status == "identified":
                inside += e.low <= true[e.name] <= e.high
                total += 1
        assert found.held_out is not None
        covered += found.held_out.covered
        print(f"{seed + 1} logs: {inside} of {total} intervals, {covered} second logs", flush=True)
    return {"logs": count, "inside": inside, "intervals": total, "covered": covered}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", type=Path)
    parser.add_argument("--known", type=int, default=0)
    parser.add_argument("--only", choices=PLANTS)
    given = parser.parse_args()
    record = json.loads(RECORD.read_text()) if RECORD.exists() else {"foreign": {}, "known": {}}
    for name in PLANTS if given.only is None else (given.only,):
        record["foreign"][name] = foreign(given.logs, name)
        print(name, json.dumps(record["foreign"][name]), flush=True)
    if given.known:
        record["known"] = known(given.known)
    RECORD.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
