"""A law kept viable by the least change of its inputs: exact cases, promises, refusals."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.settings import SafeguardAnswer
from holdfast.maths.expressions.functions import wrap

K1, K2 = 1.0, 4.0
X, V, A, W = (hf.symbol(n) for n in "xvaw")
RATE, PHASE, SIZE = (hf.symbol(n) for n in ("rate", "phase", "size"))

# -- x'' = a, |a| <= 1, x <= 1: the filtered input in closed form


@pytest.fixture(scope="module")
def restless(double_integrator):
    """A law that wants whatever its parameters say: a push and a sine, of any size, and a drag."""
    wanted = SIZE * (sp.sin(RATE * hf.TIME + PHASE) + hf.symbol("push")) - hf.symbol("drag") * V
    numbers = {"size": "m/s^2", "rate": "1/s", "phase": "rad", "push": "1", "drag": "1/s"}
    parameters = tuple(hf.Parameter(n, unit, value=1.0) for n, unit in numbers.items())
    return hf.Law(
        "restless",
        double_integrator.states,
        {"a": wanted},
        parameters=parameters,
        signals={"wanted": wanted},
    )


DRAWS = {"size": (0, 30), "rate": (2, 8), "phase": (0, 6), "push": (0.3, 2), "drag": (0, 1)}


def kept_from_the_wall(system, law, wall, starts, *, margin=0.0, draws=DRAWS, **settings):
    guarded = hf.safeguard(system, law, wall, gains=(K1, K2), margins={"wall": margin})
    return hf.simulate(
        system,
        guarded,
        starts=starts,
        region=wall,
        varied=hf.Varied(draws=draws),
        **({"horizon": 20.0, "record_every": 0.02} | settings),
    )


def grid_of_safe_starts(margin=0.0):
    """c = x - 1 + margin <= 0, dc/dt + k1 c <= 0, and slow enough for |a| <= 1 to brake."""
    found = []
    for x in np.linspace(-0.5, 1.0 - margin, 12):
        for v in np.linspace(-0.4, K1 * (1.0 - margin - x), 10):
            found.append((x, min(v, 0.8)))
    return np.array(found)


def test_filtered_acceleration_is_the_closed_form(double_integrator, restless, wall):
    """a = clip(min(w, -(k1 + k2) v - k1 k2 (x - 1)), -1, 1) at every sample of every run."""
    data = kept_from_the_wall(double_integrator, restless, wall, grid_of_safe_starts()).dataset
    x, v = (data["state"].sel(state_name=n).values for n in "xv")
    wanted = data["signal"].sel(signal_name="wanted").values
    expected = np.clip(np.minimum(wanted, -(K1 + K2) * v - K1 * K2 * (x - 1)), -1, 1)
    assert np.abs(data["input"].values[..., 0] - expected).max() < 1e-9
    assert (expected < np.clip(wanted, -1, 1) - 0.1).mean() > 0.2  # it has work to do


def test_result_tells_what_the_law_asked_for_and_where_it_was_overruled(
    double_integrator, restless, wall
):
    """Saturation at |a| = 1 alone is not the safeguard's doing, and is not counted as such."""
    found = kept_from_the_wall(double_integrator, restless, wall, grid_of_safe_starts())
    data = found.dataset
    wanted = data["signal"].sel(signal_name="wanted").values
    assert np.array_equal(data["nominal"].sel(input_name="a").values, wanted)
    assert data["nominal"].attrs["units"] == "m/s^2"
    x, v = (data["state"].sel(state_name=n).values for n in "xv")
    admitted = -(K1 + K2) * v - K1 * K2 * (x - 1)
    clear = np.abs(admitted - np.clip(wanted, -1, 1)) > 1e-6
    overruled = (admitted < np.clip(wanted, -1, 1)) & clear
    saturated = (np.abs(wanted) > 1) & ~overruled & clear
    assert saturated.mean() > 0.1
    assert np.abs(overruled.sum(axis=1) - data["overruled"].values).max() <= (~clear).sum()
    assert (~clear).sum() < 1e-3 * clear.size
    answers = data["safeguard"].values
    assert np.array_equal((answers == SafeguardAnswer.OVERRULED)[clear], overruled[clear])
    summary = found.summary()["safeguard"]
    assert summary["samples_overruled"] == data["overruled"].values.sum() > 0
    assert summary["runs_overruled"] == (data["overruled"].values > 0).sum()
    assert (data["slack"].values == 0).all()


def test_slack_of_every_sample_is_what_the_brake_lacks(double_integrator, restless, wall):
    """At full brake a = -1: (k1 + k2) v + k1 k2 (x - 1) - 1 where that is above 0, else none."""
    found = kept_from_the_wall(double_integrator, restless, wall, [[0.5, 2.0], [0.0, 0.0]])
    data = found.dataset
    x, v = (data["state"].sel(state_name=n).values for n in "xv")
    lacking = (K1 + K2) * v + K1 * K2 * (x - 1) - 1
    slack = data["slack"].values
    assert slack == pytest.approx(np.maximum(lacking, 0), abs=1e-9)
    assert data["slack"].dims == ("run", "time")
    assert data["slack"].attrs["units"] == "m/s^2"
    assert (slack > 0).sum(axis=1).tolist() == data["infeasible"].values.tolist()
    assert np.array_equal(data["safeguard"].values == SafeguardAnswer.INFEASIBLE, slack > 0)
    assert (data["overruled"].values >= data["infeasible"].values).all()


def test_without_a_safeguard_there_is_no_nominal_command_and_no_slack(double_integrator, restless):
    found = hf.simulate(double_integrator, restless, starts=[[0.0, 0.0]], horizon=0.2)
    assert not {"nominal", "nominal_actuator", "slack", "overruled"} & set(found.dataset)
    assert found.summary()["safeguard"] == {}


@pytest.mark.parametrize("margin", [0.0, 0.2])
def test_wall_is_never_reached_whatever_the_law_wants(double_integrator, restless, wall, margin):
    """From a grid of starts with dc/dt + k1 c <= 0, c + margin never exceeds 0; nothing relaxed."""
    starts = np.repeat(grid_of_safe_starts(margin), 5, axis=0)
    found = kept_from_the_wall(
        double_integrator, restless, wall, starts, margin=margin, seed=3, record_every=20.0
    )
    assert found.viable == len(starts) == 600
    worst = found.dataset["worst_constraint"].values
    assert worst.max() <= -margin + 1e-9
    assert (worst > -margin - 0.02).mean() > 0.5  # most are driven against it
    told = found.summary()["safeguard"]
    assert told["runs_relaxed"] == told["samples_relaxed"] == told["largest_slack"] == 0
    assert told["runs_overruled"] > 500


def test_pressed_against_the_wall_it_stops_at_the_margin(double_integrator, restless, wall):
    """c -> -m with the rate k1."""
    fixed = DRAWS | {"size": (20, 20), "rate": (0, 0), "phase": (0, 0), "push": (1, 1)}
    found = kept_from_the_wall(
        double_integrator, restless, wall, [[0.0, 0.0]], margin=0.3, draws=fixed
    )
    position = found.dataset["state"].sel(state_name="x").values[0]
    gap = 0.7 - position
    assert gap[-1] == pytest.approx(0, abs=1e-6)
    assert gap[600] / gap[550] == pytest.approx(math.exp(-K1), rel=2e-2)  # one second later


def test_too_weak_a_brake_is_an_outcome_and_the_run_goes_on(double_integrator, restless, wall):
    """x = 1/2 at 2 m/s with |a| <= 1 passes the wall to x = 2 1/2, and comes back."""
    found = kept_from_the_wall(double_integrator, restless, wall, [[0.5, 2.0], [0.0, 0.0]])
    data = found.dataset
    assert data["worst_constraint"].values[0, 0] == pytest.approx(1.5, abs=1e-9)
    assert data["input"].values[0, :100, 0] == pytest.approx(-1.0, abs=1e-9)
    assert np.abs(data["input"].values).max() <= 1.0
    assert found.outcomes["left region"] == 1
    count = int(data["infeasible"].values[0])
    assert data["infeasible"].values.tolist() == [count, 0]
    slack = data["largest_slack"].values[0]
    v, x = 2.0, 0.5
    assert slack == pytest.approx(max(slack, (K1 + K2) * v + K1 * K2 * (x - 1) - 1))
    told = found.summary()["safeguard"]
    assert told["runs_relaxed"] == 1
    assert told["samples_relaxed"] == count
    assert told["largest_slack"] == pytest.approx(slack)
    end = data["state"].sel(state_name="x").values[0, -1]
    assert end <= 1.0 + 1e-9
    json.dumps(found.summary())


# -- a unicycle before the wall: relative degree 1


def test_unicycle_slows_down_as_it_nears_the_wall_and_turns_as_it_likes(wall):
    """cos(psi) v + k1 (x - 1) <= 0 bounds the speed v from one side; r is not changed."""
    system = hf.systems.unicycle(speed_limit=1.0, turn_limit=2.0)
    law = hf.Law(
        "wander", system.states, {"v": sp.Float(0.9), "r": sp.Rational(3, 2) * sp.sin(hf.TIME)}
    )
    guarded = hf.safeguard(system, law, wall, gains=(2.0, 9.0))
    generator = np.random.default_rng(5)
    starts = generator.uniform([-1, -1, -math.pi], [1, 1, math.pi], (100, 3))
    found = hf.simulate(
        system, guarded, starts=starts, region=wall, horizon=10.0, record_every=0.02
    )
    data = found.dataset
    x, psi = (data["state"].sel(state_name=n).values for n in ("x", "psi"))
    turn = 1.5 * np.sin(data["time"].values)
    assert np.abs(data["input"].sel(input_name="r").values - turn).max() < 1e-12
    limit = 2.0 * (1.0 - x) / np.where(np.cos(psi) > 0, np.cos(psi), 1e-300)
    expected = np.minimum(0.9, limit)
    assert np.abs(data["input"].sel(input_name="v").values - expected).max() < 1e-9
    assert (expected < 0.8).mean() > 0.1
    assert found.viable == 100
    assert found.summary()["safeguard"]["runs_relaxed"] == 0


# -- the camera view


BOX = {"x": (-2.0, -0.3), "y": (-1.6, 1.6), "psi": (-math.pi / 3, math.pi / 3)}
GAINS = {"u": 5.0, "r": 10.0}


@pytest.fixture(scope="module")
def tracked(vehicle):
    return hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), GAINS)


@pytest.fixture(scope="module")
def view():
    return hf.regions.camera_view()


@pytest.fixture(scope="module")
def ahead():
    """The same with the heading within 90 deg - alpha of the wall's normal, as (5.23) needs (E10)."""
    view, limit = hf.regions.camera_view(), math.pi / 3 - 0.015
    headings = (
        hf.Inequality("port", wrap(hf.symbol("psi")) - limit, "rad"),
        hf.Inequality("starboard", -wrap(hf.symbol("psi")) - limit, "rad"),
    )
    return replace(view, name="view_ahead", inequalities=(*view.inequalities, *headings))


def evaluator(law, system, expressions):
    """Expressions of a safeguarded law at rows of states and disturbances."""
    arguments = [q.symbol for q in (*system.states, *system.disturbances)]
    return Evaluator(expressions, arguments, law.parameters).values


def safe_states(system, boundary, count, seed=0):
    """States inside the region, moving."""
    generator = np.random.default_rng(seed)
    low, high = [-2, -1.6, -1, -0.2, -0.1, -0.5], [-0.3, 1.6, 1, 0.2, 0.1, 0.5]
    states = generator.uniform(low, high, (40 * count, 6))
    return states[boundary.worst(states) <= 0][:count]


@pytest.mark.few("True")
@pytest.mark.parametrize("measured", [False, True])
def test_rows_are_those_of_the_regulation_map_of_the_same_gains(vehicle, tracked, view, measured):
    """At random states, in a current: conditions row by row, the polytope corner by corner."""
    law = hf.safeguard(vehicle, tracked, view, gains=(0.7, 3.0), disturbance_measured=measured)
    guard, names = law.safeguard, vehicle.input_names
    boundary = hf.Boundary(vehicle, view)
    states = safe_states(vehicle, boundary, 40)
    generator = np.random.default_rng(1)
    current = generator.uniform(-0.05, 0.05, (len(states), 2))
    columns = [e for n in names for e in guard.normals[n]]
    values = evaluator(law, vehicle, [*columns, *guard.offsets])(np.hstack([states, current]))
    normals, offsets = np.split(values, [2 * len(guard.offsets)], axis=1)
    normals = normals.reshape(len(states), 2, -1).transpose(0, 2, 1)
    for state, w, n, b in zip(states, current, normals, offsets, strict=True):
        known = {"Vx": w[0], "Vy": w[1]} if measured else "none"
        found = boundary.regulation_map(state, gains=(0.7, 3.0), disturbance=known)
        count = len(found.conditions)
        assert n[guard.hard :] == pytest.approx(found.normals[:count], rel=1e-9, abs=1e-12)
        assert b[guard.hard :] == pytest.approx(found.offsets[:count], rel=1e-9, abs=1e-9)
        same = replace(found, normals=n, offsets=b)
        assert same.vertices == pytest.approx(found.vertices, abs=1e-8)


@pytest.fixture(scope="module")
def kept_in_view(vehicle, tracked, view):
    return hf.simulate(
        vehicle,
        hf.safeguard(vehicle, tracked, view),
        starts=hf.Starts(random=200, box=BOX),
        region=view,
        horizon=150.0,
        record_every=0.2,
        tolerance=1e-4,  # held between samples, the input lets a constraint rise by some 1e-5
        seed=1,
    )


def test_target_stays_in_view_from_every_start_at_rest(kept_in_view):
    """200 of 200 with 5 N, no condition relaxed; the filter alone deadlocks many of them."""
    assert kept_in_view.viable == 200
    assert kept_in_view.summary()["safeguard"]["samples_relaxed"] == 0
    assert kept_in_view.dataset["peak_actuator"].values.max() <= 5.0 + 1e-9
    final = kept_in_view.dataset["state"].values[:, -1]
    there = (np.hypot(final[:, 0] + 0.5, final[:, 1]) < 0.03) & (np.abs(final[:, 2]) < 0.05)
    assert 0.2 < there.mean() < 0.5


@pytest.mark.heavy
def test_nominal_thrusts_are_those_that_make_the_nominal_forces(kept_in_view, vehicle):
    """tau = M a, and each thruster's limit of 5 N is in the result."""
    data = kept_in_view.dataset
    image = vehicle.input_bounds.at({p.symbol: p.value for p in vehicle.parameters})
    matrix = np.array(image.matrix, dtype=float)
    made = data["nominal_actuator"].values @ matrix.T
    assert made == pytest.approx(data["nominal"].values, rel=1e-9, abs=1e-9)
    assert np.abs(data["nominal_actuator"].values).max() > 5.0, "it asks for more than there is"
    assert data["actuator_low"].values.tolist() == [-5.0, -5.0]
    assert data["actuator_high"].values.tolist() == [5.0, 5.0]
    assert data["input_high"].values == pytest.approx(5.0 * np.abs(matrix).sum(axis=1))


def test_law_is_unchanged_wherever_it_is_safe_and_only_there(kept_in_view, vehicle, tracked, view):
    """Along the runs: within the polytope of the regulation map equal to 1e-12, else on its edge."""
    boundary = hf.Boundary(vehicle, view)
    data = kept_in_view.dataset
    states = data["state"].values[::5, ::25].reshape(-1, 6)
    given = data["input"].values[::5, ::25].reshape(-1, 2)
    still = np.zeros((len(states), 2))
    wanted = evaluator(tracked, vehicle, list(tracked.outputs.values()))(np.hstack([states, still]))
    unchanged = 0
    for state, u, w in zip(states, given, wanted, strict=True):
        if boundary.worst(state[None]) > 0:
            continue
        allowed = boundary.regulation_map(state, gains=(K1, K2))
        assert allowed.contains(u, 1e-7)
        if allowed.contains(w, -1e-9):
            assert u == pytest.approx(w, rel=1e-12, abs=1e-12)
            unchanged += 1
        elif not allowed.contains(w):
            assert (allowed.normals @ u - allowed.offsets).max() == pytest.approx(0, abs=1e-7)
    assert 0.1 < unchanged / len(states) < 0.9


DIRECTION = hf.symbol("direction")
CURRENT = {"Vx": 0.05 * sp.cos(DIRECTION), "Vy": 0.05 * sp.sin(DIRECTION)}


def in_current(vehicle, law, region, low, high):
    return hf.simulate(
        vehicle,
        law,
        starts=hf.Starts(random=200, box=BOX),
        region=region,
        disturbance=CURRENT,
        varied=hf.Varied(draws={"direction": (low, high)}),
        horizon=60.0,
        record_every=60.0,
        tolerance=1e-3,
        seed=1,
    )


@pytest.mark.heavy
def test_measured_current_is_allowed_for_whatever_its_direction(vehicle, tracked, ahead):
    law = hf.safeguard(vehicle, tracked, ahead, disturbance_measured=True)
    for low, high in ((-math.pi, math.pi), (0.0, 0.0), (math.pi, math.pi)):
        assert in_current(vehicle, law, ahead, low, high).viable >= 198


def test_current_that_is_ignored_drives_the_target_out_of_view_most_of_all_from_astern(
    vehicle, tracked, ahead
):
    """At direction 0 it pushes the vehicle to the wall that it looks at."""
    law = hf.safeguard(vehicle, tracked, ahead)
    astern, bow, any_direction = (
        in_current(vehicle, law, ahead, *r).viable / 200
        for r in ((0.0, 0.0), (math.pi, math.pi), (-math.pi, math.pi))
    )
    assert astern <= 0.05
    assert astern < any_direction < 0.5
    assert astern < bow < 0.6


# -- what it is built of, and what it refuses


def pushed(**more):
    """x' = v + w, v' = a + w: two ways in for a disturbance; a second input b on its own state."""
    chosen = {"input_bounds": hf.Box((-1, 0), (3, 0))} | more
    return hf.System(
        "pushed",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"), hf.Quantity("y", "m")),
        (hf.Quantity("a", "m/s^2"), hf.Quantity("b", "m/s")),
        {"x": V + W, "v": A + W, "y": hf.symbol("b")},
        disturbances=(hf.Quantity("w"),),
        **chosen,
    )


def go(system=None, **more):
    chosen = {"outputs": {"a": sp.Float(1), "b": sp.Float(0)}} | more
    return hf.Law("go", (system or pushed()).states, **chosen)


def test_scales_are_half_the_width_of_the_bounds_where_they_have_one(wall):
    """Of a, 2; b has no room, and no scale either; of the marine vehicle 2 F and 2 arm F."""
    assert dict(hf.safeguard(pushed(), go(), wall).safeguard.scales) == {"a": 2, "b": 1}
    free = pushed(input_bounds=hf.Box((-1, -sp.oo), (sp.oo, sp.oo)))
    scales = hf.safeguard(free, go(), wall, scales={"b": 0.1}).safeguard.scales
    assert dict(scales) == {"a": 1, "b": sp.Float(0.1)}
    vehicle = hf.systems.marine_vehicle()
    outputs = {"tau_u": sp.S.Zero, "tau_r": sp.S.Zero}
    scales = hf.safeguard(vehicle, go(vehicle, outputs=outputs), wall).safeguard.scales
    values = {p.symbol: p.value for p in vehicle.parameters}
    arm = values[hf.symbol("thruster_arm")]
    assert [float(e.subs(values)) for e in scales.values()] == pytest.approx([10, 10 * arm])


def test_disturbance_is_measured_or_what_the_law_believes_or_zero(wall):
    """d2x/dt2 + 5 dx/dt + 4 (x - 1) <= 0 with dx/dt = v + w, d2x/dt2 = a + w."""

    def offset(law, **options):
        guarded = hf.safeguard(pushed(), law, wall, gains=(1.0, 4.0), **options)
        gains = {hf.symbol("kappa1"): 1, hf.symbol("kappa2"): 4}
        return sp.expand(guarded.safeguard.offsets[-1].subs(gains))

    rest = 4 - 4 * X - 5 * V
    believing = go(believed={"w": sp.Rational(1, 2)})
    assert sp.expand(offset(go()) - rest) == 0
    assert sp.expand(offset(believing) - rest + 3) == 0
    assert sp.expand(offset(go(), disturbance_measured=True) - rest + 6 * W) == 0
    assert sp.expand(offset(believing, disturbance_measured=True) - rest + 6 * W) == 0


def test_every_mode_of_a_switching_is_kept_and_the_rules_between_them_stay(wall):
    first, second = go(), go(outputs={"a": sp.Float(-1), "b": sp.Float(0)})
    change = hf.Transition("first", "second", X)
    switching = hf.Switching("both", {"first": first, "second": second}, (change,))
    guarded = hf.safeguard(pushed(), switching, wall)
    assert guarded.transitions == (change,)
    guards = [mode.safeguard for mode in guarded.modes.values()]
    assert guards[0] == guards[1] == hf.safeguard(pushed(), first, wall).safeguard
    assert guarded.modes["second"].outputs == second.outputs


def refusal(system, law, region, **options):
    with pytest.raises(DefinitionError) as caught:
        hf.safeguard(system, law, region, **options)
    return str(caught.value)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"gains": (1.0, 0.0)}, "two numbers above 0"),
        ({"gains": (-1.0, 4.0)}, "two numbers above 0"),
        ({"gains": (math.nan, 4.0)}, "two numbers above 0"),
        ({"gains": (1.0, math.inf)}, "two numbers above 0"),
        ({"gains": (1.0,)}, "two numbers above 0"),
        ({"gains": 4.0}, "gains of the safeguard are 4.0"),
        ({"gains": "14"}, "gains of the safeguard are '14'"),
        ({"gains": ("1", "4")}, "two numbers above 0"),
        ({"gains": (True, 4.0)}, "two numbers above 0"),
        ({"margins": {"wal": 0.1}}, "did you mean 'wall'"),
        ({"margins": {"wall": -0.1}}, "margin of 'wall' is -0.1"),
        ({"margins": {"wall": math.nan}}, "margin of 'wall' is nan"),
        ({"margins": {"wall": math.inf}}, "margin of 'wall' is inf"),
        ({"margins": {"wall": "0.1"}}, "margin of 'wall' is '0.1'"),
        ({"margins": {"wall": True}}, "margin of 'wall' is True"),
        ({"margins": 0.1}, "margins of the safeguard are 0.1"),
        ({"scales": {"c": 1.0}}, "scale of 'c', which is not an input"),
        ({"scales": {"a": 0.0}}, "scale of 'a' is 0.0"),
        ({"scales": {"a": math.nan}}, "scale of 'a' is nan"),
        ({"scales": {"a": "2"}}, "scale of 'a' is '2'"),
        ({"scales": {"a": True}}, "scale of 'a' is True"),
        ({"scales": [1.0, 2.0]}, "scales of the safeguard are [1.0, 2.0]"),
        ({"disturbance_measured": "no"}, "disturbance_measured of the safeguard is 'no'"),
    ],
)
def test_numbers_and_names_that_cannot_be_used_are_refused(wall, options, complaint):
    assert complaint in refusal(pushed(), go(), wall, **options)


def test_law_that_gives_velocities_is_to_be_tracked_first(vehicle, view, wall):
    found = refusal(vehicle, hf.laws.steer_marine(vehicle), view)
    assert "gives u, r; expected the inputs" in found
    assert "let the inputs track them" in found
    other = go(outputs={"a": sp.S.One, "c": sp.S.One})
    assert "track" not in refusal(pushed(), other, wall)


def test_safeguarded_law_is_neither_safeguarded_again_nor_tracked(wall):
    guarded = hf.safeguard(pushed(), go(), wall)
    assert "has a safeguard already" in refusal(pushed(), guarded, wall)
    with pytest.raises(DefinitionError, match="track the velocities first, then safeguard"):
        hf.track_velocity(pushed(), guarded, {"a": 1.0, "b": 1.0})


def test_inputs_in_a_ball_are_kept_in_a_polygon_on_its_rim(wall):
    assert hf.safeguard(pushed(input_bounds=hf.Ball(1, 2)), go(), wall).safeguard.hard == 32
    image = hf.LinearImage(sp.ImmutableMatrix([[1, 0], [1, 1]]), hf.Ball(1, 2))
    assert hf.safeguard(pushed(input_bounds=image), go(), wall).safeguard.hard == 32


def test_more_actuators_than_inputs_are_refused(wall):
    three = hf.LinearImage(sp.ImmutableMatrix([[1, 0, 1], [0, 1, 1]]), hf.Box((-1,) * 3, (1,) * 3))
    assert "more actuators than inputs" in refusal(pushed(input_bounds=three), go(), wall)


def test_constraint_that_the_inputs_reach_too_late_is_refused(wall):
    """Only the third derivative of x contains the input."""
    states = tuple(hf.Quantity(n) for n in ("x", "v", "s"))
    slow = hf.System("slow", states, (hf.Quantity("a"),), {"x": V, "v": hf.symbol("s"), "s": A})
    law = hf.Law("go", states, {"a": sp.Float(1)})
    assert "relative degree is above 2" in refusal(slow, law, wall)


# -- constraints of the safeguard's own


def test_constraints_of_the_safeguard_alone_are_kept_and_are_no_part_of_the_region(
    double_integrator, restless, wall
):
    """|v| <= 0.3 beside x <= 1: kept by both pieces, and a start beyond it has not left."""
    slow = hf.Region(
        "slow", double_integrator.states, (hf.Inequality("slow", abs(V) - 0.3, "m/s"),)
    )
    guarded = hf.safeguard(
        double_integrator, restless, wall, constraints=slow, gains=(K1, K2), margins={"slow": 0.01}
    )
    assert len(guarded.safeguard.offsets) == 2 + 1 + 2  # thrust both ways, the wall, both pieces
    data = hf.simulate(
        double_integrator,
        guarded,
        starts=[[-0.5, 0.0], [0.0, 0.25], [-2.0, 0.5]],
        region=wall,
        varied=hf.Varied(draws=DRAWS),
        horizon=20.0,
        record_every=0.02,
    ).dataset
    assert (data["outcome"].values == hf.Outcome.STAYED).all()
    speed = np.abs(data["state"].sel(state_name="v").values)
    assert speed[:2].max() <= 0.3
    assert speed[2, 200:].max() <= 0.3  # and the third is brought inside


# -- against the worst of what is unknown


def test_condition_against_the_worst_push_is_that_of_a_shorter_reach(double_integrator):
    """x'' = a + w, |w| <= 0.3: the admissible inputs are those without w, less 0.3."""
    pushed = hf.add_unmodelled(double_integrator, ["v"], hf.Box((-0.3,), (0.3,)))
    region = hf.Region("wall", pushed.states[:1], (hf.Inequality("wall", X - 1, "m"),))
    law = hf.Law("ahead", pushed.states, {"a": sp.Float(1.0)})
    plain = hf.safeguard(pushed, law, region, gains=(K1, K2)).safeguard
    robust = hf.safeguard(pushed, law, region, gains=(K1, K2), worst=["unmodelled_v"]).safeguard
    values = {hf.symbol("kappa1"): K1, hf.symbol("kappa2"): K2, X: 0.2, V: 0.1}
    difference = [
        sp.sympify(a - b).subs(values) for a, b in zip(plain.offsets, robust.offsets, strict=True)
    ]
    assert [float(d) for d in difference[-1:]] == pytest.approx([0.3])
    assert all(d == 0 for d in difference[:-1])
    swinging = hf.parse_expression("0.3*sin(3*t)", {"t": hf.TIME})
    for worst, push, kept in (
        ([], sp.Float(0.3), False),
        (["unmodelled_v"], sp.Float(0.3), True),
        (["unmodelled_v"], swinging, True),
    ):
        guarded = hf.safeguard(pushed, law, region, gains=(K1, K2), worst=worst)
        result = hf.simulate(
            pushed, guarded, starts=[(-1.0, 0.0)], region=region, horizon=10.0,
            disturbance={"unmodelled_v": push}, tolerance=1e-6,
        )  # fmt: skip
        assert bool(result.viable) is kept


def test_one_disturbance_may_be_measured_and_another_be_the_worst():
    """Towards a wall by a known wind and an unknown push, of 0.5 and up to 0.3 m/s^2."""
    wind = hf.Quantity("wind", "m/s^2")
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("a", "m/s^2"),),
        {"x": hf.symbol("v"), "v": hf.symbol("a") + wind.symbol}, disturbances=(wind,),
        disturbance_bounds=hf.Box((-0.6,), (0.6,)), input_bounds=hf.Box((-3.0,), (3.0,)),
    )  # fmt: skip
    pushed = hf.add_unmodelled(cart, ["v"], hf.Box((-0.3,), (0.3,)))
    region = hf.Region("wall", pushed.states[:1], (hf.Inequality("wall", X - 1, "m"),))
    law = hf.Law("ahead", pushed.states, {"a": sp.Float(1.0)})
    for measured, worst, kept in (
        (True, ["unmodelled_v"], True),
        (False, ["unmodelled_v"], False),
        (False, ["wind", "unmodelled_v"], True),
    ):
        guarded = hf.safeguard(
            pushed, law, region, gains=(K1, K2), disturbance_measured=measured, worst=worst
        )
        assert ("wind" in [q.name for q in guarded.reads]) is measured
        assert "unmodelled_v" not in [q.name for q in guarded.reads]
        result = hf.simulate(
            pushed, guarded, starts=[(-1.0, 0.0)], region=region, horizon=10.0,
            disturbance={"wind": 0.5, "unmodelled_v": 0.3}, tolerance=1e-6,
        )  # fmt: skip
        assert bool(result.viable) is kept


def test_worst_of_what_is_no_disturbance_or_is_measured_is_refused(double_integrator):
    pushed = hf.add_unmodelled(double_integrator, ["v"], hf.Box((-0.3,), (0.3,)))
    region = hf.Region("wall", pushed.states[:1], (hf.Inequality("wall", X - 1, "m"),))
    law = hf.Law("ahead", pushed.states, {"a": sp.Float(1.0)})
    with pytest.raises(DefinitionError, match="'unmodelled_x', which is not a disturbance"):
        hf.safeguard(pushed, law, region, worst=["unmodelled_x"])
    with pytest.raises(DefinitionError, match="is measured, and is to be the worst"):
        hf.safeguard(pushed, law, region, worst=["unmodelled_v"], disturbance_measured=True)
    early = hf.add_unmodelled(double_integrator, ["x"], hf.Box((-0.3,), (0.3,)))
    with pytest.raises(DefinitionError, match="is not affine in unmodelled_x"):
        hf.safeguard(early, law, region, worst=["unmodelled_x"])
