"""Kernels, reachable sets and least times whose exact form is known, on grids of several sizes.

A1 is the population of J.-P. Aubin and P. Saint-Pierre; A2 a vehicle that brakes before two walls;
A4 unstable lines, whose products are exact in any dimension; A5 a vehicle that turns before a wall
in a current; A6 Zermelo's navigation; A7 the double integrator (M. Athans, P. Falb, 7-26).
"""

import itertools
import math

import numpy as np
import pytest
import sympy as sp
from exact import (
    aircraft,
    braking,
    double_integrator_by_time,
    population,
    quantities,
    region,
    turning,
    unstable,
    zermelo,
)

import holdfast as hf

X, U, D = (hf.symbol(n) for n in ("x", "u", "d"))


def within(expression, limit):
    return hf.parse_expression(f"abs({expression}) - {limit}", {str(expression): expression})


def found_on(problem, grid, horizon=None, **options):
    """The set of a problem on a grid of the test's own."""
    seconds = problem.horizon if horizon is None else horizon
    return problem.find(problem.system, *problem.regions, grid, seconds, **options)


def area(value, count=1201):
    """The area of { V > 0 } by its interpolant at many points."""
    sides = [np.linspace(a.low, a.high, count) for a in value.grid.axes]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    cell = math.prod(float(s[1] - s[0]) for s in sides)
    return value.contains(points).sum() * cell


def order_of(errors):
    """The observed order of convergence, each grid twice as fine as the one before."""
    return [math.log2(a / b) for a, b in itertools.pairwise(errors)]


def test_population_of_aubin_converges_to_its_kernel():
    problem = population()
    errors = []
    for nodes in (51, 101):
        found = found_on(problem, hf.grid(problem.system, problem.box, nodes))
        assert found.dataset.attrs["converged"] == 1
        errors.append(abs(area(found) / problem.volume - 1))
    assert errors[0] < 0.010  # 0.0095: a cell is trimmed at the tips
    assert errors[1] < 0.0034  # the same, of cells half as large
    assert order_of(errors)[0] > 1.3


@pytest.mark.few("upwind-percent0")
@pytest.mark.parametrize(
    ("scheme", "percent"),
    [
        ("upwind", (-4.0, -2.0, -0.97)),
        ("eno2", (-0.86, -0.34, -0.13)),
        pytest.param("eno3", (-0.55, -0.20, -0.068), marks=pytest.mark.heavy),
        pytest.param("weno5", (-0.46, -0.16, -0.054), marks=pytest.mark.heavy),
    ],
)
def test_braking_before_two_walls_against_a_disturbance(scheme, percent):
    """Area (16/3) sqrt(w), w what the brakes have left against the disturbance; its error in %."""
    problem = braking()
    errors = []
    for nodes in (51, 101, 201):
        grid = hf.grid(problem.system, problem.box, nodes)
        found = found_on(problem, grid, 3.0, scheme=scheme)
        errors.append(100 * (area(found) / problem.volume - 1))
    assert errors == pytest.approx(percent, rel=0.06, abs=0.003)


@pytest.mark.few("global-None")
@pytest.mark.parametrize(
    ("dissipation", "kept"), [("local-local", 0.108), ("local", None), ("global", None)]
)
def test_speeds_that_two_slopes_allow_leave_a_kernel_where_two_players_nearly_balance(
    dissipation, kept
):
    """x' = x + u + d, |u| <= 0.6, |d| <= 0.5: |x| <= 0.1 can be held for ever."""
    system = hf.System(
        "line", quantities("x"), quantities("u"), {"x": X + U + D}, disturbances=quantities("d"),
        input_bounds=hf.Box((-0.6,), (0.6,)), disturbance_bounds=hf.Box((-0.5,), (0.5,)),
    )  # fmt: skip
    grid = hf.grid(system, {"x": (-1.2, 1.2)}, 101)
    found = hf.discriminating_kernel(
        system, region(within(X, 1)), grid, 60.0, dissipation=dissipation
    )
    if kept is None:
        assert found.dataset.attrs["empty"]
    else:
        assert found.dataset.attrs["converged"]
        assert found.extent()["x"] == pytest.approx((-kept, kept), abs=0.001)


@pytest.mark.few("local")
@pytest.mark.parametrize("dissipation", ["global", "local", "local-local"])
def test_every_dissipation_gives_the_braking_kernel(dissipation):
    problem = braking()
    found = found_on(
        problem, hf.grid(problem.system, problem.box, 81), 3.0, dissipation=dissipation
    )
    assert area(found) / problem.volume == pytest.approx(1, abs=0.006)


@pytest.mark.few("1-41-weno5-0.15", "2-41-weno5-0.15")
@pytest.mark.parametrize(
    ("dimension", "nodes", "scheme", "share"),
    [(1, 41, "weno5", 0.15), (2, 41, "weno5", 0.15), (3, 31, "weno5", 0.5), (4, 17, "weno5", 0.5),
     pytest.param(5, 11, "weno5", 0.5, marks=pytest.mark.heavy),
     pytest.param(6, 9, "weno5", 0.5, marks=pytest.mark.heavy)],
)  # fmt: skip
def test_unstable_lines_in_every_dimension(dimension, nodes, scheme, share):
    """The half-widths of the kernel after a second, within a share of a cell."""
    problem = unstable(dimension, nodes, 1)
    grid = hf.grid(problem.system, problem.box, nodes)
    found = found_on(problem, grid, scheme=scheme)
    exact = np.abs(problem.points).max(axis=0)
    for i in range(dimension):
        points = np.zeros((2001, dimension))
        points[:, i] = np.linspace(0, 1.25, 2001)
        reached = points[found.contains(points), i].max()
        assert abs(reached - exact[i]) < share * grid.axes[i].step


def test_turning_before_a_wall_in_a_current():
    """K = { y <= h }: safe where y + g(theta) <= h, g the way still gone before the turn is done."""
    problem = turning()
    grid = hf.grid(problem.system, problem.box, {"y": 106, "theta": 96}, problem.ends)
    found = found_on(problem, grid)
    assert found.dataset.attrs["converged"] == 1
    for angle in np.linspace(-3.1, 3.1, 41):
        heights = np.linspace(-2.4, 0.99, 1500)
        points = np.stack([heights, np.full(1500, angle)], axis=1)
        top = heights[found.contains(points)].max()
        assert top == pytest.approx(float(problem.value(0.0, np.array(angle))), abs=0.03)


def test_zermelo_needs_the_least_root_of_his_equation():
    """|x + V T e1| = r + mu T: a boat in a current, to a disc."""
    current, speed, radius = 0.5, 1.0, 0.4
    problem = zermelo()
    grid = hf.grid(problem.system, problem.box, {"x": 121, "y": 101})
    found = found_on(problem, grid, arrival_steps=60)
    arrival = found.dataset["arrival"].values
    x, y = np.meshgrid(*(a.nodes for a in grid.axes), indexing="ij")
    # (x + V T)^2 + y^2 = (r + mu T)^2
    a = speed**2 - current**2
    b = speed * radius - current * x
    root = (-b + np.sqrt(np.maximum(b**2 + a * (x**2 + y**2 - radius**2), 0))) / a
    exact = np.where(x**2 + y**2 <= radius**2, 0.0, root)
    reached = exact < 1.1
    assert np.isfinite(arrival[reached]).all()
    assert np.abs(arrival - exact)[reached].max() < 0.02
    assert not np.isfinite(arrival[exact > 1.25]).any()


def test_double_integrator_needs_the_least_time_of_athans_and_falb():
    """From the states within a second of rest at the origin: the times are those, less a second."""
    problem = double_integrator_by_time()
    medians, worst, lost = [], [], []
    for nodes in (61, 121):
        grid = hf.grid(problem.system, problem.box, nodes)
        found = found_on(problem, grid, arrival_steps=50)
        arrival = found.dataset["arrival"].values
        x, y = np.meshgrid(*(a.nodes for a in grid.axes), indexing="ij")
        side = np.where(x > -0.5 * y * np.abs(y), 1.0, -1.0)
        exact = side * y + np.sqrt(np.maximum(4 * side * x + 2 * y**2, 0)) - 1
        reached = (exact > 0.02) & (exact < 0.9)
        gap = np.abs(arrival - exact)[reached]
        medians.append(np.nanmedian(gap))
        worst.append(np.nanquantile(gap, 0.99))
        lost.append(np.isnan(gap).mean())
        assert medians[-1] < grid.axes[0].step
        # a cell beside the switching curve the least time is later by a square root
        assert worst[-1] < math.sqrt(4 * grid.axes[0].step)
    assert order_of(medians)[0] > 0.8
    assert order_of(worst)[0] > 0.5
    assert order_of(lost)[0] > 1


@pytest.mark.heavy
def test_barrier_of_two_aircraft():
    """Points of the left barrier of air3D in closed form, 51 x 40 x 50 nodes, 2.8 s."""
    problem = aircraft()
    grid = hf.grid(problem.system, problem.box, {"x": 51, "y": 40, "psi": 50}, problem.ends)
    found = found_on(problem, grid)
    assert np.abs(found.at(problem.points)).max() < 0.12  # a quarter of a cell


@pytest.mark.slow("40-upwind", "40-eno2", "40-eno3", "81-eno2")
@pytest.mark.parametrize("scheme", ["upwind", "eno2", "eno3", "weno5"])
@pytest.mark.parametrize("nodes", [40, 80, 81])
def test_ridge_between_the_nodes_falls_as_one_on_a_node_does(scheme, nodes):
    """x' = u, |u| <= 2, y' = -1, above the wedge y = |x| for 1 s: exactly y > max(|x|, 1).

    The margin has its ridge at x = 0, on a node (81) or between two (80): high-order differences
    alone see a summit between the nodes there, and call the whole wedge a kernel.
    """
    x, y, u = (hf.symbol(n) for n in "xyu")
    states = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
    falling = hf.System(
        "falling", states, (hf.Quantity("u", "m/s"),), {"x": u, "y": sp.Integer(-1)},
        input_bounds=hf.Box((-2,), (2,)),
    )  # fmt: skip
    wedge = hf.Region(
        "wedge", states, (hf.Inequality("right", x - y, "m"), hf.Inequality("left", -x - y, "m"))
    )
    ends = {"x": "extrapolated", "y": "extrapolated"}
    grid = hf.grid(falling, {"x": (-2, 2), "y": (-1, 3)}, nodes, ends)
    found = hf.viability_kernel(falling, wedge, grid, 1.0, scheme=scheme)
    cell = grid.axes[0].step
    for at, exact in ((0.0, 1.0), (0.3, 1.0), (-0.9, 1.0), (1.4, 1.4), (-1.7, 1.7)):
        assert not found.contains([[at, exact - 0.3 * cell]])[0], (at, exact)
        assert found.contains([[at, exact + 1.1 * cell]])[0], (at, exact)


@pytest.mark.slow("weno5-56", "weno5-221", "eno3-56")
@pytest.mark.parametrize("nodes", [56, 111, 221])
@pytest.mark.parametrize("scheme", ["weno5", "eno3"])
def test_a_parabola_that_is_carried_against_a_disturbance_ends_where_the_way_does(scheme, nodes):
    """Its second difference is large: steps of first order would end up to five cells early."""
    drag, thrust, low, gust, width, middle = -1.13, 1.03, -0.442, 0.0571, 0.2652, -0.357
    system = hf.System(
        "drag", (hf.Quantity("x"),), (hf.Quantity("u"),),
        {"x": drag * X * abs(X) + thrust * U + D},
        input_bounds=hf.Box((low,), (0.591,)),
        disturbances=(hf.Quantity("d"),), disturbance_bounds=hf.Box((-0.0673,), (gust,)),
    )  # fmt: skip
    goal = region(((X - middle) / width) ** 2 - 1)
    walls = region(within(X, 0.663))
    grid = hf.grid(system, {"x": (-0.962, 0.962)}, nodes=nodes)
    value = hf.capture_basin(system, goal, walls, grid, 1.31, scheme=scheme)
    end, step = middle + width, 1e-4
    for _ in range(13100):  # back along the way of the worst disturbance
        end -= step * (drag * end * abs(end) + thrust * low + gust)
    reached = grid.axes[0].nodes[value.values() > 0].max()
    assert -0.05 < (end - reached) / grid.axes[0].step < 1.0


def test_forward_set_of_a_surge_ends_a_part_of_a_cell_beyond_what_is_reached():
    """An inner approximation leaves out what is thin; its ends are those of the scheme."""
    drag, mass, force = 0.95 * X + 6.04 * X * abs(X), 7.34, 10
    system = hf.System(
        "surge", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": (U - drag) / mass},
        input_bounds=hf.Box((-force,), (force,)),
    )  # fmt: skip
    grid = hf.grid(system, {"x": (-1.6, 1.6)}, 41, {"x": "extrapolated"})
    value = hf.forward_reachable_set(system, region(within(X, 0.3)), grid, 8.0)
    fastest = (-0.95 + math.sqrt(0.95**2 + 4 * 6.04 * force)) / (2 * 6.04)
    beyond = (value.extent()["x"][1] - fastest) / grid.axes[0].step
    assert beyond == pytest.approx(0.05, abs=0.02)
