"""Observed orders of convergence against exact values, for every scheme: docs/convergence.md.

python benchmarks/convergence.py [--only A2] [--schemes upwind,weno5]
python benchmarks/convergence.py --beside OTHER/src     seconds by weno5 beside another version
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from exact import PROBLEMS, Exact

import holdfast as hf

SCHEMES = ("upwind", "eno2", "eno3", "weno5")


@dataclass
class Observed:
    """Errors on every grid: of the volume, relative; of the value near the boundary, as a mean and
    the largest; or of the value at points of the boundary."""

    errors: dict[str, list[float]] = field(default_factory=dict)

    def add(self, problem: Exact, found: hf.ValueFunction) -> None:
        if problem.points is not None:
            gap = np.abs(found.at(problem.points))
        else:
            exact = problem.exactly(found.grid)
            gap = np.abs(found.values() - exact)[np.abs(exact) <= problem.near]
        of = {"mean": float(gap.mean()), "largest": float(gap.max())}
        if problem.volume is not None:
            of["volume"] = abs(volume(found) / problem.volume - 1)
        for name, error in of.items():
            self.errors.setdefault(name, []).append(error)

    def orders(self, name: str) -> list[float]:
        """log2 of how much smaller the error is on a grid twice as fine."""
        return [math.log2(a / b) for a, b in itertools.pairwise(self.errors[name])]

    @property
    def said(self) -> list[str]:
        """The errors on the finest grid, each with its orders."""
        cells = []
        for name in ("mean", "largest", "volume"):
            known = name in self.errors
            cells.append(f"{self.errors[name][-1]:.1e}" if known else "")
            cells.append(", ".join(f"{p:.1f}" for p in self.orders(name)) if known else "")
        return cells


def grids(problem: Exact) -> str:
    """The numbers of cells, those of all axes at once where they are the same."""
    sizes = [{*c} for c in problem.cells]
    return ", ".join(
        str(c[0]) if len(s) == 1 else " x ".join(map(str, c))
        for c, s in zip(problem.cells, sizes, strict=True)
    )


def volume(found: hf.ValueFunction, points: int = 2400) -> float:
    """Of { V > 0 } in the plane, by the interpolant in the middle of many small cells."""
    inside = 0
    axes = found.grid.axes
    lines = [a.low + (a.high - a.low) * (np.arange(points) + 0.5) / points for a in axes]
    for row in np.array_split(lines[0], 40):
        at = np.stack(np.meshgrid(row, lines[1], indexing="ij"), axis=-1).reshape(-1, 2)
        inside += int(found.contains(at).sum())
    return inside / points**2 * math.prod(a.high - a.low for a in axes)


def observe(problem: Exact, scheme: str) -> Observed:
    """The errors of a scheme, with the options that it has by default."""
    found = Observed()
    for level in range(len(problem.cells)):
        found.add(problem, problem.march(level, scheme, **options(problem)))
    return found


def options(problem: Exact) -> dict[str, int]:
    return {"arrival_steps": 0} if problem.find is hf.capture_basin else {}


def table(head: tuple[str, ...], lines: Iterable[tuple[str, ...]]) -> None:
    """In Markdown, a line as soon as it is known."""
    for line in itertools.chain([head, ("---",) * len(head)], lines):
        print("| " + " | ".join(line) + " |", flush=True)
    print()


TURNS = 5


def timed() -> None:
    """Seconds of one core for every problem that is named on a line of the input."""
    for line in sys.stdin:
        problem = PROBLEMS[line.strip()]()
        began = time.process_time()
        problem.march(1, "weno5", threads=1, **options(problem))
        print(time.process_time() - began, flush=True)


def beside(other: str, names: Iterable[str]) -> None:
    """Medians of some turns after one that compiles, and their ratio."""
    sources = other, os.path.dirname(os.path.dirname(hf.__file__))
    sides = [
        subprocess.Popen(
            [sys.executable, __file__, "--timed"], text=True, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": source},
        )
        for source in sources
    ]  # fmt: skip

    def seconds(side: subprocess.Popen[str], name: str) -> float:
        assert side.stdin
        assert side.stdout
        side.stdin.write(f"{name}\n")
        side.stdin.flush()
        return float(side.stdout.readline())

    ratios = []
    print("| problem | there, s | here, s | there / here |\n| --- | --- | --- | --- |")
    for name in names:
        turns = [[seconds(side, name) for side in sides] for _ in range(1 + TURNS)]
        there, here = (statistics.median(t[k] for t in turns[1:]) for k in (0, 1))
        ratios.append(there / here)
        print(f"| {name} | {there:.3f} | {here:.3f} | {there / here:.2f} |", flush=True)
    print(f"median of the ratios: {statistics.median(ratios):.2f}")
    for side in sides:
        side.communicate()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--only", choices=tuple(PROBLEMS), action="append")
    parser.add_argument("--schemes", default=",".join(SCHEMES))
    parser.add_argument("--beside", help="the folder src of another version")
    parser.add_argument("--timed", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.timed:
        return timed()
    if chosen.beside:
        return beside(chosen.beside, chosen.only or PROBLEMS)
    problems = [PROBLEMS[name]() for name in chosen.only or PROBLEMS]
    table(
        ("problem", "", "cells along every axis", "near the boundary"),
        ((p.name, p.what, grids(p),
          f"V within {p.near:g}" if p.points is None else f"{len(p.points)} points")
         for p in problems),
    )  # fmt: skip
    table(
        ("problem", "scheme", "mean", "orders", "largest", "orders", "volume", "orders"),
        ((p.name, scheme, *observe(p, scheme).said)
         for p, scheme in itertools.product(problems, chosen.schemes.split(","))),
    )  # fmt: skip


if __name__ == "__main__":
    main()
