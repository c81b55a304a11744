"""Marches over a grid: holdfast beside hj_reachability, and beside what the machine can do.

The same grid, margin, scheme, dissipation, share of the longest stable step and order of the
Runge-Kutta method, in one process, in turns, after compilation; both use every core. Of third order
the peer has three stages for an Euler step, ours four for two. docs/benchmarks.md says what each
column is.

python -m pip install -e ".[benchmark]" && python benchmarks/level_set.py
"""

from __future__ import annotations

import argparse
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from level_sets import OURS, LevelSet, Peer, aircraft, game, limited_weno5, reach
from machine import bytes_per_second, operations_per_second

from holdfast.execution.resources import available_cores

PROBLEMS = {
    "aircraft": partial(aircraft, (51, 40, 50), 129),
    "game": partial(game, 51, 85),
    "reach": partial(reach, 26, 25),
    "aircraft-fine": partial(aircraft, (101, 80, 100), 20),
    "game-fine": partial(game, 101, 20),
}

OPERATIONS = {"upwind": 6, "weno5": 78}
"""Additions, multiplications, divisions and comparisons along an axis at a node: both slopes, their
mean and half their gap, where what neighbours share is made once."""

STEPPING = 6
"""The same for a stage of a step, with the limit of the rate's sign."""

ARRAYS = {"upwind": 2.0, "weno5": 11 / 4}
"""Numbers read and written at a node in a stage: of the values, the new values, and in all but the
first stage those at the start of the step."""


@dataclass
class Row:
    """A problem and a scheme: seconds of every march, and what their values say."""

    problem: LevelSet
    scheme: str
    precision: str
    peer: Peer
    seconds: dict[str, list[float]] = field(default_factory=dict)
    first: dict[str, float] = field(default_factory=dict)
    computed: float = math.nan
    differences: dict[str, float] = field(default_factory=dict)
    sides: int = 0
    inside: int = 0

    def ours(self, **options: object) -> tuple[np.ndarray, float]:
        values, said = self.problem.march(self.scheme, precision=self.precision, **options)
        assert said["steps"] == -(-self.problem.steps // OURS[self.scheme].lengths)
        self.computed = said["computed_share"]
        return values, said["wall_time_s"]

    @property
    def contenders(self) -> dict[str, Callable[[], tuple[np.ndarray, float]]]:
        return {
            "every node": partial(self.ours, skip=False),
            "one thread": partial(self.ours, skip=False, threads=1),
            "peer": self.peer.march,
            "ours": self.ours,
            "answer": partial(self.ours, alone=False),
        }

    def prepare(self) -> None:
        """Compile, and compare: as they are, and the peer with our slopes."""
        found = {}
        for name in ("ours", "peer"):
            began = time.perf_counter()
            found[name] = self.contenders[name]()[0]
            self.first[name] = time.perf_counter() - began
        gap = np.abs(found["ours"] - found["peer"])
        self.differences = {"largest": float(gap.max()), "median": float(np.median(gap))}
        self.sides = int(((found["ours"] > 0) != (found["peer"] > 0)).sum())
        self.inside = int((found["ours"] > 0).sum())
        if self.scheme == "weno5":
            same = Peer(self.problem, self.scheme, limited_weno5).march()[0]
            gap = np.abs(found["ours"] - same)
        self.differences["same slopes"] = float(gap.max())

    def repeat(self) -> None:
        for name, march in self.contenders.items():
            began = time.perf_counter()
            values, seconds = march()
            del values
            self.seconds.setdefault(name, []).append(seconds)
            self.seconds.setdefault(f"{name}, whole call", []).append(time.perf_counter() - began)

    def least(self, name: str) -> float:
        return min(self.seconds[name])

    def nanoseconds(self, name: str) -> float:
        """Per node and stage."""
        ours, three = OURS[self.scheme], {"upwind": 1, "weno5": 3}[self.scheme]
        steps = self.problem.steps
        stages = three * steps if name == "peer" else len(ours.stages) * -(-steps // ours.lengths)
        return 1e9 * self.least(name) / stages / self.problem.grid.nodes

    @property
    def operations(self) -> int:
        axes = len(self.problem.grid.axes)
        return axes * OPERATIONS[self.scheme] + self.problem.operations + STEPPING

    @property
    def bytes(self) -> float:
        return ARRAYS[self.scheme] * np.dtype(self.precision).itemsize


def rows(names: list[str], precision: str) -> Iterator[Row]:
    for name in names:
        problem = PROBLEMS[name]()
        for scheme in ("upwind", "weno5"):
            yield Row(problem, scheme, precision, Peer(problem, scheme))


def table(head: tuple[str, ...], lines: list[tuple[str, ...]]) -> None:
    """In Markdown."""
    for line in (head, ("---",) * len(head), *lines):
        print("| " + " | ".join(line) + " |")
    print(flush=True)


def show(found: list[Row], threads: int) -> None:
    def named(row: Row) -> tuple[str, str, str]:
        return row.problem.name, " x ".join(map(str, row.problem.grid.shape)), row.scheme

    print("Seconds\n")
    table(
        ("set", "nodes", "scheme", "steps", "ours", "whole call", "computed", "every node",
         "one thread", "peer", "ratio", "every node", "answer", "ratio", "first call", "peer"),
        [
            (*named(r), str(r.problem.steps), f"{r.least('ours'):.3f}",
             f"{r.least('ours, whole call'):.3f}", f"{100 * r.computed:.0f} %",
             f"{r.least('every node'):.3f}", f"{r.least('one thread'):.3f}",
             f"{r.least('peer'):.3f}", f"**{r.least('peer') / r.least('ours'):.1f}**",
             f"{r.least('peer') / r.least('every node'):.1f}", f"{r.least('answer'):.3f}",
             f"{r.least('peer') / r.least('answer'):.1f}", f"{r.first['ours']:.1f}",
             f"{r.first['peer']:.1f}")
            for r in found
        ],
    )  # fmt: skip
    print("Nanoseconds per node and stage, every node computed\n")
    flops = operations_per_second(found[0].precision, threads)
    lines = []
    for r in found:
        speed = bytes_per_second(3 * r.problem.grid.nodes, r.precision, threads)
        least = 1e9 * r.bytes / speed, 1e9 * r.operations / flops
        lines.append(
            (*named(r), f"{r.nanoseconds('every node'):.2f}", f"{r.nanoseconds('peer'):.1f}",
             f"{r.bytes:.0f}", f"{speed / 1e9:.0f}", f"{least[0]:.2f}", f"{r.operations}",
             f"{least[1]:.2f}", f"{100 * max(least) / r.nanoseconds('every node'):.0f} %")
        )  # fmt: skip
    print(f"{flops / 1e9:.0f} G operations/s by {threads} threads\n")
    table(
        ("set", "nodes", "scheme", "ours", "peer", "bytes", "GB/s", "at least", "operations",
         "at least", "reached"),
        lines,
    )  # fmt: skip
    print("Differences of the values\n")
    table(
        ("set", "nodes", "scheme", "largest", "median", "other side of 0", "largest, same slopes"),
        [
            (*named(r), f"{r.differences['largest']:.1e}", f"{r.differences['median']:.1e}",
             f"{r.sides} of {r.inside}", f"{r.differences['same slopes']:.1e}")
            for r in found
        ],
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--precision", choices=("float64", "float32"), default="float64")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--only", choices=tuple(PROBLEMS), action="append")
    options = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", options.precision == "float64")
    threads = available_cores()
    print(f"{options.precision}; load average {os.getloadavg()[0]:.2f} before", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["HOLDFAST_CACHE_DIR"] = folder  # the first call is one
        found = list(rows(options.only or list(PROBLEMS), options.precision))
        for row in found:
            row.prepare()
            for _ in range(options.repetitions):
                row.repeat()
    print(f"load average {os.getloadavg()[0]:.2f} after\n")
    show(found, threads)


if __name__ == "__main__":
    main()
