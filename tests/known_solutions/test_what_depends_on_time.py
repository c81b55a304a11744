"""Kernels and reachable sets of what changes with time, whose exact form is known.

x' = a(t) + u, |u| <= c, before walls and targets that move: everything is an interval.
"""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError

X, U, D, T = hf.symbol("x"), hf.symbol("u"), hf.symbol("d"), hf.TIME
STATE = (hf.Quantity("x", "m"),)
CELL = 0.05


def boat(speed=1.0, drift=sp.S.Zero):
    return hf.System(
        "boat", STATE, (hf.Quantity("u", "m/s"),), {"x": drift + U},
        input_bounds=hf.Box((-speed,), (speed,)),
    )  # fmt: skip


def region(*expressions):
    rows = tuple(hf.Inequality(f"c{i}", e, "m") for i, e in enumerate(expressions))
    return hf.Region("region", STATE, rows)


def line(low=-2.0, high=4.0, **ends):
    return hf.grid(boat(), {"x": (low, high)}, round((high - low) / CELL) + 1, ends)


def interval(found, time=None):
    """The ends of the set, by interpolation; it is one interval."""
    x = np.linspace(found.grid.axes[0].low, found.grid.axes[0].high, 12001)
    inside = x[found.at(x[:, None], time) > 0]
    assert inside.max() - inside.min() < (len(inside) + 1) * (x[1] - x[0])
    return inside.min(), inside.max()


WALL = region(0.5 * T - 1 - X, X - 1)
"""Between a wall that comes in at 0.5 m/s, at -1 at t = 0, and one that stands at 1."""


@pytest.mark.parametrize("scheme", ["upwind", "eno2", "weno5"])
@pytest.mark.parametrize("speed", [0.2, 1.0])
def test_who_is_slower_than_a_wall_has_to_start_ahead_of_it(scheme, speed):
    """x(0) >= -1 + (0.5 - c) T if c < 0.5, else anywhere between the walls."""
    found = hf.viability_kernel(boat(speed), WALL, line(), 3.0, scheme=scheme)
    low, high = interval(found)
    assert low == pytest.approx(-1 + max(0.5 - speed, 0) * 3, abs=0.5 * CELL)
    assert high == pytest.approx(1, abs=0.5 * CELL)
    said = found.dataset.attrs
    assert said["depends_on_time"] == 1
    assert said["converged"] == 0
    assert said["reached_s"] == 3.0


def test_walls_that_meet_leave_nothing():
    assert hf.viability_kernel(boat(), WALL, line(), 3.9).dataset.attrs["empty"] == 0
    with pytest.raises(SimulationError, match="no node of the grid is in region"):
        hf.viability_kernel(boat(), WALL, line(), 4.1)  # there is nothing to end in


def test_problem_that_starts_later_finds_the_wall_further_on():
    found = hf.viability_kernel(boat(0.2), WALL, line(), 2.0, start_time=1.0)
    assert interval(found) == pytest.approx((-0.5 + 0.3 * 2, 1), abs=0.5 * CELL)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_kernel_in_a_current_that_rises(order):
    """A current of 2 m/s from t = 1 s on, against 1 m/s: who has time before it needs less room.

    At t = 2 all of |x| <= 1 will do, at 1 all up to 0, at 0.5 all up to 0.5, at 0 all again: the
    set does not shrink with the time to go.
    """
    current = boat(drift=hf.parse_expression("2 if t > 1 else 0", {"t": T}))
    walls = region(X - 1, -1 - X)
    times = [1.0, 1.5]
    found = hf.viability_kernel(current, walls, line(), 2.0, times=times, order=order)
    for to_go, high in ((1.0, 0.0), (1.5, 0.5), (2.0, 1.0)):
        assert interval(found, to_go)[1] == pytest.approx(high, abs=CELL)
    later = hf.viability_kernel(current, walls, line(), 1.5, start_time=0.5, order=order)
    # The current sets in within a step, at another share of it in each of both marches.
    assert later.values() == pytest.approx(found.values(1.5), abs=0.25 * CELL)


def test_steps_are_short_enough_for_a_current_that_comes_later():
    """40 m/s for a tenth of a second, at the end of the march: no step is longer than it can be."""
    gust = boat(drift=hf.parse_expression("40 if t < 0.1 else 0", {"t": T}))
    target = region(abs(X - 2) - 0.4)
    grid = line(-5.0, 4.0)
    found = hf.backward_reachable_tube(gust, target, grid, 1.1, scheme="upwind", cfl=1.0)
    assert found.dataset.attrs["steps"] > 0.1 * 41 / CELL
    low, high = interval(found)
    assert low == pytest.approx(2 - 0.4 - 4 - 1.1, abs=3 * CELL)
    # to the right of the target at t = 0.1 the boat comes back; before, the gust takes it away
    assert high == pytest.approx(2.4, abs=3 * CELL)


@pytest.mark.parametrize("speed", [0.4, 1.0, 1.5])
def test_target_that_moves_away_is_caught_by_who_is_fast_enough(speed):
    """|x - s t| <= 0.5, s = 1: from behind by x >= -0.5 - (c - 1) T if c > 1, else from within;
    ahead of it one only has to wait."""
    target = region(abs(X - T) - 0.5)
    grid = line(-3.0, 6.0, x="extrapolated")
    found = hf.backward_reachable_tube(boat(speed), target, grid, 2.0)
    low, high = interval(found)
    assert low == pytest.approx(-0.5 - max(speed - 1, 0) * 2, abs=CELL)
    assert high == pytest.approx(0.5 + (1 + speed) * 2, abs=CELL)


def test_capture_of_a_target_that_moves_before_a_wall_that_closes():
    """The goal comes from the right at 1 m/s; the wall from the left at 0.5 m/s wipes out who waits."""
    goal = region(abs(X - 4 + T) - 0.25)
    free = region(-1.5 + 0.5 * T - X)
    grid = line(-3.0, 5.0, x="extrapolated")
    found = hf.capture_basin(boat(0.25), goal, free, grid, 3.0)
    # at T = 3 the goal is at 1 and the wall at 0: from the left, 0.75 is met at 0.25 m/s in time,
    # and the wall, faster by 0.25 m/s, takes 3 s over 0.75 m
    low, high = interval(found)
    assert low == pytest.approx(max(0.75 - 0.25 * 3, -1.5 + 0.25 * 3), abs=CELL)
    assert high == pytest.approx(4.25, abs=CELL)
    assert "arrival" not in found.dataset
    with pytest.raises(
        SimulationError, match="the least time to the goal depends on the start time"
    ):
        hf.capture_basin(boat(0.25), goal, free, grid, 3.0, arrival_steps=10)


def test_forward_reach_is_that_at_the_end_of_the_horizon():
    """From |x| <= 0.5, left at any time, in a current of 2 t m/s: [-0.5 - 1, 0.5 + 2^2 + 2]."""
    start = region(abs(X) - 0.5)
    grid = hf.grid(boat(), {"x": (-3, 9)}, 241)
    found = hf.forward_reachable_set(boat(drift=2 * T), start, grid, 2.0)
    low, high = interval(found)
    assert high == pytest.approx(6.5, abs=CELL)
    # left at s > 0.5 to the left, the current brings it back: -0.5 + min over s of what is drifted
    assert low == pytest.approx(-0.5, abs=CELL)
    later = hf.forward_reachable_set(boat(drift=2 * T), start, grid, 1.0, start_time=1.0)
    assert interval(later)[1] == pytest.approx(0.5 + 3 + 1, abs=CELL)


def test_disturbance_may_be_an_expression_of_time():
    waves = hf.System(
        "waves", STATE, (hf.Quantity("u", "m/s"),), {"x": U + D},
        disturbances=(hf.Quantity("d", "m/s"),),
        input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-2,), (2,)),
    )  # fmt: skip
    current = hf.parse_expression("2 if t > 1 else 0", {"t": T})
    walls = region(X - 1, -1 - X)
    given = hf.viability_kernel(
        waves, walls, line(), 1.5, start_time=0.5, disturbance={"d": current}
    )
    own = hf.viability_kernel(boat(drift=current), walls, line(), 1.5, start_time=0.5)
    assert np.array_equal(given.values(), own.values())
    assert given.dataset.attrs["disturbance"] == '{"d": "select(t - 1, 2, 0)"}'
    with pytest.raises(SimulationError, match="disturbance 'd' uses 'x'; expected a number, or an"):
        hf.viability_kernel(waves, walls, line(), 1.5, disturbance={"d": X})


def test_what_depends_on_time_goes_on_from_a_checkpoint(tmp_path):
    current = boat(drift=sp.sin(3 * T))

    def kernel(**options):
        return hf.viability_kernel(current, WALL, line(), 2.0, times=[0.5], **options)

    told = []

    def stop(share):
        told.append(share)
        if len(told) > 11:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kernel(checkpoint=tmp_path / "a", checkpoint_every=0, progress=stop)
    rest = []
    again = kernel(checkpoint=tmp_path / "a", progress=rest.append)
    whole = kernel()
    assert again.dataset["value"].identical(whole.dataset["value"])
    first = sum(share <= 0.5 for share in rest)  # the filtered march has the second half
    assert first == whole.dataset.attrs["steps"] - 11


def test_target_that_was_larger_for_a_while_is_remembered_by_a_checkpoint(tmp_path):
    """What was reached while it was large stays reached: that is no growth out of nothing."""
    swells = region(abs(X) - 0.3 - 2 * T * (2 - T))
    told = []

    def stop(_share):
        told.append(1)
        if len(told) > 8:
            raise KeyboardInterrupt

    def reach(**options):
        return hf.backward_reachable_tube(boat(0.5), swells, line(-5, 5), 2.0, **options)

    with pytest.raises(KeyboardInterrupt):
        reach(checkpoint=tmp_path / "a", checkpoint_every=0, progress=stop)
    again = reach(checkpoint=tmp_path / "a")
    assert np.array_equal(again.values(), reach().values())
    assert again.values().max() == pytest.approx(2.3, abs=CELL)


def test_region_that_moves_out_of_the_grid_is_refused():
    with pytest.raises(SimulationError, match=r"cuts off region 'region' at x = 4"):
        hf.viability_kernel(boat(), region(abs(X - 4 * T * (1 - T)) - 3.2), line(-4), 1.0)


def test_region_that_moves_is_refused_where_it_would_be_taken_to_stand():
    slow, law = boat(), hf.Law("still", STATE, {"u": sp.S.Zero})
    for use in (
        lambda: hf.simulate(slow, law, starts=[[0.0]], goal=WALL, horizon=1.0),
        lambda: hf.redesign(law, WALL, viable={"c0": law, "c1": law},
                            layers={"c0": (-0.2, -0.1), "c1": (-0.2, -0.1)}),
        lambda: hf.regulation_map(slow, WALL, [0.0]),
    ):  # fmt: skip
        with pytest.raises(
            DefinitionError, match="region 'region' depends on time; expected a stationary region"
        ):
            use()


def test_value_that_holds_at_one_time_makes_no_law():
    found = hf.viability_kernel(boat(), WALL, line(), 1.0)
    with pytest.raises(
        SimulationError, match="the value function depends on time, and is valid at"
    ):
        hf.safety_law(boat(), found)


def test_what_rests_on_what_is_outside_is_told_of_what_depends_on_time():
    """Carried off by 2 t m/s in a corridor without an end: by t = 1 s who starts beyond 3 is outside."""
    corridor = region(-1 - X)
    grid = line(-2.0, 4.0, x="extrapolated")
    found = hf.viability_kernel(boat(0.0, 2 * T), corridor, grid, 1.0, check_outside=True)
    x, outside = grid.axes[0].nodes, found.dataset["outside"].values
    sure = (np.abs(x - 3) > 2 * CELL) & (x < 4)
    assert np.array_equal((outside == 1)[sure], (x > 3)[sure])
