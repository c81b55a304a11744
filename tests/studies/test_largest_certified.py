"""The largest numbers that are certified: found, proved by the other program, and beside margins."""

import json
from functools import cache

import pytest
from click.testing import CliRunner

import holdfast as hf
from holdfast.analysis.reachability.solve import Answer
from holdfast.commands.certify import command
from holdfast.errors import ScenarioError
from holdfast.scenario.files import read_tables
from holdfast.studies.certification import largest_certified, write_largest
from holdfast_check.checker import check

searched = cache(largest_certified)


@pytest.mark.heavy
def test_largest_current_of_a_target_in_view_is_near_the_speed_of_the_vehicle(tmp_path):
    """Above 0.5 m/s, at which it moves itself, any state is lost: the range grows."""
    found = searched("seen-target", "current", share=0.0)
    assert (found.low, found.high) == (pytest.approx(0.4625), pytest.approx(0.4641, abs=1e-4))
    assert found.answered
    assert found.widens
    assert found.found is not None
    assert (found.found.kept.inside, len(found.found.kept.members)) == (5114, 3997)
    assert found.found.ranges["wa"][1] == found.low
    files = write_largest(found, tmp_path, figures=False)
    assert "3997 cells for ever" in check(str(files[0]), share=0.05)
    told = json.loads((tmp_path / "largest.json").read_text())
    assert told["certificate"]["cells_certified"] == 3997
    assert [t["value"] for t in told["trials"]] == sorted(t["value"] for t in told["trials"])


@pytest.mark.heavy
def test_largest_current_is_smaller_where_more_of_the_view_is_asked_for():
    most = searched("seen-target", "current", share=0.9)
    assert most.low < searched("seen-target", "current", share=0.0).low
    shares = [t.share for t in most.trials if t.answer is Answer.HELD]
    assert min(shares) >= 0.9
    assert max(t.share for t in most.trials if t.answer is Answer.LOST) < 0.9


@pytest.mark.heavy
def test_what_is_proved_is_below_what_the_margin_of_the_kernel_finds():
    """A kernel of 20 s on the same grid is empty at more than 0.54 m/s."""
    proved = largest_certified("seen-target", "current", cells=51)
    margin = hf.disturbance_margin("seen-target", "current")
    assert margin.low == pytest.approx(0.541, abs=1e-3)
    assert proved.low < 0.5 < margin.low


@pytest.mark.heavy
def test_trials_of_a_largest_current_halve_cells():
    asked = {"between": (0.1, 0.6), "tolerance": 0.3, "cells": 25, "halvings": 1}
    found = largest_certified("seen-target", "current", **asked)
    assert found.low == pytest.approx(0.35)
    assert found.found.kept.depth == 1
    assert found.found.cells.counts == (50, 50)


@pytest.mark.heavy
def test_mass_may_be_off_by_a_ninth_with_half_of_the_states_certified(tmp_path):
    found = searched("loaded-cart", "uncertain.mass", share=0.5)
    assert found.low == pytest.approx(2.344, abs=1e-3)
    assert found.low / 20 > 1 / 9
    assert found.widens
    low, high = found.found.ranges["mass"]
    assert (low, high) == (20 - found.low, 20 + found.low)
    path = found.found.write(tmp_path / "mass.holdfast")
    assert check(str(path)) == "5503 cells for ever: 5503 of 5503 entries hold"


@pytest.mark.heavy
def test_number_that_is_no_bound_is_tried_all_over_the_interval():
    """A heavier cart brakes less: fewer cells are certified, but that is not known beforehand."""
    asked = {"between": (10.0, 40.0), "tolerance": 1.0, "share": 0.5, "cells": 61}
    exact = ["certificate.uncertain={}"]
    found = largest_certified("loaded-cart", "mass", **asked, overrides=exact)
    assert not found.widens
    assert len(found.trials) >= 9
    assert found.answered
    assert 10 < found.low < 40
    assert found.found.ranges["mass"] == (found.low, found.low)


def test_number_whose_range_the_scenario_has_is_not_searched(tmp_path):
    text = read_tables("loaded-cart")[1].replace("mass", "cart_mass")
    (tmp_path / "cart.toml").write_text(text)
    with pytest.raises(ScenarioError, match="'cart_mass' is searched, and has a range"):
        largest_certified(str(tmp_path / "cart.toml"), "cart_mass", cells=11)
    with pytest.raises(ScenarioError, match="'mass' is searched, and has a range in uncertain"):
        largest_certified("loaded-cart", "mass", cells=11)


@pytest.mark.heavy
def test_command_finds_the_largest_current_and_the_other_one_checks_it(tmp_path):
    out = tmp_path / "c"
    asked = ["seen-target", "--largest", "current", "--cells", "21", "--tolerance", "0.05"]
    answer = CliRunner().invoke(command, [*asked, "--between", "0", "0.8", "--out", str(out)])
    assert answer.exit_code == 0, answer.output
    assert "proved for     every smaller value as well" in answer.output
    assert "holdfast-check" in answer.output
    assert (out / "largest.json").exists()
    assert check(str(out / "certificate.holdfast"), share=0.2)


def test_command_says_where_the_limit_was_not_found(tmp_path):
    (tmp_path / "certificate.holdfast").write_text("of an earlier question")
    asked = ["seen-target", "--largest", "current", "--cells", "11", "--between", "0.8", "0.9"]
    answer = CliRunner().invoke(command, [*asked, "--out", str(tmp_path)])
    assert answer.exit_code == 1
    assert "0.8 m/s is not certified already" in answer.output
    assert "was not found" in answer.output
    assert not (tmp_path / "certificate.holdfast").exists()


def test_command_refuses_a_share_without_a_number_to_search():
    with pytest.raises(ScenarioError, match="--share without --largest"):
        CliRunner().invoke(command, ["seen-target", "--share", "0.5"], catch_exceptions=False)


@pytest.mark.parametrize(
    ("of", "options", "message"),
    [
        ("currant", {}, "no key 'currant'"),
        ("uncertain.mess", {}, "no parameter 'mess'"),
        ("march.horizon", {}, "no certificate depends on it"),
        ("slope", {"share": 1.5}, "share is 1.5"),
        ("slope", {"between": (0.2, 0.1)}, "between 0.2 and 0.1"),
        ("slope", {"tolerance": 2.0}, "the tolerance is 2"),
        ("uncertain.mass", {"between": (-1.0, 1.0)}, "LOW at or above 0"),
        ("uncertain.mass", {"uncertain": {"mass": (7.0, 8.0)}}, "has a range in uncertain as well"),
    ],
)
def test_what_cannot_be_searched_is_named(of, options, message):
    with pytest.raises(ScenarioError, match=message):
        largest_certified("loaded-cart", of, **options)


def test_scenario_without_a_region_to_keep_is_named():
    with pytest.raises(ScenarioError, match="is no kernel of a region"):
        largest_certified("inspection", "k1")
