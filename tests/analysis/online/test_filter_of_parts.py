"""A safety filter of a kernel that is put together from parts."""

from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError
from tests.parted_systems import box, late_cart, plane, walls

Status = hf.Status
SHARE = 0.6
SAMPLE = 0.01


@cache
def kernel():
    parted = hf.decompose(late_cart(), walls("x"), lag_share=SHARE, box=box("x", "v", at=1.5))
    return hf.solve_parts(parted, None, 121, 4.0)


def starts(count, margin):
    low, high = np.array([(-1, -2, -SHARE), (1, 2, SHARE)])
    drawn = np.random.default_rng(1).uniform(low, high, (60 * count, 3))
    return drawn[kernel().contains(drawn, margin)][:count]


def made(value=None, **options):
    return hf.SafetyFilter(late_cart(), value or kernel(), sample_time=SAMPLE, **options)


def runs(command, law):
    options = {"starts": starts(300, 0.1), "region": walls("x"), "horizon": 4.0}
    return hf.simulate(late_cart(), law, sample_time=SAMPLE, command=command, **options)


@pytest.mark.parametrize("push", [1.0, -1.0, np.nan], ids=["right", "left", "random"])
def test_a_vehicle_that_lags_is_kept_whatever_it_is_commanded(push):
    rng = np.random.default_rng(2)

    def command(t, q):
        return rng.uniform(-1, 1, (len(q), 1)) if np.isnan(push) else np.full((len(q), 1), push)

    kept = runs(command, made().law)
    assert len(kept.arrays["outcome"].values) == 300
    assert (kept.arrays["outcome"].values == 0).all()
    if not np.isnan(push):
        alone = runs(command, hf.commanded(late_cart()))
        assert not (alone.arrays["outcome"].values == 0).any()


def test_steps_are_those_of_the_law_and_the_value_is_that_of_the_kernel():
    keep, many = made(), starts(40, 0.0)
    commands = np.linspace(-1, 1, 40)[:, np.newaxis]
    answers = keep.step_many(many, commands)
    assert np.array_equal(answers.value, kernel().at(many))
    for k in range(0, 40, 7):
        one = keep.step(many[k], commands[k])
        assert one.input.tobytes() == answers.input[k].tobytes()
        assert (one.value, one.status) == (answers.value[k], answers.status[k])
    calm = keep.step([0.0, 0.0, 0.0], [0.05])
    assert calm.status is Status.PASSED
    assert calm.input == 0.05
    near = keep.step([0.5, 0.4, 0.1], [0.9])
    assert near.status is Status.CHANGED
    assert "the value of the viability-kernel is" in near.why


def test_where_the_parts_promise_nothing_the_status_says_so():
    keep = made()
    thrust = keep.step([0.0, 0.0, 0.8], [0.0])
    assert thrust.status is Status.OUTSIDE_GRID
    assert thrust.value < 0
    assert "where actual_u is in [-0.6, 0.6]" in thrust.why
    assert "promise" in thrust.why
    states = [[0.0, 0.0, 0.8], [0.0, 0.0, 0.0], [0.0, 9.0, 0.0], [np.nan, 0.0, 0.0]]
    found = keep.step_many(states, np.zeros((4, 1))).status
    assert found == (
        Status.OUTSIDE_GRID, Status.PASSED, Status.OUTSIDE_GRID, Status.NOT_A_NUMBER
    )  # fmt: skip
    assert "v = 9 is outside" in keep.step(states[2], [0.0]).why


def test_a_kernel_of_a_file_has_the_same_bits(tmp_path):
    again = hf.load(kernel().save(tmp_path / "parts.nc"), lazy=True)
    keep, stored = made(), made(again)
    for state in starts(20, 0.0):
        one, other = keep.step(state, [1.0]), stored.step(state, [1.0])
        assert one.input.tobytes() == other.input.tobytes()
        assert (one.value, one.status) == (other.value, other.status)


def test_scales_of_inputs_are_those_of_the_whole_system():
    assert made(scales={"u": 0.5}).step([0.0, 0.0, 0.0], [0.1]).input == 0.1
    with pytest.raises(DefinitionError, match="scale of 'w', which is not an input"):
        made(scales={"w": 0.5})


def test_what_the_parts_do_not_promise_is_refused():
    with pytest.raises(SimulationError, match="belongs to another system 'cart"):
        hf.SafetyFilter(late_cart(0.3), kernel())
    with pytest.raises(DefinitionError, match="kept beside something else; expected it alone"):
        made([kernel(), walls("x")])
    with pytest.raises(DefinitionError, match="where not all states are measured"):
        made(states=["x", "v"])
    several = hf.solve_parts(
        hf.decompose(plane(), walls("x", "y")), box("x", "vx", "y", "vy"), 15, 0.5
    )
    with pytest.raises(SimulationError, match="one law for 2 parts"):
        hf.SafetyFilter(plane(), several)
