"""Faults of a measured signal: what is left out, what is kept, what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from holdfast.errors import SimulationError
from holdfast.interop.logs.read import repaired
from holdfast.interop.logs.table import Column

T = np.arange(600) * 0.1
NOISE = np.random.default_rng(4).normal(0, 0.01, len(T))


def read(time, value, *, unit="", factor=1.0, angle=False, measured=True):
    column = Column(np.asarray(time, float), np.asarray(value, float), unit)
    return repaired("q", column, factor, angle=angle, measured=measured)


def test_single_values_far_off_are_left_out_and_counted():
    value = np.sin(0.3 * T) + NOISE
    spoilt = value.copy()
    spoilt[[50, 52, 300, 511]] += [0.5, -0.7, 3.0, -1.0]
    signal, told = read(T, spoilt)
    assert told == ["q: 4 single values far off left out"]
    assert set(T) - set(signal.time) == set(T[[50, 52, 300, 511]])


def test_spikes_of_a_heading_that_wraps_leave_no_false_turn():
    heading = 0.5 * T + NOISE
    wrapped = np.angle(np.exp(1j * heading))
    spoilt = wrapped.copy()
    spoilt[[40, 200, 401]] += [3.2, -3.1, math.pi]
    signal, told = read(T, spoilt, angle=True)
    assert told == ["q: 3 single values far off left out"]
    kept = np.isin(T, signal.time)
    assert np.abs(signal.value - heading[kept] - round(wrapped[0] - heading[0])).max() < 1e-9


@pytest.mark.parametrize(
    "value",
    [
        np.where(T < 30, 0.0, 1.0),  # a step
        np.abs((T % 20) - 10),  # turning points without noise
        np.round(np.sin(0.1 * T) / 0.05) * 0.05,  # a coarse sensor
        np.round((np.sin(0.1 * T) + NOISE) / 0.05) * 0.05,  # with a last digit that flickers
        np.sin(3 * T),
        np.exp(-T),
    ],
    ids=["step", "triangle", "coarse", "flicker", "sine", "decay"],
)
def test_what_a_sound_signal_does_is_no_spike(value):
    signal, told = read(T, value)
    assert len(signal.time) == len(T)
    assert not [s for s in told if "far off" in s]


def test_values_of_a_slower_sensor_count_once():
    value = np.repeat(np.sin(0.3 * T[::10]), 10)
    signal, told = read(T, value)
    assert signal.time == pytest.approx(T[::10])
    assert told == ["q: every value stands 10 times, the first of each is kept"]
    held, told = read(T, value, measured=False)
    assert len(held.time) == 600
    assert told == []


def test_pulse_of_a_command_is_kept():
    command = np.zeros(len(T))
    command[100] = 50.0
    signal, told = read(T, command, measured=False)
    assert signal.value[100] == 50.0
    assert told == []


def test_spikes_at_every_tenth_value_are_too_many_and_kept():
    value = np.sin(0.3 * T) + NOISE
    value[5::10] += 5.0
    signal, told = read(T, value)
    assert len(signal.time) == len(T)
    assert told == ["q: 60 single values far off are too many to be faults; kept"]


def test_times_out_of_order_and_twice_are_sorted_and_counted():
    time = T.copy()
    time[[100, 101]] = time[[101, 100]]
    time[201] = time[200]
    signal, told = read(time, np.arange(600.0))
    assert told == [
        "q: time goes back 1 times, sorted",
        "q: 1 values at a time that another has left out",
    ]
    assert (np.diff(signal.time) > 0).all()
    assert signal.value[100] == 101.0


def test_newest_first_is_sorted():
    signal, _ = read(T[::-1], np.arange(600.0))
    assert signal.value[0] == 599.0


def test_clock_that_was_set_back_is_refused_as_two_motions_would_be_mixed():
    time = T - np.where(T > 40, 2.0, 0.0)
    with pytest.raises(SimulationError, match=r"goes back by 1.9 s after 40 s .* cut the log"):
        read(time, T)
    with pytest.raises(SimulationError, match="two logs are joined"):
        read(np.append(T, T), np.append(T, T))


def test_heading_that_jumps_by_360_is_refused_and_one_beyond_a_turn_is_questioned():
    with pytest.raises(SimulationError, match=r'in degrees; say so: "q \[deg\]"'):
        read(T, (10 * T) % 360, angle=True)
    _, told = read(T, 40 * np.sin(0.1 * T), angle=True)
    assert told == [
        "q reaches 40 without a jump by a turn and has no unit: taken as radians; "
        'if it is in degrees, say "q [deg]"'
    ]
    assert read(T, 40 * np.sin(0.1 * T), angle=True, unit="rad")[1] == []
    signal, told = read(T, (10 * T) % 360, angle=True, unit="deg", factor=math.pi / 180)
    assert told == []
    assert signal.value[-1] == pytest.approx(math.radians(10 * T[-1]))


def test_sensor_that_stands_still_is_said_and_kept():
    value = np.sin(0.3 * T) + NOISE
    value[200:300] = value[200]
    signal, told = read(T, value)
    assert told == ["q: does not change for 9.9 s from 20 s on; kept"]
    assert len(signal.time) == 600


def test_column_of_which_most_is_no_number_is_refused():
    half = np.where(np.arange(600) % 3 == 0, T, np.inf)
    with pytest.raises(SimulationError, match="most values of q are not finite"):
        read(T, half)
    text = Column(T, np.where(np.arange(600) % 3 == 0, T, np.nan), "", (), 400)
    with pytest.raises(SimulationError, match="most values of q are not finite"):
        repaired("q", text, 1.0, angle=False, measured=True)
    sparse = Column(T, np.where(np.arange(600) % 3 == 0, T, np.nan), "")  # a slower sensor
    assert len(repaired("q", sparse, 1.0, angle=False, measured=True)[0].time) == 200
    with pytest.raises(SimulationError, match="1 values of q"):
        read([0.0], [1.0])
    with pytest.raises(SimulationError, match="have one time"):
        read([3.0, 3.0, 3.0], [1.0, 2.0, 3.0])


ANY = st.floats(width=32)


@given(
    arrays.arrays(np.float64, st.shared(st.integers(0, 80), key="n"), elements=ANY),
    arrays.arrays(np.float64, st.shared(st.integers(0, 80), key="n"), elements=ANY),
    st.booleans(),
    st.booleans(),
)
def test_whatever_is_read_has_increasing_times_and_finite_values(time, value, angle, measured):
    try:
        signal, _ = read(time, value, angle=angle, measured=measured)
    except SimulationError:
        return
    assert (np.diff(signal.time) > 0).all()
    assert np.isfinite(signal.value).all()
    assert np.isin(signal.time, time).all()
    assert len(signal.time) == len(signal.value) >= 2
