"""Which starts could come to rest in a current under any law: a basin of `inspection-current`.

python benchmarks/current_basin.py [--only NAME] [--nodes 41,69,41,17] [--step 13.75]

The states are x, y, psi and the surge u; the inputs are the surge force and the yaw rate, each
within what the thrusters give when they do nothing else. The yaw rate may jump, and there is no
sway. A start counts as excluded where the value is still below 0 with the change from twice the
cells added once more. The current comes from astern, in directions `step` degrees apart; a start is
judged by the two beside its own, reflected for a current to the other side. Against a current from
ahead nothing is judged. Starts that are excluded and come to rest nevertheless say what the grid is
worth; beyond `STEEP` degrees off the normal of the wall the place at rest is too near to the edge
of the view for it. One case takes 20 minutes of one busy core. `current_basin.json` is the record.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import sympy as sp
from tqdm import tqdm

import holdfast as hf
from holdfast.maths.definitions.extension import steady_bounds

RECORD = Path(__file__).with_suffix(".json")
STEEP = 60  # degrees
HALF = math.radians(83)  # of the directions that the scenarios go to: `bearing_max`


@dataclass(frozen=True)
class Case:
    """A scenario at one speed of the current; lengths are multiples of those of the VideoRay."""

    scenario: str
    speed: float  # m/s
    length: float
    horizon: float  # s
    surge: tuple[float, float]  # m/s

    @property
    def name(self) -> str:
        return f"{self.scenario} {self.speed:g} m/s"


CASES = (
    Case("inspection-current", 0.2, 1.0, 20.0, (-1.3, 1.3)),
    Case("inspection-current", 0.1, 1.0, 20.0, (-1.3, 1.3)),
    Case("otter-current", 0.3, 5.0, 60.0, (-1.8, 3.2)),
)


def without_sway(vehicle: hf.System) -> hf.System:
    """x, y, psi and u of `vehicle`; its yaw rate is an input, and it has no sway."""
    kept = ("x", "y", "psi", "u")
    states = {q.name: q for q in vehicle.states}
    push = next(q for q in vehicle.inputs if q.name == "tau_u")
    (yaw,) = steady_bounds(vehicle, ("r",)).upper
    numbers = {p.symbol: p.value for p in vehicle.parameters}
    most, least = (
        float(
            sign * vehicle.input_bounds.support((sp.Integer(sign), sp.S.Zero), 1)[0].subs(numbers)
        )
        for sign in (1, -1)
    )
    still = {hf.symbol("v"): sp.S.Zero}
    return hf.System(
        f"{vehicle.name} without sway",
        tuple(states[n] for n in kept),
        (push, states["r"]),
        {n: vehicle.rates[n].xreplace(still).subs(hf.symbol("r") ** 2, 0) for n in kept},
        parameters=vehicle.parameters,
        disturbances=vehicle.disturbances,
        disturbance_bounds=vehicle.disturbance_bounds,
        input_bounds=hf.Box((least, -float(yaw)), (most, float(yaw))),
        empirical="numbers",
    )


@dataclass(frozen=True)
class Starts:
    """The starts of a case and what became of them: arrays with one row a start.

    at: x, y, psi, u as if the current pushed to +y; angle [rad] of the current off the normal of
    the wall; astern: it pushes to the wall; place: the scenario goes to the place at rest.
    """

    at: np.ndarray
    angle: np.ndarray
    astern: np.ndarray
    place: np.ndarray
    rest: np.ndarray


def starts_of(case: Case) -> Starts:
    """Simulates the scenario of the case."""
    draws = f"varied.draws.speed.range=[{case.speed}, {case.speed}]"
    scenario = hf.load_scenario(case.scenario, [draws, "run.record_every=50"])
    data = scenario.run().dataset
    direction = data["varied"].sel(varied_name="direction").values
    side = np.where(np.sin(direction) < 0, -1.0, 1.0)
    at = data["state"].values[:, 0, :4] * np.stack([side**2, side, side, side**2], 1)
    off = np.abs(np.arctan(np.tan(direction)))
    return Starts(
        at=at,
        angle=off,
        astern=np.cos(direction) > 0,
        place=off < HALF,
        rest=data["outcome"].values == hf.Outcome.REACHED,
    )


def basin(case: Case, angle: float, nodes: tuple[int, ...]) -> hf.ValueFunction:
    """The states from which the place at rest is reached, in view until there.

    Anywhere within 0.3 m (times the length) of the place and 0.5 rad of the heading is near enough.
    """
    scenario = hf.load_scenario(case.scenario)
    reduced = without_sway(scenario.system)
    numbers = {p.name: p.value for p in scenario.region.parameters}
    size = case.length
    view = hf.regions.camera_view(**numbers, along_wall=2.4 * size)
    grid = hf.grid(
        reduced,
        {
            "x": (-2.2 * size, 0.1 * size),
            "y": (-2.6 * size, 2.6 * size),
            "psi": (-1.6, 1.6),
            "u": case.surge,
        },
        dict(zip(("x", "y", "psi", "u"), nodes, strict=True)),
        {"u": "limited", "psi": "contained"},
    )
    x, y, psi = (hf.symbol(n) for n in ("x", "y", "psi"))
    ahead = 1.2 * size
    off = (
        (x + ahead * math.cos(angle)) ** 2
        + (y + ahead * math.sin(angle)) ** 2
        + (0.6 * size * (psi - angle)) ** 2
    )
    near = hf.Region(
        "near",
        view.reads,
        (hf.Inequality("near", sp.sqrt(off) - 0.3 * size, "m"),),
        empirical="numbers",
    )
    return hf.capture_basin(
        reduced,
        near,
        view,
        grid,
        case.horizon,
        arrival_steps=0,
        precision="float32",
        disturbance={"Vx": case.speed * math.cos(angle), "Vy": case.speed * math.sin(angle)},
    )


def values_of(case: Case, starts: Starts, nodes: tuple[int, ...], step: float) -> np.ndarray:
    """The value [m] at every start, of the two directions beside its current."""
    angles = np.radians(np.arange(0, 83, step))
    found = []
    for angle in tqdm(angles, desc=f"{case.name}, {nodes}", unit="march"):
        begun = time.monotonic()
        found.append(np.asarray(basin(case, float(angle), nodes).at(starts.at)))
        inside = starts.astern & (np.abs(starts.angle - angle) < np.radians(step / 2))
        low = int((found[-1][inside] < 0).sum())
        tqdm.write(f"{np.degrees(angle):g} deg: {low} of {inside.sum()} below 0, "
                   f"{time.monotonic() - begun:.0f} s")  # fmt: skip
    stack = np.stack(found)
    place = np.clip(np.degrees(starts.angle) / step, 0, len(angles) - 1)
    low = np.minimum(place.astype(int), len(angles) - 2)
    share, run = place - low, np.arange(len(place))
    return (1 - share) * stack[low, run] + share * stack[low + 1, run]


def judge(starts: Starts, fine: np.ndarray, coarse: np.ndarray) -> dict[str, object]:
    """Counts of the starts whose scenario goes to the place at rest."""
    judged = starts.place & starts.astern
    excluded = judged & (fine + np.maximum(fine - coarse, 0) < 0)

    def counts(chosen: np.ndarray) -> dict[str, int]:
        groups = {
            "astern": chosen,
            "rest": chosen & starts.rest,
            "excluded": chosen & excluded,
            "rest_though_excluded": chosen & excluded & starts.rest,
        }
        return {name: int(group.sum()) for name, group in groups.items()}

    flat = starts.angle < np.radians(STEEP)
    return {
        "place": int(starts.place.sum()),
        "rest": int((starts.place & starts.rest).sum()),
        "up_to_60_deg": counts(judged & flat),
        "beyond": counts(judged & ~flat),
        "excluded_up_to_60_deg": np.flatnonzero(excluded & flat).tolist(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=[c.name for c in CASES])
    parser.add_argument("--nodes", default="41,69,41,17")
    parser.add_argument("--step", type=float, default=13.75)
    given = parser.parse_args()
    nodes = tuple(int(n) for n in given.nodes.split(","))
    half = tuple(n // 2 + 1 for n in nodes)
    record = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    for case in CASES:
        if given.only in (None, case.name):
            starts = starts_of(case)
            coarse = values_of(case, starts, half, given.step)
            fine = values_of(case, starts, nodes, given.step)
            record[case.name] = {
                "nodes": nodes,
                "step": given.step,
                **judge(starts, fine, coarse),
            }
            print(json.dumps(record[case.name]), flush=True)
            RECORD.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
