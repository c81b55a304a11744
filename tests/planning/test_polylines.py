"""Lines through many points, drawn by few."""

import numpy as np
import pytest

from holdfast.planning.obstacles import kept_points


def farthest(points, line):
    """The largest distance of points from a line of segments."""
    a, along = line[:-1], np.diff(line, axis=0)
    length = np.maximum((along**2).sum(axis=1), 1e-300)
    part = ((points[:, None] - a) * along).sum(axis=2) / length
    foot = a + np.clip(part, 0.0, 1.0)[..., None] * along
    return np.hypot(*(points[:, None] - foot).transpose(2, 0, 1)).min(axis=1).max()


@pytest.mark.parametrize("within", [1e-2, 1e-3])
def test_no_point_is_farther_than_the_bound_from_the_line_that_is_drawn(within):
    angle = np.linspace(0.0, 40.0, 1500)
    spiral = np.column_stack([np.cos(angle), np.sin(angle)]) * (angle / 40.0)[:, None]
    shaken = spiral + np.random.default_rng(1).normal(scale=3e-4, size=spiral.shape)
    kept = kept_points(shaken, within)
    assert kept[0] == 0
    assert kept[-1] == 1499
    assert (np.diff(kept) > 0).all()
    assert len(kept) < 600
    assert 0.2 * within < farthest(shaken, shaken[kept]) <= within


def test_a_corner_stays_and_a_vehicle_at_rest_is_two_points():
    corner = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]])
    np.testing.assert_array_equal(kept_points(corner, 1e-3), [0, 2, 4])
    np.testing.assert_array_equal(kept_points(np.ones((9, 2)), 1e-3), [0, 8])
    np.testing.assert_array_equal(kept_points(corner[:1], 1e-3), [0])
