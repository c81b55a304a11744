"""The law in a plane: colours by the sign of an input, arrows that are ways in a short time."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.quiver import Quiver

import holdfast as hf
from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.value_function import to_value_function
from holdfast.errors import OutputError
from holdfast.presentation.figures.value_function import NEGATIVE, POSITIVE


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


def value(*names, counts=(21, 17, 5)):
    axes = tuple(
        Axis(hf.Quantity(n, "m"), -2.0, 2.0, c, "contained")
        for n, c in zip(names, counts, strict=False)
    )
    mesh = np.meshgrid(*(a.nodes for a in axes), indexing="ij")
    return to_value_function(Grid(axes), 1 - np.hypot(mesh[0], mesh[1]), Report(value_unit="m"))


def coordinates(shown):
    return np.meshgrid(*(a.nodes for a in shown.grid.axes[:2]), indexing="ij")


def colour_at(panel, point):
    (found,) = {
        colour
        for s in panel.collections[:1]
        for path, colour in zip(
            s.get_paths(), (tuple(np.round(c, 3)) for c in s.get_facecolor()), strict=True
        )
        if path.contains_point(point)
    }
    return found


@pytest.mark.slow("True")
@pytest.mark.parametrize("turned", [False, True])
def test_colours_and_arrows_lie_where_their_nodes_are(turned):
    shown = value("x", "y")
    x, y = coordinates(shown)
    plane = ("y", "x") if turned else ("x", "y")
    arrays = {"u": x, "r": -y}
    velocity = (-x, -y)
    if turned:
        arrays, velocity = {k: a.T for k, a in arrays.items()}, (-y.T, -x.T)
    figure = hf.optimal_input_figure(shown, arrays, velocity, plane=plane)
    figure.canvas.draw()
    first, second = figure.axes
    assert (first.get_title(), second.get_title()) == ("sign of $u$", "sign of $r$")
    point = (0.4, 1.2) if turned else (1.2, 0.4)  # x = 1.2, y = 0.4
    tints = {
        name: tuple(np.round(plt.matplotlib.colors.to_rgba(c), 3))
        for name, c in (("positive", POSITIVE), ("negative", NEGATIVE))
    }
    assert colour_at(first, point) == tints["positive"]
    assert colour_at(second, point) == tints["negative"]
    inside, outside = (c for c in first.collections if isinstance(c, Quiver))
    for arrows in (inside, outside):
        ways = np.stack([arrows.U, arrows.V], axis=1)
        assert ways == pytest.approx(-0.1 * arrows.XY)  # towards the origin, in 0.1 s
    assert np.hypot(*inside.XY.T).max() < 1
    assert np.hypot(*outside.XY.T).min() >= 1
    texts = [t.get_text() for t in figure.legends[0].get_texts()]
    assert texts == ["≥ 0", "< 0", "edge of the set", "displacement in 0.1 s"]


def test_nodes_that_are_no_number_have_no_colour_and_no_arrow():
    shown = value("x", "y")
    x, y = coordinates(shown)
    hidden = np.where(x > 0, np.nan, y)
    figure = hf.optimal_input_figure(shown, {"u": hidden}, (hidden, y))
    (panel,) = figure.axes
    for arrows in (c for c in panel.collections if isinstance(c, Quiver)):
        assert arrows.XY[:, 0].max() <= 0


def test_other_states_are_held_and_said():
    whole = value("x", "y", "z")
    x, y = np.meshgrid(*(a.nodes for a in whole.grid.axes[:2]), indexing="ij")
    figure = hf.optimal_input_figure(whole, {"u": x}, (x, y), at={"z": 0.5})
    assert figure.get_suptitle().endswith("$z$ = 0.5 m")
    with pytest.raises(OutputError, match="number of states to draw is not two; expected a plane"):
        hf.optimal_input_figure(whole, {"u": x}, (x, y))


def test_arrays_of_another_shape_are_refused():
    shown = value("x", "y")
    x, y = coordinates(shown)
    with pytest.raises(OutputError, match=r"'u' has the shape \(17, 21\); expected \(21, 17\)"):
        hf.optimal_input_figure(shown, {"u": x.T}, (x, y))
    with pytest.raises(OutputError, match="'velocity in y' has the shape"):
        hf.optimal_input_figure(shown, {"u": x}, (x, y[:5]))
    with pytest.raises(OutputError, match="no input to draw"):
        hf.optimal_input_figure(shown, {}, (x, y))
