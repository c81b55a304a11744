"""Every stepper converges at its order; the simulator agrees with an independent integrator."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import holdfast as hf
from holdfast.execution.simulation.settings import (
    ALL,
    BOGACKI_SHAMPINE,
    DORMAND_PRINCE,
    RK4,
    Tableau,
)


@pytest.mark.parametrize("tableau", ALL, ids=lambda t: t.name)
def test_tableau_is_consistent(tableau: Tableau):
    assert sum(tableau.b) == pytest.approx(1)
    assert np.dot(tableau.b, tableau.c) == pytest.approx(1 / 2)
    assert np.dot(tableau.b, np.square(tableau.c)) == pytest.approx(1 / 3)
    if tableau.b_low is not None:
        assert sum(tableau.b_low) == pytest.approx(1)
        assert np.dot(tableau.b_low, tableau.c) == pytest.approx(1 / 2)


def pendulum():
    """A smooth closed loop under continuous control, with a term in time."""
    a, w = hf.symbol("a"), hf.symbol("w")
    system = hf.System(
        "pendulum",
        (hf.Quantity("a", "rad", angle=True), hf.Quantity("w", "rad/s")),
        (hf.Quantity("m"),),
        {"a": w, "w": -sp.sin(a) + hf.symbol("m") + hf.TIME / 10},
    )
    return system, hf.Law("damp", system.states, {"m": -0.3 * w * sp.cos(hf.TIME)})


def pendulum_end(stepper, **settings):
    system, law = pendulum()
    result = hf.simulate(
        system,
        law,
        starts=[[1.0, 0.3]],
        horizon=4.0,
        stepper=stepper,
        continuous=True,
        record_every=4.0,
        **settings,
    )
    return result.dataset["state"].values[0, -1], result


@pytest.fixture(scope="module")
def reference():
    return solve_ivp(
        lambda t, q: [q[1], -np.sin(q[0]) - 0.3 * q[1] * np.cos(t) + t / 10],
        (0, 4),
        [1.0, 0.3],
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
    ).y[:, -1]


def test_rk4_converges_at_fourth_order(reference):
    steps = np.array([0.4, 0.2, 0.1, 0.05])
    errors = [
        np.abs(pendulum_end("rk4", sample_time=h, substeps=1)[0] - reference).max() for h in steps
    ]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(RK4.order, abs=0.3)


@pytest.mark.parametrize("tableau", [BOGACKI_SHAMPINE, DORMAND_PRINCE], ids=lambda t: t.name)
def test_global_error_of_an_adaptive_pair_falls_in_proportion_to_its_tolerance(tableau, reference):
    """The tolerance bounds the error of one step; the error at the end is a multiple of it."""
    tolerances = np.array([1e-4, 1e-6, 1e-8])
    errors = []
    for tolerance in tolerances:
        end, _ = pendulum_end(tableau.name, sample_time=4.0, absolute=tolerance, relative=tolerance)
        errors.append(np.abs(end - reference).max())
    assert (np.array(errors) < 30 * tolerances).all()
    assert np.polyfit(np.log(tolerances), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("tableau", [BOGACKI_SHAMPINE, DORMAND_PRINCE], ids=lambda t: t.name)
def test_fixed_steps_of_an_adaptive_pair_converge_at_its_order(tableau, reference):
    """With a huge tolerance every step is taken whole, so the sample time is the step."""
    steps = np.array([0.4, 0.2, 0.1, 0.05])
    errors = [
        np.abs(
            pendulum_end(tableau.name, sample_time=h, absolute=1e9, relative=1e9)[0] - reference
        ).max()
        for h in steps
    ]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(tableau.order, abs=0.4)


SMOOTH = [-1.5, -0.6, 0.3, 0.02, -0.01, 0.05]
"""A start from which no sign changes for 8 s under the full force law (x < goal)."""


@pytest.fixture(scope="module")
def force_law(vehicle):
    return hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})


@pytest.fixture(scope="module")
def independent(vehicle, force_law):
    """The states at every second by DOP853, from the same expressions as NumPy functions."""
    law = force_law
    values = {p.symbol: p.value for p in (*law.parameters, *vehicle.parameters)}
    saturated = vehicle.input_bounds.saturate([q.symbol for q in vehicle.inputs])
    wanted = {q.symbol: law.outputs[q.name] for q in vehicle.inputs}
    applied = {q.symbol: e.subs(wanted) for q, e in zip(vehicle.inputs, saturated, strict=True)}
    still = {hf.symbol("Vx"): 0, hf.symbol("Vy"): 0}
    numpy_functions = {
        "sgn": lambda x: 1.0 if x >= 0 else -1.0,
        "wrap": lambda x: x - 2 * np.pi * np.ceil((x - np.pi) / (2 * np.pi)),
        "select": lambda x, a, b: a if x >= 0 else b,
        "magnitude": abs,
        "least": min,
        "greatest": max,
        "angle": lambda y, x, guard: np.arctan2(y, x),
        "length": lambda x, y, guard: np.hypot(x, y),
    }
    right_hand_side = sp.lambdify(
        [q.symbol for q in vehicle.states],
        [e.subs(still).subs(applied).subs(values) for e in vehicle.rates.values()],
        modules=[numpy_functions, "numpy"],
        cse=True,
    )
    found = solve_ivp(
        lambda t, q: right_hand_side(*q), (0, 8), SMOOTH, method="DOP853", rtol=1e-12,
        atol=1e-13, t_eval=np.arange(9.0), max_step=0.05,
    )  # fmt: skip
    return found.y.T


@pytest.mark.slow("rk4")
@pytest.mark.parametrize("stepper", ["rk4", "dormand-prince"])
def test_smooth_closed_loop_agrees_with_an_independent_integrator(
    vehicle, force_law, independent, stepper
):
    ours = hf.simulate(
        vehicle, force_law, starts=[SMOOTH], horizon=8.0, stepper=stepper, continuous=True,
        sample_time=0.01, substeps=2, record_every=1.0, absolute=1e-11, relative=1e-11,
    ).dataset["state"].values[0]  # fmt: skip
    assert np.abs(ours - independent).max() < 1e-7


def test_motion_too_fast_for_its_tolerance_is_an_outcome_and_not_an_endless_run():
    """A spin of 1e9 rad/s: a million steps within one sample, then 'diverged', with the time."""
    x, y, w = (hf.symbol(n) for n in ("x", "y", "w"))
    spin = hf.System(
        "spin", (hf.Quantity("x"), hf.Quantity("y")), (hf.Quantity("w"),), {"x": -w * y, "y": w * x}
    )
    fast = hf.Law("fast", spin.states, {"w": 1e9})
    data = hf.simulate(
        spin,
        fast,
        starts=[[1.0, 0.0]],
        horizon=1.0,
        sample_time=1.0,
        record_every=1.0,
        stepper="dormand-prince",
    ).dataset
    assert data["outcome"].values[0] == hf.Outcome.DIVERGED
    assert 0 < data["exit_time"].values[0] < 1
