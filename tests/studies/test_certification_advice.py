"""Certificates as a scenario asks for them, and which of their numbers helps, by trials."""

import math
import re
import shlex

import pytest
from click.testing import CliRunner

from holdfast.analysis.certificates.reading import read_certificate
from holdfast.commands.certify import command
from holdfast.errors import ModelWarning, ScenarioError, SimulationError
from holdfast.presentation.studies.certificate import advice_text
from holdfast.scenario.load import load_scenario
from holdfast.studies import certification
from holdfast.studies.certification import certified, what_helps
from tests.command_line import called


@pytest.mark.parametrize(
    ("scenario", "cells"),
    [
        ("ferry-banks", 19597),
        pytest.param("held-station", 7455, marks=pytest.mark.heavy),
        pytest.param("leader-gains", 40200, marks=pytest.mark.heavy),
    ],
)
def test_scenario_proves_what_the_page_says_without_options(scenario, cells):
    assert len(certified(scenario).kept.members) == cells


def advised(answer):
    """The options that help, and the shares that they had."""
    lines = answer.stdout.partition("what helps")[2].splitlines()
    found = [re.match(r" *(--.+): ([\d.]+) %", line) for line in lines]
    return [(shlex.split(m[1]), float(m[2])) for m in found if m]


@pytest.mark.heavy
def test_number_that_helps_is_named_and_helps(tmp_path):
    asked = ("certify", "held-station", "--no-figures", "--out", tmp_path)
    answer = called(*asked, "--set", "certificate.sample_time=0.1")
    assert "6089 of 7669 cells in the region (79.4 %)" in answer.stdout
    (option, share), *others = advised(answer)
    assert (option, share) == (["--sample-time", "0.02"], 97.2)
    assert all(79.4 + 2 <= other < share for _, other in others)
    assert {option[0] for option, _ in others} == {"--cells", "--inputs"}
    better = called(*asked, *option)
    assert f"({share} %)" in better.stdout
    assert "what helps" not in better.stdout


@pytest.mark.heavy
def test_no_cell_leaves_no_certificate_and_says_what_helps(tmp_path):
    asked = ("certify", "ferry-banks", "--cells", "81", "--no-figures", "--out", tmp_path)
    assert called(*asked).returncode == 0
    assert (tmp_path / "certificate.holdfast").exists()
    answer = called(*asked, "--set", "certificate.sample_time=0.1")
    assert answer.returncode == 1
    assert "holdfast: no cell is certified" in answer.stderr
    assert "From every state" not in answer.stdout
    assert [f.name for f in tmp_path.iterdir()] == ["certificate.json"]
    (option, share), *_ = advised(answer)
    assert f"({share} %)" in called(*asked, *option).stdout


@pytest.mark.heavy
def test_what_does_not_help_is_said():
    answer = called("certify", "loaded-cart", "--no-figures")
    told = answer.stdout.partition("what helps")[2].splitlines()
    assert told[0].strip() == "none of these alone, by 2 % or more:"
    assert {line.split()[0] for line in told[1:]} == {"--sample-time", "--inputs", "--cells"}


@pytest.mark.heavy
def test_trials_are_of_fewer_cells_where_there_are_many(monkeypatch):
    monkeypatch.setattr(certification, "MOST_CELLS", 3000)
    cells = {"ahead": 21, "left": 27, "v": 11}
    options = {"cells": cells, "sample_time": 1.5, "errors": {"left": 0.02}}
    strong = ("system.parameters.current.value=0.25",)
    found = certified("seen-with-sway", strong, **options)
    assert found.kept.share < certification.ENOUGH
    progress = []
    advice = what_helps(
        found, "seen-with-sway", strong, options, lambda _, done: progress.append(done)
    )
    assert progress == [k / 8 for k in range(8)]
    times = [f"--sample-time {t}" for t in ("0.75", "3", "0.3", "7.5", "0.15")]
    twice = "--set 'certificate.cells={ahead = 42, left = 54, v = 22}'"
    assert set(advice.tried) == {*times, "--inputs 9", twice}
    best = advice.changes[0]
    assert best.option in times
    assert best.cells == (16, 21, 9)
    assert best.share >= best.before + certification.GAIN
    assert "tried on 16 x 21 x 9 cells, which have" in advice_text(advice)


@pytest.mark.heavy
def test_trials_have_no_more_cells_than_were_asked_for():
    """Twice the cells are tried as they are advised; where they are too many they are not."""
    found = certified("loaded-cart", cells=2)
    advice = what_helps(found, "loaded-cart", (), {"cells": 2})
    assert "--cells 4" in advice.tried
    assert all(change.cells is None for change in advice.changes)
    found = certified("loaded-cart", cells=170)
    advice = what_helps(found, "loaded-cart", (), {"cells": 170})
    assert advice is not None
    assert not any("cells" in option for option in advice.tried)


def test_trials_are_of_the_edges_that_were_asked_for():
    """Whoever follows the advice has the share that it says."""
    edges = [-1.02, *(round(-1 + 0.2 * k, 1) for k in range(11)), 1.02]
    own = [f"certificate={{sample_time=0.4, cells={{x={edges}, v=25}}}}"]
    advice = what_helps(certified("loaded-cart", own), "loaded-cart", own, {})
    shares = {change.option: change.share for change in advice.changes}
    followed = certified("loaded-cart", own, sample_time=0.8)
    assert shares["--sample-time 0.8"] == followed.kept.share


@pytest.mark.heavy
def test_trials_that_are_refused_are_not_told():
    options = {"delay": 0.15, "cells": 41}
    found = certified("loaded-cart", **options)
    tried = what_helps(found, "loaded-cart", (), options).tried
    assert [o for o in tried if o.startswith("--sample-time")] == [
        "--sample-time 0.4", "--sample-time 1"
    ]  # fmt: skip


@pytest.mark.heavy
def test_more_inputs_are_told_as_they_can_be_asked_for():
    override = ["certificate.inputs={F = 3}"]
    found = certified("loaded-cart", override, cells=21)
    assert "--inputs 5" in what_helps(found, "loaded-cart", override, {"cells": 21}).tried


def test_interrupted_trials_leave_the_answer(monkeypatch, tmp_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(certification, "what_helps", interrupted)
    asked = ["held-station", "--cells", "31", "--set", "certificate.sample_time=0.1"]
    answer = CliRunner().invoke(command, [*asked, "--no-figures", "--out", str(tmp_path)])
    assert answer.exit_code == 0
    assert "check it" in answer.output
    assert "what helps" not in answer.output


def test_options_replace_what_the_scenario_asks():
    own = ["certificate={sample_time='200 ms', horizon=1, inputs={F=3}, errors={x='1 cm'}}"]
    found = certified("loaded-cart", own, cells=21)
    assert found.hold == 0.2
    assert found.kept.holds == 5
    assert found.candidates.shape == (3, 1)
    assert found.sampling.errors == (0.01, 0.0)
    assert found.ranges["mass"] == (20.0, 20.0)
    found = certified("loaded-cart", own, cells=21, horizon=math.inf, errors={"v": 0.02}, inputs=5)
    assert found.kept.holds is None
    assert found.candidates.shape == (5, 1)
    assert found.sampling.errors == (0.01, 0.02)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (
            "certificate.uncertain={mess=[1, 2]}",
            "uncertain.mess: unknown name; did you mean 'mass'",
        ),
        ("certificate.errors={mass=1}", "certificate.errors.mass: unknown name"),
        ("certificate.sample_time='2 m'", "the unit 'm' does not fit; expected 's'"),
        ("certificate.cell=3", "certificate.cell: unknown key; did you mean 'cells'"),
        ("certificate.halvings=-1", "certificate.halvings"),
    ],
)
def test_what_a_certificate_cannot_be_asked_is_refused(override, said):
    with pytest.raises(ScenarioError, match=re.escape(said)):
        load_scenario("loaded-cart", [override])


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("certificate.inputs={G=3}", "inputs names 'G', which is no input"),
        ("certificate.cells={x=11, w=11}", "cells names 'w', which is no state"),
    ],
)
def test_counts_of_what_the_system_has_not_are_refused(override, said):
    with pytest.raises(SimulationError, match=said):
        certified("loaded-cart", [override])


def test_cells_of_one_state_leave_those_of_the_others_and_parameters_are_of_the_region_too():
    found = certified("loaded-cart", ["certificate={cells={v=7}}"])
    assert found.cells.counts == (101, 7)
    kept = load_scenario("seen-with-sway", ["certificate.uncertain={clearance=[0, '1 cm']}"])
    assert kept.certificate["uncertain"] == {"clearance": (0.0, 0.01)}


def test_enclosure_is_asked_by_the_scenario_or_the_command(monkeypatch, tmp_path):
    monkeypatch.setattr(certification, "what_helps", lambda *_: None)
    asked = ["loaded-cart", "--cells", "31", "--no-figures", "--out", str(tmp_path)]
    CliRunner().invoke(command, [*asked, "--enclosure", "zonotope"])
    with pytest.warns(ModelWarning, match="was not checked"):
        found = read_certificate(tmp_path / "certificate.holdfast", check=0)
    assert found.sampling.enclosure == "zonotope"
    own = ["certificate.enclosure='zonotope'"]
    assert certified("loaded-cart", own, cells=3).sampling.enclosure == "zonotope"
    answer = CliRunner().invoke(command, [*asked, "--enclosure", "zonotop"])
    assert "did you mean 'zonotope'" in str(answer.exception)


def test_outer_sets_take_no_table():
    answer = called("certify", "seen-target", "--outer", "none.nc", "--set", "certificate.cells=5")
    assert answer.returncode == 2
    assert "--set certificate with --outer" in answer.stderr


def test_sets_that_are_not_certified_have_no_certificate():
    with pytest.raises(ScenarioError, match="a forward-reachable-set is not certified"):
        load_scenario("ch7-forward-reach", ["certificate.cells=5"])
