"""Grids, marches and value functions: what is asked of them, and what is refused."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, OutputError, SimulationError
from holdfast.presentation.text.values import value_text

X, V, U, TH = (hf.symbol(n) for n in ("x", "v", "u", "theta"))

CART = hf.System(
    "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
    {"x": V, "v": U}, input_bounds=hf.Box((-1,), (1,)),
)  # fmt: skip
WALLS = hf.Region(
    "walls", CART.states[:1],
    (hf.Inequality("left", -1 - X, "m"), hf.Inequality("right", X - 1, "m")),
)  # fmt: skip
BOX = {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}


def cart_grid(nodes=41, **ends):
    return hf.grid(CART, BOX, nodes, ends)


def kernel(nodes=41, horizon=3.0, **options):
    return hf.viability_kernel(CART, WALLS, cart_grid(nodes), horizon, **options)


@pytest.fixture(scope="module")
def found():
    return kernel(81)


@pytest.mark.slow("eno3", "weno5")
@pytest.mark.parametrize("scheme", ["upwind", "eno2", "eno3", "weno5"])
def test_what_is_skipped_would_not_have_changed(scheme):
    """With the value cut off at a band, most of it settles; the numbers stay the same to the bit."""
    wide = hf.grid(CART, BOX | {"x": (-3, 3)}, 101)
    options = {"scheme": scheme, "band": 0.3}
    skipped = hf.viability_kernel(CART, WALLS, wide, 3.0, **options)
    full = hf.viability_kernel(CART, WALLS, wide, 3.0, **options, skip=False)
    assert np.array_equal(skipped.values(), full.values())
    assert skipped.dataset.attrs["computed_share"] < 0.7
    assert full.dataset.attrs["computed_share"] == 1.0


def test_band_leaves_the_set_as_it_is(found):
    narrow = kernel(81, band=0.4)
    assert np.abs(narrow.values()).max() == 0.4
    near = np.abs(found.values()) < 0.1
    assert np.abs(narrow.values() - found.values())[near].max() < 5e-3
    assert narrow.volume() == pytest.approx(found.volume(), rel=3e-3)


def test_threads_and_precision_do_not_change_the_answer(found):
    few = kernel(201, horizon=0.3, threads=1).values()
    many = kernel(201, horizon=0.3, threads=3).values()
    assert np.array_equal(few, many)
    short = kernel(81, precision="float32")
    assert short.values().dtype == np.float32
    assert np.abs(short.values() - found.values()).max() < 1e-3


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_ball_of_inputs_has_one_set_in_both_precisions():
    """Where V is flat the best input is 0/0: what keeps it a number may not vanish in the short one."""
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("a", "m/s^2"),),
        {"x": hf.symbol("v"), "v": hf.symbol("a")}, input_bounds=hf.Ball(1, 1),
    )  # fmt: skip
    near = hf.Inequality("near", sp.Abs(hf.symbol("x")) - 1, "m")
    walls = hf.Region("walls", cart.states, (near,))
    grid = hf.grid(cart, {"x": (-1.2, 1.2), "v": (-2, 2)}, 31)
    short, long = (
        hf.viability_kernel(cart, walls, grid, 5, precision=p) for p in ("float32", "float64")
    )
    assert short.report.converged
    assert np.abs(short.values() - long.values()).max() < 1e-3


def test_converged_and_not_converged_are_told_apart(found):
    said = found.dataset.attrs
    assert said["converged"] == 1
    assert said["reached_s"] < 3.0
    early = kernel(81, horizon=0.4).dataset.attrs
    assert early["converged"] == 0
    assert early["reached_s"] == pytest.approx(0.4)
    assert early["residual_cells"] > 1 > said["tolerance_cells"] > said["residual_cells"]


def test_values_at_times_shrink(found):
    several = kernel(81, horizon=1.0, times=[0.25, 0.5])
    assert several.dataset["time"].values == pytest.approx([0.25, 0.5, 1.0])
    a, b, c = (several.fraction(t) for t in (0.25, 0.5, 1.0))
    assert a > b > c > found.fraction()
    with pytest.raises(
        SimulationError, match=r"no value at 0\.3 s; expected one of 0\.25, 0\.5, 1"
    ):
        several.values(0.3)
    with pytest.raises(SimulationError, match="is stored at its last time only"):
        found.values(0.5)


def test_start_value_is_the_margin_of_the_region():
    """Before anything moves: linear in x, so that the interpolant is exact where it has no kink."""
    still = hf.System("still", CART.states, (), {"x": sp.S.Zero, "v": sp.S.Zero})
    value = hf.viability_kernel(still, WALLS, hf.grid(still, BOX, 27), 1.0)
    points = np.random.default_rng(0).uniform((-1.3, -1.8), (-0.1, 1.8), (50, 2))
    assert value.at(points) == pytest.approx(1 + points[:, 0])
    assert value.gradient(points[points[:, 0] < -0.2])[:, 0] == pytest.approx(1.0)
    assert value.dataset.attrs["converged"] == 1
    assert np.isnan(value.at([[1.4, 0.0]])[0])
    assert not value.contains([[1.4, 0.0]])[0]


def test_fraction_volume_slice_and_projection(found):
    exact = 16 / 3
    assert found.volume() == pytest.approx(exact, rel=0.03)
    assert found.fraction() == pytest.approx(exact / (2.6 * 3.6), rel=0.03)
    line = found.slice(v=0.7)
    inside = line.grid.axes[0].nodes[line.values() > 0]
    assert inside.max() == pytest.approx(1 - 0.7**2 / 2, abs=0.04)
    assert line.at([[0.2]])[0] == pytest.approx(found.at([[0.2, 0.7]])[0])
    shadow = found.projection("x")
    assert shadow.values() == pytest.approx(found.values().max(axis=1))
    with pytest.raises(SimulationError, match="'w' is not an axis; expected one of x, v"):
        found.slice(w=0)
    with pytest.raises(SimulationError, match="'v' at 2 is outside the grid"):
        found.slice(v=2.0)


def test_angle_wraps_in_the_march_and_between_nodes():
    """A front that turns with the unit circle: the value moves, the same over the seam."""
    theta = hf.Quantity("theta", "rad", angle=True)
    ring = hf.System("ring", (theta,), (), {"theta": sp.S.One})
    goal = hf.Region("goal", (theta,), (hf.Inequality("c", -sp.cos(TH - 1)),))
    grid = hf.grid(ring, {"theta": (-math.pi, math.pi)}, 64)
    assert grid.axes[0].ends == "periodic"
    found = hf.backward_reachable_tube(ring, goal, grid, 1.5)
    angles = np.linspace(-9, 9, 200)
    inside = found.contains(angles[:, None])
    # a state at theta passes through [theta, theta + 1.5]: it meets |a - 1| < pi/2 within that
    gap = (angles - 1 + math.pi) % (2 * math.pi) - math.pi
    expected = (gap > -math.pi / 2 - 1.5) & (gap < math.pi / 2)
    sure = np.minimum(abs(gap + math.pi / 2 + 1.5), abs(gap - math.pi / 2)) > 0.06
    assert np.array_equal(inside[sure], expected[sure])


def test_limited_state_cannot_leave_through_its_end():
    """A vehicle whose speed ends at 0.5 m/s brakes in time from everywhere 0.125 m off a wall."""
    box = {"x": (-1.3, 1.3), "v": (-0.5, 0.5)}
    grid = hf.grid(CART, box, {"x": 105, "v": 41}, {"v": "limited"})
    found = hf.viability_kernel(CART, WALLS, grid, 4.0)
    top = found.slice(v=0.5)
    assert top.grid.axes[0].nodes[top.values() > 0].max() == pytest.approx(0.875, abs=0.03)


def test_forward_reach_is_called_an_inner_approximation_wherever_it_is_told():
    """x' = -x + u from rest reaches x < 1: a grid leaves some of it out."""
    x, u = hf.symbol("x"), hf.symbol("u")
    lag = hf.System(
        "lag", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": u - x},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    start = hf.Region("rest", lag.states, (hf.Inequality("near", sp.Abs(x) - 0.1),))
    grid = hf.grid(lag, {"x": (-1.5, 1.5)}, 41, {"x": "extrapolated"})
    ahead = hf.forward_reachable_set(lag, start, grid, 3.0)
    assert ahead.extent()["x"][1] < 1 - 0.9 * np.exp(-3)
    assert ahead.report.approximation == ahead.summary()["approximation"] == "inner approximation"
    assert "; inner approximation" in value_text(ahead)
    assert "inner approximation" in hf.value_function_figure(ahead).get_suptitle()
    back = hf.backward_reachable_tube(lag, start, grid, 0.5)
    assert "approximation" not in back.summary()


def test_forward_reach_is_the_reverse_of_backward_reach():
    disc = hf.Inequality("c", sp.sqrt(X**2 + V**2 + 1e-12) - 0.2, "m")
    start = hf.Region("start", CART.states, (disc,), empirical="a disc of numbers")
    box = {"x": (-2, 2), "v": (-2, 2)}
    ahead = hf.forward_reachable_set(CART, start, hf.grid(CART, box, 81), 1.0)
    back = hf.backward_reachable_tube(CART, start, hf.grid(CART, box, 81), 1.0)
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (200, 2))
    mirrored = points * [1, -1]  # time reversed, a cart moves as if its velocity were reversed
    assert ahead.at(points) == pytest.approx(back.at(mirrored), abs=1e-9)
    # a full second of full thrust from the middle of the start
    assert ahead.contains([[0.5, 1.0]])[0]
    assert not ahead.contains([[1.2, 1.4]])[0]
    assert ahead.dataset.attrs["ends_reached"] == ""
    touching = hf.forward_reachable_set(
        CART, start, hf.grid(CART, {"x": (-2, 2), "v": (-0.9, 0.9)}, 61), 1.0
    )
    assert touching.dataset.attrs["ends_reached"] == "v = -0.9, v = 0.9"


def test_invariance_kernel_is_what_no_input_can_leave():
    """x' = -x + u, |u| <= 0.5: |x| <= 1 cannot be left; |x| <= 0.4 is left from everywhere."""
    decay = hf.System(
        "decay", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": U - X},
        input_bounds=hf.Box((-0.5,), (0.5,)),
    )  # fmt: skip
    grid = hf.grid(decay, {"x": (-1.3, 1.3)}, 101)
    held = hf.invariance_kernel(decay, WALLS, grid, 5.0)
    assert held.volume() == pytest.approx(2.0, rel=0.02)
    small = hf.Region(
        "small", decay.states, (hf.Inequality("a", X - 0.4, "m"), hf.Inequality("b", -0.4 - X, "m"))
    )
    assert hf.invariance_kernel(decay, small, grid, 8.0).dataset.attrs["empty"] == 1


def test_capture_basin_keeps_out_of_what_is_not_allowed():
    """A boat that cannot pass through a wall with a gap takes the way around; behind it, none."""
    w = hf.symbol("w")
    boat = hf.System(
        "boat", (hf.Quantity("x", "m"), hf.Quantity("v", "m")),
        (hf.Quantity("u", "m/s"), hf.Quantity("w", "m/s")), {"x": U, "v": w},
        input_bounds=hf.Ball(sp.S.One, 2),
    )  # fmt: skip
    goal = hf.Region(
        "goal", boat.states, (hf.Inequality("c", sp.sqrt(X**2 + V**2 + 1e-12) - 0.3, "m"),)
    )
    names = {"x": X, "v": V}
    wall = hf.parse_expression("min(0.15 - abs(x - 1), 0.5 - v)", names)  # |x - 1| < .15, v < .5
    free = hf.Region("free", boat.states, (hf.Inequality("wall", wall, "m"),))
    grid = hf.grid(boat, {"x": (-2, 3), "v": (-2, 2)}, {"x": 101, "v": 81})
    found = hf.capture_basin(boat, goal, free, grid, 2.5, arrival_steps=50)
    times = found.dataset["arrival"].sel(x=2.0, v=[0.0, 0.5], method="nearest").values
    # (2, .5) goes along v = .5 over the wall's end and down: at least the straight way
    assert times[1] > math.hypot(2, 0.5) - 0.3
    assert times[0] > times[1]
    assert np.isnan(found.dataset["arrival"].sel(x=1.0, v=0.0, method="nearest"))
    straight = found.dataset["arrival"].sel(x=-1.5, v=0.0, method="nearest")
    assert float(straight) == pytest.approx(1.2, abs=0.03)


def test_file_keeps_everything(found, tmp_path):
    path = found.save(tmp_path / "kernel.nc")
    again = hf.load(path)
    assert isinstance(again, hf.ValueFunction)
    assert np.array_equal(again.values(), found.values())
    assert again.grid == found.grid
    said, first = again.summary(), found.summary()
    assert said.pop("extent") == first.pop("extent")
    assert said == pytest.approx(first)
    (tmp_path / "folder").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        found.save(tmp_path / "folder" / "kernel.nc")


@pytest.mark.parametrize("name", ["value", "arrival", "outside", "time"])
def test_a_state_with_the_name_of_a_variable_of_the_file_is_refused(name):
    state = hf.Quantity(name, "m")
    tank = hf.System("tank", (state,), (), {name: sp.S.One})
    with pytest.raises(SimulationError, match=f"a state has the name '{name}'.*rename the state"):
        hf.grid(tank, {name: (-1, 1)}, 5)


def test_grids_of_another_system_and_margins_that_are_no_numbers_are_refused():
    one = hf.System(
        "one", CART.states[:1], (hf.Quantity("u"),), {"x": U}, input_bounds=CART.input_bounds
    )
    with pytest.raises(
        SimulationError, match="the grid belongs to another system, with the states x; expected the"
    ):
        hf.viability_kernel(CART, WALLS, hf.grid(one, {"x": (-2, 2)}, 21), 1.0)
    root = hf.Region("root", CART.states[:1], (hf.Inequality("c", sp.sqrt(X) - 1),))
    with pytest.raises(SimulationError, match="are NaN at some nodes"):
        hf.viability_kernel(one, root, hf.grid(one, {"x": (-2, 2)}, 21), 1.0)


def test_problems_that_are_another_are_refused():
    with pytest.raises(SimulationError, match="the system has no disturbances"):
        hf.discriminating_kernel(CART, WALLS, cart_grid(), 1.0)
    drifting = hf.systems.drifting_unicycle()
    box = dict.fromkeys(drifting.state_names, (-4, 4)) | {"psi": (-math.pi, math.pi)}
    near = hf.Region(
        "near", drifting.states[:1], (hf.Inequality("c", drifting.states[0].symbol - 1, "m"),)
    )
    with pytest.raises(SimulationError, match="ask for the discriminating_kernel"):
        hf.viability_kernel(drifting, near, hf.grid(drifting, box, 11), 1.0)
    free = hf.System("free", CART.states, CART.inputs, dict(CART.rates))
    with pytest.raises(DefinitionError, match="no bounds for its inputs"):
        hf.viability_kernel(free, WALLS, cart_grid(), 1.0)


def test_a_march_that_takes_in_what_is_outside_is_no_result():
    """The reach of a vehicle that runs off the grid, with ends that are continued, is caught or told."""
    outward = hf.System(
        "outward", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": 3 * X + U},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    start = hf.Region("start", outward.states, (hf.Inequality("c", X**2 - 0.01),))
    found = hf.forward_reachable_set(outward, start, hf.grid(outward, {"x": (-1, 1)}, 101), 2.0)
    assert found.dataset.attrs["ends_reached"] == "x = -1, x = 1"
