"""A grid that ends on a constraint gives the set of a wider one; one that ends before is refused."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import SimulationError

HALF = {"x": 1.0, "v": 1.5}
CELLS = 40


def cart(scale=1.0):
    _x, v, u = (hf.symbol(n) for n in ("x", "v", "u"))
    system = hf.System(
        "cart",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        (hf.Quantity("u", "m/s^2"),),
        {"x": v, "v": u * scale},
        input_bounds=hf.Box((-1,), (1,)),
    )
    rows = [
        hf.Inequality(f"{side}_{q.name}", sign * q.symbol - scale * HALF[q.name], q.unit)
        for q in system.states
        for side, sign in (("low", -1), ("high", 1))
    ]
    return system, hf.Region("box", system.states, tuple(rows))


def box(scale=1.0, more=0.0):
    """The box of the region, wider by so many cells, or less than a cell."""
    return {
        n: tuple(side * scale * half * (1 + 2 * more / CELLS) for side in (-1, 1))
        for n, half in HALF.items()
    }


def kernel(interval, nodes, scale=1.0, **options):
    system, region = cart(scale)
    grid = hf.grid(system, interval, nodes)
    return hf.viability_kernel(system, region, grid, 20.0, **options)


def share(found, scale=1.0):
    return found.volume() / (4 * scale**2 * HALF["x"] * HALF["v"])


@pytest.fixture(scope="module")
def wide():
    return share(kernel(box(more=2), CELLS + 5))


@pytest.mark.few("1.0-3e-13", "1e-06-1e-16", "1e-06--1e-16", "1e-06-3e-13", "1000.0-3e-13")
@pytest.mark.parametrize("off", [0.0, 1e-16, -1e-16, 3e-13])
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e3])
def test_grid_that_ends_on_the_constraints_gives_the_set_of_a_wider_one(wide, off, scale):
    interval = {n: (a * (1 + off), b * (1 - off)) for n, (a, b) in box(scale).items()}
    found = kernel(interval, CELLS + 1, scale)
    assert share(found, scale) == pytest.approx(wide, abs=1e-3)
    assert found.report.converged
    assert not found.report.ends_reached


@pytest.mark.slow("options1")
@pytest.mark.parametrize("options", [{"precision": "float32"}, {"refine": 2}, {"scheme": "upwind"}])
def test_so_it_is_with_every_kind_of_march(options):
    nodes = {"refine": CELLS // 2 + 1}.get(next(iter(options)), CELLS + 1)
    more = {"refine": CELLS // 2 + 3}.get(next(iter(options)), CELLS + 3)
    wider = share(kernel(box(more=2 if "refine" in options else 1), more, **options))
    assert share(kernel(box(), nodes, **options)) == pytest.approx(wider, abs=5e-3)


@pytest.mark.parametrize(("name", "end"), [("x", 0), ("x", 1), ("v", 0), ("v", 1)])
def test_each_end_on_a_constraint_lets_its_loss_in(wide, name, end):
    interval = {n: list(b) for n, b in box(more=2).items()}
    nodes = dict.fromkeys(HALF, CELLS + 5)
    interval[name][end], nodes[name] = box()[name][end], CELLS + 3
    assert share(kernel(interval, nodes)) == pytest.approx(wide, abs=1e-3)


@pytest.mark.parametrize("scheme", ["upwind", "weno5"])
@pytest.mark.parametrize("low", ["0.2 - x**0.5", "1/(x + 0.02) - 1/0.06"])
def test_margin_that_is_no_number_beyond_the_grid_says_nothing_of_what_is_there(low, scheme):
    """x is kept from .04 to 1; the grid ends at 0."""
    states = (hf.Quantity("x"),)
    x, u = hf.symbol("x"), hf.symbol("u")
    system = hf.System(
        "point", states, (hf.Quantity("u"),), {"x": u}, input_bounds=hf.Box((-1,), (1,))
    )
    below = hf.parse_expression(low, {"x": x})
    rows = (hf.Inequality("low", below), hf.Inequality("high", x - 1))
    value = hf.viability_kernel(
        system, hf.Region("between", states, rows), hf.grid(system, {"x": (0, 1.2)}, 61), 5.0,
        scheme=scheme,
    )  # fmt: skip
    assert value.report.converged
    assert value.extent()["x"] == pytest.approx((0.04, 1.0), abs=1e-3)


@pytest.mark.parametrize("scheme", ["upwind", "weno5"])
def test_a_drift_into_the_corner_of_two_constraints_empties_the_set(scheme):
    """x' = u, v' = 1.2 u + 0.4: v - 1.2 x grows at 0.4 and is between -2.7 and 2.7 in the box."""
    states = cart()[0].states
    u = hf.symbol("u")
    rates = {"x": u, "v": 1.2 * u + 0.4}
    system = hf.System(
        "drift", states, (hf.Quantity("u"),), rates, input_bounds=hf.Box((-1,), (1,))
    )
    found = hf.viability_kernel(system, cart()[1], hf.grid(system, box(), 21), 30.0, scheme=scheme)
    assert found.report.empty
    assert found.report.converged


def test_grid_that_ends_before_the_constraint_is_refused_with_the_width_to_take():
    interval = box() | {"x": (-1.0 + 0.5 * 2 / CELLS, 1.0)}
    with pytest.raises(SimulationError, match=r"widen it to x = -1\.0") as refused:
        kernel(interval, CELLS + 1)
    place = float(str(refused.value).split("widen it to x = ")[1].split(",")[0])
    found = kernel(box() | {"x": (place, 1.0)}, CELLS + 1)
    assert 0.8 < share(found) < 0.83


def test_basin_whose_target_ends_with_the_grid_is_that_of_a_wider_grid():
    """x' = u to |x| < 1/2 within 1/2 s: |x| < 1."""
    x, u = hf.symbol("x"), hf.symbol("u")
    states = (hf.Quantity("x", "m"),)
    line = hf.System(
        "line", states, (hf.Quantity("u"),), {"x": u}, input_bounds=hf.Box((-1,), (1,))
    )
    near = hf.Region("near", states, (hf.Inequality("far", abs(x) - 0.5, "m"),))
    for high, nodes in ((0.5, 81), (0.75, 91)):
        grid = hf.grid(line, {"x": (-1.5, high)}, nodes, {"x": "extrapolated"})
        found = hf.backward_reachable_tube(line, near, grid, 0.5)
        inside = np.linspace(-1.49, 0.49, 199)
        assert found.contains(inside[:, None]).mean() == pytest.approx(149 / 199, abs=0.02)


@pytest.mark.heavy
@pytest.mark.parametrize(("fastest", "ends"), [(0.8, "v = -0.8, v = 0.8"), (1.2, "")])
def test_set_depends_on_nothing_beyond_an_end_that_nothing_leads_out_of(fastest, ends):
    """A cart x' = v, v' = u + d - v |v| with |u| <= 1, |d| <= 0.1: v = 1.05 is its greatest speed."""
    x, v, u, d = (hf.symbol(n) for n in ("x", "v", "u", "d"))
    system = hf.System(
        "cart in water",
        (hf.Quantity("x"), hf.Quantity("v")),
        (hf.Quantity("u"),),
        {"x": v, "v": u + d - v * abs(v)},
        disturbances=(hf.Quantity("d"),),
        input_bounds=hf.Box((-1,), (1,)),
        disturbance_bounds=hf.Box((-0.1,), (0.1,)),
    )
    walls = hf.Region("walls", system.states, (hf.Inequality("far", abs(x) - 1),))
    grid = hf.grid(system, {"x": (-1.1, 1.1), "v": (-fastest, fastest)}, 61)
    found = hf.discriminating_kernel(system, walls, grid, 10.0)
    assert found.contains([[0.0, fastest]])[0], "the set is there at the end"
    assert found.report.ends_reached == ends
    promise = hf.check_promise(system, found, walls, runs=50)
    assert promise.held
    assert promise.confirmed is not bool(ends)


def test_what_leads_out_of_an_end_is_not_judged_where_it_depends_on_time():
    """v' = (u - v |v|) t, |u| <= 1: never out of |v| <= 1.2, but it was looked at one instant only."""
    x, v, u = (hf.symbol(n) for n in ("x", "v", "u"))
    system = hf.System(
        "cart in water that thickens",
        (hf.Quantity("x"), hf.Quantity("v")),
        (hf.Quantity("u"),),
        {"x": v, "v": (u - v * abs(v)) * hf.TIME},
        input_bounds=hf.Box((-1,), (1,)),
    )
    walls = hf.Region("walls", system.states, (hf.Inequality("far", abs(x) - 1),))
    grid = hf.grid(system, {"x": (-1.1, 1.1), "v": (-1.2, 1.2)}, 21)
    found = hf.viability_kernel(system, walls, grid, 0.3, scheme="upwind")
    assert found.report.ends_reached == "v = -1.2, v = 1.2"


@pytest.mark.parametrize("rate", ["u/2 - x", "u/2 + x"])
def test_what_a_forward_set_has_beyond_the_grid_is_said_whether_it_flows_in_or_out(rate):
    x, u = hf.symbol("x"), hf.symbol("u")
    states = (hf.Quantity("x"),)
    rates = {"x": hf.parse_expression(rate, {"x": x, "u": u})}
    line = hf.System("line", states, (hf.Quantity("u"),), rates, input_bounds=hf.Box((-1,), (1,)))
    start = hf.Region("start", states, (hf.Inequality("far", abs(x) - 1),))
    grid = hf.grid(line, {"x": (-0.8, 0.8)}, 41, {"x": "extrapolated"})
    found = hf.forward_reachable_set(line, start, grid, 0.1)
    assert found.report.ends_reached == "x = -0.8, x = 0.8"
