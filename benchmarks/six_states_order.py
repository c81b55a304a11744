"""The kernel of the whole vehicle in six states, by schemes of higher order: docs/kernels.md.

python benchmarks/six_states_order.py [--kernels upwind:13:0.1,upwind:17:0.1,eno2:9:0.3,...]

A kernel is a scheme, the nodes along every axis (9/y=13: but 13 along y), and the band [m]. 4,000
random states of S and its velocities are simulated under the optimal thrusts and under the filter
of every kernel: a state is kept if one of these laws keeps it for 3 s. Promised are those in the
set, false those of them that no law keeps.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

import holdfast as hf
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.simulation.simulate import simulate
from holdfast.execution.leaf import Evaluator
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import load_scenario

NAME = "ch7-six-states"
KERNELS = (
    "upwind:13:0.1,upwind:17:0.1,eno2:9:0.3,eno2:11:0.3,eno2:13:0.3,weno5:11:0.3,"
    "eno2:9/y=13/psi=15:0.3"
)
STARTS, DRAWN, SEED = 4000, 60_000, 11
DEEP = 0.02  # m
SETTINGS = {"horizon": 3.0, "sample_time": 0.01, "record_every": 3.0, "start_outside": True}


@dataclass(frozen=True)
class Row:
    """values: of the kernel at the starts; kept: by one of its laws."""

    name: str
    nodes: int
    seconds: float
    values: np.ndarray
    kept: np.ndarray

    def said(self, kept: np.ndarray) -> str:
        """With the states that a law of any kernel keeps."""
        parts = []
        for depth in (0.0, DEEP):
            promised = self.values > depth
            false = promised & ~kept
            parts.append(f"{100 * promised.mean():.1f} %")
            parts.append(f"{100 * false.sum() / max(promised.sum(), 1):.2f} %")
        return f"| {self.name} | {self.nodes / 1e6:.3g} million | {self.seconds:.0f} s | " + (
            " | ".join(parts) + " |"
        )


def scenario(kernel: str) -> KernelScenario:
    scheme, nodes, band = kernel.split(":")
    of_all, *others = nodes.split("/")
    changes = [f"march.scheme={scheme}", f"grid.nodes={of_all}", f"march.band={band}"]
    found = load_scenario(NAME, changes)
    assert isinstance(found, KernelScenario)
    more = {name: int(count) for name, count in (o.split("=") for o in others)}
    axes = (replace(a, count=more.get(a.name, a.count)) for a in found.grid.axes)
    return replace(found, grid=Grid(tuple(axes)))


def starts(of: KernelScenario) -> np.ndarray:
    """Random states of the region, with all velocities of the grid."""
    low, high = (np.array([getattr(a, end) for a in of.grid.axes]) for end in ("low", "high"))
    drawn = np.random.default_rng(SEED).uniform(low, high, (DRAWN, len(low)))
    symbols = [q.symbol for q in of.system.states]
    inside = Evaluator([of.about.margin], symbols, of.about.parameters).values(drawn)[:, 0] > 0
    return drawn[inside][:STARTS]


def solved(kernel: str) -> Row:
    of = scenario(kernel)
    value, states = of.solve(), starts(of)
    kept = np.zeros(len(states), dtype=bool)
    for law in (
        hf.safety_law(of.system, value, sample_time=0.01),
        hf.safety_law(of.system, value, of.law, sample_time=0.01, rate=10.0, margin=0.05),
    ):
        run = simulate(
            of.system, law, starts=states, region=of.region, disturbance={"Vx": 0.0, "Vy": 0.0},
            **SETTINGS,
        )  # fmt: skip
        kept |= np.isnan(run.arrays["exit_time"].values)
    report = value.report
    return Row(
        kernel.replace(":", ", "), value.values().size, report.wall_time_s, value.at(states), kept
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--kernels", default=KERNELS)
    rows = [solved(k) for k in parser.parse_args().kernels.split(",")]
    kept = np.any([r.kept for r in rows], axis=0)
    print(f"kept by some law: {100 * kept.mean():.1f} %")
    head = "scheme nodes band,nodes,march,promised,false,2 cm inside,false"
    print("| " + " | ".join(head.split(",")) + " |\n" + "|---" * 7 + "|")
    for row in rows:
        print(row.said(kept))


if __name__ == "__main__":
    main()
