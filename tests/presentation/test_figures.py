"""Figures say what they show: units, legends, and every shape of the scene."""

import matplotlib.pyplot as plt
import pytest

import holdfast as hf
from holdfast.errors import OutputError
from holdfast.presentation import style
from holdfast.presentation.text import summary_text


@pytest.fixture(scope="module", params=["inspection", "ch5-viable-goal-set", "wheeled_camera"])
def result(request):
    return hf.load_scenario(request.param, ["run.horizon=20"], runs=12).run()


def test_paths_have_equal_axes_units_and_one_legend(result):
    figure = hf.paths_figure(result, cone_run=1)
    figure.canvas.draw()
    for axis in figure.axes:
        assert axis.get_aspect() == 1
        assert "[m]" in axis.get_xlabel()
    (legend,) = figure.legends
    texts = [t.get_text() for t in legend.get_texts()]
    assert len(texts) == len(set(texts))
    assert {"start", "vehicle", "view"} <= set(texts)
    assert any(t.startswith("reached goal (") or t.startswith("stayed (") for t in texts)
    plt.close(figure)


def test_histories_show_every_state_input_constraint_and_signal_with_its_unit(result):
    figure = hf.histories_figure(result, 1)
    figure.canvas.draw()
    data = result.dataset
    lines = sum(
        len([x for x in a.get_lines() if not x.get_label().startswith("_")])
        for a in figure.axes
        if a.get_visible()
    )
    inputs = data.sizes["actuator"] or data.sizes["input"]
    assert lines == (data.sizes["state"] + inputs + data.sizes["constraint"] + data.sizes["signal"])
    labels = {a.get_ylabel() for a in figure.axes}
    assert {f"[{u}]" for u in data["state_unit"].values} <= labels
    plt.close(figure)


def test_no_text_of_a_figure_overlaps_another(result):
    figure = hf.histories_figure(result, 0)
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    boxes = []
    for axis in figure.axes:
        if axis.get_visible():
            for text in (axis.title, axis._left_title, axis.yaxis.label, axis.xaxis.label):
                if text.get_text() and text.get_visible():
                    boxes.append(text.get_window_extent(renderer))
    for i, a in enumerate(boxes):
        assert not any(a.overlaps(b) for b in boxes[i + 1 :])
    plt.close(figure)


def test_figures_are_written_as_png_and_svg(result, tmp_path):
    names = [p.name for p in style.write(hf.paths_figure(result), tmp_path, "paths")]
    assert names == ["paths.png", "paths.svg"]
    assert (tmp_path / "paths.png").read_bytes().startswith(b"\x89PNG")
    assert "</svg>" in (tmp_path / "paths.svg").read_text()[-200:]
    assert sorted(p.name for p in tmp_path.iterdir()) == names


def test_a_run_that_does_not_exist_cannot_be_drawn(result):
    with pytest.raises(OutputError, match="expected 0 to 11"):
        hf.histories_figure(result, 12)


def test_summary_names_viability_worst_constraints_and_peaks(result):
    text = summary_text(result)
    assert "viable         12 of 12 runs" in text
    assert "peak" in text
    for name in result.dataset["constraint_name"].values:
        assert str(name).replace("_", " ") in text


def test_names_are_set_as_mathematics():
    assert style.label("psi") == r"$\psi$"
    assert style.label("tau_u") == r"$\tau_{\mathrm{u}}$"
    assert style.label("distance") == "distance"
