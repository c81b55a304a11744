"""Gains against the sample time: what a held input bears, derived, run and refused."""

import cmath
import math
import re

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import brentq

import holdfast as hf
from holdfast.errors import DefinitionError, GainWarning, SimulationError
from holdfast.maths.control.safety_filter import longest_hold, usual_gains

X, U = hf.symbol("x"), hf.symbol("u")
PUSH = 10.0


@pytest.fixture(scope="module")
def point():
    """x' = u."""
    return hf.System(
        "point", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": U},
        input_bounds=hf.Box((-PUSH,), (PUSH,)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def end(point):
    return hf.Region("end", point.states, (hf.Inequality("end", X - 1, "m"),))


def pushed_out(system, **outputs):
    return hf.Law("push", system.states, {n: sp.Float(v) for n, v in outputs.items()})


def highest(gains, hold, more=None, holds=40):
    """The largest c of the sampled double integrator, between samples too, from the worst start.

    It begins on the limit, moving inwards, or where dc/dt + k1 c = 0. more: by how much the input
    does more than the condition asks, a number for every hold.
    """
    (k1, k2), t = gains, np.linspace(0.0, hold, 400)
    found = -math.inf
    for c, rate in ((0.0, -1.0), (-1.0, k1)):
        for i in range(holds):
            extra = 0.0 if more is None else more[i]
            second = -(k1 + k2) * rate - k1 * k2 * c - extra
            way = c + rate * t + second * t**2 / 2
            found = max(found, way[1:].max() if c == 0.0 else way.max())
            c, rate = way[-1], rate + second * hold
    return found


@pytest.mark.parametrize("seed", range(40))
def test_longest_hold_of_second_order_is_the_one_at_which_the_limit_is_touched(seed):
    generator = np.random.default_rng(seed)
    gains = tuple(10 ** generator.uniform(-1.5, 1.5, 2))
    longest = longest_hold(gains, (2,))
    assert highest(gains, 0.999 * longest) <= 0.0
    assert highest(gains, 1.003 * longest) > 0.0
    more = generator.exponential(1.0, 40) * generator.integers(0, 2, 40) * sum(gains)
    assert highest(gains, generator.uniform(0.1, 0.999) * longest, more) <= 0.0


def test_longest_hold_has_the_limits_of_equal_gains_and_of_one_much_slower():
    assert longest_hold((1.0, 1e-9), (2,)) == pytest.approx((1 + math.sqrt(5)) / 2, rel=1e-6)
    q = 1 / math.sqrt(2)
    assert longest_hold((1.0, 1.0), (2,)) == pytest.approx(
        (q + math.sqrt(q * q + 2 + 2 * q)) / (2 + 2 * q)
    )
    assert longest_hold((4.0, 9.0), (1,)) == 0.25
    assert longest_hold((4.0, 9.0), (1, 2)) == pytest.approx(
        min(1 / 9, longest_hold((4.0, 9.0), (2,)))
    )


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_longest_hold_is_the_same_in_every_unit_of_time(unit):
    for orders in ((1,), (2,), (1, 2)):
        scaled = longest_hold((1.5 / unit, 8.0 / unit), orders)
        assert scaled == pytest.approx(longest_hold((1.5, 8.0), orders) * unit, rel=1e-12)


@pytest.mark.parametrize("gain", [4.0, 8.0, 20.0])
def test_gain_that_the_sample_time_does_not_bear_is_refused_with_the_largest_that_it_bears(
    point, end, gain
):
    expected = r"at most 3\.333 1/s, or a sample time of at most"
    with pytest.raises(DefinitionError, match=expected):
        hf.SafetyFilter(point, end, gains=(gain, gain), sample_time=0.3)
    guarded = hf.safeguard(point, pushed_out(point, u=PUSH), end, gains=(gain, gain))
    run = {"starts": [[0.0]], "region": end, "horizon": 3.0, "record_every": 0.3}
    with pytest.raises(SimulationError, match=expected):
        hf.simulate(point, guarded, sample_time=0.3, **run)
    with pytest.raises(SimulationError, match=expected):
        hf.Controller(point, guarded, sample_time=0.3)
    borne = hf.safeguard(point, pushed_out(point, u=PUSH), end, gains=(3.333, gain))
    result = hf.simulate(point, borne, sample_time=0.3, **run)
    assert result.viable == 1
    assert result.arrays["worst_constraint"].values.max() > -0.01  # pressed against the end


@pytest.mark.parametrize("gains", [(26.5, 53.0), (53.0, 26.5), (100.0, 1.0)])
def test_gains_of_a_refusal_are_borne_where_constraints_have_two_orders(gains):
    """A wall of x is of order two, one of its speed of order one."""
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
        {"x": hf.symbol("v"), "v": U}, input_bounds=hf.Box((-PUSH,), (PUSH,)),
    )  # fmt: skip
    limits = (hf.Inequality("slow", hf.symbol("v") - 1, "m/s"), hf.Inequality("end", X - 1, "m"))
    room = hf.Region("room", cart.states, limits)
    with pytest.raises(DefinitionError, match="expected at most") as refused:
        hf.SafetyFilter(cart, room, gains=gains, sample_time=0.04)
    most = re.search(r"expected at most ([0-9.]+) and ([0-9.]+) 1/s", str(refused.value))
    hf.SafetyFilter(cart, room, gains=tuple(map(float, most.groups())), sample_time=0.04)


def test_wall_is_never_crossed_with_the_largest_gains_that_the_sample_time_bears(
    double_integrator, wall
):
    """At full speed inwards from beside the wall, and pushed back, with room for the brake."""
    strong = hf.System(
        "strong", double_integrator.states, double_integrator.inputs, double_integrator.rates,
        input_bounds=hf.Box((-1000,), (1000,)),
    )  # fmt: skip
    law = pushed_out(strong, a=1000.0)
    starts = np.array([(1.0 - d, -v) for d in (0.0, 1e-6, 0.01, 0.5) for v in (0.0, 0.1, 1.0, 9.0)])
    for gains in ((1.0, 4.0), (3.0, 3.0), (0.1, 8.0)):
        hold = longest_hold(gains, (2,)) * (1 - 1e-9)
        guarded = hf.safeguard(strong, law, wall, gains=gains)
        result = hf.simulate(
            strong, guarded, starts=starts, region=wall, horizon=100 * hold, sample_time=hold,
            record_every=hold, tolerance=1e-9,
        )  # fmt: skip
        assert result.viable == len(starts)
        with pytest.raises(SimulationError, match="crossed between two samples"):
            hf.simulate(
                strong, guarded, starts=starts, region=wall, horizon=2.002 * hold,
                sample_time=1.001 * hold, record_every=2.002 * hold,
            )  # fmt: skip


def test_gains_that_nobody_gave_are_what_the_sample_time_bears(point, end):
    assert hf.SafetyFilter(point, end).gains == (1.0, 4.0)
    slow = hf.SafetyFilter(point, end, sample_time=2.0)
    assert slow.gains == usual_gains(2.0) == (0.125, 0.5)
    state = [0.0]
    for _ in range(40):
        state = [state[0] + 2.0 * slow.step(state, [PUSH]).input[0]]
        assert state[0] <= 1.0 + 1e-12
    assert state[0] > 0.9


def test_gain_that_a_run_draws_is_refused_as_one_that_is_given(point, end):
    guarded = hf.safeguard(point, pushed_out(point, u=PUSH), end, gains=(2.0, 4.0))
    with pytest.raises(SimulationError, match=r"of the safety filter, held for 0\.3 s"):
        hf.simulate(
            point, guarded, starts=[[0.0]] * 8, region=end, horizon=3.0, sample_time=0.3,
            record_every=0.3, varied=hf.Varied(draws={"kappa1": (2.0, 9.0)}),
        )  # fmt: skip


def test_continuous_control_holds_nothing(point, end):
    guarded = hf.safeguard(point, pushed_out(point, u=PUSH), end, gains=(20.0, 20.0))
    result = hf.simulate(
        point, guarded, starts=[[0.0]], region=end, horizon=3.0, sample_time=0.3, record_every=0.3,
        continuous=True,
    )  # fmt: skip
    assert result.viable == 1


def test_delay_at_which_the_loop_of_a_condition_diverges_is_warned_of(double_integrator, wall):
    """The gains (2, 6) at 100 Hz: the recursion with a measurement that is d samples old."""
    gains, hold = (2.0, 6.0), 0.01
    strong = hf.System(
        "strong", double_integrator.states, double_integrator.inputs, double_integrator.rates,
        input_bounds=hf.Box((-1e9,), (1e9,)),
    )  # fmt: skip
    guarded = hf.safeguard(strong, pushed_out(strong, a=1e9), wall, gains=gains)

    def grows(late):
        states = [(-1.0, 0.0)] * (late + 1)
        for _ in range(4000):
            c, rate = states[-1 - late]
            second = -sum(gains) * rate - gains[0] * gains[1] * c
            c, rate = states[-1]
            states.append((c + rate * hold + second * hold**2 / 2, rate + second * hold))
        return abs(states[-1][0]) > 1.0

    limit = next(d for d in range(100) if grows(d))
    run = {"starts": [[0.0, 0.0]], "region": wall, "horizon": 0.5, "sample_time": hold}
    with pytest.warns(GainWarning, match="crossed ever further, whatever its margin"):
        hf.simulate(strong, guarded, delay=(limit + 1) * hold, record_every=0.5, **run)
    hf.simulate(strong, guarded, delay=(limit - 1) * hold, record_every=0.5, **run)  # not a word


@pytest.mark.parametrize("gains", [(1.5, 8.0), (2.0, 6.0), (0.4, 0.5)])
def test_delay_that_is_named_is_the_phase_margin_of_the_loop(double_integrator, wall, gains):
    """|k1 k2 + j (k1 + k2) w| = w^2 where the open loop crosses 1, by a root that is searched for."""
    s, p, hold = sum(gains), gains[0] * gains[1], 1e-3
    w = brentq(lambda w: abs(p + 1j * s * w) / w**2 - 1, 1e-3, 1e3)
    guarded = hf.safeguard(
        double_integrator, pushed_out(double_integrator, a=0.1), wall, gains=gains
    )
    run = {"starts": [[0.0, 0.0]], "region": wall, "horizon": 11.0, "record_every": 11.0}
    with pytest.warns(GainWarning) as warned:
        hf.simulate(double_integrator, guarded, sample_time=hold, delay=10.0, **run)
    (said,) = [str(one.message) for one in warned if "crossed ever further" in str(one.message)]
    delay = float(re.search(r"beyond a delay of ([\d.]+) s", said)[1])
    assert delay == pytest.approx(
        cmath.phase(p + 1j * s * w) / w - hold / 2, rel=5e-3
    )  # three digits


def test_scenario_refuses_gains_that_its_sample_time_does_not_bear():
    with pytest.raises(hf.errors.ScenarioError, match="expected at most"):
        hf.load_scenario("inspection", ["run.sample_time=0.2", "run.record_every=0.2"])
