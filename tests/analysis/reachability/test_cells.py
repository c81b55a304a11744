"""Volumes of sets between the nodes, and the questions that are asked of a set at a time."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.reachability.value_function import share_inside
from holdfast.errors import SimulationError

X, Y, A, B = (hf.symbol(n) for n in ("x", "y", "a", "b"))


def over(nodes, dimension, half=1.3):
    axis = np.linspace(-half, half, nodes)
    return np.meshgrid(*[axis] * dimension, indexing="ij", sparse=True)


def ball(nodes, dimension):
    places = over(nodes, dimension)
    inside = 1.0 - np.sqrt(sum(p**2 for p in places))
    exact = math.pi ** (dimension / 2) / math.gamma(dimension / 2 + 1)
    return share_inside(inside, [False] * dimension) * 2.6**dimension / exact


@pytest.mark.parametrize(("dimension", "nodes"), [(2, 15), (3, 15), (4, 13)])
def test_volume_of_a_ball_is_off_by_the_square_of_the_step(dimension, nodes):
    for count in (nodes, 2 * nodes - 1):
        step = 2.6 / (count - 1)
        assert abs(ball(count, dimension) - 1) < 0.2 * step**2


def test_volume_of_a_product_of_lines_in_four_dimensions():
    """|x_i| <= m_i on 29^4 nodes: the count of nodes is 6 % off, the volume 1 %."""
    half = np.array([0.8765, 0.8765, 0.91, 0.8765])
    places = over(29, 4, 1.25)
    table = np.minimum.reduce(
        np.broadcast_arrays(*(m - np.abs(p) for m, p in zip(half, places, strict=True)))
    )
    exact = math.prod(2 * half)
    assert share_inside(table, [False] * 4) * 2.5**4 == pytest.approx(exact, rel=0.01)
    assert abs((table > 0).sum() * (2.5 / 28) ** 4 / exact - 1) > 0.05


def test_boundary_across_an_axis_is_exact_and_a_periodic_axis_has_no_ends():
    assert share_inside(np.linspace(-1.0, 2.0, 7), [False]) == pytest.approx(2 / 3, abs=1e-15)
    around = np.cos(np.linspace(0, 2 * np.pi, 40, endpoint=False))
    assert share_inside(around, [True]) == pytest.approx(0.5, abs=1e-12)
    assert share_inside(np.full((5, 5), -1.0), [False, True]) == 0.0
    assert share_inside(np.full((5, 5), 1.0), [False, True]) == 1.0


def test_many_nodes_are_looked_at_in_blocks_with_the_same_sum(monkeypatch):
    table = np.random.default_rng(0).normal(size=(6, 7, 8))
    whole = share_inside(table, [True, False, True])
    monkeypatch.setattr("holdfast.analysis.reachability.value_function.TOGETHER", 20)
    assert share_inside(table, [True, False, True]) == pytest.approx(whole, abs=1e-14)


@pytest.fixture(scope="module")
def basin():
    """A boat of 1 m/s on its way to a disc of radius 0.5 m, within 1 s."""
    plane = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
    boat = hf.System(
        "boat", plane, (hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s")), {"x": A, "y": B},
        input_bounds=hf.Ball(1.0, 2),
    )  # fmt: skip
    disc = hf.Region("disc", plane, (hf.Inequality("far", sp.sqrt(X**2 + Y**2) - 0.5, "m"),))
    grid = hf.grid(boat, {"x": (-2, 2), "y": (-2, 2)}, 41)
    return hf.capture_basin(boat, disc, None, grid, 1.0, times=[0.5, 1.0], arrival_steps=50)


def test_least_time_to_the_goal_is_the_way_at_full_speed(basin):
    angles = np.linspace(0, 6, 13)
    for distance in (0.7, 1.0, 1.3):
        states = distance * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        assert basin.least_time(states) == pytest.approx(distance - 0.5, abs=0.04)
    assert basin.least_time([[0.1, 0.0]])[0] == 0.0
    assert np.isnan(basin.least_time([[1.8, 0.0], [5.0, 0.0]])).all()


def test_set_at_a_time_contains_what_has_that_long_to_go(basin):
    states = [[0.8, 0.0], [1.2, 0.0]]
    assert basin.contains(states, time=0.5).tolist() == [True, False]
    assert basin.contains(states).tolist() == [True, True]


def test_least_time_of_what_has_none_is_refused(basin):
    with pytest.raises(SimulationError, match="has no least times; expected a capture basin"):
        basin.slice(y=0.0).least_time([[0.7]])
