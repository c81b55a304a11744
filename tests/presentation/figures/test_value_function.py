"""A value function as a picture: the set where it is, with units, and words where it is empty."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.value_function import to_value_function
from holdfast.errors import OutputError, SimulationError
from holdfast.maths.definitions.region import Circle, Segment
from holdfast.presentation.figures import level_sets

STATES = {
    "x": ("m", -2.0, 2.0, "contained"),
    "y": ("m", -2.0, 2.0, "contained"),
    "psi": ("rad", -np.pi, np.pi, "periodic"),
    "u": ("m/s", 0.5, 1.5, "contained"),
    "v": ("m/s", -1.0, 1.0, "contained"),
    "r": ("rad/s", -1.0, 1.0, "contained"),
}


def axis(name, nodes):
    unit, low, high, ends = STATES[name]
    return Axis(hf.Quantity(name, unit, angle=name == "psi"), low, high, nodes, ends)


def ball(*names, radius=1.0, nodes=9, times=None, attributes=None, arrival=False):
    """1 - |q| in the first two states, shallower along the others; at several times it shrinks."""
    grid = Grid(tuple(axis(n, nodes) for n in names))
    mesh = np.meshgrid(*(a.nodes for a in grid.axes), indexing="ij")
    distance = np.sqrt(sum(m**2 for m in mesh[:2]))
    values = radius - distance - sum(0.1 * np.cos(m) for m in mesh[2:])
    if times:
        values = np.stack([values - 0.1 * t for t in times])
    report = Report(**{"value_unit": "m"} | (attributes or {}))
    seconds = np.where(values > 0, distance, np.nan) if arrival else None
    return to_value_function(grid, values, report, times=times, arrival=seconds)


def texts(figure):
    return [t.get_text() for legend in figure.legends for t in legend.get_texts()]


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


def drawn(*arguments, **options):
    figure = hf.value_function_figure(*arguments, **options)
    figure.canvas.draw()
    return figure, [a for a in figure.axes if a.get_visible()]


def test_one_state_shows_the_value_with_the_set_shaded():
    figure, (panel,) = drawn(ball("x", nodes=41), others={"before": ball("x", radius=1.5)})
    assert panel.get_xlabel() == "$x$ [m]"
    assert panel.get_ylabel() == "$V$ [m]"
    assert texts(figure) == ["in the set", "$V$", "before"]
    (shade,) = panel.collections
    corners = shade.get_paths()[0].vertices[:, 0]
    assert (corners.min(), corners.max()) == pytest.approx((-1, 1))


def test_two_states_are_colours_about_zero_with_the_edge_of_the_set():
    figure, (panel,) = drawn(ball("x", "y", nodes=81), label="kernel")
    filled, edge = panel.collections
    assert filled.levels[0] == -filled.levels[-1]
    assert 0.0 in filled.levels
    points = np.vstack([p.vertices for p in edge.get_paths()])
    assert np.hypot(*points.T) == pytest.approx(1, abs=2e-3)
    assert panel.get_aspect() == 1
    assert texts(figure) == ["kernel"]
    (bar,) = panel.child_axes
    assert bar.get_ylabel() == "$V$ [m]"


def test_scales_are_equal_between_lengths_only():
    _, (panel,) = drawn(ball("x", "v"))
    assert panel.get_aspect() == "auto"
    assert panel.get_ylabel() == "$v$ [m/s]"


def test_several_times_are_lines_named_in_seconds():
    figure, (panel,) = drawn(ball("x", "y", nodes=41, times=[1.0, 2.0, 3.0]))
    assert texts(figure) == ["1 s", "2 s", "3 s"]
    edges = panel.collections[1:]
    assert len(edges) == 3
    sizes = [np.hypot(*e.get_paths()[0].vertices.T).max() for e in edges]
    assert sizes == pytest.approx([0.9, 0.8, 0.7], abs=0.02)
    colours = [tuple(e.get_edgecolor()[0]) for e in edges]
    assert len(set(colours)) == 3


@pytest.mark.few("names0")
@pytest.mark.parametrize("names", [("x", "y", "psi"), ("x", "y", "psi", "u"), tuple(STATES)])
def test_more_states_are_five_slices_and_a_projection(names):
    whole = ball(*names, nodes=7)
    figure, panels = drawn(whole, others={"start": ball(*names, radius=1.4, nodes=7)})
    titles = [p.get_title() for p in panels]
    assert len(titles) == 6
    assert all(t.startswith(r"$\psi$ = ") and "rad" in t for t in titles[:5])
    assert titles[5].startswith("projection, any ")
    assert all(f"${n}$" in titles[5] for n in names[3:])
    assert texts(figure) == ["in the set", "start"]
    held = figure.get_suptitle()
    assert ("$u$ = 1 m/s" in held) == ("u" in names)
    assert ("$v$ = 0 m/s" in held) == ("v" in names)


def test_slices_and_plane_are_at_the_choice_of_the_reader():
    whole = ball("x", "y", "psi", "v")
    _, panels = drawn(whole, plane=("psi", "y"), at={"x": [-0.5, 0.5], "v": 0.25})
    assert [p.get_title() for p in panels] == [
        "$x$ = -0.5 m", "$x$ = 0.5 m", "projection, any $x$",
    ]  # fmt: skip
    assert panels[0].get_xlabel() == r"$\psi$ [rad]"
    assert panels[0].get_ylabel() == "$y$ [m]"


def test_turn_is_closed_in_the_picture():
    whole = ball("psi", "v", nodes=8)
    x, y = level_sets.mesh(whole, ("v", "psi"))
    table = level_sets.on_mesh(whole, ("v", "psi"), whole.values())
    assert y[-1] == pytest.approx(np.pi)
    assert table.shape == (9, 8)
    assert table[-1] == pytest.approx(table[0])
    assert x[-1] == pytest.approx(1)


def test_capture_basin_shows_its_least_times_up_to_its_edge():
    basin = ball("x", "y", "v", nodes=21, arrival=True)
    figure, (panel,) = drawn(basin, at={"v": 0})
    (bar,) = panel.child_axes
    assert bar.get_ylabel() == "least time [s]"
    filled = panel.collections[0]
    assert filled.get_clip_path() is not None
    assert filled.levels[0] == 0
    assert texts(figure) == ["in the set"]


@pytest.mark.few(
    "True-names0--5.0-empty: no node-empty",
    "True-names0-9.0-every node of the grid-full",
    "False-names0--5.0-empty: no node-empty",
    "False-names0-9.0-every node of the grid-full",
)
@pytest.mark.parametrize(
    ("radius", "said", "where"),
    [(-5.0, "empty: no node", "empty"), (9.0, "every node of the grid", "full")],
)
@pytest.mark.parametrize("names", [("x",), ("x", "y"), ("x", "y", "psi")])
@pytest.mark.parametrize("arrival", [True, False])
def test_empty_and_full_sets_are_told_in_words(radius, said, where, names, arrival):
    figure, panels = drawn(ball(*names, radius=radius, arrival=arrival))
    assert said in figure.get_suptitle()
    if len(names) == 3:
        assert all(f"({where})" in p.get_title() for p in panels)


def test_title_says_what_the_answer_is_worth():
    said = {"kind": "viability-kernel", "region": "two_walls", "system": "cart", "reached_s": 2.5}
    figure, _ = drawn(ball("x", attributes=said | {"converged": 0}))
    assert figure.get_suptitle() == "viability kernel of two walls, cart\nfor 2.5 s, not converged"
    figure, _ = drawn(ball("x", attributes=said | {"converged": 1}))
    assert figure.get_suptitle().endswith("\nconverged after 2.5 s")


def test_shapes_stand_in_every_panel():
    radius = hf.symbol("radius")
    wall = Segment("wall", (sp.S.Zero, sp.S(-1)), (sp.S.Zero, sp.S.One))
    rock = Circle("rock", (sp.S.One, sp.S.Zero), radius)
    figure, panels = drawn(ball("x", "y", "v"), scene=(wall, rock), parameters={"radius": 0.2})
    assert texts(figure) == ["in the set", "wall", "rock"]
    assert [p.patches[0].get_radius() for p in panels] == [0.2] * 6


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"plane": ("x", "z")}, r"the plane is \(x, z\); expected two of the states x, y, psi"),
        ({"plane": ("x", "x")}, "expected two of the states"),
        ({"plane": ("x", "y"), "at": {"x": 0}}, "expected two of the states y, psi"),
        ({"at": {"heading": 0}}, "'heading' is not a state; allowed: psi, x, y"),
        ({"at": {"x": 0, "y": 0, "psi": 0}}, "the states to draw are: none"),
        ({"at": {"x": [0, 1], "y": [0, 1]}}, "several values of at most one other"),
        ({"others": {"safe set": ball("x", "y")}}, "'safe set' is a value function of x, y"),
    ],
)
def test_what_cannot_be_drawn_is_refused(options, said):
    with pytest.raises(OutputError, match=said):
        hf.value_function_figure(ball("x", "y", "psi"), **options)


def test_state_held_outside_the_grid_is_refused():
    with pytest.raises(SimulationError, match="'x' at 5 is outside the grid; expected -2 to 2"):
        hf.value_function_figure(ball("x", "y", "psi"), at={"x": 5})
