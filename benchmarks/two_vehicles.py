"""What the kernel of two vehicles keeps, and what a barrier keeps, against a worst opponent.

    python benchmarks/two_vehicles.py [CASE ...] [--starts 100] [--seconds 8]
    python benchmarks/two_vehicles.py forward --figure docs/images/two_vehicles.png

Starts are drawn among the relative poses near the edge of the kernel from which held inputs keep
the distance: W above its level, V at most .5 m. Our vehicle is steered at the other one, and its
filter changes that. The other one is an opponent of three kinds: one that lowers the value of the
kernel the most at every sample, one that heads for our vehicle at full speed, and one that changes
between extremes at random. A start counts as kept where the vehicles keep their distance for the
time against all three.
"""

from __future__ import annotations

import argparse
import itertools
import math
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
import sympy as sp

import holdfast as hf
from holdfast.execution.leaf import Evaluator

SAMPLE_TIME, SUBSTEPS = 0.05, 4
NEAR = 0.5
"""The V of starts [m], at most: from far away every filter keeps its distance at first."""

KINDS = ("lowers the value", "pursues", "at random")


def forward(least: float, most: float, turn: float, name: str) -> hf.System:
    """A unicycle that cannot stop: its speed is between two numbers [m/s], turn [rad/s]."""
    unicycle = hf.systems.unicycle()
    return hf.System(
        name, unicycle.states, unicycle.inputs, unicycle.rates,
        input_bounds=hf.Box((least, -turn), (most, turn)),
    )  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Two vehicles, the distance that they keep [m], and the grid of their kernel."""

    title: str
    ours: hf.System
    theirs: hf.System
    distance: float
    reach: float
    nodes: int

    def pair(self) -> hf.PairKernel:
        """The kernel of both."""
        relative = hf.relative_system(self.ours, self.theirs)
        ahead, left = (q.symbol for q in relative.states[:2])
        near = hf.Inequality("near", self.distance - sp.sqrt(ahead**2 + left**2), "m")
        box = dict.fromkeys(("x_r", "y_r"), (-self.reach, self.reach))
        nodes = hf.grid(
            relative, {**box, "psi_r": (-math.pi, math.pi)}, self.nodes,
            dict.fromkeys(box, "extrapolated"),
        )  # fmt: skip
        region = hf.Region("apart", relative.states[:2], (near,))
        kernel = hf.discriminating_kernel(relative, region, nodes, 30.0)
        return hf.PairKernel(self.ours, self.theirs, kernel)


CASES = {
    "equal": Case(
        "two unicycles of 1 m/s and 2 rad/s",
        hf.systems.unicycle(), hf.systems.unicycle(), 1.0, 4.0, 31,
    ),
    "slower": Case(
        "a unicycle of 1 m/s, the other one of 0.6 m/s",
        hf.systems.unicycle(), hf.systems.unicycle(0.6), 1.0, 4.0, 31,
    ),
    "forward": Case(
        "a vehicle of 0.5 to 1 m/s, the other one of 0.5 to 0.8 m/s, both 1 rad/s",
        forward(0.5, 1.0, 1.0, "ours"), forward(0.5, 0.8, 1.0, "theirs"), 1.0, 4.0, 31,
    ),
    "agile": Case(
        "a vehicle of 0.5 to 1 m/s and 2 rad/s, the other one of 1 rad/s",
        forward(0.5, 1.0, 2.0, "ours"), forward(0.5, 1.0, 1.0, "theirs"), 1.0, 4.0, 31,
    ),
}  # fmt: skip


class Vehicle:
    """A vehicle that moves with a held input."""

    def __init__(self, system: hf.System) -> None:
        symbols = [q.symbol for q in (*system.states, *system.inputs)]
        self.rates = Evaluator(list(system.rates.values()), symbols, system.parameters)
        values = {p.symbol: p.value for p in system.parameters}
        ends = [[float(e.subs(values)) for e in pair] for pair in system.input_bounds.ranges()]
        self.low, self.high = np.array(ends).T
        self.corners = np.array(list(itertools.product(*ends)))

    def moved(self, states, inputs, time):
        """The states (runs, states) after some time with held inputs, by Runge-Kutta steps."""
        f = lambda q: self.rates.values(np.hstack([q, inputs]))  # noqa: E731
        a = f(states)
        b = f(states + time / 2 * a)
        c = f(states + time / 2 * b)
        return states + time / 6 * (a + 2 * b + 2 * c + f(states + time * c))


def relative(ours, theirs):
    """The relative poses (runs, 3)."""
    dx, dy = (theirs - ours)[:, 0], (theirs - ours)[:, 1]
    cos, sin = np.cos(ours[:, 2]), np.sin(ours[:, 2])
    turn = theirs[:, 2] - ours[:, 2]
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)


def steered_at(vehicle, states, other, speed):
    """Inputs (runs, 2) at a speed towards another place."""
    gap = other[:, :2] - states[:, :2]
    error = np.arctan2(gap[:, 1], gap[:, 0]) - states[:, 2]
    error = (error + np.pi) % (2 * np.pi) - np.pi
    turn = np.clip(error / SAMPLE_TIME, vehicle.low[1], vehicle.high[1])
    return np.stack([np.full(len(states), speed), turn], axis=1)


class Opponent:
    """What the other vehicle does, of one of `KINDS`."""

    def __init__(self, kind, vehicle, pair, seed):
        self.kind, self.vehicle, self.pair = kind, vehicle, pair
        self.generator, self.until = np.random.default_rng(seed), 0.0

    def inputs(self, t, ours, theirs, moved):
        """Its inputs (runs, 2); moved: ours after the sample, which it foresees."""
        if self.kind == "pursues":
            return steered_at(self.vehicle, theirs, ours, self.vehicle.high[0])
        if self.kind == "at random":
            if t >= self.until:
                self.until = t + self.generator.uniform(0.2, 1.5)
                drawn = self.generator.integers(0, len(self.vehicle.corners), len(theirs))
                self.does = self.vehicle.corners[drawn]
            return self.does
        heights = []
        axes = self.pair.value.grid.axes[:2]
        for corner in self.vehicle.corners:
            does = np.tile(corner, (len(theirs), 1))
            seen = relative(moved, self.vehicle.moved(theirs, does, SAMPLE_TIME))
            for k, axis in enumerate(axes):  # beyond the grid as at its edge
                seen[:, k] = np.clip(seen[:, k], axis.low, axis.high)
            heights.append(self.pair.value.at(seen))
        return self.vehicle.corners[np.argmin(heights, axis=0)]


def least_distances(case, pair, starts, decide, kind, seconds, paths=None):
    """The least distance of every start (runs, 3) in that time, and the infeasible samples.

    decide: of our state, the other state, the other velocity, and a command, to an input and
    whether it was admissible. paths: a list to which the poses of both are appended.
    """
    ours, theirs = Vehicle(case.ours), Vehicle(case.theirs)
    opponent = Opponent(kind, theirs, pair, 1)
    q, z = np.zeros_like(starts), starts.copy()
    velocity = np.zeros((len(q), 2))
    least = np.hypot(*(z - q)[:, :2].T)
    infeasible = np.zeros(len(q), dtype=int)
    for k in range(round(seconds / SAMPLE_TIME)):
        wanted = steered_at(ours, q, z, ours.high[0])
        u = wanted.copy()
        for i in range(len(q)):
            if least[i] >= case.distance:  # what is lost already is not steered on
                u[i], admissible = decide(q[i], z[i], velocity[i], wanted[i])
                infeasible[i] += not admissible
        does = opponent.inputs(k * SAMPLE_TIME, q, z, ours.moved(q, u, SAMPLE_TIME))
        before = z.copy()
        for _ in range(SUBSTEPS):
            q = ours.moved(q, u, SAMPLE_TIME / SUBSTEPS)
            z = theirs.moved(z, does, SAMPLE_TIME / SUBSTEPS)
            least = np.minimum(least, np.hypot(*(z - q)[:, :2].T))
        velocity = (z - before)[:, :2] / SAMPLE_TIME
        if paths is not None:
            paths.append((q.copy(), z.copy()))
    return least, infeasible


def by_kernel(case, guard):
    """Decisions by the kernel of both vehicles."""

    def decide(q, z, velocity, wanted):
        other = hf.Obstacle.vehicle(z[:2], z[2], case.distance / 2, velocity=tuple(velocity))
        d = guard.step(q, wanted, obstacles=[other])
        return d.input, d.status is not hf.Status.INFEASIBLE

    return decide


def by_barrier(case, guard, *, told):
    """Decisions by the condition of a disc; told: with the velocity at the last sample, which may
    change as fast as a turn changes it; else with a velocity of any direction."""
    theirs = Vehicle(case.theirs)
    fastest, turn = theirs.high

    def decide(q, z, velocity, wanted):
        motion = {"velocity_error": fastest}
        if told:
            motion = {"velocity": tuple(velocity), "acceleration": fastest * turn}
        d = guard.step(q, wanted, obstacles=[hf.Obstacle.disc(z[:2], case.distance / 2, **motion)])
        return d.input, d.status is not hf.Status.INFEASIBLE

    return decide


def starts_of(case, pair, keeper, count, seed=0):
    """Relative poses near the edge of the kernel from which held inputs keep the distance."""
    generator = np.random.default_rng(seed)
    chosen = []
    while len(chosen) < count:
        reach = keeper.reach * np.sqrt(generator.uniform())
        bearing, turn = generator.uniform(-np.pi, np.pi, 2)
        pose = np.array([reach * np.cos(bearing), reach * np.sin(bearing), turn])
        if keeper.keeps(pose) and pair.value.at([pose])[0] < NEAR:
            chosen.append(pose)
    return np.array(chosen)


def compared(case, count, seconds):
    """Of so many starts how many each filter keeps, by the name of the filter."""
    pair = case.pair()
    wide = case.distance / 2
    guard = hf.SafetyFilter(
        case.ours, obstacles=hf.Obstacles(1, hull=wide, pair=pair), sample_time=SAMPLE_TIME
    )
    disc = hf.SafetyFilter(case.ours, obstacles=hf.Obstacles(1, hull=wide), sample_time=SAMPLE_TIME)
    starts = starts_of(case, pair, guard._slots.keeper, count)
    filters = {
        "kernel": by_kernel(case, guard),
        "barrier, velocity told": by_barrier(case, disc, told=True),
        "barrier, any velocity": by_barrier(case, disc, told=False),
    }
    results = {}
    for name, decide in filters.items():
        each = [least_distances(case, pair, starts, decide, kind, seconds)[0] for kind in KINDS]
        least = np.min(each, axis=0)
        results[name] = int((least >= case.distance).sum()), float(least.min())
    return results


def figure(case, path):
    """Draw what the kernel loses at three headings of the other vehicle, and a play at its edge."""
    pair = case.pair()
    wide = case.distance / 2
    guard = hf.SafetyFilter(
        case.ours, obstacles=hf.Obstacles(1, hull=wide, pair=pair), sample_time=SAMPLE_TIME
    )
    drawn, (left, right) = plt.subplots(1, 2, figsize=(9.6, 4.6), layout="constrained")
    ahead, aside, _ = (axis.nodes for axis in pair.value.grid.axes)
    headings = {"the same heading": 0.0, "across, to the left": np.pi / 2, "head-on": -np.pi}
    for (label, turn), colour, dashes in zip(
        headings.items(), ("#0072B2", "#E69F00", "#D55E00"), ("-", "--", "-."), strict=True
    ):
        values = pair.value.slice(psi_r=turn).values()
        left.contour(ahead, aside, values.T, [0.0], colors=colour, linestyles=dashes, linewidths=2)
        left.plot([], [], dashes, color=colour, lw=2, label=label)
    around = np.linspace(0, 2 * np.pi, 100)
    left.fill(case.distance * np.cos(around), case.distance * np.sin(around), color="0.85", lw=0)
    left.annotate(
        "", (0.45, 0), (-0.35, 0), arrowprops={"arrowstyle": "-|>", "color": "0.2", "lw": 2}
    )
    left.text(0.0, -0.42, "ours", ha="center", color="0.2")
    left.set(
        xlabel="ahead of our vehicle [m]", ylabel="to its left [m]", aspect="equal",
        xlim=(-2, 3), ylim=(-2.5, 2.5), title="places from which the other one catches ours",
    )  # fmt: skip
    left.legend(title="the other vehicle has", loc="lower right", fontsize=8, title_fontsize=8)
    bearing, turn = 0.5, -2.2
    for reach in np.arange(case.distance, guard._slots.keeper.reach, 0.02):
        start = np.array([reach * np.cos(bearing), reach * np.sin(bearing), turn])
        if guard._slots.keeper.keeps(start):
            break
    start = start[np.newaxis]
    paths: list = []
    least, _ = least_distances(case, pair, start, by_kernel(case, guard), KINDS[0], 5.0, paths)
    ours, theirs = (np.array([pair[k][0] for pair in paths]) for k in (0, 1))
    for path_of, colour, dashes, label in (
        (ours, "#0072B2", "-", "ours, filtered"), (theirs, "#D55E00", "--", "the other one"),
    ):  # fmt: skip
        right.plot(path_of[:, 0], path_of[:, 1], dashes, color=colour, lw=2, label=label)
    for k in range(0, len(ours), 20):
        pair_of = np.stack([ours[k, :2], theirs[k, :2]])
        right.plot(*pair_of.T, color="0.75", lw=0.8, zorder=0)
        right.plot(*ours[k, :2], "o", color="#0072B2", ms=4)
        right.plot(*theirs[k, :2], "s", color="#D55E00", ms=4)
    every = np.concatenate([ours[:, :2], theirs[:, :2]])
    middle, half = (every.max(0) + every.min(0)) / 2, np.ptp(every, 0).max() / 2 + 0.3
    right.set(
        xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=middle[0] + half * np.array([-1, 1]),
        ylim=middle[1] + half * np.array([-1, 1]),
        title=f"a play of 5 s, least distance {least[0]:.2f} m",
    )  # fmt: skip
    right.legend(loc="best", fontsize=8)
    drawn.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=list(CASES))
    parser.add_argument("--starts", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--figure", help="draw the first case into a file instead")
    options = parser.parse_args()
    if options.figure:
        figure(CASES[options.cases[0]], options.figure)
        return
    for name in options.cases:
        case = CASES[name]
        results = compared(case, options.starts, options.seconds)
        print(f"{name}: {case.title}, {case.distance:g} m apart")
        for which, (count, least) in results.items():
            share = 100 * count / options.starts
            said = f"keeps {count} of {options.starts} ({share:.1f} %), least {least:.3f} m"
            print(f"  {which:24} {said}")


if __name__ == "__main__":
    main()
