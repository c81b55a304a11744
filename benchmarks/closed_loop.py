"""Closed-loop trajectories per second: holdfast beside scipy, diffrax and hand-written JAX.

Every contender simulates the same vehicle under the same law at 50 Hz in float64, side by
side in one process. Their final states must agree before anything is timed. docs/benchmarks.md says
what each row is; `python benchmarks/closed_loop.py --help` lists the options.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import peers
from task import Contender, Task, final_states, holdfast, plain, starts_inside

import holdfast as hf

AIMS = {"(a)": 300.0, "(b)": 10.0, "(c)": 3.0}
"""How many times faster than each kind of peer holdfast is meant to be."""

PEERS = {
    "jax": peers.jax_contenders,
    "diffrax": peers.diffrax_contenders,
    "scipy": peers.scipy_contenders,
}


def holdfast_contenders(task: Task) -> Iterator[Contender]:
    """The plain law; the viable law of the scenario, alone and with its region watched."""
    for continuous in (False, True):
        run = partial(plain, task, continuous)
        yield Contender(
            "holdfast, plain law", "continuous" if continuous else "held", run,
            partial(final_states, task, continuous), 0.0, task.runs, prepare=run,
        )  # fmt: skip
    scene = hf.load_scenario("inspection", ["safeguard.uncertain="])  # of the nominal model
    simulate = partial(holdfast, task, scene.system, scene.law, starts_inside(task, scene.region))
    watched = {"region": scene.region, "goal": scene.goal, "tolerance": 1e-3}
    for name, settings in (("", {}), (" in watched region", watched)):
        run = partial(simulate, **settings)
        yield Contender(
            f"holdfast, viable law{name}", "held", run, lambda: simulate()[1], 1e-9, task.runs,
            prepare=run,
        )  # fmt: skip


def gather(task: Task, skip_peers: bool) -> tuple[list[Contender], list[str]]:
    """Every contender that can run, and the peers that are not installed."""
    found, missing = list(holdfast_contenders(task)), []
    for name, contenders in {} if skip_peers else PEERS.items():
        try:
            found += contenders(task)
        except ModuleNotFoundError as error:
            if error.name not in PEERS:
                raise
            missing.append(name)
    return found, missing


def check(contender: Contender) -> bool:
    """Compile and warm up; whether the final states are those expected."""
    began = time.perf_counter()
    contender.prepare()
    prepared = time.perf_counter() - began
    seconds, final = contender.run()
    contender.compile_s = prepared - (seconds if "holdfast" in contender.name else 0.0)
    contender.difference = float(abs(final - contender.expected()).max())
    return contender.difference <= contender.tolerance


def report(
    contenders: list[Contender], missing: list[str], task: Task, loads: list[float]
) -> dict[str, Any]:
    """Everything measured, in numbers."""
    per_step = {id(c): sorted(s / (c.runs * task.steps) * 1e9 for s in c.times) for c in contenders}
    middle = {key: statistics.median(values) for key, values in per_step.items()}
    own = {c.control: middle[id(c)] for c in contenders[:2]}
    least_held = per_step[id(contenders[0])][0]
    rows = [
        {
            "name": c.name,
            "control": c.control,
            "runs_timed": c.runs,
            "compile_s": c.compile_s,
            "median_s": statistics.median(c.times),
            "ns_per_step": [per_step[id(c)][0], middle[id(c)], per_step[id(c)][-1]],
            "trajectories_per_s": 1e9 / (middle[id(c)] * task.steps),
            "times_holdfast_held": middle[id(c)] / own["held"],
            "times_holdfast_same_control": middle[id(c)] / own[c.control],
            "times_holdfast_held_of_minima": per_step[id(c)][0] / least_held,
            "difference": c.difference,
        }
        for c in contenders
    ]
    return {
        "runs": task.runs,
        "seconds": task.seconds,
        "steps": task.steps,
        "repeats": len(contenders[0].times),
        "cores": len(os.sched_getaffinity(0)),
        "load_before_and_after": loads,
        "python": platform.python_version(),
        "versions": {
            name: metadata.version(name)
            for name in ("holdfast", "llvmlite", "numpy", *PEERS)
            if name not in missing
        },
        "not_installed": missing,
        "rows": rows,
    }


def show(result: dict[str, Any]) -> None:
    """Print the table, then the ratios beside the aims."""
    versions = ", ".join(f"{k} {v}" for k, v in result["versions"].items())
    print(
        f"{result['runs']} runs of {result['seconds']:g} s, {result['steps']} control steps each, "
        f"float64; {result['repeats']} repeats, interleaved\n"
        f"{result['cores']} cores; load average {result['load_before_and_after'][0]:.2f} before, "
        f"{result['load_before_and_after'][1]:.2f} after; Python {result['python']}, {versions}\n"
    )
    print(
        f"{'':42}{'':11}{'compile':>8}{'ns per control step':>26}{'runs':>10}"
        f"{'x holdfast held':>20}{'same':>9}{'largest':>10}\n"
        f"{'contender':42}{'control':11}{'s':>8}{'min':>8}{'median':>9}{'max':>9}{'per s':>10}"
        f"{'medians':>11}{'minima':>9}{'control':>9}{'diff.':>10}"
    )
    for row in result["rows"]:
        low, middle, high = row["ns_per_step"]
        print(
            f"{row['name']:42}{row['control']:11}{row['compile_s']:8.2f}{low:8.0f}{middle:9.0f}"
            f"{high:9.0f}{row['trajectories_per_s']:10.4g}{row['times_holdfast_held']:11.3g}"
            f"{row['times_holdfast_held_of_minima']:9.3g}{row['times_holdfast_same_control']:9.3g}"
            f"{row['difference']:10.1e}"
        )
    print()
    for name in result["not_installed"]:
        print(f"{name}: not installed")
    for kind, aim in AIMS.items():
        ratios = {
            row["times_holdfast_held"]: row["name"]
            for row in result["rows"]
            if row["name"].startswith(kind)
        }
        if ratios:
            print(
                f"{kind} aim {aim:g}; against the fastest way to write it {min(ratios):.3g} "
                f"[{ratios[min(ratios)]}], against the slowest {max(ratios):.3g}"
            )


def main() -> int:
    """Check, measure, print; exit code 1 when the contenders disagree."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--skip-peers", action="store_true", help="time holdfast alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers there too")
    options = parser.parse_args()
    if options.runs < 1 or options.repeats < 1 or options.seconds <= 0:
        parser.error("--runs, --seconds and --repeats must be positive")
    task = Task(options.runs, options.seconds)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["HOLDFAST_CACHE_DIR"] = folder  # compile times are those of a first call
        loads = [os.getloadavg()[0]]
        contenders, missing = gather(task, options.skip_peers)
        wrong = [c for c in contenders if not check(c)]
        for c in wrong:
            print(f"{c.name}: final states differ by {c.difference:.3g}, "
                  f"allowed {c.tolerance:.3g}", file=sys.stderr)  # fmt: skip
        if wrong:
            return 1
        for _ in range(options.repeats):
            for c in contenders:
                c.times.append(c.run()[0])
        loads.append(os.getloadavg()[0])
        result = report(contenders, missing, task, loads)
    show(result)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
