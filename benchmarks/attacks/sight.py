"""Filters that keep targets in view among random obstacles, in closed loop, judged by Shapely."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import shapely

import holdfast as hf
from attacks import writing
from attacks.case import Fault, Kind, Outcome, attacked

STARTS = 24
SAMPLES = 400
SAMPLE = 0.02
VEHICLES = ("point", "unicycle", "pushed point")
MOST = {"point": [1.0, 1.0], "unicycle": [1.0, 2.0, 2.0], "pushed point": [2.0, 2.0]}
"""Bounds of the inputs."""
ALLOWED = 0.02
"""Radians by which a camera may be beyond its half angle: of a held input."""
LOST = "a target is out of view although the filter found an admissible input"
HIT = "an input is beyond its bounds"


class Yard:
    """Polygons that may not be convex, targets between them, and a vehicle."""

    def __init__(self, seed: int, number: int) -> None:
        g = np.random.default_rng([seed, number, 21])
        self.generator = g
        self.vehicle = VEHICLES[number % len(VEHICLES)]
        self.clearance = float(g.uniform(0.04, 0.12))
        self.polygons: dict[str, list[tuple[float, float]]] = {}
        shapes: list[Any] = []
        for k in range(int(g.integers(1, 3))):
            corners = star(g)
            if all(shapely.Polygon(corners).distance(s) > 0.5 for s in shapes):
                shapes.append(shapely.Polygon(corners))
                self.polygons[f"rock{k}"] = corners
        self.shapes = shapely.union_all(shapes)
        shapely.prepare(self.shapes)
        self.targets: dict[str, tuple[float, float]] = {}
        while len(self.targets) < int(g.integers(1, 4)):
            at = g.uniform(-5, 5, 2)
            if self.shapes.distance(shapely.Point(at)) > 0.3:
                self.targets[f"mark{len(self.targets)}"] = (float(at[0]), float(at[1]))
        self.at_least = int(g.integers(1, len(self.targets) + 1))
        self.turns = self.vehicle == "unicycle" and bool(g.random() < 0.6)
        self.half_angle = float(g.uniform(0.5, 1.4)) if self.turns else None

    def system(self) -> Any:
        """The vehicle, and the bounds of its inputs."""
        a, b = hf.symbol("a"), hf.symbol("b")
        place = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
        if self.vehicle == "unicycle":
            robot = hf.systems.unicycle()
            return hf.panning(robot, 2.0) if self.turns else robot
        if self.vehicle == "point":
            inputs = (hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s"))
            rates = {"x": a, "y": b}
            return hf.System("point", place, inputs, rates, input_bounds=hf.Box((-1, -1), (1, 1)))
        inputs = (hf.Quantity("a", "m/s^2"), hf.Quantity("b", "m/s^2"))
        speeds = (hf.Quantity("p", "m/s"), hf.Quantity("q", "m/s"))
        rates = {"x": hf.symbol("p"), "y": hf.symbol("q"), "p": a, "q": b}
        bounds = hf.Box((-2, -2), (2, 2))
        return hf.System("pushed point", (*place, *speeds), inputs, rates, input_bounds=bounds)

    def moved(self, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """A sample later, by four steps of Runge's rule."""
        h = SAMPLE / 4
        for _ in range(4):
            middle = states + h / 2 * self._rates(states, inputs)
            states = states + h * self._rates(middle, inputs)
        return states

    def _rates(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        if self.vehicle == "point":
            return u
        if self.vehicle == "pushed point":
            return np.column_stack([q[:, 2:], u])
        plain = [u[:, 0] * np.cos(q[:, 2]), u[:, 0] * np.sin(q[:, 2]), u[:, 1]]
        return np.column_stack([*plain, *([u[:, 2]] if self.turns else [])])

    def in_view(self, states: np.ndarray, clearance: float, beyond: float) -> np.ndarray:
        """How many targets are in view."""
        seen = np.zeros(len(states), int)
        for at in self.targets.values():
            ends = np.stack([states[:, :2], np.broadcast_to(at, (len(states), 2))], axis=1)
            free = shapely.distance(shapely.linestrings(ends), self.shapes) > clearance
            if self.half_angle is not None:
                dx, dy = at[0] - states[:, 0], at[1] - states[:, 1]
                off = np.arctan2(dy, dx) - states[:, 2] - states[:, 3]
                off = np.abs(np.arctan2(np.sin(off), np.cos(off)))
                near = np.hypot(dx, dy) < 0.3 + clearance
                free &= (off <= self.half_angle + beyond) & ~near
            seen += free
        return seen


def star(g: np.random.Generator) -> list[tuple[float, float]]:
    """A polygon around a point, convex or not."""
    count = int(g.integers(3, 7))
    angles = np.sort(g.uniform(0, 2 * math.pi, count)) + np.linspace(0, 0.2, count)
    if np.diff(angles, append=angles[0] + 2 * math.pi).max() > 3.0:
        angles = np.linspace(0, 2 * math.pi, count, endpoint=False)
    radii = g.uniform(0.4, 1.6, count)
    middle = g.uniform(-2.5, 2.5, 2)
    return [
        (float(middle[0] + r * math.cos(a)), float(middle[1] + r * math.sin(a)))
        for r, a in zip(radii, angles, strict=True)
    ]


def filtered(yard: Yard) -> tuple[Any, Any]:
    """The vehicle and the filter of its view."""
    system = yard.system()
    extra: dict[str, Any] = {}
    if yard.half_angle is not None:
        extra = {"half_angle": yard.half_angle, "pan": "pan", "pan_limit": 2.5, "range_min": 0.3}
    view = hf.targets_in_view(
        system,
        yard.targets,
        yard.polygons,
        at_least=yard.at_least,
        clearance=yard.clearance,
        **extra,
    )
    return system, hf.SafetyFilter(system, view, gains=(2.0, 4.0), sample_time=SAMPLE)


def closed_loops(yard: Yard) -> dict[str, Any]:
    """Runs from places in view, with commands that lead out of it."""
    g = yard.generator
    system, keep = filtered(yard)
    n, m = len(system.states), len(system.inputs)
    states = np.zeros((4000, n))
    states[:, :2] = g.uniform(-5, 5, (4000, 2))
    if yard.vehicle == "unicycle":
        states[:, 2:] = g.uniform(-2, 2, (4000, n - 2))
    states = states[yard.in_view(states, yard.clearance + 0.02, -0.02) >= yard.at_least][:STARTS]
    if len(states) < 3:
        return {"runs": 0, "why": "no place in view"}
    most = np.array(
        {"unicycle": [1.0, 2.0, 2.0], "point": [1.0, 1.0]}.get(yard.vehicle, [2.0, 2.0])
    )
    most = most[:m]
    doubted = np.zeros(len(states), bool)
    lost = np.zeros(len(states), bool)
    out, worst = 0, 0
    marks = np.array(list(yard.targets.values()))
    middle = shapely.get_coordinates(yard.shapes.centroid)[0]
    aims = middle + 1.5 * (middle - marks[g.integers(len(marks), size=len(states))])
    held = g.uniform(-1, 1, (len(states), m)) * most
    for k in range(SAMPLES):
        if k % 40 == 0:
            held = g.choice([-1.0, 1.0], (len(states), m)) * most
        command = held.copy()
        half = len(states) // 2
        to = aims[:half] - states[:half, :2]
        if yard.vehicle == "unicycle":
            off = np.arctan2(to[:, 1], to[:, 0]) - states[:half, 2]
            command[:half, 0] = 1.0
            command[:half, 1] = 2 * np.arctan2(np.sin(off), np.cos(off))
        else:
            command[:half] = 2 * to
        decisions = keep.step_many(states, command)
        inputs = np.asarray(decisions.input)
        out += int((np.abs(inputs) > most + 1e-9).any(axis=1).sum())
        doubted |= np.array([s.value not in ("passed", "changed") for s in decisions.status])
        states = yard.moved(states, inputs)
        lost |= (yard.in_view(states, 0.0, ALLOWED) < yard.at_least) & ~doubted
        worst = max(worst, int(lost.sum()))
    return {"runs": len(states), "lost": worst, "out": out, "doubted": int(doubted.sum())}


def attempt(seed: int, number: int) -> Outcome:
    """A yard; every third has a vehicle with inertia."""

    def trial(outcome: Outcome) -> None:
        yard = Yard(seed, number)
        told = closed_loops(yard)
        outcome.judged = int(told["runs"] > 0)
        outcome.counts = {"loops": told["runs"], f"of a {yard.vehicle}": told["runs"]}
        if why := told.get("why"):
            outcome.counts[f"nothing to run: {why}"] = 1
            return
        outcome.counts["without an admissible input"] = told["doubted"]
        for what, sentence in (("lost", LOST), ("out", HIT)):
            if told[what]:
                outcome.faults.append(Fault(f"{sentence}, {yard.vehicle}", str(told)))

    return attacked(trial)


def shrink(seed: int, number: int, fault: Fault) -> None:
    body = f"print(attempt({seed}, {number}).faults)\n"
    fault.text = writing.alone(
        f"{fault.signature}.\n\n{fault.message}", ("case", "writing", "sight"), body
    )


KIND = Kind(
    "sight",
    attempt,
    shrink,
    share=0.5,
    seconds=90.0,
    shown=(
        "loops",
        "of a point",
        "of a unicycle",
        "of a pushed point",
        "without an admissible input",
    ),
)
