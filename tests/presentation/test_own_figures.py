"""What a user defines is drawn: constraints, obstacles, the goal, trailers, and titles."""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest
import sympy as sp
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import same_color
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

import holdfast as hf
from holdfast.errors import OutputError, ScenarioError
from holdfast.maths.definitions.region import ZeroLevel, drawn_shapes
from holdfast.presentation.figures import style
from holdfast.presentation.figures.value_function import told
from holdfast.presentation.figures.zero_levels import PlaneLevels
from holdfast.presentation.html.interactive import paths_data

X, Y, PSI, V, W = (hf.symbol(n) for n in ("x", "y", "psi", "v", "w"))
PLANE = (-6.0, 14.0, -6.0, 6.0)


def disc(name, x, y, radius, sign=1):
    return hf.Inequality(name, sign * (radius - sp.sqrt((X - x) ** 2 + (Y - y) ** 2)), "m")


FIELD = (
    disc("rock", 3, 0.5, hf.symbol("size")), disc("small_tree", 6, -1, 0.004),
    hf.Inequality("fence", Y - 3, "m"), hf.Inequality("turned", sp.Abs(PSI) - 3 - 1.0 * Y, "rad"),
)  # fmt: skip


@pytest.fixture(scope="module")
def car():
    return hf.System(
        "my_car",
        states=(
            hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("psi", "rad", angle=True),
        ),
        inputs=(hf.Quantity("w", "rad/s"),),
        rates={"x": sp.cos(PSI), "y": sp.sin(PSI), "psi": W},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def result(car):
    """Four runs among obstacles to a goal: one of them leaves the region."""
    size = hf.Parameter("size", "m", value=1.0)
    return hf.simulate(
        car,
        hf.Law("steer", car.states, {"w": 2 * sp.sin(sp.atan2(-Y, 8 - X) - PSI)}),
        starts=hf.Starts(
            states=({"x": 0}, {"x": 0, "y": 2, "psi": 1}, {"x": 0, "y": -2}, {"x": 1})
        ),
        region=hf.Region("field", car.states, FIELD, parameters=(size,)),
        goal=hf.Region("home", car.states[:2], (disc("near", 8, 0, 0.5, sign=-1),)),
        horizon=9.0,
    )


def on_the_line(line):
    return np.vstack(line.pieces).T


def test_every_inequality_of_the_plane_has_its_line_where_it_is_zero(result):
    lines = {line.name: line for line in PlaneLevels.of(result, ("x", "y")).lines(PLANE)}
    assert set(lines) == {"rock", "small_tree", "fence", "goal"}
    for name, (x, y, radius) in {
        "rock": (3, 0.5, 1), "small_tree": (6, -1, 0.004), "goal": (8, 0, 0.5)
    }.items():  # fmt: skip
        found = np.hypot(*(on_the_line(lines[name]) - np.array([[x], [y]])))
        np.testing.assert_allclose(found, radius, rtol=2e-3)
    np.testing.assert_allclose(on_the_line(lines["fence"])[1], 3.0, atol=1e-9)


def test_forbidden_side_is_above_zero_and_the_goal_below(result):
    lines = {line.name: line for line in PlaneLevels.of(result, ("x", "y")).lines(PLANE)}
    for name, sign in (("rock", 1), ("goal", -1)):
        line = lines[name]
        middle = line.values[len(line.y) // 2, len(line.x) // 2]
        assert sign * middle > 0


def test_what_has_no_line_is_named_with_the_reason(result):
    levels = PlaneLevels.of(result, ("x", "y"))
    near = (0.0, 1.0, -1.0, 1.0)
    said = levels.note(levels.lines(near))
    assert said == (
        "not drawn: rock, small tree, fence, goal (beyond the frame); turned (depends on other states)"
    )
    assert levels.note(levels.lines(PLANE)) == "not drawn: turned (depends on other states)"


def test_a_parameter_that_varies_has_no_one_line(result):
    data = result.dataset.drop_vars(["varied", "varied_name"], errors="ignore")
    data = data.assign_coords(varied_name=["size"])
    other = hf.Result(data, result.scene, result.parameters)
    assert ("constraint", "rock") in PlaneLevels.of(other, ("x", "y")).hidden


def test_a_file_that_lacks_what_varies_is_drawn_too(result):
    data = result.dataset.drop_vars(["varied", "varied_name"], errors="ignore")
    figure = hf.paths_figure(hf.Result(data))
    assert len(figure.axes) == 2
    plt.close(figure)


def test_paths_show_obstacles_and_goal_in_both_panels_with_their_names(result):
    figure = hf.paths_figure(result)
    (legend,) = figure.legends
    texts = {t.get_text() for t in legend.get_texts()}
    assert {"rock", "small tree", "fence", "goal", "forbidden"} <= texts
    assert legend.get_title().get_text() == "not drawn: turned (depends on other states)"
    for axis in figure.axes:
        hatched = [c for c in axis.collections if getattr(c, "hatches", None) not in (None, [None])]
        assert len(hatched) >= 3
    plt.close(figure)


def test_obstacles_and_the_goal_near_the_paths_are_in_the_frame(car):
    far = disc("rock", 5, 0, 0.5)
    result = hf.simulate(
        car, hf.Law("straight", car.states, {"w": 0.0}), starts=hf.Starts(states=({"x": 0},)),
        region=hf.Region("field", car.states, (far,)), horizon=4.0,
    )  # fmt: skip
    figure = hf.paths_figure(result)
    assert figure.axes[0].get_xlim()[1] > 5.5
    plt.close(figure)


def test_page_has_the_same_lines_as_the_figure(result):
    page = paths_data(result, ("x", "y"))
    rock = [t for t in page["data"] if t["name"] == "rock"]
    assert [t["showlegend"] for t in rock] == [True]
    np.testing.assert_allclose(
        np.hypot(np.array(rock[0]["x"]) - 3, np.array(rock[0]["y"]) - 0.5), 1, rtol=2e-3
    )
    assert page["layout"]["meta"]["says"] == "4 paths; not drawn: turned (depends on other states)"


def test_many_constraints_share_one_entry_of_the_legend(car):
    walls = tuple(hf.Inequality(f"wall_{k}", Y - 2 - 0.1 * k, "m") for k in range(8))
    result = hf.simulate(
        car, hf.Law("round", car.states, {"w": 0.5}), starts=hf.Starts(states=({"x": 0},)),
        region=hf.Region("field", car.states, walls), start_outside=True, horizon=9.0,
    )  # fmt: skip
    figure = hf.paths_figure(result)
    texts = [t.get_text() for t in figure.legends[0].get_texts()]
    assert "8 constraints" in texts
    assert not any("wall" in t for t in texts)
    plt.close(figure)


def test_outcomes_and_modes_differ_without_colours():
    outcomes = list(style.OUTCOME_DASHES.values())
    assert set(style.OUTCOME_DASHES) == set(hf.Outcome)
    assert len(set(outcomes)) == len(outcomes)
    assert len(set(style.DASHES)) == len(style.DASHES) > 2 * len(style.MODES)


def test_paths_have_the_dashes_of_their_outcome(result):
    figure = hf.paths_figure(result)
    legend = figure.legends[0]
    names = [t.get_text() for t in legend.get_texts()]
    entries = dict(zip(names, legend.legend_handles, strict=True))
    counts = {name: n for name, n in result.outcomes.items() if n}
    assert len(counts) == 3
    for outcome in (o for o in hf.Outcome if o.label in counts):
        _, dashes = entries[f"{outcome.label} ({counts[outcome.label]})"]._unscaled_dash_pattern
        assert tuple(dashes or ()) == style.OUTCOME_DASHES[outcome]
    plt.close(figure)


def test_history_says_which_run_it_is_how_it_ended_and_where_it_began(result):
    figure = hf.histories_figure(result, 1)
    assert figure.get_suptitle() == (
        "run 1 of 4: reached goal\nfrom $x$ = 0 m, $y$ = 2 m, $\\psi$ = 1 rad"
    )
    plt.close(figure)


def test_legends_of_a_history_lie_over_their_panels_and_beside_nothing(car):
    names = ("low", "high", "near", "far", "a_long_name_of_a_constraint", "low_again", "high_again")
    limits = [hf.Inequality(n, (-1) ** k * Y - 3 - k, "m") for k, n in enumerate(names)]
    result = hf.simulate(
        car, hf.Law("sway", car.states, {"w": sp.cos(1.0 * X)}, empirical="a motion to draw"), horizon=3.0,
        region=hf.Region("field", car.states, limits), starts=hf.Starts(states=({"x": 0},)),
    )  # fmt: skip
    figure = hf.histories_figure(result)
    figure.canvas.draw()
    page, extents = figure.bbox, {}
    for panel in (a for a in figure.axes if a.get_visible()):
        box = panel.get_legend().get_window_extent()
        assert box.y0 >= panel.bbox.y1
        assert page.x0 <= box.x0
        assert box.x1 <= page.x1
        extents[panel] = [box, panel._left_title.get_window_extent()]
    for panel, (legend, title) in extents.items():
        assert not legend.overlaps(title)
        others = [other.bbox for other in extents if other is not panel]
        others += [box for other in extents if other is not panel for box in extents[other]]
        assert not any(legend.overlaps(box) or title.overlaps(box) for box in others)
    plt.close(figure)


def test_a_single_mode_is_not_shaded(result):
    figure = hf.histories_figure(result)
    assert not any(axis.patches for axis in figure.axes)
    plt.close(figure)


def test_legend_has_as_many_columns_as_fit_and_the_figure_grows_with_it():
    def legend_of(labels):
        with style.look():
            figure = Figure(figsize=(style.WIDTH, 3.0), layout="constrained")
            style.add_legend(figure, [Line2D([], [], label=text) for text in labels])
            FigureCanvasAgg(figure).draw()
        return figure, figure.legends[0]

    figure, legend = legend_of(["start", "a name of many letters of one law", "x", "y", "z"])
    assert (legend._ncols, figure.get_figheight()) == (5, 3.0)
    figure, legend = legend_of([f"a name of many letters of law {k}" for k in range(12)])
    assert legend._ncols == 3
    assert figure.get_figheight() > 3.0
    box = legend.get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1


def test_shape_and_constraint_of_one_name_have_the_entry_of_the_shape():
    figure = Figure(layout="constrained")
    thick, thin = (Line2D([], [], linewidth=width, label="moored") for width in (3, 1))
    style.add_legend(figure, [thick, thin])
    (line,) = figure.legends[0].get_lines()
    assert line.get_linewidth() == 3


def test_bold_paths_have_the_number_of_their_run(result):
    figure = hf.paths_figure(result, highlight=3)
    assert [t.get_text() for t in figure.axes[1].texts] == ["0", "1", "2"]
    plt.close(figure)


def test_vehicle_with_a_trailer_is_drawn_with_it_along_its_path():
    tractor = hf.systems.tractor_trailer(1, length_1=0.8)
    law = hf.Law("drive", tractor.states, {"v": 1.0, "r": 0.3})
    result = hf.simulate(tractor, law, starts=hf.Starts(states=({"x": 0, "psi1": 0.2},)), horizon=4)
    figure = hf.paths_figure(result, cones=3)
    (axis,) = figure.axes
    outlines = [p.get_xy()[:-1] for p in axis.patches if isinstance(p, Polygon)]
    assert len(outlines) == 6
    trailer = outlines[1]
    drawbar = trailer[[3, 4]].mean(axis=0)
    np.testing.assert_allclose(drawbar, 0.8 * np.array([np.cos(0.2), np.sin(0.2)]), atol=1e-12)
    low, high = np.vstack(outlines).min(axis=0), np.vstack(outlines).max(axis=0)
    assert (low > [axis.get_xlim()[0], axis.get_ylim()[0]]).all()
    assert (high < [axis.get_xlim()[1], axis.get_ylim()[1]]).all()
    plt.close(figure)


@pytest.fixture(scope="module")
def kernel():
    x, v = (hf.Quantity(n, u) for n, u in (("x", "m"), ("v", "m/s")))
    cart = hf.System(
        "my_cart", (x, v), (hf.Quantity("a", "m/s^2"),), {"x": V, "v": hf.symbol("a")},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    lane = hf.Region("my_lane", (x,), (hf.Inequality("ends", X**2 - 1, "m^2"),))
    return hf.viability_kernel(cart, lane, hf.grid(cart, {"x": (-2, 2), "v": (-2, 2)}, 21), 3.0)


def test_own_kernel_has_its_names_in_the_title(kernel):
    assert told(kernel).startswith("viability kernel of my lane, my cart\n")


def test_kernel_of_a_file_has_the_title_of_the_file(kernel):
    report = dataclasses.replace(kernel.report, region="region", system="system")
    of_file = kernel.reported(title="A cart between two walls", region="region", system="system")
    assert report.region == of_file.report.region
    assert told(of_file).startswith("A cart between two walls\nviability kernel\n")
    figure = hf.value_function_figure(of_file)
    assert figure.get_suptitle().startswith("A cart between two walls\n")
    plt.close(figure)


def test_shapes_to_draw_are_those_of_both_regions_and_all_their_inequalities(result):
    near = hf.regions.near_pose()
    shapes = drawn_shapes(None, near)
    assert shapes[: len(near.scene)] == near.scene
    assert [(s.role, s.name) for s in shapes[len(near.scene) :]] == [("goal", "at_pose")]


def test_one_run_that_leaves_is_said_to_leave_and_has_a_cross_there(car):
    result = hf.simulate(
        car, hf.Law("straight", car.states, {"w": 0.0}), starts=hf.Starts(states=({"x": 0},)),
        region=hf.Region("field", car.states, (disc("rock", 5, 0, 0.5),)), horizon=6.0,
    )  # fmt: skip
    figure = hf.paths_figure(result)
    (axis,) = figure.axes
    assert axis.get_title() == "path, by mode: left region"
    (cross,) = (line for line in axis.lines if line.get_label() == "left here")
    ((x, y),) = cross.get_xydata()
    assert 4.5 <= x <= 4.6 + 1e-9  # the sample after the edge
    assert y == 0.0
    assert "left here" in [t.get_text() for t in figure.legends[0].get_texts()]
    plt.close(figure)


RACK = {"rack": [(1, -1), (2, -1), (2, 1), (1, 1)]}


def test_outlines_of_obstacles_stay_beside_other_constraints(car):
    outside = hf.obstacles(car, RACK, clearance=0.2)
    plain = hf.Region("slow", car.states, (hf.Inequality("nose", X - 6, "m"),))
    assert len(outside.scene) == 4
    for region in (hf.both(plain, outside), hf.both(outside, plain)):
        assert region.scene == outside.scene


def test_set_of_a_goal_is_drawn_with_the_obstacles_of_its_region(tmp_path):
    path = tmp_path / "basin.toml"
    path.write_text("""
[scenario]
title = "To a dock past a rack"
kind = "capture-basin"
[system]
states = { x = { unit = "m" }, y = { unit = "m" } }
inputs = { u = { unit = "m/s", bounds = [-1, 1] }, w = { unit = "m/s", bounds = [-1, 1] } }
rates = { x = "u", y = "w" }
[region]
obstacles = { rack = [[1, -1], [2, -1], [2, 1], [1, 1]] }
clearance = 0.2
[goal]
constraints = { dock = { expression = "hypot(x - 4, y) - 0.5", unit = "m" } }
[grid]
nodes = { x = 21, y = 21 }
box = { x = [-1, 5], y = [-3, 3] }
[march]
horizon = 2
""")
    around = hf.load_scenario(str(path)).drawn_around
    assert [s.role for s in around["scene"]] == ["obstacle"] * 4 + ["constraint"]
    assert around["parameters"] == {"clearance_rack": 0.2}


def test_figure_of_a_set_has_the_lines_of_constraints_at_the_states_that_it_holds(kernel):
    limits = (
        hf.Inequality("ahead", X - 1.5, "m"), hf.Inequality("fast", V - hf.symbol("most"), "m/s"),
        hf.Inequality("hot", hf.symbol("heat") - 1, "K"),
    )  # fmt: skip
    scene = tuple(ZeroLevel("constraint", c.name, c.expression) for c in limits)
    figure = hf.value_function_figure(kernel, scene=scene, parameters={"most": 0.5})
    texts = [t.get_text() for t in figure.legends[0].get_texts()]
    assert texts == ["in the set", "ahead", "fast", "forbidden"]
    edges = [c for c in figure.axes[0].collections if same_color(c.get_edgecolor(), style.LIMIT)]
    ahead, fast = (c.get_paths()[0].vertices for c in edges)
    np.testing.assert_allclose(ahead[:, 0], 1.5)
    np.testing.assert_allclose(fast[:, 1], 0.5)
    plt.close(figure)


def test_figure_of_a_result_file_says_that_it_has_no_constraints(result, tmp_path):
    result.save(tmp_path / "result.nc")
    figure = hf.paths_figure(hf.load(tmp_path / "result.nc"))
    assert figure.legends[0].get_title().get_text() == (
        "not drawn: rock, small tree, fence, turned and 1 more (a result file has no shapes)"
    )
    plt.close(figure)


def test_run_of_the_history_is_among_the_bold_paths_and_an_unknown_one_is_refused(result):
    figure = hf.paths_figure(result, highlight=2, cone_run=3)
    assert [t.get_text() for t in figure.axes[1].texts] == ["0", "1", "3"]
    assert figure.axes[1].get_title() == "runs 0 to 1 and 3, by mode"
    plt.close(figure)
    for run in (4, -1):
        with pytest.raises(OutputError, match="expected 0 to 3"):
            hf.paths_figure(result, cone_run=run)


def test_run_of_the_history_that_a_file_does_not_have_is_refused():
    with pytest.raises(ScenarioError, match="there is no run 9; expected 0 to 7"):
        hf.load_scenario("ch2-unicycle", ["figures.history=9", "starts.random=5"])


def test_constraint_has_the_same_dashes_in_paths_histories_and_the_page(car):
    region = hf.Region(
        "field", car.states,
        (hf.Inequality("turned", sp.Abs(PSI) - 3, "rad"), hf.Inequality("low", -1 - Y, "m"),
         hf.Inequality("near", -1 - X, "m"), hf.Inequality("high", Y - 1, "m")),
    )  # fmt: skip
    result = hf.simulate(
        car, hf.Law("sway", car.states, {"w": sp.cos(1.0 * X)}), region=region, horizon=9.0,
        starts=hf.Starts(states=({"x": 0, "y": 0.5}, {"x": -0.9, "y": -0.8})), start_outside=True,
    )  # fmt: skip
    paths, histories = hf.paths_figure(result), hf.histories_figure(result)
    drawn = {n.get_label(): n for n in paths.legends[0].get_lines()}
    curves = {n.get_label(): n for axis in histories.axes for n in axis.lines}
    page = {t["name"]: t["line"]["dash"] for t in paths_data(result, ("x", "y"))["data"]}
    for place, name in ((1, "low"), (3, "high")):
        for line in (drawn[name], curves[name]):
            _, dashes = line._unscaled_dash_pattern
            assert tuple(dashes or ()) == style.DASHES[place]
        assert page[name] == ",".join(f"{d * 1.5:.3g}px" for d in style.DASHES[place])
    plt.close(paths)
    plt.close(histories)


def test_line_just_beyond_the_frame_is_named_as_not_drawn(result):
    levels = PlaneLevels.of(result, ("x", "y"))
    lines = levels.lines((-6.0, 14.0, -6.0, 2.98))
    assert [line.name for line in lines] == ["rock", "small_tree", "goal"]
    assert levels.note(lines) == (
        "not drawn: fence (beyond the frame); turned (depends on other states)"
    )
