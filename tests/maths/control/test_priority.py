"""Several filters in order: the last gives way first, and the decision says which did."""

import math

import clarabel
import numpy as np
import pytest
from scipy import sparse

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.simulation.quadratic_program import keep_in_order, numbers_of_programs
from tests.c_code import built, needs_gcc, pointer

X, Y = hf.symbol("x"), hf.symbol("y")


@pytest.fixture(scope="module")
def point():
    """x' = u + d, y' = w, |u|, |w| <= 1."""
    u, w = hf.symbol("u"), hf.symbol("w")
    return hf.System(
        "point", (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Quantity("u", "m/s"), hf.Quantity("w", "m/s")), {"x": u, "y": w},
        input_bounds=hf.Box((-1, -1), (1, 1)),
    )  # fmt: skip


def half_plane(system, name, expression):
    return hf.Region(name, system.states, (hf.Inequality(name, expression, "m"),))


def test_last_filter_gives_way_first_and_is_named(point):
    """x <= 0 and x >= 1 exclude each other: u <= -x, or u >= 1 - x, with gains of 1 / s."""
    left, right = half_plane(point, "left", X), half_plane(point, "right", 1 - X)
    for keep, wanted, gave in (((left, right), -0.5, "right"), ((right, left), 0.5, "left")):
        decision = hf.SafetyFilter(point, keep).step([0.5, 0.0], [0.1, 0.3])
        assert decision.status is hf.Status.INFEASIBLE
        assert decision.input == pytest.approx([wanted, 0.3], abs=1e-7)
        assert decision.slack == pytest.approx(1.0, rel=1e-7)
        assert decision.gave_way == (gave,)
        assert f"'{gave}' gave way" in decision.why
    together = hf.SafetyFilter(point, hf.both(left, right)).step([0.5, 0.0], [0.1, 0.3])
    assert together.input == pytest.approx([0.0, 0.3], abs=1e-7)
    assert together.gave_way == ("left", "right")


def test_where_all_can_be_kept_the_order_does_not_matter(point):
    floor, wall = half_plane(point, "floor", -Y), half_plane(point, "wall", X - 1)
    filters = [hf.SafetyFilter(point, keep) for keep in ((floor, wall), (wall, floor))]
    joint = hf.SafetyFilter(point, hf.both(floor, wall))
    for state, command in zip(
        np.random.default_rng(0).uniform([-1, 0], [1, 1], (200, 2)),
        np.random.default_rng(1).normal(size=(200, 2)),
        strict=True,
    ):
        first, second, both = (f.step(state, command) for f in (*filters, joint))
        assert first.input == pytest.approx(both.input, abs=1e-12)
        assert second.input == pytest.approx(both.input, abs=1e-12)
        assert first.gave_way == ()
        assert first.value == pytest.approx(state[1])
        assert second.value == pytest.approx(1 - state[0])


@pytest.mark.heavy
def test_kernel_comes_before_what_is_only_wanted(point):
    """The kernel of a corridor, then a request that leads out of it."""
    corridor = half_plane(point, "corridor", X - 1)
    open_ends = {"x": "extrapolated", "y": "extrapolated"}
    over = hf.grid(point, {"x": (-2, 1.5), "y": (-1, 1)}, 36, open_ends)
    value = hf.viability_kernel(point, corridor, over, 0.5)
    out = half_plane(point, "out", 3 - X)
    with pytest.warns(hf.PromiseFellShortWarning, match="touches the open ends of the grid"):
        keep = hf.SafetyFilter(point, [value, out], rate=1.0, margin=0.05)
    decision = keep.step([0.9, 0.0], [0.0, 0.0])
    assert decision.status is hf.Status.INFEASIBLE
    assert decision.gave_way == ("out",)
    assert decision.input[0] == pytest.approx(decision.value - 0.05, abs=1e-6)
    assert decision.value == pytest.approx(0.1, abs=0.02)
    other = hf.SafetyFilter(point, [out, value], rate=1.0, margin=0.05)
    assert other.step([0.9, 0.0], [0.0, 0.0]).gave_way == ("out",), "V stays above its margin"
    lost = other.step([0.94, 0.0], [0.0, 0.0])
    assert lost.gave_way == ("out", "value"), "the first cannot be met either"
    assert lost.input[0] == pytest.approx(1.0, abs=1e-6)


# -- the program, against an interior-point solver level by level


def lexicographic(wanted, rows, ends, hard):
    """The least slack of every level in turn, by Clarabel, and the nearest input."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    a, b = rows[:, :-1], rows[:, -1].copy()
    m, slacks = a.shape[1], []
    begin = hard
    for end in ends:
        eased = np.zeros(end)
        eased[begin:] = 1.0
        lines = np.vstack([np.column_stack([a[:end], -eased]), np.append(np.zeros(m), -1.0)])
        cost = np.append(np.zeros(m), 1.0)
        found = clarabel.DefaultSolver(
            sparse.csc_matrix((m + 1, m + 1)), cost, sparse.csc_matrix(lines),
            np.append(b[:end], 0.0), [clarabel.NonnegativeConeT(end + 1)], settings,
        ).solve()  # fmt: skip
        slacks.append(max(found.x[m], 0.0))
        b[begin:end] += slacks[-1] + 1e-8
        begin = end
    found = clarabel.DefaultSolver(
        sparse.csc_matrix(2 * np.eye(m)), -2 * wanted, sparse.csc_matrix(a), b,
        [clarabel.NonnegativeConeT(len(b))], settings,
    ).solve()  # fmt: skip
    return np.array(slacks), np.array(found.x)


def kept_in_order(wanted, rows, ends, hard):
    m = len(wanted)
    room, whole = numbers_of_programs(m, len(rows))
    given, counts = np.empty(m), np.empty(whole, dtype=np.int64)
    flat = rows.ravel().copy()
    slack = keep_in_order(
        wanted, np.ones(m), flat, m, len(rows), hard, np.array(ends), len(ends), given,
        np.empty(room), counts,
    )  # fmt: skip
    return slack, given


@pytest.mark.few("1")
@pytest.mark.parametrize("m", [1, 2, 3])
def test_levels_are_relaxed_as_little_as_those_before_them_allow(m):
    rng, relaxed = np.random.default_rng(m), 0
    for _ in range(150):
        box = np.vstack([np.column_stack([s * np.eye(m), np.ones(m)]) for s in (1, -1)])
        sizes = rng.integers(1, 4, size=rng.integers(2, 5))
        free = rng.normal(size=(sizes.sum(), m))
        free /= np.linalg.norm(free, axis=1)[:, np.newaxis]
        rows = np.vstack([box, np.column_stack([free, rng.normal(size=len(free)) - 0.5])])
        ends = (2 * m + np.cumsum(sizes)).tolist()
        wanted = 2 * rng.normal(size=m)
        # both leave a little room, which narrow sets magnify
        slacks, nearest = lexicographic(wanted, rows, ends, 2 * m)
        slack, given = kept_in_order(wanted, rows, ends, 2 * m)
        assert (np.abs(given) <= 1 + 1e-9).all()
        assert slack == pytest.approx(slacks.max(), abs=1e-5)
        allowed = np.repeat(slacks, sizes)
        assert (rows[2 * m :, :-1] @ given - rows[2 * m :, -1] <= allowed + 1e-5).all()
        assert ((given - wanted) ** 2).sum() <= ((nearest - wanted) ** 2).sum() + 1e-3
        relaxed += slacks.max() > 1e-3
    assert relaxed > 50


def test_one_level_shares_its_slack_and_bounds_that_exclude_each_other_have_none():
    rows = np.array([[1.0, 1], [-1, 1], [1, 0], [-1, -1]])
    assert kept_in_order(np.array([0.4]), rows, [3, 4], 2)[1] == pytest.approx([0.0], abs=1e-8)
    assert kept_in_order(np.array([0.4]), rows, [4], 2)[1] == pytest.approx([0.5], abs=1e-8)
    wall = np.array([[1.0, 1], [-1, 1], [0, -1]])
    assert kept_in_order(np.array([0.4]), wall, [3], 3)[0] == math.inf


@needs_gcc
def test_order_in_c_has_the_same_bits(point, tmp_path):
    keep = hf.SafetyFilter(
        point, [half_plane(point, "left", X), half_plane(point, "right", 1 - X),
                half_plane(point, "low", Y - 0.2)],
    )  # fmt: skip
    c = built(tmp_path, keep.export_c("keep") + ONE, "keep")
    rng = np.random.default_rng(0)
    states, commands = rng.normal(size=(500, 2)), rng.normal(size=(500, 2))
    found = keep.step_many(states, commands)
    assert sum(s is hf.Status.INFEASIBLE for s in found.status) > 300
    for k in range(500):
        answer = np.zeros(5)
        c.one(pointer(states[k].copy()), pointer(commands[k].copy()), pointer(answer))
        assert answer[:2].tolist() == found.input[k].tolist()
        assert answer[4] == found.slack[k]


ONE = """
void one(const double *seen, const double *handed, double *answer) {
    keep_state s;
    keep_start(&s);
    keep_step(&s, 0.0, 0.02, seen, handed, keep_parameters, answer, answer + 2);
    answer[4] = s.slack;
}
"""


def test_name_of_a_law_says_how_many_filters_give_way(point):
    law = hf.commanded(point)
    guarded = [hf.safeguard(point, law, half_plane(point, n, X)) for n in ("a", "b", "c")]
    for count, more in ((1, ""), (2, ", then 1 more"), (3, ", then 2 more")):
        assert hf.in_order(guarded[:count]).name == guarded[0].name + more


def test_filters_that_do_not_go_together_are_refused(point):
    left = half_plane(point, "left", X)
    open_ends = {"x": "extrapolated", "y": "extrapolated"}
    over = hf.grid(point, {"x": (-1, 1), "y": (-1, 1)}, 9, open_ends)
    value = hf.viability_kernel(point, left, over, 0.1)
    for keep, said in (
        ([left, left], "two filters have an inequality 'left'"),
        ([], "there is nothing to keep"),
        ([value, value], "more than one kernel"),
        ([left, "right"], "keep is 'right'"),
        ([half_plane(point, f"h{k}", X - k) for k in range(7)], "7 filters; expected 1 to 6"),
    ):
        with pytest.raises(hf.HoldfastError, match=said):
            hf.SafetyFilter(point, keep)
    law = hf.commanded(point)
    other = hf.Law(
        "other",
        (),
        {"u": hf.symbol("command_u") * 2, "w": hf.symbol("command_w")},
        handed=law.handed,
    )
    with pytest.raises(DefinitionError, match="has no safety filter"):
        hf.in_order([law])
    with pytest.raises(DefinitionError, match="the filters are of different laws"):
        hf.in_order(
            [hf.safeguard(point, law, left), hf.safeguard(point, other, half_plane(point, "r", -X))]
        )
