"""A saddle that is held by an input which acts on both axes: the ridge of V is kept by upwind, too.

Of q' = q + u + d in the plane, |u_x| + |u_y| <= 1 and |d| <= r, can be held what inputs reach
whatever disturbs: |x| + |y| <= 1 - r sqrt(2). The sums of u are those of two thrusters.
"""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf

X, Y, U, W, A, B = (hf.symbol(n) for n in ("x", "y", "u", "w", "a", "b"))
STATES = (hf.Quantity("x"), hf.Quantity("y"))
SUMS = hf.LinearImage(sp.Matrix([[0.5, 0.5], [0.5, -0.5]]), hf.Box((-1, -1), (1, 1)))
SIDES = {"east": X - 1.5, "west": -1.5 - X, "north": Y - 1.5, "south": -1.5 - Y}
SQUARE = hf.Region("square", STATES, tuple(hf.Inequality(n, e) for n, e in SIDES.items()))


def held(radius, nodes, **options):
    """The share of the exact set, and by how many cells what is held lies beyond it."""
    system = hf.System(
        "saddle", STATES, (hf.Quantity("u"), hf.Quantity("w")),
        {"x": X + U + A, "y": Y + W + B}, input_bounds=SUMS,
        disturbances=(hf.Quantity("a"), hf.Quantity("b")),
        disturbance_bounds=hf.Ball(sp.Float(radius), 2),
    )  # fmt: skip
    grid = hf.grid(system, {"x": (-1.6, 1.6), "y": (-1.6, 1.6)}, nodes)
    value = hf.discriminating_kernel(system, SQUARE, grid, 20, **options)
    states = np.random.default_rng(0).uniform(-1.5, 1.5, (20_000, 2))
    size, inside = np.abs(states).sum(axis=1), value.contains(states)
    exact = size <= 1 - radius * math.sqrt(2)
    beyond = (size[inside].max() - 1) / math.sqrt(2) + radius
    return (inside & exact).sum() / exact.sum(), beyond / (3.2 / (nodes - 1))


@pytest.mark.few("0.0-41-options0-0.99")
@pytest.mark.parametrize(
    ("radius", "nodes", "options", "share"),
    [
        (0.0, 41, {"scheme": "upwind"}, 0.99),
        (0.0, 81, {"scheme": "upwind"}, 0.99),
        (0.3, 41, {"scheme": "upwind"}, 0.70),
        (0.3, 81, {"scheme": "upwind"}, 0.99),
        (0.3, 41, {}, 0.97),
        (0.3, 41, {"scheme": "eno2"}, 0.97),
    ],
)
def test_a_ridge_of_an_input_on_both_axes_does_not_wear(radius, nodes, options, share):
    """With the speeds of all slopes at a node upwind kept none of it against the disturbance."""
    kept, beyond = held(radius, nodes, **options)
    assert kept > share
    assert beyond < 1.0


@pytest.mark.few("eno2")
@pytest.mark.parametrize("scheme", ["weno5", "eno2"])
def test_a_ball_that_turns_and_pushes_against_a_disturbance_keeps_its_set(scheme):
    """Its axes turn with the state, and another player acts beside it: all of the set was lost."""
    turned = hf.System(
        "turned", STATES, (hf.Quantity("u"), hf.Quantity("w")),
        {"x": Y * U - 0.444 * X, "y": -X * U + 0.904 * Y + 1.45 * W + B},
        input_bounds=hf.Ball(sp.Float(0.682), 2),
        disturbances=(hf.Quantity("b"),), disturbance_bounds=hf.Box((-0.396,), (0.255,)),
    )  # fmt: skip
    sides = sp.Max(sp.Abs(X) - 1.25, sp.Abs(Y) - 1.3)
    room = hf.Region("room", STATES, (hf.Inequality("sides", sides),))
    shares = []
    for nodes in (21, 41):
        grid = hf.grid(turned, {"x": (-1.25, 1.25), "y": (-1.3, 1.3)}, nodes)
        value = hf.discriminating_kernel(turned, room, grid, 30, scheme=scheme)
        shares.append(value.fraction())
    assert shares[0] > 0.5
    assert shares[1] == pytest.approx(shares[0], abs=0.05)
