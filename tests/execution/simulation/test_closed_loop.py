"""Sampling, switching, saturation, leaving the region, and every outcome, on known motions."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import GainWarning, SimulationError
from holdfast.maths.expressions.functions import greatest, least, magnitude, select, sgn, wrap
from tests.conftest import constant_law

X, V = hf.symbol("x"), hf.symbol("v")


def run(system, law, start, horizon=2.0, **settings):
    return hf.simulate(system, law, starts=[start], horizon=horizon, **settings).dataset


@pytest.mark.parametrize("sample_time", [0.01, 0.1, 0.5])
@pytest.mark.parametrize("stepper", ["rk4", "dormand-prince"])
def test_leaving_the_region_is_located_in_time(double_integrator, wall, sample_time, stepper):
    """From x = 0 at v = 0.3 under a = 1 the wall x = 1 is met at -0.3 + sqrt(2.09)."""
    law = constant_law(double_integrator, 1.0)
    data = run(
        double_integrator,
        law,
        [0, 0.3],
        region=wall,
        sample_time=sample_time,
        substeps=1,
        record_every=0.5,
        stepper=stepper,
    )
    assert data["outcome"].values[0] == hf.Outcome.LEFT
    assert data["exit_time"].values[0] == pytest.approx(-0.3 + np.sqrt(2.09), abs=1e-9)
    assert data["exit_constraint"].values[0] == 0


def test_an_excursion_inside_one_step_is_not_stepped_over(double_integrator, wall):
    """x = t - t^2/2 + 0.6 rises above 1 between t = 0.55 and 1.45 and falls back."""
    law = constant_law(double_integrator, -1.0)
    data = run(
        double_integrator,
        law,
        [0.6, 1.0],
        region=wall,
        sample_time=2.0,
        substeps=1,
        record_every=2.0,
    )
    assert data["constraint"].values[0, :, 0] == pytest.approx([-0.4, -0.4])
    assert data["outcome"].values[0] == hf.Outcome.LEFT
    assert data["exit_time"].values[0] == pytest.approx(1 - np.sqrt(0.2), abs=1e-9)
    assert data["worst_constraint"].values[0, 0] == pytest.approx(0.1, abs=1e-9)


def test_a_run_that_only_touches_within_the_tolerance_has_not_left(double_integrator, wall):
    law = constant_law(double_integrator, -1.0)
    settings = {"region": wall, "sample_time": 0.5, "substeps": 1, "record_every": 0.5}
    assert run(double_integrator, law, [0.4995, 1.0], **settings)["outcome"].values[0] == 0
    close = run(double_integrator, law, [0.5005, 1.0], tolerance=1e-3, **settings)
    assert close["outcome"].values[0] == hf.Outcome.STAYED
    strict = run(double_integrator, law, [0.5005, 1.0], **settings)
    assert strict["outcome"].values[0] == hf.Outcome.LEFT


def test_the_earliest_of_several_violations_is_the_one_reported(double_integrator):
    region = hf.Region(
        "two",
        double_integrator.states,
        (hf.Inequality("far", X - 1), hf.Inequality("near", X - 0.5)),
    )
    data = run(
        double_integrator,
        constant_law(double_integrator, 0.0),
        [0, 1],
        region=region,
        sample_time=2.0,
        substeps=1,
        record_every=2.0,
    )
    assert data["exit_constraint"].values[0] == 1
    assert data["exit_time"].values[0] == pytest.approx(0.5)


def test_reaching_the_goal_needs_to_be_there_at_the_end(double_integrator):
    goal = hf.Region("goal", double_integrator.states, (hf.Inequality("near", abs(X) - 0.1),))
    coast = constant_law(double_integrator, 0.0)
    passing = run(double_integrator, coast, [-1, 1], goal=goal)
    assert passing["outcome"].values[0] == hf.Outcome.STAYED
    assert np.isnan(passing["goal_time"].values[0])
    arriving = run(double_integrator, coast, [-2, 1], goal=goal)
    assert arriving["outcome"].values[0] == hf.Outcome.REACHED
    assert arriving["goal_time"].values[0] == pytest.approx(1.9, abs=0.021)


def test_reaching_the_goal_after_leaving_the_region_is_still_leaving(double_integrator, wall):
    goal = hf.Region("goal", double_integrator.states, (hf.Inequality("far", 1 - X),))
    data = run(
        double_integrator, constant_law(double_integrator, 0.0), [0, 1], region=wall, goal=goal
    )
    assert data["outcome"].values[0] == hf.Outcome.LEFT
    assert data["goal_time"].values[0] == pytest.approx(1.0, abs=0.021)


def test_blowing_up_is_an_outcome_with_its_time(double_integrator):
    x = hf.symbol("x")
    system = hf.System(
        "blow_up",
        (hf.Quantity("x"),),
        (hf.Quantity("a"),),
        {"x": x**2 + hf.symbol("a")},
    )
    law = hf.Law("none", system.states, {"a": sp.S.Zero})
    for settings in ({"substeps": 4}, {"stepper": "dormand-prince"}):
        data = run(system, law, [1.0], **settings)
        assert data["outcome"].values[0] == hf.Outcome.DIVERGED
        assert data["exit_time"].values[0] == pytest.approx(1.0, abs=0.05)
        state = data["state"].values[0, :, 0]
        assert np.isfinite(state[data["time"].values < 0.95]).all()
        assert np.isnan(state[-1])


def test_a_law_that_is_not_a_number_is_an_outcome(double_integrator):
    push = {"a": sp.sqrt(X - 1)}
    law = hf.Law("root", double_integrator.states, push, empirical="a root of a number")
    data = run(double_integrator, law, [0, 0])
    assert data["outcome"].values[0] == hf.Outcome.DIVERGED


HIDDEN = {
    "sgn": sgn(sp.sqrt(X - 1)),
    "select": select(sp.log(X - 1), 1, 2),
    "least": least(0.5, sp.sqrt(X - 1)),
    "greatest": greatest(sp.sqrt(X - 1), 0.5),
    "wrap": wrap(sp.sqrt(X - 1)),
    "magnitude": sp.Abs(sp.sqrt(X - 1)),
}


@pytest.mark.parametrize("branch", HIDDEN)
def test_no_branch_hides_what_is_not_a_number(double_integrator, branch):
    states, why = double_integrator.states, "roots of a number"
    laws = {n: hf.Law(n, states, {"a": e}, empirical=why) for n, e in HIDDEN.items()}
    law = hf.Switching("hidden", laws, initial=branch)  # one program: where it begins is no text
    result = hf.simulate(double_integrator, law, starts=[[0, 0], [2, 0]], horizon=2.0)
    assert result.dataset["outcome"].values.tolist() == [hf.Outcome.DIVERGED, hf.Outcome.STAYED]
    assert result.dataset["mode"].values[1, 0] == list(HIDDEN).index(branch)


def test_a_constraint_that_is_not_a_number_is_an_outcome(double_integrator):
    """sqrt(1 - x) exists up to x = 1, reached at t = 1."""
    region = hf.Region("root", double_integrator.states, (hf.Inequality("r", -sp.sqrt(1 - X)),))
    data = run(double_integrator, constant_law(double_integrator, 0.0), [0, 1.0], region=region)
    assert data["outcome"].values[0] == hf.Outcome.DIVERGED
    assert data["exit_time"].values[0] == pytest.approx(1.0, abs=0.03)


def test_sampled_control_is_held_and_continuous_control_is_not(double_integrator):
    """Under a = -v held for T the speed falls by (1 - T) each sample, else by exp(-t)."""
    rate = hf.Parameter("rate", "1/s", value=1.0)
    law = hf.Law("brake", double_integrator.states, {"a": -rate.symbol * V}, (rate,))
    settings = {"sample_time": 0.5, "substeps": 50, "record_every": 0.5}
    held = run(double_integrator, law, [0, 1], **settings)["state"].values[0, :, 1]
    assert held == pytest.approx(0.5 ** np.arange(5), rel=1e-12)
    smooth = run(double_integrator, law, [0, 1], continuous=True, **settings)
    assert smooth["state"].values[0, :, 1] == pytest.approx(np.exp(-np.arange(5) / 2), rel=1e-7)


def test_input_is_saturated_and_its_peak_recorded(double_integrator):
    data = run(double_integrator, constant_law(double_integrator, 30.0), [0, 0])
    assert data["input"].values[0].max() == 1.0
    assert data["peak_input"].values[0, 0] == 1.0
    assert data["state"].values[0, -1] == pytest.approx([2.0, 2.0])


def test_thrusters_are_recorded_and_saturate_one_by_one(vehicle):
    law = hf.Law("push", vehicle.states, {"tau_u": sp.Float(8.0), "tau_r": sp.Float(0.4)})
    data = run(vehicle, law, np.zeros(6), horizon=0.2)
    assert list(data["actuator_name"].values) == ["port", "starboard"]
    assert data["actuator"].values[0, 0] == pytest.approx([2.0, 5.0])  # wanted 2 and 6
    assert data["input"].values[0, 0] == pytest.approx([7.0, 0.3])


def test_hysteresis_switches_at_its_two_thresholds(double_integrator):
    """Bang-bang between x = -0.5 and x = 0.5 with the mode held in between."""
    up = hf.Law("up", double_integrator.states, {"a": sp.S.One})
    down = hf.Law("down", double_integrator.states, {"a": sp.S.NegativeOne})
    law = hf.Switching(
        "thermostat",
        {"up": up, "down": down},
        (hf.Transition("up", "down", X - 0.5), hf.Transition("down", "up", -0.5 - X)),
    )
    data = run(double_integrator, law, [0, 0], horizon=20.0, record_every=0.02)
    mode, x = data["mode"].values[0], data["state"].values[0, :, 0]
    rises = np.flatnonzero(np.diff(mode) > 0) + 1
    falls = np.flatnonzero(np.diff(mode) < 0) + 1
    assert len(rises) >= 2
    assert (x[rises] >= 0.5).all()
    assert (x[rises - 1] < 0.5).all()
    assert (x[falls] <= -0.5).all()
    assert data["switches"].values[0] == len(rises) + len(falls)


def test_dwell_time_is_a_guard_on_the_time_in_the_mode(double_integrator):
    one = hf.Law("one", double_integrator.states, {"a": sp.S.One})
    other = hf.Law("other", double_integrator.states, {"a": sp.S.NegativeOne})
    long_enough = hf.TIME_IN_MODE - 0.5
    law = hf.Switching(
        "clock",
        {"one": one, "other": other},
        (hf.Transition("one", "other", long_enough), hf.Transition("other", "one", long_enough)),
    )
    data = run(double_integrator, law, [0, 0], horizon=4.0)
    assert data["switches"].values[0] == 8


def test_time_varying_current_carries_the_vehicle(vehicle):
    law = hf.Law("idle", vehicle.states, {"tau_u": sp.S.Zero, "tau_r": sp.S.Zero})
    data = run(
        vehicle,
        law,
        np.zeros(6),
        horizon=4.0,
        disturbance={"Vx": 0.1, "Vy": 0.2 * sp.cos(sp.pi * hf.TIME / 4)},
    )
    end = data["state"].values[0, -1]
    assert end[:2] == pytest.approx([0.4, 0.0], abs=1e-6)
    middle = data["state"].sel(time=2.0, method="nearest").values[0]
    assert middle[1] == pytest.approx(0.8 / np.pi, abs=1e-6)


def test_plant_may_differ_from_what_its_law_believes(vehicle):
    law = hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})
    start = [-1.5, -0.6, 0.3, 0.1, 0, 0]
    nominal = run(vehicle, law, start, horizon=1.0)
    heavier = run(vehicle, law, start, horizon=1.0, plant={"mass": 8.0})
    assert np.array_equal(nominal["input"].values[0, 0], heavier["input"].values[0, 0])
    assert not np.allclose(nominal["state"].values[0, -1], heavier["state"].values[0, -1])


def test_gains_beyond_their_limit_warn_with_the_limit(vehicle):
    law = hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle, k1=0.3), {"u": 5.0, "r": 10.0})
    with pytest.warns(GainWarning, match=r"0\.45 is not below its limit 0\.3508"):
        run(vehicle, law, [-1.5, -0.6, 0.3, 0, 0, 0], horizon=0.1)


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"horizon": -1.0}, "horizon is -1"),
        ({"horizon": float("nan")}, "horizon is nan"),
        ({"sample_time": 0.0}, "sample_time is 0"),
        ({"sample_time": 0.03}, "whole multiple of sample_time"),
        ({"substeps": 0}, "whole number >= 1"),
        ({"record_every": 0.03}, "whole multiple"),
        ({"tolerance": -1e-3}, "0 or more"),
        ({"seed": -1}, "seed is -1"),
        ({"noise_normal": {"z": 0.1}}, "'z', which is not a state"),
        ({"noise_uniform": {"x": -0.1}}, "0 or more"),
        ({"stepper": "rk5"}, "did you mean 'rk4'"),
        ({"substep": 2}, "did you mean 'substeps'"),
        ({"disturbance": {"wind": 1}}, "no disturbance 'wind'"),
        ({"plant": {"weight": 1}}, "no parameter 'weight'"),
    ],
)
def test_settings_that_make_no_sense_are_refused(double_integrator, settings, complaint):
    with pytest.raises(SimulationError) as caught:
        run(double_integrator, constant_law(double_integrator, 0.0), [0, 0], **settings)
    assert complaint in str(caught.value)


@pytest.mark.parametrize(
    ("starts", "complaint"),
    [
        (np.zeros((0, 2)), "at least one start"),
        (np.zeros((3, 3)), "expected (runs, 2)"),
        ([[np.nan, 0]], "not finite"),
        ([[2.0, 0]], "wall = 1 m"),
        (hf.Starts(states=[{"z": 1}]), "'z' is not a state"),
        (hf.Starts(random=-1), "-1 random starts"),
        (hf.Starts(random=1, box={"x": (1, 0)}), "lowest first"),
        (hf.Starts(random=1, box={"x": (2, 3)}), "no state of the region found"),
    ],
)
def test_starts_that_make_no_sense_are_refused(double_integrator, wall, starts, complaint):
    with pytest.raises(SimulationError) as caught:
        hf.simulate(
            double_integrator,
            constant_law(double_integrator, 0.0),
            starts=starts,
            region=wall,
            horizon=1.0,
        )
    assert complaint in str(caught.value)


def test_a_start_outside_is_simulated_when_asked_for(double_integrator, wall):
    data = run(
        double_integrator,
        constant_law(double_integrator, 0.0),
        [2, 0],
        region=wall,
        start_outside=True,
    )
    assert data["outcome"].values[0] == hf.Outcome.LEFT
    assert data["exit_time"].values[0] == 0.0


@pytest.mark.parametrize(
    ("value", "complaint"),
    [
        (0.6, "leaves its bounds at t = 0"),
        (sp.log(hf.TIME), "not finite"),
        (hf.symbol("tau_u"), "uses 'tau_u'"),
    ],
)
def test_disturbance_out_of_bounds_is_refused(vehicle, value, complaint):
    law = hf.Law("idle", vehicle.states, {"tau_u": sp.S.Zero, "tau_r": sp.S.Zero})
    with pytest.raises(SimulationError, match=complaint):
        run(vehicle, law, np.zeros(6), disturbance={"Vx": value})


def test_interrupting_stops_the_workers(vehicle):
    law = hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})
    calls = []

    def progress(fraction):
        calls.append(fraction)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hf.simulate(
            vehicle,
            law,
            starts=np.tile([-1.5, 0, 0, 0, 0, 0.0], (400, 1)),
            horizon=4000.0,
            record_every=4000.0,
            progress=progress,
        )
    assert len(calls) == 1
    assert calls[0] < 0.9


def test_a_record_that_does_not_fit_in_memory_is_refused_before_the_work(double_integrator):
    with pytest.raises(SimulationError, match="raise record_every"):
        run(
            double_integrator,
            constant_law(double_integrator, 0.0),
            [0, 0],
            horizon=1e12,
            sample_time=0.5,
            record_every=0.5,
        )


def test_progress_ends_at_one(double_integrator):
    seen = []
    hf.simulate(
        double_integrator,
        constant_law(double_integrator, 0.0),
        starts=np.zeros((9, 2)),
        horizon=1.0,
        progress=seen.append,
    )
    assert seen[-1] == 1.0
    assert seen == sorted(seen)


def test_a_kink_above_the_limit_is_found_like_a_peak():
    """c = 0.006 - |x - 0.51| with x' = 1 touches +0.006 in the middle of a step."""
    system = hf.System(
        "line", (hf.Quantity("x", "m"),), (hf.Quantity("a", "m/s"),), {"x": hf.symbol("a")}
    )
    law = hf.Law("go", system.states, {"a": sp.Float(1.0)})
    for kink in (-magnitude(X - 0.51), least(X - 0.51, 0.51 - X)):
        region = hf.Region("kink", system.states, (hf.Inequality("c", 0.006 + kink),))
        data = run(system, law, [0.0], region=region, horizon=1.0, sample_time=0.1, substeps=1)
        assert data["outcome"].values[0] == hf.Outcome.LEFT
        assert data["worst_constraint"].values[0, 0] == pytest.approx(0.006, abs=1e-7)
        assert data["exit_time"].values[0] == pytest.approx(0.504, abs=1e-7)


def test_names_of_states_do_not_change_what_is_found():
    """z' = 1 - 2 z from z = 0: z (1 - z) exceeds 0.2 when exp(-2 t) = sqrt(0.2)."""
    names = ("z", "qdot_0", "qdot0", "c_0")
    states = tuple(hf.Quantity(name) for name in names)
    rates = {name: 1 - 2 * hf.symbol(name) + hf.symbol("a") for name in names}
    system = hf.System("s", states, (hf.Quantity("a"),), rates)
    law = hf.Law("none", states, {"a": sp.S.Zero})
    expressions = {name: hf.symbol(name) * (1 - hf.symbol(name)) - 0.2 for name in names}
    region = hf.Region("r", states, tuple(hf.Inequality(n, e) for n, e in expressions.items()))
    settings = {"sample_time": 0.02, "substeps": 1, "record_every": 0.02}
    data = run(system, law, [0.0] * 4, region=region, **settings)
    assert data["outcome"].values[0] == hf.Outcome.LEFT
    assert data["exit_time"].values[0] == pytest.approx(-np.log(0.2) / 4, abs=1e-6)
    for found in (data["state"], data["constraint"], data["worst_constraint"]):
        assert (found.values == found.values[..., :1]).all()


def test_a_run_that_left_and_then_diverged_keeps_when_and_why_it_left(wall, double_integrator):
    system = hf.System(
        "grow",
        double_integrator.states,
        double_integrator.inputs,
        {"x": V, "v": 50 * X**3 + hf.symbol("a")},
        empirical="it is to diverge",
    )
    law = hf.Law("none", system.states, {"a": sp.S.Zero})
    data = run(system, law, [0.9, 1.0], region=wall)
    assert data["outcome"].values[0] == hf.Outcome.DIVERGED
    assert data["exit_constraint"].values[0] == 0
    assert 0 < data["exit_time"].values[0] < 0.1


def test_an_input_that_is_not_a_number_at_the_last_sample_is_an_outcome(double_integrator):
    law = hf.Law("late", double_integrator.states, {"a": sp.sqrt(1.99 - hf.TIME)})
    data = run(double_integrator, law, [0, 0], horizon=2.0)
    assert data["outcome"].values[0] == hf.Outcome.DIVERGED


def test_redundant_thrusters_are_recorded_as_they_were_driven():
    """Three thrusters, two inputs: the wanted (2.4, 1.6) drives them to (0, 0.8, 1)."""
    a, b = hf.symbol("a"), hf.symbol("b")
    system = hf.System(
        "three",
        (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s")),
        {"x": a, "y": b},
        input_bounds=hf.LinearImage(
            sp.Matrix([[1, 1, 1], [-1, 0, 1]]), hf.Box((-1,) * 3, (1,) * 3)
        ),
    )
    law = hf.Law("push", system.states, {"a": sp.Float(2.4), "b": sp.Float(1.6)})
    data = run(system, law, [0, 0], horizon=0.2)
    assert data["actuator"].values[0, 0] == pytest.approx([0.0, 0.8, 1.0])
    assert data["input"].values[0, 0] == pytest.approx([1.8, 1.0])


def test_allocation_is_the_controllers_belief_and_the_effect_is_the_plants(vehicle):
    law = hf.Law("turn", vehicle.states, {"tau_u": sp.S.Zero, "tau_r": sp.Float(0.1)})
    data = run(vehicle, law, np.zeros(6), horizon=0.2, plant={"thruster_arm": 0.05})
    assert data["actuator"].values[0, 0] == pytest.approx([-0.5, 0.5])
    assert data["input"].values[0, 0] == pytest.approx([0.0, 0.05])


def test_noise_with_continuous_control_is_refused(double_integrator):
    law = constant_law(double_integrator, 0.0)
    with pytest.raises(SimulationError, match="measurement noise with continuous control"):
        run(double_integrator, law, [0, 0], continuous=True, noise_normal={"x": 0.1})


def test_gain_limit_below_lambda_two_does_not_warn_of_a_bound_that_does_not_bind(vehicle):
    """lambda = 1.1: the second denominator is negative, only |Yv|/m22 = 0.513 remains."""
    law = hf.laws.steer_marine(vehicle, lam=1.1)
    values = {p.symbol: p.value for p in law.parameters}
    assert float(law.conditions[0].limit.subs(values)) == pytest.approx(5.87 / 11.45)
