"""The leaf of a stage and the sweep that calls it agree on where things are."""

import numpy as np
import sympy as sp

import holdfast as hf
from holdfast.execution.level_set import stage_leaf, stencils


def test_sweep_and_stage_count_the_same_places():
    places = [getattr(stencils, name.upper()) for name in stage_leaf.PLACES]
    assert places == list(range(len(places)))
    assert len(places) == stencils.SLOPES
    assert stencils.PITCH == stage_leaf.PITCH


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
