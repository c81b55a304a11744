"""How long it takes to explain a system, and to derive and compile a shipped law.

python benchmarks/derive.py [--only NAME]

Each line is a new process. Cold: an empty cache of compiled code. Warm: the second process. The
time counted begins once the library is imported and ends when the first sample can be computed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time

EXPLAINED = [
    "unicycle", "nonholonomic_integrator", "chained_form", "chained_form n=6", "car",
    "front_axle_car", "tractor_trailer", "tractor_trailer trailers=2",
    "tractor_trailer trailers=3", "marine_vehicle",
]  # fmt: skip


def seconds(code: str, cache: str) -> float:
    """What the child prints: the seconds it took itself."""
    environment = dict(os.environ, HOLDFAST_CACHE_DIR=cache)
    answer = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    return float(answer.stdout.split()[-1])


def main() -> None:
    from holdfast.scenario.files import scenario_names
    from holdfast.scenario.kinds.closed_loop import Scenario
    from holdfast.scenario.load import load_scenario

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", help="a part of the name")
    only = parser.parse_args().only or ""
    print(f"{'explain':<34} {'seconds':>8}")
    for entry in EXPLAINED:
        if only not in entry:
            continue
        name, *overrides = entry.split()
        code = (
            "import time; from holdfast.studies.derivation import explain; "
            "from holdfast.scenario.files import load_system; t = time.perf_counter(); "
            f"d = explain(load_system({name!r}, {overrides!r})); d.text(); d.markdown(); "
            "print(time.perf_counter() - t)"
        )
        print(f"{entry:<34} {seconds(code, ''):8.2f}", flush=True)
    print(f"\n{'derive and compile':<34} {'cold':>8} {'warm':>8}")
    for name in scenario_names():
        if only not in name or not isinstance(loaded := load_scenario(name), Scenario):
            continue  # a kernel is marched: level_set.py
        runs = 1 if loaded.independent_runs else None  # robots on a course have one start
        code = (
            "import time; from holdfast.scenario.load import load_scenario; "
            "t = time.perf_counter(); "
            "short = ['run.horizon=0.2', 'run.record_every=0.2']; "
            f"load_scenario({name!r}, short, runs={runs}).run(); "
            "print(time.perf_counter() - t)"
        )
        with tempfile.TemporaryDirectory() as cache:
            cold = seconds(code, cache)
            warm = seconds(code, cache)
        print(f"{name:<34} {cold:8.2f} {warm:8.2f}", flush=True)


if __name__ == "__main__":
    began = time.perf_counter()
    main()
    print(f"\n{time.perf_counter() - began:.0f} s in all", file=sys.stderr)
