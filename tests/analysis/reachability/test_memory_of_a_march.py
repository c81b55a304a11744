"""The memory that a march takes is what was said, and what it does not return is given back."""

import gc
import tracemalloc
from collections.abc import Callable

import pytest

import holdfast as hf
from tests.carts import BOX, STATES, WALLS, cart

ORIGIN = hf.Region("origin", STATES[:1], (
    hf.Inequality("near", hf.symbol("x") ** 2 - 0.04, "m^2"),
))  # fmt: skip
NODES = 601  # so that the scratch of a sweep, which no node has, is little beside them

MARCHES: dict[str, Callable] = {
    "kernel": lambda grid, **o: hf.discriminating_kernel(cart(), WALLS, grid, 0.1, **o),
    "tube": lambda grid, **o: hf.backward_reachable_tube(cart(), ORIGIN, grid, 0.1, **o),
    "basin": lambda grid, **o: hf.capture_basin(cart(), ORIGIN, WALLS, grid, 0.1, **o),
}


def traced(march, grid, **options):
    """The most and the last bytes, in the values of a grid; nothing is collected meanwhile."""
    march(hf.grid(cart(), BOX, 21), **options)  # what is compiled and imported once
    gc.collect()
    gc.disable()
    try:
        tracemalloc.start()
        found = march(grid, **options)
        now, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    finally:
        gc.enable()
    size = 4 if options.get("precision") == "float32" else 8
    del found
    return most / (size * grid.nodes), now / (size * grid.nodes)


@pytest.mark.heavy
@pytest.mark.parametrize("scheme", ["upwind", pytest.param("weno5", marks=pytest.mark.heavy)])
@pytest.mark.parametrize("outside", [False, True], ids=["alone", "with outside"])
@pytest.mark.parametrize("kind", ["tube", "basin"])
def test_a_march_takes_the_memory_that_is_said_beforehand(kind, outside, scheme):
    grid = hf.grid(cart(), BOX, NODES)
    options = {"scheme": scheme, "check_outside": outside}
    said = hf.march_memory(grid, capture=kind == "basin", opposed=True, **options)
    said /= 8 * grid.nodes
    most, _ = traced(MARCHES[kind], grid, threads=1, **options)
    assert 0.8 * said < most < 1.1 * said


@pytest.mark.few("kernel-1")
@pytest.mark.parametrize(("kind", "kept"), [("kernel", 1), ("tube", 1), ("basin", 2)])
def test_after_a_march_nothing_is_held_but_its_answer(kind, kept):
    _, held = traced(MARCHES[kind], hf.grid(cart(), BOX, NODES), scheme="upwind", threads=1)
    assert kept <= held < kept + 0.2
