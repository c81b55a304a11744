"""Leader and follower through random corridors: how many are planned, refused, and kept.

python benchmarks/random_corridors.py [--corridors 200] [--cells 4] [--seed 1]

Corridors of rectangular cells, 1.0 to 2.2 m wide and 3 to 6 m long, that turn left or right at
every cell; robots of radius 0.2 m, 1 m apart.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass

import numpy as np

import holdfast as hf
from holdfast.errors import HoldfastError
from holdfast.scenario.build.formation import composed_formation
from holdfast.scenario.schema.closed_loop import FormationSpec

WIDTHS, LENGTHS = (1.0, 2.2), (3.0, 6.0)


@dataclass
class Corridor:
    """Cells from the first to the last, the first along x."""

    cells: dict[str, list[list[float]]]
    goal: list[float]
    width: float


def corridor(generator: np.random.Generator, count: int) -> Corridor:
    """Rectangles, each of which begins at the end of the one before and goes off to a side of it.

    Those that would overlap an earlier one are drawn again.
    """
    while True:
        widths, lengths = generator.uniform(*WIDTHS, count), generator.uniform(*LENGTHS, count)
        sides = generator.choice([-1, 1], count - 1)
        boxes = _boxes(widths, lengths, sides)
        apart = all(
            min(a[2], b[2]) - max(a[0], b[0]) < 1e-9 or min(a[3], b[3]) - max(a[1], b[1]) < 1e-9
            for i, a in enumerate(boxes)
            for b in boxes[:i]
        )
        touching = any(_touch(a, b) for i, a in enumerate(boxes) for b in boxes[: max(i - 1, 0)])
        if apart and not touching:
            break
    cells = {
        f"cell_{i}": [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
        for i, (x0, y0, x1, y1) in enumerate(boxes)
    }
    *_, last = boxes
    way = _ways(sides)[-1]
    middle = np.array([(last[0] + last[2]) / 2, (last[1] + last[3]) / 2])
    return Corridor(cells, [float(v) for v in middle + way * (lengths[-1] / 2 - 0.5)], widths[0])


def _ways(sides: np.ndarray) -> list[np.ndarray]:
    ways = [np.array([1.0, 0.0])]
    for side in sides:
        x, y = ways[-1]
        ways.append(np.array([-side * y, side * x]))
    return ways


def _boxes(widths, lengths, sides) -> list[tuple[float, float, float, float]]:
    """(x0, y0, x1, y1): the cell before ends in a side of the next, at its beginning."""
    ways, found = _ways(sides), []
    end = np.array([-lengths[0], 0.0])  # the middle of where a cell begins
    for i, way in enumerate(ways):
        across = np.array([-way[1], way[0]])
        corners = np.array([end + s * across * widths[i] / 2 for s in (-1, 1)])
        corners = np.vstack([corners, corners + way * lengths[i]])
        low, high = corners.min(axis=0), corners.max(axis=0)
        found.append((*(float(v) for v in low), *(float(v) for v in high)))
        if i + 1 < len(ways):
            exit_middle = end + way * lengths[i]
            onwards = ways[i + 1]
            end = exit_middle + way * widths[i + 1] / 2 - onwards * widths[i] / 2
    return found


def _touch(a, b) -> bool:
    return max(a[0], b[0]) < min(a[2], b[2]) + 1e-9 and max(a[1], b[1]) < min(a[3], b[3]) + 1e-9


def spec_of(found: Corridor) -> FormationSpec:
    return FormationSpec.model_validate(
        {
            "scenario": {"title": "random corridor", "kind": "formation"},
            "environment": {"robot_radius": 0.2, "cells": found.cells},
            "leader": {
                "start": {"x": -1.0, "y": 0.0, "theta": 0.0},
                "goal": found.goal,
                "speed": 0.2,
            },
            "followers": {
                "starts": [{"x": -2.2, "y": 0.05, "theta": 0.0}],
                "law": {"name": "follow_leader", "k1": 0.6, "k2": 0.8, "distance": 1.0},
            },
            "camera": {"range_max": 2.5, "half_angle": "35 deg"},
            "run": {"horizon": 150.0},
        }
    )


def judged(found: Corridor) -> tuple[str, np.ndarray | None]:
    """ "kept", "lost" or the reason of a refusal; and the worst of every constraint."""
    try:
        parts = composed_formation("corridor", spec_of(found))
    except HoldfastError as error:
        return " ".join(str(error).split(": ")[2].split()[:6]), None
    result = hf.simulate(
        parts.system, parts.law, starts=parts.starts, region=parts.region, goal=parts.goal,
        horizon=150.0, sample_time=0.01, substeps=1, record_every=1.0, tolerance=1e-6,
    )  # fmt: skip
    worst = result.dataset["worst_constraint"].values[0]
    outcome = hf.Outcome(int(result.dataset["outcome"].values[0]))
    return "kept" if outcome == hf.Outcome.REACHED else outcome.label, worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--corridors", type=int, default=200)
    parser.add_argument("--cells", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    generator = np.random.default_rng(asked.seed)
    counts: Counter[str] = Counter()
    worst = np.full(6, -np.inf)
    for _ in range(asked.corridors):
        said, found = judged(corridor(generator, asked.cells))
        counts[said] += 1
        if found is not None:
            worst = np.maximum(worst, found)
    for said, count in counts.most_common():
        print(f"{count:5d}  {said}")
    names = ("bearing", "range", "sight", "clear of walls, leader", "follower", "apart")
    shown = [f"{name} {value:.3f}" for name, value in zip(names, worst, strict=True)]
    print("worst of those that ran: " + ", ".join(shown))


if __name__ == "__main__":
    main()
