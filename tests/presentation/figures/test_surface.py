"""A set of three states as a body: the surface is closed and lies where the value is zero."""

from collections import Counter

import matplotlib.pyplot as plt
import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.value_function import to_value_function
from holdfast.errors import OutputError
from holdfast.presentation.figures.surface import zero_surface


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


def ball(radius, names=("x", "y", "z"), count=15):
    axes = tuple(Axis(hf.Quantity(n, "m"), -2.0, 2.0, count, "contained") for n in names)
    mesh = np.meshgrid(*(a.nodes for a in axes), indexing="ij")
    return to_value_function(Grid(axes), radius - np.sqrt(sum(m**2 for m in mesh)), Report())


def enclosed(faces):
    """Six times the volume between the faces and the origin, of a body around the origin."""
    return np.abs(np.linalg.det(faces)).sum() / 6


def surface(value):
    return zero_surface([a.nodes for a in value.grid.axes], value.values())


def test_surface_of_a_ball_has_its_radius_and_its_volume():
    faces = surface(ball(1.5, count=41))
    assert np.linalg.norm(faces, axis=2) == pytest.approx(1.5, abs=5e-3)
    assert enclosed(faces) == pytest.approx(4 / 3 * np.pi * 1.5**3, rel=0.01)


def test_every_edge_of_the_surface_belongs_to_two_triangles():
    faces = np.round(surface(ball(1.234, count=12)), 9)
    edges = Counter(
        frozenset((tuple(f[i]), tuple(f[(i + 1) % 3]))) for f in faces for i in range(3)
    )
    assert {n for e, n in edges.items() if len(e) == 2} == {2}


def test_set_that_goes_on_beyond_the_grid_is_cut_flat():
    faces = surface(ball(9.0))
    assert np.abs(faces).max(axis=(1, 2)) == pytest.approx(2.0)
    assert enclosed(faces) == pytest.approx(4.0**3, rel=1e-6)


def test_bodies_stand_side_by_side_with_units_and_names():
    figure = hf.surface_figure(ball(1.0), others={"before": ball(1.5)}, label="kernel")
    figure.canvas.draw()
    assert [a.get_title() for a in figure.axes] == ["before", "kernel"]
    for panel in figure.axes:
        assert (panel.get_xlabel(), panel.get_zlabel()) == ("$x$ [m]", "$z$ [m]")
        assert len(panel.collections) == 1


def test_empty_and_full_sets_are_told_in_words():
    for radius, said, bodies in ((-1.0, "empty", 0), (9.0, "full", 1)):
        (panel,) = hf.surface_figure(ball(radius)).axes
        assert panel.get_title() == f"in the set ({said})"
        assert len(panel.collections) == bodies


def test_three_states_are_needed():
    whole = ball(1.0, ("x", "y", "z", "w"), count=5)
    figure = hf.surface_figure(whole, at={"y": 0.5})
    assert figure.axes[0].get_ylabel() == "$z$ [m]"
    assert figure.get_suptitle().endswith("$y$ = 0.5 m")
    with pytest.raises(
        OutputError, match="states to draw are: x, y, z, w; expected three; fix the"
    ):
        hf.surface_figure(whole)
    with pytest.raises(OutputError, match="'other' is a value function of x, y"):
        hf.surface_figure(ball(1.0), others={"other": ball(1.0, ("x", "y"))})
