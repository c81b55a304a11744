"""A filter between streams: late, lost and wrong messages, and what is said of them."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import holdfast as hf
from holdfast.errors import SimulationError
from tests.decisions import camera_filter, drive, pd


def test_relay_with_fresh_messages_gives_the_decisions_of_the_filter():
    vehicle, keep = camera_filter()
    start = [-1.3, 0.75, -0.35, 0, 0, 0]
    records = drive(hf.Relay(keep), hf.Plant(vehicle, start), 4)
    keep.reset()
    boat = hf.Plant(vehicle, start)
    for record in records:
        decision = keep.step(boat.state, pd(boat.state))
        assert list(record.input.values()) == decision.input.tolist()
        assert record.status == decision.status.value
        assert record.value == decision.value
        boat.step(decision.input)
    assert {r.status for r in records} == {"passed", "changed"}
    assert not any(r.lost for r in records)


@pytest.mark.heavy
def test_vehicle_stays_in_view_where_the_commands_cease():
    """From 16 starts that the filter keeps; the last command goes on for the patience at most."""
    vehicle, keep = camera_filter()
    view = hf.Boundary(vehicle, hf.regions.camera_view())
    relay = hf.Relay(keep)
    generator = np.random.default_rng(3)
    for _ in range(16):
        x, y, psi = generator.uniform([-2, -0.8, -0.8], [-0.6, 0.8, 0.8])
        if view.worst([[x, y, psi, 0, 0, 0]])[0] > 0:
            continue
        relay.reset()
        records = drive(relay, hf.Plant(vehicle, [x, y, psi, 0, 0, 0]), 8, command_until=1.5)
        lost = [r for r in records if r.lost]
        assert {r.lost for r in lost} == {"command"}
        assert len(lost) == pytest.approx((8 - 1.5 - relay.patience) / 0.02, abs=2)
        assert "no command for 0.2" in lost[0].why
        states = [list(r.state.values()) for r in records]
        assert view.worst(states).max() <= 1e-3


def test_lost_measurements_give_the_fallback_and_say_so():
    vehicle, keep = camera_filter(fallback=[-1.0, 0.0])
    records = drive(hf.Relay(keep), hf.Plant(vehicle, [-1.3, 0.2, 0, 0, 0, 0]), 2, measure_until=1)
    lost = [r for r in records if r.lost == "measurement"]
    assert 0.7 < len(lost) * 0.02 < 0.8
    for record in lost:
        assert record.status == "no measurement"
        assert record.intervened
        assert record.input == {"tau_u": -1.0, "tau_r": 0.0}
        assert all(math.isnan(v) for v in record.state.values())
    sentences = [r.why for r in lost if r.why]
    assert len(sentences) == 3  # at once, and every quarter of a second
    assert sentences[0].startswith("no measurement for 0.2")


def test_before_the_first_message_nothing_is_promised():
    _, keep = camera_filter()
    relay = hf.Relay(keep)
    first = relay.decide(5.0)
    assert (first.status, first.why) == (
        "no measurement",
        "no measurement yet: the input is the fallback",
    )
    relay.measured([-1.3, 0.2, 0, 0, 0, 0], 5.1)
    second = relay.decide(5.1)
    assert (second.status, second.lost) == ("passed", "command")


def test_measurement_that_is_not_finite_is_a_status_and_others_are_refused():
    _, keep = camera_filter()
    relay = hf.Relay(keep)
    relay.commanded({"tau_u": 1.0, "tau_r": 0.0}, 0.0)
    relay.measured([math.nan, 0, 0, 0, 0, 0], 0.0)
    found = relay.decide(0.0)
    assert found.status == "not a number"
    assert "x is nan" in found.why
    assert relay.decide(0.3).status == "no measurement"
    with pytest.raises(SimulationError, match="unknown command 'push'"):
        relay.commanded({"push": 1.0}, 0.0)
    with pytest.raises(SimulationError, match="6 numbers"):
        relay.measured([0.0], 0.0)
    for patience in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(SimulationError, match="patience"):
            hf.Relay(keep, patience=patience)


def test_measured_disturbance_is_needed_and_reaches_the_filter():
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),),
        {"x": hf.symbol("u") + hf.symbol("d")}, disturbances=(hf.Quantity("d", "m/s"),),
        input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-0.5,), (0.5,)),
    )  # fmt: skip
    end = hf.Region("end", cart.states, (hf.Inequality("end", hf.symbol("x") - 1),))
    relay = hf.Relay(hf.SafetyFilter(cart, end, disturbance_measured=True))
    with pytest.raises(SimulationError, match="disturbance"):
        relay.measured([0.9], 0.0)
    found = []
    for pushed in (-0.2, 0.2):
        relay.measured([0.9], 0.0, disturbance=[pushed])
        relay.commanded([1.0], 0.0)
        found.append(relay.decide(0.0).input["u"])
    assert found[0] == pytest.approx(found[1] + 0.4)


def test_record_returns_from_its_line():
    vehicle, keep = camera_filter()
    records = drive(
        hf.Relay(keep), hf.Plant(vehicle, [-1.3, 0.75, -0.35, 0, 0, 0]), 2, measure_until=1
    )
    for record in records:
        line = record.line()
        assert "\n" not in line
        assert "NaN" not in line
        again = hf.DecisionRecord.read(line)
        assert again.line() == line
        assert again.intervened == record.intervened
        assert again.input == record.input


@pytest.mark.parametrize(
    "line",
    ["", "{}", json.dumps({"t": 10**400}), "[]", "nothing", "null", b"\xff\xfe", "[" * 5000]
    + [json.dumps({"t": 0, "status": s}) for s in ("passed", "unheard of")],
)  # fmt: skip
def test_line_that_is_no_record_is_refused(line):
    with pytest.raises(SimulationError, match="is no decision"):
        hf.DecisionRecord.read(line)


def test_estimate_is_not_taken_over_a_gap_in_the_measurements():
    """A cart seen by its place alone: after 1.2 s without it the filter decides as at its start."""
    x, v, u = (hf.symbol(n) for n in "xvu")
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
        {"x": v, "v": u}, input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    end = hf.Region("end", cart.states, (hf.Inequality("end", x - 1),))
    made = [hf.SafetyFilter(cart, end, states=("x",), bandwidth=5.0) for _ in range(2)]
    relay, fresh = hf.Relay(made[0]), hf.Relay(made[1])
    for k in range(50):
        relay.measured([-3 + 0.3 * k * 0.02], k * 0.02)
        relay.commanded([0.0], k * 0.02)
        relay.decide(k * 0.02)
    for k in range(50, 110):
        last = relay.decide(k * 0.02)
    assert last.status == "no measurement"
    for k in range(110, 200):
        for one in (relay, fresh):
            one.measured([-3 + 0.3 * k * 0.02], k * 0.02)
            one.commanded([0.5], k * 0.02)
        assert relay.decide(k * 0.02).input == fresh.decide(k * 0.02).input


def test_clock_that_goes_back_begins_anew():
    """What was received before counts no more: its age is not known."""
    _, keep = camera_filter()
    relay = hf.Relay(keep)
    relay.measured([-1.3, 0.2, 0, 0, 0, 0], 10.0)
    relay.commanded([0.0, 0.0], 10.0)
    assert relay.decide(10.0).status == "passed"
    assert relay.decide(9.0).status == "no measurement"
    relay.measured([-1.3, 0.2, 0, 0, 0, 0], 9.1)
    assert relay.decide(9.1).lost == "command"


@pytest.fixture(scope="module")
def far_away():
    """A filter that changes no command, so that its input says which command it was given."""
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": hf.symbol("u")},
        input_bounds=hf.Box((-1e6,), (1e6,)),
    )  # fmt: skip
    end = hf.Region("end", cart.states, (hf.Inequality("end", hf.symbol("x") - 1e9),))
    return hf.SafetyFilter(cart, end, fallback=[-1.0])


PATIENCE = 0.25


def newest(items, now):
    """The last item with the latest time, of those that came, and that time."""
    at, item = max(items, key=lambda one: one[0], default=(-math.inf, None))
    return (at, item) if now - at <= PATIENCE else (-math.inf, None)


def judged(relay, now, measured, commanded):
    """The decision at a time is that on the newest of what came, and what is lost is lost."""
    record = relay.decide(now)
    (_, state), (_, command) = newest(measured, now), newest(commanded, now)
    if state is None:
        assert (record.lost, record.status) == ("measurement", "no measurement")
    elif command is None:
        assert (record.lost, record.state) == ("command", {"x": state})
    else:
        assert (record.lost, record.state, record.input) == ("", {"x": state}, {"u": command})
    return record


MESSAGES = st.lists(
    st.tuples(
        st.booleans(),  # a command, or a measurement
        st.integers(0, 60),  # the hundredth of a second of its time
        st.integers(0, 40),  # how many later it comes
    ),
    max_size=40,
)


@settings(max_examples=150)
@given(MESSAGES, st.integers(1, 4))
def test_what_is_live_is_never_lost_whatever_its_age_and_order(far_away, messages, every):
    """Measurements and commands of any age, in any order, between samples of any rate."""
    relay = hf.Relay(far_away, patience=PATIENCE)
    queue = sorted(enumerate(messages), key=lambda one: one[1][1] + one[1][2])
    come = ([], [])
    for tick in range(0, 110, every):
        while queue and sum(queue[0][1][1:]) <= tick:
            number, (is_command, at, _) = queue.pop(0)
            give = relay.commanded if is_command else relay.measured
            give([float(number)], at / 100)
            come[is_command].insert(0, (at / 100, float(number)))
        judged(relay, tick / 100, *come)


@settings(max_examples=60)
@given(
    st.integers(0, 24),  # hundredths of a second that measurements are old
    st.integers(0, 24),  # and commands
    st.integers(100, 10_000),  # hundredths that the clock is set back by
    st.booleans(),  # whether the commands go on
)
def test_clock_that_is_set_back_by_seconds_is_noticed_and_what_follows_counts(
    far_away, measured_age, commanded_age, back, go_on
):
    relay, shift = hf.Relay(far_away, patience=PATIENCE), 0
    for tick in range(200, 320, 2):
        if tick == 260:
            shift = back
        if tick >= 200 + measured_age and not 260 <= tick < 260 + measured_age:
            relay.measured([float(tick)], (tick - shift - measured_age) / 100)
        if tick >= 200 + commanded_age and (tick < 260 or (go_on and tick >= 260 + commanded_age)):
            relay.commanded([float(tick)], (tick - shift - commanded_age) / 100)
        record = relay.decide((tick - shift) / 100)
        if tick < 200 + max(measured_age, commanded_age):
            continue
        if tick < 260:
            assert (record.lost, record.input) == ("", {"u": float(tick)})
        elif tick < 260 + measured_age:
            assert record.lost == "measurement"
            assert tick > 260 or "since the clock was set back by" in record.why
        elif not go_on or tick < 260 + commanded_age:  # that of before is not taken for a new one
            assert (record.lost, record.state) == ("command", {"x": float(tick)})
        else:
            assert (record.lost, record.input) == ("", {"u": float(tick)})


def test_measurement_that_is_always_older_than_the_last_command_loses_no_command():
    """5 ms old, at 50 Hz."""
    vehicle, keep = camera_filter()
    relay, boat = hf.Relay(keep), hf.Plant(vehicle, [-1.3, 0.75, -0.35, 0, 0, 0])
    for k in range(400):
        now = 10.0 + 0.02 * k
        relay.commanded(pd(boat.state), now)
        relay.measured(boat.state, now - 0.005)
        record = relay.decide(now)
        assert record.lost == ""
        boat.step(record.input)


def test_times_that_the_clock_has_not_reached_count_as_those_of_the_next_decision(far_away):
    """A sensor whose clock is an hour ahead is lost after the patience, not after an hour."""
    relay = hf.Relay(far_away, patience=PATIENCE)
    for k in range(10):
        now = 0.02 * k
        relay.measured([1.0], now + 3600.0)
        relay.commanded([2.0], now)
        assert relay.decide(now).lost == ""
    relay.commanded([2.0], 0.4)
    assert relay.decide(0.42).lost == ""
    assert relay.decide(0.44).lost == "measurement"
    relay.measured([3.0], 0.45)
    assert relay.decide(0.46).state == {"x": 3.0}
