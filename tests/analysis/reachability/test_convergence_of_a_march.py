"""When a march may say that it has converged, and what it refuses."""

import math

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import quad

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast.maths.definitions.quantity import TIME

X, Y, U, A, B = (hf.symbol(n) for n in ("x", "y", "u", "a", "b"))
DAY = 86400.0


def line(rate, most=1.0, parameters=(), samples=0):
    return hf.System(
        "line", (hf.Quantity("x", "m"),), (hf.Quantity("u", "1"),), {"x": rate},
        parameters=parameters, input_bounds=hf.Box((-most,), (most,)), samples=samples,
        empirical="rates are numbers",
    )  # fmt: skip


GROWTH = hf.Parameter("growth", "1/s", value=0.0)
PUSH, DRIFT = (hf.Parameter(n, "m/s", value=0.0) for n in ("push", "drift"))
AFFINE = line(GROWTH.symbol * X + PUSH.symbol * U + DRIFT.symbol, 1.0, (GROWTH, PUSH, DRIFT))
WALLS = hf.Region(
    "walls", (hf.Quantity("x", "m"),),
    (hf.Inequality("left", -1 - X, "m"), hf.Inequality("right", X - 1, "m")),
)  # fmt: skip


def kernel(horizon, growth=0.0, push=0.0, drift=0.0, nodes=101, **options):
    """x' = growth x + push u + drift, |u| <= 1, within |x| <= 1."""
    grid = hf.grid(AFFINE, {"x": (-1.2, 1.2)}, nodes)
    values = {"growth": growth, "push": push, "drift": drift}
    return hf.viability_kernel(AFFINE, WALLS, grid, horizon, parameters=values, **options)


def test_vessel_that_a_current_carries_away_is_lost_whatever_the_size_of_the_sea():
    """0.3 m/s of thrust against 0.8 m/s, 100 km of sea: nothing lasts for 2.4 days."""
    vessel = hf.System(
        "vessel", (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s")), {"x": A + 0.8, "y": B},
        input_bounds=hf.Box((-0.3, -0.3), (0.3, 0.3)),
    )  # fmt: skip
    sides = (
        hf.Inequality("east", sp.Abs(X) - 50_000, "m"),
        hf.Inequality("north", sp.Abs(Y) - 50_000, "m"),
    )
    sea = hf.Region("sea", vessel.states, sides)
    grid = hf.grid(vessel, {"x": (-55e3, 55e3), "y": (-55e3, 55e3)}, 101)
    found = hf.viability_kernel(vessel, sea, grid, 7 * DAY, estimate_error=True)
    said = found.dataset.attrs
    assert said["empty"]
    assert said["converged"]
    assert said["residual_cells"] == 0
    assert said["reached_s"] == pytest.approx(100e3 / 0.5, rel=0.02)
    early = hf.viability_kernel(vessel, sea, grid, DAY).dataset.attrs
    assert not early["converged"]
    assert 10 < early["residual_cells"] <= 2 * 101


def test_tank_that_fills_faster_than_its_pump_empties_it_overflows():
    assert kernel(4e6, push=1e-6, drift=2e-6).dataset.attrs["empty"]


@pytest.mark.parametrize("slowness", [1.0, 1e5, 1e-4])
def test_unstable_line_keeps_a_quarter_however_slow_it_is(slowness):
    """x' = 2 x + u / 2, all of it slower: |x| <= 1/4."""
    found = kernel(10.0 * slowness, growth=2 / slowness, push=0.5 / slowness)
    assert found.dataset.attrs["converged"]
    assert found.extent()["x"] == pytest.approx((-0.25, 0.25), abs=0.024)
    short = kernel(0.3 * slowness, growth=2 / slowness, push=0.5 / slowness)
    assert not short.dataset.attrs["converged"]


def test_march_converges_once_what_is_left_is_within_its_tolerance(double_integrator):
    """On 40 x 40 nodes 0.019 of a cell are left after a minute: more than 0.01, the default."""
    x = (hf.Quantity("x", "m"),)
    region = hf.Region("walls", x, (hf.Inequality("wall", sp.Abs(X) - 1, "m"),))
    box = {"x": (-1.2, 1.2), "v": (-2, 2)}

    def said(nodes, **options):
        grid = hf.grid(double_integrator, box, nodes)
        options |= {"scheme": "upwind"}
        return hf.viability_kernel(double_integrator, region, grid, 60.0, **options).dataset.attrs

    unfinished = said(40)
    assert unfinished["tolerance_cells"] == 0.01
    assert unfinished["residual_cells"] == pytest.approx(0.019, abs=5e-4)
    assert not unfinished["converged"]
    for nodes, tolerance in ((25, 0.01), (40, 0.02), (40, 0.05), (40, 0.2)):
        rest = said(nodes, tolerance=tolerance)
        assert rest["converged"]
        assert rest["residual_cells"] <= tolerance
        assert rest["reached_s"] < 60


@pytest.mark.parametrize("scheme", ["upwind", "weno5"])
@pytest.mark.parametrize("horizon", [0.1, 1.0, 10.0, pytest.param(100.0, marks=pytest.mark.heavy)])
def test_drift_that_is_small_beside_the_speeds_is_never_at_rest(scheme, horizon):
    """x' = -1 + 0.9999 u: nothing lasts, though in 100 s less than half a cell is lost."""
    found = kernel(horizon, push=0.9999, drift=-1.0, scheme=scheme)
    assert not found.dataset.attrs["converged"]
    if horizon >= 1.0:
        lost = found.dataset.attrs["residual_cells"]
        assert lost == pytest.approx(1e-4 * horizon / 0.024, rel=0.05)


CHANGES = {
    "ends": 4 * sp.Max(0, 1 - TIME), "begins": 4 * sp.Max(0, TIME - 4),
    "passes": 4 * sp.Max(0, 1 - sp.Abs(TIME - 2.3)), "decays": 4 * sp.exp(-TIME),
    "sways": 1 + sp.sin(TIME),
}  # fmt: skip
"""Speeds x' along a line: of each the integral over 5 s is what is lost of |x| <= 3."""


@pytest.mark.parametrize("nodes", [81, 161])
@pytest.mark.parametrize("scheme", ["upwind", "weno5"])
@pytest.mark.parametrize("change", CHANGES)
def test_set_is_exact_whenever_its_rate_changes(change, scheme, nodes):
    """A step was as long as the speed at its beginning let it, which may be nought."""
    states = (hf.Quantity("x", "m"),)
    system = hf.System("late", states, (), {"x": CHANGES[change]})
    region = hf.Region("walls", states, (hf.Inequality("wall", sp.Abs(X) - 3, "m"),))
    grid = hf.grid(system, {"x": (-8, 8)}, nodes)
    value = hf.viability_kernel(system, region, grid, 5.0, scheme=scheme)
    assert (value.report.converged, value.report.reached_s) == (False, 5.0)
    lost = quad(sp.lambdify(TIME, CHANGES[change]), 0, 5, points=(1, 2.3, 4))[0]
    cells = {"upwind": 0.7, "weno5": 0.05}[scheme]
    assert value.extent()["x"][1] == pytest.approx(3 - lost, abs=cells * 16 / (nodes - 1))
    assert value.report.steps >= 128


def test_wall_that_comes_and_goes_is_seen_by_what_hardly_moves():
    """For half a second it is 2 m further in; the march might be one step."""
    states, inputs = (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),)
    system = hf.System("slow", states, inputs, {"x": U}, input_bounds=hf.Box((-1e-4,), (1e-4,)))
    wall = X - 3 + 2 * sp.exp(-((TIME - 2.3) ** 2) / 0.1)
    rows = hf.Inequality("wall", wall, "m"), hf.Inequality("low", -X - 3, "m")
    region = hf.Region("walls", states, rows)
    value = hf.viability_kernel(system, region, hf.grid(system, {"x": (-4, 4)}, 161), 5.0)
    assert value.extent()["x"][1] == pytest.approx(1, abs=0.05)


def test_kernel_that_is_all_of_its_region_has_converged():
    found = kernel(100.0, push=1.0)
    assert found.dataset.attrs["converged"]
    assert found.extent()["x"] == pytest.approx((-1, 1))


def test_march_whose_time_step_collapses_is_refused_by_state_and_node():
    system = line(sp.exp(100 * X) + U)
    grid = hf.grid(system, {"x": (-1.2, 1.2)}, 101)
    with pytest.raises(SimulationError, match=r"'x' moves at up to 1\.3e\+52 m/s at x = 1\.2"):
        hf.viability_kernel(system, WALLS, grid, 5.0)


@pytest.mark.parametrize("rate", [U / X, U * sp.sin(X) / X])
def test_rate_that_is_not_finite_at_a_node_is_refused_by_state_and_node(rate):
    system = line(rate)
    grid = hf.grid(system, {"x": (-1.2, 1.2)}, 101)
    with pytest.raises(SimulationError, match="the rate of 'x' is not finite at x = 0; expected"):
        hf.viability_kernel(system, WALLS, grid, 5.0)
    clear = hf.grid(system, {"x": (-1.2, 1.2)}, 100)  # no node at 0
    assert np.isfinite(hf.viability_kernel(system, WALLS, clear, 0.01).values()).all()


def test_sampled_input_dissipates_no_more_than_one_with_a_closed_form():
    """x' = 2 x + u^3 / 2 on 201 nodes for 40 s: |x| <= 1/4, as x' = 2 x + u / 2."""
    system = line(2 * X + U**3 / 2, samples=9)
    grid = hf.grid(system, {"x": (-1.2, 1.2)}, 201)
    found = hf.viability_kernel(system, WALLS, grid, 40.0)
    assert found.extent()["x"] == pytest.approx((-0.25, 0.25), abs=0.012)
    plain = kernel(40.0, growth=2.0, push=0.5, nodes=201)
    assert (found.values() - plain.values())[plain.values() > 0].min() > -1e-9


def test_pursuit_with_two_balls_of_velocities_reaches_a_disc_that_grows_by_their_difference():
    """|q'| <= 1 against 0.9 for 20 s from a disc of radius 1: a disc of radius 3."""
    c, d = (hf.symbol(n) for n in ("c", "d"))
    plane = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
    game = hf.System(
        "game", plane, (hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s")), {"x": A + c, "y": B + d},
        disturbances=(hf.Quantity("c", "m/s"), hf.Quantity("d", "m/s")),
        input_bounds=hf.Ball(1.0, 2), disturbance_bounds=hf.Ball(0.9, 2),
    )  # fmt: skip
    disc = hf.Region("disc", plane, (hf.Inequality("far", sp.sqrt(X**2 + Y**2) - 1, "m"),))
    box = {"x": (-4, 4), "y": (-4, 4)}
    grid = hf.grid(game, box, 41, ends={"x": "extrapolated", "y": "extrapolated"})
    found = hf.backward_reachable_tube(game, disc, grid, 20.0)
    assert found.volume() == pytest.approx(9 * math.pi, rel=0.02)


def test_disturbance_that_is_given_outside_its_bounds_is_refused():
    d = hf.symbol("d")
    system = hf.System(
        "pushed", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": U + d},
        disturbances=(hf.Quantity("d", "m/s"),), input_bounds=hf.Box((-1,), (1,)),
        disturbance_bounds=hf.Box((-0.5,), (0.5,)),
    )  # fmt: skip
    grid = hf.grid(system, {"x": (-1.2, 1.2)}, 21)
    for given, shown in ((0.6, "d = 0.6;"), (hf.TIME, "d = 0.5")):
        with pytest.raises(SimulationError, match=f"given outside its bounds: {shown}"):
            hf.viability_kernel(system, WALLS, grid, 2.0, disturbance={"d": given})


@pytest.mark.parametrize("scheme", ["upwind", pytest.param("weno5", marks=pytest.mark.heavy)])
def test_flow_through_a_bottleneck_is_neither_stopped_nor_sped_up_by_what_is_outside(scheme):
    """x' = e + x^2: x = -1 is kept for 97 s with e = 0.001, for 140 s with e = 0.0005, not for ever."""
    square, narrow = hf.Parameter("square", "1/(m s)", value=1.0), DRIFT
    flow = line(narrow.symbol + square.symbol * X**2 + 0 * U, 1.0, (square, narrow))
    grid = hf.grid(flow, {"x": (-1.2, 1.2)}, 101)

    def kept(horizon, drift):
        return hf.viability_kernel(
            flow, WALLS, grid, horizon, parameters={"drift": drift}, scheme=scheme
        )

    half = kept(50.0, 1e-3)
    assert not half.dataset.attrs["converged"]
    assert half.extent()["x"] == pytest.approx((-1.0, -0.0013), abs=0.036)
    assert kept(1000.0, 5e-4).dataset.attrs["empty"]


def test_least_time_does_not_depend_on_the_horizon():
    """x' = 0.5 m/s to a goal 0.7 m <= x <= 0.9 m: the way over the speed, in any horizon."""
    flow = line(sp.Rational(1, 2) + 0 * U)
    sides = (hf.Inequality("left", 0.7 - X, "m"), hf.Inequality("right", X - 0.9, "m"))
    goal = hf.Region("goal", flow.states, sides)
    grid = hf.grid(flow, {"x": (-1.2, 1.2)}, 101)
    for horizon in (2.5, 500.0):
        found = hf.capture_basin(flow, goal, WALLS, grid, horizon)
        assert found.least_time([[0.5], [0.2], [-0.3]]) == pytest.approx([0.4, 1.0, 2.0], abs=0.05)
