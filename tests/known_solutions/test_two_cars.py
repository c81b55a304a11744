"""Games of two vehicles that are known in closed form.

The barrier of the game of two identical cars (A. W. Merz, 1972), and whom a faster car catches
(R. Isaacs, Differential games, 1965, the homicidal chauffeur).

Of two cars with one speed and one largest rate of turn, one keeps away from the other. The last part
of a play on the barrier ends where the distance is smallest: the other car is at the bearing psi / 2
then, and both have turned at their largest rates, ours away from it and the other one towards ours.
Backwards in time both go along circles, which gives the states of the barrier.
"""

from functools import cache

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError

DISTANCE, REACH, CELL = 1.0, 4.0, 0.2


@cache
def _kernel():
    unicycle = hf.systems.unicycle()
    psi = hf.symbol("psi")
    car = hf.System(
        "car", unicycle.states, unicycle.inputs[1:],
        {"x": sp.cos(psi), "y": sp.sin(psi), "psi": hf.symbol("r")},
        input_bounds=hf.Box((-1,), (1,)), empirical="its speed is 1 m/s",
    )  # fmt: skip
    both = hf.relative_system(car, car)
    ahead, left = (q.symbol for q in both.states[:2])
    near = hf.Inequality("near", DISTANCE - sp.sqrt(ahead**2 + left**2), "m")
    box = dict.fromkeys(("x_r", "y_r"), (-REACH, REACH))
    nodes = hf.grid(both, {**box, "psi_r": (-np.pi, np.pi)}, 41, dict.fromkeys(box, "extrapolated"))
    return hf.discriminating_kernel(both, hf.Region("apart", both.states[:2], (near,)), nodes, 20.0)


def _earlier(x, y, heading, turn, time):
    """A pose of a car of 1 m/s that turns at 1 rad/s, some time before."""
    before = heading - turn * time
    return (
        x - (np.sin(heading) - np.sin(before)) / turn,
        y + (np.cos(heading) - np.cos(before)) / turn,
        before,
    )


def _barrier():
    """States of the barrier; beyond half a turn of the heading its two sides do not meet soon."""
    psi, time = np.meshgrid(np.linspace(np.pi, 2 * np.pi - 0.2, 12), np.linspace(0.1, 1.0, 10))
    psi, time = psi.ravel(), time.ravel()
    ours = _earlier(0.0, 0.0, 0.0 * psi, -1.0, time)
    bearing = psi / 2
    theirs = _earlier(DISTANCE * np.cos(bearing), DISTANCE * np.sin(bearing), psi, 1.0, time)
    dx, dy = theirs[0] - ours[0], theirs[1] - ours[1]
    cos, sin = np.cos(ours[2]), np.sin(ours[2])
    turn = (theirs[2] - ours[2] + np.pi) % (2 * np.pi) - np.pi
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)


@pytest.mark.heavy
def test_the_kernel_ends_at_the_barrier_of_two_identical_cars():
    kernel, states = _kernel(), _barrier()
    assert kernel.report.converged
    assert len(states) == 120
    assert np.abs(kernel.at(states)).max() < 0.15 * CELL
    distance = np.hypot(states[:, 0], states[:, 1])
    assert distance.max() > 2.0  # the barrier goes far beyond the distance itself
    for side in (1, -1):
        moved = states.copy()
        moved[:, :2] *= (1 + side * 0.5 * CELL / distance)[:, np.newaxis]
        outside = np.hypot(moved[:, 0], moved[:, 1]) > DISTANCE + 0.1 * CELL
        assert outside.any()
        assert ((kernel.at(moved) > 0) == (side > 0))[outside].all()


@pytest.mark.heavy
def test_what_is_kept_is_the_same_on_the_left_and_on_the_right():
    values = _kernel().values()
    there = np.roll(values[:, ::-1, ::-1], 1, axis=2)  # y to -y and psi to -psi
    assert np.abs(values - there).max() < 1e-9


def _chauffeur(distance, reach, nodes, horizon):
    """A person of 1 m/s, a car of 1.25 m/s that turns at 1 rad/s, and the kernel of a distance."""
    unicycle = hf.systems.unicycle()
    psi, a, b = (hf.symbol(n) for n in ("psi", "a", "b"))
    car = hf.System(
        "car", unicycle.states, unicycle.inputs[1:],
        {"x": 1.25 * sp.cos(psi), "y": 1.25 * sp.sin(psi), "psi": hf.symbol("r")},
        input_bounds=hf.Box((-1,), (1,)), empirical="its speed is 1.25 m/s",
    )  # fmt: skip
    person = hf.System(
        "person", unicycle.states[:2], (hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s")),
        {"x": a, "y": b}, input_bounds=hf.Ball(1.0, 2),
    )  # fmt: skip
    both = hf.relative_system(person, car)
    near = hf.Inequality("near", f"{distance} - sqrt(x_r**2 + y_r**2)", "m")
    box = dict.fromkeys(("x_r", "y_r"), (-reach, reach))
    grid = hf.grid(
        both, {**box, "psi_r": (-np.pi, np.pi)}, {**dict.fromkeys(box, nodes), "psi_r": 24},
        dict.fromkeys(box, "extrapolated"),
    )  # fmt: skip
    region = hf.Region("apart", both.states[:2], (near,))
    return person, car, hf.discriminating_kernel(both, region, grid, horizon)


@pytest.mark.heavy
def test_a_faster_car_that_turns_wide_is_evaded_where_isaacs_says_so():
    ratio, turn = 1 / 1.25, 1.25
    limit = turn * (np.sqrt(1 - ratio**2) + ratio * np.arcsin(ratio) - 1)
    assert limit == pytest.approx(0.43, abs=0.005)
    kernel = hf.PairKernel(*_chauffeur(0.2, 2.4, 41, 60.0))
    assert kernel.distance == pytest.approx(0.2, abs=1e-9)
    with pytest.raises(
        DefinitionError, match=r"'car' catches 'person' .* faster, 1\.25 m/s against 1 m/s"
    ):
        hf.PairKernel(*_chauffeur(0.7, 3.0, 31, 15.0))
