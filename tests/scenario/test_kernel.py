"""Scenarios that ask for sets of states: read, refused, marched, tried, written."""

import json
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis import load as load_module
from holdfast.errors import ScenarioError, SimulationError
from holdfast.execution import resources
from holdfast.scenario.files import scenario_names
from holdfast.scenario.kernel_reference import named_kernel
from holdfast.scenario.load import load_scenario
from tests.command_line import called
from tests.scenario_files import CART, PLANT, scenarios_of


@pytest.fixture
def cart(tmp_path):
    path = tmp_path / "cart.toml"
    path.write_text(CART)
    return str(path)


OTHERS = scenarios_of("closed-loop", "formation")
KERNELS = [n for n in scenario_names() if n not in OTHERS]


def test_chapter_7_is_there():
    assert set(KERNELS) >= {
        "ch7-any-current", "ch7-capture-basin", "ch7-discriminating", "ch7-forward-reach",
        "ch7-forward-reach-printed", "ch7-hold-goal", "ch7-safety-law", "ch7-six-states",
    }  # fmt: skip


@pytest.mark.heavy
def test_kernel_of_a_file_is_marched_tried_and_written(cart, tmp_path):
    out = tmp_path / "out"
    done = called("run", cart, "--out", str(out))
    assert done.returncode == 0
    assert "discriminating kernel of region, for ever" in done.stdout
    assert "200 of 200 stay" in done.stdout
    assert {p.name for p in out.iterdir()} == {"result.nc", "set.png", "set.svg", "summary.json"}
    said = json.loads((out / "summary.json").read_text())
    assert said["promise"]["held"]
    assert said["promise"]["outside"]["count"] == 0
    assert said["extent"]["x"] == pytest.approx([-1, 1], abs=0.02)
    value = hf.load(out / "result.nc")
    assert isinstance(value, hf.ValueFunction)
    assert "cart between walls" in value.dataset.attrs["scenario_text"]
    assert value.contains([[0.0, 0.0]])[0]


@pytest.mark.heavy
def test_set_that_lasts_and_has_not_converged_is_no_answer(cart, tmp_path):
    done = called(
        "run", cart, "--out", str(tmp_path / "o"), "--no-figures",
        "--set", "march.horizon=0.5", "--set", "promise.horizon=0.5",
    )  # fmt: skip
    assert done.returncode == 1
    assert "did not converge within 0.5 s" in done.stderr


@pytest.mark.heavy
def test_law_of_a_file_is_kept_safe_and_runs_and_seed_are_those_of_the_promise(cart):
    more = ["law.outputs.a=1", "law.name=push"]
    loaded = load_scenario(cart, more, runs=50, seed=3)
    found = loaded.run()
    assert found.promise.law == "push, kept safe"
    assert found.promise.inside[0].kept.total == 50
    assert found.promise.held


def test_march_is_not_lost_where_its_promise_cannot_be_tried(cart, tmp_path):
    out = tmp_path / "o"
    done = called("run", cart, "--out", str(out), "--set", "promise.margin=5 m", "--no-figures")
    assert done.returncode == 1
    assert "further inside than 5" in done.stderr
    assert (out / "result.nc").exists()


def test_options_that_are_none_are_refused(cart):
    with pytest.raises(ScenarioError, match="progress: unknown key"):
        load_scenario(cart, ["march.progress=1"])
    with pytest.raises(ScenarioError, match="has no \\[promise\\]"):
        load_scenario(cart, ["promise="], seed=1)
    times = load_scenario(cart, ["march.horizon=0.4", "march.times=3"]).options["times"]
    assert times[-1] == 0.4
    assert len(times) == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("scenario.kind=viable-kernel", "scenario.kind"),
        ("scenario.kind=capture-basin", "goal: missing table"),
        ("origin.constraints.a=x", "origin: a discriminating-kernel does not use it"),
        ("grid.box.z=[0, 1]", "grid.box.z: unknown name"),
        ("grid.nodes=2.5", "grid.nodes"),
        ("grid.nodes=3", "at least 7 for weno5"),
        ("march.horizon=0", "the horizon [s] is 0.0"),
        ("march.schema=weno5", "did you mean 'scheme'"),
        ("march.scheme=weno7", "weno7"),
        ("march.times=0", "march.times"),
        ("march.arrival_steps=10", "does not use it"),
        ("disturbance.w=1", "no disturbance 'w'"),
        ("figures.plane=['x', 'w']", "figures.plane: unknown name"),
        ("figures.inputs=['b']", "figures.inputs"),
        ("system.promote={x=[0]}", "expected [lowest, highest]"),
        ("system.keep=['x']", "depends on 'v'"),
        ("system.disturb={v=[-1, 1]}", "'disturb' without 'promote'"),
        ("scenario.kind=invariance-kernel", "has no closed-loop promise"),
        ("tracking.a=1", "there is no [law]"),
        ("promise.sample_time=-1", "promise: sample_time -1 s"),
    ],
)  # fmt: skip
def test_mistakes_are_answered_with_the_key(cart, change, message):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(cart, [change]).solve()
    assert message in str(caught.value)
    assert "cart.toml" in str(caught.value)


def test_law_that_cannot_follow_the_rate_is_refused_before_the_march(cart):
    changes = ["law.outputs={a='1'}", "promise.rate=2", "promise.sample_time=0.6"]
    with pytest.raises(ScenarioError, match=r"cart\.toml: promise: rate 2 1/s with a sample time"):
        load_scenario(cart, changes)


@pytest.mark.heavy
def test_closed_loop_may_be_kept_in_the_kernel_of_another_scenario(cart, tmp_path, monkeypatch):
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(tmp_path / "cache"))
    text = CART[CART.index("[system]") : CART.index("[grid]")]
    path = tmp_path / "loop.toml"
    path.write_text(f"""
[scenario]
title = "pushed cart"
{text}
[law]
outputs = {{ a = "0.9*sin(t)" }}
[disturbance]
d = "0.5*cos(0.3*t)"
[safety]
kernel = "{cart}"
[starts]
states = [{{ x = 0 }}, {{ x = 0.8, v = 0.2 }}]
[run]
horizon = 20
""")
    kept = load_scenario(str(path)).run()
    assert kept.viable == 2
    lost = load_scenario(str(path), ["safety="]).run()
    assert lost.viable == 0
    files = list((tmp_path / "cache").glob("value_*.nc"))
    assert len(files) == 1
    assert np.array_equal(named_kernel(cart).value().values(), hf.load(files[0]).values())
    late = load_scenario(str(path), ["run.delay=0.1"]).run()
    cell = named_kernel(cart).value().report.cell
    for result in (kept, late):  # it predicts where it is, and needs no margin for the delay
        assert 0 < result.parameters["safety_margin"] <= cell
    assert late.viable == 2
    with pytest.raises(
        ScenarioError, match="safety: the optimal inputs without a law have no margin"
    ):
        load_scenario(str(path), ["run.delay=0.1", "safety.alone=true"]).run()
    with pytest.raises(ScenarioError, match="does not compute a kernel"):
        load_scenario(str(path), ["safety.kernel=inspection"]).run()
    with pytest.raises(ScenarioError, match="leave one of them out"):
        load_scenario(str(path), ["safeguard.gains=[1, 2]"])


def test_kept_kernel_that_was_cut_is_computed_again(cart, tmp_path, monkeypatch):
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(tmp_path / "cache"))
    values = named_kernel(cart).value().values()
    (kept,) = (tmp_path / "cache").glob("value_*.nc")
    whole = kept.read_bytes()
    kept.write_bytes(whole[: len(whole) // 2])
    assert np.array_equal(named_kernel(cart).value().values(), values)
    assert np.array_equal(hf.load(kept).values(), values)


def test_commands_know_the_kinds():
    assert "ch7-discriminating" in called("list").stdout
    assert 'kind = "discriminating-kernel"' in called("show", "ch7-discriminating").stdout


def test_promise_that_falls_short_ends_with_exit_status_1(cart, tmp_path):
    """From V > 0 alone, with inputs held for two seconds: some are lost, and it is said."""
    out = tmp_path / "out"
    short = ["promise.margin=0", "promise.sample_time=2", "promise.runs=60", "grid.nodes=41"]
    sets = [part for one in short for part in ("--set", one)]
    done = called("run", cart, "--out", str(out), "--no-figures", *sets)
    assert done.returncode == 1
    assert "holdfast: the promise falls short: " in done.stderr
    assert "of 60 starts 0 m inside stay" in done.stderr
    assert "Traceback" not in done.stderr
    said = json.loads((out / "summary.json").read_text())["promise"]
    assert not said["held"]
    assert not said["confirmed"]
    assert said["inside"][0]["count"] < 60
    assert said["beaten"]
    assert said["verdict"] in done.stderr


@pytest.mark.heavy
def test_kernel_without_a_promise_in_its_file_is_tried_and_the_result_remembers_it(cart, tmp_path):
    Path(cart).write_text(CART.split("[promise]")[0])
    out = tmp_path / "out"
    done = called("run", cart, "--out", str(out), "--no-figures")
    assert done.returncode == 0
    assert "within a cell of the edge, as " in done.stdout
    said = json.loads((out / "summary.json").read_text())
    assert said["promise"]["share_tried"] == pytest.approx(1.0)
    assert said["promise"]["conclusion"] in done.stdout
    report = hf.load(out / "result.nc").report
    assert report.promise_outcome == said["promise"]["outcome"]
    assert report.promise_conclusion == said["promise"]["conclusion"]
    assert report.promise_share == said["promise"]["share_kept"]


def test_promise_of_no_runs_is_left_out_and_said_to_be(cart, tmp_path):
    more = ("--set", "promise.runs=0", "--no-figures")
    done = called("run", cart, "--out", str(tmp_path), *more)
    assert done.returncode == 0
    assert "  promise        none: runs = 0" in done.stdout
    assert "promise" not in json.loads((tmp_path / "summary.json").read_text())
    assert hf.load(tmp_path / "result.nc").report.promise_outcome is None


def test_promise_of_an_empty_kernel_is_said_to_be_none(cart, tmp_path):
    """Pushed harder than it can brake: the answer is the empty set, and nothing is promised."""
    sets = ["--set", "system.disturbances.d.bounds=[-2, 2]", "--set", "grid.nodes=41"]
    done = called("run", cart, "--out", str(tmp_path), "--no-figures", *sets)
    assert done.returncode == 0
    assert "promise        none: the set is empty" in done.stdout


def test_scale_of_a_constraint_is_read_and_a_depth_with_a_unit_is_refused(cart):
    table = "region.constraints.left={expression='-1 - x', unit='m', scale='50 cm'}"
    found = load_scenario(cart, [table, "promise.margin=0.5"])
    assert [c.scale for c in found.region.inequalities] == [0.5, None]
    assert found.region.margin_unit == "1"
    assert found.promised["margin"] == 0.5
    with pytest.raises(ScenarioError, match=r"promise.margin: '2 cm' inside region .* scale"):
        load_scenario(cart, [table, "promise.margin=2 cm"])
    with pytest.raises(ScenarioError, match=r"region.constraints.left: .*scale 0"):
        load_scenario(cart, [table.replace("50 cm", "0 cm")])


def test_scales_of_a_region_of_the_catalogue_are_a_table():
    found = load_scenario("ch7-discriminating")
    name = found.region.inequality_names[0]
    scaled = load_scenario("ch7-discriminating", [f"region.scale.{name}='10 cm'"])
    assert scaled.region.inequality(name).scale == pytest.approx(0.1)
    with pytest.raises(ScenarioError, match=r"region.scale: .*no inequality"):
        load_scenario("ch7-discriminating", ["region.scale.nowhere=1"])


HELD = f"""
[scenario]
title = "held"
{PLANT}[law]
name = "idle"
outputs = {{ a = 0 }}
[safety]
kernel = "KERNEL"
alone = true
[starts]
states = [{{ x = 0.2 }}]
[run]
horizon = 0.2
"""

NARROW = "region.constraints.right={expression='x - 0.8', unit='m'}"


@pytest.mark.heavy
def test_kernel_of_a_weaker_region_is_refused_for_safety(cart, tmp_path):
    """The kernel keeps |x| <= 1; who asks for x <= 0.8 is told where the two differ."""
    small = cart.replace("cart.toml", "small.toml")
    text = CART.replace("nodes = 61", "nodes = 41").split("[promise]")[0]
    (tmp_path / "small.toml").write_text(text)
    path = tmp_path / "held.toml"
    path.write_text(HELD.replace("KERNEL", small))
    assert load_scenario(str(path)).run().viable == 1, "the same region"
    told = r"held\.toml: safety: the kernel of '.*' is not within region .*: at x = .*, v = .* it "
    with pytest.raises(ScenarioError, match=told + "violates 'right' by 0.* m; compute the kernel"):
        load_scenario(str(path), [NARROW]).run()
    wider = load_scenario(str(path), [NARROW.replace("0.8", "1.1")])
    assert wider.run().viable == 1, "a stronger kernel implies the region"
    unknown = "region.constraints.right={expression='x - 2 + 0*v', unit='m'}"
    assert load_scenario(str(path), [unknown]).run().viable == 1
    saved = load_scenario(small).solve().save(tmp_path / "set.nc")
    path.write_text(HELD.replace("KERNEL", str(saved)))
    assert load_scenario(str(path)).run().viable == 1, "checked at the nodes, without its scenario"
    with pytest.raises(ScenarioError, match="is not within region"):
        load_scenario(str(path), [NARROW]).run()
    no_number = "region.constraints.right={expression='log(x) - 9', unit='m'}"
    with pytest.raises(ScenarioError, match="violates 'right' by nan m"):
        load_scenario(str(path), [no_number]).run()


def test_a_kernel_that_does_not_fit_into_memory_is_read_where_the_runs_are(
    cart, tmp_path, monkeypatch
):
    value = load_scenario(cart, ["grid.nodes=121"]).solve()
    saved = value.save(tmp_path / "set.nc")
    path = tmp_path / "held.toml"
    path.write_text(HELD.replace("KERNEL", str(saved)) + "record_every = 0.02\n")
    for limit in ("MOST_READ", "LOOKS"):  # of the sampled game, which reads all
        monkeypatch.setattr(f"holdfast.analysis.safety.sampled_value.{limit}", 0)
    inside = load_scenario(str(path)).run()
    monkeypatch.setattr(load_module, "LARGE", 1)
    monkeypatch.setattr(resources, "total_memory", lambda: 1.4 * value.values().nbytes)
    stored = load_scenario(str(path)).run()
    assert inside.arrays["state"].values.tobytes() == stored.arrays["state"].values.tobytes()
    with pytest.raises(SimulationError, match="needed as a whole here"):
        hf.load(saved).law_table(all_times=False).whole()
    with pytest.raises(ScenarioError, match="is not within region"):
        load_scenario(str(path), [NARROW]).run()
