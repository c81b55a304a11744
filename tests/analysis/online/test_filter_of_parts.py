"""A safety filter of a kernel that is put together from parts."""

import dataclasses
from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError
from tests.parted_systems import box, late_cart, plane, walls

pytestmark = pytest.mark.filterwarnings(  # the walls bound no speed: sets go on beyond any box
    "ignore:of the discriminating-.*which the filter keeps:holdfast.errors.PromiseFellShortWarning"
)

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
    options = {"sample_time": SAMPLE, **options}
    return hf.SafetyFilter(late_cart(), value or kernel(), **options)


@cache
def one_way(times=None):
    """The kernel of the walls along x, in which uy has no part."""
    more = {} if times is None else {"times": list(times)}
    parted = hf.decompose(plane(), walls("x"))
    return hf.solve_parts(parted, box("x", "vx"), 21, 0.5, **more)


def runs(command, law):
    options = {"starts": starts(300, 0.1), "region": walls("x"), "horizon": 4.0}
    return hf.simulate(late_cart(), law, sample_time=SAMPLE, command=command, **options)


@pytest.mark.heavy
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
    near = keep.step([0.7, 0.4, 0.1], [0.7])
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
    assert "predicted v = 9 is outside" in keep.step(states[2], [0.0]).why


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
    with pytest.raises(DefinitionError, match="the rate of 'u' is limited"):
        made(rates={"u": 1.0})
    with pytest.raises(SimulationError, match="would leave its share in inputs held"):
        made(sample_time=0.3, rate=1.0)
    several = hf.solve_parts(
        hf.decompose(plane(), walls("x", "y")), box("x", "vx", "y", "vy"), 15, 0.5
    )
    with pytest.raises(SimulationError, match="one law for 2 parts"):
        hf.SafetyFilter(plane(), several)


@pytest.mark.heavy
def test_every_input_stays_within_its_bounds_wherever_the_vehicle_is():
    keep = hf.SafetyFilter(plane(), one_way(), sample_time=SAMPLE)
    answers = keep.step_many(np.zeros((2, 4)), [[0.2, 5.0], [0.0, -5.0]])
    assert answers.input.tolist() == [[0.2, 1.0], [0.0, -1.0]]
    assert answers.status == (Status.CHANGED, Status.CHANGED)
    drawn = np.random.default_rng(3).uniform([-2, -3, -9], [2, 3, 9], (300, 3))
    found = made().step_many(drawn, np.tile([[3.0], [-3.0]], (150, 1)))
    assert np.abs(found.input).max() <= 1 + 1e-12


@pytest.mark.heavy
def test_an_actuator_of_a_state_that_is_left_out_is_kept_in_its_share():
    th, turn = hf.Quantity("th", "rad", angle=True), hf.symbol("turn")
    cart = hf.System(
        "carousel", (*late_cart().states[:2], th), (hf.Quantity("u"), hf.Quantity("turn")),
        {"x": hf.symbol("v"), "v": hf.symbol("u"), "th": turn},
        input_bounds=hf.Box((-1, -1), (1, 1)),
    )  # fmt: skip
    late = hf.lagged(cart, {"u": 0.2, "turn": 0.2})
    over = {**box("x", "v", at=1.5), "th": (-np.pi, np.pi)}
    parted = hf.decompose(late, walls("x"), lag_share=SHARE, box=over)
    assert parted.parts[0].system.state_names == ("x", "v")
    keep = hf.SafetyFilter(late, hf.solve_parts(parted, None, 31, 0.5), sample_time=SAMPLE)
    for thrust in (0.0, SHARE):
        (_, turned) = keep.step([0.0, 0.0, 0.0, 0.0, thrust], [0.0, 9.0]).input
        assert thrust + (turned - thrust) * (1 - np.exp(-SAMPLE / 0.2)) <= SHARE + 1e-12
        assert SHARE <= turned + 1e-12 <= 1 + 2e-12


def test_a_thrust_that_rests_at_an_end_of_its_share_is_within_it():
    end = np.nextafter(SHARE, 1.0)
    assert made().step([0.0, 0.0, end], [0.0]).status is not Status.OUTSIDE_GRID
    assert kernel().contains([[0.0, 0.0, end]]).all()
    assert made().step([0.0, 0.0, SHARE + 1e-6], [0.0]).status is Status.OUTSIDE_GRID


def test_a_system_whose_inputs_come_in_another_order_is_another_one():
    other = dataclasses.replace(plane(), inputs=plane().inputs[::-1])
    with pytest.raises(SimulationError, match="belongs to another system"):
        hf.SafetyFilter(other, one_way(), sample_time=SAMPLE)


def test_the_value_of_a_kernel_that_runs_out_is_that_of_the_remaining_time():
    value = one_way((0.0, 0.25, 0.5))
    keep, state = hf.SafetyFilter(plane(), value, sample_time=SAMPLE), [0.8, 0.9, 0.0, 0.0]
    for t, left in ((0.0, 0.5), (0.25, 0.25), (0.5, 0.0)):
        (known,) = value.at([state], left)
        assert keep.step(state, [0.5, 0.0], t).value == pytest.approx(known, abs=1e-12)
        assert keep.step_many([state], [[0.5, 0.0]], t).value == pytest.approx(known, abs=1e-12)


def test_a_command_that_takes_an_actuator_out_of_its_share_is_said_to_be_one():
    near = made().step([0.0, 0.0, 0.5], [0.9])
    assert near.input[0] < 0.9
    assert "an actuator would leave its share with it" in near.why


@pytest.mark.heavy
def test_a_limit_of_an_acceleration_is_named():
    keep = hf.SafetyFilter(plane(), one_way(), sample_time=SAMPLE, rates={"vx": 0.5})
    assert "the rate of vx would be beyond its limit" in keep.step(np.zeros(4), [1.0, 0.0]).why
