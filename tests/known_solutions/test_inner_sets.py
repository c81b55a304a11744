"""The inner set of a value function: no state of it is lost, on problems whose kernels are known."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ScenarioError, SimulationError
from holdfast.scenario.load import load_scenario
from tests import carts
from tests.carts import STATES, WALLS, U, V, X

COUNT = 20_000


def line(nodes):
    """x' = 2x + u/2, |u| <= 1: |x| <= 1/4 can be held; V jumps there."""
    system = hf.System(
        "line", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": 2 * X + U / 2},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    grid = hf.grid(system, {"x": (-1.2, 1.2)}, nodes)
    value = hf.viability_kernel(system, WALLS, grid, 20, scheme="upwind", estimate_error=True)
    states = np.random.default_rng(0).uniform(-1, 1, (COUNT, 1))
    return value, states, np.abs(states[:, 0]) <= 0.25


def cart(nodes):
    """x'' = u + d brakes at 1/2 before both walls."""
    system = carts.cart()
    grid = hf.grid(system, carts.BOX, nodes)
    value = hf.discriminating_kernel(system, WALLS, grid, 6, estimate_error=True)
    x, v = np.random.default_rng(0).uniform((-1, -1.8), (1, 1.8), (COUNT, 2)).T
    return value, np.stack([x, v], axis=1), (v <= np.sqrt(1 - x)) & (v >= -np.sqrt(1 + x))


def population(nodes):
    """x' = x y, y' = u (Aubin and Saint-Pierre)."""
    system = hf.System(
        "population", (hf.Quantity("x"), hf.Quantity("v")), (hf.Quantity("u"),), {"x": X * V, "v": U},
        input_bounds=hf.Box((-0.5,), (0.5,)),
    )  # fmt: skip
    region = hf.Region("size", STATES[:1], (
        hf.Inequality("least", 0.2 - X, "m"), hf.Inequality("most", X - 3, "m"),
    ))  # fmt: skip
    grid = hf.grid(system, {"x": (0.06, 3.14), "v": (-2.2, 2.2)}, nodes)
    value = hf.viability_kernel(system, region, grid, 10, scheme="upwind", estimate_error=True)
    x, v = np.random.default_rng(0).uniform((0.2, -2), (3, 2), (COUNT, 2)).T
    exact = (v <= np.sqrt(np.log(3 / x))) & (v >= -np.sqrt(np.log(x / 0.2)))
    return value, np.stack([x, v], axis=1), exact


def lake(nodes):
    """Phosphorus P' = -0.8 P + L + P^8/(1 + P^8) <= 1.4 of a load L >= 0.1 that falls by 0.09."""
    load, mass = hf.symbol("L"), hf.symbol("P")
    states = (hf.Quantity("L", "1"), hf.Quantity("P", "1"))
    system = hf.System(
        "lake", states, (hf.Quantity("u", "1"),),
        {"L": U, "P": -0.8 * mass + load + mass**8 / (1 + mass**8)},
        input_bounds=hf.Box((-0.09,), (0.09,)),
    )  # fmt: skip
    region = hf.Region("clear", states, (
        hf.Inequality("less_load", 0.1 - load), hf.Inequality("more_load", load - 1),
        hf.Inequality("less", -mass), hf.Inequality("more", mass - 1.4),
    ))  # fmt: skip
    grid = hf.grid(system, {"L": (0.0, 1.1), "P": (-0.1, 1.5)}, nodes)
    value = hf.viability_kernel(system, region, grid, 60, scheme="upwind", estimate_error=True)
    start = np.random.default_rng(0).uniform((0.1, 0), (1, 1.4), (COUNT, 2))
    a, p = start.T
    exact, step = np.ones(COUNT, dtype=bool), 0.02

    def rate(a, p):
        return -0.8 * p + a + p**8 / (1 + p**8)

    for _ in range(3000):  # the load falls as fast as it can: P is least in all ways at once
        then = np.maximum(a - 0.09 * step, 0.1)
        k1 = rate(a, p)
        k2 = rate((a + then) / 2, p + step / 2 * k1)
        a, p = then, np.minimum(p + step * k2, 3.0)
        exact &= p <= 1.4
    return value, start, exact


def test_set_that_a_jump_of_the_value_bounds_may_be_too_large():
    """0.25 can be held: the zero of V is between the nodes at 0.225 and 0.3."""
    value, _, _ = line(33)
    assert value.extent()["x"] == pytest.approx((-0.269, 0.269), abs=5e-4)


@pytest.mark.few("line-33-0.064-0.48", "line-65-0.0-0.55", "cart-41-0.0-0.81")
@pytest.mark.parametrize(
    ("problem", "nodes", "false", "share"),
    [
        (line, 33, 0.064, 0.48),
        (line, 65, 0.0, 0.55),
        pytest.param(line, 201, 0.0, 0.86, marks=pytest.mark.heavy),
        (lake, 41, 0.0069, 0.23),
        pytest.param(lake, 81, 0.0071, 0.65, marks=pytest.mark.heavy),
        (population, 41, 0.006, 0.49),
        pytest.param(population, 81, 0.0039, 0.73, marks=pytest.mark.heavy),
        (cart, 41, 0.0, 0.81),
    ],
)
def test_no_state_of_an_inner_set_is_lost(problem, nodes, false, share):
    """false: the part of the set itself that is; share: the part of the exact set that is inner."""
    value, states, exact = problem(nodes)
    claimed, inner = value.contains(states), value.inner().contains(states)
    assert (claimed & ~exact).sum() / claimed.sum() == pytest.approx(false, abs=5e-4)
    assert not (inner & ~exact).any()
    assert not (inner & ~claimed).any()
    assert (inner & exact).sum() / exact.sum() == pytest.approx(share, abs=0.01)


def unstable(bounds, size):
    """x' = x + u, y' = y + w in the square of 4 m; of its exact kernel the size is 1 m at most.

    V jumps at its boundary."""
    y, w = hf.symbol("y"), hf.symbol("w")
    states = (hf.Quantity("x"), hf.Quantity("y"))
    system = hf.System(
        "unstable", states, (hf.Quantity("u"), hf.Quantity("w")),
        {"x": X + U, "y": y + w}, input_bounds=bounds,
    )  # fmt: skip
    sides = {"east": X - 2, "west": -2 - X, "north": y - 2, "south": -2 - y}
    square = hf.Region("square", states, tuple(hf.Inequality(n, e) for n, e in sides.items()))
    start = np.random.default_rng(0).uniform(-2, 2, (COUNT, 2))

    def value(nodes, **options):
        grid = hf.grid(system, {"x": (-2.3, 2.3), "y": (-2.3, 2.3)}, nodes)
        return hf.viability_kernel(system, square, grid, 20, estimate_error=True, **options)

    return value, start, size(start)


DISC = unstable(hf.Ball(1.0, 2), lambda q: np.hypot(*q.T))
BOX = unstable(hf.Box((-1, -1), (1, 1)), lambda q: np.abs(q).max(axis=1))


@pytest.mark.few("problem1-options1-shares1")
@pytest.mark.parametrize(
    ("problem", "options", "shares"),
    [
        (DISC, {}, {41: 0.53, 81: 0.72}),
        (BOX, {}, {41: 0.44, 81: 0.80}),
        *(
            pytest.param(*case, marks=pytest.mark.heavy)
            for case in (
                (DISC, {"scheme": "eno2"}, {41: 0.33, 81: 0.59}),
                (DISC, {"scheme": "eno3"}, {41: 0.52, 81: 0.58}),
                (DISC, {"scheme": "upwind"}, {41: 0.52, 81: 0.57, 161: 0.84}),
                (DISC, {"dissipation": "global"}, {41: 0.52, 81: 0.56}),
                (BOX, {"scheme": "upwind"}, {41: 0.44, 81: 0.81, 161: 0.83}),
                (DISC, {}, {161: 0.85, 321: 0.92}),
                (BOX, {}, {161: 0.88, 321: 0.95}),
            )
        ),
    ],
)
def test_inner_set_of_an_unstable_system_tends_to_the_exact_set(problem, options, shares):
    """Its boundary itself is within a cell; the error is told in cells and in metres."""
    kernel, states, size = problem
    exact = size <= 1
    for nodes, share in shares.items():
        value = kernel(nodes, **options)
        report, step = value.report, 4.6 / (nodes - 1)
        assert report.jumps
        assert report.boundary_error == pytest.approx(
            dict.fromkeys("xy", report.error_reach * step)
        )
        assert report.error_cells == report.error_reach
        claimed = value.contains(states)
        assert -0.6 < (size[claimed].max() - 1) / step < 0.4
        assert -0.8 < (size[~claimed].min() - 1) / step < 0.15
        inner = value.inner().contains(states)
        assert not (inner & ~exact).any()
        assert (inner & exact).sum() / exact.sum() == pytest.approx(share, abs=0.02)


@pytest.mark.heavy
def test_value_that_does_not_jump_is_not_said_to():
    """On the coarser grid that of the population falls to where it is cut off in four cells."""
    assert not cart(41)[0].report.jumps
    assert not population(321)[0].report.jumps
    assert population(81)[0].report.jumps


@pytest.mark.few("global-41-0.0")
@pytest.mark.parametrize(
    ("dissipation", "nodes", "share"),
    [
        ("local", 81, 0.91),
        ("global", 41, 0.0),
        *(
            pytest.param(*case, marks=pytest.mark.heavy)
            for case in (
                ("local", 161, 0.91), ("local", 321, 0.94), ("global", 81, 0.0), ("global", 321, 0.90)
            )
        ),
    ],
)  # fmt: skip
def test_dissipation_that_wears_a_set_away_leaves_none_that_is_too_large(dissipation, nodes, share):
    kernel, states, size = DISC
    value, exact = kernel(nodes, scheme="upwind", dissipation=dissipation), size <= 1
    claimed, inner = value.contains(states), value.inner().contains(states)
    assert not (inner & ~exact).any()
    assert claimed[exact].mean() == pytest.approx(share, abs=0.01)


def test_set_of_two_grids_that_have_nothing_in_common_has_no_inner_set():
    value = DISC[0](41, scheme="upwind", dissipation="local")
    assert value.report.boundary_error == {}
    with pytest.raises(SimulationError, match="exceeds 20 cells"):
        value.inner()


def test_grids_that_have_nothing_in_common_have_no_inner_set():
    value = line(33)[0]
    apart = hf.ValueFunction(value.dataset.assign_attrs(error_reach=0), value.grid)
    with pytest.raises(SimulationError, match="estimated error of the set exceeds 20 cells"):
        apart.inner()


def test_inner_set_needs_an_estimate_of_the_error():
    value = line(65)[0]
    bare = hf.ValueFunction(value.dataset.drop_attrs().assign_attrs(cell=0.1), value.grid)
    with pytest.raises(SimulationError, match="estimate_error=True"):
        bare.inner()


LINE = """
[scenario]
title = "a line"
kind = "viability-kernel"
[system]
states = { x = { unit = "m" } }
inputs = { u = { unit = "m/s", bounds = [-1, 1] } }
rates = { x = "2*x + 0.5*u" }
[region]
constraints = { left = { expression = "-1 - x", unit = "m" }, right = { expression = "x - 1", unit = "m" } }
[grid]
nodes = 65
box = { x = [-1.2, 1.2] }
[march]
horizon = 20
scheme = "upwind"
inner = true
[promise]
runs = 40
horizon = 5
sample_time = "2 ms"
"""


@pytest.mark.heavy
def test_promise_checks_the_inner_set_of_a_scenario(tmp_path):
    path = tmp_path / "line.toml"
    path.write_text(LINE)
    found = load_scenario(str(path)).run()
    assert found.value.dataset.attrs["inner_cells"] == 3
    assert found.value.extent()["x"][1] < 0.25
    assert found.promise.held
    with pytest.raises(ScenarioError, match=r"march\.inner: there is no estimate"):
        load_scenario(str(path), ["march.estimate_error=false"])
