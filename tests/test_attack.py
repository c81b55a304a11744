"""The engine that attacks (benchmarks/attacks): its oracle against known sets, its first minute.

What it finds in longer runs is on the page docs/attacks.md. Everything here is by count, not by time.
"""

import itertools
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from attacks import (
    certificates,
    engine,
    filters,
    forgeries,
    games,
    identification,
    kernels,
    maps,
    planted,
    scenario_files,
    sure_sets,
    writing,
)
from attacks.case import Fault, Outcome
from attacks.enclosures import ENCLOSED, NUMBERS, between, enclose_all, read
from attacks.oracle import brackets, hull_of, moved, pieces, points
from attacks.problems import Problem, problem, problem_of
from scipy.optimize import brentq


def problem_in(rates, region, inputs, disturbances, half, kind="kernel", goal="x", horizon=30.0):
    """A problem on a box around zero."""
    n = len(rates)
    return Problem(
        kind, "known", tuple(rates), tuple(region), (goal,), {}, inputs, disturbances, (False,) * n,
        tuple(-h for h in half), tuple(half), (41,) * n, horizon, scales=(1.0,) * n,
    )  # fmt: skip


def line_exact(x):
    return np.abs(x[0]) <= 0.1


def cart_exact(x):
    return np.abs(x[0] + np.sign(x[1]) * x[1] ** 2 / 1.6) <= np.where(np.abs(x[0]) <= 1, 1, -1)


KNOWN = {
    "a line that grows": (
        problem_in(["x + u0 + d0"], ["abs(x) - 1"], ["box", [-0.6], [0.6]], ["box", [-0.5], [0.5]], [1.3]),
        line_exact, 2000,
    ),
    "a cart that brakes": (
        problem_in(["y", "u0 + d0"], ["abs(x) - 1"], ["box", [-1.0], [1.0]], ["box", [-0.2], [0.2]], [1.3, 2]),
        cart_exact, 100,
    ),
    "a disc of inputs": (
        problem_in(["x + u0", "y + u1"], ["abs(x) - 2", "abs(y) - 2"], ["ball", 1.0, 2], None, [2.3, 2.3]),
        lambda x: np.hypot(*x) <= 1, 80,
    ),
    "time to an interval": (
        problem_in(["u0"], ["abs(x) - 1"], ["box", [-1.0], [1.0]], None, [1.2], "basin", "abs(x) - 0.1", 0.5),
        lambda x: np.abs(x[0]) <= 0.6, 1000,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", KNOWN)
def test_brackets_hold_the_exact_set_between_them(name):
    p, exact, count = KNOWN[name]
    sure = brackets(p, count, math.inf if p.kind == "kernel" else p.horizon)
    lines = [
        a + w * (np.arange(n) + 0.5)
        for a, w, n in zip(sure.low, sure.size, sure.outer.shape, strict=True)
    ]
    inside = exact(np.array([m.ravel() for m in np.meshgrid(*lines, indexing="ij")]))
    assert not (inside & ~sure.outer.ravel()).any()
    assert not (sure.inner.ravel() & ~inside).any()
    volume = np.prod(sure.size) * inside.sum()
    assert sure.outer.sum() * np.prod(sure.size) < 2.5 * volume
    assert sure.inner.sum() * np.prod(sure.size) > 0.5 * volume


def test_brackets_lie_within_a_cell_of_a_grid_of_the_exact_set():
    p, exact, _ = KNOWN["a cart that brakes"]
    sure = brackets(p, None, math.inf)
    g = np.random.default_rng(0)
    x = g.uniform(p.low, p.high, (4000, 2)).T
    wide = p.cells[:, None]
    around = [
        exact(x + wide * np.array(c)[:, None]) for c in itertools.product((-1, 0, 1), repeat=2)
    ]
    surely_in, surely_out = np.all(around, axis=0), ~np.any(around, axis=0)
    decided = np.where(surely_in, sure.all_inner(x, x), sure.none_outer(x, x))
    assert decided[surely_in | surely_out].mean() > 0.97


@pytest.mark.heavy
def test_a_set_that_is_empty_though_it_falls_slowly_is_called_lost():
    """x' = 1 - 1.3 m, y' = -.3 + .35 m: .23 x + y falls by .019 a second at least, whatever m is."""
    p = problem_in(
        ["1 - 1.3*u0", "0.35*u0 - 0.3"],
        ["-x", "x - 1", "-y", "y - 1"],
        ["box", [0.0], [1.0]],
        None,
        [1.1, 1.1],
    )
    assert not brackets(p, 280, math.inf).outer.any()


FORMULAS = [
    "sin(x)*cos(2*y)",
    "max(x, y)*abs(x - y)",
    "min(x*y, 0.2)**2",
    "sqrt(x**2 + y**2 + 1)/3",
    "x*abs(x) - y",
]


@pytest.mark.parametrize("formula", FORMULAS)
def test_enclosures_hold_values_and_slopes(formula):
    g = np.random.default_rng(0)
    low = g.uniform(-2, 2, (2, 300))
    high = low + g.uniform(0, 1, low.shape)
    boxes = {n: between(a, b, i) for i, (n, a, b) in enumerate(zip("xy", low, high, strict=True))}
    value, slopes = enclose_all([formula], boxes, (300,), 2)
    for _ in range(30):
        at = low + g.random(low.shape) * (high - low)
        v = read(formula, dict(zip("xy", at, strict=True)), NUMBERS)
        assert (value[0][0] <= v + 1e-12).all()
        assert (v <= value[1][0] + 1e-12).all()
        for i in range(2):
            step = np.zeros_like(at)
            step[i] = 1e-7 * np.where(at[i] < (low[i] + high[i]) / 2, 1, -1)
            slope = (read(formula, dict(zip("xy", at + step, strict=True)), NUMBERS) - v) / step[i]
            assert (slopes[0][0, i] - 1e-5 <= slope).all()
            assert (slope <= slopes[1][0, i] + 1e-5).all()
    assert set(ENCLOSED) == set(NUMBERS)


@pytest.mark.parametrize(
    "bound",
    [
        ["box", [-1, 0.2], [0.5, 1]],
        ["ball", 0.7, 2],
        ["image", [[0.5, 0.5], [1, -1]], [-1, -1], [1, 1]],
    ],
    ids=str,
)
def test_pieces_cover_a_bound_and_stay_in_its_hull(bound):
    members = points(bound, 7)
    middles, half = pieces(bound, 5)
    inside = (np.abs(members[:, None] - middles) <= half + 1e-12).all(axis=2)
    assert inside.any(axis=1).all()
    low, high = hull_of(bound)
    assert (middles - half >= low - 1e-12).all()
    assert (middles + half <= high + 1e-12).all()


def test_the_integrator_is_that_of_a_pendulum():
    p = problem_in(["y", "0 - x"], ["abs(x) - 2"], None, None, [2, 2])
    x = moved(p, np.array([[1.0], [0.0]]), (), (), math.pi, 200)
    assert x[:, 0] == pytest.approx([-1, 0], abs=1e-8)


def test_a_problem_follows_from_seed_and_number_and_survives_json():
    assert problem(3, 41) == problem(3, 41)
    assert problem(3, 41) != problem(4, 41)
    assert problem_of(problem(3, 41).plain()) == problem(3, 41)


def test_problems_in_a_row_have_one_structure():
    first, *others = [problem(2, 16 + k) for k in range(8)]
    assert all((p.rates, p.region) == (first.rates, first.region) for p in others)
    assert len({tuple(p.numbers.values()) for p in others}) > 1


# -- what judges, judged ----------------------------------------------------------------------------


class Claimed:
    """A value function that keeps what it is told to."""

    def __init__(self, p, keeps):
        class Report:
            converged = True

        class Axis:
            def __init__(self, nodes):
                self.nodes = nodes

        class Grid:
            axes = tuple(
                Axis(np.linspace(a, b, n)) for a, b, n in zip(p.low, p.high, p.nodes, strict=True)
            )

        self.report, self.grid = Report, Grid
        self._v = keeps(np.meshgrid(*(a.nodes for a in Grid.axes), indexing="ij"))

    def values(self):
        return self._v


@pytest.mark.slow("0.0-None")
@pytest.mark.parametrize(
    ("shift", "what"), [(0.0, None), (0.45, "kept but lost"), (-0.5, "lost but kept")]
)
def test_a_set_that_is_too_large_or_too_small_is_seen_and_a_right_one_is_not(shift, what):
    p, _, _ = KNOWN["a cart that brakes"]
    claimed = Claimed(
        p,
        lambda x: (
            np.minimum(1 - abs(x[0]), 1 - abs(x[0] + np.sign(x[1]) * x[1] ** 2 / 1.6)) + shift
        ),
    )
    found = kernels.judge(p, None, claimed)
    assert {k for k in kernels.VERDICTS if found[k]} == ({what} if what else set())


def test_a_set_behind_a_pocket_that_no_cell_has_is_not_asked_for():
    """x' = a(x) + .595 u: from x = .091 to x = .65 every input leads to the right, and between there
    and the constraint, .09 of a cell further, a state can stay. The rates decide that, not an oracle."""
    numbers = {"p0": 0.611, "p1": 0.439, "p2": 0.595, "p4": 1.73, "p5": 0.479}
    p = Problem(
        "kernel", "ring", ("p0*sin(x) + p1*cos(2*x) + p2*u0",), ("cos(x - p4) - p5",), (),
        numbers, ["box", [-0.82], [0.501]], None, (True,), (-math.pi,), (math.pi,), (52,), 30.0,
        scales=(1.0,),
    )  # fmt: skip

    def slowest(x):
        return 0.611 * math.sin(x) + 0.439 * math.cos(2 * x) - 0.595 * 0.82

    wall = 1.73 - math.acos(0.479)
    pocket = wall - brentq(slowest, 0.5, wall)
    assert min(map(slowest, np.linspace(0.1, 0.6, 200))) > 0 > slowest(wall)
    assert pocket == pytest.approx(0.088 * p.cells[0], abs=0.002 * p.cells[0])
    behind = np.array([[0.3]])
    assert brackets(p, horizon=30.0).all_inner(behind, behind)[0]
    assert not brackets(p, horizon=30.0, narrower=p.cells).all_inner(behind, behind)[0]


@pytest.mark.few("416-eno3")
@pytest.mark.parametrize(
    ("number", "scheme"),
    [
        (416, "eno3"),
        (1086, "upwind"),
        (48, "eno2"),
        (1752, "weno5"),
        (7746, "eno3"),
    ],
)
def test_a_kernel_that_the_engine_found_wrong_is_right(number, scheme):
    assert problem(1, number).scheme == scheme
    assert kernels.attempt(1, number).faults == []


def test_intervals_that_hold_too_seldom_are_seen():
    assert identification.chance_of_at_most(95, 100, 0.95) > 0.3
    assert not identification.conclude([(0, "a", k % 20 != 0) for k in range(400)])
    assert identification.conclude([(0, "a", k % 6 != 0) for k in range(400)])


@pytest.mark.heavy
def test_a_fault_is_made_smaller_and_its_file_runs_alone(tmp_path):
    least = writing.shrunk(
        list(range(40)), lambda v: (v[:k] + v[k + 1 :] for k in range(len(v))), lambda v: 7 in v
    )
    assert least == [7]
    fault = Fault(f"{kernels.VERDICTS['kept but lost']}; stays", "told")
    modules = ("case", "enclosures", "problems", "oracle", "product", "writing", "kernels")
    fault.text = writing.alone(
        "a title",
        modules,
        "print(judge(p := problem(1, 3), b := Built(p), b.solve())['nodes'] > 0)\n",
    )
    path = tmp_path / "fault.py"
    path.write_text(fault.text, "utf-8")
    ran = subprocess.run(
        [sys.executable, str(path)], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert ran.stdout.strip() == "True", ran.stderr


def test_a_table_says_what_was_refused_and_what_is_wrong():
    tally = engine.Tally(kernels.KIND)
    tally.add(0, Outcome(judged=1, counts={"nodes": 5}), 0.1)
    tally.add(1, Outcome(refused="too small"), 0.1)
    tally.add(2, Outcome(judged=1, faults=[Fault("wrong", "much")]), 0.1)
    text = engine.table({"kernels": tally})
    assert re.search(r"kernels \| 3 \| 2 \(5 nodes\) \| 33.3 % \| 1 ", text)
    assert "wrong (first: case 2)" in text
    assert '"refused": 1' in engine.as_json({"kernels": tally}, 1)


def test_tables_of_several_runs_add_up(tmp_path):
    paths = [tmp_path / "one.json", tmp_path / "other.json"]
    for path, number in zip(paths, (3, 5), strict=True):
        tally = engine.Tally(kernels.KIND)
        tally.add(number, Outcome(judged=1, counts={"nodes": 5}), 0.1)
        tally.add(number, Outcome(refused="too small"), 0.1)
        tally.add(number, Outcome(faults=[Fault("wrong", "much")]), 0.1)
        path.write_text(engine.as_json({"kernels": tally}, 1), "utf-8")
    both = engine.summed(paths)
    assert list(both) == ["kernels"]
    assert both["kernels"].plain() == tally.plain() | {
        "cases": 6, "judged": 2, "refused": 2, "refused_by": {"too small": 2}, "first_refused": {"too small": 3},
        "faults": {"wrong": 2}, "counts": {"nodes": 10}, "cpu_s": 0.6, "first": {"wrong": 3},
    }  # fmt: skip


def test_page_has_the_table_of_the_counts_that_are_kept():
    root = Path(__file__).parents[1]
    told = engine.table(engine.summed([root / "benchmarks" / "attacks.json"])).splitlines()
    page = (root / "docs" / "attacks.md").read_text("utf-8").splitlines()
    rows = [line for line in told if line.startswith("|")]
    begin = page.index(rows[0])
    assert page[begin : begin + len(rows)] == rows


@pytest.mark.heavy
def test_a_case_that_takes_too_long_is_a_fault_and_its_process_is_replaced():
    worker = engine.Worker()
    try:
        worker.give(kernels.KIND, 1, 0)
        assert worker.end_if_late() is None
        worker.deadline = 0.0
        outcome, _ = worker.end_if_late()
        assert [f.signature for f in outcome.faults] == ["longer than its time limit"]
        worker.give(identification.KIND, 1, 0)
        outcome, _ = worker.answer()
        assert outcome.judged == 1
    finally:
        worker.close()


@pytest.mark.heavy
def test_every_breakage_that_is_planted_is_found_within_its_number_of_cases():
    assert len(planted.BREAKAGES) == 14
    assert planted.prove() == 0


# -- the fixed first minute --------------------------------------------------------------------------

FIRST_MINUTE = {
    kernels.KIND: range(0, 24),
    filters.KIND: range(0, 16),
    certificates.KIND: range(0, 16),
    forgeries.KIND: range(8, 12),
    sure_sets.KIND: range(0, 8),
    identification.KIND: range(0, 12),
    scenario_files.KIND: range(0, 80),
    games.KIND: range(0, 8),
    maps.KIND: range(0, 12),
}
"""Cases of seed 1, of which every fast run tries one in four."""


@pytest.mark.few("forged certificates-4")
@pytest.mark.parametrize("share", [4, pytest.param(1, marks=pytest.mark.heavy)])
@pytest.mark.parametrize("kind", FIRST_MINUTE, ids=lambda k: k.name)
def test_no_claim_falls_in_the_first_minute_of_attacks(kind, share):
    cases = FIRST_MINUTE[kind]
    outcomes = {n: kind.attempt(1, n) for n in cases[::share]}
    faults = {n: [f.signature for f in o.faults] for n, o in outcomes.items() if o.faults}
    assert not faults
    assert sum(o.judged for o in outcomes.values()) > len(outcomes) / 4
    assert not kind.conclude([note for o in outcomes.values() for note in o.notes])
