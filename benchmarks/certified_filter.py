"""The time of a decision of a filter by proof, and of a step of the law of its certificate as C.

`python benchmarks/certified_filter.py` prints a table: the shipped certificate of a target in view
(101 x 101 cells, 25 inputs), random states of certified cells; each number is the least of seven
repetitions, on one core.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from safety_filter import least

import holdfast as hf

CALLS = 2000
MANY = 20_000
LOOP = """
void many(const double *seen, long count, double *answer) {
    keep_state s;
    keep_start(&s);
    for (long k = 0; k < count; k++)
        keep_step(&s, 0.0, 0.1, seen + k * KEEP_SEEN, keep_parameters, answer,
                  answer + KEEP_INPUTS);
}
"""


def in_c(text: str, states: np.ndarray) -> float:
    """The time of a step of the exported law [ns]."""
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "keep.c"), Path(folder, "keep.so")
        source.write_text(text + LOOP)
        subprocess.run(
            ["cc", "-std=c99", "-O2", "-shared", "-fPIC", source, "-o", library, "-lm"], check=True
        )
        code, answer = ctypes.CDLL(str(library)), np.zeros(16)
        seen, out = (a.ctypes.data_as(ctypes.c_void_p) for a in (states, answer))
        count = ctypes.c_long(len(states))
        return least(lambda: code.many(seen, count, out), len(states))


def main() -> None:
    target = hf.load_scenario("seen-target")
    box = {"ahead": (0.3, 2.1), "left": (-1.2, 1.2)}
    found = hf.certify(target.system, target.region, box=box, cells=101, sample_time=0.1)
    keep, rng = hf.CertifiedFilter(found, target.system), np.random.default_rng(0)
    low, high = found.cells.corners(rng.choice(found.kept.members, MANY))
    states = np.ascontiguousarray(low + rng.uniform(size=low.shape) * (high - low))
    commands = rng.uniform([-0.5, -0.8], [0.5, 0.8], states.shape)
    told = keep.step_many(states, commands)
    print(f"{'':<42}{'us':>8}  of T")
    for status in (hf.Status.PASSED, hf.Status.CHANGED):
        some = [k for k, s in enumerate(told.status) if s is status][:CALLS]
        pairs = list(zip(states[some], commands[some], strict=True))

        def run(pairs: list[tuple[np.ndarray, np.ndarray]] = pairs) -> None:
            for x, w in pairs:
                keep.step(x, w)

        show(f"a decision in Python, {status.value}", least(run, len(pairs)))
    show(
        f"one of {MANY} together ({told.status.count(hf.Status.CHANGED) / MANY:.0%} changed)",
        least(lambda: keep.step_many(states, commands), MANY),
    )
    show("the law in C", in_c(hf.export_c(target.system, hf.certified_law(found), "keep"), states))


def show(what: str, time: float) -> None:
    print(f"{what:<42}{time / 1000:8.3g}  1/{0.1e9 / time:,.0f}")


if __name__ == "__main__":
    main()
