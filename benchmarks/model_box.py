"""What a filter that counts a box of parameters keeps, beyond its box too, and what a call costs.

Every row is `inspection` with the filter as shipped and with one that knows its nominal model alone
(`safeguard.uncertain` removed). 150 s, 50 Hz, two 5 N thrusters unless it says otherwise; printed
is how many runs never leave the view, the fewest at one vertex, and how many runs had a sample
without an admissible input.

  python benchmarks/model_box.py vertices            # 203 and 600 starts, two seeds, 64 vertices
  python benchmarks/model_box.py current             # the same vertices in a measured current
  python benchmarks/model_box.py beyond              # what no box counts
  python benchmarks/model_box.py calls               # CPU time of a decision, Python and C
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import sympy as sp

import holdfast as hf
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.studies.comparison import variant

NOMINAL = "safeguard.uncertain="
LAST = "run.record_every=150.0"
WEAK = 0.8  # of the thrust of one thruster


def counted(result: hf.Result) -> str:
    """Runs that stay, the fewest at one vertex, runs with a sample without an admissible input."""
    runs = result.dataset.sizes["run"]
    relaxed = int((result.dataset["infeasible"].values > 0).sum())
    vertices = result.summary()["vertices"]
    fewest = f", fewest {min(v['viable'] for v in vertices)}" if vertices else ""
    return f"{result.viable:,} of {runs:,}{fewest}, relaxed in {relaxed}"


def vertices(seed: int, starts: int, *more: str) -> Scenario:
    """`inspection` at the 64 vertices of its model, from so many starts of a seed."""
    return variant("inspection", "inspection", "axes", starts, [LAST, f"run.seed={seed}", *more])


CURRENT = (
    "system.current_limit=0.1", "safeguard.disturbance_measured=true", "starts.states=[]",
    'varied.draws.direction={ range = ["-180 deg", "180 deg"], unit = "rad" }',
)  # fmt: skip
"""A measured current of 0.1 m/s in a random direction."""


CALMER = (
    "law.k1=0.14", "safeguard.gains=[4.0, 8.0]", "safeguard.margins.too_near=0.1",
    "safeguard.margins.edge_low=0.06", "safeguard.margins.edge_high=0.06",
)  # fmt: skip
"""What keeps nearly all starts in a measured current at every vertex."""
DIRECTIONS = 8


def flow(direction: str) -> tuple[str, ...]:
    return (f'disturbance.Vx="0.1*cos({direction})"', f'disturbance.Vy="0.1*sin({direction})"')


def in_current(direction: int, starts: int, *more: str) -> hf.Result:
    """The runs at the 64 vertices in a measured current in one of `DIRECTIONS`."""
    angle = repr(2 * np.pi * direction / DIRECTIONS)
    return vertices(1 + direction, starts, *CURRENT[:3], *flow(angle), *more).run()


BEYOND: dict[str, tuple[str, ...]] = {
    "yaw moment, 0.02 N m": (
        "system.unmodelled={ tau_r = [-0.02, 0.02] }", "disturbance.unmodelled_tau_r=0.02",
    ),
    "the same, with `worst`": (
        "system.unmodelled={ tau_r = [-0.02, 0.02] }", "disturbance.unmodelled_tau_r=0.02",
        'safeguard.worst=["unmodelled_tau_r"]',
    ),
    "thruster lag of 0.1 s": ("system.lag={ tau_u = 0.1, tau_r = 0.1 }",),
    "thruster lag of 0.3 s": ("system.lag={ tau_u = 0.3, tau_r = 0.3 }",),
    "one thruster 20 % weak": (),
    "current turns in 63 s": (*CURRENT, *flow("direction + 0.1*t")),
    "current turns in 13 s": (*CURRENT, *flow("direction + 0.5*t")),
    "current jumps in 7.9 s": (
        *CURRENT, 'varied.draws.phase={ range = ["-180 deg", "180 deg"], unit = "rad" }',
        *flow("direction + pi*select(sin(0.4*t + phase), 0, 1)"),
    ),
    "current jumps in 1.6 s": (
        *CURRENT, 'varied.draws.phase={ range = ["-180 deg", "180 deg"], unit = "rad" }',
        *flow("direction + pi*select(sin(2*t + phase), 0, 1)"),
    ),
    "current, starts on a limit": (
        *CURRENT, *flow("direction"),
        'starts.active=[["edge_low"], ["edge_high"], ["too_near"], ["too_far"]]',
    ),
}  # fmt: skip
"""Case -> what it changes in `inspection`."""


def with_weak_thruster(scenario: Scenario) -> Scenario:
    """The same with a starboard thruster that gives a share of what it is told.

    Fs = (tau_u + tau_r / arm) / 2, of which (1 - WEAK) are missing.
    """
    system = scenario.system
    force, moment, arm = (hf.symbol(n) for n in ("tau_u", "tau_r", "thruster_arm"))
    missing = sp.Float(1 - WEAK) * (force + moment / arm) / 2
    given = {force: force - missing, moment: moment - arm * missing}
    rates = {n: e.xreplace(given) for n, e in system.rates.items()}
    return replace(scenario, system=replace(system, rates=rates))


def beyond(case: str, starts: int, seed: int, *more: str) -> hf.Result:
    """The runs of a case from random starts at rest."""
    changes = [f"starts.random={starts}", "starts.states=[]", f"run.seed={seed}", LAST, "compare="]
    scenario = hf.load_scenario("inspection", [*changes, *BEYOND[case], *more])
    return (with_weak_thruster(scenario) if "weak" in case else scenario).run()


# -- a call ------------------------------------------------------------------------------------

LOOP = """
void many(const double *seen, const double *handed, long count, double *answer) {
    keep_state s;
    keep_start(&s);
    for (long k = 0; k < count; k++)
        keep_step(&s, 0.0, 0.02, seen + k * KEEP_SEEN, handed + k * KEEP_INPUTS,
                  keep_parameters, answer, answer + KEEP_INPUTS);
}
"""


def filters() -> tuple[hf.SafetyFilter, hf.SafetyFilter]:
    """The filter of `inspection` around any command: that of its nominal model, and of its box."""
    return tuple(
        hf.load_scenario(
            "inspection", ["law={ external = true }", "tracking=", "reference=", "compare=", *more]
        ).safety_filter()
        for more in ((NOMINAL,), ())
    )  # type: ignore[return-value]


def asked() -> tuple[np.ndarray, np.ndarray]:
    """States along paths through the view, and commands of which the filter changes most."""
    rng = np.random.default_rng(0)
    steps = np.cumsum(0.01 * rng.uniform(-1, 1, (20_000, 6)), axis=0)
    low = np.array([-1.6, 0.3, -0.5, 0, -0.01, -0.1])
    wide = np.array([-0.8, 0.5, -0.2, 0.1, 0.01, 0.1]) - low
    return low + wide * np.abs((steps / wide + 0.5) % 2 - 1), 3 * rng.normal(size=(20_000, 2))


def least(run, count: int) -> float:
    """The least CPU time of one of `count` decisions, in microseconds."""
    best = float("inf")
    for _ in range(7):
        began = time.process_time()
        run()
        best = min(best, (time.process_time() - began) / count)
    return best * 1e6


def in_c(keep: hf.SafetyFilter, folder: Path) -> ctypes.CDLL:
    source, library = folder / "keep.c", folder / f"keep{id(keep)}.so"
    source.write_text(keep.export_c("keep") + LOOP)
    subprocess.run(
        ["cc", "-std=c99", "-O2", "-shared", "-fPIC", source, "-o", library, "-lm"], check=True
    )
    return ctypes.CDLL(str(library))


def calls() -> Iterator[tuple[str, list[float]]]:
    """Python and C: the CPU time [us] of a decision of the nominal filter, and of the box."""
    states, commands = asked()
    pair = filters()
    few = list(zip(states[:3000], commands[:3000], strict=True))

    def stepped(keep: hf.SafetyFilter) -> None:
        keep.reset()
        for state, command in few:
            keep.step(state, command)

    yield "Python", [least(lambda k=k: stepped(k), len(few)) for k in pair]  # type: ignore[misc]
    with tempfile.TemporaryDirectory() as folder:
        codes = [in_c(k, Path(folder)) for k in pair]
        answer = np.zeros(16)
        given = [a.ctypes.data_as(ctypes.c_void_p) for a in (states, commands, answer)]
        count = ctypes.c_long(len(states))
        yield (
            "C",
            [
                least(lambda c=c: c.many(given[0], given[1], count, given[2]), len(states))  # type: ignore[misc]
                for c in codes
            ],
        )


def main(what: str = "vertices", *more: str) -> None:
    if what == "calls":
        for language, (nominal, box) in calls():
            print(f"{language}: {nominal:.2f} us nominal, {box:.2f} us box, {box / nominal:.2f}")
    elif what == "current":
        for changes in (more, (*CALMER, *more)):
            counts = [in_current(k, 25, *changes).viable for k in range(DIRECTIONS)]
            print(f"{sum(counts):,} of {DIRECTIONS * 64 * 25:,}: {counts}", flush=True)
    elif what == "beyond":
        for case in BEYOND:
            if more and more[0] not in case:
                continue
            nominal, box = (counted(beyond(case, 200, 1, *o)) for o in ((NOMINAL,), ()))
            print(f"{case}\n    nominal {nominal}\n    box     {box}", flush=True)
    else:
        for starts in (203, 600):
            for seed in (1, 20261126):
                box = counted(vertices(seed, starts, *more).run())
                print(f"{starts} starts, seed {seed}: {box}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
