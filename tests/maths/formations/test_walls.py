"""Distances to walls, beside shapely's."""

import numpy as np
import pytest
import shapely
import sympy as sp

import holdfast as hf
from holdfast.execution.leaf import Evaluator
from holdfast.maths.formations.walls import sight_distance, wall_distance

AX, AY, BX, BY = (hf.symbol(n) for n in ("ax", "ay", "bx", "by"))


@pytest.fixture(scope="module")
def walls():
    generator = np.random.default_rng(1)
    return generator.uniform(-2, 2, (9, 4))


def test_distance_to_walls_and_its_gradient(walls):
    distance = wall_distance((AX, AY), [sp.Float(v) for v in walls.ravel()])
    check = Evaluator([distance, distance.diff(AX), distance.diff(AY)], [AX, AY], ())
    points = np.random.default_rng(2).uniform(-3, 3, (2000, 2))
    found = check.values(points)
    lines = shapely.MultiLineString([[w[:2], w[2:]] for w in walls])
    assert found[:, 0] == pytest.approx(shapely.distance(shapely.points(points), lines), abs=1e-12)
    assert np.hypot(found[:, 1], found[:, 2]) == pytest.approx(1.0, abs=1e-9)
    nearer = points - 0.5 * found[:, :1] * found[:, 1:]
    assert check.values(nearer)[:, 0] == pytest.approx(found[:, 0] / 2, abs=1e-12)


def test_line_of_sight_is_as_far_from_walls_as_shapely_says_and_negative_behind_one(walls):
    line = sight_distance((AX, AY), (BX, BY), [sp.Float(v) for v in walls[:4].ravel()])
    variables = [AX, AY, BX, BY]
    check = Evaluator([line, *(line.diff(v) for v in variables)], variables, ())
    ends = np.random.default_rng(3).uniform(-3, 3, (4000, 4))
    found = check.values(ends)
    each = [shapely.LineString([w[:2], w[2:]]) for w in walls[:4]]
    between = shapely.linestrings(ends.reshape(-1, 2, 2))
    crossed = np.array([shapely.crosses(between, w) for w in each])
    assert ((found[:, 0] < 0) == crossed.any(axis=0)).all()
    assert 500 < crossed.any(axis=0).sum() < 3500
    free = ~crossed.any(axis=0)
    distance = shapely.distance(between, shapely.union_all(each))
    assert found[free, 0] == pytest.approx(distance[free], abs=1e-12)
    # behind one wall alone: by as much as an end of one line is beyond the other
    alone = crossed[0] & (crossed.sum(axis=0) == 1)
    points = [shapely.points(ends[alone, :2]), shapely.points(ends[alone, 2:])]
    depth = [shapely.distance(p, each[0]) for p in points]
    depth += [
        shapely.distance(shapely.Point(w), between[alone]) for w in (walls[0, :2], walls[0, 2:])
    ]
    assert found[alone, 0] == pytest.approx(-np.min(depth, axis=0), abs=1e-12)


def test_gradient_of_the_line_of_sight_is_that_of_small_steps(walls):
    line = sight_distance((AX, AY), (BX, BY), [sp.Float(v) for v in walls.ravel()])
    variables = [AX, AY, BX, BY]
    check = Evaluator([line, *(line.diff(v) for v in variables)], variables, ())
    ends = np.random.default_rng(4).uniform(-3, 3, (500, 4))
    at, step = check.values(ends), 1e-6
    steady = np.ones(len(ends), dtype=bool)
    slopes = []
    for i in range(4):
        up, down = ends.copy(), ends.copy()
        up[:, i] += step
        down[:, i] -= step
        one, other = check.values(up), check.values(down)
        steady &= (np.abs(one[:, 1:] - other[:, 1:]) < 1e-3).all(axis=1)  # no kink between them
        slopes.append((one[:, 0] - other[:, 0]) / (2 * step))
    assert steady.mean() > 0.95
    assert at[steady, 1:] == pytest.approx(np.array(slopes).T[steady], abs=1e-4)
