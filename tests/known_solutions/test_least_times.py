"""The law of a capture basin arrives when its least times say."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.safety.safety_filter import worst_disturbance
from tests.c_code import built, needs_gcc, pointer

X, Y, HEADING, TURN, SPEED = (hf.symbol(n) for n in ("x", "y", "heading", "turn", "v"))
PLANE = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
STATES = (*PLANE, hf.Quantity("heading", "rad", angle=True))
RADIUS = 0.4


def goal(states):
    return hf.Region("goal", states, (hf.Inequality("near", sp.sqrt(X**2 + Y**2) - RADIUS, "m"),))


def dubins(**current):
    """A car of 1 m/s that turns at up to 1 rad/s, in a current if there is one."""
    drift = [hf.symbol(q.name) for q in current.get("disturbances", ())] or [0, 0]
    return hf.System(
        "car", STATES, (hf.Quantity("turn", "rad/s"),),
        {"x": sp.cos(HEADING) + drift[0], "y": sp.sin(HEADING) + drift[1], "heading": TURN},
        input_bounds=hf.Box((-1,), (1,)), **current,
    )  # fmt: skip


def in_a_field(system, counts=(61, 61, 48)):
    box = {"x": (-4, 4), "y": (-4, 4), "heading": (-np.pi, np.pi)}
    return hf.grid(system, box, dict(zip(system.state_names, counts, strict=True)))


def starts_of(basin, low, high, count):
    states = np.random.default_rng(1).uniform(low, high, (2 * count, len(low)))
    return states[np.isfinite(basin.least_time(states))][:count]


def arrivals(system, law, starts, horizon=12.0):
    """When each run first is in the goal, inf for never; at samples of 20 ms."""
    result = hf.simulate(
        system, law, starts=starts, goal=goal(system.states), horizon=horizon, record_every=0.02
    )
    place = result.dataset["state"].values
    inside = np.hypot(place[:, :, 0], place[:, :, 1]) <= RADIUS + 1e-9
    times = result.dataset["time"].values
    return np.where(inside.any(axis=1), times[inside.argmax(axis=1)], np.inf)


def shortest_path(starts, radius=RADIUS):
    """The length of the shortest path of a car with circles of 1 m to the disc around 0, of those
    that turn one way for less than a circle and then go straight: the least time at 1 m/s where the
    disc is not in both circles (L. E. Dubins 1957, with a free heading at the end)."""
    best = np.full(len(starts), np.inf)
    for side in (1.0, -1.0):
        angle = np.linspace(0, 2 * np.pi, 20001)
        for k, (x, y, heading) in enumerate(starts):
            turned = heading + side * angle
            px = x + side * (np.sin(turned) - np.sin(heading))
            py = y - side * (np.cos(turned) - np.cos(heading))
            ahead = -(px * np.cos(turned) + py * np.sin(turned))
            miss = -px * np.sin(turned) + py * np.cos(turned)
            straight = ahead - np.sqrt(np.maximum(radius**2 - miss**2, 0.0))
            reaches = (np.abs(miss) <= radius) & (straight >= 0)
            length = np.where(reaches, angle + straight, np.inf)
            best[k] = min(best[k], length.min())
    return best


@pytest.fixture(scope="module")
def basin():
    car = dubins()
    return hf.capture_basin(car, goal(STATES), None, in_a_field(car), 9.0)


def test_a_dubins_car_arrives_in_the_least_time(basin):
    """300 starts on cells of 13 cm: every one arrives, and all but those beside a jump of T within
    0.1 s of it.

    The slopes of V, which are those of a set that grows no more, do not lead to the goal.
    """
    assert 100 * basin.grid.axes[0].step == pytest.approx(13, abs=0.5)
    car = dubins()
    starts = starts_of(basin, [-3, -3, -np.pi], [3, 3, np.pi], 300)
    late = arrivals(car, hf.least_time_law(car, basin), starts) - basin.least_time(starts)
    assert np.isfinite(late).all()
    assert np.count_nonzero(late <= 0.1) >= 295
    assert abs(np.median(late)) <= 0.02
    by_value = arrivals(car, hf.safety_law(car, basin), starts[:100])
    assert np.count_nonzero(np.isfinite(by_value)) < 50


def test_the_least_times_are_those_of_dubins_paths(basin):
    """Where the shortest path turns once and goes straight, T is its length to 0.06 s at 19 of 20
    starts; a cell is 0.13 m. The rest is beside a jump."""
    starts = starts_of(basin, [-3, -3, -np.pi], [3, 3, np.pi], 300)
    far = np.hypot(starts[:, 0], starts[:, 1]) > 2 + RADIUS
    exact = shortest_path(starts[far])
    error = np.abs(basin.least_time(starts[far]) - exact)
    assert len(error) > 100
    assert np.quantile(error, 0.95) < 0.06
    car = dubins()
    late = arrivals(car, hf.least_time_law(car, basin), starts[far]) - exact
    assert np.quantile(late, 0.95) < 0.1, "an own measure of the law: nothing of the grid is in it"
    assert late.min() > -0.02, "no law is quicker than the shortest path"


STEPS = """
void run(const double *seen, int count, double *answer) {
    double actuators[1];
    soon_state s;
    for (int k = 0; k < count; k++) {
        soon_start(&s);
        soon_step(&s, 0.0, 0.02, seen + 3 * k, soon_parameters, answer + k, actuators);
    }
}
"""


@needs_gcc
@pytest.mark.heavy
def test_the_law_in_c_commands_what_the_simulated_one_does(basin, tmp_path):
    car = dubins()
    law = hf.least_time_law(car, basin)
    c = built(tmp_path, hf.export_c(car, law, "soon") + STEPS, "soon")
    starts = starts_of(basin, [-3, -3, -np.pi], [3, 3, np.pi], 300)
    answers = np.zeros(len(starts))
    c.run(pointer(np.ascontiguousarray(starts)), len(starts), pointer(answers))
    result = hf.simulate(car, law, starts=starts, horizon=0.02, record_every=0.02)
    assert np.array_equal(answers, result.dataset["input"].values[:, 0, 0])
    assert len(set(answers.tolist())) > 1


def cart():
    """x' = v, v' = push, |push| <= 1."""
    return hf.System(
        "cart", (PLANE[0], hf.Quantity("v", "m/s")), (hf.Quantity("push", "m/s^2"),),
        {"x": SPEED, "v": hf.symbol("push")}, input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip


def lateness(basin, goal, inside, starts):
    """By how much later than T each run first is in the goal, inf for never."""
    law = hf.least_time_law(cart(), basin)
    run = hf.simulate(cart(), law, starts=starts, goal=goal, horizon=10, record_every=0.02)
    here, times = inside(run.dataset["state"].values), run.dataset["time"].values
    first = np.where(here.any(axis=1), times[here.argmax(axis=1)], np.inf)
    return first - basin.least_time(starts)


def test_a_double_integrator_brakes_in_time():
    rest = hf.Region("rest", cart().states, (
        hf.Inequality("near", sp.Abs(X) - 0.2, "m"),
        hf.Inequality("slow", sp.Abs(SPEED) - 0.2, "m/s"),
    ))  # fmt: skip
    grid = hf.grid(cart(), {"x": (-4, 4), "v": (-3, 3)}, {"x": 121, "v": 91})
    basin = hf.capture_basin(cart(), rest, None, grid, 7.0)
    starts = starts_of(basin, [-3, -2], [3, 2], 300)
    late = lateness(basin, rest, lambda s: (np.abs(s) <= 0.2 + 1e-9).all(axis=2), starts)
    assert np.count_nonzero(late <= 0.1) >= 297
    assert late.max() < 0.2


@pytest.mark.parametrize(("nodes", "cell", "most"), [(81, 5.5, 45), (161, 2.75, 4)])
def test_paths_that_graze_the_goal_are_later_and_fewer_on_finer_cells(nodes, cell, most):
    """Into a disc of 20 cm: all of 300 starts arrive, those that just miss it a little later."""
    near = hf.Inequality("near", sp.sqrt(X**2 + SPEED**2) - 0.2, "m")
    disc = hf.Region("disc", cart().states, (near,), empirical="a disc of numbers")
    grid = hf.grid(cart(), {"x": (-2.2, 2.2), "v": (-2.2, 2.2)}, nodes)
    assert 100 * grid.axes[0].step == pytest.approx(cell)
    basin = hf.capture_basin(cart(), disc, None, grid, 6.0)
    starts = starts_of(basin, [-1.5, -1], [1.5, 1], 300)
    late = lateness(basin, disc, lambda s: np.hypot(s[..., 0], s[..., 1]) <= 0.2 + 1e-9, starts)
    assert np.count_nonzero(late > 0.1) <= most
    assert late.max() < 0.3


@pytest.mark.heavy
def test_against_the_worst_current_most_arrive_in_time_and_nearly_all():
    """A game has more jumps, and its adversary holds the boat beside them: the honest numbers."""
    current = (hf.Quantity("dx", "m/s"), hf.Quantity("dy", "m/s"))
    boat = dubins(disturbances=current, disturbance_bounds=hf.Ball(0.2, 2))
    basin = hf.capture_basin(boat, goal(STATES), None, in_a_field(boat), 12.0)
    starts = starts_of(basin, [-3, -3, -np.pi], [3, 3, np.pi], 300)
    plant, law = worst_disturbance(boat, basin, hf.least_time_law(boat, basin))
    late = arrivals(plant, law, starts, horizon=20.0) - basin.least_time(starts)
    assert np.count_nonzero(np.isfinite(late)) >= 285
    assert np.count_nonzero(late <= 0.1) >= 245


@pytest.mark.heavy
def test_a_basin_with_rocks_is_crossed_in_time():
    car = dubins()
    rocks = hf.Region("rocks", STATES, (
        hf.Inequality("east", 0.5 - sp.sqrt((X - 1.5) ** 2 + Y**2), "m"),
        hf.Inequality("west", 0.5 - sp.sqrt((X + 1.5) ** 2 + (Y - 1) ** 2), "m"),
        hf.Inequality("wall x", sp.Abs(X) - 3.8, "m"),
        hf.Inequality("wall y", sp.Abs(Y) - 3.8, "m"),
    ))  # fmt: skip
    basin = hf.capture_basin(car, goal(STATES), rocks, in_a_field(car), 9.0)
    starts = starts_of(basin, [-3, -3, -np.pi], [3, 3, np.pi], 300)
    late = arrivals(car, hf.least_time_law(car, basin), starts) - basin.least_time(starts)
    assert np.count_nonzero(late <= 0.1) >= 285
