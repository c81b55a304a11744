"""A scenario file and Python say the same thing by the same word."""

import dataclasses
import inspect
import re
from importlib import resources
from pathlib import Path
from typing import Annotated, ForwardRef, Literal

import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.certificates.outer_set import OuterOptions
from holdfast.analysis.decomposition.parts_law import FilterOptions
from holdfast.analysis.reachability.problem import Marching, MarchOptions
from holdfast.analysis.reachability.solve import PosedOptions, solve
from holdfast.analysis.reachability.value_function import CertifyOptions
from holdfast.analysis.safety.safety_filter import kept_law
from holdfast.arguments import Count, OfStates, Seconds, Two
from holdfast.commands.certify import command
from holdfast.errors import ArgumentError, RenamedWarning, ScenarioError
from holdfast.execution.simulation.settings import Settings, SettingsOptions
from holdfast.interop.ros2.node import FilterNode
from holdfast.interop.ros2.node import FilterOptions as NodeOptions
from holdfast.scenario.load import load_scenario
from holdfast.scenario.schema import closed_loop as schema
from holdfast.scenario.schema import values
from holdfast.scenario.schema.kernel import CertificateSpec
from holdfast.studies.certification import certified, largest_certified

ROOT = Path(__file__).parents[1]
Pair = Annotated[tuple[float, float], Two("k1, k2")]
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
            "safeguard": "hf.safeguard",
            "obstacles": "hf.Obstacles, and what the runs meet",
            "observer": "hf.observe",
            "safety": "hf.safety_law",
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
    "a transition": (
        schema.TransitionSpec,
        [hf.Transition],
        {"from": "source: 'from' is no name in Python", "to": "target, beside it"},
        {"source": "from", "target": "to"},
    ),
}
"""Tables whose keys are written by hand: they are other tables, or the functions take long to load."""


@pytest.mark.parametrize("table", TABLES)
def test_key_of_a_file_and_argument_of_python_are_one_word(table):
    """What differs is listed, each with its reason; a new difference fails here."""
    spec, functions, of_files, of_python = TABLES[table]
    keys = {field.alias or name for name, field in spec.model_fields.items()}
    words = {word for f in functions for word in inspect.signature(f).parameters} - OBJECTS
    assert keys - words - OBJECTS == set(of_files), "keys that Python does not know"
    assert words - keys == set(of_python), "arguments that files do not know"


def dwell(place: hf.Region, hold: Seconds, drift: OfStates, gains: Pair, level: sp.Expr = 0,
          tries: Count = 3, how: Literal["slow", "fast"] = "slow") -> None:  # fmt: skip
    """A function that a table is of."""


class DwellSpec(values.Section, of=[dwell], without=["how"]):
    note: str = ""


UNITS = {"states": {"x": "m", "psi": "rad"}}


def test_keys_of_a_table_are_the_arguments_of_its_function():
    """Names, types, units and defaults are said in the signature alone."""
    written = {"hold": "2 min", "drift": {"x": "5 cm"}, "gains": [1, 2], "level": "x**2"}
    spec = values.validated(DwellSpec, written, "a.toml", "dwell")
    assert set(DwellSpec.model_fields) == {"note", "hold", "drift", "gains", "level", "tries"}
    x = hf.symbol("x")
    read = spec.read("a.toml", "dwell", UNITS, {"x": x})
    assert read == {"hold": 120.0, "drift": {"x": 0.05}, "gains": (1, 2), "level": x**2}
    assert spec.read("a.toml", "dwell", UNITS, {"x": x}, defaults=True) == read | {"tries": 3}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"held": 1}, "a.toml: dwell.held: unknown key; did you mean 'hold'"),
        ({"hold": None}, "a.toml: dwell.hold: missing key; add it"),
        ({"hold": "2 kg"}, r"a.toml: dwell.hold: .*expected a unit of time|a.toml: dwell.hold: "),
        ({"hold": True}, "a.toml: dwell.hold: got True; expected a valid number"),
        ({"tries": -1}, "a.toml: dwell.tries: got -1; expected greater than or equal to 0"),
        ({"tries": 2.5}, "a.toml: dwell.tries: got 2.5; expected a valid integer"),
        ({"gains": [1]}, r"a.toml: dwell.gains: got \[1\]; expected two numbers \[k1, k2\]"),
        ({"drift": {"y": 1}}, "a.toml: dwell.drift.y: unknown name; allowed: psi, x"),
        ({"level": "x + q"}, "a.toml: dwell.level: .*'q'"),
    ],
)
def test_what_does_not_fit_is_refused_with_file_and_key(change, said):
    written = {"hold": 1, "drift": {}, "gains": [1, 2], **change}
    table = {n: value for n, value in written.items() if value is not None}
    with pytest.raises(ScenarioError, match=said):
        values.validated(DwellSpec, table, "a.toml", "dwell").read(
            "a.toml", "dwell", UNITS, {"x": hf.symbol("x")}
        )


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
    line = hf.System("line", (hf.Quantity("x"),), (), {"x": -x})
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
    for options, function, without in (
        (FilterOptions, kept_law, {"system", "value", "law", "scales", "errors", "predicts"}),
        (CertifyOptions, hf.certify, {"system", "region", "law", "candidate"}),
        (OuterOptions, hf.outer_set, {"value", "system", "region"}),
        (NodeOptions, FilterNode.__init__, {"self", "keep"}),
    ):
        taken = {n: p.annotation for n, p in inspect.signature(function).parameters.items()}
        assert set(taken) - without == set(options.__annotations__)
        for name, hint in options.__annotations__.items():
            assert hint.__forward_arg__ == taken[name], (function, name)
    asked = set(inspect.signature(solve).parameters) - {"arrival_steps"}
    assert set(PosedOptions.__annotations__) - set(MarchOptions.__annotations__) <= asked


def test_what_a_file_asks_of_a_certificate_every_command_asks_too():
    """Each key of [certificate] is an argument of both studies, and an option of the command."""
    keys = set(CertificateSpec.model_fields)
    assert keys == {
        "cells", "sample_time", "horizon", "inputs", "uncertain", "errors", "delay", "halvings",
        "enclosure",
    }  # fmt: skip
    for study in (certified, largest_certified):
        assert keys <= set(inspect.signature(study).parameters)
    options = {parameter.name for parameter in command.params}
    assert {name.replace("errors", "error") for name in keys} <= options


FREE = {
    "ValueFunction.reported": "entries of the report",
    "PartsValue.reported": "entries of the report",
    "ValueFunction.slice": "states of its grid",
    "load_vehicle": "parameters of the vehicle",
    "systems.marine_craft": "parameters of the vehicle",
    "systems.marine_vehicle": "parameters of the vehicle",
}
"""Public functions that take any name, with what the names are of."""


def with_options():
    """The public functions and methods that take options, and the types of these."""
    for name in hf.__all__:
        of = getattr(hf, name)
        members = vars(of).items() if inspect.isclass(of) or inspect.ismodule(of) else [("", of)]
        for member, function in members:
            if not inspect.isfunction(function) or member.startswith("_"):
                continue
            for parameter in inspect.signature(function).parameters.values():
                if parameter.kind is parameter.VAR_KEYWORD:
                    yield f"{name}.{member}".strip("."), str(parameter.annotation)


def test_options_of_every_public_function_are_typed():
    free = {name for name, hint in with_options() if not hint.startswith("Unpack[")}
    assert free == set(FREE)


@pytest.mark.heavy
def test_a_misspelt_option_is_refused_by_a_type_checker(tmp_path):
    mypy = pytest.importorskip("mypy.api")
    typed = sorted({name for name, _ in with_options()} - set(FREE))
    calls = [f"    hf.{name}(*every, precison=1)" for name in typed]
    lines = [
        "from typing import Any",
        "import holdfast as hf",
        "def f(every: Any) -> None:",
        *calls,
    ]
    (tmp_path / "calls.py").write_text("\n".join(lines) + "\n")
    cache = str(ROOT / ".mypy_cache")
    said, _, _ = mypy.run(
        ["--strict", "--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", cache,
         str(tmp_path / "calls.py")]
    )  # fmt: skip
    refused = re.findall(r'Unexpected keyword argument "precison" for "(\w+)"', said)
    assert sorted(refused) == sorted(name.rpartition(".")[2] for name in typed), said
