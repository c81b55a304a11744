"""The limits of a plot of paths."""

import numpy as np
import pytest

from holdfast.presentation.figures.paths import frame_of


def spokes(count=20):
    """Paths from a circle of radius 1 to its middle, shape (count, 50, 2)."""
    angle = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    start = np.column_stack([np.cos(angle), np.sin(angle)])
    return start[:, None] * np.linspace(1.0, 0.0, 50)[:, None]


def test_a_few_far_paths_do_not_shrink_the_others_to_dots():
    paths = spokes()
    paths[3] = paths[3, :1] * np.linspace(1.0, 30.0, 50)[:, None]
    frame = frame_of(paths)
    assert frame.beyond == 1
    assert max(frame.size) < 2.5
    assert frame_of(spokes()).beyond == 0


def test_a_start_that_is_far_and_fixed_points_are_in_the_frame():
    paths = spokes()
    paths[0] += 9.0
    frame = frame_of(paths, np.array([[-5.0, 0.0]]))
    assert frame.x[0] < -5.0
    assert frame.x[1] > 10.0
    assert frame.y[1] > 9.0


def test_what_ended_counts_up_to_its_end():
    paths = spokes()
    paths[:, 25:] = np.nan
    assert frame_of(paths).size == pytest.approx((2.24, 2.24))


@pytest.mark.parametrize("size", [780.0, 1e9])
def test_paths_that_are_lines_at_one_scale_have_two(size):
    paths = spokes() * [1.0, size]
    frame = frame_of(paths)
    assert not frame.equal
    assert frame.size == pytest.approx((2.24, 2.24 * size))


def test_a_straight_path_is_drawn_as_one():
    straight = np.column_stack([np.linspace(0.0, 4.0, 30), 1e-13 * np.sin(np.arange(30.0))])
    frame = frame_of(straight[None])
    assert frame.size[1] > 10 * np.ptp(straight[:, 1])
