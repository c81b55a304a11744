"""Problems whose rates are not affine in the inputs, against what is known of them exactly."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError

X, Y, V, U, H, D = (hf.symbol(n) for n in ("x", "y", "v", "u", "h", "d"))
WALLS = hf.Region(
    "walls", (hf.Quantity("x", "1"),),
    (hf.Inequality("left", -1 - X), hf.Inequality("right", X - 1)),
)  # fmt: skip
DISC = hf.Region(
    "disc", (hf.Quantity("x", "1"), hf.Quantity("y", "1")),
    (hf.Inequality("near", sp.sqrt(X**2 + Y**2 + 1e-12) - 0.4),),
)  # fmt: skip


def quantities(*names):
    return tuple(hf.Quantity(n, "1") for n in names)


def cart(rate, bounds, disturbances=(), disturbance_bounds=None):
    return hf.System(
        "cart", quantities("x", "v"), quantities("u"), {"x": V, "v": rate},
        disturbances=quantities(*disturbances),
        input_bounds=bounds, disturbance_bounds=disturbance_bounds,
    )  # fmt: skip


def over(system, nodes=61):
    return hf.grid(system, {"x": (-1.3, 1.3), "v": (-2.0, 2.0)}, nodes)


def boat(current=0.5, samples=0):
    return hf.System(
        "boat", quantities("x", "y"), quantities("h"), {"x": current + sp.cos(H), "y": sp.sin(H)},
        input_bounds=hf.Box((-sp.pi,), (sp.pi,)), samples=samples,
    )  # fmt: skip


@pytest.fixture(scope="module")
def basin():
    grid = hf.grid(boat(), {"x": (-3.5, 2.5), "y": (-2.5, 2.5)}, {"x": 121, "y": 101})
    times = np.linspace(0, 1.2, 13)
    return hf.capture_basin(
        boat(), DISC, None, grid, 1.2, arrival_steps=60, times=times, samples=33
    )


def test_affine_system_in_disguise_has_the_same_kernel():
    """sin u over a quarter turn either way is an input in [-1, 1], whose ends are samples."""
    plain = cart(U, hf.Box((-1,), (1,)))
    disguised = cart(sp.sin(U), hf.Box((-sp.pi / 2,), (sp.pi / 2,)))
    one = hf.viability_kernel(plain, WALLS, over(plain), 4.0)
    other = hf.viability_kernel(disguised, WALLS, over(disguised), 4.0, samples=5)
    assert np.abs(one.values() - other.values()).max() < 1e-9
    assert (one.dataset.attrs["samples"], other.dataset.attrs["samples"]) == (0, 5)


def test_an_effectiveness_that_is_not_known_costs_what_it_is_at_worst():
    """v' = (1 + d) u with |d| <= 0.3 brakes as v' = 0.7 u does: v^2 <= 1.4 (1 - x)."""
    uncertain = cart((1 + D) * U, hf.Box((-1,), (1,)), ("d",), hf.Box((-0.3,), (0.3,)))
    grid = over(uncertain, 101)
    found = hf.discriminating_kernel(uncertain, WALLS, grid, 6.0, samples=3)
    assert found.dataset.attrs["converged"] == 1
    assert found.dataset.attrs["separable"] == 0
    for x in (-0.5, 0.0, 0.5):
        speeds = np.linspace(0, 2, 2001)
        inside = found.contains(np.stack([np.full(2001, x), speeds], axis=1))
        assert speeds[inside].max() == pytest.approx(math.sqrt(1.4 * (1 - x)), abs=0.02)


def test_zermelo_who_chooses_a_heading_needs_the_least_root_of_his_equation(basin):
    """|x + V T e1| = r + T; 33 headings are at most 5.6 degrees off, which costs 0.5 %."""
    arrival = basin.dataset["arrival"].values
    x, y = np.meshgrid(*(a.nodes for a in basin.grid.axes), indexing="ij")
    a, b = 1 - 0.5**2, 0.4 - 0.5 * x
    root = (-b + np.sqrt(np.maximum(b**2 + a * (x**2 + y**2 - 0.4**2), 0))) / a
    exact = np.where(x**2 + y**2 <= 0.4**2, 0.0, root)
    reached = exact < 1.1
    assert np.isfinite(arrival[reached]).all()
    assert np.abs(arrival - exact)[reached].max() < 0.02


def test_the_heading_that_is_chosen_brings_the_boat_there(basin):
    law = hf.safety_law(boat(samples=33), basin)
    points = np.array([[-1.5, 0.3], [-1.0, -0.8], [0.6, 0.7]])
    assert basin.contains(points).all()
    result = hf.simulate(boat(), law, starts=points, goal=DISC, horizon=1.2)
    states = result.dataset["state"].values
    nearest = np.hypot(states[:, :, 0], states[:, :, 1]).min(axis=1)
    assert (nearest < 0.4 + 0.02).all()


def test_law_of_a_sampled_value_takes_the_samples_from_it(basin):
    assert hf.safety_law(boat(), basin).outputs == hf.safety_law(boat(samples=33), basin).outputs
    with pytest.raises(DefinitionError, match="not affine in 'h'"):
        hf.safety_law(
            boat(), basin, hf.Law("east", boat().states, {"h": hf.parse_expression("0", {})})
        )


def test_symmetry_over_samples_is_refused():
    grid = hf.grid(boat(), {"x": (-2, 2), "y": (-2, 2)}, 21)
    with pytest.raises(DefinitionError, match="symmetry of system 'boat' with 9 samples"):
        hf.capture_basin(boat(), DISC, None, grid, 0.1, samples=9, symmetry={"y": -1})
