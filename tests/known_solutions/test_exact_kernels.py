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

import holdfast as hf

X, Y, U, W, D, TH = (hf.symbol(n) for n in ("x", "y", "u", "w", "d", "theta"))


def quantities(*names):
    return tuple(hf.Quantity(n, "1") for n in names)


def region(*expressions, reads=("x",)):
    rows = tuple(hf.Inequality(f"c{i}", e) for i, e in enumerate(expressions))
    return hf.Region("K", quantities(*reads), rows)


def within(expression, limit):
    return hf.parse_expression(f"abs({expression}) - {limit}", {str(expression): expression})


def area(value, count=1201):
    """The area of { V > 0 } by its interpolant at many points."""
    sides = [np.linspace(a.low, a.high, count) for a in value.grid.axes]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    cell = math.prod(float(s[1] - s[0]) for s in sides)
    return value.contains(points).sum() * cell


def order_of(errors):
    """The observed order of convergence, each grid twice as fine as the one before."""
    return [math.log2(a / b) for a, b in itertools.pairwise(errors)]


def brake(most=1.0, disturbance=0.5):
    return hf.System(
        "brake", quantities("x", "v"), quantities("u"),
        {"x": hf.symbol("v"), "v": U + D}, disturbances=quantities("d"),
        input_bounds=hf.Box((-most,), (most,)),
        disturbance_bounds=hf.Box((-disturbance,), (disturbance,)),
    )  # fmt: skip


def test_population_of_aubin_converges_to_its_kernel():
    system = hf.System(
        "population", quantities("x", "y"), quantities("u"), {"x": X * Y, "y": U},
        input_bounds=hf.Box((-0.5,), (0.5,)),
    )  # fmt: skip
    between = region(0.2 - X, X - 3)
    errors = []
    for nodes in (51, 101):
        grid = hf.grid(system, {"x": (0.05, 3.15), "y": (-2.2, 2.2)}, nodes)
        found = hf.viability_kernel(system, between, grid, 12.0)
        assert found.dataset.attrs["converged"] == 1
        errors.append(abs(area(found) / 6.051494 - 1))
    assert errors[0] < 0.008
    assert errors[1] < 0.003
    assert order_of(errors)[0] > 1.3


@pytest.mark.parametrize(
    ("scheme", "percent"),
    [
        ("upwind", (-4.0, -2.0, -0.97)),
        ("eno2", (-0.86, -0.34, -0.13)),
        ("eno3", (-0.55, -0.20, -0.068)),
        ("weno5", (-0.46, -0.16, -0.054)),
    ],
)
def test_braking_before_two_walls_against_a_disturbance(scheme, percent):
    """Area (16/3) sqrt(w), w what the brakes have left against the disturbance; its error in %."""
    system, walls = brake(), region(within(X, 1))
    errors = []
    for nodes in (51, 101, 201):
        grid = hf.grid(system, {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}, nodes)
        found = hf.discriminating_kernel(system, walls, grid, 3.0, scheme=scheme)
        errors.append(100 * (area(found) / (16 / 3 * math.sqrt(0.5)) - 1))
    assert errors == pytest.approx(percent, rel=0.06, abs=0.003)


@pytest.mark.parametrize(
    ("dissipation", "kept"), [("local-local", 0.102), ("local", None), ("global", None)]
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


@pytest.mark.parametrize("dissipation", ["global", "local", "local-local"])
def test_every_dissipation_gives_the_braking_kernel(dissipation):
    system, walls = brake(), region(within(X, 1))
    grid = hf.grid(system, {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}, 81)
    found = hf.discriminating_kernel(system, walls, grid, 3.0, dissipation=dissipation)
    assert area(found) / (16 / 3 * math.sqrt(0.5)) == pytest.approx(1, abs=0.006)


def unstable(dimension):
    """x_i' = lambda_i x_i + u_i + d_i: |x_i| <= m + (1 - m) exp(-lambda T), m = w / lambda."""
    names = [f"x{i}" for i in range(dimension)]
    lam = np.array([1.0, 0.5, 1.5, 0.8, 1.2, 0.6])[:dimension]
    most = np.array([0.6, 0.5, 0.8, 0.7, 0.9, 0.5])[:dimension]
    against = np.array([0.1, 0.2, 0.2, 0.3, 0.3, 0.1])[:dimension]
    rates = {
        n: float(k) * hf.symbol(n) + hf.symbol(f"u{i}") + hf.symbol(f"d{i}")
        for i, (n, k) in enumerate(zip(names, lam, strict=True))
    }
    system = hf.System(
        "unstable", quantities(*names), quantities(*(f"u{i}" for i in range(dimension))), rates,
        disturbances=quantities(*(f"d{i}" for i in range(dimension))),
        input_bounds=hf.Box(tuple(-most), tuple(most)),
        disturbance_bounds=hf.Box(tuple(-against), tuple(against)),
    )  # fmt: skip
    rest = (most - against) / lam
    limits = [within(hf.symbol(n), 1) for n in names]
    return (
        system,
        region(*limits, reads=names),
        lambda t: np.where(rest < 1, rest + (1 - rest) * np.exp(-lam * t), 1.0),
    )


@pytest.mark.parametrize(
    ("dimension", "nodes", "scheme", "share"),
    [(1, 41, "weno5", 0.15), (2, 41, "weno5", 0.15), (3, 31, "weno5", 0.5), (4, 17, "weno5", 0.5),
     pytest.param(5, 11, "weno5", 0.5, marks=pytest.mark.heavy), (6, 9, "weno5", 0.5)],
)  # fmt: skip
def test_unstable_lines_in_every_dimension(dimension, nodes, scheme, share):
    """The half-widths of the kernel after a second, within a share of a cell."""
    system, box, exact = unstable(dimension)
    grid = hf.grid(system, dict.fromkeys(system.state_names, (-1.25, 1.25)), nodes)
    found = hf.discriminating_kernel(system, box, grid, 1.0, scheme=scheme)
    for i in range(dimension):
        points = np.zeros((2001, dimension))
        points[:, i] = np.linspace(0, 1.25, 2001)
        reached = points[found.contains(points), i].max()
        assert abs(reached - exact(1.0)[i]) < share * grid.axes[i].step


def test_turning_before_a_wall_in_a_current():
    """K = { y <= h }: safe where y + g(theta) <= h, g the way still gone before the turn is done."""
    speed, rate, current, wall = 1.0, 1.0, 0.5, 0.5
    theta = hf.Quantity("theta", "rad", angle=True)
    system = hf.System(
        "turning", (hf.Quantity("y", "m"), theta), quantities("u"),
        {"y": speed * sp.sin(TH) + current, "theta": rate * U},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    grid = hf.grid(
        system, {"y": (-2.5, 1.0), "theta": (-math.pi, math.pi)}, {"y": 106, "theta": 96},
        ends={"y": "limited"},
    )  # fmt: skip
    found = hf.viability_kernel(system, region(Y - wall, reads=("y",)), grid, 6.0)
    assert found.dataset.attrs["converged"] == 1
    still = -math.asin(current / speed)
    radius = speed / rate
    for angle in np.linspace(-3.1, 3.1, 41):
        turned = angle if angle >= still else angle + 2 * math.pi
        g = 0.0
        if still < turned < math.pi - still:
            right = (
                radius * (math.cos(still) - math.cos(turned)) + current * (turned - still) / rate
            )
            left = radius * (math.cos(turned) + math.cos(still))
            left += current * (math.pi - still - turned) / rate
            g = min(right, left)
        heights = np.linspace(-2.4, 0.99, 1500)
        points = np.stack([heights, np.full(1500, angle)], axis=1)
        top = heights[found.contains(points)].max()
        assert top == pytest.approx(wall - g, abs=0.03)


def test_zermelo_needs_the_least_root_of_his_equation():
    """|x + V T e1| = r + mu T: a boat in a current, to a disc."""
    current, speed, radius = 0.5, 1.0, 0.4
    system = hf.System(
        "boat", quantities("x", "y"), quantities("u", "w"), {"x": current + U, "y": W},
        input_bounds=hf.Ball(sp.Float(speed), 2),
    )  # fmt: skip
    disc = region(sp.sqrt(X**2 + Y**2 + 1e-12) - radius, reads=("x", "y"))
    grid = hf.grid(system, {"x": (-3.5, 2.5), "y": (-2.5, 2.5)}, {"x": 121, "y": 101})
    found = hf.capture_basin(system, disc, None, grid, 1.2, arrival_steps=60)
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
    v = hf.symbol("v")
    system = hf.System(
        "cart", quantities("x", "v"), quantities("u"), {"x": v, "v": U},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    names = {"x": X, "v": v}
    time = hf.parse_expression(
        "v + sqrt(max(4*x + 2*v**2, 0)) if x > -0.5*v*abs(v) else -v + sqrt(max(-4*x + 2*v**2, 0))",
        names,
    )
    near = region(time - 1, reads=("x", "v"))
    medians, worst, lost = [], [], []
    for nodes in (61, 121):
        grid = hf.grid(system, {"x": (-2.5, 2.5), "v": (-2.2, 2.2)}, nodes)
        found = hf.capture_basin(system, near, None, grid, 1.0, arrival_steps=50)
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


@pytest.fixture(scope="module")
def air3d():
    """Pursuit and evasion of two aircraft (I. Mitchell's air3D), 51 x 40 x 50 nodes, 2.8 s."""
    psi, turn, other = (hf.symbol(n) for n in ("psi", "a", "b"))
    states = (*quantities("x", "y"), hf.Quantity("psi", "rad", angle=True))
    system = hf.System(
        "air3d", states, quantities("a"),
        {
            "x": -5 + 5 * sp.cos(psi) + turn * Y,
            "y": 5 * sp.sin(psi) - turn * X,
            "psi": other - turn,
        },
        disturbances=quantities("b"),
        input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    apart = region(5 - sp.sqrt(X**2 + Y**2 + 1e-12), reads=("x", "y"))
    box = {"x": (-6, 20), "y": (-10, 10), "psi": (0, 2 * math.pi)}
    return (
        system,
        apart,
        hf.grid(
            system,
            box,
            {"x": 51, "y": 40, "psi": 50},
            ends={"x": "extrapolated", "y": "extrapolated"},
        ),
    )


def test_barrier_of_two_aircraft(air3d):
    """Points of the left barrier in closed form: retrograde paths from the usable part's edge."""
    system, apart, grid = air3d
    found = hf.discriminating_kernel(system, apart, grid, 2.8)
    worst = []
    for psi0, longest in ((math.pi / 3, 0.5), (math.pi / 2, 0.5), (2.0, 0.5)):
        for tau in np.linspace(0.1, longest, 5):
            i = 1j
            z = np.exp(-i * tau) * (
                5 * np.exp(i * psi0 / 2)
                - i * 5 * (np.exp(i * tau) - 1 + np.exp(i * psi0) * (np.exp(-i * tau) - 1))
            )
            psi = (psi0 - 2 * tau) % (2 * math.pi)
            worst.append(abs(found.at([[z.real, z.imag, psi]])[0]))
    assert max(worst) < 0.12  # a quarter of a cell


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
