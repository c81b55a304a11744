"""The leaf of a stage and the sweep that calls it agree on where things are."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.execution.arithmetic.elementary import sine_and_cosine
from holdfast.execution.arithmetic.steps import Steps, choose, only_where
from holdfast.execution.codegen.llvm_text import LANES, Leaf
from holdfast.execution.leaf import compiled_leaves
from holdfast.execution.level_set import stage_leaf, stencils


def test_sweep_and_stage_count_the_same_places():
    places = [getattr(stencils, name.upper()) for name in stage_leaf.PLACES]
    assert places == list(range(len(places)))
    assert len(places) == stencils.SLOPES


def test_functions_at_a_node_may_have_a_rare_case():
    """The sine of a product of two states, which is small nearly everywhere."""
    x, y, u = (hf.symbol(n) for n in "xyu")
    states = (hf.Quantity("x", "1"), hf.Quantity("y", "1"))
    system = hf.System(
        "swirl", states, (hf.Quantity("u", "1"),), {"x": sp.sin(1e4 * x * y), "y": u},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    region = hf.Region("disc", states, (hf.Inequality("edge", x**2 + y**2 - 1),))
    found = [
        hf.viability_kernel(
            system, region, hf.grid(system, {"x": (-s, s), "y": (-s, s)}, 21), horizon=0.01,
            scheme="upwind",
        ).values()
        for s in (1.2, 120.0)
    ]  # fmt: skip
    assert np.isfinite(found).all()


def test_an_unusual_value_is_that_of_the_lanes_that_need_it():
    """Its steps have a rare case of their own, the sine of a large number."""
    steps = Steps(expanded=True)
    x = steps.input("x")
    far = x > 1.0
    unusual = choose(far, sine_and_cosine(1e9 * x)[0], x)
    results = [only_where(far, unusual, x), unusual]
    leaves = compiled_leaves({"both": Leaf(steps, {"q": ["x"]}, results)})
    points = np.linspace(0.0, 1.0, 3 * LANES)  # no lane of the first two blocks needs it,
    points[-1], points[-2] = 3.0, np.nan  # one of the last does
    skipped, computed = leaves.values("both", len(points), 2, points[:, np.newaxis]).T
    np.testing.assert_array_equal(skipped, computed)
    assert skipped[-1] == pytest.approx(np.sin(3e9), abs=1e-14)
    np.testing.assert_array_equal(skipped[:-1], points[:-1])
