"""Parameters from logs with known truth: exact without noise, covered by their intervals with it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit
from scipy.stats import binom

import holdfast as hf
from holdfast.analysis.identification.identify import refuse_other_way
from holdfast.errors import SimulationError
from holdfast.maths.identification import measured_motion
from tests.boats import boat, boat_log, vehicle_log

TRUE = {"mass": 20.0, "drag": 8.0, "quadratic": 30.0}
ROUGH = (14.0, 11.0, 20.0)


def test_log_without_noise_gives_the_exact_numbers_from_a_rough_guess():
    found = hf.identify(boat(*ROUGH), boat_log(noise=0.0))
    assert found.values == pytest.approx(TRUE, rel=2e-5)
    left = found.unexplained
    assert left.names == ("u",)
    assert max(abs(left.low[0]), abs(left.high[0])) < 1e-4


def test_fit_of_a_speed_alone_agrees_with_an_independent_fit():
    """Constant drag from rest: u = F (1 - exp(-d t / m)) / d, fitted by SciPy's `curve_fit`."""
    true, step = (20.0, 8.0, 0.0), 0.1
    log = boat_log(true, forces=np.full(200, 20.0), seconds=20.0)
    log = replace(log, states={"u": log.states["u"]})
    t, u = log.states["u"].time, log.states["u"].value
    known = boat(*ROUGH[:2], 0.0)
    found = hf.identify(known, log, hold=["quadratic"], window=4.0)
    other, covariance = curve_fit(
        lambda t, m, d, first: first * np.exp(-d * t / m) + 20 * (1 - np.exp(-d * t / m)) / d,
        t, u, p0=(14, 11, 0.0),
    )  # fmt: skip
    spread = np.sqrt(np.diag(covariance))
    assert step == pytest.approx(t[1])
    for k, name in enumerate(("mass", "drag")):
        # windows with states of their own know less than one curve
        assert abs(found.values[name] - other[k]) < 4 * spread[k]
        half = next(e.half_width for e in found.parameters if e.name == name)
        assert 1.5 * spread[k] < half < 12 * spread[k]


@pytest.mark.heavy
def test_intervals_cover_the_truth_at_their_level():
    inside = total = 0
    for seed in range(12):
        found = hf.identify(boat(*ROUGH), boat_log(seed=seed, seconds=60.0))
        for e in found.parameters:
            inside += e.low <= TRUE[e.name] <= e.high
            total += 1
    assert binom.cdf(inside, total, 0.95) > 0.005, f"{inside} of {total}"


@pytest.mark.heavy
def test_intervals_of_an_otter_cover_the_truth_at_their_level():
    otter = hf.load_vehicle("otter")
    true = {p.name: p.value for p in otter.parameters}
    inside = total = covered = 0
    for seed in range(40):
        random = np.random.default_rng(seed)
        rough = replace(
            otter,
            parameters=tuple(
                replace(p, value=p.value * random.uniform(0.7, 1.4)) if p.name[0] in "XYN" else p
                for p in otter.parameters
            ),
        )
        found = hf.identify(
            rough, vehicle_log(otter, seed=seed, seconds=200.0),
            held_out=vehicle_log(otter, seed=seed + 500, seconds=200.0), hold=["mass", "Iz", "x_g"],
        )  # fmt: skip
        for e in found.parameters:
            if e.status == "identified":
                inside += e.low <= true[e.name] <= e.high
                total += 1
        covered += found.held_out.covered
    assert total >= 300
    assert binom.cdf(inside, total, 0.95) > 0.005, f"{inside} of {total}"
    assert covered >= 38, covered


def test_outliers_move_the_numbers_by_less_than_their_intervals():
    log = boat_log()
    random = np.random.default_rng(4)
    states = {}
    for name, signal in log.states.items():
        value = signal.value.copy()
        wrong = random.random(len(value)) < 0.03
        value[wrong] += random.uniform(-3, 3, wrong.sum())
        states[name] = hf.Signal(signal.time, value)
    found = hf.identify(boat(*ROUGH), replace(log, states=states))
    assert 0.03 < found.outliers < 0.08
    for e in found.parameters:
        assert e.low <= TRUE[e.name] <= e.high


def test_window_never_reaches_over_a_gap():
    log = boat_log()
    kept = (log.states["x"].time < 50.03) | (log.states["x"].time > 61.0)
    cut = {n: hf.Signal(s.time[kept], s.value[kept]) for n, s in log.states.items()}
    found = hf.identify(boat(*ROUGH), replace(log, states=cut))
    start = found.unexplained.start
    assert not ((start + found.unexplained.length > 50.04) & (start < 60.9)).any()
    for e in found.parameters:
        assert e.low <= TRUE[e.name] <= e.high
    with pytest.raises(SimulationError, match="windows of 60 s without a gap"):
        hf.identify(boat(*ROUGH), replace(log, states=cut), window=60.0)


def test_numbers_that_are_seen_only_together_are_said_and_the_first_is_held():
    found = hf.identify(boat(12.0, 11.0, 20.0, added=3.0), boat_log())
    told = {e.name: e for e in found.parameters}
    assert told["mass"].status == "tied"
    assert told["mass"].value == 12.0
    assert told["added"].low <= 8.0 <= told["added"].high
    assert found.ties == ("only a combination of mass, added is seen",)
    found = hf.identify(boat(12.0, 11.0, 20.0, added=3.0), boat_log(), hold=["added"])
    assert {e.name: e.status for e in found.parameters}["added"] == "given"
    assert found.values["mass"] == pytest.approx(17.0, rel=0.01)


def test_log_that_does_not_show_a_number_holds_it_and_names_the_manoeuvre_that_would():
    """The Otter straight ahead: no yaw drag; steps of the yaw moment would show it."""
    otter = hf.load_vehicle("otter")
    log = vehicle_log(otter)
    time = log.states["u"].time
    random = np.random.default_rng(0)
    speed = boat_log((85.5, 77.55, 0.0), seconds=100.0)
    still = {n: hf.Signal(time, 0.005 * random.standard_normal(len(time))) for n in ("v", "r")}
    straight = hf.Log(
        "straight",
        {"u": speed.states["u"], **still},
        {"tau_u": speed.inputs["F"], "tau_r": hf.Signal(time[:-1], np.zeros(len(time) - 1))},
        gap=0.5,
    )
    found = hf.identify(otter, straight, estimate=["Xu", "Nr", "Nrr"])
    told = {e.name: e for e in found.parameters}
    assert told["Xu"].status == "identified"
    for name in ("Nr", "Nrr"):
        assert told[name].status in ("not seen", "wide"), told[name]
        assert "tau_r" in told[name].manoeuvre, told[name]


def test_pose_alone_shows_the_numbers_too():
    otter = hf.load_vehicle("otter")
    log = vehicle_log(otter, measured=("x", "y", "psi"))
    found = hf.identify(otter, log, estimate=["Xu", "Nr", "Nrr", "Nrdot"])
    true = {p.name: p.value for p in otter.parameters}
    for e in found.parameters:
        assert e.status == "identified"
        assert e.low <= true[e.name] <= e.high


@pytest.mark.heavy
def test_speed_over_ground_in_a_current_gives_the_current():
    otter = hf.load_vehicle("otter")
    log = vehicle_log(otter, current=(0.12, -0.2), seed=3)
    psi = log.states["psi"].value
    ground = log.states["u"].value + 0.12 * np.cos(psi) - 0.2 * np.sin(psi)
    log = replace(log, states={**log.states, "u": hf.Signal(log.states["u"].time, ground)})
    names = {n: hf.symbol(n) for n in ("u", "Vx", "Vy", "psi")}
    measures = {"u": hf.parse_expression("u + Vx*cos(psi) + Vy*sin(psi)", names)}
    found = hf.identify(otter, log, estimate=["Xu", "Yv", "Nr"], outputs=measures)
    told = {e.name: e for e in found.disturbances}
    assert told["Vx"].value == pytest.approx(0.12, abs=0.01)
    assert told["Vy"].value == pytest.approx(-0.2, abs=0.01)
    assert -80 < found.values["Xu"] < -75


@pytest.mark.heavy
def test_thruster_forces_stand_for_the_inputs_and_are_limited_as_thrusters_are():
    otter = hf.load_vehicle("otter")
    log = vehicle_log(otter)
    surge, turn = (log.inputs[n].value for n in ("tau_u", "tau_r"))
    time = log.inputs["tau_u"].time
    port, starboard = surge / 2 - turn / (2 * 0.395), surge / 2 + turn / (2 * 0.395)
    thrusters = {"port": hf.Signal(time, port), "starboard": hf.Signal(time, starboard)}
    some = ["Xu", "Nr"]
    by_inputs = hf.identify(otter, log, estimate=some).values
    by_thrusters = hf.identify(otter, replace(log, inputs=thrusters), estimate=some).values
    assert by_thrusters == pytest.approx(by_inputs, rel=1e-6)
    with pytest.raises(SimulationError, match="no signal of tau_r"):
        hf.identify(otter, replace(log, inputs={"tau_u": log.inputs["tau_u"]}))


def test_command_beyond_the_limit_counts_as_the_limit():
    forces = np.clip(1.8 * boat_log().inputs["F"].value, -60, 60)
    log = boat_log(forces=np.clip(forces, -40, 40))
    asked = replace(log, inputs={"F": hf.Signal(log.inputs["F"].time, forces)})
    found = hf.identify(boat(*ROUGH), asked)
    assert found.values == pytest.approx(hf.identify(boat(*ROUGH), log).values, rel=1e-9)
    (told,) = found.repairs
    assert told.startswith("F is commanded beyond its limits in ")
    share = float(told.removeprefix("F is commanded beyond its limits in ").split(" %")[0])
    assert share == pytest.approx(100 * np.mean(np.abs(forces) > 40), abs=2)
    far = replace(log, inputs={"F": hf.Signal(log.inputs["F"].time, 20 * forces)})
    with pytest.raises(SimulationError, match="give the limits of the vehicle of the log"):
        hf.identify(boat(*ROUGH), far)


def test_second_log_that_shows_nothing_is_refused_and_not_within_the_bound():
    log, other = boat_log(), boat_log((20.0, 8.0, 90.0), seed=4)
    rare = {n: hf.Signal(s.time[::20], s.value[::20]) for n, s in other.states.items()}
    with pytest.raises(SimulationError, match="do not show what the model leaves unexplained"):
        hf.identify(boat(*ROUGH), log, held_out=replace(other, states=rare))
    assert not hf.identify(boat(*ROUGH), log, held_out=other).held_out.covered


def test_window_with_too_few_values_is_refused():
    with pytest.raises(SimulationError, match="at least 5 values in a window"):
        hf.identify(boat(*ROUGH), boat_log(), window=0.3)
    with pytest.raises(SimulationError, match="at least 5 values in a window"):
        hf.identify(boat(*ROUGH), boat_log(), window=1e-9)


@pytest.mark.heavy
def test_fits_from_other_first_guesses_agree_within_their_intervals():
    """Windows are of other lengths, since those follow from the guess."""
    log = boat_log()
    first, second = (
        hf.identify(boat(*guess), log).parameters for guess in (ROUGH, (60.0, 1.0, 5.0))
    )
    for a, b in zip(first, second, strict=True):
        assert abs(a.value - b.value) < a.half_width


@pytest.mark.heavy
def test_commands_that_are_zero_are_refused_and_those_of_the_wrong_sign_are_said():
    otter = hf.load_vehicle("otter")
    log = vehicle_log(otter, seconds=40.0)
    some = ["Xu", "Nr"]

    def with_commands(change):
        signals = {n: hf.Signal(s.time, change(n, s.value)) for n, s in log.inputs.items()}
        return replace(log, inputs=signals)

    with pytest.raises(SimulationError, match="tau_u, tau_r are 0"):
        hf.identify(otter, with_commands(lambda n, v: 0 * v), estimate=some)
    turned = with_commands(lambda n, v: -v if n == "tau_r" else v)
    found = hf.identify(otter, turned, estimate=some)
    assert "Nr has the other sign than before" in found.remarks
    half = hf.identify(otter, with_commands(lambda n, v: 0 * v if n == "tau_r" else v),
                       estimate=["Xu"])  # fmt: skip
    assert "tau_r is 0 throughout" in half.remarks


def test_numbers_with_which_an_input_acts_the_other_way_are_refused():
    otter = hf.load_vehicle("otter")
    motion = measured_motion(otter, otter.state_names, ["Nrdot"])
    other = tuple(replace(p, value=60.0) if p.name == "Nrdot" else p for p in otter.parameters)
    with pytest.raises(SimulationError, match=r"make tau_r move (v|r) the other way"):
        refuse_other_way(otter, replace(otter, parameters=other), motion)
    refuse_other_way(otter, otter, motion)


@pytest.mark.heavy
def test_what_makes_intervals_too_narrow_is_said():
    log = boat_log()
    assert hf.identify(boat(*ROUGH), log).remarks == ()
    late = replace(log, inputs={"F": hf.Signal(log.inputs["F"].time - 0.4, log.inputs["F"].value)})
    assert any("a delay" in r for r in hf.identify(boat(*ROUGH), late).remarks)
    speed = log.states["u"]
    knots = replace(log, states={**log.states, "u": hf.Signal(speed.time, 1.9 * speed.value)})
    assert any("its unit" in r for r in hf.identify(boat(*ROUGH), knots).remarks)
    short = hf.identify(boat(*ROUGH), boat_log(seconds=40.0), window=5.0)
    assert "intervals and bound are those of 7 windows only" in short.remarks


def runaway(growth):
    """q' = growth q^3 + gain F, which leaves every bound in finite time."""
    q, f, a, b = (hf.symbol(n) for n in ("q", "F", "growth", "gain"))
    numbers = (
        hf.Parameter("growth", "1/(m^2 s)", value=growth),
        hf.Parameter("gain", "1", value=1.0),
    )
    return hf.System(
        "runaway", (hf.Quantity("q", "m"),), (hf.Quantity("F", "m/s"),), {"q": a * q**3 + b * f},
        parameters=numbers,
    )  # fmt: skip


def runaway_log():
    """Of growth 1 and gain 1, about places that feedback holds."""
    random, step, count, aim = np.random.default_rng(0), 0.05, 2000, 0.0
    q, places, forces = 0.5, np.empty(count), np.empty(count)
    for k in range(count):
        aim = random.uniform(-1.2, 1.2) if k % 40 == 0 else aim
        places[k], forces[k] = q, -(q**3) + 3 * (aim - q) + random.normal(0, 0.3)
        for _ in range(20):
            q += step / 20 * (q**3 + forces[k])
    time = step * np.arange(count)
    measured = places + 0.02 * random.standard_normal(count)
    signals = {"q": hf.Signal(time, measured)}
    return hf.Log("runaway", signals, {"F": hf.Signal(time, forces)}, gap=0.5)


def test_model_that_diverges_in_long_windows_is_fitted_in_shorter_ones():
    log = runaway_log()
    found = hf.identify(runaway(1.05), log)
    assert found.window == pytest.approx(0.6)
    for name in ("growth", "gain"):
        (told,) = (e for e in found.parameters if e.name == name)
        assert told.low < 1 < told.high
        assert told.half_width < 0.02
    with pytest.raises(SimulationError, match=r"diverges within 2\.5 s"):
        hf.identify(runaway(1.05), log, window=2.5)
    with pytest.raises(SimulationError, match="begin with better ones"):
        hf.identify(runaway(4.0), log)


def test_bound_contains_what_no_model_knows_and_a_rougher_log_is_outside_it():
    def swell(size):
        return lambda t: size * np.sin(0.7 * t)

    log = boat_log(unknown=swell(0.06), seconds=200.0)
    alike = boat_log(unknown=swell(0.06), seed=1)
    known = boat(20.0, *ROUGH[1:])
    found = hf.identify(known, log, held_out=alike, hold=["mass"])
    left = found.unexplained
    assert left.low[0] < -0.05
    assert left.high[0] > 0.05
    assert left.noise_share[0] < 0.5
    assert found.held_out.covered
    assert "all" in found.verdict
    rough = boat_log(unknown=swell(0.25), seed=2)
    found = hf.identify(known, log, held_out=rough, hold=["mass"])
    assert not found.held_out.covered
    assert found.held_out.outside > 10
    assert "NOT within the bound" in found.verdict
    assert "no second log" in hf.identify(boat(*ROUGH), log).verdict


def test_verdict_does_not_depend_on_the_unit_of_length():
    in_metres = hf.identify(boat(*ROUGH), boat_log())
    in_millimetres = hf.identify(boat(*ROUGH, metre=1e3), boat_log(metre=1e3))
    factor = {"mass": 1.0, "drag": 1.0, "quadratic": 1e-3}
    for a, b in zip(in_metres.parameters, in_millimetres.parameters, strict=True):
        assert a.status == b.status
        scale = factor[a.name]
        assert np.array([b.low, b.value, b.high]) == pytest.approx(
            scale * np.array([a.low, a.value, a.high]), rel=1e-5
        )
    assert in_millimetres.window == pytest.approx(in_metres.window)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": 1.0}, "level is 1"),
        ({"window": -1.0}, "window is -1"),
        ({"widen": 0.5}, "widen is 0.5"),
        ({"estimate": ["drga"]}, "no parameter 'drga'.*did you mean 'drag'"),
        ({"estimate": ["drag"], "hold": ["drag"]}, "to be estimated and to be held"),
        ({"unexplained_rates": ["y"]}, "the log says nothing of 'y'"),
    ],
)
def test_arguments_out_of_range_are_refused(options, message):
    with pytest.raises(SimulationError, match=message):
        hf.identify(boat(), boat_log(seconds=30.0), **options)


def test_second_log_without_a_signal_and_a_log_without_any_are_refused():
    log = boat_log(seconds=30.0)
    with pytest.raises(SimulationError, match="has no signal 'x'"):
        hf.identify(boat(), log, held_out=replace(log, states={"u": log.states["u"]}))
    with pytest.raises(SimulationError, match="no signal of a state"):
        hf.identify(boat(), replace(log, states={}))
    with pytest.raises(SimulationError, match="no signal of F"):
        hf.identify(boat(), replace(log, inputs={}))
