"""Vehicles that drive through maps: who is hit, with a filter and without.

    python benchmarks/maps.py unicycle boat                  rooms with doors of 1.2 m
    python benchmarks/maps.py unicycle boat --growing        cells beyond 3 m are unknown until seen
    python benchmarks/maps.py unicycle --random 100          another map for every run
    python benchmarks/maps.py ridge                          a smooth field in a corridor
    python benchmarks/maps.py times                          a map of 1,000 x 1,000 cells
    python benchmarks/maps.py --draw                         the map of the examples, and the figure

Each vehicle is sent to places elsewhere in the map, along a straight line, and turns to another
place every 6 s. The truth is looked at beside the filter: the distance from the vehicle to every
occupied cell around it, as a square, at every sample.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import sympy as sp

import holdfast as hf

ROOT = Path(__file__).parents[1]
MAP = ROOT / "examples" / "rooms.yaml"
SAMPLE, SECONDS, EVERY = 0.02, 30.0, 6.0
RADIUS, CLEARANCE, NEAR, MOST = 0.15, 0.03, 2.5, 40
SEEN = 3.0
"""How far a sensor sees [m]."""
VEHICLES = {
    "unicycle": (lambda: hf.systems.unicycle(), 0.25, (1.0, 4.0), (1.0, 2.0, 0.0)),
    "boat": (
        lambda: hf.systems.marine_vehicle("videoray_pro_iii"), 0.3, (0.6, 3.0), (6.0, 1.0, 0.25),
    ),
}  # fmt: skip
"""The lead [m] and gains [1/s] of the filter; surge, turn and damping of the controller."""


# -- maps -------------------------------------------------------------------------------------


def rooms():
    """Sixteen rooms of 5 m with doors of 1.2 m, pillars, a slanted wall: percent, -1 unknown."""
    random, cells = np.random.default_rng(4), np.zeros((200, 200))
    cells[[0, 1, -1, -2]] = cells[:, [0, 1, -1, -2]] = 100
    for wall in (50, 100, 150):
        cells[wall - 1 : wall + 1] = cells[:, wall - 1 : wall + 1] = 100
    for wall in (50, 100, 150):
        for room in range(0, 200, 50):
            door = room + int(random.integers(8, 30))
            cells[wall - 1 : wall + 1, door : door + 12] = 0
            door = room + int(random.integers(8, 30))
            cells[door : door + 12, wall - 1 : wall + 1] = 0
    y, x = np.mgrid[:200, :200] + 0.5
    for px, py in ((25, 125), (125, 30), (172, 172)):
        cells[(x - px) ** 2 + (y - py) ** 2 < 25] = 100
    cells[(np.abs(y - 70 - 0.4 * (x - 60)) < 1.2) & (np.abs(x - 75) < 11)] = 100
    cells[160:190, 12:30] = -1
    return cells


def random_rooms(random, cells_of=120):
    """Walls at random places with doors of 1.4 m, slanted walls, discs, and single cells."""
    n = cells_of
    cells = np.zeros((n, n))
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    for along in (0, 1):
        for wall in random.choice(np.arange(30, n - 25, 15), 2, replace=False):
            lines = cells if along else cells.T
            lines[wall : wall + int(random.integers(1, 4))] = 100
            for door in random.integers(4, n - 20, 3):
                lines[wall : wall + 4, door : door + 14] = 0
    y, x = np.mgrid[:n, :n] + 0.5
    for _ in range(3):
        (px, py), turn = random.uniform(20, n - 20, 2), random.uniform(0, np.pi)
        across = (y - py) * np.cos(turn) - (x - px) * np.sin(turn)
        along = (y - py) * np.sin(turn) + (x - px) * np.cos(turn)
        cells[(np.abs(across) < 1.3) & (np.abs(along) < random.uniform(4, 12))] = 100
    for _ in range(4):
        px, py = random.uniform(10, n - 10, 2)
        cells[(x - px) ** 2 + (y - py) ** 2 < random.uniform(1, 5) ** 2] = 100
    cells[random.random(cells.shape) < 0.001] = 100
    origin = (*random.uniform(-20, 20, 2), random.uniform(-np.pi, np.pi))
    return hf.OccupancyMap(cells, 0.1, origin)


def write_map():
    """The map of the examples, as map_server writes it."""
    shade = np.where(rooms() < 0, 205, np.where(rooms() > 0, 0, 254)).astype(np.uint8)[::-1]
    rows, columns = shade.shape
    MAP.with_suffix(".pgm").write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + shade.tobytes())
    MAP.write_text(
        "image: rooms.pgm\nmode: trinary\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n",
        "utf-8",
    )


class Truth:
    """The distance to occupied cells as squares, in a window, by nothing of the package."""

    def __init__(self, world, reach=8):
        self.cells, self.resolution, self.reach = world.cells, world.resolution, reach
        x, y, yaw = world.origin
        self.corner = np.array([x, y])
        self.turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])

    def in_cells(self, places):
        return (places - self.corner) @ self.turn / self.resolution

    def __call__(self, places):
        """Up to `reach` cells; what is outside the map is occupied."""
        at = self.in_cells(places)
        window = np.arange(-self.reach, self.reach + 1)
        base = np.floor(at).astype(int)
        column, row = (base[:, k, np.newaxis] + window for k in (0, 1))
        rows, columns = self.cells.shape
        inside = ((column >= 0) & (column < columns))[:, np.newaxis, :] & (
            (row >= 0) & (row < rows)
        )[:, :, np.newaxis]
        there = (
            self.cells[
                np.clip(row, 0, rows - 1)[:, :, np.newaxis],
                np.clip(column, 0, columns - 1)[:, np.newaxis, :],
            ]
            | ~inside
        )
        gaps = []
        for index, place in ((column, at[:, :1]), (row, at[:, 1:])):
            gaps.append(np.maximum(np.maximum(index - place, place - index - 1), 0))
        gap = np.hypot(gaps[0][:, np.newaxis, :], gaps[1][:, :, np.newaxis])
        return self.resolution * np.where(there, gap, np.inf).min(axis=(1, 2))

    def free(self, random, count, gap):
        """Places in the map with so much around them."""
        rows, columns = self.cells.shape
        places = np.empty((0, 2))
        while len(places) < count:
            drawn = random.uniform(0, [columns, rows], (4 * count, 2)) * self.resolution
            drawn = drawn @ self.turn.T + self.corner
            places = np.vstack([places, drawn[self(drawn) > gap]])
        return places[:count]


class Seen:
    """A map that is unknown where a sensor that sees 3 m has not been, for one run."""

    def __init__(self, world):
        self.world, self.wide = world, int(SEEN / world.resolution)
        self.states, self.truth = np.full(world.shape, -1), Truth(world)
        self.states_of = np.where(world.cells, 100, 0)
        self.map = hf.OccupancyMap(self.states, world.resolution, world.origin)
        y, x = np.mgrid[-self.wide : self.wide + 1, -self.wide : self.wide + 1]
        self.disc = np.hypot(x, y) * world.resolution <= SEEN

    def look(self, place):
        """Cells within 3 m are seen, through walls too: how a map grows is not the question."""
        rows, columns = self.states.shape
        column, row = np.floor(self.truth.in_cells(place)).astype(int)
        low = max(row - self.wide, 0), max(column - self.wide, 0)
        high = min(row + self.wide + 1, rows), min(column + self.wide + 1, columns)
        part = slice(low[0], high[0]), slice(low[1], high[1])
        disc = self.disc[
            low[0] - row + self.wide : high[0] - row + self.wide,
            low[1] - column + self.wide : high[1] - column + self.wide,
        ]
        self.states[part] = np.where(disc, self.states_of[part], self.states[part])
        self.map.update(self.states[part], row=low[0], column=low[1])


# -- runs -------------------------------------------------------------------------------------


class Course:
    """The command of a controller that drives straight to places, another every 6 s."""

    def __init__(self, vehicle, places):
        self.surge, self.turn, self.damping = VEHICLES[vehicle][3]
        self.places = places

    def __call__(self, t, states):
        goal = self.places[:, int(t / EVERY + 1e-9) % self.places.shape[1]]
        gap = goal - states[:, :2]
        off = np.arctan2(gap[:, 1], gap[:, 0]) - states[:, 2]
        off = np.arctan2(np.sin(off), np.cos(off))
        surge = np.minimum(1, 2 * np.linalg.norm(gap, axis=1)) * np.maximum(np.cos(off), 0)
        turn = np.clip(1.5 * off, -1, 1) * self.turn
        if self.damping:
            turn = np.clip(0.6 * off - self.damping * states[:, 5], -0.4, 0.4) * self.turn
        return np.stack([self.surge * surge, turn], axis=1)


def drive(vehicle, runs, *, filtered=True, growing=False, worlds=None, seed=0, most=MOST):
    """What came of it: runs hit, least distance of the hull, infeasible samples, the way, and
    bodies that were near and had no place."""
    make, lead, gains, _ = VEHICLES[vehicle]
    system, random = make(), np.random.default_rng(seed)
    worlds = worlds or [hf.OccupancyMap.from_file(MAP)] * runs
    truths = [Truth(world) for world in worlds]
    one = all(world is worlds[0] for world in worlds)
    margin = RADIUS + lead + 2 * 0.1  # the disc ahead of the axle, and what bodies reach beyond
    if one:
        starts, places = (truths[0].free(random, n, margin) for n in (runs, 6 * runs))
        places = places.reshape(runs, 6, 2)
    else:
        starts = np.vstack([truth.free(random, 1, margin) for truth in truths])
        places = np.stack([truth.free(random, 6, RADIUS) for truth in truths])
    states = np.zeros((runs, len(system.states)))
    states[:, :2], states[:, 2] = starts, random.uniform(-np.pi, np.pi, runs)
    ahead = lead * np.stack([np.cos(states[:, 2]), np.sin(states[:, 2])], axis=1)
    states[:, :2] -= ahead  # the point that keeps clear is at the place
    course = Course(vehicle, places)
    seen = [Seen(world) for world in worlds] if growing else None
    least, counted = np.full(runs, np.inf), {"near": 0, "left": 0, "most": 0, "sample": 0}

    def look(states):
        """The truth at a sample."""
        if one:
            gap = truths[0](states[:, :2])
        else:
            pairs = zip(truths, states[:, :2], strict=True)
            gap = np.concatenate([truth(place[np.newaxis]) for truth, place in pairs])
        np.minimum(least, gap - RADIUS, out=least)

    def around(t, states):
        look(states)
        counted["sample"] += 1
        if growing:
            if counted["sample"] % 10 == 1:
                for one_seen, place in zip(seen, states[:, :2], strict=True):
                    one_seen.look(place)
            listed = [s.map.near(place, NEAR) for s, place in zip(seen, states[:, :2], strict=True)]
        elif one:
            listed = worlds[0].near(states[:, :2], NEAR)
        else:
            listed = [w.near(place, NEAR) for w, place in zip(worlds, states[:, :2], strict=True)]
        sizes = [len(bodies) for bodies in listed]
        counted["near"] += sum(sizes)
        counted["most"] = max(counted["most"], *sizes)
        counted["left"] += sum(size > most for size in sizes)
        return listed

    if filtered:
        keep = hf.SafetyFilter(
            system, obstacles=hf.Obstacles(most, hull=RADIUS, lead=lead, clearance=CLEARANCE),
            gains=gains, sample_time=SAMPLE,
        )  # fmt: skip
        law, command = keep.law, keep.among(course, around)
    else:

        def command(t, states):
            look(states)
            return course(t, states)

        law = hf.commanded(system)
    result = hf.simulate(
        system, law, command=command, starts=states, horizon=SECONDS, sample_time=SAMPLE,
        record_every=0.5,
    )  # fmt: skip
    paths = result.arrays["state"].values[:, :, :2]
    slack = result.arrays["infeasible"].values if filtered else np.zeros(runs)
    return {
        "hit": int((least < 0).sum()),
        "hit without an infeasible sample": int(((least < 0) & (slack == 0)).sum()),
        "least": float(least.min()),
        "runs with an infeasible sample": int((slack > 0).sum()),
        "infeasible": float(slack.mean() / (SECONDS / SAMPLE)),
        "way": float(np.median(np.linalg.norm(np.diff(paths, axis=1), axis=2).sum(axis=1))),
        "near": counted["near"] / max(runs * counted["sample"], 1),
        "most near": counted["most"],
        "left out": counted["left"],
        "paths": paths,
    }


def ridge(width, runs=200, cell=0.1, seed=0):
    """A boat that sways from side to side in a corridor: runs and samples without an input.

    The smooth field is w / 2 - sqrt(y^2 + cell^2) at the point P of the filter, the distance to the
    nearer wall with its ridge rounded over a cell.
    """
    make, lead, gains, _ = VEHICLES["boat"]
    boat = make()
    q = {state.name: state.symbol for state in boat.states}
    level = lead + RADIUS - width / 2 + sp.sqrt((q["y"] + lead * sp.sin(q["psi"])) ** 2 + cell**2)
    field = hf.Region("field", boat.states[1:3], (hf.Inequality("field", level, "m"),))
    cells = np.zeros((round(width / cell) + 4, 400))
    cells[[0, 1, -1, -2]] = 100
    walls = hf.OccupancyMap(cells, cell, (-10, -width / 2 - 2 * cell, 0), unknown="free")
    random = np.random.default_rng(seed)
    starts = np.zeros((runs, 6))
    starts[:, 1] = random.uniform(-0.1, 0.1, runs)
    phase = random.uniform(0, 2 * np.pi, runs)

    def sway(t, states):
        heading = 0.6 * np.sin(1.2 * t + phase)
        turn = np.clip(2.0 * (heading - states[:, 2]) - 0.3 * states[:, 5], -0.4, 0.4)
        return np.stack([np.full(len(states), 3.0), turn], axis=1)

    answers = {}
    by_field = hf.SafetyFilter(boat, field, gains=gains, sample_time=SAMPLE)
    by_bodies = hf.SafetyFilter(
        boat, obstacles=hf.Obstacles(10, hull=RADIUS, lead=lead), gains=gains, sample_time=SAMPLE
    )
    among = by_bodies.among(sway, lambda t, states: walls.near(states[:, :2], NEAR))
    for name, law, command in (
        ("smooth field", by_field.law, sway), ("bodies", by_bodies.law, among),
    ):  # fmt: skip
        result = hf.simulate(
            boat, law, command=command, starts=starts, horizon=15.0, sample_time=SAMPLE,
            record_every=0.1,
        )  # fmt: skip
        infeasible = result.arrays["infeasible"].values
        place = result.arrays["state"].values
        point = np.abs(place[:, :, 1] + lead * np.sin(place[:, :, 2])).max(axis=1)
        answers[name] = {
            "runs": int((infeasible > 0).sum()),
            "samples": float(infeasible.mean() / (15.0 / SAMPLE)),
            "least": float(width / 2 - lead - RADIUS - point.max()),
        }
    return answers


def times():
    """How long a map of 1,000 x 1,000 cells takes: a line for each thing."""
    random = np.random.default_rng(1)
    cells = random.random((1000, 1000)) < 0.001
    cells[::60] = cells[:, ::60] = True
    for wall in range(0, 1000, 60):
        for room in range(0, 1000, 60):
            door = room + int(random.integers(5, 40))
            cells[wall, door : door + 12] = cells[door : door + 12, wall] = False
    world = hf.OccupancyMap(cells, 0.05)
    place = np.array([25.0, 25.0])

    def timed(what, function, count=1):
        """CPU time of this process, the median of so many."""
        spent = []
        for _ in range(count):
            began = time.process_time()
            function()
            spent.append(time.process_time() - began)
        print(f"{what}: {1e3 * float(np.median(spent)):.3f} ms", flush=True)

    def patch():
        return random.random((60, 60)) < 0.05

    timed("all distances", lambda: world.distance([place]))
    timed("all bodies", lambda: world.near(place, NEAR))
    print(f"{len(world._convex())} bodies, {len(world.near(place, NEAR))} within {NEAR:g} m")
    timed("near", lambda: world.near(place, NEAR), 200)
    timed("a patch of 60 x 60, distances", lambda: world.update(patch(), 500, 300), 10)

    def seen():
        world.update(patch(), 500, 300)
        world.near(place, NEAR)

    timed("a patch of 60 x 60, distances and bodies", seen, 10)
    keep = hf.SafetyFilter(
        hf.systems.unicycle(), obstacles=hf.Obstacles(MOST, hull=RADIUS, lead=0.25), gains=(1, 4)
    )
    bodies = world.near(place, NEAR)
    timed("step", lambda: keep.step([25.0, 25.0, 0.0], [1.0, 0.0], obstacles=bodies), 200)


def draw(path):
    """The map, paths with the filter and without, and the bodies that are near one vehicle."""
    import matplotlib.pyplot as plt
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Circle, Polygon

    world, cells = hf.OccupancyMap.from_file(MAP), rooms()
    shown = np.where(cells < 0, 1, np.where(cells > 0, 2, 0))
    colours = ListedColormap(["white", "#c9c5bf", "#4d4943"])
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 5), layout="constrained")
    for axes in (left, right):
        axes.imshow(shown, cmap=colours, origin="lower", extent=(0, 20, 0, 20), vmin=0, vmax=2)
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    answers = {f: drive("unicycle", 6, filtered=f, seed=3)["paths"] for f in (False, True)}
    for filtered, colour, name in ((False, "#d55e00", "alone"), (True, "#0072b2", "filtered")):
        paths = answers[filtered]
        for k, run in enumerate(paths):
            left.plot(*run.T, color=colour, lw=1.4, label=name if k == 0 else None)
    left.plot(*answers[True][:, 0].T, "o", color="black", ms=4, label="start")
    left.set(xlim=(-1, 21), ylim=(-1, 22.5), title="six robots, 30 s", xticks=range(0, 21, 5))
    left.legend(loc="upper center", ncol=3, framealpha=1)
    place, heading, lead = np.array([7.6, 9.0]), 0.9, VEHICLES["unicycle"][1]
    ahead = place + lead * np.array([np.cos(heading), np.sin(heading)])
    for k, body in enumerate(world.near(place, NEAR)):
        outline = Polygon(
            body.bodies[0][0], fill=False, ec="#0072b2", lw=1.6,
            label="a body that is near" if k == 0 else None,
        )  # fmt: skip
        right.add_patch(outline)
    right.add_patch(Circle(place, NEAR, fill=False, ec="black", ls=":", label="2.5 m"))
    right.add_patch(
        Circle(ahead, lead + RADIUS, fc="#e69f0055", ec="#e69f00", label="disc that keeps clear")
    )
    right.plot(*place, "o", color="black", ms=4, label="axle")
    right.set(xlim=(4.2, 11.2), ylim=(5.6, 12.6), title="what the filter is given there")
    right.legend(loc="lower right", framealpha=1)
    figure.savefig(path, dpi=110)


def said(vehicle, what, answer, runs):
    return (
        f"{vehicle:9s} {what:20s} hit {answer['hit']} of {runs} "
        f"({answer['hit without an infeasible sample']} without an infeasible sample), least "
        f"{answer['least']:+.3f} m, infeasible {100 * answer['infeasible']:.3f} % in "
        f"{answer['runs with an infeasible sample']} runs, way {answer['way']:.1f} m, bodies near "
        f"{answer['near']:.1f}, at most {answer['most near']}, left out {answer['left out']} times"
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="*", help="unicycle, boat, ridge, times")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--growing", action="store_true")
    parser.add_argument("--random", type=int, default=0, metavar="MAPS")
    parser.add_argument("--draw", action="store_true")
    asked = parser.parse_args()
    if asked.draw:
        write_map()
        draw(ROOT / "docs" / "images" / "maps.png")
    for what in asked.what:
        began = time.perf_counter()
        if what == "times":
            times()
            continue
        if what == "ridge":
            for width in (1.2, 1.6, 2.0):
                for name, answer in ridge(width, asked.runs).items():
                    print(
                        f"corridor of {width:g} m, {name:12s} no input in {answer['runs']} of "
                        f"{asked.runs} runs, {100 * answer['samples']:.2f} % of samples, least gap "
                        f"{answer['least']:+.3f} m", flush=True,
                    )  # fmt: skip
            continue
        if asked.random:
            random = np.random.default_rng(asked.seed)
            worlds = [random_rooms(random) for _ in range(asked.random)]
            answer = drive(
                what, asked.random, worlds=worlds, growing=asked.growing, seed=asked.seed
            )
            print(said(what, "random maps", answer, asked.random), flush=True)
            continue
        for filtered in (True,) if asked.growing else (False, True):
            answer = drive(
                what, asked.runs, filtered=filtered, growing=asked.growing, seed=asked.seed
            )
            kind = ("growing map" if asked.growing else "filtered") if filtered else "alone"
            print(
                said(what, kind, answer, asked.runs),
                f"({time.perf_counter() - began:.0f} s)",
                flush=True,
            )


if __name__ == "__main__":
    main()
