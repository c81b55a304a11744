"""How long a law exported as C99 takes, along runs of its scenario, and how much stack it needs.

python benchmarks/exported_law.py            # laws of scenarios
python benchmarks/exported_law.py filters    # filters over kernels, against those by slopes
"""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import sympy as sp

import holdfast as hf
from holdfast.execution.codegen.c_timing import time_law

NAMES = (
    "ch4-unicycle", "ch3-unknown-current", "ch4-chained-4", "ch5-viable-goal-set", "ch6-chain",
    "inspection", "ch5-rescue",
)  # fmt: skip
RUNS = 4


def stack(text: str) -> int:
    """Bytes on the stack, all functions that remain together."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "law.c").write_text(text)
        subprocess.run(
            ["gcc", "-std=c99", "-O2", "-fstack-usage", "-c", "law.c"], cwd=folder, check=True
        )
        return sum(map(int, re.findall(r"\t(\d+)\t", (Path(folder) / "law.su").read_text())))


# -- filters over kernels ------------------------------------------------------------------------

HOLD, SAMPLES, STARTS, TURNS = 0.02, 500, 100, 45
X, V, Y, PSI = (hf.symbol(n) for n in ("x", "v", "y", "psi"))
Problem = tuple[hf.System, hf.ValueFunction, Callable, float]


def pushed(push: float) -> tuple[sp.Expr | int, dict]:
    """What is added to a rate, and the arguments of a system that has this disturbance."""
    more = {"disturbances": (hf.Quantity("d"),), "disturbance_bounds": hf.Box((-push,), (push,))}
    return (hf.symbol("d"), more) if push else (0, {})


def kernel(system: hf.System, region: hf.Region, grid: hf.Grid) -> hf.ValueFunction:
    solved = hf.discriminating_kernel if system.disturbances else hf.viability_kernel
    return solved(system, region, grid, horizon=30)


def cart(push: float) -> Problem:
    """|x - v / 5| <= 1, |v| <= 1.8, v' = u + d, on 81 x 81 nodes."""
    d, more = pushed(push)
    system = hf.System(
        "cart", (hf.Quantity("x"), hf.Quantity("v")), (hf.Quantity("u"),),
        {"x": V, "v": hf.symbol("u") + d}, input_bounds=hf.Box((-1,), (1,)), **more,
    )  # fmt: skip
    limits = {"left": -1 - X + V / 5, "right": X - V / 5 - 1, "speed": abs(V) - 1.8}
    region = hf.Region(
        "leaning", system.states, tuple(hf.Inequality(n, e) for n, e in limits.items())
    )
    grid = hf.grid(system, {"x": (-1.5, 1.5), "v": (-2, 2)}, 81)
    rates = lambda q, u, d: [q[1], u + d]  # noqa: E731
    return system, kernel(system, region, grid), rates, push


def car(push: float) -> Problem:
    """A car of constant speed that is pushed to the side in a round room, on 41^3 nodes."""
    d, more = pushed(push)
    system = hf.System(
        "car", (hf.Quantity("x"), hf.Quantity("y"), hf.Quantity("psi", "rad", angle=True)),
        (hf.Quantity("w"),), {"x": sp.cos(PSI) + d, "y": sp.sin(PSI), "psi": hf.symbol("w")},
        input_bounds=hf.Box((-1,), (1,)), **more,
    )  # fmt: skip
    region = hf.Region("room", system.states[:2], (hf.Inequality("wall", X**2 + Y**2 - 9),))
    grid = hf.grid(system, {"x": (-3.4, 3.4), "y": (-3.4, 3.4), "psi": (-np.pi, np.pi)}, 41)
    rates = lambda q, u, d: [np.cos(q[2]) + d, np.sin(q[2]), u]  # noqa: E731
    return system, kernel(system, region, grid), rates, push


LOOP = """
void many(const double *seen, const double *handed, long count, double *answer) {
    keep_state s;
    double actuators[KEEP_ACTUATORS];
    keep_start(&s);
    for (long k = 0; k < count; k++)
        keep_step(&s, 0.0, 0.02, seen + k * KEEP_SEEN, handed + k * KEEP_INPUTS,
                  keep_parameters, answer + k * KEEP_INPUTS, actuators);
}
"""


class Filter:
    """A filter in C, and what it is asked along closed loops of its own from states it keeps."""

    def __init__(self, problem: Problem, ahead: bool, folder: Path) -> None:
        system, value, rates, push = problem
        law = hf.safety_law(system, value, hf.commanded(system), sample_time=HOLD, ahead=ahead)
        source, library = folder / f"{ahead}.c", folder / f"{system.name}{push}{ahead}.so"
        source.write_text(hf.export_c(system, law, "keep") + LOOP)
        options = ["-std=c99", "-O2", "-shared", "-fPIC"]
        subprocess.run(["cc", *options, source, "-o", library, "-lm"], check=True)
        self.code = ctypes.CDLL(str(library))
        margin = next(p.value for p in law.parameters if p.name == "safety_margin")
        rng = np.random.default_rng(0)
        low, high = (np.array([getattr(a, e) for a in value.grid.axes]) for e in ("low", "high"))
        q = rng.uniform(low, high, (20_000, len(low)))
        q = q[np.nan_to_num(value.at(q), nan=-1.0) > 1.5 * margin][:STARTS]
        asked, wanted = [], rng.uniform(-1, 1, (len(q), 1))
        for _ in range(SAMPLES):
            new = rng.uniform(size=len(q)) < HOLD
            wanted[new] = rng.uniform(-1, 1, (new.sum(), 1))
            u = self.answers(q, wanted)
            asked.append((q, wanted.copy(), u != wanted[:, 0]))
            d = push * rng.choice([-1, 1], len(q))
            f = lambda z: np.stack(np.broadcast_arrays(*rates(z.T, u, d)), 1)  # noqa: E731, B023
            a = f(q)
            b = f(q + HOLD / 2 * a)
            c = f(q + HOLD / 2 * b)
            q = q + HOLD / 6 * (a + 2 * b + 2 * c + f(q + HOLD * c))
        self.seen, self.wanted, self.acts = (
            np.ascontiguousarray(np.concatenate(np.stack(one, axis=1)))
            for one in zip(*asked, strict=True)
        )

    def answers(self, seen: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        result = np.zeros(len(seen))
        where = [a.ctypes.data_as(ctypes.c_void_p) for a in (seen, wanted, result)]
        self.code.many(where[0], where[1], ctypes.c_long(len(seen)), where[2])
        return result

    def nanoseconds(self, chosen: np.ndarray) -> float:
        """CPU time of one of the calls that are chosen."""
        seen, wanted = self.seen[chosen], self.wanted[chosen]
        began = time.process_time()
        self.answers(seen, wanted)
        return 1e9 * (time.process_time() - began) / max(len(seen), 1)


def filters() -> None:
    """Medians over turns: calls of the filter by the sampled game, of that by slopes, the ratio."""
    print("| filter over | which calls | share | ns by the game | ns by slopes | ratio |")
    print("|---|---|---|---|---|---|")
    for problem in (cart, car):
        for push in (0.0, 0.2 if problem is cart else 0.1):
            with tempfile.TemporaryDirectory() as folder:
                built = problem(push)
                pair = [Filter(built, ahead, Path(folder)) for ahead in (True, False)]
            for what in ("all", "command passes", "filter acts"):
                masks = [
                    {"all": k.acts | True, "filter acts": k.acts}.get(what, ~k.acts) for k in pair
                ]
                turns = [
                    [k.nanoseconds(m) for k, m in zip(pair, masks, strict=True)]
                    for _ in range(TURNS)
                ]
                game, slopes = np.median(turns, axis=0)
                ratio = np.median([a / b for a, b in turns])
                shares = " and ".join(f"{100 * m.mean():.0f} %" for m in masks)
                print(
                    f"| {problem.__name__}, push {push} | {what} | {shares} | {game:.0f} "
                    f"| {slopes:.0f} | {ratio:.2f} |",
                    flush=True,
                )


def main(what: str = "laws") -> None:
    if what == "filters":
        return filters()
    print("| law of | modes | lines | stack, bytes | ns a call |\n|---|---|---|---|---|")
    for name in NAMES:
        scenario = hf.load_scenario(name)
        text = hf.export_c(scenario.system, scenario.law, name)
        data = scenario.run(part=range(min(RUNS, scenario.runs))).dataset
        times, states = data["time"].values, data["state"].values
        found = time_law(text, name, times, states, scenario.settings["sample_time"])
        modes = len(getattr(scenario.law, "modes", [1]))
        print(
            f"| `{name}` | {modes} | {len(text.splitlines())} | {stack(text)} "
            f"| {found.nanoseconds:.0f} |"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
