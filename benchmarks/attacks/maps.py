"""Maps of occupied cells: random ones, whose distances, bodies and filters are judged by all cells.

Cells are squares here, and every distance is to all of them, one by one.
"""

from __future__ import annotations

import maps
import numpy as np

import holdfast as hf
from attacks.case import Fault, Kind, Outcome, attacked

FAR, LEFT, BEYOND = (
    "a distance is beyond its bounds",
    "a cell is left out",
    "a body reaches too far",
)
ANEW, HIT = "an update differs from a new map", "a cell is hit"
RUNS, SECONDS, PLACES, SMALL = 4, 8.0, 40, 1e-9


def world_of(random: np.random.Generator) -> hf.OccupancyMap:
    """Rooms, or lumps that no room has."""
    if random.random() < 0.6:
        return maps.random_rooms(random, int(random.integers(90, 140)))
    shape = random.integers(20, 60, 2)
    cells = random.random(shape) < random.choice([0.02, 0.2, 0.5])
    if random.random() < 0.7:
        cells = np.kron(cells, np.ones((2, 3), dtype=bool))
    origin = (*random.uniform(-9, 9, 2), random.uniform(-4, 4))
    unknown = str(random.choice(["free", "occupied"]))
    return hf.OccupancyMap(cells, float(random.uniform(0.02, 2)), origin, unknown=unknown)


class Cells:
    """The occupied cells of a map as squares, and a band of what is outside it."""

    def __init__(self, world: hf.OccupancyMap) -> None:
        self.side, wide = world.resolution, 3
        cells = np.pad(world.cells, wide, constant_values=world.unknown == "occupied")
        row, column = np.nonzero(cells)
        self.low = np.stack([column, row], axis=1) - float(wide)
        x, y, yaw = world.origin
        self.corner = np.array([x, y])
        self.turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        self.size = np.array(world.shape[::-1], dtype=float)

    def drawn(self, random: np.random.Generator) -> np.ndarray:
        """Places in the map."""
        return random.uniform(0, 1, (PLACES, 2)) * self.size * self.side @ self.turn.T + self.corner

    def distance(self, places: np.ndarray) -> np.ndarray:
        """To the nearest square."""
        at = (places - self.corner) @ self.turn / self.side
        if not len(self.low):
            return np.full(len(at), np.inf)
        gap = np.maximum(self.low - at[:, np.newaxis], at[:, np.newaxis] - self.low - 1)
        return self.side * np.linalg.norm(np.maximum(gap, 0), axis=2).min(axis=1)


def distance_to(corners: np.ndarray, place: np.ndarray) -> float:
    """Of a place to a convex polygon."""
    ends = np.roll(corners, -1, axis=0)
    along, off = ends - corners, place - corners
    turns = along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0]
    if (turns >= 0).all() or (turns <= 0).all():
        return 0.0
    share = np.clip((along * off).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(off - share[:, np.newaxis] * along, axis=1).min())


def judge(world: hf.OccupancyMap, random: np.random.Generator, outcome: Outcome) -> None:
    """Distances and bodies at random places."""
    cells = Cells(world)
    places = cells.drawn(random)
    exact, stated = cells.distance(places), world.distance(places)
    below, above = world.distance_error
    some = np.isfinite(exact)
    error = stated[some] - exact[some]
    if (error > above + SMALL).any() or (error < -below - SMALL).any():
        outcome.faults.append(Fault(FAR, f"by {error.min():g} to {error.max():g}"))
    within = float(random.uniform(1, 12)) * world.resolution
    for place, far, near in zip(places, exact, world.near_many(places, within), strict=True):
        gaps = [distance_to(np.array(body.bodies[0][0]), place) for body in near]
        nearest = min(gaps, default=np.inf)
        if far <= within and nearest > far + SMALL:
            outcome.faults.append(Fault(LEFT, f"{far:g} m from {place}: {nearest:g} m"))
        if nearest < far - world.resolution - SMALL:
            outcome.faults.append(Fault(BEYOND, f"{far:g} m from {place}: {nearest:g} m"))
    outcome.judged += len(places)
    outcome.counts["places"] = outcome.counts.get("places", 0) + len(places)


def attempt(seed: int, number: int) -> Outcome:
    """A map, patches of it, and runs through it."""
    random = np.random.default_rng((seed, number, 48))

    def trial(outcome: Outcome) -> None:
        world = world_of(random)
        judge(world, random, outcome)
        for _ in range(3):
            rows, columns = (int(random.integers(1, n)) for n in world.shape)
            patch = random.random((rows, columns)) < random.choice([0.0, 0.1, 0.6])
            row, column = (
                int(random.integers(0, n - k + 1))
                for n, k in zip(world.shape, (rows, columns), strict=True)
            )
            if rows * columns < 400:
                world.update(patch, row, column)
        anew = hf.OccupancyMap(
            world.cells, world.resolution, world.origin, unknown=world.unknown
        )  # fmt: skip
        places = Cells(world).drawn(random)
        if not np.array_equal(world.distance(places), anew.distance(places)):
            outcome.faults.append(Fault(ANEW, "distances"))
        judge(world, random, outcome)
        if number % 4 == 1:
            rooms = maps.random_rooms(random)
            vehicle = str(random.choice(list(maps.VEHICLES)))
            answer = maps.drive(vehicle, RUNS, worlds=[rooms] * RUNS, seed=number, seconds=SECONDS)
            if answer["hit without an infeasible sample"] or answer["left out"]:
                outcome.faults.append(Fault(HIT, f"a {vehicle}: {answer['least']:g} m"))
            outcome.counts["runs"] = RUNS
            outcome.counts["infeasible"] = answer["runs with an infeasible sample"]

    return attacked(trial)


def shrink(seed: int, number: int, fault: Fault) -> None:
    """A file that tries the case again; maps are not made smaller."""
    fault.text = (
        f"# {fault.signature}: {fault.message}\n# to be run in the folder benchmarks\n"
        f"from attacks import maps\n\nfor fault in maps.attempt({seed}, {number}).faults:\n"
        "    print(fault.signature, fault.message)\n"
    )


KIND = Kind("maps", attempt, shrink, share=1.0, seconds=90.0, shown=("places", "runs"))
