"""Values and slopes of a table lie between what is said of the boxes that their places are in."""

import numpy as np
import pytest

from holdfast.execution.intervals.law_ranges import TableRanges
from holdfast.execution.table_in_parts import slopes_at, values_at

LOW, STEPS, SHAPE = np.array([-1.0, 0.3]), np.array([0.1, 0.25]), np.array([21, 13])


@pytest.mark.parametrize("periodic", [(False, False), (True, False), (True, True)])
def test_values_and_slopes_lie_between_the_nodes_around(periodic):
    rng = np.random.default_rng(5)
    grid = (LOW, STEPS, SHAPE, np.array(periodic))
    values = rng.normal(size=SHAPE.prod())
    ranges = TableRanges((values, *grid))
    last = LOW + STEPS * (SHAPE - 1)
    turns = np.where(periodic, 3 * (last - LOW), 0)
    low = LOW - turns + (last - LOW + 2 * turns) * rng.random((3000, 2))
    low = np.where(rng.random(low.shape) < 0.3, LOW + STEPS * rng.integers(0, SHAPE), low)
    high = low + rng.choice([0.0, 1e-9, 0.05, 0.4], low.shape)
    high = np.where(periodic, high, np.minimum(high, last))
    least, most = ranges.over(low, high)
    for share in (0.0, 0.3, 1.0):
        at = low + share * (high - low)
        found = np.concatenate(
            [values_at(values, at, grid)[:, None], slopes_at(values, at, grid)], 1
        )
        room = 1e-9 * (1 + np.abs(found))  # the rounding of the look-up
        assert (least - room <= found).all()
        assert (found <= most + room).all()
    assert np.median(most - least) < np.ptp(values) / STEPS.min()


def test_places_beyond_a_table_are_at_its_end_and_unknown_ones_are_not_known():
    values = np.arange(3.0)
    one = (values, np.array([0.0]), np.array([1.0]), np.array([3]), np.array([False]))
    least, most = TableRanges(one).over(
        np.array([[5.0], [-9.0], [np.nan], [-1.0]]), np.array([[6.0], [-8.0], [1.0], [9.0]])
    )
    assert least[:2, 0].tolist() == most[:2, 0].tolist() == [2.0, 0.0]
    assert np.isnan(least[2]).all()
    assert (least[3, 0], most[3, 0]) == (0.0, 2.0)
