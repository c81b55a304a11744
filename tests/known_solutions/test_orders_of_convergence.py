"""The orders of docs/convergence.md are those that a march has, as far as seconds allow."""

import re
from pathlib import Path

import pytest
from convergence import observe
from exact import PROBLEMS

PAGE = Path(__file__).parents[2] / "docs" / "convergence.md"

PUBLISHED = {
    tuple(cells[:2]): cells[2:]
    for line in PAGE.read_text("utf-8").splitlines()
    if len(cells := [c.strip() for c in line[1:-1].split("|")]) == 8
}


@pytest.mark.parametrize(
    ("scheme", "order"), [("upwind", 1), ("eno2", 2), ("eno3", 3), ("weno5", 3)]
)
def test_value_without_a_kink_converges_at_the_order_of_its_scheme(scheme, order):
    """In the maximum norm; weno5 has the third order of its Runge-Kutta method."""
    found = observe(PROBLEMS["smooth"](), scheme)
    assert min(found.orders("largest")[-2:]) > order - 0.5
    assert found.orders("largest")[-1] > order - 0.15


@pytest.mark.parametrize(
    ("name", "scheme"),
    [("smooth", "eno3"), ("A2", "upwind"), ("A2", "weno5"), ("A4-2", "eno3"), ("A6", "eno2")],
)
def test_published_errors_and_orders_are_those_observed(name, scheme):
    problem = PROBLEMS[name]()
    said = observe(problem, scheme).said
    row = PUBLISHED[problem.name, scheme]
    for now, then in zip(said[::2], row[::2], strict=True):
        assert now == then == "" or float(now) == pytest.approx(float(then), rel=0.05)
    for now, then in zip(said[1::2], row[1::2], strict=True):
        numbers = [[float(x) for x in re.findall(r"-?\d\.\d", text)] for text in (now, then)]
        assert numbers[0] == pytest.approx(numbers[1], abs=0.11)
