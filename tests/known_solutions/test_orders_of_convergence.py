"""The orders of docs/convergence.md are those that a march has, as far as seconds allow."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from convergence import SCHEMES, grids, observe
from exact import PROBLEMS

PAGE = Path(__file__).parents[2] / "docs" / "convergence.md"

PUBLISHED = {
    tuple(cells[:2]): cells[2:]
    for line in PAGE.read_text("utf-8").splitlines()
    if len(cells := [c.strip() for c in line[1:-1].split("|")]) == 8
}

HEADS = [("problem", "scheme"), ("---", "---")]


@pytest.mark.parametrize(
    ("scheme", "order"), [("upwind", 1), ("eno2", 2), ("eno3", 3), ("weno5", 3)]
)
def test_value_without_a_kink_converges_at_the_order_of_its_scheme(scheme, order):
    """In the maximum norm; weno5 has the third order of its Runge-Kutta method."""
    found = observe(PROBLEMS["smooth"](), scheme)
    assert min(found.orders("largest")[-2:]) > order - 0.5
    assert found.orders("largest")[-1] > order - 0.15


FAST = [("smooth", "eno3"), ("A2", "upwind"), ("A4-2", "eno3"), ("A6", "eno2")]
SLOW = [(n, s) for n in PROBLEMS for s in SCHEMES if (n, s) not in FAST]


def test_every_problem_is_on_the_page_with_its_grids():
    problems = [make() for make in PROBLEMS.values()]
    assert set(PUBLISHED) == {(p.name, s) for p in problems for s in SCHEMES} | set(HEADS)
    for p in problems:
        near = f"V within {p.near:g}" if p.points is None else f"{len(p.points)} points"
        assert f"| {p.name} | {p.what} | {grids(p)} | {near} |" in PAGE.read_text("utf-8")


@pytest.mark.few("smooth-eno3")
@pytest.mark.parametrize(
    ("name", "scheme"), FAST + [pytest.param(*c, marks=pytest.mark.heavy) for c in SLOW]
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


def test_errors_of_a_box_in_three_dimensions_are_largest_at_its_edges():
    """A4 on 40 cells by weno5: where the margins of two states are as bad."""
    problem = PROBLEMS["A4-3"]()
    gap = np.abs(problem.march(1, "weno5").at(problem.points))
    faces = np.abs(problem.points).max(axis=0)
    from_edge = np.sort(faces - np.abs(problem.points), axis=1)[:, 1]
    assert gap[from_edge < 0.1].mean() == pytest.approx(0.035, abs=0.001)
    assert gap[from_edge >= 0.1].mean() == pytest.approx(0.001, abs=0.0003)


def test_faces_of_a_box_in_six_dimensions_meet_in_sixty_and_its_mean_error_is_a_third_of_a_cell():
    """By weno5 on 12 cells from end to end, as published."""
    problem = PROBLEMS["A4-6"]()
    (cell,) = {a.step for a in problem.grid(1).axes}
    assert problem.cells[1] == (12,) * 6
    assert cell == pytest.approx(0.21, abs=0.005)
    assert float(PUBLISHED[problem.name, "weno5"][0]) / cell == pytest.approx(1 / 3, abs=0.04)
    pairs = {frozenset(c) for c in itertools.combinations(range(12), 2) if c[0] // 2 != c[1] // 2}
    assert len(pairs) == 60


@pytest.mark.heavy
def test_largest_error_of_the_population_is_outside_its_kernel_where_the_slope_jumps():
    problem = PROBLEMS["A1"]()
    found = problem.march(2, "weno5")
    exact = problem.exactly(found.grid)
    gap = np.where(np.abs(exact) <= problem.near, np.abs(found.values() - exact), 0)
    place = np.unravel_index(gap.argmax(), gap.shape)
    x, y = (float(a.nodes[i]) for a, i in zip(found.grid.axes, place, strict=True))
    assert exact[place] < 0
    assert (x, y) == pytest.approx((0.13, 1.78), abs=0.005)
    grown = np.exp(y * y)  # x is at x exp(y^2) when y has been stopped
    left, right = x - 0.2, 3.0 - x * grown
    assert left == pytest.approx(right, abs=0.03)
    assert np.hypot(grown, 2 * x * y * grown) == pytest.approx(26, abs=0.5)
