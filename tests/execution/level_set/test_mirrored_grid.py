"""A problem that does not notice a reflection is solved on half of its grid."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError

X, Y, V, U, W, PSI = (hf.symbol(n) for n in ("x", "y", "v", "u", "w", "psi"))
CART = hf.System(
    "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
    {"x": V, "v": U}, input_bounds=hf.Box((-1,), (1,)),
)  # fmt: skip
WALLS = hf.Region(
    "walls", CART.states[:1],
    (hf.Inequality("left", -1 - X, "m"), hf.Inequality("right", X - 1, "m")),
)  # fmt: skip
ROBOT = hf.System(
    "robot", (hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("psi", "rad", angle=True)),
    (hf.Quantity("u", "rad/s"),), {"x": sp.cos(PSI), "y": sp.sin(PSI) + W, "psi": U},
    disturbances=(hf.Quantity("w", "m/s"),),
    input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-0.3,), (0.3,)),
)  # fmt: skip
LANE = hf.Region(
    "lane", ROBOT.states[:2],
    (hf.Inequality("left", Y - 1, "m"), hf.Inequality("right", -1 - Y, "m"),
     hf.Inequality("post", 0.4 - sp.sqrt(X**2 + Y**2 + 1e-12), "m")),
)  # fmt: skip
SIDES = {"y": -1, "psi": -1}


def robot_grid(low=-math.pi, angles=40, y=24):
    box = {"x": (-2, 1), "y": (-1.3, 1.3), "psi": (low, low + 2 * math.pi)}
    return hf.grid(ROBOT, box, {"x": 31, "y": y, "psi": angles}, {"x": "extrapolated"})


def same(half, whole, share):
    assert np.abs(half.values() - whole.values()).max() < 1e-12
    assert 0.4 < half.dataset.attrs["computed_share"] < share
    assert whole.dataset.attrs["computed_share"] == 1.0
    assert half.dataset.attrs["steps"] == whole.dataset.attrs["steps"]


@pytest.mark.slow("160-eno2", "160-weno5")
@pytest.mark.parametrize("scheme", ["upwind", "eno2", "weno5"])
@pytest.mark.parametrize("nodes", [81, 160])
def test_half_of_the_states_of_a_cart_tell_the_other_half(scheme, nodes):
    grid = hf.grid(CART, {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}, nodes)
    options = {"scheme": scheme, "skip": False}
    whole = hf.viability_kernel(CART, WALLS, grid, 0.7, **options)
    half = hf.viability_kernel(CART, WALLS, grid, 0.7, **options, symmetry={"x": -1, "v": -1})
    same(half, whole, 0.6)


@pytest.mark.few("-3.0915926535897933-0-24")
@pytest.mark.parametrize("y", [24, 25])
@pytest.mark.parametrize(("low", "angles"), [(-math.pi, 40), (0.0, 70), (-math.pi + 0.05, 0)])
def test_left_tells_right_for_a_robot_between_walls(low, angles, y):
    """An angle may begin anywhere from which its nodes are reflected onto one another."""
    if not angles:  # 0 lies in the middle between two nodes
        angles = 36
        low = -math.pi + math.pi / 36
    grid = robot_grid(low, angles, y)
    whole = hf.discriminating_kernel(ROBOT, LANE, grid, 0.5, skip=False)
    half = hf.discriminating_kernel(ROBOT, LANE, grid, 0.5, skip=False, symmetry=SIDES)
    same(half, whole, 0.75)
    skipped = hf.discriminating_kernel(ROBOT, LANE, grid, 0.5, symmetry=SIDES, band=0.3)
    full = hf.discriminating_kernel(ROBOT, LANE, grid, 0.5, symmetry=SIDES, band=0.3, skip=False)
    assert np.array_equal(skipped.values(), full.values())


def test_one_angle_alone_and_several_threads_make_no_difference():
    still = hf.System(
        "ring", (hf.Quantity("psi", "rad", angle=True),), (hf.Quantity("u", "rad/s"),),
        {"psi": U + 0.5 * sp.sin(PSI)}, input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    goal = hf.Region("goal", still.states, (hf.Inequality("c", -sp.cos(PSI) + 0.5),))
    grid = hf.grid(still, {"psi": (-math.pi, math.pi)}, 150)
    options = {"skip": False, "cfl": 0.5}
    whole = hf.backward_reachable_tube(still, goal, grid, 0.5, **options)
    half = hf.backward_reachable_tube(still, goal, grid, 0.5, **options, symmetry={"psi": -1})
    assert np.abs(half.values() - whole.values()).max() < 1e-12
    big = robot_grid(y=50)
    one, three = (
        hf.discriminating_kernel(ROBOT, LANE, big, 0.1, symmetry=SIDES, threads=n) for n in (1, 3)
    )
    assert np.array_equal(one.values(), three.values())


@pytest.mark.parametrize(
    ("signs", "complaint"),
    [
        ({"y": -1}, "the rate of 'y' is not the same after the reflection"),
        ({"x": -1}, "the rate of 'x' is not the same"),
        ({"z": -1}, "symmetry of 'z', which is not a state"),
        ({"y": -2, "psi": -1}, "symmetry of 'y' is -2; expected -1 or 1"),
        ({"x": 1}, "the symmetry reflects no state"),
    ],
)
def test_symmetries_that_are_none_are_refused(signs, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.discriminating_kernel(ROBOT, LANE, robot_grid(), 0.5, symmetry=signs)


def test_regions_inputs_and_grids_that_are_not_reflected_are_refused():
    aside = hf.Region("aside", ROBOT.states[1:2], (hf.Inequality("left", Y - 1, "m"),))
    grid = hf.grid(ROBOT, {"x": (-2, 1), "y": (-1.3, 1.3), "psi": (-math.pi, math.pi)}, 21,
                   {"x": "extrapolated", "y": "extrapolated"})  # fmt: skip
    with pytest.raises(
        DefinitionError, match="inequality 'left' of region 'aside' is not the same"
    ):
        hf.discriminating_kernel(ROBOT, aside, grid, 0.5, symmetry=SIDES)
    right = hf.System(
        "right", CART.states, CART.inputs, dict(CART.rates), input_bounds=hf.Box((-1,), (2,))
    )
    both = {"x": -1, "v": -1}
    cart = hf.grid(CART, {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}, 41)
    with pytest.raises(DefinitionError, match="effect of inputs and disturbances is not the same"):
        hf.viability_kernel(right, WALLS, cart, 0.5, symmetry=both)
    uneven = hf.grid(CART, {"x": (-1.3, 1.3), "v": (-1.8, 1.9)}, 41)
    with pytest.raises(SimulationError, match="the nodes along 'v' are not symmetric about 0"):
        hf.viability_kernel(CART, WALLS, uneven, 0.5, symmetry=both)
