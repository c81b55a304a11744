"""Laws judged by the kernel of the vehicle of each case: a start outside it is nobody's failure."""

import json
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.safety.safety_filter import safety_law
from holdfast.analysis.simulation.law_comparison import Comparison, Reference
from holdfast.errors import DefinitionError, HoldfastError, ScenarioError
from holdfast.presentation.studies.comparison import comparison_text
from holdfast.scenario.kernel_reference import named_kernel
from holdfast.scenario.load import load_scenario
from holdfast.studies.comparison import Judge, variant
from tests.command_line import called

CART = """
[system]
name = "cart"
states = { x = { unit = "m" }, v = { unit = "m/s" } }
inputs = { a = { unit = "m/s^2", bounds = ["-a_max", "a_max"] } }
parameters = { a_max = { value = 1.0, unit = "m/s^2" } }
rates = { x = "v", v = "a" }
[region]
constraints = { left = { expression = "-1 - x", unit = "m" }, right = { expression = "x - 1", unit = "m" } }
"""

KERNEL = f"""
[scenario]
title = "from where a cart can stay"
kind = "viability-kernel"
{CART}
[grid]
nodes = 81
box = {{ x = [-1.3, 1.3], v = [-2.4, 2.4] }}
[march]
horizon = 10
forever = true
"""

LOOP = f"""
[scenario]
title = "a cart between walls"
{CART}
[law]
outputs = {{ a = 0 }}
[starts]
random = 300
box = {{ x = [-1, 1], v = [-2, 2] }}
[run]
horizon = 10
sample_time = 0.01
seed = 2
[compare]
title = "motor off"
kernel = "KERNEL"
margin = "8 cm"
[compare.laws.filter]
safety = {{ kernel = "KERNEL" }}
[compare.cases.weak]
[compare.cases.strong]
system = {{ parameters = {{ a_max = 2.0 }} }}
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("judging")
    (folder / "kernel.toml").write_text(KERNEL)
    kernel = str(folder / "kernel.toml")
    (folder / "loop.toml").write_text(LOOP.replace("KERNEL", kernel))
    return kernel, str(folder / "loop.toml")


@pytest.fixture(scope="module")
def found(files) -> Comparison:
    return hf.compare(files[1])


@pytest.fixture(scope="module")
def starts(files):
    return load_scenario(files[1], ["run.horizon=0.1"]).run().dataset["state"].values[:, 0]


def room(starts, a_max):
    """Exact V: how near a wall the cart comes that brakes at once; kept where > 0."""
    x, v = starts.T
    return 1 - np.maximum(np.abs(x), np.abs(x + v * np.abs(v) / (2 * a_max)))


STRENGTH = {"weak": 1.0, "strong": 2.0}


@pytest.mark.heavy
@pytest.mark.slow("weak")
@pytest.mark.parametrize("case", STRENGTH)
def test_starts_are_judged_by_the_exact_kernel_of_the_cart_of_their_case(found, starts, case):
    left, r = room(starts, STRENGTH[case]), found.references[case]
    assert (left[r.inside] > 0).all()
    assert (left[r.given_up] < 0).all()
    assert (r.inside | r.given_up)[np.abs(left) > 0.12].all()


def test_a_stronger_cart_has_more_starts_that_can_be_kept(found, starts):
    more = found.references["strong"].inside.sum() - found.references["weak"].inside.sum()
    sure = (room(starts, 2.0) > 0.3) & (room(starts, 1.0) < 0)
    assert more > sure.sum() > 10


@pytest.mark.parametrize("case", STRENGTH)
def test_filter_over_the_kernel_of_its_cart_fails_no_start_that_can_be_kept(found, case):
    kept = found.of_kernel("filter", case)
    assert kept.count == kept.total > 50
    assert found.of_given_up("filter", case).count == 0
    assert found.viable("filter", case).value < 1


@pytest.mark.parametrize("case", STRENGTH)
def test_a_cart_without_motor_fails_those_that_move(found, starts, case):
    """It leaves within ten seconds unless slower than the way ahead of it asks."""
    x, v = starts.T
    stays = np.abs(x + 10 * v) <= 1
    inside = found.references[case].inside
    kept = found.of_kernel("loop", case)
    assert (kept.count, kept.total) == ((stays & inside).sum(), inside.sum())
    assert kept.value < 0.5


def test_law_that_keeps_what_the_kernel_gives_up_is_counted(found):
    """Were the kernel of the weak cart taken for that of the strong one, it would give up too much."""
    wrong = replace(found, references=dict.fromkeys(STRENGTH, found.references["weak"]))
    assert wrong.of_given_up("filter", "strong").count > 10


def test_without_a_goal_to_be_rescued_is_to_stay(found):
    assert not found.to_goal
    for law in found.laws:
        assert np.array_equal(found.of(law, "weak").rescued, found.of(law, "weak").viable)
    text = comparison_text(found)
    assert "rescued" not in text
    assert "detour" not in text
    assert f"{found.references['weak'].inside.sum()} starts inside (for ever), " in text
    assert max(map(len, text.splitlines())) < 130


def test_with_a_goal_the_starts_that_can_be_kept_are_to_be_brought_there(files):
    goal = ["goal.constraints.near=abs(x) - 0.5"]
    found = hf.compare(files[1], ["filter"], ["weak"], overrides=goal, runs=60)
    t, inside = found.of("filter", "weak"), found.references["weak"].inside
    kept = found.of_kernel("filter", "weak")
    assert (kept.count, kept.total) == ((t.rescued & inside).sum(), inside.sum())
    assert 0 < kept.count < t.viable[inside].sum()
    text = comparison_text(found)
    for column in ("viable", "rescued", "inside kernel", "outside kernel", "detour"):
        assert f"{column}   " in text


def test_figure_marks_the_starts_that_can_be_kept(found):
    figure = hf.comparison_figure(found)
    figure.canvas.draw()
    labels = [t.get_text() for t in figure.legends[0].get_texts()]
    assert labels == [
        "motor off", "filter", "viable, with interval", "of starts inside the kernel, with interval",
        "of starts outside the kernel",
    ]  # fmt: skip
    plt.close(figure)


def test_numbers_of_the_judgement_are_in_the_file(files, tmp_path):
    done = called(
        "compare", files[1], "--runs", "20", "--out", str(tmp_path), "--cases", "weak",
        "--no-figures",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said = json.loads((tmp_path / "comparison.json").read_text())
    kernel = said["kernels"]["weak"]
    assert kernel["starts_inside"] + kernel["starts_given_up"] <= 20
    assert kernel["horizon_s"] is None
    assert said["cases_without_kernel"] == {}
    for t in said["trials"]:
        assert t["rescued_of_kernel"]["count"] <= kernel["starts_inside"]
        assert t["in_goal_since"] == {"median": None, "worst": None}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("varied.draws.push=[0, 1]", "varied from run to run"),
        ("plant.a_max=2", "not that of [system]"),
        ("region.constraints.right.expression=x - 0.8", "another region"),
    ],
)
def test_case_that_the_kernel_cannot_follow_is_left_out_with_the_reason(files, change, reason):
    key, _, value = change.partition("=")
    changes = [f"compare.cases.other.{key}={value}"]
    if "varied" in change:
        changes.append('compare.cases.other.varied.plant.a_max="a_max + push"')
    found = hf.compare(files[1], ["loop"], ["weak", "other"], overrides=changes, runs=5)
    assert list(found.references) == ["weak"]
    assert reason in found.unjudged["other"]
    assert found.of_kernel("loop", "other") is None
    assert f"no reference kernel: {found.unjudged['other']}" in comparison_text(found)


@pytest.mark.parametrize(
    ("system", "change", "reason"),
    [
        ({"current_limit": 0.2}, "disturbance.Vy=0.1", "Vy is not 0, the value"),
        ({"current_limit": 0.2}, 'disturbance.Vy="0.1*sin(t)"', "Vy is not 0, the value"),
        ({"promote": {"u": [-1, 1], "r": [-1, 1]}}, "run.seed=1", "grid.box.u: unknown name"),
    ],
)
def test_kernel_of_another_plant_judges_nothing(system, change, reason):
    """Nothing is marched to find that out."""
    judge = Judge("ch7-six-states", 0.02)
    scenario = load_scenario("ch7-rescue", ["system.current_limit=0.2", change])
    tables = {"system": {"name": "marine_vehicle", **system}}
    value, said = judge.value(tables, [scenario], lambda fraction: None)
    assert value is None
    assert reason in said


def test_what_a_law_is_not_told_changes_nothing_of_what_could_be_kept(files):
    blind = ["noise.uniform.x=0.1", "run.delay=0.3", "safety.margin=0.05"]
    changes = [f"compare.cases.blind.{change}" for change in blind]
    found = hf.compare(files[1], ["filter"], ["weak", "blind"], overrides=changes, runs=100)
    a, b = (found.references[case] for case in ("weak", "blind"))
    assert np.array_equal(a.value, b.value)
    assert found.of_kernel("filter", "blind").value < found.of_kernel("filter", "weak").value


def with_kernel(files, folder, march):
    """The scenario with another march of its kernel."""
    path = folder / "other.toml"
    path.write_text(f'{Path(files[1]).read_text()}[kernels."{files[0]}"]\nmarch = {march}\n')
    return str(path)


def test_kernel_that_has_not_converged_judges_no_longer_run(files, tmp_path):
    path = with_kernel(files, tmp_path, "{ horizon = 1, forever = false }")
    found = hf.compare(path, ["other"], ["weak"], runs=5)
    assert "is valid for 1 s, but the run takes 10 s" in found.unjudged["weak"]
    found = hf.compare(path, ["other"], ["weak"], runs=5, overrides=["run.horizon=1"])
    assert found.references["weak"].horizon == 1.0


def test_kernel_of_which_nothing_is_a_cell_inside_asks_for_a_margin(files, tmp_path):
    path = with_kernel(files, tmp_path, "{ band = 0.01 }")
    changes = ["compare.margin=", "run.horizon=1"]
    found = hf.compare(files[1], ["loop"], ["weak"], overrides=changes, runs=2)
    assert found.references["weak"].margin == pytest.approx(0.0325)
    with pytest.raises(ScenarioError, match=r"a cell, 0\.0175 m; expected \[compare\]"):
        hf.compare(path, ["other"], ["weak"], overrides=changes, runs=2)


def test_start_beyond_the_grid_is_neither_kept_nor_given_up():
    value = np.array([0.5, np.nan, -0.5])
    r = Reference("k", value, 0.1, "m", np.inf)
    assert r.inside.tolist() == [True, False, False]
    assert r.given_up.tolist() == [False, False, True]
    assert r.summary()["starts_beyond_grid"] == 1


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ("compare.kernel=inspection", "does not compute a kernel"),
        ("compare.kernel=value.nc", "is a viability-kernel or a discriminating-kernel"),
        ("compare.margin=-1", "at least 0"),
        ("compare.margin=2 s", "the unit 's' does not fit"),
        ("compare.kernel=", "needs compare.kernel"),
        ("kernels.ch7-hold-goal.grid.nodes=11", "names this kernel"),
    ],
)
def test_what_cannot_judge_is_refused(files, change, complaint):
    with pytest.raises(HoldfastError, match=r"loop\.toml") as caught:
        hf.compare(files[1], overrides=[change], runs=2)
    assert complaint in str(caught.value)


def test_equal_questions_are_answered_once(files):
    """The kernel of another scenario for the same system is the kernel that it computes."""
    kernel, loop = files
    data = load_scenario(loop)
    assert data.safety is None
    own = named_kernel(kernel)
    same = named_kernel(kernel, {"parameters": {"a_max": {"value": 1.0}}})
    other = named_kernel(kernel, {"parameters": {"a_max": 2.0}})
    assert own.digest == same.digest != other.digest
    assert other.scenario.system.parameters[0].value == 2.0
    finer = named_kernel(kernel, None, {kernel: {"grid": {"nodes": 91}}})
    assert finer.scenario.grid.shape == (91, 91)
    assert "91" in finer.scenario.text


def test_velocities_of_a_kernel_are_tracked_by_the_inputs_of_the_vehicle(files, tmp_path):
    """Of x' = v with |v| <= 1 the best is away from the nearer wall; a = -5 (v - that)."""
    kernel, loop = files
    slow = tmp_path / "slow.toml"
    slow.write_text(
        Path(kernel).read_text()
        .replace('rates = { x = "v", v = "a" }', 'rates = { x = "v", v = "a" }\npromote = { v = [-1, 1] }')
        .replace(", v = [-2.4, 2.4]", "")
    )  # fmt: skip
    changes = [f"safety.kernel={slow}", "safety.alone=true", "law.outputs={v = 0}", "tracking.v=5"]
    scenario = load_scenario(loop, [*changes, "run.horizon=0.1", "starts.random=0",
                                    "starts.states=[{x=0.5, v=-0.9}, {x=-0.4, v=0.95}, {x=0.3, v=0.5}]"])  # fmt: skip
    result = scenario.run()
    assert result.dataset["input"].values[:, 0, 0] == pytest.approx([-0.5, 0.25, -1.0])
    with pytest.raises(ScenarioError, match="alone = true, and \\[tracking\\]"):
        load_scenario(loop, [f"safety.kernel={slow}"])
    with pytest.raises(ScenarioError, match="alone = true, and \\[tracking\\]"):
        load_scenario(loop, [*changes, "safety.alone=false"])


def test_velocities_that_vary_with_the_value_itself_have_no_known_rate(files):
    kernel = named_kernel(files[0])
    value = kernel.value()
    optimal = safety_law(kernel.scenario.system, value, ahead=False)
    system = kernel.scenario.system
    smooth = replace(optimal, outputs={"v": optimal.lookup.slopes[0]})
    with pytest.raises(DefinitionError, match="varies with its lookup table"):
        hf.track_velocity(system, smooth, {"v": 1.0})


@pytest.mark.parametrize("law", ["filter", "optimal", "decomposed"])
def test_every_law_of_the_six_dimensional_comparison_knows_the_vehicle_of_its_case(law):
    scenario = variant("ch7-rescue", law, "1 N")
    limit = {q.name: q.value for q in scenario.system.parameters}["thrust_limit"]
    assert limit == 1.0
    if scenario.safety is not None:
        system = scenario.safety.kernel.scenario.system
        assert {q.name: q.value for q in system.parameters}["thrust_limit"] == 1.0
        if law == "decomposed":
            held = hf.steady_bounds(hf.systems.marine_vehicle(thrust_limit=1.0), ("u", "r"))
            assert system.input_bounds == held
            assert [float(v) for v in held.upper] == pytest.approx([0.5021, 0.6416], abs=1e-4)
