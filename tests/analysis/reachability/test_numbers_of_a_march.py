"""Numbers are handed to a march when it runs: another bound or disturbance needs no new program."""

import sys

import pytest

import holdfast as hf
from holdfast.errors import DefinitionError

X, V, U, D = (hf.symbol(n) for n in ("x", "v", "u", "d"))
LIMIT = hf.Parameter("limit", "m/s^2", value=0.5)
CART = hf.System(
    "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
    {"x": V, "v": U + D}, disturbances=(hf.Quantity("d", "m/s^2"),), parameters=(LIMIT,),
    input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-LIMIT.symbol,), (LIMIT.symbol,)),
)  # fmt: skip
WALLS = hf.Region("walls", CART.states[:1], (hf.Inequality("walls", X**2 - 1, "m^2"),))
GRID = hf.grid(CART, {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}, 41)


def programs():
    return {name for name in sys.modules if name.startswith("sweep_")}


def test_another_bound_of_the_disturbance_needs_no_new_program():
    small = hf.discriminating_kernel(CART, WALLS, GRID, 1.0, parameters={"limit": 0.2})
    before = programs()
    large = hf.discriminating_kernel(CART, WALLS, GRID, 1.0, parameters={"limit": 0.7})
    assert programs() == before
    assert large.volume() < 0.9 * small.volume()


def test_another_given_disturbance_needs_no_new_program():
    one = hf.viability_kernel(CART, WALLS, GRID, 1.0, disturbance={"d": 0.2})
    before = programs()
    other = hf.viability_kernel(CART, WALLS, GRID, 1.0, disturbance={"d": -0.4})
    assert programs() == before
    assert other.at([[-0.8, -0.5]]) < one.at([[-0.8, -0.5]])
    assert "given" not in other.dataset.attrs["parameters"]
    assert other.dataset.attrs["disturbance"] == '{"d": -0.4}'


def test_bounds_that_contradict_themselves_with_these_numbers_are_refused():
    with pytest.raises(DefinitionError, match="empty interval"):
        hf.discriminating_kernel(CART, WALLS, GRID, 1.0, parameters={"limit": -0.2})
