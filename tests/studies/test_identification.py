"""From a log to a vehicle to a guarantee: the files that are written, and what they answer."""

import csv
import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.identification.log import Log, Signal
from holdfast.errors import ScenarioError
from holdfast.studies.identification import (
    redrawn,
    scenario_with,
    subject_of,
    vehicle_with,
    write_identified,
)
from tests.boats import boat_log, vehicle_log
from tests.command_line import called


def as_csv(log, path):
    """The signals in one table; commands end with a repetition."""
    time = next(iter(log.states.values())).time
    columns = {n: s.value for n, s in log.states.items()}
    columns |= {n: np.append(s.value, s.value[-1]) for n, s in log.inputs.items()}
    with open(path, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time", *columns])
        rows.writerows(zip(time, *columns.values(), strict=True))
    return path


@pytest.fixture(scope="module")
def otter_found():
    otter = hf.load_vehicle("otter")
    return hf.identify(otter, vehicle_log(otter), estimate=["Xu", "Nr", "Nrr"])


@pytest.mark.heavy
def test_vehicle_file_has_the_numbers_with_their_source_and_loads(tmp_path, otter_found):
    subject = subject_of("otter")
    text = vehicle_with(otter_found, subject)
    entry = tomllib.loads(text)["parameters"]["Xu"]
    assert entry["value"] == pytest.approx(otter_found.values["Xu"], rel=1e-6)
    assert "identified from marine_craft 0: 95 % from" in entry["source"]
    path = tmp_path / "boat.toml"
    path.write_text(text)
    loaded = {p.name: p.value for p in hf.load_vehicle(str(path)).parameters}
    before = {p.name: p.value for p in subject.system.parameters}
    for name, value in loaded.items():
        expected = otter_found.values.get(name, before[name])
        assert value == pytest.approx(expected, rel=1e-6), name
    again = subject_of(str(path))
    assert again.vehicle == str(path)


def test_subject_is_a_vehicle_a_system_or_a_scenario_without_its_reductions():
    assert subject_of("inspection").vehicle == "videoray_pro_iii"
    assert subject_of("ch7-six-states").vehicle == "videoray_pro_iii"
    reduced = subject_of("ch7-discriminating")
    assert {"u", "r"} <= set(reduced.system.state_names)
    assert subject_of("unicycle").vehicle == ""
    assert subject_of("marine_craft", ('vehicle="remus_100"',)).vehicle == "remus_100"
    with pytest.raises(
        ScenarioError, match="no vehicle, system, scenario or file is called 'oter'"
    ):
        subject_of("oter")


@pytest.fixture(scope="module")
def videoray_found():
    craft = hf.load_vehicle("videoray_pro_iii")
    found = hf.identify(craft, vehicle_log(craft, seconds=40.0), estimate=["Xuu"], window=1.5)
    bound = replace(found.unexplained, low=(-0.06, -0.06, -0.4), high=(0.06, 0.06, 0.4))
    return replace(found, unexplained=bound)


@pytest.mark.heavy
def test_scenario_of_the_log_has_the_vehicle_the_bound_and_a_filter_that_counts_it(
    tmp_path, videoray_found
):
    subject = subject_of("inspection")
    write_identified(videoray_found, subject, tmp_path, figures=False)
    tables = tomllib.loads((tmp_path / "identified.toml").read_text())
    assert tables["system"]["vehicle"] == "vehicle.toml"
    assert tables["system"]["unmodelled"]["r"] == [-0.4, 0.4]
    assert tables["safeguard"]["worst"] == ["unmodelled_u", "unmodelled_v", "unmodelled_r"]
    scenario = hf.load_scenario(str(tmp_path / "identified.toml"), runs=30)
    values = {p.name: p.value for p in scenario.system.parameters}
    assert values["Xuu"] == pytest.approx(videoray_found.values["Xuu"], rel=1e-6)


@pytest.mark.heavy
def test_filter_that_counts_the_bound_keeps_what_one_without_it_loses(tmp_path, videoray_found):
    write_identified(videoray_found, subject_of("inspection"), tmp_path, figures=False)
    path = str(tmp_path / "identified.toml")
    pushed = (
        'disturbance.unmodelled_v="0.06*sin(t)"',
        'disturbance.unmodelled_r="-0.4*tanh(99*sin(t))"',
        "run.horizon=40",
    )
    with_it = hf.load_scenario(path, pushed, runs=40).run()
    without = hf.load_scenario(path, (*pushed, "safeguard.worst="), runs=40).run()
    assert with_it.viable == 40
    assert without.viable < 30


@pytest.mark.heavy
def test_vehicle_file_has_the_numbers_that_were_given_too(tmp_path):
    otter = hf.load_vehicle("otter")
    subject = subject_of("otter", ("mass=60", "Nr=-50"))
    found = hf.identify(subject.system, vehicle_log(otter), estimate=["Xu", "Xudot"])
    (tmp_path / "vehicle.toml").write_text(vehicle_with(found, subject))
    written = {p.name: p.value for p in hf.load_vehicle(str(tmp_path / "vehicle.toml")).parameters}
    assert written == pytest.approx({p.name: p.value for p in found.system.parameters})
    assert (written["mass"], written["Nr"]) == (60, -50)


@pytest.mark.heavy
def test_margins_are_computed_before_and_after(tmp_path, videoray_found):
    for name, changes, of in (
        (
            "ch7-discriminating",
            ("grid.nodes=15", "march.horizon=1"),
            "current that leaves a kernel",
        ),
        ("inspection-current", ("run.horizon=1",), "disturbances that leave a place at rest"),
    ):
        subject, folder = subject_of(name, changes), tmp_path / name
        write_identified(videoray_found, subject, folder, figures=False)
        found, _ = redrawn(videoray_found, subject, folder, runs=2, figures=False)
        (row,) = (r for r in found.rows if of in r[0])
        assert row[1] == pytest.approx(row[2], rel=0.05)
        assert not found.no_margin
        without, _ = redrawn(videoray_found, subject, folder, runs=2, figures=False, margins=False)
        assert without.no_margin == "not asked for"


def test_reduced_kernel_says_what_it_cannot_count(videoray_found):
    text, missing = scenario_with(videoray_found, subject_of("ch7-discriminating"))
    assert set(missing) >= {"u", "r"}
    assert "vehicle.toml" in text


SCENARIO = """
[scenario]
title = "A boat before a pier"
[system]
states = { x = { unit = "m" }, u = { unit = "m/s" } }
inputs = { F = { unit = "N", bounds = [-40, 40] } }
rates = { x = "u", u = "(F - drag*u - quadratic*abs(u)*u)/mass" }
[system.parameters]
mass = { value = 20, unit = "kg" }
drag = { value = 11, unit = "N s/m" }
quadratic = { value = 20, unit = "N s^2/m^2" }
[region]
constraints = { pier = { expression = "x - 1", unit = "m" } }
[law]
outputs = { F = 10 }
[safeguard]
gains = [1, 3]
[starts]
random = 20
box = { x = [-3, 0], u = [-0.2, 0.2] }
[run]
horizon = 20
sample_time = 0.05
"""


@pytest.mark.few("0.3")
@pytest.mark.parametrize("swell", [0.0, 0.3])
def test_command_goes_from_a_log_to_a_scenario_and_fails_on_a_log_beyond_the_bound(tmp_path, swell):
    as_csv(boat_log(seconds=60.0), tmp_path / "log.csv")
    second = boat_log(seconds=40.0, seed=3, unknown=lambda t: swell * np.sin(t))
    as_csv(second, tmp_path / "second.csv")
    (tmp_path / "pier.toml").write_text(SCENARIO)
    arguments = ["log.csv", "--system", "pier.toml", "--held-out", "second.csv", "--hold", "mass"]
    answer = called("identify", *arguments, "--no-figures", cwd=tmp_path)
    assert answer.returncode == (1 if swell else 0), answer.stderr
    assert ("NOT within the bound" in answer.stderr) == bool(swell)
    told = json.loads((tmp_path / "runs" / "log" / "identification.json").read_text())
    drag = told["parameters"]["drag"]
    assert drag["low"] <= 8.0 <= drag["high"]
    assert told["held_out"]["covered"] is not bool(swell)
    identified = tomllib.loads((tmp_path / "runs" / "log" / "identified.toml").read_text())
    assert identified["system"]["parameters"]["drag"]["value"] == pytest.approx(drag["value"])
    assert "runs that stay in the region" in answer.stdout
    assert "filter does not count it" in answer.stdout
    assert "no margin: pier.toml" in answer.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing.csv", "--system", "otter"], "nothing.csv does not exist"),
        (["log.csv", "--system", "otter"], "no state of system"),
        (["log.csv", "--system", "pier.toml", "--column", "x"], "expected NAME=..."),
        (["log.csv", "--system", "pier.toml", "--measures", "u=sin(w)"], "unknown name 'w'"),
        (["log.csv", "--system", "pier.toml", "--level", "2"], "level is 2"),
        (["log.csv", "--system", "otter", "--runs", "3"], "otter is no scenario"),
        (["log.csv", "--system", "pier.toml", "--unexplained", "w"], "the log says nothing of 'w'"),
    ],
)
def test_command_names_what_is_wrong(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    log = Log("log", {"x": Signal(np.arange(30.0), np.arange(30.0))}, {}, 5.0)
    as_csv(log, tmp_path / "log.csv")
    (tmp_path / "pier.toml").write_text(SCENARIO)
    (tmp_path / "log.csv").write_text(
        (tmp_path / "log.csv").read_text().replace("time,x", "time,distance")
        if "otter" in arguments
        else (tmp_path / "log.csv").read_text()
    )
    answer = called("identify", *arguments)
    assert answer.returncode == 2
    assert message in answer.stderr
