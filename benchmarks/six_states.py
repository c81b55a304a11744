"""The kernel of the whole vehicle in six states, on grids of several sizes: docs/kernels.md.

python benchmarks/six_states.py [--nodes 13,17,21,31]

Nanoseconds are those of one core for a node that is computed, in a step. 31 nodes along every axis
take an hour and 8 GB, 13 nodes half a minute.
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import dataclass

from holdfast.analysis.reachability.solve import set_on_grid
from holdfast.execution.resources import available_cores
from holdfast.scenario.load import load_scenario


@dataclass(frozen=True)
class Row:
    """What a run of `ch7-six-states` says; left: of the region and its velocities;
    memory: the most that the process has had [GB]."""

    nodes: int
    steps: int
    march: float
    whole: float
    memory: float
    left: float
    inside: int
    outside: int
    computed: float
    nanoseconds: float

    def __str__(self) -> str:
        return (
            f"| {self.nodes}^6 = {self.nodes**6 / 1e6:.3g} million | {self.steps:,} "
            f"| {self.march:.0f} s | {self.whole:.0f} s | {self.memory:.2g} GB "
            f"| {100 * self.left:.0f} % | {self.inside:,} | {self.outside:,} "
            f"| {100 * self.computed:.0f} % | {self.nanoseconds:.0f} |"
        )


def solved(nodes: int) -> Row:
    begun = time.monotonic()
    scenario = load_scenario("ch7-six-states", [f"grid.nodes={nodes}", "promise.margin='2 cm'"])
    found = scenario.run()
    whole = time.monotonic() - begun
    said = found.value.dataset.attrs
    promise = found.promise
    assert promise is not None
    assert promise.outside is not None
    places = said["steps"] * nodes**6 * said["computed_share"]
    return Row(
        nodes,
        said["steps"],
        said["wall_time_s"],
        whole,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9,
        found.value.fraction() / set_on_grid(scenario.about, scenario.grid).fraction(),
        promise.inside[0].kept.count,
        promise.outside.kept.count,
        said["computed_share"],
        1e9 * said["wall_time_s"] * available_cores() / places,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--nodes", default="13,17,21,31")
    head = "nodes,steps,march,whole run,memory,left,inside stay,outside stay,computed,ns"
    print("| " + " | ".join(head.split(",")) + " |\n" + "|---" * 10 + "|", flush=True)
    for nodes in parser.parse_args().nodes.split(","):
        print(solved(int(nodes)), flush=True)


if __name__ == "__main__":
    main()
