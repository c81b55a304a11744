"""A scenario file and Python say the same thing by the same word."""

import dataclasses
import inspect
from importlib import resources
from typing import ForwardRef

import pytest

import holdfast as hf
from holdfast.analysis.decomposition.parts_law import FilterOptions
from holdfast.analysis.reachability.problem import Marching, MarchOptions
from holdfast.analysis.reachability.solve import PosedOptions, solve
from holdfast.analysis.safety.safety_filter import kept_law
from holdfast.errors import ArgumentError, RenamedWarning, ScenarioError
from holdfast.execution.simulation.settings import Settings, SettingsOptions
from holdfast.maths.definitions.region import Circle, Cone, Footprint, Segment
from holdfast.scenario.load import load_scenario
from holdfast.scenario.schema import closed_loop as schema
from holdfast.scenario.schema import kernel as kernel_schema
from holdfast.scenario.schema import values

OBJECTS = {"system", "law", "region", "value", "result", "progress"}
"""Arguments that are made from other tables of the file, or belong to a running program."""

TABLES = {
    # table: (its schema, what it is in Python, keys of files alone, arguments of Python alone)
    "the file": (
        schema.ScenarioSpec,
        [hf.simulate],
        {
            "scenario": "says what the file is",
            "run": "the settings of simulate, below",
            "noise": "noise_uniform and noise_normal, below",
            "figures": "arguments of the figures, below",
            "compare": "hf.compare, below",
            "redesign": "hf.redesign, below",
            "tracking": "hf.track_velocity: its gains by the names of velocities",
            "safeguard": "hf.safeguard, below",
            "observer": "hf.observe, below",
            "safety": "hf.safety_law, below",
            "kernels": "alters other files",
        },
        {
            "part": "the command line divides the work",
            "attributes": "the file stores its own text",
            "command": "--controller, and law.external",
            "horizon": "in [run]",
            "stepper": "in [run]",
            "start_outside": "in [starts]",
            "settings": "in [run]",
        },
    ),
    "[starts]": (
        schema.StartsSpec,
        [hf.Starts],
        {
            "every": "short for the same interval of every state of the box",
            "start_outside": "an argument of simulate, since starts may be an array",
        },
        {},
    ),
    "[run]": (
        schema.RunSpec,
        [Settings],
        {"stepper": "an argument of simulate"},
        {
            "noise_uniform": "in [noise]",
            "noise_normal": "in [noise]",
            "threads": "of the machine, not of the experiment",
        },
    ),
    "[varied]": (
        schema.VariedSpec,
        [hf.Varied],
        {},
        {"units": "in the draws", "cases": "tune varies gains, a sweep runs a file for each cell"},
    ),
    "[redesign]": (
        schema.RedesignSpec,
        [hf.redesign],
        {"parameters": "of the laws that the table names"},
        {},
    ),
    "[safeguard]": (
        schema.SafeguardSpec,
        [hf.safeguard],
        {"rates": "hf.limit_rates, of any law"},
        {"sample_time": "in [run]"},
    ),
    "[observer]": (schema.ObserverSpec, [hf.observe, hf.observe_set], {}, {}),
    "[safety]": (
        schema.SafetySpec,
        [hf.safety_law],
        {"kernel": "the file that computes the value", "alone": "in Python: no law is given"},
        {
            "sample_time": "in [run]",
            "delay": "in [run]",
            "scales": "in [safeguard]",
            "errors": "of the parts of a kernel",
        },
    ),
    "[compare]": (
        schema.CompareSpec,
        [hf.compare],
        {"title": "of the file's own law", "kernel": "a file", "margin": "of that kernel"},
        {"name": "the file itself", "overrides": "--set", "seed": "in [run]"},
    ),
    "[figures]": (
        schema.FiguresSpec,
        [hf.paths_figure],
        {"history": "the run of histories_figure: a table has one word for each figure"},
        {"cone_run": "the file draws those of the run of the history"},
    ),
    "[[system.pfaffian]]": (schema.PfaffianSpec, [hf.PfaffianRow], {}, {}),
    "[system]": (
        schema.SystemSpec,
        [hf.System],
        {},
        {
            "input_bounds": "bounds, at each input",
            "disturbance_bounds": "bounds, at each disturbance",
            "samples": "of the file's kernel: [march] samples",
            "promoted": "what promote says of its answer",
        },
    ),
    "a flat output": (
        values.FlatOutputSpec,
        [hf.FlatOutput],
        {},
        {"antiderivatives": "of Python and of catalogue entries"},
    ),
    "a state": (
        schema.QuantitySpec,
        [hf.Quantity],
        {},
        {"name": "the key", "role": "of disturbances alone"},
    ),
    "a disturbance": (
        schema.DisturbanceSpec,
        [hf.Quantity],
        {"bounds": "of the whole system in Python"},
        {"name": "the key", "angle": "of states alone"},
    ),
    "a parameter": (
        values.ParameterSpec,
        [hf.Parameter],
        {},
        {
            "name": "the key",
            "angle": "of states alone",
            "role": "of disturbances alone",
            "above": "of catalogue entries alone",
        },
    ),
    "a measurement": (
        schema.MeasurementSpec,
        [hf.Measurement],
        {},
        {"name": "the key", "angle": "of states alone", "role": "of disturbances alone"},
    ),
    "[law]": (
        schema.LawSpec,
        [hf.Law, hf.Switching],
        {"definitions": "Python has variables"},
        {
            "conditions": "of catalogue entries alone",
            "believed": "of catalogue entries alone",
            "safeguard": "[safeguard]",
            "lookup": "[safety]",
            "handed": "the command of another controller: SafetyFilter",
            "memory": "[observer]",
            "extra_parameters": "parameters of a law with modes are in one table",
        },
    ),
    "a transition": (
        schema.TransitionSpec,
        [hf.Transition],
        {"from": "source: 'from' is no name in Python", "to": "target, beside it"},
        {"source": "from", "target": "to"},
    ),
    "a constraint": (schema.InequalitySpec, [hf.Inequality], {}, {"name": "the key"}),
    "[region]": (
        schema.RegionSpec,
        [hf.Region],
        {
            "constraints": "inequalities: messages and results call them constraints too",
            "definitions": "Python has variables",
        },
        {"inequalities": "constraints", "reads": "what the expressions contain"},
    ),
    "a shape": (
        schema.ShapeSpec,
        [Segment, Circle, Cone, Footprint],
        {"kind": "the class"},
        {},
    ),
    "[grid]": (kernel_schema.GridSpec, [hf.grid], {}, {}),
    "[march]": (
        kernel_schema.MarchSpec,
        [hf.capture_basin, hf.backward_reachable_tube],
        {
            "times": "of every problem, among its options",
            "forever": "what the exit status answers",
            "inner": "ValueFunction.inner of the answer",
        },
        {"goal": "[goal]", "grid": "[grid]", "target": "[goal]", "options": "in [march]"},
    ),
    "[promise]": (kernel_schema.PromiseSpec, [hf.check_promise], {}, {"goal": "[goal]"}),
}


def words_of(function):
    return set(inspect.signature(function).parameters)


@pytest.mark.parametrize("table", TABLES)
def test_key_of_a_file_and_argument_of_python_are_one_word(table):
    """What differs is listed, each with its reason; a new difference fails here."""
    spec, functions, of_files, of_python = TABLES[table]
    keys = {field.alias or name for name, field in spec.model_fields.items()}
    words = set().union(*map(words_of, functions)) - OBJECTS
    assert keys - words - OBJECTS == set(of_files), "keys that Python does not know"
    assert words - keys == set(of_python), "arguments that files do not know"


def test_kernel_file_passes_every_option_of_a_march_on():
    assert kernel_schema.MarchSpec.model_config["extra"] == "allow"
    assert {"order", "precision", "tolerance"} <= set(Marching.__dataclass_fields__)


def test_noise_of_a_file_is_the_noise_of_python_by_two_words():
    keys = {f"noise_{kind}" for kind in schema.NoiseSpec.model_fields}
    assert keys == {n for n in Settings.__dataclass_fields__ if n.startswith("noise")}


FORMER = """
[scenario]
title = "a sled"
[system]
states = { x = { unit = "m" }, y = { unit = "m" }, psi = { unit = "rad", angle = true } }
[[system.pfaffian]]
COEFFICIENTS = { x = "-sin(psi)", y = "cos(psi)" }
[law]
outputs = { w1 = "1", w2 = "0" }
[region]
constraints = { near = { expression = "x - 1", unit = "m" } }
[starts]
states = [{ x = 2 }]
OUTSIDE = true
[run]
horizon = 1
CONTINUOUS
"""
NOW = {
    "COEFFICIENTS": "coefficients",
    "OUTSIDE": "start_outside",
    "CONTINUOUS": "continuous = true",
}


def load(folder, **former):
    text = FORMER
    for key, word in (NOW | former).items():
        text = text.replace(key, word)
    (folder / "sled.toml").write_text(text)
    return load_scenario(str(folder / "sled.toml"))


@pytest.mark.parametrize(
    ("key", "word", "told"),
    [
        ("COEFFICIENTS", "row", "the key 'row' is now 'coefficients'"),
        ("OUTSIDE", "outside", "the key 'outside' is now 'start_outside'"),
        ("CONTINUOUS", 'control = "continuous"', "'control' is now 'continuous': write .* = true"),
    ],
)
def test_former_word_is_understood_with_a_warning(key, word, told, tmp_path):
    now = load(tmp_path)
    with pytest.warns(RenamedWarning, match=told):
        before = load(tmp_path, **{key: word})
    assert before.settings == now.settings
    assert before.settings["continuous"] is True
    assert before.start_outside is now.start_outside is True
    assert before.system == now.system


def test_word_beside_its_former_one_is_refused(tmp_path):
    twice = 'continuous = true\ncontrol = "sampled"'
    with pytest.raises(ScenarioError, match="either 'continuous' or its former name 'control'"):
        load(tmp_path, CONTINUOUS=twice)
    with pytest.raises(ScenarioError, match="'continuous' or 'sampled', now 'continuous'"):
        load(tmp_path, CONTINUOUS='control = "smooth"')


def test_a_former_argument_is_understood_for_a_release():
    x = hf.symbol("x")
    line = hf.System("line", (hf.Quantity("x", "m"),), (), {"x": -x})
    region = hf.Region("near", line.states, (hf.Inequality("n", x**2 - 1, "m^2"),))
    asked = {"box": {"x": (-1, 1)}, "cells": 10, "sample_time": 0.1}
    with pytest.warns(RenamedWarning, match="the argument 'refine' is now 'halvings'"):
        former = hf.certify(line, region, refine=1, **asked)
    assert former.kept.depth == hf.certify(line, region, halvings=1, **asked).kept.depth == 1
    with pytest.raises(ArgumentError, match="both 'halvings' and its former name 'refine'"):
        hf.certify(line, region, refine=1, halvings=1, **asked)
    with pytest.warns(RenamedWarning, match="the argument 'starts' is now 'searches'"):
        former = hf.resting_state(line, region, starts=2)
    assert former == hf.resting_state(line, region, searches=2)


@pytest.mark.parametrize(
    "function", [hf.safeguard, hf.SafetyFilter, hf.laws.hold_station, hf.laws.steer_marine]
)
def test_whether_the_disturbance_is_measured_has_a_word_of_its_own(function):
    """`measured` is a list of names everywhere: of an observer, of a log."""
    taken = inspect.signature(function).parameters
    assert "measured" not in taken
    assert taken["disturbance_measured"].default is False
    with (
        pytest.warns(RenamedWarning, match="the argument 'measured' is now 'disturbance_measured'"),
        pytest.raises(ArgumentError, match="missing a required argument: 'system'"),
    ):
        function(measured=True)


@pytest.mark.parametrize(
    ("scenario", "table"),
    [("ch5-current", "law"), ("ch3-veering-current", "law"), ("inspection-tide", "safeguard")],
)
def test_former_key_of_a_measured_disturbance_is_understood_with_a_warning(
    scenario, table, tmp_path
):
    shipped = load_scenario(scenario)
    text = (resources.files("holdfast.scenarios") / f"{scenario}.toml").read_text("utf-8")
    assert text.count("disturbance_measured = true") == 1
    mine = tmp_path / "mine.toml"
    mine.write_text(text.replace("disturbance_measured", "measured"))
    with pytest.warns(RenamedWarning, match="the key 'measured' is now 'disturbance_measured'"):
        former = load_scenario(str(mine))
    assert former.law == shipped.law
    with pytest.raises(ScenarioError, match=f"{table}.*'measured'"):
        load_scenario(scenario, [f"{table}.measured=true"])


def test_options_are_typed():
    """What a type checker knows of `**options` are the fields of the dataclasses that take them."""
    for options, of, without in (
        (MarchOptions, Marching, ()), (SettingsOptions, Settings, ("horizon",)),
    ):  # fmt: skip
        assert dict(options.__annotations__) == {
            f.name: ForwardRef(f.type, module=f"{options.__module__}", is_class=True)
            for f in dataclasses.fields(of) if f.name not in without
        }  # fmt: skip
    taken = inspect.signature(kept_law).parameters
    assert set(FilterOptions.__annotations__) <= set(taken)
    asked = set(inspect.signature(solve).parameters) - {"arrival_steps"}
    assert set(PosedOptions.__annotations__) - set(MarchOptions.__annotations__) <= asked
