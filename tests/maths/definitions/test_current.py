"""A current is a role, not a name: an own system whose current is called otherwise is as good."""

import copy
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.reachability.problem import definition
from holdfast.errors import DefinitionError, GainWarning, RenamedWarning, ScenarioError
from holdfast.maths.definitions.bounds import Ball, Box, Product
from holdfast.maths.definitions.quantity import Quantity, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.written import read, written
from holdfast.scenario.files import read_tables
from holdfast.scenario.load import scenario_of
from holdfast.studies.scenario_parameter import find_knob

WINDS = {"Vx": "wind_east", "Vy": "wind_north"}
RENAMED = {symbol(former): symbol(now) for former, now in WINDS.items()}


def with_winds(system):
    """The same system with the names of a user, the component along y declared first."""
    blown = hf.renamed(system, WINDS)
    return replace(blown, name=system.name, disturbances=blown.disturbances[::-1])


def without_roles(system):
    return replace(system, disturbances=tuple(replace(q, role="") for q in system.disturbances))


# -- the role


@pytest.mark.parametrize(
    ("quantity", "complaint"),
    [
        ({"unit": "m/s", "role": "wind"}, "'w' has the role 'wind'; expected 'current', or none"),
        ({"unit": "m", "role": "current"}, "current 'w' has unit 'm'; expected unit 'm/s'"),
        ({"unit": "m/s", "role": ["current"]}, r"'w' has the role \['current'\]"),
    ],
)
def test_role_that_nothing_has_is_refused(quantity, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        Quantity("w", **quantity)


def test_current_is_found_by_its_role_and_its_axis():
    blown = with_winds(hf.systems.marine_vehicle())
    assert [q.name for q in blown.current] == ["wind_north", "wind_east"]
    assert [q.name for q in blown.current_along("x", "y")] == ["wind_east", "wind_north"]
    assert [q.name for q in blown.current_along("y")] == ["wind_north"]
    assert blown.current_along("x", "psi") is None
    assert without_roles(blown).current_along("x", "y") is None
    twice = replace(blown, pfaffian=(), rates=blown.rates | {"x": 2 * blown.rates["x"]})
    assert twice.current_along("x") is None


def test_largest_current_follows_from_its_bounds():
    w, f = symbol("w"), symbol("f")
    blown = without_roles(with_winds(hf.systems.drifting_unicycle()))
    force = (Quantity("push", "m/s"),)
    winds = tuple(replace(q, role="current") for q in blown.disturbances)

    def largest(bounds, disturbances=winds):
        parameters = (*blown.parameters, *(hf.Parameter(n, "m/s", value=0.3) for n in "wf"))
        bounded = replace(
            blown, parameters=parameters, disturbances=disturbances, disturbance_bounds=bounds
        )
        return bounded.largest_current

    assert largest(Ball(w, 2)) == w
    assert largest(Box((-w, -w), (w, w))) == sp.sqrt(2) * sp.Abs(w)
    assert largest(Box((-1, -0.5), (0.2, 0.5))).evalf() == pytest.approx(math.hypot(1, 0.5))
    assert largest(None) is None
    assert largest(Product((Box((-f,), (f,)), Ball(w, 2))), force + winds) == w
    assert largest(Ball(w, 3), force + winds) is None
    assert largest(Ball(w, 2), blown.disturbances) is None


# -- definitions and files that stand


@pytest.mark.parametrize(
    ("system", "digest"),
    [
        (hf.systems.marine_vehicle, "bf08e258b1890374"),
        (hf.systems.drifting_unicycle, "fec5bca0ebd32e6b"),
        (hf.systems.marine_craft, "92b428e675bb005c"),
    ],
)
def test_role_leaves_the_digest_of_a_stored_kernel(system, digest):
    assert definition(system()) == definition(without_roles(system())) == digest


def test_role_is_written_and_a_file_from_before_it_is_read():
    blown = with_winds(hf.systems.marine_vehicle())
    again = read(json.loads(json.dumps(written(blown))), System)
    assert again == blown
    assert [q.role for q in again.disturbances] == ["current", "current"]
    former = written(blown)
    for disturbance in former["what"]["disturbances"]:
        assert disturbance.pop("role") == "current"
    plain = without_roles(blown)
    assert former == written(plain)
    assert "role" not in json.dumps(former)
    assert read(former, System) == plain
    odd = copy.deepcopy(former)
    odd["what"]["disturbances"][0]["role"] = "wind"
    with pytest.raises(DefinitionError, match="has the role 'wind'"):
        read(odd, System)
    odd["what"]["disturbances"][0]["role"] = 1
    with pytest.raises(DefinitionError, match="nobody wrote"):
        read(odd, System)


# -- laws


CRAFT = hf.systems.marine_craft("cybership_ii_full")
VEHICLE = hf.systems.marine_vehicle()
LIMITS = {"speed_limit": 0.5, "turn_limit": 1.0}
LAWS = {
    "hold_station": lambda s: hf.laws.hold_station(s, **LIMITS),
    "hold_station, measured": lambda s: hf.laws.hold_station(
        s, disturbance_measured=True, r2=1.0, **LIMITS
    ),
    "hold_station_unknown": lambda s: hf.laws.hold_station_unknown(s, **LIMITS),
    "weathervane": lambda s: hf.laws.weathervane(s, **LIMITS),
    "steer_marine": lambda s: hf.laws.steer_marine(s, disturbance_measured=True),
    "rest_in_current": hf.laws.rest_in_current,
}


def renamed_expressions(law):
    """All that a law computes, what it reads and believes, by the names of a user."""
    modes = law.modes.values() if isinstance(law, hf.Switching) else [law]
    transitions = law.transitions if isinstance(law, hf.Switching) else ()
    return (
        [{n: e.xreplace(RENAMED) for n, e in mode.outputs.items()} for mode in modes],
        [[WINDS.get(q.name, q.name) for q in mode.reads] for mode in modes],
        [
            {WINDS.get(n, n): e.xreplace(RENAMED) for n, e in mode.believed.items()}
            for mode in modes
        ],
        [t.when.xreplace(RENAMED) for t in transitions],
        [(c.value, c.limit) for c in law.conditions],
    )


@pytest.mark.parametrize("name", LAWS)
def test_law_is_the_same_whatever_the_current_is_called(name):
    own, shipped = LAWS[name](with_winds(VEHICLE)), LAWS[name](VEHICLE)
    assert renamed_expressions(own) == renamed_expressions(shipped)


def test_pose_is_held_in_a_current_of_any_name():
    own = hf.laws.hold_pose(with_winds(CRAFT), current_x=0.1)
    assert own.believed == {
        "wind_east": symbol("current_x"), "wind_north": symbol("current_y"),
    }  # fmt: skip
    assert hf.laws.hold_pose(without_roles(with_winds(CRAFT))).believed == {}


@pytest.mark.parametrize("name", ["hold_station", "weathervane", "hold_station_unknown"])
def test_vehicle_without_a_current_is_refused_and_told_the_role(name):
    with pytest.raises(DefinitionError, match='disturbances of the role "current"'):
        LAWS[name](without_roles(with_winds(VEHICLE)))


@pytest.mark.parametrize("name", ["steer_marine", "rest_in_current"])
def test_law_that_measures_no_current_is_refused_with_the_remedy(name):
    with pytest.raises(DefinitionError, match=f'{name} has to measure .*role="current"'):
        LAWS[name](without_roles(with_winds(VEHICLE)))


def test_former_names_are_the_current_for_a_release_with_a_warning():
    with pytest.warns(RenamedWarning, match=r"Vx and Vy of system .* say role=.current. of them"):
        former = LAWS["weathervane"](without_roles(VEHICLE))
    assert former == LAWS["weathervane"](VEHICLE)
    with pytest.warns(RenamedWarning):
        assert without_roles(VEHICLE).largest_current == symbol("current_limit")


def test_runs_with_a_current_of_another_name_are_the_same_runs():
    starts = [[-0.5, 0.3, 0.2], [0.4, 0.4, -2.0]]
    shipped = hf.systems.drifting_unicycle(speed_limit=1.0, turn_limit=5.0)
    data = []
    for system, names in ((shipped, ("Vx", "Vy")), (with_winds(shipped), WINDS.values())):
        law = hf.laws.hold_station(system, disturbance_measured=True)
        felt = dict(zip(names, (-0.1, 0.2), strict=True))
        data.append(hf.simulate(system, law, starts=starts, disturbance=felt, horizon=5.0))
    own, other = (d.arrays["state"].values for d in data)
    np.testing.assert_allclose(own, other, rtol=0, atol=1e-9)  # sums are in the order of names


# -- places at rest


def test_place_at_rest_is_told_in_the_words_of_a_current():
    view = hf.regions.camera_view()
    box = {"x": (-3.0, -0.2), "y": (-2.0, 2.0), "psi": (-1.5, 1.5)}
    felt = {"wind_east": 0.06, "wind_north": 0.08}
    rest = hf.resting_state(with_winds(VEHICLE), view, felt, box=box)
    shipped = hf.resting_state(VEHICLE, view, {"Vx": 0.06, "Vy": 0.08}, box=box)
    units = dict.fromkeys(felt, "m/s")
    assert rest.words(units) == shipped.words({}) == "a current of 0.1 m/s along 53.13 degrees"
    plain = hf.resting_state(without_roles(with_winds(VEHICLE)), view, felt, box=box)
    assert plain.words(units) == "wind_north = 0.08 m/s, wind_east = 0.06 m/s"


def test_directions_at_rest_are_those_of_the_current_along_x_and_y():
    view = hf.regions.camera_view()
    box = {"x": (-3.0, -0.2), "y": (-2.0, 2.0), "psi": (-1.5, 1.5)}
    ends = hf.resting_directions(with_winds(VEHICLE), view, 0.1, count=4, box=box, searches=2)
    assert [
        (round(e.disturbance["wind_east"], 9), round(e.disturbance["wind_north"], 9)) for e in ends
    ] == [(0.1, 0.0), (0.0, 0.1), (-0.1, 0.0), (0.0, -0.1)]


# -- scenarios

BOAT = """
[scenario]
title = "A boat in the wind"
{kind}
[system]
states = {{ x = {{ unit = "m" }}, y = {{ unit = "m" }}, psi = {{ unit = "rad", angle = true }} }}
inputs = {{ u = {{ unit = "m/s", bounds = [-1, 1] }}, r = {{ unit = "rad/s", bounds = [-2, 2] }} }}
rates = {{ x = "u*cos(psi) + wind_east", y = "u*sin(psi) + wind_north", psi = "r" }}
parameters = {{ wind_limit = {limit} }}
[system.disturbances]
wind_north = {{ unit = "m/s", bounds = ["-wind_limit", "wind_limit"], role = "current" }}
wind_east = {{ unit = "m/s", bounds = ["-wind_limit", "wind_limit"], role = "current" }}
"""
STATION = """
[law]
name = "hold_station"
current_x = -0.3
current_y = 0.4
speed_limit = 1.0
turn_limit = 2.0
[disturbance]
wind_east = -0.3
wind_north = 0.4
[starts]
states = [{ x = 0.3 }]
[run]
horizon = 1
"""
KERNEL = """
[region]
constraints = { near = { expression = "x**2 + y**2 - 1", unit = "m^2" } }
[grid]
nodes = 11
box = { x = [-1.2, 1.2], y = [-1.2, 1.2], psi = ["-180 deg", "180 deg"] }
[march]
horizon = 0.1
"""
LIMIT = '{ value = 0.3, unit = "m/s" }'


def knob(folder, rest, *, kind="", limit=LIMIT, changes=()):
    file = folder / "boat.toml"
    file.write_text(BOAT.format(kind=kind, limit=limit) + rest)
    shown, text, data = read_tables(str(file), changes)
    return find_knob(scenario_of(shown, text, data), data, "current.speed")


def test_speed_of_a_prescribed_current_of_another_name_is_varied_and_believed(tmp_path):
    of = knob(tmp_path, STATION)
    assert of.own == pytest.approx(0.5)
    settings = {k: float(v) for k, v in (s.split("=") for s in of.settings(1.0))}
    assert settings == pytest.approx({
        "disturbance.wind_east": -0.6, "disturbance.wind_north": 0.8,
        "law.current_x": -0.6, "law.current_y": 0.8,
    })  # fmt: skip


@pytest.mark.parametrize(("limit", "key"), [(LIMIT, "wind_limit.value"), ("0.3", "wind_limit")])
def test_largest_current_of_another_name_is_searched(limit, key, tmp_path):
    of = knob(tmp_path, KERNEL, kind='kind = "discriminating-kernel"', limit=limit)
    assert (of.key, of.unit, of.own) == ("current.speed", "m/s", pytest.approx(0.3 * math.sqrt(2)))
    ((name, value),) = (s.split("=") for s in of.settings(math.sqrt(2)))
    assert name == f"system.parameters.{key}"
    assert float(value) == pytest.approx(1.0)


def test_margin_of_an_own_current_is_found(tmp_path):
    knob(tmp_path, KERNEL, kind='kind = "discriminating-kernel"')
    found = hf.disturbance_margin(
        str(tmp_path / "boat.toml"), between=(0.1, 2.0), tolerance=0.5,
        overrides=["march.horizon=3"],
    )  # fmt: skip
    assert found.settings[-1].startswith("system.parameters.wind_limit.value=")
    assert found.low is not None
    assert found.low < 2.0


def test_current_without_a_number_of_its_speed_is_refused_with_the_remedy(tmp_path):
    game = 'kind = "discriminating-kernel"'
    fixed = [f"system.disturbances.wind_{n}.bounds=[-0.3, 0.2]" for n in ("east", "north")]
    with pytest.raises(ScenarioError, match=r"wind_east in \[disturbance.*prescribe one: --set"):
        knob(tmp_path, KERNEL, kind=game, changes=fixed)
    with pytest.raises(ScenarioError, match="'wind'; expected '' or 'current'"):
        knob(tmp_path, STATION, changes=['system.disturbances.wind_east.role="wind"'])
    plain = [f"system.disturbances.wind_{n}.role=''" for n in ("east", "north")]
    with pytest.raises(ScenarioError, match="has no current; expected disturbances of the role"):
        knob(tmp_path, KERNEL, kind=game, changes=plain)
    with pytest.raises(ScenarioError, match='disturbances of the role "current" that are added'):
        knob(tmp_path, STATION, changes=plain)


def test_page_of_a_boat_has_its_current(tmp_path):
    file = tmp_path / "boat.toml"
    file.write_text(BOAT.format(kind="", limit="0.5") + STATION)
    with pytest.warns(GainWarning, match="entering the ball is not proved"):
        page = hf.explore(str(file))
    assert '"given": ["wind_north", "wind_east"]' in page
    assert '"current": ["wind_east", "wind_north"]' in page
