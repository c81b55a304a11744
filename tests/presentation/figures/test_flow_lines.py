"""Flow-line figures say what they show: units, equal axes, sectors, and the classification."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Wedge

import holdfast as hf
from holdfast.maths.catalogue import fields
from holdfast.maths.reference_fields.field import Field
from holdfast.presentation.figures import style
from holdfast.presentation.figures.flow_lines import flow_lines_figure


def text_of(figure):
    figure.canvas.draw()
    (legend,) = figure.legends
    (axis,) = figure.axes
    return axis, axis.get_title(), [t.get_text() for t in legend.get_texts()]


@pytest.mark.few("dipolar")
@pytest.mark.parametrize(
    ("field", "unit"),
    [
        (fields.dipolar(), "m"),
        (fields.dipolar(lam=2.0, moment=(2**-0.5, 2**-0.5)), "m"),
        (fields.dipole_like(), "1"),
        (fields.electric_dipole(moment=(1e-9, 0.0)), "m"),
        (fields.dipole_like(moment=(0.0, 1.0, 1.0)), "1"),
        (fields.dipolar(moment=(1.0, 0.0, 0.0, 1.0)), "m"),
    ],
    ids=["dipolar", "at 45 deg", "dipole_like", "electric", "in a plane of 3", "in a plane of 4"],
)
def test_planar_figure_names_the_rose_and_its_sectors(field, unit):
    figure = flow_lines_figure(field, reach=2.0)
    axis, title, entries = text_of(figure)
    assert "rose, two elliptic sectors, index 2" in title
    assert ("each plane through p" in title) == (field.dimension > 2)
    assert any(e.startswith("elliptic sector (2)") for e in entries)
    assert {"flow line", "critical point", "direction of p"} <= set(entries)
    assert len(entries) == len(set(entries))
    assert axis.get_aspect() == 1
    for label in (axis.get_xlabel(), axis.get_ylabel()):
        assert ("[m]" in label) == (unit == "m")
        assert "[1]" not in label
    plt.close(figure)


@pytest.mark.heavy
def test_potential_is_drawn_where_there_is_one():
    """Thesis Fig. 2.1: field lines and equipotential lines; the charges are nodes."""
    figure = flow_lines_figure(fields.charge_pair())
    _, title, entries = text_of(figure)
    assert "2 times node, one parabolic sector, index 1" in title
    assert "equipotential" in entries
    plt.close(figure)
    assert "equipotential" not in text_of(flow_lines_figure(fields.dipolar()))[2]
    plt.close("all")


def test_sectors_of_a_local_picture_stay_near_the_point():
    for field, wide in ((fields.dipolar(), True), (fields.dipole_like(), False)):
        figure = flow_lines_figure(field, reach=2.0)
        _, _, entries = text_of(figure)
        radii = [w.r for w in figure.axes[0].patches if isinstance(w, Wedge)]
        assert len(radii) == 2
        assert all((r > 2.0) == wide for r in radii)
        assert ("elliptic sector (2), near the point" in entries) != wide
        plt.close(figure)


def test_drawn_loops_close_at_the_origin():
    figure = flow_lines_figure(fields.dipolar())
    curves = [np.column_stack(x.get_data()) for x in figure.axes[0].get_lines()]
    loops = [c for c in curves if len(c) == 400 and np.abs(c[:, 1]).max() > 0.1]
    assert len(loops) == 18
    for loop in loops:
        assert np.abs(loop[[0, -1]]).max() < 1e-9
        assert loop[200, 0] < loop[100, 0]  # away from the axis the field runs against p
    plt.close(figure)


def test_each_of_two_nodes_is_marked_and_counted():
    figure = flow_lines_figure(fields.dipole_like(exponential=False), reach=2.0)
    _, title, entries = text_of(figure)
    assert "2 times node, four parabolic sectors, index 1" in title
    assert "parabolic sector (8), near the point" in entries
    (dots,) = [x for x in figure.axes[0].get_lines() if x.get_label() == "critical point"]
    assert sorted(dots.get_xdata()) == pytest.approx([-(3**-0.5), 3**-0.5])
    plt.close(figure)


def test_field_without_axis_is_drawn_without_one():
    x, y = hf.symbol("x"), hf.symbol("y")
    saddle = Field("saddle", (hf.Quantity("x", "m"), hf.Quantity("y", "m")), (x, -y))
    figure = flow_lines_figure(saddle)
    _, title, entries = text_of(figure)
    assert "cross point, four hyperbolic sectors, index -1" in title
    assert "direction of p" not in entries
    plt.close(figure)


@pytest.mark.few("moment0")
@pytest.mark.parametrize("moment", [(1.0, 0.0, 0.0), (1.0, 1.0, 1.0)])
def test_loops_in_space_lie_in_planes_through_the_moment(moment, tmp_path):
    figure = flow_lines_figure(fields.dipolar(moment=moment), planes=3)
    axis, title, entries = text_of(figure)
    assert axis.name == "3d"
    assert "each plane through p: rose, two elliptic sectors, index 2" in title
    assert [e for e in entries if e.startswith("plane at")] == [
        f"plane at {angle} deg" for angle in (0, 60, 120)
    ]
    p = np.array(moment) / np.linalg.norm(moment)
    loops = [np.column_stack(x.get_data_3d()) for x in axis.get_lines()]
    loops = [c for c in loops if len(c) == 400]
    assert len(loops) == 3 * 2 * 3
    for loop in loops:
        normal = np.cross(p, loop[200])
        assert np.abs(loop @ normal).max() < 1e-12
    assert {f"[{u}]" in axis.get_zlabel() for u in ("m",)} == {True}
    written = style.write(figure, tmp_path, "loops")
    assert {f.suffix for f in written} == {".png", ".svg"}
    assert all(f.stat().st_size > 5000 for f in written)
