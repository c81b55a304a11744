"""What is proved of shipped scenarios: cells, shares, seconds, memory, what the checker says.

    python benchmarks/certificates.py [--part PART] [--only NAME ...]

writes `benchmarks/certificates.json`. Every case runs in a process of its own, compiled code in the
cache, and `holdfast-check` reads the file that it writes: all entries, or a random share of them.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

from holdfast.analysis.certificates.certificate import Certificate
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.maths.definitions.quantity import symbol
from holdfast.studies.certification import certified, largest_certified
from holdfast.studies.law_certification import judged_law
from holdfast_check.checker import NotValidError, check

RECORD = Path(__file__).with_suffix(".json")


@dataclass(frozen=True)
class Case:
    """A certificate: `holdfast certify SCENARIO` with options; share: of its entries to check."""

    scenario: str
    what: str
    options: dict[str, Any] = field(default_factory=dict)
    overrides: tuple[str, ...] = ()
    share: float = 1.0


SLOW_BOAT = ("grid.box.u=[-0.4, 0.4]", "grid.box.v=[-0.16, 0.16]")
SLOW_CART = ("grid.box.vx=[-1.2, 1.2]", "grid.box.vy=[-1.2, 1.2]")
"""Speeds of the cases that are certified within less than the boxes of their scenarios."""

CERTIFIED = {
    "seen-target": Case("seen-target", "target in view, any current up to 0.1 m/s"),
    "seen-leader": Case("seen-leader", "leader in view, up to 0.25 m/s in any direction"),
    "leader-gains": Case("leader-gains", "the same with the law of chapter 6, k2 = 0.8"),
    "leader-gains-any": Case(
        "leader-gains",
        "the same with any gain k2 from 0.7 to 0.85, varying",
        {"sample_time": 0.01, "uncertain": {"k2": (0.7, 0.85)}},
    ),
    "held-station": Case("held-station", "station within 0.18 m, any current up to 0.25 m/s"),
    "ferry-banks": Case("ferry-banks", "the tutorial's ferry off the banks"),
    "seen-with-sway": Case(
        "seen-with-sway",
        "target in view, sway a state, any current up to 0.1 m/s",
        share=0.5,
    ),
    "seen-with-lasers": Case(
        "seen-with-lasers",
        "target in view of camera and lasers, any current up to 0.05 m/s",
        share=0.05,
    ),
    "pushed-cart": Case(
        "pushed-cart",
        "cart on a floor, pushed by up to 0.1 m/s^2",
        share=0.1,
    ),
    "seen-by-thrust": Case(
        "seen-by-thrust",
        "target in view by thrust, surge and sway states, any current up to 0.05 m/s",
        {},
        (*SLOW_BOAT, "grid.nodes={ahead = 37, left = 49, u = 17, v = 9}"),
        share=0.1,
    ),
    "seen-by-torque": Case(
        "seen-by-torque",
        "target in view by thrust and torque, sway and yaw rate states, any current up to 0.05 m/s",
        share=0.01,
    ),
    "loaded-cart": Case(
        "loaded-cart",
        "cart between walls, any mass from 18 to 22 kg",
    ),
}

"""By name: what is certified."""

JUDGED = {
    "seen-guarded": Case(
        "seen-guarded",
        "target in view by a law that runs into it and its safeguard, any current up to 0.05 m/s",
        {"box": {"ahead": (0.35, 2.0), "bearing": (-0.5235, 0.5235)}},
        share=0.1,
    ),
    "berth-filter": Case(
        "berth-filter",
        "boat in its berth by the filter of a kernel, whatever is commanded",
        {"box": {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, "cells": 80, "inputs": 10},
        overrides=("law={external=true}", "safety.ahead=false"),
        share=0.02,
    ),
    "ferry-tacks": Case(
        "ferry-tacks",
        "ferry off the banks by a law of two modes",
        {"box": {"y": (-3.0, 3.0), "psi": (-0.8, 0.8)}, "cells": 161},
    ),
}
"""By name: of which law of a closed loop it is asked what it keeps."""

LARGEST = {
    "seen-target": Case("seen-target", "current"),
    "seen-target-most": Case("seen-target", "current", {"share": 0.9}),
    "seen-leader": Case("seen-leader", "leader"),
    "seen-leader-most": Case("seen-leader", "leader", {"share": 0.9}),
    "leader-gains": Case(
        "leader-gains", "leader", {"sample_time": 0.01, "between": (0.05, 0.45), "share": 0.9}
    ),
    "held-station": Case("held-station", "current"),
    "ferry-banks": Case("ferry-banks", "stream"),
    "loaded-cart": Case("loaded-cart", "uncertain.mass", {"share": 0.5}),
}
"""By name: the number of which the largest certified value is searched."""

HALVED = {
    "seen-target": Case("seen-target", "", {"cells": 51, "halvings": 2}),
    "held-station": Case("held-station", "", {"cells": 51, "halvings": 2}),
    "ferry-banks": Case("ferry-banks", "", {"cells": 81, "halvings": 2}),
    "seen-with-sway": Case(
        "seen-with-sway",
        "",
        {"cells": {"ahead": 31, "left": 41, "v": 11}, "halvings": 2},
    ),
    "pushed-cart": Case(
        "pushed-cart",
        "",
        {"cells": 16, "halvings": 1},
        SLOW_CART,
        share=0.02,
    ),
    "seen-by-thrust": Case(
        "seen-by-thrust",
        "",
        {"cells": {"ahead": 25, "left": 33, "u": 17, "v": 9}, "halvings": 1},
        SLOW_BOAT,
        share=0.02,
    ),
}
"""By name: cells that are halved near certified ones, to compare with all cells that small."""

POINTS = 1 << 18
"""Spread evenly over the box: those in certified cells, of those in the region."""


def searched(name: str) -> dict[str, Any]:
    """A search: between which numbers the limit lies, and what the checker says of the lower."""
    case = LARGEST[name]
    begun = time.perf_counter()
    found = largest_certified(case.scenario, case.what, **case.options)
    seconds = time.perf_counter() - begun
    told = found.summary()
    kept = {
        n: told[n] for n in ("scenario", "key", "name", "unit", "share", "widens", "low", "high")
    }
    assert found.found is not None, name
    with tempfile.TemporaryDirectory() as folder:
        path = found.found.write(Path(folder) / "certificate.holdfast")
        try:
            says, valid = check(str(path)), True
        except NotValidError as wrong:
            says, valid = str(wrong), False
    return kept | {
        "share_certified": found.found.kept.share,
        "trials": len(found.trials),
        "seconds": round(seconds, 1),
        "valid": valid,
        "checker": says,
    }


def _by_its_law(*scenario: Any, **options: Any) -> Certificate:
    return judged_law(*scenario, **options).certificate


def measured(name: str) -> dict[str, Any]:
    """A case: what is certified, and in what time and memory; what the checker says of the file."""
    return recorded(CERTIFIED[name])


def judged(name: str) -> dict[str, Any]:
    """The same of what a law keeps."""
    return recorded(JUDGED[name])


def recorded(case: Case) -> dict[str, Any]:
    certify: Callable[..., Certificate] = _by_its_law if "box" in case.options else certified
    certify(case.scenario, case.overrides, **{**case.options, "cells": 5})  # compiled
    begun = time.perf_counter()
    found = certify(case.scenario, case.overrides, **case.options)
    seconds = time.perf_counter() - begun
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    with tempfile.TemporaryDirectory() as folder:
        path = found.write(Path(folder) / "certificate.holdfast")
        size = path.stat().st_size
        begun = time.perf_counter()
        try:
            says = check(str(path), case.share)
            valid = True
        except NotValidError as wrong:
            says, valid = str(wrong), False
        checking = time.perf_counter() - begun
    return {
        "scenario": case.scenario,
        "what": case.what,
        **found.summary(),
        "seconds_to_certify": round(seconds, 2),
        "peak_gib": round(peak, 2),
        "file_bytes": size,
        "checked_share": case.share,
        "valid": valid,
        "checker": says,
        "seconds_to_check": round(checking, 1),
        "horizon": found.summary()["seconds"],
    }


def certified_volume(found: Certificate) -> float:
    """The part of the region's volume that lies in certified cells."""
    edges, free = found.cells.edges, [n for n, _ in found.parameters]
    low, high = (np.array([e[k] for e in edges]) for k in (0, -1))
    points = low + (high - low) * qmc.Sobol(len(low), seed=1).random(POINTS)
    names = [symbol(n) for n in (*(n for n, _ in found.states), *free)]
    limits = Enclosure([e for *_, e in found.constraints], names)
    ends = [np.tile([found.ranges[n][k] for n in free], (POINTS, 1)) for k in (0, 1)]
    most = limits.over(*(np.hstack([points, end]) for end in ends))[1]
    kept = np.zeros(found.cells.total, dtype=bool)
    kept[found.kept.members] = True
    places = [np.searchsorted(e, points[:, k], side="right") - 1 for k, e in enumerate(edges)]
    inside = kept[np.ravel_multi_index(places, found.cells.counts, mode="clip")]
    return float(inside[(most <= 0).all(axis=1)].mean())


def halved(name: str) -> list[dict[str, Any]]:
    """A case: cells that are halved, and all cells as small as the smallest of them."""
    case = HALVED[name]
    certified(
        case.scenario, case.overrides, **{**case.options, "cells": 5, "halvings": 0}
    )  # compiled
    cells, times = case.options["cells"], case.options["halvings"]
    small = cells << times if isinstance(cells, int) else {n: c << times for n, c in cells.items()}
    rows = []
    for options in (case.options, {**case.options, "cells": small, "halvings": 0}):
        begun = time.perf_counter()
        found = certified(case.scenario, case.overrides, **options)
        row: dict[str, Any] = {
            "scenario": case.scenario,
            "cells": [c >> options["halvings"] for c in found.cells.counts],
            "halved": options["halvings"],
            "entries": len(found.kept.entries),
            "seconds": round(time.perf_counter() - begun, 2),
            "volume": round(certified_volume(found), 4),
        }
        with tempfile.TemporaryDirectory() as folder:
            path = found.write(Path(folder) / "certificate.holdfast")
            row["file_bytes"] = path.stat().st_size
            if options["halvings"]:
                row |= {"checked_share": case.share, "checker": check(str(path), case.share)}
        rows.append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", help="cases by name")
    parser.add_argument("--part", choices=("certified", "largest", "halved"), help="of the record")
    asked = parser.parse_args()
    record = json.loads(RECORD.read_text("utf-8")) if RECORD.exists() else {}
    context = multiprocessing.get_context("spawn")
    parts: list[tuple[str, dict[str, Case], Callable[[str], Any]]] = [
        ("certified", CERTIFIED, measured), ("judged", JUDGED, judged),
        ("largest", LARGEST, searched), ("halved", HALVED, halved),
    ]  # fmt: skip
    for part, cases, run in parts:
        kept = record.setdefault(part, {})
        for name in cases:
            if asked.only is not None and name not in asked.only:
                continue
            if asked.part is not None and part != asked.part:
                continue
            with context.Pool(1) as pool:
                kept[name] = pool.apply(run, (name,))
            print(f"{part} {name}: {kept[name]}", flush=True)
            record[part] = kept = {n: kept[n] for n in cases if n in kept}
            RECORD.write_text(json.dumps(record, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
