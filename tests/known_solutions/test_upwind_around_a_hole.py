"""A hole that states drift into: how far schemes of first order enlarge the set beside it."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.reachability.problem import Posed

X, U = hf.symbol("x"), hf.symbol("u")
HORIZON = 0.54  # s


def rate(x):
    """At the best input."""
    return 0.78 - 1.47 * np.sin(1.79 * x)


def first_kept():
    """Backwards from the upper rim of the hole, along the best input."""
    x, steps = 0.49 + np.sqrt(0.02), 5400
    h = -HORIZON / steps
    for _ in range(steps):
        k1 = rate(x)
        k2 = rate(x + 0.5 * h * k1)
        x += h * k2
    return x


def cells_too_large(scheme, dissipation, nodes):
    line = hf.System(
        "line", (hf.Quantity("x", "m"),), (hf.Quantity("u"),),
        {"x": 0.78 * U - 1.47 * sp.sin(1.79 * X)}, input_bounds=hf.Box((0.15,), (1,)),
    )  # fmt: skip
    walls = (X - 1.05, -1.05 - X, 0.02 - (X - 0.49) ** 2)
    room = hf.Region(
        "room", line.states, tuple(hf.Inequality(f"c{i}", e) for i, e in enumerate(walls))
    )
    grid = hf.grid(line, {"x": (-1.0815, 1.0815)}, nodes)
    kernel = hf.viability_kernel(line, room, grid, HORIZON, scheme=scheme, dissipation=dissipation)
    states = np.linspace(0.64, 1.05, 8001)
    first = states[kernel.contains(states[:, None])].min()
    return (first_kept() - first) / grid.axes[0].step


@pytest.mark.slow("global-0.9-51", "global-0.9-401", "local-0.9-51", "local-0.9-401")
@pytest.mark.parametrize("nodes", [51, 101, 201, 401])
@pytest.mark.parametrize(
    ("dissipation", "cells"), [("global", 0.9), ("local", 0.9), ("local-local", 1.0)]
)
def test_upwind_enlarges_a_set_where_its_value_is_convex_by_a_cell(dissipation, cells, nodes):
    assert cells_too_large("upwind", dissipation, nodes) == pytest.approx(cells, abs=0.06)


def test_without_the_second_march_global_speeds_enlarge_it_by_more_cells_of_finer_grids(
    monkeypatch,
):
    monkeypatch.setattr(Posed, "marched_twice", False)
    cells = [cells_too_large("upwind", "global", nodes) for nodes in (51, 401)]
    assert cells == pytest.approx([2.6, 4.3], abs=0.1)


def test_weno5_does_not():
    assert abs(cells_too_large("weno5", "local-local", 201)) < 0.4


def test_empty_kernel_of_two_marches_has_converged_at_several_times_too():
    line = hf.System(
        "line", (hf.Quantity("x", "m"),), (hf.Quantity("u"),), {"x": 1 + U / 2},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    room = hf.Region("room", line.states, (hf.Inequality("far", abs(X) - 1, "m"),))
    grid = hf.grid(line, {"x": (-1.2, 1.2)}, 61)
    for options in ({}, {"times": [0.5, 20.0]}):
        found = hf.viability_kernel(
            line, room, grid, 20.0, scheme="upwind", dissipation="global", **options
        )
        assert found.report.empty
        assert found.report.converged
