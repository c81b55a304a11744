"""Logs of plants that others wrote (`foreign_plants`), for the identification of their parameters.

    python benchmarks/foreign_logs.py OUT [--plant otter]

For each plant OUT/NAME-fit.csv and OUT/NAME-held-out.csv, half as long and of another seed:

    time,x,y,psi,u,v,r,tau_u,tau_r      otter, rov, ship (calm): states and inputs of marine_vehicle
    time,x,y,psi,v,r                    wheels: states and inputs of unicycle

in SI units, z up, psi counter-clockwise in (-pi, pi], y and v to port. The plant starts at rest.
Each input is stepped to random values in 60 % of its limits, each held for a random time, both
independently; a pair that a thruster could not give is drawn again. Ten rows a second: what was
measured, and the command from then on. The measurements have noise, 0.5 % of them are outliers, and
two gaps of some seconds have no rows. A plant whose package is missing is left out, and said.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from foreign_plants import Boat, Otter, Rov, Ship, Wheels

SAMPLE, INNER = 0.1, 5
"""Time between two rows [s], and steps of the plant in it."""
SHARE = 0.6
"""Of its limits that an input is stepped to."""
DEGREE = math.pi / 180
NOISE = {
    "x": 0.01, "y": 0.01, "psi": 0.3 * DEGREE, "u": 0.01, "v": 0.01, "r": 0.3 * DEGREE
}  # fmt: skip
"""Standard deviations [m, rad, m/s, rad/s]."""
OUTLIERS, OUTLIER_SIZE = 0.005, (20.0, 100.0)
"""The share of the measurements that are outliers, and how many deviations they are off."""
GAP = (2.0, 6.0)
"""How long a gap is [s]."""
Allowed = Callable[[np.ndarray], bool]


@dataclass(frozen=True)
class Manoeuvre:
    """What a plant is driven by.

    low, high: of the two inputs that are logged, 100 %. allowed: whether the plant can give a pair
    of inputs; given: what its `step` takes for them. held: the shortest and the longest time that a
    value is held [s]. seconds: of the log for the fit.
    """

    plant: Any
    inputs: tuple[str, str]
    low: np.ndarray
    high: np.ndarray
    allowed: Allowed
    given: Callable[[np.ndarray], np.ndarray]
    held: tuple[float, float] = (1.0, 6.0)
    seconds: float = 300.0


def of_boat(
    boat: Boat, held: tuple[float, float] = (1.0, 6.0), seconds: float = 300.0
) -> Manoeuvre:
    """Steps of surge force [N] and yaw moment [N m], which two thrusters share."""
    turn = 2 * boat.arm * min(boat.ahead, boat.astern)

    def given(forces: np.ndarray) -> np.ndarray:
        half = forces[1] / (2 * boat.arm)
        return np.array([forces[0] / 2 - half, forces[0] / 2 + half])

    def allowed(forces: np.ndarray) -> bool:
        thrusts = given(forces)
        return bool((-boat.astern <= thrusts).all() and (thrusts <= boat.ahead).all())

    return Manoeuvre(
        boat, ("tau_u", "tau_r"), np.array([-2 * boat.astern, -turn]),
        np.array([2 * boat.ahead, turn]), allowed, given, held, seconds,
    )  # fmt: skip


def of_wheels(robot: Wheels) -> Manoeuvre:
    """Steps of the speed [m/s] and turn rate [rad/s] asked for; no radius or track is fitted."""
    high = np.array([0.4, 1.5])
    return Manoeuvre(robot, ("v", "r"), -high, high, lambda pair: True, lambda pair: pair)


def steps(manoeuvre: Manoeuvre, rows: int, generator: np.random.Generator) -> np.ndarray:
    """The inputs of every row, shape (rows, 2)."""
    now, until = np.zeros(2), np.zeros(2)
    found = np.empty((rows, 2))
    for k in range(rows):
        for i in np.flatnonzero(until <= k * SAMPLE + 1e-9):
            until[i] = k * SAMPLE + generator.uniform(*manoeuvre.held)
            drawn = now.copy()
            while True:
                drawn[i] = SHARE * generator.uniform(manoeuvre.low[i], manoeuvre.high[i])
                if manoeuvre.allowed(drawn):
                    break
            now = drawn
        found[k] = now
    return found


def driven(manoeuvre: Manoeuvre, inputs: np.ndarray) -> np.ndarray:
    """The states of the plant at every row, from rest at the origin."""
    manoeuvre.plant.start((0.0, 0.0, 0.0))
    states = []
    for pair in inputs:
        states.append(manoeuvre.plant.state())
        for _ in range(INNER):
            manoeuvre.plant.step(manoeuvre.given(pair), SAMPLE / INNER)
    return np.array(states)


def measured(states: np.ndarray, names: list[str], generator: np.random.Generator) -> np.ndarray:
    """States with noise and outliers, the heading in (-pi, pi]."""
    deviation = np.array([NOISE[n] for n in names])
    seen = states + deviation * generator.standard_normal(states.shape)
    off = generator.uniform(*OUTLIER_SIZE, states.shape) * generator.choice([-1, 1], states.shape)
    seen += (generator.uniform(size=states.shape) < OUTLIERS) * off * deviation
    seen[:, 2] = -np.remainder(math.pi - seen[:, 2], 2 * math.pi) + math.pi
    return seen


def whole(time: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Which rows are written: not those of a gap in the first half and one in the second."""
    kept = np.ones(len(time), dtype=bool)
    for share in (0.0, 0.5):
        begin = time[-1] * (share + generator.uniform(0.1, 0.4))
        kept &= (time < begin) | (time > begin + generator.uniform(*GAP))
    return kept


def write(path: Path, manoeuvre: Manoeuvre, seconds: float, seed: int) -> str:
    """One log; says what is in it."""
    generator = np.random.default_rng(seed)
    time = SAMPLE * np.arange(round(seconds / SAMPLE) + 1)
    inputs = steps(manoeuvre, len(time), generator)
    states = driven(manoeuvre, inputs)
    names = list(NOISE)[: states.shape[1]]
    table = np.column_stack([time, measured(states, names, generator), inputs])
    kept = whole(time, generator)
    header = ",".join(["time", *names, *manoeuvre.inputs])
    np.savetxt(path, table[kept], "%.6g", ",", header=header, comments="")
    reach = np.abs(states).max(axis=0)
    return f"{path}: {kept.sum()} rows of {seconds:.0f} s; largest " + ", ".join(
        f"|{n}| {value:.3g}" for n, value in zip(names, reach, strict=True)
    )


PLANTS: dict[str, tuple[Any, Callable[[], Manoeuvre]]] = {
    "otter": (Otter, lambda: of_boat(Otter())),
    "rov": (Rov, lambda: of_boat(Rov())),
    "ship": (Ship, lambda: of_boat(Ship(), (5.0, 30.0), 600.0)),
    "wheels": (Wheels, lambda: of_wheels(Wheels())),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--plant", choices=PLANTS, action="append")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.plant or PLANTS:
        kind, made = PLANTS[name]
        if find_spec(kind.package) is None:
            print(f"{name} is left out: there is no {kind.package}", flush=True)
            continue
        manoeuvre = made()
        for part, share, seed in (("fit", 1.0, 1), ("held-out", 0.5, 2)):
            path = given.out / f"{name}-{part}.csv"
            print(write(path, manoeuvre, share * manoeuvre.seconds, seed), flush=True)


if __name__ == "__main__":
    main()
