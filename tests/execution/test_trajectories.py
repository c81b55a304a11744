"""Trajectories with sensitivities, against exact solutions and another integrator."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.trajectories import Trajectories
from holdfast.maths.identification import measured_motion

OTTER = hf.load_vehicle("otter")
GENERATOR = np.random.default_rng(4)


def of_a_boat(sensitive=True):
    """The Otter's motion by three numbers, and its trajectories."""
    measured = measured_motion(
        OTTER, ["x", "y", "psi", "u", "v", "r"], ["mass", "Nr", "Yvdot", "Vx"]
    )
    x, u, v = ([q.symbol for q in g] for g in (measured.states, measured.inputs, measured.unknown))
    rates = measured.sensitivities if sensitive else list(measured.rates)
    return measured, Trajectories(rates, x, u, v, measured.parameters)


def drawn(measured, count=11, steps=30):
    """First states, inputs that change between steps, and unknown numbers."""
    values = {p.name: p.value for p in OTTER.parameters}
    first = GENERATOR.normal(0, 0.3, (count, 6))
    inputs = GENERATOR.uniform(-20, 20, (count, steps, len(measured.inputs)))
    known = np.array([values.get(q.name, 0.1) for q in measured.unknown])
    return first, inputs, known * GENERATOR.uniform(0.9, 1.1, (count, len(known)))


def test_a_linear_motion_and_its_sensitivities_are_the_exponential_of_its_matrix():
    x = sp.symbols("x1:3", real=True)
    a, b, u, p = sp.symbols("a b u p", real=True)
    rates = [a * x[0] + x[1] + u, -p * x[0] + b]
    slopes = [r.diff(s) for group in (x, (a, b)) for r in rates for s in group]
    known = (hf.Parameter("p", "1/s^2", value=2.0, description="stiffness"),)
    paths = Trajectories([*rates, *slopes], x, [u], [a, b], known)
    first, v, held, step = np.array([[0.3, -0.2]]), np.array([[-0.4, 0.7]]), 0.5, 0.01
    z, _ = paths.nodes(first, np.full((1, 100, 1), held), v, step)

    def exact(q, c):
        """(q, 1) moves linearly."""
        whole = np.array([[c[0], 1.0, held], [-2.0, 0.0, c[1]], [0.0, 0.0, 0.0]])
        return (expm(whole * 100 * step) @ np.array([*q, 1.0]))[:2]

    assert z[-1, :2, 0] == pytest.approx(exact(first[0], v[0]), abs=1e-9)
    found = z[-1, 2:, 0].reshape(2, 4)
    for k in range(4):
        moved = [np.concatenate([first[0], v[0]]) + d * np.eye(4)[k] for d in (1e-6, -1e-6)]
        ends = [exact(m[:2], m[2:]) for m in moved]
        assert found[:, k] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-8)


def test_a_boat_moves_as_another_integrator_moves_it():
    measured, paths = of_a_boat(sensitive=False)
    first, inputs, unknown = drawn(measured)
    z, rates = paths.nodes(first, inputs, unknown, 0.02)
    symbols = [q.symbol for q in (*measured.states, *measured.inputs, *measured.unknown)]
    numbers = {p.symbol: p.value for p in measured.parameters}
    rate = sp.lambdify(
        symbols,
        [sp.sympify(r).xreplace(numbers) for r in measured.rates],
        [{"magnitude": abs}, "math"],
    )
    for k in (0, 7, 10):
        q = first[k]
        for step in range(30):
            held = (*inputs[k, step], *unknown[k])
            assert rates[step, :, k] == pytest.approx(rate(*z[step, :, k], *held), abs=1e-11)
            q = solve_ivp(
                lambda t, s, held=held: rate(*s, *held), (0, 0.02), q, rtol=1e-10, atol=1e-12
            ).y[:, -1]
        assert z[-1, :, k] == pytest.approx(q, abs=1e-6)


def test_sensitivities_of_a_boat_are_the_limits_of_difference_quotients():
    measured, paths = of_a_boat()
    first, inputs, unknown = drawn(measured)
    z, _ = paths.nodes(first, inputs, unknown, 0.02)
    found = z[-1, 6:].reshape(6, 6 + 4, -1)
    _, plain = of_a_boat(sensitive=False)
    for k in range(10):
        ends = []
        size = 1e-6 if k < 6 else 1e-6 * max(1.0, float(np.abs(unknown[0, k - 6])))
        for sign in (1, -1):
            q, v = first.copy(), unknown.copy()
            if k < 6:
                q[:, k] += sign * size
            else:
                v[:, k - 6] += sign * size
            ends.append(plain.nodes(q, inputs, v, 0.02)[0][-1])
        quotient = (ends[0] - ends[1]) / (2 * size)
        assert found[:, k] == pytest.approx(quotient, rel=1e-5, abs=1e-8)


def test_a_trajectory_that_diverges_leaves_the_others_alone():
    q, a = sp.symbols("q a", real=True)
    paths = Trajectories([a * q**2], [q], [], [a], ())
    nothing = np.empty((3, 400, 0))
    z, _ = paths.nodes(np.ones((3, 1)), nothing, np.array([[-1.0], [9.0], [-2.0]]), 0.01)
    assert not np.isfinite(z[-1, 0, 1])
    assert z[-1, 0, [0, 2]] == pytest.approx([1 / 5, 1 / 9], rel=1e-8)


def test_an_undeclared_symbol_is_named():
    q, a = sp.symbols("q a", real=True)
    with pytest.raises(DefinitionError, match="'a'"):
        Trajectories([a * q], [q], [], [], ())
