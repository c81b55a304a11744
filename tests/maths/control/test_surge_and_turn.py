"""Laws for a vehicle that surges and turns in a current: limits, the slowed approach, rest.

What the laws say is evaluated by NumPy from their expressions, and compared with the field, its
gradient and the motion written out by hand here.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, ScenarioError
from holdfast.maths.control.surge_and_turn import surge_and_turn

LAWS = {
    f.__name__: f for f in (hf.laws.hold_station, hf.laws.hold_station_unknown, hf.laws.weathervane)
}
COUNT = 4000
ROUNDING = 1e-9


def turned(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


NUMPY = {
    "sgn": lambda x: np.where(x >= 0, 1.0, -1.0),
    "wrap": turned,
    "select": lambda x, a, b: np.where(x >= 0, a, b),
    "least": np.minimum,
    "greatest": np.maximum,
    "magnitude": np.abs,
    "angle": lambda y, x, guard: np.arctan2(y, x),
    "length": lambda x, y, guard: np.hypot(x, y),
}


@cache
def numerical(expression, names):
    return sp.lambdify([hf.symbol(n) for n in names], expression, [NUMPY, "numpy"])


def evaluated(expression, parameters, **states):
    """An expression of a law at many states, by NumPy alone."""
    values = {p.name: p.value for p in parameters} | states
    return np.broadcast_to(numerical(expression, tuple(values))(**values), (COUNT,))


def modes(law):
    return law.modes if isinstance(law, hf.Switching) else {law.name: law}


def drawn(seed=0, **more):
    """Random poses, many of them near the origin, where the field turns fastest."""
    generator = np.random.default_rng(seed)
    size, bearing = (
        10 ** generator.uniform(-2.5, 0.7, COUNT),
        generator.uniform(-np.pi, np.pi, COUNT),
    )
    poses = {
        "x": size * np.cos(bearing),
        "y": size * np.sin(bearing),
        "psi": generator.uniform(-np.pi, np.pi, COUNT),
    }
    return poses | {n: generator.uniform(-s, s, COUNT) for n, s in more.items()}


@cache
def built(name, kind, speed_limit, turn_limit):
    if kind == "drifting_unicycle":
        system = hf.systems.drifting_unicycle(speed_limit=speed_limit, turn_limit=turn_limit)
        return LAWS[name](system), drawn()
    limits = {"speed_limit": speed_limit, "turn_limit": turn_limit}
    return LAWS[name](hf.systems.marine_vehicle(), **limits), drawn(v=0.1)


# -- limits


@pytest.mark.slow(
    "hold_station-drifting_unicycle",
    "hold_station-marine_vehicle",
    "hold_station_unknown-marine_vehicle",
)
@pytest.mark.parametrize("kind", ["drifting_unicycle", "marine_vehicle"])
@pytest.mark.parametrize("name", LAWS)
def test_both_velocities_stay_within_their_limits_in_every_mode(name, kind):
    law, states = built(name, kind, 0.3, 0.7)
    for mode in modes(law).values():
        for output, limit in (("u", 0.3), ("r", 0.7)):
            asked = np.abs(evaluated(mode.outputs[output], mode.parameters, **states))
            assert asked.max() <= limit + ROUNDING
    free, _ = built(name, kind, 1e3, 1e3)
    first = next(iter(modes(free).values()))
    for output, limit in (("u", 0.3), ("r", 0.7)):  # the limits are there for a reason
        assert np.abs(evaluated(first.outputs[output], first.parameters, **states)).max() > limit


def dipole_like(x, y, p, lam=3.0):
    """The direction of F = lam (p . r) r - p (1 - exp(-|r|^2)) and its gradient."""
    along, squared = p[0] * x + p[1] * y, x**2 + y**2
    decay, fading = -np.expm1(-squared), np.exp(-squared)
    fx, fy = (lam * along * r - q * decay for r, q in ((x, p[0]), (y, p[1])))
    # dF_i/dr_j = lam (p_j r_i + (p . r) delta_ij) - 2 p_i r_j exp(-|r|^2)
    slope = [
        [
            lam * (p[j] * (x, y)[i] + along * (i == j)) - 2 * p[i] * (x, y)[j] * fading
            for j in (0, 1)
        ]
        for i in (0, 1)
    ]
    gradient = [(fx * slope[1][j] - fy * slope[0][j]) / (fx**2 + fy**2) for j in (0, 1)]
    return np.arctan2(fy, fx), gradient


def needed_velocity(x, y, current, k1):
    """The direction of w = -k1 r - V and its gradient."""
    wx, wy = -k1 * x - current[0], -k1 * y - current[1]
    squared = wx**2 + wy**2
    return np.arctan2(wy, wx), [k1 * wy / squared, -k1 * wx / squared], np.sqrt(squared)


BELIEVED = (-0.1, 0.2)


def approach(name, kind, turn_limit):
    """(law, states, phi, wanted surge, d/dt phi in proportion to u, the rest of d/dt phi)."""
    speed_limit = 0.4
    law, states = built(name, kind, speed_limit, turn_limit)
    x, y, psi = (states[n] for n in ("x", "y", "psi"))
    sway = states.get("v", 0.0)
    heading, across = (np.cos(psi), np.sin(psi)), (-np.sin(psi) * sway, np.cos(psi) * sway)
    distance, ahead = np.hypot(x, y), np.where(x * heading[0] + y * heading[1] >= 0, 1.0, -1.0)
    current = (0.0, 0.0) if name == "hold_station_unknown" else BELIEVED
    if name == "weathervane":
        phi, gradient, size = needed_velocity(x, y, current, 0.5)
        wanted = np.minimum(size, speed_limit) * np.cos(psi - phi)
    elif name == "hold_station":
        side = -1.0  # of the current along x
        phi, gradient = dipole_like(x, y, (side * current[0], side * current[1]))
        wanted = -1.5 * ahead * distance - side * np.hypot(*current)
    else:
        phi, gradient = dipole_like(x, y, (1.0, 0.0))
        wanted = -ahead * (1.5 * distance + 0.25)
    wanted = np.clip(wanted, -speed_limit, speed_limit)
    each = gradient[0] * heading[0] + gradient[1] * heading[1]
    drift = sum(g * (v + a) for g, v, a in zip(gradient, current, across, strict=True))
    return next(iter(modes(law).values())), states, phi, wanted, each, drift


CASES = [
    (name, kind, turn)
    for name in LAWS
    for kind in ("drifting_unicycle", "marine_vehicle")
    for turn in ((0.3, 0.5) if name == "weathervane" else (0.5, 3.0))  # its w turns more slowly
]


@pytest.mark.parametrize(("name", "kind", "turn_limit"), CASES)
def test_approach_goes_no_faster_than_it_can_turn(name, kind, turn_limit):
    """|d/dt phi| <= 0.8 turn_limit along the motion asked for, wherever the current and the sway
    alone leave room for it; and no slower than that needs."""
    law, states, _, wanted, each, drift = approach(name, kind, turn_limit)
    surge = evaluated(law.outputs["u"], law.parameters, **states)
    most = 0.8 * turn_limit
    possible = np.abs(drift) <= most
    assert possible.sum() > 500
    rate = np.abs(each * surge + drift)
    assert rate[possible].max() <= most * (1 + ROUNDING)

    freely = possible & (np.abs(each * wanted + drift) <= most)
    assert 100 < freely.sum() < COUNT
    assert surge[freely] == pytest.approx(wanted[freely], rel=1e-9, abs=1e-12)

    slowed = possible & ~freely & (np.abs(each * wanted) > 1e-6)
    assert slowed.sum() > 100
    assert rate[slowed] == pytest.approx(most, rel=1e-6)
    assert (surge * wanted)[slowed].min() >= 0
    assert (np.abs(surge) <= np.abs(wanted) + ROUNDING)[slowed].all()


@pytest.mark.slow("hold_station-drifting_unicycle-0.5", "hold_station-marine_vehicle-0.5")
@pytest.mark.parametrize(("name", "kind", "turn_limit"), CASES)
def test_turn_rate_follows_the_field_along_the_slowed_motion(name, kind, turn_limit):
    """r = -k2 wrap(psi - phi) + d/dt phi, cut at turn_limit, d/dt phi with the slowed surge."""
    law, states, phi, _, each, drift = approach(name, kind, turn_limit)
    surge = evaluated(law.outputs["u"], law.parameters, **states)
    k2 = {p.name: p.value for p in law.parameters}["k2"]
    exact = np.clip(
        -k2 * turned(states["psi"] - phi) + each * surge + drift, -turn_limit, turn_limit
    )
    turn = evaluated(law.outputs["r"], law.parameters, **states)
    assert turn == pytest.approx(exact, rel=1e-6, abs=1e-6)
    assert (np.abs(exact) < turn_limit).sum() > 50


def test_where_the_current_alone_turns_the_field_too_fast_the_surge_does_not_add_to_it():
    law, states, _, wanted, each, drift = approach("hold_station", "drifting_unicycle", 0.5)
    surge = evaluated(law.outputs["u"], law.parameters, **states)
    hopeless = np.abs(drift) > 0.4 * (1 + ROUNDING)
    worse = hopeless & (each * wanted * drift > 0)
    assert 100 < worse.sum() < hopeless.sum() - 100
    assert (surge[worse] == 0).all()
    assert (np.abs(each * surge + drift)[hopeless] <= np.abs(drift)[hopeless] + ROUNDING).all()


# -- which limits


@pytest.mark.parametrize("name", LAWS)
def test_system_with_limits_of_its_own_cannot_be_given_others(name):
    system = hf.systems.drifting_unicycle(speed_limit=2.0, turn_limit=3.0)
    for given, shown in (
        ({"speed_limit": 1.0}, "1, .* has 2"),
        ({"turn_limit": 4.0}, "4, .* has 3"),
    ):
        with pytest.raises(
            DefinitionError, match=rf"{next(iter(given))} of law '{name}' is {shown}"
        ):
            LAWS[name](system, **given)
    same = LAWS[name](system, speed_limit=2.0, turn_limit=3.0)
    assert {p.name: p.value for p in same.parameters}["turn_limit"] == 3.0


@pytest.mark.parametrize("name", LAWS)
def test_marine_vehicle_must_be_given_what_it_can_follow(name):
    system = hf.systems.marine_vehicle()
    for given, missing in (
        ({"turn_limit": 1.0}, r"speed_limit \[m/s\]"),
        ({"speed_limit": 1.0}, r"turn_limit \[rad/s\]"),
    ):
        with pytest.raises(DefinitionError, match=f"'{name}' needs {missing}: .*'marine_vehicle'"):
            LAWS[name](system, **given)
    with pytest.raises(DefinitionError, match="'turn_limit' is -1; expected above 0"):
        LAWS[name](system, speed_limit=1.0, turn_limit=-1.0)
    law = LAWS[name](system, speed_limit=0.3, turn_limit=0.5)
    values = {p.name: (p.value, p.unit) for p in law.parameters}
    assert (values["speed_limit"], values["turn_limit"]) == ((0.3, "m/s"), (0.5, "rad/s"))
    assert {q.name for mode in modes(law).values() for q in mode.reads} == {"x", "y", "psi", "v"}


def marine_file(tmp_path, speed_limit):
    file = tmp_path / "marine.toml"
    file.write_text(f"""
[scenario]
title = "Marine"
[system]
name = "marine_vehicle"
[law]
name = "weathervane"
speed_limit = {speed_limit}
turn_limit = 1.0
[tracking]
u = 5.0
r = 10.0
[starts]
states = [{{ x = 1 }}]
[run]
horizon = 1
""")
    return hf.load_scenario(str(file))


def test_scenario_gives_the_limits_as_numbers(tmp_path):
    law = marine_file(tmp_path, "0.3").law
    assert {p.name: p.value for p in law.parameters}["speed_limit"] == 0.3
    with pytest.raises(ScenarioError, match=r"marine\.toml: law: .*'speed_limit' is -1"):
        marine_file(tmp_path, "-1")


def test_scenario_gives_the_limits_with_units(tmp_path):
    law = marine_file(tmp_path, '"30 cm/s"').law
    assert {p.name: p.value for p in law.parameters}["speed_limit"] == pytest.approx(0.3)


# -- which systems


PSI, U, R, VX, VY = (hf.symbol(n) for n in ("psi", "u", "r", "Vx", "Vy"))
CONTROL = {"x": U * sp.cos(PSI) + VX, "y": U * sp.sin(PSI) + VY, "psi": R}


def like_a_drifting_unicycle(**rates):
    return replace(
        hf.systems.drifting_unicycle(), name="another", rates=CONTROL | rates, pfaffian=()
    )


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize(
    "system",
    [
        hf.systems.unicycle(),
        hf.systems.car(),
        like_a_drifting_unicycle(x=U * sp.cos(PSI) + 2 * VX),
        like_a_drifting_unicycle(x=U * sp.cos(PSI) + VX + VY),
        like_a_drifting_unicycle(y=U * sp.sin(2 * PSI) + VY),
        like_a_drifting_unicycle(psi=2 * R),
        like_a_drifting_unicycle(psi=R + VX / 2),
        replace(
            hf.systems.drifting_unicycle(),
            name="still",
            disturbances=(),
            disturbance_bounds=None,
            pfaffian=(),
            rates={"x": U * sp.cos(PSI), "y": U * sp.sin(PSI), "psi": R},
        ),
    ],
    ids=lambda s: s.name,
)
def test_other_systems_are_refused_with_what_is_expected(name, system):
    with pytest.raises(DefinitionError) as caught:
        LAWS[name](system)
    said = str(caught.value)
    assert f"law '{name}' is not made for system '{system.name}'" in said
    assert "psi' = r, and disturbances of the role \"current\" that are added to x' and y'" in said
    assert "as of 'drifting_unicycle' or 'marine_vehicle'" in said


@pytest.mark.parametrize("turn", [R + U / 2, R + 1, R + sp.sin(PSI)])
def test_vehicle_that_turns_by_itself_is_refused(turn):
    with pytest.raises(DefinitionError, match="not made for system"):
        surge_and_turn("law", like_a_drifting_unicycle(psi=turn), None, None)


def test_vehicle_whose_turn_rate_moves_its_position_is_refused_as_such():
    """A reference point ahead of the axle: x' = u cos(psi) - a r sin(psi)."""
    system = like_a_drifting_unicycle(x=U * sp.cos(PSI) - R * sp.sin(PSI) / 10 + VX)
    with pytest.raises(DefinitionError, match="not made for system"):
        hf.laws.hold_station(system)


def test_position_may_drift_with_other_states_that_the_law_then_reads():
    """x' = ... + 0.1 x: the drift enters d/dt phi."""
    x, y = hf.symbol("x"), hf.symbol("y")
    vehicle = surge_and_turn("law", like_a_drifting_unicycle(x=CONTROL["x"] + x / 10), None, None)
    assert [q.name for q in vehicle.reads] == ["x", "y", "psi"]
    assert vehicle.position_rates(sp.Integer(2), (sp.S.Zero, y))[0] == 2 * sp.cos(PSI) + x / 10
    zero = (sp.S.Zero, sp.S.Zero)
    surge, rate = vehicle.along(sp.atan2(y, x), sp.S.Zero, zero)
    assert surge == 0
    assert sp.simplify(rate - -y * x / 10 / (x**2 + y**2)) == 0


# -- the sample time that the heading gains need


@pytest.mark.parametrize("name", ["hold_station", "hold_station_unknown"])
def test_heading_gain_times_sample_time_may_be_one_half_but_not_more(name):
    """k2 = 5 at 100 ms is the limit, and is allowed; without sampling there is no limit."""
    law = LAWS[name](hf.systems.drifting_unicycle())
    values = {p.symbol: p.value for p in law.parameters}
    sampling = [c for c in law.conditions if hf.SAMPLE_TIME in c.value.free_symbols]
    assert len(sampling) == {"hold_station": 3, "hold_station_unknown": 2}[name]
    for condition in sampling:
        for allowed in (0.0, 0.05, 0.1, 0.1 * (1 + 1e-15)):
            assert condition.violation(values | {hf.SAMPLE_TIME: allowed}) is None
        said = condition.violation(values | {hf.SAMPLE_TIME: 0.102})
        assert "sample_time) = 0.51 is above its limit 0.5" in said


# -- weathervane: where it comes to rest


SPEED, DIRECTION = hf.symbol("speed"), hf.symbol("direction")
ANY_CURRENT = hf.Varied(
    {"speed": (0.05, 0.4), "direction": (-np.pi, np.pi)},
    {"current_x": SPEED * sp.cos(DIRECTION), "current_y": SPEED * sp.sin(DIRECTION)},
)


def weathervaning(system, runs=60, **gains):
    data = hf.simulate(
        system,
        hf.laws.weathervane(system, **gains),
        starts=hf.Starts(random=runs, box={"x": (-2, 2), "y": (-2, 2), "psi": (-np.pi, np.pi)}),
        horizon=60.0,
        sample_time=0.05,
        substeps=1,
        record_every=1.0,
        disturbance={"Vx": hf.symbol("current_x"), "Vy": hf.symbol("current_y")},
        varied=ANY_CURRENT,
        seed=2,
    ).dataset
    return data["state"].values, data["input"].values, *data["varied"].values.T


@pytest.mark.parametrize(("speed_limit", "turn_limit"), [(10.0, 50.0), (1.0, 1.0)])
def test_weathervane_comes_to_rest_at_the_origin_with_its_bow_into_the_current(
    speed_limit, turn_limit
):
    """psi = direction of -V, u = |V|, r = 0: whatever the current and the start."""
    system = hf.systems.drifting_unicycle(speed_limit=speed_limit, turn_limit=turn_limit)
    state, given, speed, direction, _, _ = weathervaning(system)
    x, y, psi = state[:, -1].T
    assert np.hypot(x, y).max() < 1e-6
    assert np.abs(turned(psi - direction - np.pi)).max() < 1e-5
    assert given[:, -1, 0] == pytest.approx(speed, abs=1e-5)
    assert np.abs(given[:, -1, 1]).max() < 1e-4
    assert np.hypot(*state[:, 0, :2].T).max() > 1.0
    assert np.abs(state[:, -1, 2] - state[:, 0, 2]).max() > 1.0


def test_weathervane_needs_to_be_faster_than_the_current():
    """At most 0.2 m/s: held in slower currents, and carried away at |V| - 0.2 in faster ones."""
    system = hf.systems.drifting_unicycle(speed_limit=0.2, turn_limit=2.0)
    with pytest.warns(hf.GainWarning, match="not fast enough"):
        state, _, speed, _, _, _ = weathervaning(system)
    distance = np.hypot(state[:, :, 0], state[:, :, 1])
    assert distance[speed < 0.12, -1].max() < 0.01
    fast = speed > 0.25
    assert 10 < fast.sum() < 60
    carried = (distance[fast, -1] - distance[fast, -11]) / 10
    assert carried == pytest.approx(speed[fast] - 0.2, abs=5e-3)


# -- the field whose axis lies along the current


def components(field, x, y):
    return [evaluated(c, field.parameters, x=x, y=y) for c in field.components]


@pytest.mark.parametrize(
    ("current", "moment"),
    [
        ((0.3, -0.2), (0.3, -0.2)),
        ((-0.3, -0.2), (0.3, 0.2)),
        ((-0.3, 0.2), (0.3, -0.2)),
        ((-1e-9, 0.2), (1e-9, -0.2)),
        ((0.0, 0.2), (0.0, 0.2)),
        ((0.0, -0.2), (0.0, -0.2)),
        ((-0.3, 0.0), (0.3, 0.0)),
    ],
)
def test_axis_of_the_field_is_the_current_turned_to_the_side_of_the_target(current, moment):
    """p = v sgn(vx) with sgn(0) = 1, and F = lam (p . r) r - p (1 - exp(-|r|^2))."""
    field = hf.fields.dipole_in_current(lam=2.0, current_x=current[0], current_y=current[1])
    assert [float(p) for p in field.moment] == pytest.approx(moment)
    generator = np.random.default_rng(0)
    x, y = generator.normal(size=(2, COUNT))
    along = moment[0] * x + moment[1] * y
    decay = 1 - np.exp(-(x**2) - y**2)
    for found, r, p in zip(components(field, x, y), (x, y), moment, strict=True):
        assert found == pytest.approx(2.0 * along * r - p * decay, abs=1e-12)


def test_field_is_the_same_for_a_current_and_its_opposite_off_vx_zero():
    there, back = (
        hf.fields.dipole_in_current(current_x=s * 0.3, current_y=s * 0.4) for s in (1, -1)
    )
    assert there.components == back.components
    up, down = (hf.fields.dipole_in_current(current_x=0.0, current_y=s) for s in (0.4, -0.4))
    assert [sp.simplify(a + b) for a, b in zip(up.components, down.components, strict=True)] == [
        0,
        0,
    ]


def test_field_without_a_current_is_refused():
    for zero in (0, 0.0, -0.0):
        with pytest.raises(
            DefinitionError, match="the current is zero; use dipole_like without a current"
        ):
            hf.fields.dipole_in_current(current_x=zero, current_y=zero)
    with pytest.raises(DefinitionError, match="expected finite numbers"):
        hf.fields.dipole_in_current(current_x=np.nan, current_y=0.1)
    with pytest.raises(DefinitionError, match="lambda >= 1"):
        hf.fields.dipole_in_current(lam=0.5)
