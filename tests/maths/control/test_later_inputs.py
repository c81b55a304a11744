"""Inputs that enter a constraint later than others: used, or refused by name."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.control.barrier_conditions import unused_inputs

X, Y, HEADING, V, ACC, SLIP, W = (hf.symbol(n) for n in ("x", "y", "th", "v", "a", "b", "w"))
BRAKE = 5.0


def bicycle(slip, acceleration=None, states=()):
    """A kinematic bicycle with a slip angle b, which is steered at once; its speed is a state."""
    rates = {
        "x": V * sp.cos(HEADING) - V * sp.sin(HEADING) * SLIP,
        "y": V * sp.sin(HEADING) + V * sp.cos(HEADING) * SLIP,
        "th": V / 0.2 * SLIP,
        "v": ACC,
    }
    places = [hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("th", "rad", angle=True)]
    bounds = hf.Box((-BRAKE, -slip), (BRAKE, slip)) if slip else None
    return hf.System(
        "bicycle", (*places, hf.Quantity("v", "m/s")),
        (hf.Quantity("a", "m/s^2"), hf.Quantity("b", "rad")), rates, input_bounds=bounds,
    )  # fmt: skip


def apart(system):
    """0.8 m from a point 5 m ahead."""
    return hf.Region(
        "apart", system.states, (hf.Inequality("apart", 0.64 - (X - 5) ** 2 - Y**2, "m^2"),)
    )


def motion(system):
    """Its own integrator: ten steps of Runge-Kutta in a hold; the states on the way."""
    symbols = [q.symbol for q in (*system.states, *system.inputs)]
    rates = sp.lambdify(symbols, [sp.sympify(system.rates[n]) for n in system.state_names], "math")

    def held(state, inputs, seconds, steps=10):
        h, way = seconds / steps, []
        for _ in range(steps):
            k1 = np.array(rates(*state, *inputs))
            k2 = np.array(rates(*(state + h / 2 * k1), *inputs))
            k3 = np.array(rates(*(state + h / 2 * k2), *inputs))
            k4 = np.array(rates(*(state + h * k3), *inputs))
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            way.append(state)
        return way

    return held


# -- the vehicle that is steered at once


@pytest.mark.few("0.01-0.5", "0.1-0.001")
@pytest.mark.parametrize("slip", [0.5, 0.001])
@pytest.mark.parametrize("aside", [0.0, 0.01, 0.1])
def test_vehicle_steered_at_once_brakes_before_an_obstacle_dead_ahead(slip, aside):
    """The driver keeps the speed and looks straight ahead; the steering alone has no effect there."""
    system = bicycle(slip)
    keep = hf.SafetyFilter(system, apart(system), gains=(1, 4))
    held, state, braked = motion(system), np.array([0.0, aside, 0.0, 1.0]), 0.0
    for _ in range(600):
        decision = keep.step(state, [2 * (1 - state[3]), 0.0])
        assert decision.status.value in ("passed", "changed")
        braked = min(braked, decision.input[0])
        way = held(state, decision.input, 0.02)
        assert all(math.hypot(q[0] - 5, q[1]) > 0.8 for q in way)
        state = way[-1]
    assert braked < -0.01


def test_beyond_what_steering_can_do_the_vehicle_steers_and_brakes():
    """At a speed at which no steering meets the first condition, both inputs are used."""
    system = bicycle(0.02)
    decision = hf.SafetyFilter(system, apart(system)).step([0.0, 0.1, 0.0, 3.0], [0.0, 0.0])
    assert decision.status.value == "changed"
    assert decision.input[0] < -1.0
    assert decision.input[1] == pytest.approx(0.02, rel=1e-6)  # P > 0: the best that there is


def test_inputs_without_bounds_count_as_at_rest():
    system = bicycle(None)
    region = apart(system)
    law = hf.Law("still", system.states, {"a": sp.S.Zero, "b": sp.S.Zero})
    guard = hf.safeguard(system, law, region).safeguard
    assert guard.names == ("apart", "apart")
    keep = hf.SafetyFilter(system, region)
    held, state = motion(system), np.array([0.0, 0.0, 0.0, 1.0])
    for _ in range(300):
        state = held(state, keep.step(state, [2 * (1 - state[3]), 0.0]).input, 0.02)[-1]
        assert math.hypot(state[0] - 5, state[1]) > 0.8


# -- exact cases


def carried(effect, drift=0):
    """x' = v + effect w + drift, v' = a, z' = w: w acts on x at once, a later."""
    z = hf.symbol("z")
    return hf.System(
        "carried",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"), hf.Quantity("z")),
        (hf.Quantity("a", "m/s^2"), hf.Quantity("w")),
        {"x": V + effect * W + drift, "v": ACC, "z": W},
        input_bounds=hf.Box((-2, -0.5), (2, 0.5)),
    ), z


def test_conditions_are_those_of_the_best_input():
    """c = x - 1: v + z w + k1 c <= max(0, P) and dP/dt + k2 P <= 0 with P = v - |z| / 2 + k1 c."""
    z = hf.symbol("z")
    system, _ = carried(z)
    wall = hf.Region("wall", system.states, (hf.Inequality("wall", X - 1, "m"),))
    law = hf.Law("still", system.states, {"a": sp.S.Zero, "w": sp.S.Zero})
    guarded = hf.safeguard(system, law, wall, gains=(1.5, 5.0))
    guard = guarded.safeguard
    assert guard.units == ("m/s", "m/s^2")
    rows = [[guard.normals[n][j] for n in ("a", "w")] + [guard.offsets[j]] for j in (4, 5)]
    states = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    found = (
        Evaluator(
            [e for row in rows for e in row], [q.symbol for q in system.states], guarded.parameters
        )
        .values(states)
        .reshape(50, 2, 3)
    )
    x, v, zs = states.T
    p = v - np.abs(zs) / 2 + 1.5 * (x - 1)
    side = np.where(zs >= 0, 1.0, -1.0)
    first = np.stack([np.zeros(50), zs, np.maximum(-v - 1.5 * (x - 1), -np.abs(zs) / 2)], axis=1)
    second = np.stack([np.ones(50), 1.5 * zs - side / 2, -1.5 * v - 5.0 * p], axis=1)
    np.testing.assert_allclose(found[:, 0], first, atol=1e-12)
    np.testing.assert_allclose(found[:, 1], second, atol=1e-12)


def test_without_drift_the_first_condition_stands_alone():
    """A unicycle can stop: its turn rate, which acts later, is not needed."""
    system = hf.systems.unicycle()
    wall = hf.Region("wall", system.states, (hf.Inequality("wall", X - 1, "m"),))
    law = hf.Law("still", system.states, dict.fromkeys(system.input_names, sp.S.Zero))
    assert hf.safeguard(system, law, wall).safeguard.names == ("wall",)


def test_input_that_acts_after_two_derivatives_is_refused_by_name():
    """The same bicycle whose acceleration is a state, driven by a jerk."""
    plain, jerk, state = bicycle(0.3), hf.symbol("jerk"), hf.symbol("acc")
    system = hf.System(
        "jerky", (*plain.states, hf.Quantity("acc", "m/s^2")),
        (hf.Quantity("jerk", "m/s^3"), plain.inputs[1]),
        {**plain.rates, "v": state, "acc": jerk}, input_bounds=hf.Box((-9, -0.3), (9, 0.3)),
    )  # fmt: skip
    with pytest.raises(DefinitionError, match=r"'jerk' of system 'jerky' acts on 'apart'"):
        hf.SafetyFilter(system, apart(system))


def test_input_that_second_derivatives_leave_out_is_named(vehicle):
    """A vehicle beside a wall turns by a moment that acts on the distance in its third derivative."""
    wall = hf.Region("wall", vehicle.states, (hf.Inequality("wall", hf.symbol("y") - 1, "m"),))
    turn = hf.Region("turn", vehicle.states, (hf.Inequality("turn", hf.symbol("psi") - 1, "rad"),))
    assert unused_inputs(vehicle, wall) == {"wall": ("tau_r",)}
    assert unused_inputs(vehicle, turn) == {}  # its moment acts alike at every state
    keep = hf.SafetyFilter(vehicle, wall)
    assert keep.unused == {"wall": ("tau_r",)}
    decision = keep.step([0.0, 0.9, 0.0, 0.0, 0.5, 0.0], [0.0, 0.0])  # sideways towards it
    assert decision.status.value == "infeasible"
    assert "'tau_r' acts on 'wall' by a third derivative or later" in decision.why


# -- random systems, hostile commands


def drawn(generator):
    """A system with an input at once and others later, its region, and a box of starts."""

    def number(low, high):
        return sp.Float(round(float(generator.uniform(low, high)), 3))

    z, p, v = hf.symbol("z"), hf.symbol("p"), hf.symbol("v")
    effects = [number(0.2, 1), z, sp.sin(3 * z), z * p, sp.cos(z), p * V]
    effect = effects[generator.integers(len(effects))]
    size, brake = number(0.1, 1.0), number(1.5, 5.0)
    system = hf.System(
        "drawn",
        (hf.Quantity("p"), hf.Quantity("v"), hf.Quantity("z")),
        (hf.Quantity("a"), hf.Quantity("w")),
        {
            "p": v + effect * W + number(-0.2, 0.2) * sp.sin(p),
            "v": ACC - number(-0.2, 0.5) * v,
            "z": number(-1, 1) * W - number(0, 1) * z + number(-0.5, 0.5) * sp.cos(2 * z),
        },
        input_bounds=hf.Box((-brake, -size), (brake, size)),
    )  # fmt: skip
    limits = (hf.Inequality("high", p - 1, "m"), hf.Inequality("low", -1 - p, "m"))
    return system, hf.Region("strip", system.states, limits)


@pytest.mark.few("5")
@pytest.mark.parametrize("seed", range(8))
def test_random_system_with_an_input_that_enters_later_stays_inside(seed):
    """Wherever an input meets all conditions from the start on, under corners of the bounds."""
    generator = np.random.default_rng(seed)
    system, region = drawn(generator)
    hold = float(generator.choice([0.01, 0.02]))
    keep = hf.SafetyFilter(system, region, gains=(1.0, 4.0), sample_time=hold)
    held = motion(system)
    ends = np.array([system.input_bounds.lower, system.input_bounds.upper], dtype=np.float64)
    begun = 0
    for _ in range(60):
        state = generator.uniform(-0.7, 0.7, 3)
        if keep.step(state, [0.0, 0.0]).status is hf.Status.INFEASIBLE or begun == 3:
            continue
        begun += 1
        for k in range(round(5 / hold)):
            if k % 20 == 0:
                command = ends[generator.integers(0, 2, 2), [0, 1]]
            decision = keep.step(state, command)
            if decision.status is hf.Status.INFEASIBLE:
                break
            way = held(state, decision.input, hold, 4)
            assert max(abs(q[0]) for q in way) <= 1.0 + 1e-3  # what held inputs leave
            state = way[-1]
    assert begun == 3
