"""A guaranteed set of a disturbance: that it holds the truth, and that a filter counts all of it."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, ScenarioError
from holdfast.maths.control.observer import worst_of
from holdfast.maths.definitions.law import Safeguard
from holdfast.maths.expressions.functions import greatest
from tests.drifts import drifting, told

BOUNDS = {"x": 1e-3, "y": 1e-3, "psi": 1e-3, "u": 5e-3, "v": 5e-3, "r": 0.1}
SET = ('observer={measured=["x","y","psi"],bandwidth=40,error_bounds='
       '{x="1 mm",y="1 mm",psi="1 mrad",u=0.005,v=0.005,r=0.1}}')  # fmt: skip
WIDE = ('observer={measured=["x","y","psi"],bandwidth=40,error_bounds='
        '{x="2 mm",y="2 mm",psi="2 mrad",u=0.01,v=0.01,r=0.3}}')  # fmt: skip
NOISE = 'noise.uniform={x="1 mm",y="1 mm",psi="1 mrad"}'
KEPT = ("Vx_low", "Vx_high", "Vy_low", "Vy_high", "learning_time", "u_hat", "v_hat", "r_hat")


@pytest.fixture(scope="module", name="drifting")
def one_that_drifts():
    return drifting()


def shown(law, names):
    """The law with these remembered quantities as signals."""
    kept = [q for q in law.memory.quantities if q.name in names]
    modes = {
        n: replace(m, reads=(*m.reads, *(q for q in kept if q not in m.reads)))
        for n, m in law.modes.items()
    }
    return replace(law, modes=modes, signals={q.name: q.symbol for q in kept})


def test_interval_of_a_drift_shrinks_as_the_error_over_the_time(drifting):
    """y is exact here: the half width is 2 n / t from the first sample on, and never grows."""
    law = hf.observe_set(drifting, told(drifting), error_bounds={"x": 0.01})
    law = shown(law, ("d_low", "d_high"))
    data = hf.simulate(
        drifting, law, starts=[[0.5]], disturbance={"d": 0.4}, horizon=8.0, sample_time=0.01,
        record_every=0.01,
    ).dataset  # fmt: skip
    low, high = np.moveaxis(data["signal"].values[0], -1, 0)
    time = data["time"].values
    assert (low[0], high[0]) == (-1.0, 1.0)
    assert (np.diff(low) >= 0).all()
    assert (np.diff(high) <= 0).all()
    assert (low < 0.4).all()
    assert (high > 0.4).all()
    late = time > 0.1
    wanted = 0.02 * 2 / np.maximum(time - 0.01, 0.01)  # of the sample before
    np.testing.assert_allclose((high - low)[late], wanted[late], rtol=1e-9)


def test_set_that_is_empty_is_learnt_anew(drifting):
    """A drift that changes contradicts what was learnt: the set begins with the known bounds."""
    law = hf.observe_set(drifting, told(drifting), error_bounds={"x": 0.01})
    law = shown(law, ("d_low", "d_high", "learning_time"))
    change = 0.4 * sp.cos(hf.TIME)
    data = hf.simulate(
        drifting, law, starts=[[0.5]], disturbance={"d": change}, horizon=6.0, sample_time=0.01,
        record_every=0.01,
    ).dataset  # fmt: skip
    since = data["signal"].values[0, :, 2]
    assert (np.diff(since) < 0).any()
    low, high = data["signal"].values[0, -1, :2]
    assert low <= high


@pytest.mark.slow("3.0-0.009")
@pytest.mark.parametrize("noise", [0.0, 0.009])
@pytest.mark.parametrize("period", [3.0, 1.0])
def test_interval_of_a_drift_that_changes_within_its_rate_follows_it(drifting, period, noise):
    """The drift goes up and down at its largest rate, rho = 0.2; n = 0.01.

    At most 2 sqrt(n rho) at the end of a window, and sqrt(2) times as much in the next one.
    """
    rho, n = 0.2, 0.01
    law = hf.observe_set(drifting, told(drifting), error_bounds={"x": n}, rate_bounds={"d": rho})
    law = shown(law, ("d_low", "d_high", "learning_time"))
    swing = rho * period / (2 * np.pi) * sp.asin(sp.sin(2 * sp.pi * hf.TIME / period))
    data = hf.simulate(
        drifting, law, starts=[[0.5], [-1.0]], disturbance={"d": 0.3 + swing}, horizon=12.0,
        sample_time=0.01, record_every=0.01, noise_uniform={"x": noise}, seed=2,
    ).dataset  # fmt: skip
    low, high, learnt = np.moveaxis(data["signal"].values, -1, 0)
    felt = data["disturbance"].values[..., 0]
    assert np.abs(np.diff(felt)).max() <= rho * 0.01 * (1 + 1e-9)
    assert (low < felt).all()
    assert (felt < high).all()
    assert learnt[:, -1] == pytest.approx(12)
    best, half = 2 * np.sqrt(n * rho), (high - low)[:, 100:] / 2
    assert half.max() <= best * np.sqrt(2) + 2 * rho * 0.01
    assert half.min() <= best + 2 * rho * 0.01


def test_interval_of_a_constant_drift_does_not_follow_one_that_changes(drifting):
    law = hf.observe_set(drifting, told(drifting), error_bounds={"x": 0.01})
    law = shown(law, ("d_low", "d_high"))
    data = hf.simulate(
        drifting, law, starts=[[0.5]], disturbance={"d": 0.3 * sp.cos(0.5 * hf.TIME)}, horizon=12.0,
        sample_time=0.01, record_every=0.01,
    ).dataset  # fmt: skip
    low, high = np.moveaxis(data["signal"].values[0], -1, 0)
    felt = data["disturbance"].values[0, :, 0]
    assert ((felt < low) | (felt > high)).mean() > 0.3


def test_condition_counts_the_worst_of_the_whole_box():
    """Against the corners and a fine grid of the box, for quadratic offsets."""
    a, b, x, w = (hf.symbol(n) for n in ("a", "b", "x", "w"))
    offset = 3 - 2 * a + x * b + a * b / 2 - b**2 + x
    guard = hf.Safeguard(
        normals={"u": (sp.S.One,)}, offsets=(offset,), hard=0, scales={"u": sp.S.One}, units=("m/s",),
        names=("c",),
    )  # fmt: skip
    worst = worst_of(guard, {a: w, b: 2 * w}).offsets[0]
    for centre in ((0.0, 0.0), (0.3, -0.2), (-1.0, 0.5)):
        at = {a: centre[0], b: centre[1], x: 0.7, w: 0.1}
        bound = float(worst.subs(at).doit())
        da, db = np.meshgrid(np.linspace(-0.1, 0.1, 21), np.linspace(-0.2, 0.2, 21))
        values = sp.lambdify((a, b, x), offset)(centre[0] + da, centre[1] + db, 0.7)
        assert bound <= values.min() + 1e-12
        assert bound >= values.min() - 0.11  # the quadratic rest is counted twice at most
    with pytest.raises(DefinitionError, match="depends on what is not measured"):
        worst_of(replace(guard, normals={"u": (a,)}), {a: w})


def inside(scenario, horizon, runs, *changes):
    """The largest excess of the truth beyond the set and the bounds, and the least learning time."""
    s = hf.load_scenario(
        scenario, [f"run.horizon={horizon}", "run.record_every=0.1", *changes], runs
    )
    data = replace(s, law=shown(s.law, KEPT)).run().dataset
    names = list(data["signal_name"].values)
    signal = {n: data["signal"].values[..., names.index(n)] for n in KEPT}
    speed, direction = data["varied"].values.T[:, :, None]
    beyond = []
    for n, v in (("Vx", speed * np.cos(direction)), ("Vy", speed * np.sin(direction))):
        beyond += [(signal[f"{n}_low"] - v).max(), (v - signal[f"{n}_high"]).max()]
    states = list(data["state_name"].values)
    errors = {
        n: np.abs(signal[f"{n}_hat"] - data["state"].values[..., states.index(n)]).max()
        for n in ("u", "v", "r")
    }
    half = [(signal[f"V{c}_high"] - signal[f"V{c}_low"]).max(axis=0) / 2 for c in "xy"]
    return max(beyond), errors, signal["learning_time"][:, -1].min(), np.maximum(*half)


@pytest.mark.heavy
def test_true_current_and_velocities_are_in_the_set():
    beyond, errors, learnt, half = inside("inspection-current", 10, 40, SET)
    assert half[[1, 10]] == pytest.approx([0.032, 0.0095], abs=0.001)  # m/s, after 0.1 s and 1 s
    assert beyond < 0
    assert all(errors[n] < BOUNDS[n] for n in errors)
    assert learnt == pytest.approx(10)


@pytest.mark.heavy
@pytest.mark.parametrize("noise", [(SET,), (WIDE, NOISE)])
def test_true_current_is_in_the_set_in_two_thousand_runs_with_and_without_noise(noise):
    beyond, errors, learnt, _ = inside("inspection-current", 20, 2000, *noise)
    bounds = BOUNDS if len(noise) == 1 else {"u": 0.01, "v": 0.01, "r": 0.3}
    assert beyond < 0
    assert learnt == pytest.approx(20)
    assert all(errors[n] < bounds[n] for n in errors), errors


VEERING = (
    "varied.draws.veering=[-0.3,0.3]",
    "disturbance.Vx=speed*cos(direction + veering*t)",
    "disturbance.Vy=speed*sin(direction + veering*t)",
)
EDDIES = (
    "varied.draws.phase_x=[-3.15,3.15]",
    "varied.draws.phase_y=[-3.15,3.15]",
    "disturbance.Vx=speed*(0.7*cos(direction) + 0.3*sin(2*y + phase_x))",
    "disturbance.Vy=speed*(0.7*sin(direction) + 0.3*sin(2*x + phase_y))",
)
RATES = {VEERING: 0.03, EDDIES: 0.06}
"""m/s^2 at 0.1 m/s: 0.3 rad/s 0.1 m/s, and 0.06 1/s at 1 m/s over ground."""


def bounded(observer, rate):
    return f"{observer[:-1]},rate_bounds={{Vx={rate},Vy={rate}}}}}"


def followed(horizon, runs, *changes):
    """Runs with a truth outside the set, those learnt anew, the largest rate, the half widths."""
    s = hf.load_scenario(
        "inspection-current", [f"run.horizon={horizon}", "run.record_every=0.02", *changes], runs
    )
    data = replace(s, law=shown(s.law, KEPT)).run().dataset
    names = list(data["signal_name"].values)
    signal = {n: data["signal"].values[..., names.index(n)] for n in KEPT}
    felt = dict(zip(("Vx", "Vy"), np.moveaxis(data["disturbance"].values, -1, 0), strict=True))
    outside = np.zeros(runs, dtype=bool)
    half = []
    for n, v in felt.items():
        low, high = signal[f"{n}_low"], signal[f"{n}_high"]
        outside |= ((v < low) | (v > high)).any(axis=1)
        half.append((high - low)[:, 50:] / 2)
    anew = (np.diff(signal["learning_time"], axis=1) < 0).any(axis=1)
    rate = max(np.abs(np.diff(v, axis=1)).max() for v in felt.values()) / 0.02
    return outside.sum(), anew.sum(), rate, np.maximum(*half)


@pytest.mark.heavy
@pytest.mark.parametrize("current", [VEERING, EDDIES])
def test_current_that_varies_within_its_rate_is_in_the_set_and_outside_one_of_a_constant_current(
    current,
):
    rho = RATES[current]
    outside, anew, rate, half = followed(6, 24, bounded(SET, rho), *current)
    assert (outside, anew) == (0, 0)
    assert 0.6 * rho < rate < rho
    assert half.max() < 0.031
    outside, _, _, _ = followed(6, 24, SET, *current)
    assert outside > 12


@pytest.mark.heavy
@pytest.mark.parametrize("current", [VEERING, EDDIES])
@pytest.mark.parametrize("noise", [(SET,), (WIDE, NOISE)])
def test_current_that_varies_is_in_the_set_in_two_thousand_runs_with_and_without_noise(
    current, noise
):
    rho = RATES[current]
    outside, anew, rate, _ = followed(20, 2000, bounded(noise[0], rho), *noise[1:], *current)
    assert (outside, anew) == (0, 0)
    assert rate < rho


@pytest.mark.heavy
@pytest.mark.parametrize(("current", "lost"), [(VEERING, 1974), (EDDIES, 1874)])
def test_current_that_varies_leaves_the_set_of_a_constant_one_in_most_of_two_thousand_runs(
    current, lost
):
    outside, _, _, _ = followed(20, 2000, SET, *current)
    assert outside == lost


def test_filter_of_a_scenario_counts_the_set_and_bad_keys_are_named():
    law = hf.load_scenario("inspection-current", [SET]).law
    plain = hf.load_scenario("inspection-current").law
    for name, mode in law.modes.items():
        guard = mode.safeguard
        hard = guard.hard
        assert guard.offsets[:hard] == plain.modes[name].safeguard.offsets[:hard]
        view = dict(zip(guard.names, guard.offsets[hard:], strict=True))
        widths = {hf.symbol(n) for n in ("Vx_low", "Vx_high", "Vy_low", "Vy_high", "error_r")}
        for edge in ("edge_low", "edge_high"):
            assert widths <= view[edge].free_symbols
        assert hf.symbol("Vx_high") in view["too_near"].free_symbols
    with pytest.raises(ScenarioError, match="error_bounds"):
        hf.load_scenario("inspection-current", ["observer={error_bounds={z=1.0}}"])
    with pytest.raises(ScenarioError, match=r"rate_bounds\.z"):
        hf.load_scenario("inspection-current", [SET[:-1] + ",rate_bounds={z=1.0}}"])
    with pytest.raises(ScenarioError, match="rate_bounds without error_bounds"):
        hf.load_scenario("inspection-current", ["observer={rate_bounds={Vx=1.0}}"])


def test_bad_input_is_refused(drifting):
    law = told(drifting)
    for arguments, match in (
        ({"error_bounds": {"z": 1.0}}, "not a state"),
        ({"error_bounds": {"x": -1.0}}, "0 or more"),
        ({"error_bounds": {}}, "error bound is 0"),
        ({"error_bounds": {"x": 0.1}, "measured": []}, "not measured"),
        ({"error_bounds": {"x": 0.1}, "bandwidth": 0.0}, "bandwidth"),
        ({"error_bounds": {"x": 0.1}, "rate_bounds": {"x": 0.1}}, "not a disturbance"),
        ({"error_bounds": {"x": 0.1}, "rate_bounds": {"d": -0.1}}, "0 or more"),
    ):
        with pytest.raises(DefinitionError, match=match):
            hf.observe_set(drifting, law, **arguments)
    unbounded = replace(drifting, disturbance_bounds=None)
    with pytest.raises(DefinitionError, match="no bounds"):
        hf.observe_set(unbounded, law, error_bounds={"x": 0.1})
    with pytest.raises(DefinitionError, match="no disturbance"):
        hf.observe_set(hf.systems.unicycle(), law, error_bounds={"x": 0.1})


@pytest.mark.heavy
def test_sway_of_the_model_leaves_its_bounds_in_fast_currents_at_50_hz_and_not_at_100_hz():
    """0.2 m/s, 40 s, 600 starts: empty sets, those of runs that had left the view before, errors."""
    fast = ("varied.draws.speed=[0.2,0.2]", "run.horizon=40", "run.record_every=0.02")
    found = []
    for change in ((SET,), (SET.replace("bandwidth=40", "bandwidth=90"), "run.sample_time=0.01")):
        s = hf.load_scenario("inspection-current", [*fast, *change])
        data = replace(s, law=shown(s.law, KEPT)).run().dataset
        names = list(data["signal_name"].values)
        states = list(data["state_name"].values)
        learnt = data["signal"].values[..., names.index("learning_time")]
        anew = np.diff(learnt, axis=1) < 0
        empty = anew.any(axis=1)
        before = data["exit_time"].values < 0.02 * anew.argmax(axis=1)
        errors = [
            np.abs(
                data["signal"].values[..., names.index(f"{n}_hat")]
                - data["state"].values[..., states.index(n)]
            ).max()
            for n in ("u", "v", "r")
        ]
        found.append((empty.sum(), (empty & before).sum(), errors))
    slow, often = found
    assert slow[:2] == (34, 32)
    assert slow[2] == pytest.approx([0.11, 0.2, 0.46], abs=0.006)
    assert often[:2] == (0, 0)
    assert often[2][0] < 1e-3
    assert often[2][1] < 1e-3
    assert often[2][2] < 0.03


def test_error_of_the_sway_that_is_not_measured_grows_at_speed_unless_the_bandwidth_is_high():
    """The yaw moment u v moves the estimate of r by 2/w of it, and u r moves the sway: unstable."""
    system = hf.load_scenario("inspection-current").system
    values = {p.symbol: p.value for p in system.parameters}
    velocities = [hf.symbol(n) for n in "uvr"]
    rates = sp.Matrix([system.rates[n].subs(values) for n in "uvr"]).jacobian(velocities)

    def growth(state, w):
        """Largest growth of (psi, u, v, r) less their estimates, in 1/s."""
        at = dict(zip(velocities, state, strict=True))
        error = np.zeros((4, 4))
        error[1:, 1:] = np.array(rates.subs(at).doit(), dtype=float)
        error[0, 0], error[0, 3], error[3, 0] = -2 * w, 1, -(w**2)
        return np.linalg.eigvals(error).real.max()

    astern = (-0.85, 0, 0)
    assert growth(astern, 40) == pytest.approx(1.84, abs=0.01)
    assert growth(astern, 90) == pytest.approx(0.61, abs=0.01)
    drifting_and_turning = (-0.81, 0.09, 0.36)  # as in the runs whose sets are empty
    assert growth(drifting_and_turning, 40) == pytest.approx(0.37, abs=0.01)
    assert growth(drifting_and_turning, 90) < 0


def test_condition_with_a_kink_is_bounded_beyond_it():
    """-(x + |x|) and -max(x, 1 - 2 x): the slope at the centre says nothing of the other side."""
    x, width = hf.symbol("x"), sp.Float(0.5)
    for rising in (
        x + greatest(x, -x),
        greatest(x, 1 - 2 * x),
        x**2 + greatest(-x, greatest(x, 0)),
    ):
        guard = Safeguard({"u": (sp.S.One,)}, (-rising,), 0, {"u": sp.S.One})
        (counted,) = worst_of(guard, {x: width}).offsets
        for centre in np.linspace(-1, 1, 21):
            near = [float(rising.subs(x, centre + d)) for d in np.linspace(-0.5, 0.5, 41)]
            assert -float(counted.subs(x, centre)) >= max(near) - 1e-12
