"""The kernel of two vehicles in a filter: it keeps what can be kept, and says what it does not."""

import importlib.util
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError

SPEED, DISTANCE, REACH, SAMPLE_TIME = 1.0, 0.5, 2.0, 0.05
x, y, a, b = (hf.symbol(n) for n in ("x", "y", "a", "b"))


def walker(speed, name="walker"):
    """A point that moves along both axes at up to a speed."""
    return hf.System(
        name, (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s")), {"x": a, "y": b},
        input_bounds=hf.Box((-speed, -speed), (speed, speed)),
    )  # fmt: skip


def kernel_of(ours, theirs, *, horizon=20.0, nodes=21, reach=REACH):
    both = hf.relative_system(ours, theirs)
    ahead, left = (q.symbol for q in both.states[:2])
    near = hf.Inequality("near", DISTANCE - sp.sqrt(ahead**2 + left**2), "m")
    box = dict.fromkeys(("x_r", "y_r"), (-reach, reach))
    grid = hf.grid(both, box, nodes, dict.fromkeys(box, "extrapolated"))
    region = hf.Region("apart", both.states[:2], (near,))
    return hf.discriminating_kernel(both, region, grid, horizon)


@cache
def pair():
    ours, theirs = walker(SPEED), walker(0.6, "other")
    return hf.PairKernel(ours, theirs, kernel_of(ours, theirs))


@cache
def guard():
    return hf.SafetyFilter(
        pair().ours, obstacles=hf.Obstacles(4, hull=0.2, pair=pair()), sample_time=SAMPLE_TIME
    )


def other(place, name="foe", radius=0.3, heading=0.0, more=()):
    return hf.Obstacle.vehicle(place, heading, radius, more, name=name)


def test_a_slower_point_is_kept_at_the_distance_from_everywhere():
    values, axes = pair().value.values(), pair().value.grid.axes
    ahead, left = np.meshgrid(*(axis.nodes for axis in axes), indexing="ij")
    assert np.abs(values - (np.hypot(ahead, left) - DISTANCE)).max() < axes[0].step
    assert pair().distance == pytest.approx(DISTANCE, abs=1e-9)


def test_a_walker_is_seen_in_the_axes_of_a_unicycle():
    robot, slow = hf.systems.unicycle(), walker(0.5, "other")
    slow = replace(slow, input_bounds=hf.Ball(0.5, 2))
    both = hf.PairKernel(robot, slow, kernel_of(robot, slow))
    cos, sin = np.cos(0.5), np.sin(0.5)
    seen = both.seen(np.array([1.0, 2.0, 0.5]), (2.0, 1.5, 0.0))
    assert seen == pytest.approx([cos - 0.5 * sin, -0.5 * cos - sin])


def test_a_faster_one_is_refused_with_both_speeds():
    ours = replace(walker(SPEED), input_bounds=hf.Ball(SPEED, 2))
    theirs = replace(walker(1.5, "other"), input_bounds=hf.Ball(1.5, 2))
    with pytest.raises(
        DefinitionError, match=r"'other' catches 'walker'.* it is faster, 1.5 m/s against 1 m/s"
    ):
        hf.PairKernel(ours, theirs, kernel_of(ours, theirs))


def test_a_kernel_that_still_shrinks_is_refused():
    ours, theirs = walker(SPEED), walker(1.1, "other")
    with pytest.raises(DefinitionError, match=r"still shrinks after 0\.05 s"):
        hf.PairKernel(ours, theirs, kernel_of(ours, theirs, horizon=0.05))


def test_an_admissible_command_passes_and_another_one_is_changed_least():
    away = guard().step([0, 0], [-0.5, 0.0], obstacles=[other((0.8, 0))])
    assert away.status is hf.Status.PASSED
    assert away.clearances["foe"] == pytest.approx(0.3)
    towards = guard().step([0, 0], [0.9, 0.0], obstacles=[other((0.56, 0))])
    assert towards.status is hf.Status.CHANGED
    assert towards.input[0] < 0
    assert "foe" in towards.why
    after = np.array([0.56, 0]) - SAMPLE_TIME * towards.input
    assert np.linalg.norm(after) - SAMPLE_TIME * 0.6 >= DISTANCE


def test_beyond_the_reach_nothing_is_asked():
    far = guard().step([0, 0], [1.0, 0.0], obstacles=[other((5.0, 0))])
    assert far.status is hf.Status.PASSED
    assert far.input == pytest.approx([1.0, 0.0])


def test_two_vehicles_are_both_asked_of_the_input():
    foes = [other((0.6, 0.25), "one"), other((0.6, -0.25), "two")]
    decision = guard().step([0, 0], [1.0, 0.0], obstacles=foes)
    assert decision.status is hf.Status.CHANGED
    for foe in foes:
        alone = guard().step([0, 0], decision.input, obstacles=[foe])
        assert alone.input == pytest.approx(decision.input, abs=1e-4)


def test_what_pinches_is_named():
    around = [
        other((0.51 * np.cos(t), 0.51 * np.sin(t)), f"foe {k}")
        for k, t in enumerate(2 * np.pi * np.arange(3) / 3)
    ]
    decision = guard().step([0, 0], [1.0, 0.0], obstacles=around)
    assert decision.status is hf.Status.INFEASIBLE
    assert set(decision.gave_way) <= {"foe 0", "foe 1", "foe 2"}
    assert decision.gave_way
    assert decision.why.startswith("pinched by")
    many = guard().step_many([[0, 0], [0, 0]], [[1.0, 0], [1.0, 0]], obstacles=[around, []])
    assert many.status == (hf.Status.INFEASIBLE, hf.Status.PASSED)


def test_a_rock_beside_a_vehicle_keeps_its_own_condition():
    rock = hf.Obstacle.disc((-0.55, 0), 0.3, name="rock")
    decision = guard().step([0, 0], [0.5, 0.0], obstacles=[rock, other((0.58, 0))])
    assert decision.input[0] > -0.6 * SPEED
    alone = guard().step([0, 0], [-1.0, 0.0], obstacles=[rock])
    assert alone.status is hf.Status.CHANGED


def test_a_vehicle_that_was_seen_earlier_is_a_disc_that_moves():
    old = other((0.9, 0)).aged(0.1)
    assert old.age == 0.1
    decision = guard().step([0, 0], [1.0, 0.0], obstacles=[old])
    disc = hf.Obstacle.disc((0.9, 0), 0.3, age=0.1)
    assert decision.input == pytest.approx(
        guard().step([0, 0], [1.0, 0.0], obstacles=[disc]).input, abs=1e-12
    )


def test_three_pursuers_at_a_time_are_kept_away_or_said_to_pinch():
    """Each heads for our point at its full speed, which would rather go to the middle of them."""
    state = np.zeros(2)
    foes = np.array([[1.2, 0.0], [0.9, 1.0], [1.0, -1.1]])
    least = np.inf
    for _ in range(120):
        obstacles = [other(tuple(place), f"foe {k}") for k, place in enumerate(foes)]
        decision = guard().step(state, [1.0, 0.0], obstacles=obstacles)
        assert decision.status is not hf.Status.INFEASIBLE
        state = state + SAMPLE_TIME * decision.input
        gap = state - foes
        foes = foes + 0.6 * SAMPLE_TIME * gap / np.linalg.norm(gap, axis=1, keepdims=True)
        least = min(least, np.linalg.norm(state - foes, axis=1).min())
    assert least >= DISTANCE


def test_a_simulation_and_a_loop_of_steps_are_the_same():
    place = np.array([0.9, 0.1])

    def command(t, states):
        return np.tile([1.0, 0.0], (len(states), 1))

    drive = guard().among(command, lambda t, states: [[other(tuple(place))]] * len(states))
    run = hf.simulate(
        pair().ours, guard().law, command=drive, starts=[[0.0, 0.0]], horizon=1.0,
        sample_time=SAMPLE_TIME, record_every=1.0,
    )  # fmt: skip
    state = np.zeros(2)
    for _ in range(20):
        decision = guard().step(state, [1.0, 0.0], obstacles=[other(tuple(place))])
        state = state + SAMPLE_TIME * decision.input
    ended = run.arrays["state"].values[0, -1]
    assert ended == pytest.approx(state, abs=1e-12)
    assert np.linalg.norm(state - place) >= DISTANCE
    assert drive.unkept.tolist() == [0]
    assert drive.least[0] >= 0


def test_bad_input_is_one_line():
    faulty = guard().step([0, 0], [1, 0], obstacles=[other((1, 0), heading=np.nan)])
    assert faulty.status is hf.Status.NOT_A_NUMBER
    assert "'foe'" in faulty.why
    with pytest.raises(SimulationError, match=r"vehicle 'foe' touch at 0\.6 m"):
        guard().step([0, 0], [1, 0], obstacles=[other((1, 0), radius=0.4)])
    with pytest.raises(SimulationError, match="has 1 further states; expected 0, as 'other'"):
        guard().step([0, 0], [1, 0], obstacles=[other((1, 0), more=(0.4,))])
    with pytest.raises(DefinitionError, match="looked up in Python alone"):
        guard().export_c()
    with pytest.raises(DefinitionError, match=r"pair is 3; expected an hf\.PairKernel"):
        hf.Obstacles(1, pair=3)
    with pytest.raises(DefinitionError, match="is one of 'walker', not of the vehicle 'slow'"):
        hf.SafetyFilter(walker(0.9, "slow"), obstacles=hf.Obstacles(1, pair=pair()))
    with pytest.raises(DefinitionError, match="kept beside an observer, limits of"):
        hf.SafetyFilter(pair().ours, obstacles=hf.Obstacles(1, pair=pair()), rates={"a": 1.0})
    with pytest.raises(SimulationError, match="belongs to system"):
        hf.PairKernel(pair().ours, hf.systems.unicycle(), pair().value)


def _benchmark():
    path = Path(__file__).parents[3] / "benchmarks" / "two_vehicles.py"
    spec = importlib.util.spec_from_file_location("two_vehicles", path)
    module = sys.modules["two_vehicles"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


STARTS, SECONDS, APART, NEAR = 100, 8.0, 1.0, 0.5
EACH = {  # by the kernel, by a barrier that is told the velocity, by one for any velocity
    "equal": (100, 61, 67),
    "slower": (100, 64, 72),
    "forward": (100, 92, 96),
    "agile": (100, 97, 100),
}


@pytest.mark.heavy
@pytest.mark.parametrize("name", EACH)
def test_what_a_kernel_and_what_barriers_keep_of_a_hundred_starts(name):
    """Near the edge of the kernel, for 8 s, against three kinds of opponents."""
    benchmark = _benchmark()
    case = benchmark.CASES[name]
    assert (case.distance, benchmark.NEAR, benchmark.SAMPLE_TIME) == (APART, NEAR, SAMPLE_TIME)
    results = benchmark.compared(case, STARTS, SECONDS)
    counts = [count for count, _ in results.values()]
    kernel, *barriers = EACH[name]
    assert counts[0] == kernel
    assert counts[1:] == pytest.approx(barriers, abs=3)
    assert results["kernel"][1] >= APART
