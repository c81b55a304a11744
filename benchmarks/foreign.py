"""Laws and filters of holdfast on plants that others wrote (`foreign_plants`), beside a peer.

    python benchmarks/foreign.py [--starts 20] [--plants Otter,Sea,Wheels] [--no-peer]

Every row is a plant and a controller: for how many seconds, from how many starts the constraints
were kept (to 1 mm or 1 mrad), the worst constraint in its own unit, how many rested within 1 cm and
0.02 rad of where they should, the medians of that, the share of samples whose command was changed
by more than 1 % of what there is, and the time of a decision. The law runs as exported C. A plant
whose package is missing is left out, and said.
"""

from __future__ import annotations

import argparse
import ctypes
import math
import os
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

os.environ.setdefault("JAX_ENABLE_X64", "1")  # what the peer's own page recommends
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from cbf_peer import cbf_filter
from foreign_plants import Boat, Car, Otter, Rov, Ship, Wheels, fitted_wheels, numbers_of

import holdfast as hf

SAMPLE = 0.02
KEPT = 1e-3
GAINS = (1.5, 8.0)
Controller = Callable[[float, np.ndarray], tuple[np.ndarray, bool]]
"""(t, state) -> what the plant is given, and whether a command was changed."""


@dataclass
class Row:
    plant: str
    controller: str
    worst: list[float] = field(default_factory=list)
    far: list[float] = field(default_factory=list)
    turned: list[float] = field(default_factory=list)
    changed: int = 0
    samples: int = 0
    seconds: float = 0.0
    filtered: bool = True
    horizon: float = 0.0

    def __str__(self) -> str:
        count, far, turned = len(self.worst), np.array(self.far), np.array(self.turned)
        arrived = int(((far < 0.01) & (turned < 0.02)).sum())
        rests = (
            f"{arrived} of {count}", f"{100 * np.median(far):.2f}", f"{np.median(turned):.4f}",
        ) if self.far else ("", "", "")  # fmt: skip
        cells = (
            self.plant, self.controller, f"{self.horizon:.0f}",
            f"{sum(w <= KEPT for w in self.worst)} of {count}", f"{max(self.worst):.3f}", *rests,
            f"{self.changed / max(self.samples, 1):.0%}" if self.filtered else "",
            f"{1e6 * self.seconds / max(self.samples, 1):.0f}",
        )  # fmt: skip
        return "| " + " | ".join(cells) + " |"


HEAD = "plant,controller,s,kept,worst,arrived,cm off,rad off,changed,us each"


def pose(goal: np.ndarray) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """The distance from a pose."""
    return lambda q: (
        np.hypot(*(q[:, :2] - goal[:2]).T),
        np.abs(np.angle(np.exp(1j * (q[:, 2] - goal[2])))),
    )


class LawInC:
    """The law of a scenario, exported, compiled, and called through its header's functions."""

    def __init__(self, scenario: Any) -> None:
        system = scenario.model
        text = hf.export_c(system, scenario.law, "law") + (
            "static law_state one;\nvoid begin(void) { law_start(&one); }\n"
            "int act(double t, double h, const double *seen, double *command, double *actuators)\n"
            "{ return law_step(&one, t, h, seen, law_parameters, command, actuators); }\n"
        )
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "law.c").write_text(text)
            subprocess.run(
                ["gcc", "-std=c99", "-O2", "-shared", "-fPIC", "law.c", "-o", "law.so", "-lm"],
                cwd=folder, check=True,
            )  # fmt: skip
            self.library = ctypes.CDLL(str(Path(folder) / "law.so"))
        count = max(len(system.actuators), len(system.inputs))
        self.command, self.actuators = np.zeros(len(system.inputs)), np.zeros(count)

    def begin(self) -> None:
        self.library.begin()

    def __call__(self, t: float, state: np.ndarray) -> tuple[np.ndarray, bool]:
        seen = np.ascontiguousarray(state, dtype=float)
        self.library.act(
            ctypes.c_double(t), ctypes.c_double(SAMPLE),
            *(ctypes.c_void_p(a.ctypes.data) for a in (seen, self.command, self.actuators)),
        )  # fmt: skip
        return self.actuators.copy(), False


def judged(
    row: Row,
    plant: Any,
    controller: Controller,
    starts: np.ndarray,
    horizon: float,
    worst: Callable[[np.ndarray], float],
    off: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None,
    begin: Callable[[], None] = lambda: None,
) -> Row:
    """Run the plant from every start; off: the distances and angles from where it should be.

    The first call of a controller, which may compile, is not timed.
    """
    plant.start(starts[0])
    begin()
    controller(0.0, plant.state())
    row.horizon = horizon
    for pose in starts:
        plant.start(pose)
        begin()
        seen = []
        for k in range(round(horizon / SAMPLE)):
            state = plant.state()
            seen.append(state)
            begun = time.perf_counter()
            given, changed = controller(k * SAMPLE, state)
            row.seconds += time.perf_counter() - begun
            row.changed += changed
            row.samples += 1
            plant.step(given, SAMPLE)
        states = np.array(seen)
        row.worst.append(worst(states) if np.isfinite(states).all() else math.inf)
        # where it rests: the farthest of the last two seconds
        if off is not None:
            far, turned = off(states[-100:])
            row.far.append(float(far.max()))
            row.turned.append(float(turned.max()))
    print(row, flush=True)
    return row


# -- boats in front of a target --------------------------------------------------------------


def inspection(boat: Boat, numbers: dict[str, float], estimate: bool) -> Any:
    """The scenario `inspection` in a view as large as the boat needs, with its numbers."""
    s = boat.scale
    sway = -numbers["Yv"] / (numbers["mass"] - numbers["Yvdot"])
    mu = 0.9 / s
    sets = [f"system.{name}={value!r}" for name, value in numbers.items()]
    sets += [
        f"region.target_half_width={0.1 * s}", f"region.range_min={0.35 * s}",
        f"region.range_max={2 * s}", f"law.distance={0.5 * s}", f"law.far_margin={0.25 * s}",
        f"law.k1={min(0.2 * math.sqrt(s), 0.5, 0.6 * sway / mu)}", f"law.mu={mu}",
        f"law.settle={0.002}",
        "safeguard.margins={ edge_low = 0.02, edge_high = 0.02, "
        f"too_near = {0.01 * s}, too_far = {0.03 * s} }}",
        f"goal.goal_x={-0.5 * s}", "starts.states=[]",
        f"starts.box={{ x = [{-2 * s}, {-0.3 * s}], y = [{-1.6 * s}, {1.6 * s}], psi = [-1, 1] }}",
    ]  # fmt: skip
    if estimate:
        push = numbers["thrust_limit"]
        turn = push * numbers["thruster_arm"]
        sets += [
            f"system.unmodelled={{ tau_u = [{-push}, {push}], tau_r = [{-turn}, {turn}] }}",
            "observer.bandwidth=4.0",
            "safeguard.disturbance_measured=true",
        ]
    sets.append("safeguard.uncertain=")  # of another vehicle
    return hf.load_scenario("inspection", sets)


def starts_of(scenario: Any, count: int) -> np.ndarray:
    """The first starts of the scenario: a run of one sample from each."""
    runs = hf.simulate(
        scenario.model, hf.commanded(scenario.model), starts=scenario.starts,
        region=scenario.region, horizon=SAMPLE, sample_time=SAMPLE, record_every=SAMPLE, seed=1,
        command=lambda t, q: np.zeros((len(q), len(scenario.model.inputs))),
    )  # fmt: skip
    return np.asarray(runs.dataset["state"].values)[:count, 0]


def towards(boat: Boat, system: hf.System) -> Callable[[np.ndarray], np.ndarray]:
    """A PD controller that knows nothing of the view: to the pose, as if it could go sideways."""
    p = {q.name: q.value for q in system.parameters}
    surge, turn = p["mass"] - p["Xudot"], p["Iz"] - p["Nrdot"]
    goal, s = -0.5 * boat.scale, boat.scale

    def command(q: np.ndarray) -> np.ndarray:
        x, y, psi, u, _, r = q
        return np.array(
            [surge * (0.3 * (goal - x) - 0.6 * u), turn * (-2 * psi - 1.5 * y / s - 2.5 * r)]
        )

    return command


def by_thrusts(system: hf.System, boat: Boat) -> hf.System:
    """The same boat with the thrusts as its inputs, whose bounds are a box."""
    port, starboard = hf.symbol("port"), hf.symbol("starboard")
    made = {hf.symbol("tau_u"): port + starboard, hf.symbol("tau_r"): boat.arm * (starboard - port)}
    return hf.System(
        "by thrusts", system.states, (hf.Quantity("port", "N"), hf.Quantity("starboard", "N")),
        {n: rate.xreplace(made) for n, rate in system.rates.items()}, system.parameters,
        disturbances=system.disturbances,
        input_bounds=hf.Box((-boat.astern,) * 2, (boat.ahead,) * 2),
        disturbance_bounds=system.disturbance_bounds,
    )  # fmt: skip


def boats(name: str, boat: Boat, count: int, peer: bool, horizon: float = 150.0) -> None:
    numbers = numbers_of(boat)
    plain, estimated = (inspection(boat, numbers, e) for e in (False, True))
    system, region = plain.model, plain.region
    starts = starts_of(plain, count)[:, :3]
    boundary = hf.Boundary(system, region)
    goal = pose(np.array([-0.5 * boat.scale, 0.0, 0.0]))

    def worst(states: np.ndarray) -> float:
        return float(boundary.worst(states).max())

    for title, scenario in (
        ("legs, exported as C", plain),
        ("the same, unmodelled forces estimated", estimated),
    ):
        law = LawInC(scenario)
        row = Row(name, title, filtered=False)
        judged(row, boat, law, starts, horizon, worst, goal, law.begin)
    margins = {"edge_low": 0.02, "edge_high": 0.02, "too_near": 0.01 * boat.scale}
    margins |= {"too_far": 0.03 * boat.scale}
    keep = hf.SafetyFilter(system, region, gains=GAINS, sample_time=SAMPLE, margins=margins)
    command = towards(boat, system)
    thrusts = np.linalg.inv([[1.0, 1.0], [-boat.arm, boat.arm]])

    def limited(wanted: np.ndarray) -> np.ndarray:
        return np.clip(thrusts @ wanted, -boat.astern, boat.ahead)

    def alone(t: float, q: np.ndarray) -> tuple[np.ndarray, bool]:
        return limited(command(q)), False

    def filtered(t: float, q: np.ndarray) -> tuple[np.ndarray, bool]:
        wanted = command(q)
        given = keep.step(q, wanted, t).actuators
        return given, differs(given, limited(wanted), np.full(2, boat.ahead))

    judged(Row(name, "PD alone", filtered=False), boat, alone, starts, 40.0, worst, goal)
    judged(Row(name, "PD, SafetyFilter"), boat, filtered, starts, 40.0, worst, goal, keep.reset)
    if peer:
        low, high = np.full(2, -boat.astern), np.full(2, boat.ahead)
        other = cbf_filter(by_thrusts(system, boat), region, GAINS, low, high, margins)

        def others(t: float, q: np.ndarray) -> tuple[np.ndarray, bool]:
            wanted = limited(command(q))
            given = np.clip(other(q, wanted), low, high)
            return given, differs(given, wanted, high)

        judged(Row(name, "PD, cbfpy"), boat, others, starts, 40.0, worst, goal)


# -- a car among parked cars -----------------------------------------------------------------

PARKED = {"first": (14, 2.0), "second": (26, -2.1), "third": (38, 1.9)}
WAY = ([0.0, 14.0, 26.0, 38.0, 60.0], [0.0, -0.35, 0.25, -0.35, 0.0])


def car_model() -> hf.System:
    theta, v, a, kappa = (hf.symbol(n) for n in ("theta", "v", "a", "kappa"))
    sin, cos = (hf.parse_expression(f"{f}(theta)", {"theta": theta}) for f in ("sin", "cos"))
    quantity = hf.Quantity
    return hf.System(
        "car",
        (
            quantity("x", "m"), quantity("y", "m"), quantity("theta", "rad", angle=True),
            quantity("v", "m/s"),
        ),
        (quantity("a", "m/s^2"), quantity("kappa", "1/m")),
        {"x": v * cos, "y": v * sin, "theta": v * kappa, "v": a},
        input_bounds=hf.Box((-4.0, -0.2), (3.0, 0.2)),
    )  # fmt: skip


def cars(count: int, peer: bool) -> None:
    """A driver who takes a way around the parked cars that is too near to them."""
    system, car = car_model(), Car()
    parked = {
        n: [[x - 2, y - 0.9], [x + 2, y - 0.9], [x + 2, y + 0.9], [x - 2, y + 0.9]]
        for n, (x, y) in PARKED.items()
    }
    road = [[-5.0, -6.0], [70.0, -6.0], [70.0, 6.0], [-5.0, 6.0]]
    wide = hf.obstacles(system, parked, room=road, clearance=1.2)
    asked = hf.obstacles(system, parked, room=road, clearance=1.5)
    boundary = hf.Boundary(system, wide)
    gains = (1.0, 3.0)
    keep = hf.SafetyFilter(system, asked, gains=gains, sample_time=SAMPLE)
    low, high = np.array([-4.0, -0.2]), np.array([3.0, 0.2])
    generator = np.random.default_rng(1)
    starts = generator.uniform([-3, -2, -0.15, 3], [0, 2, 0.15, 5], (count, 4))

    def command(q: np.ndarray) -> np.ndarray:
        x, y, theta, v = q
        ahead = np.interp(x + 6.0, *WAY) - y
        aim = math.remainder(math.atan2(ahead, 6.0) - theta, 2 * math.pi)
        return np.clip([5.0 - v, 2 * math.sin(aim) / math.hypot(6.0, ahead)], low, high)

    def alone(t: float, q: np.ndarray) -> tuple[np.ndarray, bool]:
        return command(q), False

    def filtered(t: float, q: np.ndarray) -> tuple[np.ndarray, bool]:
        wanted = command(q)
        given = keep.step(q, wanted, t).input
        return given, differs(given, wanted, high)

    def worst(states: np.ndarray) -> float:
        return float(boundary.worst(states).max())

    goal = None  # the road goes on
    judged(Row("car", "driver alone", filtered=False), car, alone, starts, 10.0, worst, goal)
    judged(Row("car", "driver, SafetyFilter"), car, filtered, starts, 10.0, worst, goal, keep.reset)
    if peer:
        other = cbf_filter(system, asked, gains, low, high, {})

        def others(t: float, q: np.ndarray) -> tuple[np.ndarray, bool]:
            wanted = command(q)
            given = np.clip(other(q, wanted), low, high)
            return given, differs(given, wanted, high)

        judged(Row("car", "driver, cbfpy"), car, others, starts, 10.0, worst, goal)


# -- a wheeled robot in front of a beacon ----------------------------------------------------


def wheels(count: int, peer: bool) -> None:
    """To the dock, or to the circle through it, facing the beacon.

    The robot's speed follows a step within 0.2 s (wheels that slip, motors), which the model does
    not know: the margins of the filters have to allow for it.
    """
    robot = Wheels()
    robot.radius, robot.track = fitted_wheels(robot)
    scenario = hf.load_scenario("wheeled_camera", ["starts.states=[]"])
    system, region = scenario.model, scenario.region
    starts = starts_of(scenario, count)
    boundary = hf.Boundary(system, region)

    def worst(states: np.ndarray) -> float:
        return float(boundary.worst(states).max())

    def off(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        facing = np.arctan2(-q[:, 1], -q[:, 0]) - q[:, 2]
        return np.abs(np.hypot(q[:, 0], q[:, 1]) - 0.8), np.abs(np.angle(np.exp(1j * facing)))

    law = LawInC(scenario)
    title = "viable redesign, exported as C"
    judged(Row("wheels", title, filtered=False), robot, law, starts, 60.0, worst, off, law.begin)
    plain = hf.load_scenario("wheeled_camera", ["starts.states=[]", "redesign="])
    nominal = hf.Controller(plain, sample_time=SAMPLE)
    low, high = np.array([-0.4, -1.5]), np.array([0.4, 1.5])

    def around(decide: Callable[..., Any]) -> Controller:
        def controller(t: float, q: np.ndarray) -> tuple[np.ndarray, bool]:
            wanted = nominal.step(q, t).input
            given = np.clip(decide(q, wanted), low, high)
            return given, differs(given, wanted, high)

        return controller

    def alone(t: float, q: np.ndarray) -> tuple[np.ndarray, bool]:
        return nominal.step(q, t).input, False

    judged(Row("wheels", "dipole alone", filtered=False), robot, alone, starts, 60.0, worst, off,
           nominal.reset)  # fmt: skip
    for margin in (0.05, 0.1):
        margins = dict.fromkeys(region.inequality_names, margin)
        keep = hf.SafetyFilter(
            system, region, gains=(2.0, 4.0), margins=margins, sample_time=SAMPLE
        )
        filters = [("SafetyFilter", lambda q, w, keep=keep: keep.step(q, w).input)]
        if peer:
            filters.append(("cbfpy", cbf_filter(system, region, (2.0, 4.0), low, high, margins)))
        for name, decide in filters:
            judged(Row("wheels", f"dipole, {name}, margins {margin}"), robot, around(decide),
                   starts, 60.0, worst, off, nominal.reset)  # fmt: skip


def differs(given: np.ndarray, wanted: np.ndarray, size: np.ndarray) -> bool:
    """Whether a command was changed by more than 1 % of what there is."""
    return bool((np.abs(given - wanted) > 0.01 * size).any())


SEA = (0.03, 1.2)
"""Significant height [m] and peak period [s]: 2.7 m and 11 s at the ship's full size."""

PLANTS: dict[str, tuple[Any, Callable[[int, bool], None]]] = {
    "Otter": (Otter, lambda n, peer: boats("Otter", Otter(), n, peer)),
    "Current": (Otter, lambda n, peer: boats("Otter, 0.1 m/s", Otter((0.0, 0.1)), n, peer)),
    "Stream": (Otter, lambda n, peer: boats("Otter, 0.3 m/s", Otter((0.0, 0.3)), n, peer)),
    "Rov": (Rov, lambda n, peer: boats("ROV", Rov(), n, peer)),
    "Ship": (Ship, lambda n, peer: boats("ship, calm", Ship(), n, peer, 400.0)),
    "Sea": (Ship, lambda n, peer: boats("ship, waves", Ship(waves=SEA), n, peer, 400.0)),
    "Car": (Car, cars),
    "Wheels": (Wheels, wheels),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--plants", default=",".join(PLANTS))
    parser.add_argument("--no-peer", action="store_true")
    given = parser.parse_args()
    warnings.simplefilter("ignore", hf.GainWarning if hasattr(hf, "GainWarning") else UserWarning)
    peer = not given.no_peer and find_spec("cbfpy") is not None
    print("| " + " | ".join(HEAD.split(",")) + " |\n" + "|---" * 10 + "|", flush=True)
    for name in given.plants.split(","):
        kind, run = PLANTS[name]
        if find_spec(kind.package) is None:
            print(f"{name} is left out: there is no {kind.package}", flush=True)
            continue
        run(given.starts, peer)


if __name__ == "__main__":
    main()
