"""The exact quadratic program against solvers that know nothing of it: Clarabel and HiGHS."""

import math

import clarabel
import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog

from holdfast.execution.simulation import quadratic_program
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from tests.execution.simulation.random_programs import (
    COUNTS,
    FAMILIES,
    MOST_ROWS,
    answers,
    anywhere,
    inside,
    opposed,
    programs,
    solved,
)


def settings(tolerance):
    chosen = clarabel.DefaultSettings()
    chosen.verbose = chosen.presolve_enable = False
    chosen.tol_gap_abs = chosen.tol_gap_rel = chosen.tol_feas = tolerance
    return chosen


FINE, COARSE = settings(1e-11), (settings(1e-10), settings(1e-8))
CONES = [[clarabel.NonnegativeConeT(k)] for k in range(MOST_ROWS + 2)]
SOLVED, INFEASIBLE = clarabel.SolverStatus.Solved, clarabel.SolverStatus.PrimalInfeasible


def matrix(dense):
    """Every entry of it, column by column: cheaper than to look for zeros."""
    k, m = dense.shape
    return sparse.csc_matrix(
        (dense.T.ravel(), np.tile(np.arange(k), m), np.arange(0, k * m + 1, k)), shape=(k, m)
    )


def peer(squares, linear, a, b, chosen):
    """Clarabel's solution of min x' squares x / 2 + linear' x with a x <= b."""
    return clarabel.DefaultSolver(
        matrix(squares), linear, matrix(a), b, CONES[len(b)], chosen
    ).solve()


def projection(a, b, w, chosen=FINE):
    """Its point nearest to w."""
    return peer(2.0 * np.eye(len(w)), -2.0 * w, a, b, chosen)


def least_slack(a, b, eased):
    """The least t >= 0 with a x <= b + t eased; NaN where Clarabel does not find it."""
    m = a.shape[1]
    rows = np.vstack([np.column_stack([a, -eased]), np.append(np.zeros(m), -1.0)])
    highest = np.append(np.zeros(m), 1.0)
    found = peer(np.zeros((m + 1, m + 1)), highest, rows, np.append(b, 0.0), FINE)
    return found.x[m] if found.status == SOLVED else math.nan


def normalised(case):
    """Unit normals, offsets, wanted input, and the sizes of the normals, in units of the scales."""
    a, b, _, wanted, scales = case
    size = np.linalg.norm(a * scales, axis=1)
    size[size == 0.0] = 1.0
    return a * scales / size[:, None], b / size, wanted / scales, size


def violation(a, b, x):
    return ((a @ x - b) / (1.0 + np.abs(b))).max(initial=0.0)


def agrees(case, answer):
    """Whether the peer comes to a verdict; that it is the same one is asserted."""
    a, b, w, size = normalised(case)
    x, slack = answer[:-1] / case[4], answer[-1]
    found = projection(a, b, w)
    if slack == 0.0:
        assert violation(a, b, x) <= 2e-10
    if found.status not in (SOLVED, INFEASIBLE):
        return False
    if (slack == 0.0) != (found.status == SOLVED):
        assert least_slack(a, b, np.ones(len(b))) <= 1e-9 * (1.0 + np.abs(b).max())
        return False
    if slack == 0.0:
        objective, least = (((v - w) ** 2).sum() for v in (x, np.array(found.x)))
        prices = sum(found.z) * (1.0 + np.abs(b).max())  # what the tolerances of the peer cost
        assert abs(objective - least) <= 5e-8 * (1.0 + least) + 1e-9 * prices
        return True
    return agrees_relaxed(case[2], a, b, w, size, x, slack)


def agrees_relaxed(hard, a, b, w, size, x, slack):
    """The same where no input is admissible; an input within the hard rows shows that one is."""
    if math.isinf(slack):
        alone = least_slack(a[:hard], b[:hard], np.ones(hard))
        assert not alone <= 1e-9
        return not math.isnan(alone)
    assert violation(a[:hard], b[:hard], x) <= 1e-10
    eased = np.append(np.zeros(hard), size[hard:].max() / size[hard:])
    least = least_slack(a, b, eased) * size[hard:].max()
    room = 1e-8  # a set with an inside is easier on the peer
    for chosen in COARSE:  # the first may be finer than its arithmetic
        found = projection(a, b + slack * (eased > 0) / size + room, w, chosen)
        if found.status == SOLVED:
            break
    if math.isnan(least) or found.status != SOLVED:
        return False
    assert slack == pytest.approx(least, rel=1e-9, abs=1e-9 * size[hard:].max())
    objective, nearly = (((v - w) ** 2).sum() for v in (x, np.array(found.x)))
    assert objective <= nearly + 1e-6 * (1.0 + nearly) + 3.0 * room * sum(found.z)
    return True


# -- the comparison


@pytest.mark.heavy
def test_a_hundred_thousand_programs_are_compared():
    """Of which the checks of every day compare a tenth."""
    assert 2 * len(FAMILIES) * sum(COUNTS.values()) >= 100_000


@pytest.mark.few(
    "1-inside-plain-10",
    "1-inside-badly scaled-10",
    "1-anywhere-plain-10",
    "1-thin-plain-10",
    "1-thin-badly scaled-10",
    "1-vertex-plain-10",
    "1-vertex-badly scaled-10",
    "1-repeated-plain-10",
    "1-repeated-badly scaled-10",
    "1-boxed-plain-10",
    "1-boxed-badly scaled-10",
    "3-inside-plain-10",
    "3-inside-badly scaled-10",
    "3-vertex-plain-10",
    "3-vertex-badly scaled-10",
)
@pytest.mark.parametrize("share", [10, pytest.param(1, marks=pytest.mark.heavy)])
@pytest.mark.parametrize("badly_scaled", [False, True], ids=["plain", "badly scaled"])
@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.__name__)
@pytest.mark.parametrize("inputs", COUNTS)
def test_nearest_input_is_that_of_an_interior_point_solver(inputs, family, badly_scaled, share):
    """Verdict, objective and violation; where none is admissible least slack and hard bounds.

    An objective as good without a violation is the same point: it is strictly convex.
    """
    cases = programs(family, inputs, badly_scaled, COUNTS[inputs] // share)
    decided = [agrees(*pair) for pair in zip(cases, answers(cases), strict=True)]
    assert decided.count(False) <= (0.01 if share == 1 else 0.03) * len(cases)  # few: they scatter


@pytest.mark.few("plain-1")
@pytest.mark.parametrize("inputs", [1, 2, 3])
@pytest.mark.parametrize("badly_scaled", [False, True], ids=["plain", "badly scaled"])
def test_least_slack_is_that_of_a_linear_program(inputs, badly_scaled):
    """min t subject to a u <= b + t for the rows that may be relaxed, by HiGHS."""
    cases = programs(opposed, inputs, badly_scaled, 200)
    compared = 0
    for case, answer in zip(cases, answers(cases), strict=True):
        a, b, _, size = normalised(case)
        hard, unit = case[2], size[case[2] :].max(initial=0.0)
        found = linprog(
            np.append(np.zeros(inputs), 1.0),
            A_ub=np.column_stack([a, np.append(np.zeros(hard), -unit / size[hard:])]),
            b_ub=b,
            bounds=[(None, None)] * inputs + [(0, None)],
            options={"primal_feasibility_tolerance": 1e-10},
        )
        if math.isinf(answer[-1]):
            assert found.status == 2  # infeasible
        else:
            assert answer[-1] == pytest.approx(found.fun * unit, rel=1e-9, abs=1e-9 * unit)
            compared += 1
    assert compared > 100


# -- exact cases, each by machine code and by Python


@pytest.fixture(params=["compiled", "interpreted"])
def keep_within(request):
    """The solver as closed loops call it: machine code, or the same text by Python."""

    def keep(wanted, rows, hard=0, scales=None):
        m = len(wanted)
        wanted, scales = np.array(wanted, dtype=float), np.array(scales or [1.0] * m)
        flat = np.array(rows, dtype=float).ravel()
        if request.param == "compiled":
            counts = np.array([len(rows)]), np.array([hard])
            return solved(wanted[np.newaxis], scales[np.newaxis], flat[np.newaxis], *counts)[0]
        room, whole = numbers_of_programs(m, len(rows))
        given, counts = np.empty(m + 1), np.empty(whole, dtype=np.int64)
        with np.errstate(invalid="ignore"):
            given[m] = quadratic_program.keep_within(
                wanted, scales, flat, m, len(rows), hard, given, np.empty(room), counts
            )
        return given

    return keep


BOX = ((1, 0, 1), (-1, 0, 1), (0, 1, 1), (0, -1, 1))


def test_admissible_input_is_given_back_to_the_last_digit(keep_within):
    for wanted in ((0.1 + 0.2, -1.0), (-0.9, 0.7)):  # -0.9 / 3 * 3 is another number
        assert keep_within(wanted, BOX, 4, scales=(3.0, 0.3)).tolist() == [*wanted, 0.0]


def test_input_moves_to_one_plane_along_the_squares_of_the_scales(keep_within):
    """u = w - S^2 n (n . w - b) / (n . S^2 n), S the scales."""
    n, b, w, s = np.array([2.0, -1.0]), 0.5, np.array([3.0, 1.0]), np.array([0.3, 4.0])
    expected = w - s**2 * n * (n @ w - b) / (n @ (s**2 * n))
    assert keep_within(w, [(*n, b)], scales=s.tolist()) == pytest.approx(
        [*expected, 0.0], abs=1e-13
    )


def test_input_beyond_a_corner_goes_to_the_corner(keep_within):
    assert keep_within((5.0, -7.0), BOX, 4).tolist() == [1.0, -1.0, 0.0]
    oblique = (*BOX, (1, 1, 1))  # the corner of u2 <= 1 and u1 + u2 <= 1
    assert keep_within((0.5, 9.0), oblique, 4) == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)


@pytest.mark.parametrize("size", [1e4, 1e8, 1e12])
def test_bounds_hold_however_large_the_wanted_input_is(keep_within, size):
    """Hard rows and rows that may be relaxed, feasible and not."""
    wanted = (0.6 * size, -0.8 * size)
    turned = [(0.6, 0.8, 1), (-0.6, -0.8, 1), (0.8, -0.6, 1), (-0.8, 0.6, 1)]
    corner = (0.8 - 0.6, -0.6 - 0.8)
    assert keep_within(wanted, turned, 4) == pytest.approx([*corner, 0.0], abs=1e-14)
    other = (0.8 + 0.6, -0.6 + 0.8)
    given = keep_within(wanted, [*turned, (-0.6, -0.8, -2)], 4)
    assert given == pytest.approx([*other, 1.0], abs=1e-9)


def test_bounds_hold_beside_a_faint_row_that_cannot_be_met(keep_within):
    """Where a value is as good as flat its row is 1e-9 against a level of 1."""
    bounds = [(1, 0, 1.49), (-1, 0, 1.46), (0, 1, 1.19), (0, -1, 0.669)]
    generator = np.random.default_rng(0)
    for size in 10 ** generator.uniform(-14, -4, 300):
        angle = generator.uniform(0, 2 * np.pi)
        faint = (size * math.cos(angle), size * math.sin(angle), -0.6)
        wanted = generator.uniform(-3, 3, 2)
        first, second, slack = keep_within(tuple(wanted), [*bounds, faint], 4)
        assert -1.46 - 1e-9 <= first <= 1.49 + 1e-9
        assert -0.669 - 1e-9 <= second <= 1.19 + 1e-9
        assert slack > 0.5


def test_rows_that_cannot_all_be_met_share_the_least_slack(keep_within):
    """u1 <= -1 and u1 >= 2 by 1.5 each; what does not matter to them stays as it was wanted."""
    conflict = [(1, 0, -1), (-1, 0, -2)]
    assert keep_within((9.0, 0.3), conflict) == pytest.approx([0.5, 0.3, 1.5], abs=1e-9)
    bounded = [(1, 0, 0.25), *conflict]  # u1 <= 1/4, which is hard
    assert keep_within((9.0, 0.3), bounded, 1) == pytest.approx([0.25, 0.3, 1.75], abs=1e-9)


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1e3, 1e6])
def test_least_slack_is_found_whatever_the_units_are(keep_within, size):
    conflict = [(size, 0, -size), (-size, 0, -2 * size)]
    given = keep_within((9.0, 0.3), conflict)
    assert given == pytest.approx([0.5, 0.3, 1.5 * size], rel=1e-9)


def test_row_without_inputs_asks_for_its_own_slack_or_is_out_of_reach(keep_within):
    nothing, wall = (0, 0, -1), (1, 0, 0.5)
    assert keep_within((2.0, 1.0), [nothing, wall]) == pytest.approx([1.5, 1.0, 1.0], abs=1e-9)
    assert keep_within((2.0, 1.0), [nothing, wall], 1)[2] == math.inf
    assert keep_within((2.0, 1.0), [(0, 0, 0), wall], 1).tolist() == [0.5, 1.0, 0.0]


def test_rows_as_good_as_parallel_are_not_kept_further_apart_than_asked(keep_within):
    """u2 <= 0 and u2 >= 9e-10 (100 - u1): (150, 0) is admissible, and nearest to (150, 5)."""
    rows = [(-9e-10, -1.0, -9e-8), (0.0, 1.0, 0.0)]
    for order in (rows, rows[::-1]):
        assert keep_within((150.0, 5.0), order) == pytest.approx([150.0, 0.0, 0.0], abs=1e-6)


def test_bounds_that_exclude_each_other_have_infinite_slack(keep_within):
    """And the wanted input, which the actuators clip, stays."""
    for inputs in (1, 2, 3):
        rest = [0.0] * (inputs - 1)
        rows = [(1, *rest, -1), (-1, *rest, -1), (1, *rest, 5)]
        wanted = [0.5] * inputs
        assert keep_within(wanted, rows, 2).tolist() == [*wanted, math.inf]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_not_a_number_stays_so(keep_within, bad):
    """In the wanted input, a normal or an offset: the run then ends as diverged."""
    assert np.isnan(keep_within((bad, 0.0), BOX, 4)).all()
    assert np.isnan(keep_within((2.0, bad), BOX, 4)).all()
    assert np.isnan(keep_within((2.0, 0.5), [*BOX, (bad, 0.0, 1.0)], 4)).all()
    assert np.isnan(keep_within((2.0, 0.5), [*BOX, (1.0, 0.0, -bad)], 4)).all()
    assert np.isnan(keep_within((0.0, 0.5), [*BOX, (1.0, 0.0, -bad)], 4)).all()


@pytest.mark.parametrize("inputs", [1, 2, 3])
def test_machine_code_and_python_agree_to_the_last_bit(keep_within, inputs):
    """Rows of every family, six at most."""
    for family in FAMILIES:
        cases = programs(family, inputs, False, 12)
        cases = [(a[:6], b[:6], min(hard, 6), w, s) for a, b, hard, w, s in cases]
        for (a, b, hard, w, s), expected in zip(cases, answers(cases), strict=True):
            given = keep_within(w, np.column_stack([a, b]), hard, s.tolist())
            assert np.array_equal(given, expected, equal_nan=True)


def test_four_inputs_are_within_its_reach():
    cases = programs(inside, 4, True, 200) + programs(anywhere, 4, True, 200)
    decided = [agrees(*pair) for pair in zip(cases, answers(cases), strict=True)]
    assert decided.count(False) <= 8


def test_slack_has_the_size_of_the_smallest_normal():
    rows = np.array([3.0, 4.0, 0.0, 0.3, 0.4, 0.0, 0.0, 0.0, 1.0])
    assert quadratic_program.unit_of_slack(rows, np.ones(2), 2, 3, 0) == pytest.approx(0.5)
    assert quadratic_program.unit_of_slack(rows, np.ones(2), 2, 3, 1) == pytest.approx(0.5)
    assert quadratic_program.unit_of_slack(rows, np.ones(2), 2, 1, 0) == pytest.approx(5.0)
    assert quadratic_program.unit_of_slack(rows, np.array([1.0, 2.0]), 2, 3, 1) == pytest.approx(
        math.hypot(0.3, 0.8)
    )


@pytest.mark.parametrize(
    ("soft", "overruled"),
    [((1.0, 1.0), True), ((1.0, 1.5), False), ((0.0, 0.0), False), ((0.0, 1.0), False)],
    ids=["at its limit", "beyond it", "without inputs", "without inputs, and kept"],
)
def test_condition_overrules_where_it_holds_the_input_back_and_not_where_its_bounds_do(
    soft, overruled
):
    """The wanted 2 is limited to 1 by its bounds, which come first."""
    rows = np.array([1.0, 1.0, *soft])
    arguments = np.array([2.0]), np.array([1.0]), 0.0, rows, 1, 2, 1
    assert quadratic_program.overrules(*arguments) is overruled
