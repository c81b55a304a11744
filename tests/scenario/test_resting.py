"""What is said before closed loops are run: where their disturbance leaves no place at rest."""

import json
import math

import pytest

from holdfast.errors import ScenarioError
from holdfast.scenario.kinds.closed_loop import no_rest, resting_places
from holdfast.scenario.load import load_scenario
from tests.command_line import called

ALONG = 'varied.draws.direction=["{0} deg", "{0} deg"]'


def test_current_along_the_wall_leaves_no_place_and_any_other_does():
    said = no_rest(load_scenario("inspection-current", [ALONG.format(90)]))
    assert "no place in 'camera_view' can be held in a current of 0.1 m/s along 90 degrees" in said
    assert "on the edge of the region" in said
    for direction in (-85, 60):
        assert no_rest(load_scenario("inspection-current", [ALONG.format(direction)])) == ""


def test_nothing_is_said_of_currents_that_are_drawn_or_vary_or_without_a_region():
    for name in ("inspection-current", "inspection", "ch3-veering-current", "ch3-known-current"):
        assert no_rest(load_scenario(name)) == "", name


def test_thrust_that_a_current_exceeds_is_the_reason():
    changes = [ALONG.format(0), "system.thrust_limit=0.02"]
    assert "exceed their bounds" in no_rest(load_scenario("inspection-current", changes))


@pytest.mark.heavy
def test_law_stays_in_view_where_no_place_can_be_held_and_the_summary_says_why(tmp_path):
    changes = ["--set", ALONG.format(90), "--set", "run.horizon=20", "--runs", "8", "--no-figures"]
    answer = called("run", "inspection-current", *changes, "--out", str(tmp_path))
    assert answer.returncode == 0, answer.stdout
    assert answer.stdout.startswith("no place in 'camera_view' can be held")
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["no_rest"] in answer.stdout
    assert summary["viable"] == 8
    assert summary["outcomes"]["reached goal"] == 0


@pytest.mark.heavy
def test_margin_of_every_drawn_direction_falls_to_none_along_the_wall():
    found = resting_places(load_scenario("inspection-current"), draws=36)
    lost = [math.degrees(math.atan2(f.disturbance["Vy"], f.disturbance["Vx"])) for f in found.found]
    lost = [round(d) for d, f in zip(lost, found.found, strict=True) if not f.exists]
    assert found.drawn
    assert found.answered
    assert found.summary()["at_rest"] == 34
    assert lost == [-90, 90]
    assert not found.worst.exists


def test_margin_of_closed_loops_prints_the_place_and_writes_it(tmp_path):
    answer = called("margin", "ch5-current", "--out", str(tmp_path))
    assert answer.returncode == 0, answer.stdout
    assert "a current of 0.05 m/s along 180 degrees" in answer.stdout
    (place,) = json.loads((tmp_path / "rest.json").read_text())["places"]
    assert place["exists"]
    assert place["state"]["u"] == pytest.approx(0.05, abs=1e-6)
    wall = ["--set", ALONG.format(90)]
    lost = called("margin", "inspection-current", *wall, "--out", str(tmp_path))
    assert lost.returncode == 1
    assert "on the edge of the region" in lost.stdout


def test_options_of_a_kernel_are_refused_for_closed_loops(tmp_path):
    asked = ["margin", "inspection-current", "--between", "0", "1", "--out", str(tmp_path)]
    answer = called(*asked)
    assert answer.returncode != 0
    assert "does not compute a kernel" in answer.stderr


def test_current_that_varies_with_time_has_no_place_at_rest():
    veering = 'disturbance.Vy="speed*sin(direction)*(1 + 0.1*sin(t))"'
    with pytest.raises(ScenarioError, match="not constant in a run"):
        resting_places(load_scenario("inspection-current", [veering]))


SHEAR = ["disturbance.Vx=speed*cos(direction)*(1 + 0.2*y)", "disturbance.Vy=speed*sin(direction)"]


@pytest.mark.heavy
def test_field_has_its_places_at_rest_too_and_none_along_the_wall():
    """The shear keeps the direction of a current along the wall, and turns every other one."""
    along = [ALONG.format(90), *SHEAR]
    assert "no place in 'camera_view' can be held" in no_rest(
        load_scenario("inspection-current", along)
    )
    assert no_rest(load_scenario("inspection-current", [ALONG.format(30), *SHEAR])) == ""
    found = resting_places(load_scenario("inspection-current", SHEAR), draws=12)
    assert [f.exists for f in found.found] == [k not in (3, 9) for k in range(12)]
    theta = math.radians(30)
    felt = found.found[7].disturbance  # the draws begin at -180 degrees
    at = found.found[7].state
    assert felt["Vx"] == pytest.approx(0.1 * math.cos(theta) * (1 + 0.2 * at["y"]))
    assert felt["Vy"] == pytest.approx(0.1 * math.sin(theta))


def test_field_of_time_has_no_place_at_rest_and_says_so():
    tide = ["disturbance.Vx=0.1*cos(t/10)*(1 + 0.2*y)"]
    assert no_rest(load_scenario("inspection-current", tide)) == ""
    with pytest.raises(ScenarioError, match="not constant in a run"):
        resting_places(load_scenario("inspection-current", tide))
