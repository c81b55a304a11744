"""Gains that follow from conditions: the best ones where they are known, and every refusal."""

import csv
import tomllib

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.safety.gain_conditions import INTERIOR, corners_of, judged
from holdfast.analysis.simulation.sweep_table import Candidate, Costs
from holdfast.errors import GainWarning, ScenarioError
from holdfast.execution.simulation.settings import Settings
from holdfast.presentation.studies.tuning import tuning_table, tuning_text
from holdfast.scenario.files import edited_text, read_tables, scenario_names
from holdfast.scenario.load import load_scenario
from holdfast.studies.write_results import write_tuning
from tests.command_line import FAST, called

FEW, MORE = {"candidates": 40, "runs": 4}, {"candidates": 120, "runs": 4}


@pytest.fixture(scope="module")
def integrator():
    return hf.tune("ch4-integrator", gains=["k2=0.3:3"], **MORE)


# -- where the best gain is known


def test_time_of_the_integrator_is_best_at_the_limit_of_its_condition(integrator):
    """rho falls as exp(-k2 t), so the largest k2 is the fastest: 0.9 k1 / 2 = 1.125 1/s."""
    assert 1.12 < integrator.gains["law.k2"] <= 1.125
    assert integrator.after.time < integrator.before.time
    assert min(c.slack for c in integrator.conditions) >= 0.1


@pytest.mark.heavy
def test_delay_and_sample_time_bound_the_gain_in_closed_form():
    """k1 (Ts + delay) <= 0.45 and 2 k2 <= 0.9 k1: with 0.2 s, k1 = 2.25 and k2 = 1.0125 1/s."""
    late = ["run.sample_time=0.1", "run.delay=0.1", "run.record_every=0.1"]
    found = hf.tune("ch4-integrator", candidates=250, runs=4, overrides=late)
    assert 0.98 * 1.0125 < found.gains["law.k2"] <= 1.0125
    assert found.gains["law.k1"] <= 2.25
    names = {c.condition: c for c in found.conditions}
    assert names["k1*(delay + sample_time)"].value <= 0.45


def test_margin_of_zero_goes_up_to_the_limit():
    found = hf.tune("ch4-integrator", gains=["k2=0.3:3"], margin=0.0, **MORE)
    assert 1.24 < found.gains["law.k2"] <= 1.25


def test_least_effort_of_the_chained_form_is_not_its_fastest_gain():
    fast, calm = (hf.tune("ch4-chained-3", cost, **FEW) for cost in ("time", "effort"))
    assert fast.after.time < calm.after.time
    assert calm.after.effort < fast.after.effort


def test_poles_that_the_file_leaves_out_are_gains_too(tmp_path):
    text = edited_text("ch4-chained-3", ["law.gains="])
    assert "gains" not in tomllib.loads(text)["law"]
    file = tmp_path / "chained.toml"
    file.write_text(text)
    found = hf.tune(str(file), **FEW)
    assert set(found.gains) == {"law.k1", "law.poles"}
    assert found.shipped["law.poles"] == -2.0


# -- corners


@pytest.mark.heavy
def test_corner_that_alone_breaks_a_condition_is_found_and_named():
    """k1 mu from 0.26 to 0.31 is below 0.351, and above 0.234: inertia +20 %, drag -20 %."""
    gains = ["mu=1.3:1.55"]
    nominal = hf.tune(
        "inspection", gains=gains, candidates=10, runs=2, overrides=["run.horizon=40"]
    )
    assert nominal.conditions[0].limit == pytest.approx(0.3508, abs=1e-4)
    with pytest.raises(ScenarioError) as refused:
        hf.tune("inspection", gains=gains, case="model", candidates=10, runs=2)
    said = str(refused.value)
    assert "k1*mu: at best it is 0.26, its limit 0.2338, less a margin of 10 %" in said
    assert "at inertia = 1.2, drag = 0.8 of the vehicle" in said
    assert "the sway outpaces the approach" in said


def test_every_corner_is_judged_and_the_worst_one_reported():
    """a + b + c < 3 fails at (1, 1, 2) alone of the eight corners."""
    a, b, c = (hf.symbol(n) for n in "abc")
    ends = {"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (0.0, 2.0)}
    corners = corners_of(hf.Varied(ends), {}, {}, seed=0)
    assert len(corners.of) == 8 + INTERIOR
    condition = hf.GainCondition(a + b + c, sp.Float(3.5), "it fails", "the test")
    (found,) = judged([condition], dict.fromkeys("abc", 0.0), corners, Settings(1.0))
    assert found.value == 4.0
    assert dict(found.corner) == {"a": 1.0, "b": 1.0, "c": 2.0}
    assert found.slack == pytest.approx(-0.125)


def test_worst_place_inside_the_ranges_is_found_too():
    """sin(a) is 0 at both ends of [0, pi], and above 0.9 between them."""
    a = hf.symbol("a")
    corners = corners_of(hf.Varied({"a": (0.0, np.pi)}), {}, {}, seed=0)
    condition = hf.GainCondition(sp.sin(a), sp.Float(0.5), "it fails", "the test")
    (found,) = judged([condition], {"a": 0.0}, corners, Settings(1.0))
    assert found.value > 0.9


def test_number_of_the_vehicle_that_its_law_does_not_know_counts():
    a = hf.symbol("a")
    condition = hf.GainCondition(a, sp.Float(2), "it fails", "the test")
    varied = hf.Varied({"wrong": (1.0, 3.0)}, plant={"a": a * hf.symbol("wrong")})
    corners = corners_of(varied, {}, {"a": 1.0}, seed=0)
    (found,) = judged([condition], {"a": 1.0}, corners, Settings(1.0))
    assert (found.value, found.vehicle) == (3.0, True)


@pytest.mark.heavy
def test_gains_of_every_shipped_scenario_meet_their_conditions_at_every_corner():
    """With no margin; the scenarios whose laws have conditions."""
    judged_laws = 0
    for name in scenario_names():
        scenario = load_scenario(name)
        if scenario.kind != "closed-loop" or not scenario.law.conditions:
            continue
        owners = [scenario.system, scenario.law, scenario.region, scenario.goal]
        numbers = {p.name: p.value for o in owners if o is not None for p in o.parameters}
        fields = Settings.__dataclass_fields__
        settings = Settings(**{n: v for n, v in scenario.settings.items() if n in fields})
        corners = corners_of(scenario.varied, scenario.plant, numbers, 1)
        for found in judged(scenario.law.conditions, numbers, corners, settings):
            assert found.slack >= 0, (name, found)
        judged_laws += 1
    assert judged_laws == 40  # three by the gains of their safety filters alone


# -- refusals


@pytest.mark.slow(
    "given0-on 2\\\\*k2: at best it is 4.00\\\\d, its limit 2.5",
    "given1-the spin k1 x3 / rho\\\\^2 grows without bound",
)
@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"gains": ["k2=2:3"]}, r"on 2\*k2: at best it is 4.00\d, its limit 2.5"),
        ({"gains": ["k2=2:3"]}, "the spin k1 x3 / rho\\^2 grows without bound"),
        ({"cost": "price"}, "the cost is 'price'; expected time or effort or clearance"),
        ({"cost": "clearance"}, r"needs a \[region\]; take --cost time or effort"),
        ({"margin": 1.0}, "margin is 1; expected at least 0 and below 1"),
        ({"margin": -0.1}, "at least 0 and below 1"),
        ({"candidates": 3}, "3 candidates; expected at least 10"),
        ({"runs": 0}, "0 starts; expected at least 1"),
        ({"gains": ["k7"]}, "no key 'k7'"),
        ({"gains": ["horizon=1:2"]}, r"the key is run.horizon; expected a number of \[law\]"),
        ({"gains": ["k2=1:1"]}, "expected LOW < HIGH"),
        ({"gains": ["k2", "law.k2=1:2"]}, "occurs twice"),
        ({"gains": ["escape_time=0.4:0.6"], "case": "none"}, r"\[compare.cases\] has no 'none'"),
        ({"overrides": ["law.k9=1"]}, "'steer_integrator' has no such parameter"),
    ],
)  # fmt: skip
def test_bad_input_and_conditions_that_cannot_be_met_are_refused(given, says):
    with pytest.raises(ScenarioError, match=says):
        hf.tune("ch4-integrator", **{**FEW, **given})


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("ch7-discriminating", "no law of its own to tune"),
        ("wheeled_camera", "names no gains; name numbers of"),
        ("no-such", "unknown scenario"),
    ],
)
def test_scenario_without_gains_is_refused(name, says):
    with pytest.raises(ScenarioError, match=says):
        hf.tune(name)


@pytest.mark.heavy
def test_conditions_that_no_gains_meet_together_are_named_as_such():
    """k1 <= 0.9 / 0.4 by the delay, and k1 >= 2 k2 / 0.9 >= 2.67 by the spin: each could be met."""
    late = ["run.sample_time=0.1", "run.delay=0.1", "run.record_every=0.1"]
    with pytest.raises(ScenarioError, match="together with the others"):
        hf.tune("ch4-integrator", gains=["k1=2:3", "k2=1.2:1.4"], overrides=late, **FEW)


# -- the same answer twice


@pytest.mark.heavy
def test_same_seed_gives_the_same_gains(integrator):
    again = hf.tune("ch4-integrator", gains=["k2=0.3:3"], **MORE)
    assert again.summary() == integrator.summary()
    other = hf.tune("ch4-integrator", gains=["k2=0.3:3"], seed=7, **MORE)
    assert [c.gains for c in other.candidates] != [c.gains for c in again.candidates]


def test_candidates_cost_what_a_run_of_the_scenario_with_their_gains_costs(integrator):
    """Candidates are cases of one compiled loop; a scenario with the gain is the same to the bit."""
    chosen = next(c for c in integrator.candidates if c.gains == integrator.gains)
    alone = load_scenario("ch4-integrator", integrator.settings, runs=FEW["runs"])
    since = alone.run().arrays["goal_time"].values
    assert chosen.costs.time == since.mean()


# -- files


def test_tuned_scenario_runs_and_the_files_say_the_same(integrator, tmp_path):
    files = write_tuning(integrator, tmp_path, figures=True)
    assert [f.name for f in files] == [
        "tuned.toml", "tuning.csv", "tuning.json", "tuning.png", "tuning.svg",
    ]  # fmt: skip
    tuned = load_scenario(str(tmp_path / "tuned.toml"), runs=20)
    k2 = next(p.value for p in tuned.law.parameters if p.name == "k2")
    assert k2 == integrator.gains["law.k2"]
    assert tuned.run().success_fraction == 1.0
    rows = list(csv.DictReader(tuning_table(integrator).splitlines()))
    assert len(rows) == len(integrator.candidates)
    assert {row["clearance"] for row in rows} == {"nan"}
    said = tuning_text(integrator)
    assert "2*k2" in said
    assert f"--set law.k2={k2!r}" in said


def test_edited_file_keeps_its_comments_and_its_paths_hold_in_any_folder(tmp_path):
    text = edited_text("inspection", ["law.k1=0.15"])
    before = read_tables("inspection")[2]
    assert "# m/s" in text
    assert "holdfast compare inspection" in text
    assert tomllib.loads(text)["law"] == {**before["law"], "k1": 0.15}
    own = tmp_path / "own.toml"
    own.write_text((tmp_path / "vehicle.toml").name and _with_vehicle(tmp_path))
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    (moved / "tuned.toml").write_text(edited_text(str(own), ["law.k1=0.3"]))
    assert load_scenario(str(moved / "tuned.toml")).runs == 503


def _with_vehicle(folder):
    from importlib import resources

    vehicle = resources.files("holdfast.vehicles") / "videoray_pro_iii.toml"
    (folder / "mine.toml").write_text(vehicle.read_text("utf-8"))
    text = (resources.files("holdfast.scenarios") / "ch4-marine.toml").read_text("utf-8")
    return text.replace('vehicle = "videoray_pro_iii"', 'vehicle = "mine.toml"')


# -- the command


def test_command_tunes_and_what_it_writes_runs(tmp_path):
    asked = ["--candidates", "10", "--runs", "2", "--gain", "k2=0.5:1", "--no-figures"]
    done = called("tune", "ch4-integrator", *asked, "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "best for time; conditions met with a margin of 10 % at 1 corner" in done.stdout
    assert done.stderr == ""
    again = called("run", str(tmp_path / "tuned.toml"), *FAST, "--out", str(tmp_path / "run"))
    assert again.returncode == 0, again.stderr


@pytest.mark.slow("asked2-holdfast: ch4-integrator.toml: no gains in the ranges meet")
@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (["--gain", "k1=5:1"], "holdfast: --gain k1=5:1: from 5 to 1; expected LOW < HIGH"),
        (
            ["--gain", "k1=a:1"],
            "holdfast: --gain k1=a:1: 'a' is not a number; expected KEY=LOW:HIGH",
        ),
        (["--gain", "k2=2:3"], "holdfast: ch4-integrator.toml: no gains in the ranges meet"),
        (["--cost", "price"], "holdfast: the cost is 'price'; expected time or effort or"),
        (["--margin", "2"], "holdfast: the margin is 2; expected at least 0 and below 1"),
    ],
)
def test_command_refuses_with_one_line(tmp_path, asked, says):
    done = called("tune", "ch4-integrator", *asked, "--out", str(tmp_path / "none"))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(says)
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "none").exists()


# -- costs


def test_front_leaves_out_what_another_candidate_betters(integrator):
    nan = float("nan")
    better, worse, other = (Costs(*c, nan, 0.0) for c in ((1.0, 2.0), (1.0, 3.0), (0.5, 9.0)))
    assert better.dominates(worse)
    assert not worse.dominates(better)
    assert not better.dominates(other)
    assert not better.dominates(better)
    lists = [Candidate({"k": float(i)}, 1.0, c) for i, c in enumerate((better, worse, other))]
    from dataclasses import replace

    found = replace(integrator, candidates=tuple(lists)).front
    assert [c.costs for c in found] == [better, other]


def test_larger_clearance_is_the_better_one():
    near, far = (Costs(1.0, 1.0, c, 0.0) for c in (0.1, 0.2))
    assert far.of("clearance") < near.of("clearance")
    assert far.dominates(near)


def test_follower_beyond_its_window_is_warned_of_by_run():
    """k2 = 1.1 1/s is above 1.03, where the leader may leave by the far end of the view."""
    scenario = load_scenario("ch6-moving-leader", ["law.k2=1.1", "run.horizon=1"], runs=2)
    with pytest.warns(GainWarning, match=r"k2 = 1\.1 is above its limit 1\.027"):
        scenario.run()
