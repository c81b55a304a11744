"""How much can be stood: filled where a kernel is left, hollow where none is, the limit between."""

import matplotlib.pyplot as plt
import pytest

import holdfast as hf
from holdfast.errors import OutputError


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


def drawn(values, fractions, **options):
    (axis,) = hf.margin_figure(values, fractions, "current", "m/s", **options).axes
    points = {x.get_label(): list(x.get_xdata()) for x in axis.get_lines()}
    return axis, points


def test_limit_lies_between_the_last_kernel_and_the_first_without():
    axis, points = drawn([0, 0.8, 0.4, 0.2, 0.3], [0.11, 0, 0, 0.05, 0.01])
    assert points["a kernel is left"] == [0, 0.2, 0.3]
    assert points["empty"] == [0.4, 0.8]
    (band,) = axis.patches
    assert (band.get_x(), band.get_x() + band.get_width()) == pytest.approx((0.3, 0.4))
    assert axis.get_title() == "current: up to 0.3 m/s leaves a kernel, 0.4 m/s none"
    assert axis.get_xlabel() == "current [m/s]"


def test_share_that_counts_as_empty_is_at_the_choice_of_the_reader():
    _, points = drawn([0, 0.2, 0.3], [0.11, 0.05, 0.01], threshold=0.02)
    assert points["empty"] == [0.3]


@pytest.mark.parametrize(
    ("fractions", "said"),
    [([0.2, 0.1], "up to 2 m/s leaves a kernel"), ([0.0, 0.0], "1 m/s leaves no kernel")],
)
def test_without_a_bracket_no_limit_is_claimed(fractions, said):
    axis, _ = drawn([1, 2], fractions)
    assert axis.get_title() == f"current: {said}: no limit found"
    assert not axis.patches


def test_every_value_needs_its_fraction():
    with pytest.raises(OutputError, match="2 values and 1 fractions"):
        drawn([1, 2], [0.1])
