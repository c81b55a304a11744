"""Filters over a kernel whose measurements are late, by the state that they predict."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError
from holdfast.maths.control.prediction import MOST_SENT, prediction, sent, span
from tests.c_code import answers_of_c, needs_gcc

Y, TH, W, D = (hf.symbol(n) for n in ("y", "theta", "w", "d"))
HOLD = 0.05


def quantities(*names: str) -> tuple[hf.Quantity, ...]:
    angles = ("theta",)
    return tuple(hf.Quantity(n, "rad" if n in angles else "1", angle=n in angles) for n in names)


CAR = hf.System(
    "car", quantities("y", "theta"), quantities("w"), {"y": sp.sin(TH) + D, "theta": W},
    disturbances=quantities("d"), input_bounds=hf.Box((-1,), (1,)),
    disturbance_bounds=hf.Box((-0.2,), (0.2,)),
)  # fmt: skip
LANE = hf.Region(
    "lane", quantities("y"), (hf.Inequality("left", Y - 1), hf.Inequality("right", -1 - Y))
)


def flown(q, inputs, disturbance, steps):
    """States (count, 2) after inputs (count,) and disturbances were held, in small steps."""
    h = HOLD / steps
    rates = lambda q: np.stack([np.sin(q[:, 1]) + disturbance, inputs], axis=1)  # noqa: E731
    way = [q]
    for _ in range(steps):
        a = rates(q)
        b = rates(q + h / 2 * a)
        c = rates(q + h / 2 * b)
        q = q + h / 6 * (a + 2 * b + 2 * c + rates(q + h * c))
        way.append(q)
    return way[1:]


@pytest.fixture(scope="module")
def kernel():
    grid = hf.grid(CAR, {"y": (-1.2, 1.2), "theta": (-math.pi, math.pi)}, {"y": 61, "theta": 60})
    return hf.discriminating_kernel(CAR, LANE, grid, 8.0)


@pytest.mark.parametrize("delay", [0.02, 0.05, 0.12])
def test_predicted_state_is_where_the_inputs_have_led(delay):
    """Against an integrator: inputs of one to three samples, the first of which began late."""
    found = prediction(CAR, HOLD, delay)
    assert found is not None
    count = math.ceil(delay / HOLD)
    inputs = [0.9, -0.6, 0.4][:count]  # the last one first
    q = np.array([[0.1, 0.7]])
    for k in range(count, 0, -1):
        length = HOLD if k < count else delay - (count - 1) * HOLD
        steps = 100
        for _ in range(steps):  # with Euler's midpoint, as fine as it has to be
            h = length / steps
            half = q + h / 2 * np.array([[np.sin(q[0, 1]), inputs[k - 1]]])
            q = q + h * np.array([[np.sin(half[0, 1]), inputs[k - 1]]])
    lengths = [HOLD] * (count - 1) + [delay - (count - 1) * HOLD]
    values = {Y: 0.1, TH: 0.7} | {hf.symbol(span(k + 1)): h for k, h in enumerate(lengths)}
    values |= {hf.symbol(sent(k + 1, "w")): u for k, u in enumerate(inputs)}
    there = [float(found.places[s].subs(values)) for s in (Y, TH)]
    assert there == pytest.approx(q[0].tolist(), abs=3e-6)
    values |= {hf.symbol(span(k + 1)): 0 for k in range(count)}  # before the first sample
    assert [float(found.places[s].subs(values)) for s in (Y, TH)] == [0.1, 0.7]


def test_delay_of_too_many_inputs_is_not_predicted():
    assert MOST_SENT == 20
    assert prediction(CAR, HOLD, 0.0) is None
    assert prediction(CAR, HOLD, (MOST_SENT + 1) * HOLD) is None


@pytest.mark.heavy
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("late", [0, 4, 10, 20])
def test_kernel_is_kept_by_a_filter_whose_measurements_are_late(kernel, late):
    """From right inside what held inputs keep, against commands and winds that push out.

    late: in tenths of a sample. Three in four states that are kept were given up by the margin
    that a delay of two samples had.
    """
    steps, seconds, count = 10, 8.0, 120
    keep = hf.SafetyFilter(CAR, kernel, sample_time=HOLD, delay=late * HOLD / steps)
    said = f", of states that are seen {keep.delay:g} s late"
    assert (said in str(keep)) == (late > 0)
    game = list(kernel.games.values())[-1]
    assert (game.table > game.least).mean() > 0.95 * (kernel.values() > 0).mean()
    generator = np.random.default_rng(0)
    points = generator.uniform([-1, -math.pi], [1, math.pi], (40_000, 2))
    margin = {p.name: float(p.value) for p in keep.law.parameters}["safety_margin"]
    inside = np.array(keep.step_many(points, np.zeros((len(points), 1))).value)
    keep.reset()
    near = (inside > margin) & (inside < margin + 0.3 * kernel.report.cell)
    q = points[near][:count]
    assert len(q) == count
    command = generator.choice([-1.0, 1.0], (count, 1))
    side = np.sign(q[:, 0])
    way, least = [q], np.inf
    for k in range(round(seconds / HOLD)):
        seen = way[max(len(way) - 1 - late, 0)]
        u = np.array(keep.step_many(seen, command).input)[:, 0]
        wind = 0.2 * np.where(np.arange(count) % 2, side, generator.choice([-1, 1]))
        way += flown(way[-1], u, wind, steps)
        turned = way[-1].copy()
        turned[:, 1] = (turned[:, 1] + math.pi) % (2 * math.pi) - math.pi
        least = min(least, float(kernel.at(turned).min()))
        if k % 20 == 0:
            side = np.sign(way[-1][:, 0])
    assert least > 0


@pytest.mark.heavy
@pytest.mark.filterwarnings("ignore")
def test_what_was_sent_in_place_of_an_answer_is_remembered(kernel):
    """A fallback acts on its way like any other input, also of one row among several."""
    keep, other = (
        hf.SafetyFilter(CAR, kernel, sample_time=HOLD, delay=2 * HOLD, fallback=[0.7])
        for _ in range(2)
    )
    near, far = [0.7, 0.3], [0.0, 0.0]
    other.step_many([far, near], [[0.5], [0.5]])
    several = other.step_many([far, [math.nan, 0.0]], [[0.5], [0.5]])
    assert several.input[1].tolist() == [0.7]
    keep.step(near, [0.5])
    assert keep.step([math.nan, 0.0], [0.5]).input.tolist() == [0.7]
    for _ in range(3):
        one = keep.step(near, [1.0])
        assert other.step_many([far, near], [[0.5], [1.0]]).input[1] == pytest.approx(one.input)
    calm = hf.SafetyFilter(CAR, kernel, sample_time=HOLD, delay=2 * HOLD)
    for q in (near, [math.nan, 0.0]):
        calm.step(q, [0.5])
    keep.reset()
    for q in (near, [math.nan, 0.0]):
        keep.step(q, [0.5])
    assert keep.step(near, [1.0]).input != pytest.approx(calm.step(near, [1.0]).input)


@pytest.mark.heavy
@needs_gcc
@pytest.mark.filterwarnings("ignore")
def test_late_filter_in_c_has_the_same_bits(kernel, tmp_path):
    keep = hf.SafetyFilter(CAR, kernel, sample_time=HOLD, delay=1.6 * HOLD)
    generator = np.random.default_rng(0)
    states = generator.uniform([-1, -1], [1, 1], (400, 2))
    commands = generator.uniform(-1, 1, (400, 1))
    answers = answers_of_c(tmp_path, keep, states, commands)
    ours = [
        keep.step(q, w, k * HOLD).input[0]
        for k, (q, w) in enumerate(zip(states, commands, strict=True))
    ]
    assert answers.tolist() == ours
    assert np.mean(answers != commands[:, 0]) > 0.2


@pytest.mark.heavy
@pytest.mark.filterwarnings("ignore")
def test_kernel_and_a_region_are_kept_in_order_of_measurements_that_are_late(kernel):
    slow = hf.Region("slow", quantities("theta"), (hf.Inequality("turn", TH - 2.5),))
    alone, first = (
        hf.SafetyFilter(CAR, keep, sample_time=HOLD, delay=HOLD)
        for keep in (kernel, [kernel, slow])
    )
    for q in ([0.0, 0.2], [0.6, 0.3], [-0.7, -0.4]):
        assert first.step(q, [1.0]).input == pytest.approx(alone.step(q, [1.0]).input, abs=1e-9)


@pytest.mark.heavy
@pytest.mark.filterwarnings("ignore")
def test_simulation_with_a_delay_is_that_of_the_filter_sample_by_sample(kernel):
    push = hf.Law("push", CAR.states, {"w": sp.S.One})
    law = hf.safety_law(CAR, kernel, push, sample_time=HOLD, delay=2 * HOLD)
    assert isinstance(law, hf.Switching)
    data = hf.simulate(
        CAR, law, starts=[[0.2, 0.1]], region=LANE, horizon=4.0, sample_time=HOLD, delay=2 * HOLD,
        record_every=HOLD, disturbance={"d": 0.1},
    ).dataset  # fmt: skip
    keep = hf.SafetyFilter(CAR, kernel, sample_time=HOLD, delay=2 * HOLD)
    states, inputs = data["state"].values[0], data["input"].values[0]
    for k in range(60):
        u = keep.step(states[max(k - 2, 0)], [1.0]).input
        assert u == pytest.approx(inputs[k], abs=1e-9)
    assert (inputs[:60] < 0.99).any()


@pytest.mark.filterwarnings("ignore")
def test_run_with_another_delay_than_that_of_its_law_is_refused(kernel):
    push = hf.Law("push", CAR.states, {"w": sp.S.One})
    law = hf.safety_law(CAR, kernel, push, sample_time=HOLD, delay=2 * HOLD)
    for delay in (0.0, HOLD, 3 * HOLD):
        with pytest.raises(
            SimulationError, match=r"over a delay of 0.1 s, and is shown it .* late"
        ):
            hf.simulate(
                CAR, law, starts=[[0, 0]], region=LANE, horizon=1, sample_time=HOLD, delay=delay
            )


X, V, U = (hf.symbol(n) for n in ("x", "v", "u"))
SLOW = hf.Box((-1,), (1,))
DRIVEN = hf.System(
    "driven", quantities("x", "v"), quantities("u"), {"x": V + D, "v": U},
    disturbances=quantities("d"), input_bounds=SLOW, disturbance_bounds=hf.Box((-0.1,), (0.1,)),
)  # fmt: skip
ROOM = hf.Region(
    "room", quantities("x", "v"),
    tuple(hf.Inequality(f"c{i}", e) for i, e in enumerate((X - 1, -1 - X, V - 1.4, -1.4 - V))),
)  # fmt: skip
ENDS = {"x": (-1.2, 1.2), "v": (-1.6, 1.6)}


@pytest.fixture(scope="module")
def room():
    grid = hf.grid(DRIVEN, ENDS, dict.fromkeys(ENDS, 61))
    return hf.discriminating_kernel(DRIVEN, ROOM, grid, 8.0)


@pytest.mark.heavy
@pytest.mark.filterwarnings("ignore")
def test_behind_an_observer_the_margin_allows_for_the_delay(room):
    """The observer advances its estimate with what was just sent: nobody may do it once more."""
    keep = hf.SafetyFilter(DRIVEN, room, sample_time=HOLD, delay=2 * HOLD, states=("x",))
    numbers = {p.name: float(p.value) for p in keep.law.parameters}
    assert numbers["safety_margin"] >= hf.sampled_margin(DRIVEN, room, HOLD, 2 * HOLD)
    push = hf.Law("push", DRIVEN.states, {"u": sp.S.One})
    law = hf.safety_law(DRIVEN, room, push, sample_time=HOLD, delay=2 * HOLD)
    for observed in (
        lambda: hf.observe(DRIVEN, law, measured=("x",), bandwidth=2.0),
        lambda: hf.observe_set(
            DRIVEN, law, measured=("x",), bandwidth=2.0, error_bounds={"x": 0.01, "v": 0.01}
        ),
    ):
        with pytest.raises(DefinitionError, match="an observer of a law that predicts the state"):
            observed()


@pytest.mark.heavy
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("gap", [23, 41])
def test_relay_predicts_over_a_gap_from_the_fallback_that_was_sent(room, gap):
    """The relay decides as the filter that was asked at every sample does."""
    late, fallback = 4, [-0.8]
    keep, plain = (
        hf.SafetyFilter(DRIVEN, room, sample_time=HOLD, delay=late * HOLD, fallback=fallback)
        for _ in range(2)
    )
    relay, q, way = hf.Relay(keep, patience=0.4 * HOLD), np.array([0.3, 0.2]), []
    for k in range(60):
        way.append(q)
        seen, missing = way[max(k - late, 0)], gap <= k < gap + 7
        if not missing:
            relay.measured(seen, k * HOLD)
        relay.commanded([1.0], k * HOLD)
        u = np.array(list(relay.decide(k * HOLD).input.values()))
        asked = [math.nan, 0.0] if missing else seen
        assert u == pytest.approx(plain.step(asked, [1.0], k * HOLD).input, abs=1e-12)
        q = q + HOLD * np.array([q[1] + 0.1 + HOLD / 2 * u[0], u[0]])
    assert max(abs(q[0]) for q in way) < 1


@pytest.mark.heavy
@pytest.mark.filterwarnings("ignore")
def test_fallback_of_the_first_sample_is_on_its_way_too(room):
    keep = hf.SafetyFilter(DRIVEN, room, sample_time=HOLD, delay=2 * HOLD, fallback=[-0.8])
    keep.step([math.nan, 0.0], [0.0])
    keep.step_many([[math.nan, 0.0]], [[0.0]])
    for _ in range(3):
        one = keep.step([0.6, 0.7], [1.0])
        assert keep.step_many([[0.6, 0.7]], [[1.0]]).value == pytest.approx([one.value])


GROWING = hf.System(
    "growing", quantities("v"), quantities("u", "w"), {"v": U * V + W + D},
    disturbances=quantities("d"), input_bounds=hf.Box((1, -3), (4, 3)),
    disturbance_bounds=hf.Box((-0.8,), (0.8,)),
)  # fmt: skip


@pytest.mark.heavy
@pytest.mark.filterwarnings("ignore")
def test_what_a_disturbance_moves_is_carried_on_with_the_worst_input():
    """By e^(u D), with inputs of which none is 0. A longer delay is refused: runs would be lost."""
    delay = HOLD
    region = hf.Region(
        "band", quantities("v"), (hf.Inequality("a", V - 1), hf.Inequality("b", -1 - V))
    )
    value = hf.discriminating_kernel(
        GROWING, region, hf.grid(GROWING, {"v": (-1.2, 1.2)}, 101), 4.0
    )
    with pytest.raises(SimulationError, match=r"from what is 0\.15 s old, lose trial runs"):
        hf.SafetyFilter(GROWING, value, sample_time=HOLD, delay=3 * HOLD)
    keep = hf.SafetyFilter(GROWING, value, sample_time=HOLD, delay=delay)
    margin = {p.name: float(p.value) for p in keep.law.parameters}["safety_margin"]
    generator = np.random.default_rng(0)
    v = generator.uniform(-1, 1, (4000, 1))
    inside = np.array(keep.step_many(v, np.zeros((4000, 2))).value)
    keep.reset()
    v = v[(inside > margin) & (inside < margin + 0.05)][:150]
    assert len(v) == 150
    wanted = generator.choice([[4.0, 3.0], [4.0, -3.0]], 150)
    way, late, steps = [v], round(delay / HOLD), 10
    for _ in range(160):
        u = np.array(keep.step_many(way[max(len(way) - 1 - late, 0)], wanted).input)
        push = 0.8 * np.where(np.arange(150) % 2, np.sign(v[:, 0]), generator.choice([-1, 1], 150))
        for _ in range(steps):
            rate = lambda x: u[:, :1] * x + u[:, 1:] + push[:, None]  # noqa: B023, E731
            v = v + HOLD / steps * rate(v + HOLD / steps / 2 * rate(v))
        way.append(v)
        assert np.abs(v).max() < 1


def test_a_name_of_what_is_remembered_is_refused():
    span = hf.symbol("span_1")
    system = hf.System(
        "cart", (hf.Quantity("span_1", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
        {"span_1": hf.symbol("v"), "v": hf.symbol("u")}, input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    walls = hf.Region("walls", system.states, (hf.Inequality("walls", abs(span) - 1, "m"),))
    grid = hf.grid(system, {"span_1": (-1.2, 1.2), "v": (-2, 2)}, 21)
    value = hf.viability_kernel(system, walls, grid, 1.0)
    with pytest.raises(DefinitionError, match="'cart' has a 'span_1', as has what a filter remem"):
        hf.SafetyFilter(system, value, sample_time=0.1, delay=0.1)
