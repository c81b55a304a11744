"""What is refused before a march begins, and how it is said: the cause, what is expected, a remedy.

One row is one thing that a user may get wrong; the text is what they read.
"""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, HoldfastError, SimulationError
from holdfast.execution.simulation import closed_loop

X, V, U, D = (hf.symbol(n) for n in ("x", "v", "u", "d"))
STATES = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"))
CART = hf.System(
    "cart", STATES, (hf.Quantity("u", "m/s^2"),), {"x": V, "v": U}, input_bounds=hf.Box((-1,), (1,))
)
WALLS = hf.Region(
    "walls", STATES[:1], (hf.Inequality("left", -1 - X, "m"), hf.Inequality("right", X - 1, "m"))
)
BOX = {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}
THETA = hf.Quantity("theta", "rad", angle=True)
RING = hf.System("ring", (THETA,), (), {"theta": sp.S.One})


def kernel(horizon=0.1, grid=None, **options):
    grid = hf.grid(CART, BOX, 21) if grid is None else grid
    return hf.viability_kernel(CART, WALLS, grid, horizon, **options)


def refused(message, action, error=SimulationError):
    with pytest.raises(error) as found:
        action()
    assert message in str(found.value)


# the grid

INTERVALS = [
    (3, "the interval of 'x' is 3; expected two numbers, (low, high)"),
    (None, "the interval of 'x' is None; expected two numbers"),
    ((1,), "the interval of 'x' is (1,); expected two numbers"),
    ((1, 2, 3), "the interval of 'x' is (1, 2, 3); expected two numbers"),
    (("a", 1), "the interval of 'x' is ('a', 1); expected two numbers"),
    ((True, 2), "the interval of 'x' is (True, 2); expected two numbers"),
    ((0, 1j), "the interval of 'x' is (0, 1j); expected two numbers"),
    ((U, 1), "the interval of 'x' is (u, 1); expected two numbers"),
    ("ab", "the interval of 'x' is 'ab'; expected two numbers"),
    ({"low": 0, "high": 1}, "expected two numbers"),
    ((math.nan, 1), "the interval of 'x' is [nan, 1]; expected low < high"),
    ((-math.inf, 1), "the interval of 'x' is [-inf, 1]; expected low < high"),
    ((1, 1), "the interval of 'x' is [1, 1]; expected low < high"),
]


@pytest.mark.parametrize(("interval", "message"), INTERVALS)
def test_intervals_that_are_none(interval, message):
    refused(message, lambda: hf.grid(CART, BOX | {"x": interval}, 11))


def test_intervals_may_be_numbers_of_any_library():
    for pair in (
        [0, 1],
        np.array([0.0, 1.0]),
        (sp.Integer(0), sp.pi),
        (np.float32(0), np.int64(1)),
    ):
        assert hf.grid(CART, BOX | {"x": pair}, 11).axes[0].low == 0.0


@pytest.mark.parametrize("nodes", [11.0, True, "11", None, 1, 0, -3, math.nan, [11], {"x": 11.0}])
def test_nodes_that_are_no_whole_numbers(nodes):
    said = nodes["x"] if isinstance(nodes, dict) else nodes
    message = f"nodes along 'x': {said!r}; expected a whole number of at least 2"
    refused(message, lambda: hf.grid(CART, BOX, nodes))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, BOX, 11), "got None; expected a System"),
        ((CART, 3, 11), 'box: 3; expected a table by name, such as {"x": (0, 1)}'),
        ((CART, None, 11), "box: None; expected a table by name"),
        ((CART, {"x": (0, 1)}, 11), "the grid has no interval for 'v'"),
        ((CART, BOX, {"x": 11}), "nodes along 'v': None; expected a whole number of at least 2"),
        ((CART, BOX, {"w": 11}), "nodes of 'w', which is not a state"),
        ((CART, BOX | {"w": (0, 1)}, 11), "box of 'w', which is not a state"),
        ((CART, BOX, 11, 3), "ends: 3; expected a table by name"),
        ((CART, BOX, 11, {"x": 3}), "ends of 'x': '3'; allowed: contained, extrapolated, limited"),
        ((CART, BOX, 11, {"x": ["contained"]}), "ends of 'x': '['contained']'"),
        ((CART, BOX, 11, {"x": "periodic"}), "'x' is periodic over [-1.3, 1.3]; expected an angle"),
    ],
)
def test_grids_that_are_none(arguments, message):
    refused(message, lambda: hf.grid(*arguments))


@pytest.mark.parametrize(
    ("interval", "ends", "message"),
    [
        (
            (-1, 1),
            {},
            "the interval of the angle 'theta', [-1, 1], is 2 rad, not a whole turn; expected 2 pi",
        ),
        ((-4, 4), {}, "the interval of the angle 'theta', [-4, 4], is 8 rad; expected"),
        ((-4, 4), {"theta": "contained"}, "is 8 rad; expected at most 2 pi"),
        ((-1, 1), {"theta": "periodic"}, "'theta' is periodic over [-1, 1]; expected an angle"),
    ],
)
def test_angles_that_do_not_span_their_turn_or_overlap(interval, ends, message):
    refused(message, lambda: hf.grid(RING, {"theta": interval}, 11, ends))
    assert hf.grid(RING, {"theta": (-1, 1)}, 11, {"theta": "contained"}).shape == (11,)


def test_grid_that_does_not_contain_the_region():
    small = hf.grid(CART, BOX | {"x": (-0.8, 1.3)}, 21)
    message = (
        "the grid cuts off region 'walls' at x = -0.8; expected a grid that contains the region; "
        'widen it to x = -1.01, or give ends = {"x": "limited"}'
    )
    refused(message, lambda: kernel(grid=small))


@pytest.mark.parametrize(
    ("scheme", "least"), [("upwind", 3), ("eno2", 5), ("eno3", 7), ("weno5", 7)]
)
def test_fewer_nodes_than_the_scheme_reaches_over(scheme, least):
    few = hf.grid(CART, BOX, {"x": 21, "v": least - 1})
    message = f"{least - 1} nodes along 'v'; expected at least {least} for {scheme}"
    refused(message, lambda: kernel(grid=few, scheme=scheme))


# the problem


@pytest.mark.parametrize("horizon", [0, -1.0, math.nan, math.inf, "5", None, True, [1]])
def test_horizons_that_are_none(horizon):
    message = f"the horizon [s] is {horizon!r}; expected a finite number above 0"
    refused(message, lambda: kernel(horizon))


def test_inputs_without_bounds():
    free = hf.System("free", CART.states, CART.inputs, dict(CART.rates))
    grid = hf.grid(free, BOX, 21)
    message = "system 'free' has no bounds for its inputs; give input bounds"
    refused(message, lambda: hf.viability_kernel(free, WALLS, grid, 1), DefinitionError)
    half = hf.System(
        "half", CART.states, CART.inputs, dict(CART.rates), input_bounds=hf.Box((-1,), (sp.oo,))
    )
    message = "an input of system 'half' is unbounded; expected finite bounds"
    refused(message, lambda: hf.viability_kernel(half, WALLS, grid, 1), DefinitionError)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"grid": 3}, "got 3; expected a Grid; make one: hf.grid(system, box, nodes)"),
        ({"start_time": "a"}, "start_time is 'a'; expected a finite number of seconds"),
        ({"start_time": math.nan}, "start_time is nan; expected a finite number of seconds"),
        ({"times": 0.05}, "times: 0.05; expected a list of times"),
        ({"times": "0.05"}, "times: '0.05'; expected a list of times"),
        ({"times": ["a"]}, "a value is asked for at the time 'a'; expected a number of seconds"),
        ({"times": [0.05, math.nan]}, "at the time nan; expected a number of seconds"),
        ({"times": [-0.01]}, "a value is asked for at -0.01 s; expected times from 0"),
        ({"times": [0.2]}, "a value is asked for at 0.2 s; expected times from 0 to the"),
        ({"disturbance": 3}, "disturbance: 3; expected a table by name"),
        ({"disturbance": {"d": 3}}, "system 'cart' has no disturbance 'd'"),
        ({"parameters": [1]}, "parameters: [1]; expected a table by name"),
        ({"parameters": {"m": 3}}, "no parameter 'm'; none is allowed here"),
        ({"progress": 3}, "progress: 3; expected a function of the share"),
        ({"scheme": "weno"}, "scheme: 'weno'; did you mean 'weno5'?"),
        ({"shceme": "eno2"}, "unknown option 'shceme'; did you mean 'scheme'?"),
    ],
)  # fmt: skip
def test_problems_that_are_none(options, message):
    refused(message, lambda: kernel(**options))


def test_regions_and_disturbances_that_are_none():
    grid = hf.grid(CART, BOX, 21)
    refused("got None; expected a Region", lambda: hf.viability_kernel(CART, None, grid, 1))
    pushed = hf.System(
        "pushed", STATES, CART.inputs, {"x": V, "v": U + D}, disturbances=(hf.Quantity("d"),),
        input_bounds=CART.input_bounds, disturbance_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    for value in ("a", math.nan, None, True):
        message = f"a disturbance is given as {value!r}; expected a finite number"
        if isinstance(value, str):
            message = f"disturbance 'd' uses '{value}'; expected a number, or an expression of t"
        refused(
            message,
            lambda d=value: hf.viability_kernel(pushed, WALLS, grid, 1, disturbance={"d": d}),
        )


@pytest.mark.parametrize("steps", ["a", -1, 2.5, True, math.nan])
def test_arrival_steps_that_are_none(steps):
    grid = hf.grid(CART, BOX, 21)
    message = f"arrival_steps: {steps!r}; expected a whole number of at least 0"
    refused(message, lambda: hf.capture_basin(CART, WALLS, None, grid, 0.1, arrival_steps=steps))


# the options of the march

NO_NUMBERS = ("a", True, [1], math.nan, -1, 0)
WRONG = {
    "cfl": ("expected a number above 0, at most 1", (*NO_NUMBERS, None, 1.5)),
    "band": ("expected a number above 0; infinite for none", (*NO_NUMBERS, None)),
    "tolerance": ("expected a number of cells above 0", NO_NUMBERS),
    "order": ("expected a whole number from 1 to 3", ("a", True, [1], math.nan, 0, 4, 3.0)),
    "threads": ("expected a whole number from 1 to 1024", (*NO_NUMBERS, 2.0, 2000)),
    "scheme": ("allowed: eno2, eno3, upwind, weno5", (None, True, [1], math.nan)),
    "dissipation": ("allowed: global, local, local-local", (None, True, ["one"], math.nan)),
    "precision": ("allowed: float32, float64", (None, True, 32, math.nan)),
    "skip": ("expected True or False", ("a", None, 1, math.nan)),
    "check_outside": ("expected True or False", ("yes", None, 1, math.nan)),
    "estimate_error": ('expected True, False or "order"', ("yes", None, 1.0, math.nan)),
    "symmetry": ('expected a table by name, such as {"y": -1}', ("x", True, ["x"], math.nan)),
    "checkpoint": ("expected a file or a folder", (True, 3, ["a"], math.nan)),
    "checkpoint_every": ("expected seconds, at least 0", ("a", None, True, math.nan, -1)),
}


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [(name, v, expected) for name, (expected, values) in WRONG.items() for v in values],
)
def test_options_of_the_wrong_type_or_beyond_their_range(name, value, expected):
    with pytest.raises(SimulationError) as found:
        kernel(**{name: value})
    assert str(found.value).startswith(f"{name}: {value!r}; ")
    assert expected in str(found.value)


@pytest.mark.parametrize("samples", ["a", True, [1], math.nan, 1, -2, 2.5])
def test_samples_that_are_none(samples):
    message = f"samples: {samples!r}; expected a whole number of at least 2"
    refused(message, lambda: kernel(samples=samples), HoldfastError)


# memory


def test_march_beyond_the_machine_says_how_much_it_needs_and_what_to_do():
    grid = hf.grid(CART, BOX, 400_000)
    with pytest.raises(
        SimulationError,
        match=r"160,000,000,000 nodes take 5.96e\+03 GiB, this machine has .*; expected at most 70 % "
        r'of it; take fewer nodes, or precision="float32"',
    ):
        kernel(grid=grid)
    with pytest.raises(
        SimulationError, match=r"take 2.98e\+03 GiB.*; take fewer nodes, or march from a disk"
    ):
        kernel(grid=grid, precision="float32")


def test_memory_is_known_before_the_march_and_said_after_it():
    grid = hf.grid(CART, BOX, 41)
    node = grid.nodes
    assert hf.march_memory(grid) == 5 * 8 * node
    assert hf.march_memory(grid, precision="float32", scheme="upwind") == 2 * 4 * node
    assert hf.march_memory(grid, times=10) == 31 * 8 * node
    assert hf.march_memory(grid, capture=True) == 9 * 8 * node
    assert hf.march_memory(grid, capture=True, least_times=False) == 6 * 8 * node
    assert hf.march_memory(grid, check_outside=True) == (9 * 8 + 1) * node
    found = kernel(grid=grid)
    assert found.dataset.attrs["memory_bytes"] == hf.march_memory(grid)
    basin = hf.capture_basin(CART, WALLS, None, grid, 0.1, precision="float32")
    said = hf.march_memory(grid, capture=True, precision="float32")
    assert basin.dataset.attrs["memory_bytes"] == said
    refused("times: -1; expected a whole number", lambda: hf.march_memory(grid, times=-1))
    refused("unknown option 'horizon'", lambda: hf.march_memory(grid, horizon=3))


def test_remedy_for_too_many_runs_is_another():
    with pytest.raises(SimulationError, match="raise record_every, or simulate fewer runs"):
        closed_loop.check_memory(10**18, "runs")
