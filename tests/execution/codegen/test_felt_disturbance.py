"""A disturbance that is a field over the states: what moves the plant, and what its law measures."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast.maths.expressions.functions import clip

X, Y, W = hf.symbol("x"), hf.symbol("y"), 0.4
VORTEX = {"Vx": -W * Y, "Vy": W * X}
EDDY = {
    "Vx": 0.1 * sp.sin(1.3 * Y) * sp.cos(0.2 * hf.TIME),
    "Vy": 0.05 * sp.cos(1.0 * X) + 0.02 * hf.symbol("current_limit"),
}


@pytest.fixture(scope="module")
def drifter():
    """What drifts with the water, and can push a little."""
    u = hf.Quantity("push", "m/s")
    return hf.System(
        name="drifter",
        states=(hf.Quantity("x"), hf.Quantity("y")),
        inputs=(u,),
        disturbances=(hf.Quantity("Vx", "m/s"), hf.Quantity("Vy", "m/s")),
        rates={"x": hf.symbol("Vx") + u.symbol, "y": hf.symbol("Vy")},
        disturbance_bounds=hf.Ball(1, 2),
    )


def told(system):
    """The law measures the disturbance, does nothing about it and shows it."""
    vx, vy = hf.symbol("Vx"), hf.symbol("Vy")
    reads = (*system.states, *system.disturbances)
    outputs = dict.fromkeys(system.input_names, sp.S.Zero)
    return hf.Law("told", reads, outputs, signals={"Vx": vx, "Vy": vy, "x": X, "y": Y})


@pytest.mark.parametrize("continuous", [False, True])
def test_what_drifts_in_a_vortex_goes_round_in_a_circle(drifter, continuous):
    data = hf.simulate(
        drifter, told(drifter), starts=[[1.0, 0.0], [0.0, -2.0]], disturbance=VORTEX, horizon=8.0,
        continuous=continuous, record_every=0.5, substeps=4,
    ).dataset  # fmt: skip
    t = data["time"].values
    circle = np.stack([np.cos(W * t), np.sin(W * t)], axis=1)
    other = 2 * np.stack([np.sin(W * t), -np.cos(W * t)], axis=1)
    np.testing.assert_allclose(data["state"].values, [circle, other], atol=1e-9)
    signal = data["signal"].values
    np.testing.assert_allclose(signal[..., 0], -W * data["state"].values[..., 1], atol=1e-12)


@pytest.mark.parametrize("stepper", ["rk4", "dormand-prince"])
def test_vehicle_in_an_eddy_moves_as_an_independent_solver_finds(stepper):
    system = hf.systems.marine_vehicle(thrust_limit=5.0)
    law = hf.Law("push", system.states, {"tau_u": sp.Float(0.8), "tau_r": sp.Float(0.02)})
    start = [-1.0, 0.4, 0.3, 0.05, -0.02, 0.1]
    found = hf.simulate(
        system, law, starts=[start], disturbance=EDDY, horizon=6.0, stepper=stepper
    ).dataset["state"].values[0, -1]  # fmt: skip
    values = {p.symbol: p.value for p in system.parameters}
    given = {hf.symbol("tau_u"): 0.8, hf.symbol("tau_r"): 0.02}
    felt = {hf.symbol(n): e.subs(values) for n, e in EDDY.items()}
    rates = [system.rates[n].subs(values).subs(given) for n in system.state_names]
    of = sp.lambdify(
        [hf.TIME, *(q.symbol for q in system.states)],
        [e.subs(felt) for e in rates],
        modules=[{"magnitude": abs}, "math"],
    )
    wanted = solve_ivp(lambda t, q: of(t, *q), (0, 6), start, rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(found, wanted, atol=2e-8)


def test_law_measures_the_field_where_the_vehicle_was_when_it_was_measured(drifter):
    """With a delay: at the late state; noise moves the measured state, and not the current."""
    settings = {"sample_time": 0.1, "record_every": 0.1, "horizon": 4.0, "delay": 0.3}
    found = hf.simulate(
        drifter, told(drifter), starts=[[1.0, 0.5]], disturbance=VORTEX,
        noise_uniform={"x": 0.05, "y": 0.05}, seed=3, **settings,
    ).dataset  # fmt: skip
    late = found["state"].values[0, :-3]
    signal = found["signal"].values[0, 3:]
    np.testing.assert_allclose(signal[:, :2], W * late[:, ::-1] * [-1, 1], atol=1e-12)
    assert np.abs(signal[:, 2] - late[:, 0]).max() > 0.02


def test_run_of_a_field_is_the_same_in_any_part(drifter):
    starts = np.random.default_rng(1).uniform(-1, 1, (40, 2))
    field = {"Vx": 0.5 * sp.sin(3 * Y), "Vy": clip(X, sp.S(-0.5), sp.S(0.5))}
    arguments = {"disturbance": field, "horizon": 2.0}
    every = hf.simulate(drifter, told(drifter), starts=starts, **arguments).dataset
    few = hf.simulate(drifter, told(drifter), starts=starts[17:23], **arguments).dataset
    for name in ("state", "disturbance", "signal"):
        np.testing.assert_array_equal(every[name].values[17:23], few[name].values)


def test_field_that_leaves_its_bounds_where_a_run_is_is_refused_with_the_run_and_the_time(drifter):
    """A run drifts outward along x at 0.5 m/s; at x > 1 the field exceeds 1 m/s."""
    field = {"Vx": sp.Float(0.5) + 0 * X, "Vy": 0.75**0.5 * X}
    starts = [[0.0, 0.0], [0.4, 0.0], [-3.0, 0.0]]
    for some, said in (
        (starts[:2], r"run 1 is at t = 1\.22 s: Vx = 0\.5, Vy = 0\.8\d+, as in 1 of 2 runs"),
        (starts[2:], r"run 0 is at t = 0 s: Vx = 0\.5, Vy = -2\.598"),
    ):
        with pytest.raises(SimulationError, match=said):
            hf.simulate(drifter, told(drifter), starts=some, disturbance=field, horizon=1.5)
    hf.simulate(drifter, told(drifter), starts=starts[:2], disturbance=field, horizon=1.2)


def test_field_on_the_very_rim_of_its_bounds_is_admitted_and_one_without_a_value_is_not(drifter):
    angle = 3 * X + 7 * Y
    rim = {"Vx": sp.cos(angle), "Vy": sp.sin(angle)}
    starts = np.random.default_rng(2).uniform(-1, 1, (50, 2))
    hf.simulate(drifter, told(drifter), starts=starts, disturbance=rim, horizon=1.0)
    with pytest.raises(SimulationError, match="leaves its bounds where run 0 is at t = 0 s"):
        hf.simulate(
            drifter, told(drifter), starts=[[-1.0, 0.0]], disturbance={"Vx": sp.log(X)}, horizon=1.0
        )


def test_field_of_what_is_no_state_is_refused(drifter):
    for name in ("push", "z"):
        with pytest.raises(SimulationError, match=f"uses '{name}'"):
            hf.simulate(
                drifter, told(drifter), starts=[[0.0, 0.0]],
                disturbance={"Vx": hf.symbol(name)}, horizon=1.0,
            )  # fmt: skip
