"""A car that cannot stop, between the sides of a lane: the kernel against the tightest turn away.

At a heading psi > 0 to the left side nothing keeps the car longer than to steer to the right at
once, at the least speed: its turns are the same arcs, and the steering gear gains time.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import holdfast as hf

WHEELBASE, SLOWEST, STEERING, STOP, HALF = 0.5, 0.5, 2.0, math.radians(35), 1.0
POSES = [(psi, delta) for psi in (0.2, 0.5, 0.8, 1.1, 1.4) for delta in (-0.4, 0.0, 0.4)]


def on_a_lane():
    car = hf.systems.car(
        wheelbase=WHEELBASE, speed_limit=1.0, speed_least=SLOWEST, steering_rate_limit=STEERING
    )
    system = hf.subsystem(car, ("y", "psi", "delta"))
    y, delta = hf.symbol("y"), hf.symbol("delta")
    rows = {
        "left": y - HALF,
        "right": -HALF - y,
        "stop_left": delta - STOP,
        "stop_right": -STOP - delta,
    }
    region = hf.Region(
        "lane", system.states,
        tuple(hf.Inequality(n, c, "rad" if "stop" in n else "m") for n, c in rows.items()),
    )  # fmt: skip
    return system, region


def kernel(nodes, **options):
    system, region = on_a_lane()
    box = {"y": (-1.2, 1.2), "psi": (-math.pi, math.pi), "delta": (-0.75, 0.75)}
    counts = {"y": nodes, "psi": 2 * nodes - 14, "delta": nodes - 6}
    grid = hf.grid(system, box, counts, {"delta": "contained"})
    return hf.viability_kernel(system, region, grid, 6.0, **options)


def sideways(psi, delta):
    """How far the car gets to the left before it is along the lane, steering right at once."""

    def rates(t, q):
        turn = SLOWEST * math.tan(q[2]) / WHEELBASE
        return [SLOWEST * math.sin(q[1]), turn, -STEERING if q[2] > -STOP else 0.0]

    def along(t, q):
        return q[1]

    along.terminal, along.direction = True, -1
    path = solve_ivp(rates, (0, 20), [0, psi, delta], events=along, max_step=0.01, rtol=1e-8)
    return path.y[0].max()


def error(value):
    line = np.linspace(-1.1, 1.1, 2201)
    found = []
    for pose in POSES:
        inside = value.contains(np.column_stack([line, np.tile(pose, (len(line), 1))]))
        found.append(line[inside].max())
    return np.array(found) - [HALF - sideways(*pose) for pose in POSES]


@pytest.mark.heavy
def test_car_that_cannot_stop_is_kept_on_its_lane_from_the_poses_of_its_tightest_turn():
    """Cells of 8 cm, 7.5 and 3.6 deg: nowhere too wide, at most 11 cm too narrow."""
    wrong = error(kernel(31))
    assert wrong.max() < 0.001
    assert wrong.min() > -0.11


@pytest.mark.heavy
def test_error_of_the_lane_falls_with_the_grid():
    coarse, fine = (np.abs(error(kernel(n))).max() for n in (31, 61))
    assert fine < 0.6 * coarse


def test_tightest_turn_is_the_arc_of_the_largest_steering_angle():
    """From the stop of the steering gear: R (1 - cos psi), R = wheelbase / tan(delta)."""
    radius = WHEELBASE / math.tan(STOP)
    assert sideways(1.0, -STOP) == pytest.approx(radius * (1 - math.cos(1.0)), abs=1e-6)


def kept_on_the_lane(value):
    """Of 60 starts inside and 60 outside: the car drives at full speed to the left, but for the
    filter of the kernel."""
    system, region = on_a_lane()
    law = hf.Law("to the left", system.states, {"v": 1.0, "w": 2.0})
    found = hf.check_promise(
        system, value, region, law=law, runs=60, horizon=6.0, sample_time=0.01
    )  # fmt: skip
    return found.inside[0].kept.count, found.outside.kept.count


@pytest.mark.heavy
def test_law_is_kept_on_the_lane_by_a_kernel_that_errs_inwards():
    assert kept_on_the_lane(kernel(31, scheme="upwind")) == (60, 0)


@pytest.mark.heavy
@pytest.mark.parametrize("nodes", [31, pytest.param(61, marks=pytest.mark.heavy)])
def test_kernel_of_high_order_keeps_the_law_on_the_lane(nodes):
    assert kept_on_the_lane(kernel(nodes)) == (60, 0)
