"""Grids that are finer near the boundary, against exact kernels: docs/kernels.md.

python benchmarks/refined_grids.py [--only A6,A2] [--scheme eno2] [--refine 8] [--share 0.1]

Every problem is solved on the finer grid everywhere, and with `refine` from a coarser one. Marched
are the nodes of both grids in a mean step of the finer one; the error is the mean at its nodes
within two of its cells of the boundary, or at points of it; seconds are those of all cores.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass, replace

import numpy as np
from convergence import options
from exact import PROBLEMS, Exact

import holdfast as hf
from holdfast.analysis.reachability.grid import Grid

CASES = {
    "A6": ((60, 50), (2, 4, 8)),
    "A5": ((50, 48), (2, 4, 8)),
    "A2": ((50, 50), (2, 4, 8)),
    "A4-3": ((30, 30, 30), (2, 4)),
    "A9": ((26, 20, 24), (2, 4)),
    "A4-4": ((10, 10, 10, 10), (2, 4)),
}
"""Cells of the coarser grid along every axis, and how many times shorter they are near the set."""


@dataclass(frozen=True)
class Row:
    """marched: nodes; mean: error near the boundary; seconds: of processor time."""

    marched: float
    mean: float
    seconds: float


def grid(problem: Exact, cells: tuple[int, ...], times: int) -> Grid:
    around = [a.ends == "periodic" for a in problem.grid(0).axes]
    nodes = {
        name: times * n + (not whole)
        for name, n, whole in zip(problem.box, cells, around, strict=True)
    }
    return hf.grid(problem.system, problem.box, nodes, problem.ends)


def solved(problem: Exact, on: Grid, scheme: str, refine: int) -> Row:
    begun = time.process_time()
    found = problem.find(
        problem.system, *problem.regions, on, problem.horizon, scheme=scheme, refine=refine,
        **options(problem),
    )  # fmt: skip
    seconds = time.process_time() - begun
    if problem.points is not None:
        gap = np.abs(found.at(problem.points))
    else:
        exact = problem.exactly(found.grid)
        near = 2 * max(a.step for a in found.grid.axes)
        gap = np.abs(found.values() - exact)[np.abs(exact) <= near]
    all_nodes = math.prod(found.grid.shape)
    share = found.report.marched_share
    marched = all_nodes if share is None else share * all_nodes
    return Row(marched, float(gap.mean()), seconds)


def compared(name: str, scheme: str, refine: int, share: float) -> str:
    """share: of the horizon, to compare times only."""
    problem, (cells, _) = PROBLEMS[name](), CASES[name]
    problem = replace(problem, horizon=share * problem.horizon)
    fine = solved(problem, grid(problem, cells, refine), scheme, 1)
    mixed = solved(problem, grid(problem, cells, 1), scheme, refine)
    shown = " x ".join(map(str, cells))
    return (
        f"| {problem.name} | {shown} | {refine} | {fine.marched:,.0f} | {mixed.marched:,.0f} "
        f"| {100 * mixed.marched / fine.marched:.0f} % | {fine.mean:.2e} | {mixed.mean:.2e} "
        f"| {fine.seconds:.1f} s | {mixed.seconds:.1f} s |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--only", default=",".join(CASES))
    parser.add_argument("--scheme", default="eno2")
    parser.add_argument("--refine", type=int, default=0, help="in place of those of a problem")
    parser.add_argument("--share", type=float, default=1.0, help="of the horizon; no errors then")
    given = parser.parse_args()
    head = "problem,cells,refine,nodes,marched,share,error,error refined,time,time refined"
    print("| " + " | ".join(head.split(",")) + " |\n" + "|---" * 10 + "|", flush=True)
    for name in given.only.split(","):
        compared(name, given.scheme, 1, 0.01)  # compiled
        for refine in [given.refine] if given.refine else CASES[name][1]:
            print(compared(name, given.scheme, refine, given.share), flush=True)


if __name__ == "__main__":
    main()
