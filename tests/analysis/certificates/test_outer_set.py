"""Outer sets: no state that is kept, or reached, is outside, by exact sets and by simulation."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast_check.checker import check
from tests import carts

X, V, A, W, PSI, Y = (hf.symbol(n) for n in ("x", "v", "a", "w", "psi", "y"))
CART = carts.cart()
LAG = hf.System(
    "lag", (hf.Quantity("x"),), (hf.Quantity("a"),), {"x": A - X},
    input_bounds=hf.Box((-1,), (1,)),
)  # fmt: skip
NEAR = hf.Region("near", LAG.states, (hf.Inequality("near", sp.Abs(X) - 0.1),))
MASS = hf.System(
    "mass", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("a", "m/s^2"),),
    {"x": V, "v": A}, input_bounds=hf.Box((-1,), (1,)),
)  # fmt: skip
DISC = hf.Inequality("near", X**2 + V**2 - 0.01)
REST = hf.Region("rest", MASS.states, (DISC,), empirical="a disc of numbers")
ENDS = {"x": "extrapolated", "v": "extrapolated"}


@pytest.fixture(scope="module")
def kernel():
    """x'' = u + d brakes at 1/2 before both walls."""
    grid = hf.grid(CART, carts.BOX, 41)
    return hf.discriminating_kernel(CART, carts.WALLS, grid, 6, scheme="upwind")


def test_state_outside_of_a_kernel_is_driven_out_and_the_checker_agrees(kernel, tmp_path):
    """No state of the exact kernel is outside, and what is outside is a certificate of its own."""
    kernel = kernel.reported(converged=True)  # for ever
    found = kernel.outer(CART, carts.WALLS, sample_time=0.8, cells=80)
    x, v = np.random.default_rng(0).uniform((-1, -1.8), (1, 1.8), (20_000, 2)).T
    exact = (v <= np.sqrt(1 - x)) & (v >= -np.sqrt(1 + x))
    inside = found.contains(np.stack([x, v], axis=1))
    assert inside[exact].all()
    assert 0.2 < (~inside).sum() / (~exact).sum() < 1
    told = check(str(found.lost.write(tmp_path / "lost.holdfast")), share=0.05)
    assert "reach the target" in told
    assert not found.contains([[1.19, 0.0], [3.0, 0.0]]).any()
    assert found.contains([[1e5, 0.0]]).all()  # of which nothing is known
    assert found.summary()["approximation"] == "outer approximation"


def test_kernel_for_a_horizon_is_bounded_for_that_horizon(kernel):
    """At v from the wall 1 m away nothing is lost within .2 s, unless it is .2 v away."""
    short = kernel.reported(converged=False, reached_s=0.2)
    found = short.outer(CART, carts.WALLS, sample_time=0.1, cells=80)
    x, v = np.random.default_rng(0).uniform((-1, -1.8), (1, 1.8), (20_000, 2)).T
    ahead = np.maximum(x + 0.2 * v - 0.5 * 0.5 * 0.04, -(x + 0.2 * v + 0.5 * 0.5 * 0.04))
    assert found.contains(np.stack([x, v], axis=1))[ahead < 1].all()


def test_invariance_kernel_is_driven_out_of_by_inputs_as_well():
    """|x| <= .4 is left from everywhere by an input of .5 of x' = -x + a: nothing else remains."""
    room = hf.Region("room", LAG.states, (hf.Inequality("size", sp.Abs(X) - 0.4, "m"),))
    grid = hf.grid(LAG, {"x": (-0.6, 0.6)}, 41)
    kernel = hf.invariance_kernel(LAG, room, grid, 6, scheme="upwind")
    assert kernel.report.empty
    assert not kernel.outer(LAG, room, sample_time=0.5, cells=120).contains([[0.0], [0.39]]).any()


def test_reached_states_are_in_the_outer_set_and_not_all_in_the_grid_s():
    """A mass under one switch of its force, from rest, after 1 s."""
    grid = hf.grid(MASS, {"x": (-2, 2), "v": (-2, 2)}, 41, ENDS)
    ahead = hf.forward_reachable_set(MASS, REST, grid, 1.0)
    generator = np.random.default_rng(0)
    angle, size = generator.uniform(0, 2 * np.pi, 5000), 0.1 * np.sqrt(generator.random(5000))
    switch, force = generator.random(5000), generator.choice([-1.0, 1.0], 5000)
    x, v = size * np.cos(angle), size * np.sin(angle)
    for seconds, a in ((switch, force), (1 - switch, -force)):
        x, v = x + v * seconds + a * seconds**2 / 2, v + a * seconds
    reached = np.stack([x, v], axis=1)
    assert (~ahead.contains(reached)).mean() == pytest.approx(0.49, abs=0.02)
    found = ahead.outer(MASS, REST, sample_time=0.5)
    assert found.contains(reached).all()
    assert found.extent()["v"][1] <= 1.5
    back = hf.backward_reachable_tube(MASS, REST, grid, 1.0).outer(MASS, REST, sample_time=0.5)
    assert back.contains(reached * [1, -1]).all()


def test_extent_of_a_lag_is_bracketed():
    """From |x| <= .1 in 3 s |x| < 1 - .9 e^-3 = .955 is reached."""
    grid = hf.grid(LAG, {"x": (-1.5, 1.5)}, 161, {"x": "extrapolated"})
    ahead = hf.forward_reachable_set(LAG, NEAR, grid, 3.0)
    inner, outer = ahead.extent()["x"][1], ahead.outer(LAG, NEAR).extent()["x"][1]
    assert inner < 1 - 0.9 * np.exp(-3) < outer
    assert (inner, outer) == pytest.approx((0.947, 0.994), abs=0.001)


def test_heading_that_comes_back_to_itself_is_bounded_by_simulation():
    """A unicycle at 1 m/s that turns by up to 1 rad/s, from a spot, heading east."""
    r = hf.symbol("r")
    system = hf.System(
        "unicycle", (hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("psi", "rad", angle=True)),
        (hf.Quantity("r", "rad/s"),), {"x": sp.cos(PSI), "y": sp.sin(PSI), "psi": r},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    start = hf.Region("spot", system.states, (
        hf.Inequality("near", X**2 + Y**2 - 0.04, "m^2"), hf.Inequality("east", 0.8 - sp.cos(PSI)),
    ))  # fmt: skip
    box = {"x": (-3, 3), "y": (-3, 3), "psi": (-np.pi, np.pi)}
    ends = {"x": "extrapolated", "y": "extrapolated", "psi": "periodic"}
    ahead = hf.forward_reachable_set(system, start, hf.grid(system, box, 21, ends), 1.0)
    found = ahead.outer(system, start, sample_time=0.5)
    generator = np.random.default_rng(0)
    q = np.stack([*generator.uniform(-0.14, 0.14, (2, 3000)), generator.uniform(-0.6, 0.6, 3000)])
    for turn in np.repeat(generator.choice([-1.0, 0.0, 1.0], (5, 3000)), 20, axis=0):
        q = q + 0.01 * np.stack([np.cos(q[2] + 0.005 * turn), np.sin(q[2] + 0.005 * turn), turn])
    assert found.contains(np.column_stack([q[0], q[1], np.angle(np.exp(1j * q[2]))])).all()
    assert found.extent()["x"][1] < 2.5


def test_basin_is_bounded_within_its_region():
    """Rest between walls at 1 m: what would hit a wall on the way is no part of the basin."""
    grid = hf.grid(
        MASS, {"x": (-1.2, 1.2), "v": (-2.4, 2.4)}, 41, {"x": "contained", "v": "extrapolated"}
    )
    room = hf.Region("room", MASS.states, (
        hf.Inequality("walls", sp.Abs(X) - 1, "m"), hf.Inequality("slow", sp.Abs(V) - 2, "m/s"),
    ))  # fmt: skip
    basin = hf.capture_basin(MASS, REST, room, grid, 2.0, arrival_steps=0)
    found = basin.outer(MASS, room, target=REST, sample_time=0.5)
    states = np.random.default_rng(0).uniform((-1, -2), (1, 2), (5000, 2))
    assert found.contains(states[basin.contains(states, 0.05)]).all()
    assert not found.contains([[1.15, 0.0]]).any()


def test_what_has_no_outer_set_is_refused(kernel):
    with pytest.raises(SimulationError, match="the set belongs to system 'cart'"):
        kernel.outer(LAG, NEAR)
    limited = hf.grid(LAG, {"x": (-1.5, 1.5)}, 41, {"x": "limited"})
    with pytest.raises(SimulationError, match="'x' is limited: its rates lead beyond it"):
        hf.forward_reachable_set(LAG, NEAR, limited, 1.0).outer(LAG, NEAR)
    tight = hf.grid(LAG, {"x": (-0.5, 0.5)}, 41, {"x": "extrapolated"})
    with pytest.raises(SimulationError, match="a way leaves the grid at 'x'"):
        hf.forward_reachable_set(LAG, NEAR, tight, 3.0).outer(LAG, NEAR)
    half = hf.Region("half", LAG.states, (hf.Inequality("right", 0.5 - X, "m"),))
    wide = hf.grid(LAG, {"x": (-2, 2)}, 41, {"x": "extrapolated"})
    with pytest.raises(SimulationError, match="'half' may reach beyond the grid at x = 2"):
        hf.backward_reachable_tube(LAG, half, wide, 0.1).outer(LAG, half)
    with pytest.raises(SimulationError, match="sample_time is -1"):
        kernel.outer(CART, carts.WALLS, sample_time=-1.0)
    with pytest.raises(SimulationError, match="without its region"):
        kernel.outer(CART, None)
