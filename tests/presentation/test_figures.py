"""Figures say what they show: units, legends, and every shape of the scene."""

import os
import subprocess
import sys

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import same_color, to_rgb

import holdfast as hf
from holdfast.errors import OutputError
from holdfast.presentation.figures import style
from holdfast.presentation.html.interactive import paths_data
from holdfast.presentation.text.runs import summary_text


@pytest.fixture(scope="module", params=["inspection", "ch5-viable-goal-set", "wheeled_camera"])
def result(request):
    return hf.load_scenario(request.param, ["run.horizon=20"], runs=12).run()


@pytest.mark.few("ch5-viable-goal-set")
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


@pytest.mark.few("wheeled_camera")
def test_histories_show_every_state_input_constraint_and_signal_with_its_unit(result):
    figure = hf.histories_figure(result, 1)
    figure.canvas.draw()
    data = result.dataset
    lines = sum(
        len([x for x in a.get_lines() if not x.get_label().startswith("_")])
        for a in figure.axes
        if a.get_visible()
    )
    drawn = "actuator" if data.sizes["actuator_name"] else "input"
    fed = len(set(data["input_unit"].values)) if drawn == "input" else 1
    names = sum(data.sizes[f"{n}_name"] for n in ("state", drawn, "constraint", "signal"))
    assert lines == names + fed * (1 + ("nominal" in data))  # the limits, and what was asked for
    labels = {a.get_ylabel() for a in figure.axes}
    assert {f"[{u}]" for u in data["state_unit"].values} <= labels
    plt.close(figure)


@pytest.fixture(scope="module")
def overruled():
    """The second start of the inspection: overruled at first, one start with weak thrusters."""
    return hf.load_scenario("inspection", ["run.horizon=20"], runs=3).run()


def panel(figure, title):
    return next(a for a in figure.axes if a.get_title(loc="left").startswith(title))


def spans(axis, colour):
    """Where a bar of the colour stands in the panel: (from, to), in seconds."""
    bars = [c for c in axis.collections if same_color(c.get_facecolor(), colour)]
    boxes = [path.get_extents() for bar in bars for path in bar.get_paths()]
    return [(box.x0, box.x1) for box in boxes]


@pytest.mark.heavy
def test_histories_show_what_the_law_asked_for_and_mark_where_it_was_overruled(overruled):
    data = overruled.dataset.copy(deep=True)
    data["safeguard"][1, 100:110] = 2  # as where no input is admissible
    figure = hf.histories_figure(hf.Result(data), 1)
    thrusts = panel(figure, "actuators")
    lines = {line.get_label(): line for line in thrusts.get_lines()}
    asked = data["nominal_actuator"].sel(run=1, actuator_name="starboard").values
    assert np.array_equal(lines["nominal"].get_ydata(), asked)
    assert set(lines) >= {"port", "starboard", "limit ±5"}
    levels = {float(line.get_ydata()[0]) for n, line in lines.items() if "limit" in n}
    assert levels == {-5.0, 5.0}
    time, answers = data["time"].values, data["safeguard"].values[1]
    assert (answers == 1).any()
    for answer, colour in ((1, style.OVERRULED), (2, style.INFEASIBLE)):
        found = spans(thrusts, colour)
        marked = [any(a - 1e-9 <= t < b - 1e-9 for a, b in found) for t in time]
        assert np.array_equal(marked, answers == answer)
    (legend,) = figure.legends
    assert {"overruled", "no admissible input"} <= {t.get_text() for t in legend.get_texts()}
    plt.close(figure)


@pytest.mark.heavy
def test_limits_out_of_reach_are_told_and_do_not_flatten_the_curves(overruled):
    data = overruled.dataset.copy(deep=True)
    data["actuator_low"][:], data["actuator_high"][:] = -500.0, 500.0
    thrusts = panel(figure := hf.histories_figure(hf.Result(data), 1), "actuators")
    assert "limit ±500" in [line.get_label() for line in thrusts.get_lines()]
    assert max(np.abs(thrusts.get_ylim())) < 50
    plt.close(figure)


def test_value_of_a_kernel_has_its_own_panel_with_its_threshold(overruled):
    data = overruled.dataset.drop_dims("signal_name")
    data = data.assign(
        signal=(
            ("run", "time", "signal_name"),
            np.ones((*data["mode"].shape, 3)),
            {"value_of_kernel": "value"},
        )
    ).assign_coords(
        signal_name=["sigma_edge", "value", "error"],
        signal_unit=("signal_name", ["1", "m", "rad"]),
    )
    kept = hf.Result(data, parameters={"safety_margin": 0.25})
    figure = hf.histories_figure(kept)
    value = panel(figure, "value of the kernel")
    assert value.get_ylabel() == "[m]"
    lines = {line.get_label(): line.get_ydata()[0] for line in value.get_lines()}
    lines = {label: level for label, level in lines.items() if label != "_mode"}
    assert lines == {"$V$": 1.0, "boundary": 0.0, "margin": 0.25}
    for title, label in (("switching signals", r"$\sigma$ edge"), ("signals", "error")):
        labels = [line.get_label() for line in panel(figure, title).get_lines()]
        assert [name for name in labels if name != "_mode"] == [label]
    plt.close(figure)


def seen_without(colour, deficiency):
    """The colour in CIE Lab as it is seen with a full deficiency (Machado et al. 2009)."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(DEFICIENCIES[deficiency]) @ linear, 0, 1)
    xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    ) @ linear / [0.9505, 1.0, 1.089]  # fmt: skip
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


DEFICIENCIES = {
    "none": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}  # fmt: skip


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
def test_every_outcome_has_a_colour_that_every_reader_tells_apart(deficiency):
    """A difference of 10 in CIE Lab is seen at a glance; 2.3 is just noticeable."""
    assert set(style.OUTCOMES) == set(hf.Outcome)
    colours = [seen_without(c, deficiency) for c in style.OUTCOMES.values()]
    colours.append(seen_without("#FFFFFF", deficiency))  # the page
    pairs = [np.linalg.norm(a - b) for i, a in enumerate(colours) for b in colours[:i]]
    assert min(pairs) > 10


def test_matplotlib_and_plotly_draw_an_outcome_in_the_same_colour(overruled):
    outcomes = list(hf.Outcome)
    runs = np.arange(len(outcomes)) % 3
    data = overruled.dataset.isel(run=runs).assign_coords(run=np.arange(len(outcomes)))
    data["outcome"] = ("run", np.array(outcomes, dtype=np.int8), data["outcome"].attrs)
    result = hf.Result(data, overruled.scene, overruled.parameters)
    traces = paths_data(result, ("x", "y"))["data"]
    labels = {o.label for o in outcomes}
    assert {t["name"]: t["line"]["color"] for t in traces if t["name"] in labels} == {
        o.label: style.OUTCOMES[o] for o in outcomes
    }
    figure = hf.paths_figure(result)
    lines = {line.get_label(): line.get_color() for line in figure.axes[0].get_lines()}
    for outcome in outcomes:
        assert lines[f"{outcome.label} (1)"] == style.OUTCOMES[outcome]
    plt.close(figure)


@pytest.mark.few("wheeled_camera")
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


@pytest.mark.few("ch5-viable-goal-set")
def test_figures_are_written_as_png_and_svg(result, tmp_path):
    names = [p.name for p in style.write(hf.paths_figure(result), tmp_path, "paths")]
    assert names == ["paths.png", "paths.svg"]
    assert (tmp_path / "paths.png").read_bytes().startswith(b"\x89PNG")
    assert "</svg>" in (tmp_path / "paths.svg").read_text()[-200:]
    assert sorted(p.name for p in tmp_path.iterdir()) == names


@pytest.mark.slow("inspection")
def test_a_run_that_does_not_exist_cannot_be_drawn(result):
    with pytest.raises(OutputError, match="expected 0 to 11"):
        hf.histories_figure(result, 12)


@pytest.mark.few("ch5-viable-goal-set", "wheeled_camera")
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


INLINE = """
import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg as FigureCanvas

matplotlib.interactive(True)  # as the backend of notebooks does
"""
FIGURE = """
import matplotlib, matplotlib.pyplot as plt
from holdfast.presentation.figures.style import look

with look():
    plt.subplots()
print(matplotlib.get_backend(), plt.isinteractive(), plt.get_fignums())
"""
COMMAND = """
import os, sys
from holdfast.__main__ import main

sys.argv = ["holdfast", "--version"]
try:
    main()
finally:
    print(os.environ["MPLBACKEND"])
"""


def test_figures_are_shown_by_the_backend_of_the_user_and_a_command_opens_no_window(tmp_path):
    """In a notebook figures appear; a command, whatever the user's backend, only writes files."""
    (tmp_path / "inline.py").write_text(INLINE)
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    backend = {"MPLBACKEND": "module://inline", "PYTHONPATH": os.pathsep.join(paths)}
    shown, written = (
        subprocess.run(
            [sys.executable, "-c", code], env=os.environ | backend, capture_output=True, text=True
        )
        for code in (FIGURE, COMMAND)
    )
    assert shown.stdout.split() == ["module://inline", "True", "[1]"], shown.stderr
    assert written.stdout.splitlines()[-1] == "Agg", written.stderr
