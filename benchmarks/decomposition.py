"""What does the decomposition of chapter 7 get wrong?

Random states of the whole vehicle, with velocities that the game (7.4) allows for: which does the
kernel of the game call safe that no law keeps for its 3 s, which does it give up that some law
keeps? The laws are those of scenario ch7-rescue; what its kernel in six states says stands beside.

    python benchmarks/decomposition.py [--runs 2000] [--nodes 17]
"""

from __future__ import annotations

import argparse

import numpy as np
from tqdm import tqdm

import holdfast as hf
from holdfast.scenario.kernel_reference import named_kernel
from holdfast.scenario.load import load_scenario

SCENARIO, GAME, WHOLE = "ch7-rescue", "ch7-discriminating", "ch7-six-states"
STILL = {"Vx": 0.0, "Vy": 0.0}
MARGIN = 0.02  # m
SHARES = (1.0, 0.1)
"""Of the bounds of the game, within which the velocities of the starts are drawn."""


def bounds(limit: float, sway: float) -> dict[str, float]:
    """Surge and yaw rate that thrusters of this limit hold up in still water, and the sway."""
    vehicle = hf.systems.marine_vehicle(thrust_limit=limit)
    surge, turn = map(float, hf.steady_bounds(vehicle, ("u", "r")).upper)
    return {"u": surge, "v": sway, "r": turn}


GAMES = {
    "5 N, sway within 0.4 m/s": ("5 N", bounds(5.0, 0.4)),
    "5 N, sway within 0.62 m/s": ("5 N", bounds(5.0, 0.62)),
    "1 N, sway within 0.17 m/s": ("1 N", bounds(1.0, 0.17)),
}
"""Title -> the case of the scenario, and the bounds of surge, sway and yaw rate in the game."""


def judged(case: str, bounds: dict[str, float], share: float, runs: int, nodes: int) -> list[int]:
    """Counts: called safe, of these lost by every law, of these outside the kernel in six states;
    given up, of these kept by some law, of these in the kernel in six states."""
    boxes = [f"starts.box.{n}=[{-share * b}, {share * b}]" for n, b in bounds.items()]
    sides = {n: [-b, b] for n, b in bounds.items()}
    changes = [
        *boxes,
        f"kernels.{WHOLE}.grid.nodes={nodes}",
        f"compare.cases.{case}.kernels.{GAME}.system.disturb.v={sides['v']}",
    ]
    found = hf.compare(SCENARIO, cases=[case], overrides=changes, runs=runs)
    starts = load_scenario(SCENARIO, [*boxes, "run.horizon=0.1"], runs).run().dataset["state"]
    promoted = {"promote": {n: sides[n] for n in ("u", "r")}, "disturb": {"v": sides["v"]}}
    game = named_kernel(GAME, None, {GAME: {"system": promoted, "disturbance": STILL}}).value()
    poses = game.at(starts.values[:, 0, :3])
    whole = found.references[case].value
    kept = np.any([found.of(law, case).viable for law in found.laws], axis=0)
    safe, given_up = poses > MARGIN, poses < -MARGIN
    return [
        int(chosen.sum())
        for chosen in (
            safe,
            safe & ~kept,
            safe & ~kept & (whole < -MARGIN),
            given_up,
            given_up & kept,
            given_up & kept & (whole > MARGIN),
        )
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--nodes", type=int, default=17, help="of the kernel in six states")
    given = parser.parse_args()
    tried = [(title, share) for title in GAMES for share in SHARES]
    print("| game | velocities | safe | lost by all | and outside | given up | kept | and inside |")
    print("|---|---|---|---|---|---|---|---|")
    for title, share in tqdm(tried):
        counts = judged(*GAMES[title], share, given.runs, given.nodes)
        within = f"within {share:.0%} of its bounds" if share < 1 else "within its bounds"
        print(f"| {title} | {within} | " + " | ".join(map(str, counts)) + " |", flush=True)


if __name__ == "__main__":
    main()
