"""Enclosures contain what balls of many digits say, and are no wider than they must be."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.maths.catalogue.signature import example
from tests.ball_arithmetic import DIGITS, OPERATIONS, X, Y, ball, boxes

COUNT = 400
ROOT = Path(__file__).parents[3]


def points(generator, low, high):
    """The corners, and one inside."""
    inside = low + (high - low) * generator.random(low.shape)
    return [low, high, np.clip(inside, low, high)]


def missed(expression, low, high, at, symbols):
    """How many values at these points are surely outside the enclosure of their box."""
    least, most = Enclosure([expression], symbols).over(low, high)
    count = 0
    for a, b, point in zip(least[:, 0], most[:, 0], at, strict=True):
        try:
            value = ball(expression, dict(zip(symbols, point.tolist(), strict=True)))
        except ZeroDivisionError:
            continue
        if value.is_finite():
            count += bool(value < a) or bool(value > b)
    return count


@pytest.mark.slow(
    "real power",
    "numbers that are no floats",
    "sine",
    "tangent",
    "arctangent",
    "angle",
    "logarithm",
    "hyperbolic tangent",
    "select",
)
@pytest.mark.parametrize("name", OPERATIONS)
def test_no_value_is_outside_its_enclosure(name):
    generator = np.random.default_rng(7)
    low, high = boxes(generator, COUNT)
    for at in points(generator, low, high):
        assert missed(OPERATIONS[name], low, high, at, [X, Y]) == 0


@pytest.mark.parametrize("name", OPERATIONS)
def test_enclosure_of_a_narrow_box_is_narrow(name):
    generator = np.random.default_rng(8)
    low = generator.uniform(0.3, 1.2, (COUNT, 2)) + np.array([0.0, 1.3])
    least, most = Enclosure([OPERATIONS[name]], [X, Y]).over(low, low + 1e-9)
    assert np.isfinite(least).all()
    assert (most - least).max() < 1e-7


def test_points_of_exact_arithmetic_are_hit_within_a_unit_in_the_last_place():
    at = np.array([[3.0, 5.0]])
    least, most = Enclosure([X + Y, X * Y, X**2, sp.sqrt(X + 1)], [X, Y]).over(at, at)
    exact = np.array([8.0, 15.0, 9.0, 2.0])
    assert (least[0] <= exact).all()
    assert (exact <= most[0]).all()
    assert (most[0] - least[0] <= 8 * np.spacing(exact)).all()


def test_extremes_between_the_ends_are_found():
    low, high = np.array([[1.0, 0.0]]), np.array([[2.0, 0.0]])
    least, most = Enclosure([sp.sin(X), sp.cos(X + sp.pi / 2), X**2 - 2 * X], [X, Y]).over(
        low, high
    )
    assert most[0, 0] == 1.0
    assert least[0, 1] == -1.0
    assert least[0, 2] < -1  # each x by itself: wider than the range, never narrower
    low, high = np.array([[-5.0, 0.0]]), np.array([[5.0, 0.0]])
    least, most = Enclosure([sp.sin(X), sp.Abs(X), X**2], [X, Y]).over(low, high)
    assert least[0].tolist() == [-1.0, 0.0, pytest.approx(0.0, abs=1e-300)]
    assert most[0].tolist() == pytest.approx([1.0, 5.0, 25.0])


@pytest.mark.parametrize(
    ("expression", "low", "high"),
    [
        (1 / X, -1.0, 1.0),
        (1 / X, 0.0, 1.0),
        (sp.log(X), -1.0, 1.0),
        (sp.tan(X), 1.0, 2.0),
        (sp.tan(X), 0.0, 4.0),
        (sp.sqrt(X), -2.0, -1.0),
        (X + 1 / Y, 0.0, 1.0),
    ],
)
def test_nothing_is_known_where_a_value_may_not_exist(expression, low, high):
    least, most = Enclosure([expression], [X, Y]).over(np.full((1, 2), low), np.full((1, 2), high))
    assert np.isnan(most).all()
    assert not (least > -math.inf).any() or expression == sp.sqrt(X)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e200, -1e308])
def test_what_is_not_finite_or_overflows_never_gives_a_false_bound(bad):
    names = list(OPERATIONS)
    low = np.array([[bad, 1.0], [1.0, bad], [bad, bad]])
    least, most = Enclosure([OPERATIONS[n] for n in names], [X, Y]).over(low, low)
    for k, name in enumerate(names):
        for point, a, b in zip(low, least[:, k], most[:, k], strict=True):
            if np.isfinite(point).all():
                try:
                    value = ball(OPERATIONS[name], dict(zip([X, Y], point.tolist(), strict=True)))
                except (ZeroDivisionError, OverflowError, ValueError):
                    continue
                outside = bool(value < a) or bool(value > b)
                assert not outside, name


SYSTEMS = [example(f) for f in hf.systems.ALL] + [hf.load_vehicle("otter")]


@pytest.mark.slow(
    "marine_vehicle",
    "slipping_unicycle",
    "car",
    "front_axle_car",
    "tractor_trailer",
    "chain",
    "marine_craft0",
)
@pytest.mark.parametrize("system", SYSTEMS, ids=lambda s: s.name)
def test_rates_of_the_catalogue_are_within_their_enclosures(system):
    generator = np.random.default_rng(9)
    numbers = {p.symbol: sp.Float(p.value) for p in system.parameters}
    symbols = [q.symbol for q in (*system.states, *system.inputs, *system.disturbances)]
    low = generator.uniform(-1.4, 1.4, (8, len(symbols)))
    high = low + 10 ** generator.uniform(-6, 0, low.shape)
    for rate in system.rates.values():
        expression = rate.xreplace(numbers)
        for at in points(generator, low, high):
            assert missed(expression, low, high, at, symbols) == 0


def test_function_without_an_enclosure_and_other_shapes_are_refused():
    with pytest.raises(DefinitionError, match="'asin' has no proved enclosure"):
        Enclosure([sp.asin(X)], [X])
    with pytest.raises(DefinitionError, match="uses 'y'"):
        Enclosure([X + Y], [X])
    with pytest.raises(SimulationError, match="corners have the shapes"):
        Enclosure([X], [X]).over(np.zeros((3, 1)), np.zeros((3, 2)))


def test_record_of_the_benchmark_has_ten_million_boxes_and_none_that_misses():
    record = json.loads((ROOT / "benchmarks" / "interval_inclusions.json").read_text())
    found = record["operations"]
    assert set(found) == set(OPERATIONS)
    assert len(found) == 27
    assert sum(f["boxes"] for f in found.values()) >= 10_000_000
    assert all(f["outside"] == 0 and f["values"] > 0.4 * f["boxes"] for f in found.values())
    assert DIGITS == 60
