"""Sets that held inputs keep: inside exact kernels, and kept by any disturbance in closed loop."""

import itertools

import numpy as np
import pytest
import sympy as sp

from holdfast.analysis.certificates.cells import Cells, Counted
from holdfast.analysis.certificates.certify import kept
from holdfast.execution.intervals.held_flow import HeldFlow

X, V, A, W = sp.symbols("x v a w", real=True)
A_AHEAD, B_LEFT, U, R, WA, WB = sp.symbols("ahead left u r wa wb", real=True)


def cart(hold, push=0.0):
    """x'' = a + w between two walls at 1 m."""
    return HeldFlow([V, A + W], [X - 1, -1 - X], [X, V], [A], {W: (-push, push)}, {}, hold)


def exact_share(cells, push):
    """Of the cells between the walls, those in the exact kernel: braking with 1 - push stops."""
    low, high = cells.corners(np.arange(int(np.prod(cells.counts))))
    between = (low[:, 0] >= -1) & (high[:, 0] <= 1)
    corners = itertools.product((low[:, 0], high[:, 0]), (low[:, 1], high[:, 1]))
    fine = between.copy()
    for x, v in corners:
        fine &= np.abs(x + v * np.abs(v) / (2 * (1 - push))) <= 1
    return fine


@pytest.mark.parametrize("push", [0.0, 0.3])
def test_cart_is_kept_within_the_exact_kernel_and_nearly_all_of_it(push):
    cells = Cells.even(((-1.0, 1.0), (-2.0, 2.0)), (201, 201), (False, False))
    found = kept(cart(0.2, push), cells, np.linspace(-1, 1, 9)[:, None])
    exact = exact_share(cells, push)
    assert exact[found.members].all()
    assert len(found.members) > 0.96 * exact.sum()


def test_hold_that_moves_less_than_a_cell_loses():
    """Every image is rounded outward to cells."""
    cells = Cells.even(((-1.0, 1.0), (-2.0, 2.0)), (201, 201), (False, False))
    found = kept(cart(0.05, 0.3), cells, np.linspace(-1, 1, 9)[:, None])
    assert len(found.members) / exact_share(cells, 0.3).sum() == pytest.approx(0.665, abs=0.02)


def test_finer_cells_keep_more():
    shares = []
    for count in (51, 101, 201):
        cells = Cells.even(((-1.0, 1.0), (-2.0, 2.0)), (count, count), (False, False))
        shares.append(kept(cart(0.1, 0.2), cells, np.linspace(-1, 1, 5)[:, None]).share)
    assert shares[0] < shares[1] < shares[2]


def view(current, hold):
    """A target ahead and to the left of a camera of 30 degrees to either side, within 0.35 to 2 m."""
    slope = sp.tan(sp.pi / 6)
    inside = [0.35 - A_AHEAD, A_AHEAD - 2, B_LEFT - slope * A_AHEAD, -B_LEFT - slope * A_AHEAD]
    rates = [-U + R * B_LEFT - WA, -R * A_AHEAD - WB]
    bounds = {WA: (-current, current), WB: (-current - 0.05, current + 0.05)}
    return HeldFlow(rates, inside, [A_AHEAD, B_LEFT], [U, R], bounds, {}, hold)


STEER = np.array(list(itertools.product(np.linspace(-0.5, 0.5, 5), np.linspace(-0.8, 0.8, 5))))


def test_view_is_kept_for_ever_in_closed_loop_against_currents_at_their_corners():
    """2,000 starts in the cells that are kept, 30 s, the current at a corner at every instant."""
    cells = Cells.even(((0.3, 2.1), (-1.2, 1.2)), (121, 121), (False, False))
    found = kept(view(0.3, 0.1), cells, STEER)
    assert 0.8 < found.share < 1
    generator = np.random.default_rng(5)
    table = np.full(int(np.prod(cells.counts)), -1)
    table[found.members] = found.inputs
    chosen = generator.choice(found.members, 2000)
    low, high = cells.corners(chosen)
    q = low + (high - low) * generator.random(low.shape)
    limit = np.tan(np.pi / 6)
    for _ in range(300):
        place = [np.searchsorted(e, q[:, k], side="right") - 1 for k, e in enumerate(cells.edges)]
        index = table[np.ravel_multi_index(place, cells.counts)]
        assert (index >= 0).all()
        u, r = STEER[index].T
        for _ in range(5):  # the worst for the nearest limit
            a, b = q.T
            margins = np.stack([0.35 - a, a - 2, b - limit * a, -b - limit * a])
            worst = margins.argmax(axis=0)
            wa = np.choose(worst, [0.3, -0.3, 0.3, 0.3])
            wb = np.choose(worst, [0.35, -0.35, -0.35, 0.35])
            for _ in range(4):
                a, b = q.T
                q = q + 0.005 * np.stack([-u + r * b - wa, -r * a - wb], axis=1)
            margins = np.stack([0.35 - q[:, 0], q[:, 0] - 2, np.abs(q[:, 1]) - limit * q[:, 0]])
            assert margins.max() < 2e-3  # of the Euler steps


def test_current_that_is_too_fast_leaves_nothing():
    cells = Cells.even(((0.3, 2.1), (-1.2, 1.2)), (61, 61), (False, False))
    assert len(kept(view(1.0, 0.1), cells, STEER).members) == 0


def test_finite_horizon_keeps_more_than_for_ever():
    cells = Cells.even(((0.3, 2.1), (-1.2, 1.2)), (61, 61), (False, False))
    shares = [kept(view(0.45, 0.1), cells, STEER, holds).share for holds in (2, 10, None)]
    assert shares[0] > shares[1] > shares[2]


def test_angle_comes_back_to_itself():
    """A heading that only grows is kept on a circle; on a line it leaves at the end."""
    psi = sp.Symbol("psi", real=True)
    flow = HeldFlow([sp.Integer(1)], [], [psi], [], {}, {}, 0.3)
    for periodic, share in ((True, 1.0), (False, 0.0)):
        cells = Cells.even(((-np.pi, np.pi),), (40,), (periodic,))
        everywhere = kept(flow, cells, np.empty((1, 0)))
        assert everywhere.share == share


def test_blocks_of_cells_are_counted_as_one_by_one():
    generator = np.random.default_rng(6)
    cells = Cells.even(((0, 1), (0, 1), (0, 1)), (7, 5, 6), (False, True, False))
    members = generator.random(7 * 5 * 6) < 0.8
    grid = members.reshape(7, 5, 6)
    counted = Counted(cells, members)
    first = generator.integers(0, [7, 5, 6], (300, 3))
    last = np.minimum(first + generator.integers(0, 3, (300, 3)), [6, 9, 5])
    for a, b, found in zip(first, last, counted.all_of(first, last), strict=True):
        block = grid[a[0] : b[0] + 1][:, np.arange(a[1], b[1] + 1) % 5][:, :, a[2] : b[2] + 1]
        assert block.all() == found


def test_boxes_touch_the_cells_of_both_sides_of_an_edge():
    cells = Cells.even(((0.0, 1.0),), (10,), (False,))
    edge = cells.edges[0][3]
    first, last, inside = cells.touched(np.array([[edge], [0.31]]), np.array([[edge], [0.39]]))
    assert (first[:, 0].tolist(), last[:, 0].tolist()) == ([2, 3], [3, 3])
    assert inside.all()
    outside = cells.touched(np.array([[-0.1], [np.nan]]), np.array([[0.2], [0.2]]))[2]
    assert not outside.any()
