"""How far the velocities go by the printed (7.2), for several directions of the current.

python benchmarks/forward_reach.py [--schemes upwind,eno2] [--currents 0,pi] [--outside]
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import holdfast as hf
from holdfast.errors import SimulationError

MIRROR = {"psi": -1, "v": -1, "r": -1}
"""Port for starboard, which a current along x does not notice."""

CURRENTS = {"still": (0.0, 0.0), "0": (0.5, 0.0), "pi/2": (0.0, 0.5), "pi": (-0.5, 0.0)}
"""beta, the direction that the current flows to, and its velocity [m/s]."""


def posed(current: str, nodes: int) -> tuple[Any, dict[str, Any]]:
    """The scenario and what is given; in still water nothing depends on the heading."""
    whole = hf.load_scenario("ch7-forward-reach-printed", [f"grid.nodes={nodes}"])
    options: dict[str, Any] = {"times": whole.options["times"]}
    if current == "still":
        box = {a.name: [a.low, a.high] for a in whole.grid.axes}
        sides = [f"grid.box.{n}={box[n]}" for n in ("u", "v", "r")]
        return hf.load_scenario("ch7-forward-reach", [f"grid.nodes={nodes}", *sides]), options
    along, across = CURRENTS[current]
    options["disturbance"] = {"Vx": along, "Vy": across}
    if across == 0.0:
        options["symmetry"] = MIRROR
    return whole, options


def largest(found: hf.ValueFunction, time: float) -> list[str]:
    """Of u, v and r in the set, whichever way, and its share of the box."""
    reached = found.extent(time)
    sizes = [max(abs(end) for end in reached[n]) for n in ("u", "v", "r")]
    shown = ["none" if math.isnan(s) else f"{s:.2f}" for s in sizes]
    return [*shown, f"{100 * found.fraction(time):.1f} %"]


def row(scheme: str, current: str, nodes: int, outside: bool) -> list[str]:
    said, options = posed(current, nodes)
    try:
        found = hf.forward_reachable_set(
            said.system, said.origin, said.grid, 8.0,
            scheme=scheme, check_outside=outside, **options,
        )  # fmt: skip
    except SimulationError as error:
        return [scheme, current, str(error)]
    attrs = found.dataset.attrs
    share = [f"{100 * attrs['share_from_outside']:.1f} %"] if outside else []
    return [
        scheme, current, *largest(found, 5.0), *largest(found, 8.0),
        attrs["ends_reached"] or "none", *share, f"{attrs['wall_time_s']:.0f} s",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--nodes", type=int, default=26)
    parser.add_argument("--schemes", default="upwind,eno2,eno3,weno5")
    parser.add_argument("--currents", default=",".join(CURRENTS))
    parser.add_argument("--outside", action="store_true", help="what rests on what is outside")
    chosen = parser.parse_args()
    sides = ["u", "v", "r", "share"]
    head = ["scheme", "current to", *sides, *sides, "ends of the grid in the set"]
    head += ["by what is outside", "march"] if chosen.outside else ["march"]
    print("| " + " | ".join(head) + " |\n" + "|" + "---|" * len(head), flush=True)
    for scheme in chosen.schemes.split(","):
        for current in chosen.currents.split(","):
            cells = row(scheme, current, chosen.nodes, chosen.outside)
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
