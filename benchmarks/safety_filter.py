"""The time of a decision of a safety filter: from Python, for many vehicles, and as C.

`python benchmarks/safety_filter.py` prints a table. The states are those of a vehicle that strays
through the set at 50 Hz; each number is the least of seven repetitions, on one core.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import holdfast as hf

CALLS = 5000
LOOP = """
void many(const double *seen, const double *handed, long count, double *answer) {
    keep_state s;
    keep_start(&s);
    for (long k = 0; k < count; k++)
        keep_step(&s, 0.0, 0.02, seen + k * KEEP_SEEN, handed + k * KEEP_INPUTS,
                  keep_parameters, answer, answer + KEEP_INPUTS);
}
"""


def least(run, count: int) -> float:
    """The least time of one of `count` decisions, in nanoseconds."""
    best = float("inf")
    for _ in range(7):
        began = time.perf_counter()
        run()
        best = min(best, (time.perf_counter() - began) / count)
    return best * 1e9


def in_c(keep: hf.SafetyFilter, states: np.ndarray, commands: np.ndarray) -> float:
    """The time of a step of the exported filter [ns]."""
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "keep.c"), Path(folder, "keep.so")
        source.write_text(keep.export_c("keep") + LOOP)
        subprocess.run(
            ["cc", "-std=c99", "-O2", "-shared", "-fPIC", source, "-o", library, "-lm"], check=True
        )
        code = ctypes.CDLL(str(library))
        answer = np.zeros(16)
        given = [a.ctypes.data_as(ctypes.c_void_p) for a in (states, commands, answer)]
        count = ctypes.c_long(len(states))
        return least(lambda: code.many(given[0], given[1], count, given[2]), len(states))


def strayed(rng: np.random.Generator, low: list[float], high: list[float]) -> np.ndarray:
    """States that follow one another at up to 0.5 m/s and 0.5 rad/s, within a box."""
    steps = np.cumsum(0.01 * rng.uniform(-1, 1, (20_000, len(low))), axis=0)
    wide = np.subtract(high, low)
    return np.array(low) + wide * np.abs((steps / wide + 0.5) % 2 - 1)  # back at the ends


def filters() -> Iterator[tuple[str, hf.SafetyFilter, np.ndarray, np.ndarray]]:
    """Filters with the states and commands they are asked about."""
    rng = np.random.default_rng(0)
    vehicle = hf.systems.marine_vehicle()
    region = hf.SafetyFilter(vehicle, hf.regions.camera_view(), gains=(1.5, 8))
    states = strayed(rng, [-1.6, 0.3, -0.5, 0, -0.01, -0.1], [-0.8, 0.5, -0.2, 0.1, 0.01, 0.1])
    yield "region of the camera, six states", region, states, 3 * rng.normal(size=(20_000, 2))
    for name, settings in (
        ("kernel, three states, at the last time", ["march.times=[3]"]),
        ("kernel, three states, at 31 times", []),
    ):
        scenario = hf.load_scenario("ch7-any-current", ["promise=", *settings])
        kernel = hf.SafetyFilter(scenario.system, scenario.solve(), around=scenario.system)
        yield name, kernel, *asked(rng)


def asked(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Poses in the view, and commands for them."""
    states = strayed(rng, [-1.5, -0.3, -0.2], [-0.7, 0.3, 0.2])
    return states, rng.normal(size=(20_000, 2))


def main() -> None:
    """Print the table."""
    warnings.simplefilter("ignore")
    print("| filter | changed | one at a time, Python | many at a time, each | C, each |")
    print("|---|---|---|---|---|")
    for name, keep, states, commands in filters():
        changed = np.mean(
            [s is not hf.Status.PASSED for s in keep.step_many(states, commands).status]
        )
        pairs = list(zip(states[:CALLS], commands[:CALLS], strict=True))

        def one(keep=keep, pairs=pairs) -> None:
            for state, command in pairs:
                keep.step(state, command, 0.0)

        def many(keep=keep, states=states, commands=commands) -> None:
            keep.step_many(states, commands)

        single, together = least(one, CALLS), least(many, len(states))
        code = in_c(keep, states, commands)
        times = f"{single / 1e3:.1f} us | {together:.0f} ns | {code:.0f} ns"
        print(f"| {name} | {changed:.0%} | {times} |")


if __name__ == "__main__":
    main()
