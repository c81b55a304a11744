"""Cells that are halved near certified ones: what straight fine cells find, from fewer of them."""

import math
from functools import cache, partial

import flint
import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.certificates.cells import Cells, Halvings
from holdfast.analysis.certificates.certificate import ENTRY
from holdfast.analysis.certificates.certified_law import Proof
from holdfast.analysis.certificates.certify import settled_kept
from holdfast.analysis.certificates.images import BEST, Images
from holdfast.analysis.certificates.reading import unchecked
from holdfast.errors import OutputError, SimulationError
from holdfast.maths.expressions.functions import sgn
from holdfast_check.checker import BITS, Checker, NotValidError, check, read
from tests.adversary import most, moved, starts_in, worst_of
from tests.certified_systems import AHEAD, BOX, CART, LEFT, camera, cart, changed, view

STRONG = 0.45


def near(system):
    """Ahead by less than a metre."""
    return hf.Region("near", system.states, (hf.Inequality("d", AHEAD - 1.0, "m"),))


def lane():
    y, psi, r = (hf.symbol(n) for n in ("y", "psi", "r"))
    car = hf.System(
        "lane", (hf.Quantity("y", "m"), hf.Quantity("psi", "rad")), (hf.Quantity("r", "rad/s"),),
        {"y": sp.sin(psi), "psi": r}, input_bounds=hf.Box((-2.0,), (2.0,)),
    )  # fmt: skip
    rows = (hf.Inequality("a", y - 1, "m"), hf.Inequality("b", -y - 1, "m"))
    box = {"y": (-1, 1), "psi": (-math.pi, math.pi)}
    return car, hf.Region("lane", car.states, rows), {"box": box, "sample_time": 0.2}


PROBLEMS = {
    "view": lambda: (camera(), view(camera()), {"box": BOX}),
    "cart": lambda: (*cart(), {"box": CART, "sample_time": 0.2}),
    "lane": lane,
    "measured and late": lambda: (
        camera(), view(camera()), {"box": BOX, "errors": {"left": 0.005}, "delay": 0.01},
    ),
    "for a while": lambda: (camera(STRONG), view(camera()), {"box": BOX, "horizon": 0.6}),
    "to a target": lambda: (
        camera(), view(camera()), {"box": BOX, "target": near(camera()), "sample_time": 0.2},
    ),
    "to a target in time": lambda: (
        camera(), view(camera()),
        {"box": BOX, "target": near(camera()), "sample_time": 0.2, "horizon": 1.0},
    ),
}  # fmt: skip


@cache
def certified(name, cells, halvings=0):
    system, region, given = PROBLEMS[name]()
    return hf.certify(system, region, **given, cells=cells, halvings=halvings, steps=1)


def levels(found):
    """How much is promised of each of the smallest cells: more is more, -1 nothing."""
    promised = np.full(found.cells.total, -1)
    cell, _, level = found.kept.spread().T
    order = np.argsort(level)
    if found.target:
        order = order[::-1]
        level = 1000 - level
    promised[cell[order]] = level[order]
    return promised


@pytest.mark.few("cart")
@pytest.mark.parametrize("name", PROBLEMS)
def test_halved_cells_promise_what_cells_that_are_all_small_do(name):
    """Not less than whole cells, and what straight cells of the smallest size do, from fewer."""
    whole, halved, small = (certified(name, *n) for n in ((20, 0), (20, 2), (80, 0)))
    assert all(map(partial(np.allclose, rtol=1e-15), halved.cells.edges, small.cells.edges))
    assert halved.cells.counts == small.cells.counts == (80, 80)
    known, best = levels(halved), levels(small)
    grown = np.kron(levels(whole).reshape(20, 20), np.ones((4, 4), dtype=int)).reshape(-1)
    assert (known >= grown).all()
    members, asked = halved.kept.members, small.kept.region  # beyond it is the target
    assert (known <= best)[asked].all()
    if name == "to a target in time":  # whole cells are more holds away than small ones
        assert len(whole.kept.members) * 16 < len(np.intersect1d(members, asked))
    else:
        assert np.array_equal(np.intersect1d(members, asked), small.kept.members)
        assert len(halved.kept.entries) < 0.6 * len(small.kept.entries)


def test_where_nothing_is_found_all_cells_are_halved():
    assert not len(certified("cart", 20).kept.members)
    assert len(certified("cart", 20, 2).kept.members)


@pytest.mark.heavy
def test_file_of_halved_cells_is_read_back_and_is_valid(tmp_path):
    for name in PROBLEMS:
        found = certified(name, 20, 2)
        path = found.write(tmp_path / "halved.holdfast")
        read = hf.read_certificate(path)
        assert read.header() == found.header()
        for what in ("members", "inputs", "entries", "region"):
            assert np.array_equal(getattr(read.kept, what), getattr(found.kept, what)), what
        told = check(str(path), share=60 / len(found.kept.entries))
        assert told.startswith(f"{len(found.kept.members)} cells"), name


def test_every_entry_of_a_file_with_cells_of_three_sizes_is_valid(tmp_path):
    found = certified("view", 20, 2)
    assert set(found.kept.entries[:, 0] // found.cells.total) == {0, 1, 2}
    assert "entries hold" in check(str(found.write(tmp_path / "view.holdfast")))


def test_certificate_of_one_size_is_written_as_before():
    assert "depth" not in certified("view", 20).header()
    assert certified("view", 20, 2).header()["depth"] == 2


def test_target_that_only_small_cells_lie_in_is_reached():
    system, region, given = PROBLEMS["to a target"]()
    rows = (hf.Inequality("c", AHEAD - 1.0, "m"), hf.Inequality("d", 0.88 - AHEAD, "m"))
    strip = {**given, "target": hf.Region("strip", system.states, rows), "sample_time": 0.1}
    with pytest.raises(SimulationError, match="no cell lies in 'strip'"):
        hf.certify(system, region, **strip, cells=14)
    assert hf.certify(system, region, **strip, cells=14, halvings=2).kept.share > 0.5


def test_cell_outlasts_what_it_leads_to_by_one_hold():
    """Of two cells the first is kept for 3 holds, and the second leads there, however long."""
    block = np.zeros((1, 1, 1), dtype=np.int32)
    leads = Images(np.array([1]), block, block, np.ones((1, 1), dtype=bool))
    cells = Cells.even(((0.0, 1.0),), (2,), (False,))
    known = np.array([3, 0], dtype=np.int32)
    assert settled_kept(leads, cells, known, 9)[0].tolist() == [4]
    assert settled_kept(leads, cells, np.array([BEST, 0], dtype=np.int32), None)[0].tolist() == [
        BEST
    ]


# -- in closed loop ------------------------------------------------------------------------------


@cache
def proof(*of):
    return Proof(certified(*of))


def looked_up(z, *of):
    """The inputs of a certificate at places ahead + i left, and for how many holds they do."""
    last, inputs = proof(*of).looked_up(np.stack([z.real, z.imag], axis=1))
    return inputs, last / proof(*of).certificate.hold


def nearest_target(found, states):
    """The inputs of a certificate of a target, and how many holds it is away, -1 in none."""
    cell, tried, level = found.kept.spread().T
    table = np.full((found.cells.total, 2), -1)
    table[cell] = np.stack([tried, level], axis=1)
    place = [np.searchsorted(e, states[:, k], side="right") - 1
             for k, e in enumerate(found.cells.edges)]  # fmt: skip
    choice, level = table[np.ravel_multi_index(place, found.cells.counts, mode="clip")].T
    return found.candidates[choice], level


def edge_cells(found):
    """The smallest cells of all that were halved most."""
    rows = found.kept.entries
    return rows[rows[:, 0] < found.cells.total, 0]


def test_halved_cells_at_the_edge_are_never_left_whatever_pushes():
    """From all members, and from the smallest cells of all: 1,000 runs of 5 s each."""
    found = certified("view", 20, 2)

    def answer(states):
        inputs, level = looked_up(states @ [1, 1j], "view", 20, 2)
        assert (level == np.inf).all()
        return inputs

    assert worst_of(found, answer, 1000, 50, 5, 1) <= 0
    z = starts_in(found, edge_cells(found), 1000, 2)
    z = z[:, 0] + 1j * z[:, 1]
    for k in range(50):
        inputs = answer(np.stack([z.real, z.imag], axis=1))
        for _ in range(5):
            ends = moved(z[:, None], inputs[:, :1], inputs[:, 1:], PUSHES * 0.1, 0.02)
            z = ends[np.arange(len(z)), most(ends).argmax(axis=1)]
            assert most(z).max() <= 0, k


PUSHES = np.array([1 + 1.5j, 1 - 1.5j, -1 + 1.5j, -1 - 1.5j])


def test_halved_cells_keep_for_as_long_as_they_say():
    """From cells of every level, a corner of the disturbance that is worst or any, piece by piece."""
    found = certified("for a while", 20, 2)
    rng = np.random.default_rng(4)
    corners = np.array([complex(a, b) for a in (-STRONG, STRONG) for b in (-0.5, 0.5)])
    starts = starts_in(found, found.kept.spread()[:, 0], 3000, 5)
    z = starts[:, 0] + 1j * starts[:, 1]
    left = np.rint(looked_up(z, "for a while", 20, 2)[1])
    assert set(left.tolist()) == {1, 2, 3, 4, 5, 6}
    while (left > 0).any():
        inputs, level = looked_up(z, "for a while", 20, 2)
        assert (np.rint(level) >= left)[left > 0].all()
        for _ in range(10):
            ends = moved(z[:, None], inputs[:, :1], inputs[:, 1:], corners, 0.01)
            worst = np.where(rng.uniform(size=len(z)) < 0.7, most(ends).argmax(axis=1),
                             rng.integers(0, 4, len(z)))  # fmt: skip
            z = np.where(left > 0, ends[np.arange(len(z)), worst], z)
            assert most(z)[left > 0].max() <= 1e-12
        left = left - 1


def test_halved_cells_lead_to_the_target_in_the_time_that_they_say():
    found = certified("to a target", 20, 2)
    rng = np.random.default_rng(6)
    for cells in (found.kept.members, edge_cells(found)):
        starts = starts_in(found, cells, 3000, 7, corners=0)
        z = starts[:, 0] + 1j * starts[:, 1]
        before = np.full(len(z), np.inf)
        while (under_way := z.real > 1.0).any():
            inputs, level = nearest_target(found, np.stack([z.real, z.imag], axis=1))
            assert (level[under_way] >= 1).all()
            assert (level < before)[under_way].all()
            before = level
            for _ in range(10):
                push = 0.1 * PUSHES[rng.integers(0, 4, len(z))]
                away = 0.1 * PUSHES[np.where(z.imag > 0, 3, 2)]
                push = np.where(rng.uniform(size=len(z)) < 0.6, away, push)
                z = np.where(under_way, moved(z, *inputs.T, push, 0.02), z)
                assert most(z).max() <= 1e-12


def test_law_of_halved_cells_is_simulated_and_no_run_leaves_the_view():
    found = certified("view", 20, 2)
    result = hf.simulate(
        camera(), hf.certified_law(found, camera()), starts=starts_in(found, edge_cells(found), 500, 3),
        region=view(camera()), horizon=5.0, sample_time=0.1, substeps=20,
        disturbance={"wa": sgn(1.2 - AHEAD) / 10, "wb": -3 * sgn(LEFT) / 20},
    )  # fmt: skip
    assert result.outcomes["stayed"] == 500


def test_halved_cells_of_a_heading_that_turns_around_are_kept():
    system, region, _ = PROBLEMS["lane"]()
    found = certified("lane", 20, 2)
    starts = starts_in(found, found.kept.members, 500, 5, corners=0)
    starts[:, 1] += 2 * math.pi * np.arange(-2, 3).repeat(100)
    result = hf.simulate(
        system, hf.certified_law(found, system), starts=starts, region=region, horizon=10.0,
        sample_time=0.2, record_every=0.2, substeps=10,
    )  # fmt: skip
    assert result.outcomes["stayed"] == 500
    assert found.kept.share > certified("lane", 20).kept.share


def test_filter_of_halved_cells_lets_no_target_leave_the_view():
    """Commands at random, most of which lose it; the disturbance takes its worst corner."""
    keep = hf.CertifiedFilter(certified("view", 20, 2), camera())
    rng = np.random.default_rng(9)

    def answer(states):
        decided = keep.step_many(states, rng.uniform([-0.5, -0.8], [0.5, 0.8], states.shape))
        assert hf.Status.OUTSIDE_GRID not in decided.status
        return decided.input

    assert worst_of(certified("view", 20, 2), answer, 200, 30, 5, 10) <= 0


# -- what is wrong is found ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def braked():
    """Cells of two sizes."""
    return certified("cart", 15, 2)


def rows_of(raw):
    return np.frombuffer(raw, dtype=ENTRY).copy()


def with_row(number):
    """One more entry, which the checker reads first."""
    return lambda raw: np.append(np.array([(number, 0, 0)], ENTRY), rows_of(raw)).tobytes()


def test_leaf_too_many_is_found(braked, tmp_path):
    """A whole cell, a half and a quarter, fast towards the wall."""
    path = braked.write(tmp_path / "cart.holdfast")
    total, (across, along) = braked.cells.total, braked.cells.counts
    for doubled, blocks in ((0, 1), (1, 4), (2, 16)):
        wide = 1 << doubled
        fast = doubled * total + (across // 2 // wide * wide) * along + along - wide
        claimed = {"cells_kept": len(braked.kept.members) + blocks}
        more = changed(path, lambda h, c=claimed: h.update(c), entries=with_row(fast))
        assert len(unchecked(more)[0].kept.members) == claimed["cells_kept"]
        with pytest.raises(OutputError, match=f"is not valid: cell {fast} "):
            hf.read_certificate(more)
        with pytest.raises(NotValidError, match=f"cell {fast} "):
            check(str(more))
        with pytest.raises(NotValidError, match="not as many as it says"):
            check(str(changed(path, lambda h: None, entries=with_row(fast))))


def test_cell_that_is_part_of_another_does_not_count_twice(braked, tmp_path):
    path = braked.write(tmp_path / "cart.holdfast")
    again = with_row(braked.kept.entries[:, 0].max() % braked.cells.total)
    more = {"cells_kept": len(braked.kept.members) + 1}
    for alter in (lambda h: h.update(more), lambda h: None):
        twice = changed(path, alter, entries=again)
        with pytest.raises(OutputError, match="the cells that are kept are not"):
            hf.read_certificate(twice)
    with pytest.raises(NotValidError, match="not as many as it says"):
        check(str(changed(path, lambda h: h.update(more), entries=again)))


@pytest.mark.parametrize("which", ["a half", "a smallest"])
def test_leaf_that_is_said_to_be_larger_is_found(braked, tmp_path, which):
    """Each cell of that size becomes twice as wide: more is claimed than was found."""
    path, total = braked.write(tmp_path / "cart.holdfast"), braked.cells.total
    doubled = 1 if which == "a half" else 0

    def wider(raw):
        rows = rows_of(raw)
        size, first = np.divmod(rows["cell"].astype(np.int64), total)
        place = np.stack(np.unravel_index(first, braked.cells.counts))
        fits = (size == doubled) & (place % (2 << doubled) == 0).all(axis=0)
        rows["cell"][fits] += total
        return rows.tobytes()

    raw = braked.kept.entries
    claimed = np.array([(c, i, n) for c, i, n in raw.tolist()], dtype=ENTRY)
    numbers = np.frombuffer(wider(claimed.tobytes()), dtype=ENTRY)["cell"].astype(np.int64)
    kept = len(np.unique(Halvings(braked.cells, 2).spread(numbers)[0]))
    assert kept > len(braked.kept.members)
    with pytest.raises(NotValidError, match=r"which is not kept|may fail on the way|not inside"):
        check(str(changed(path, lambda h: h.update(cells_kept=kept), entries=wider)))


@pytest.mark.parametrize(("name", "own", "claimed"), [("for a while", 2, 3), ("to a target", 3, 2)])
def test_level_that_is_one_better_than_was_found_is_refused(tmp_path, name, own, claimed):
    """Of one smallest cell: it would have to lead to cells that are one better too."""
    found = certified(name, 20, 2)
    small = (found.kept.entries[:, 0] < found.cells.total) & (found.kept.entries[:, 2] == own)
    row = found.kept.entries[np.flatnonzero(small)[:1]]
    number = row[0, 0]
    path = found.write(tmp_path / "some.holdfast")

    def better(raw):
        rows = rows_of(raw)
        one = rows["cell"] == number
        rows["level"][one] = claimed
        return np.concatenate([rows[one], rows[~one]]).tobytes()

    truth, lies = (
        Checker(*read(p.read_bytes())) for p in (path, changed(path, dict, entries=better))
    )
    flint.ctx.prec = BITS
    truth.entry(number, row[0, 1], own)
    with pytest.raises(NotValidError, match=f"cell {number} .* which is not kept"):
        lies.entry(number, row[0, 1], claimed)


@pytest.mark.parametrize("depth", [0, 1, 2.0, -1, "2", True, None, 1000])
def test_header_that_says_another_depth_is_refused(tmp_path, depth):
    path = certified("view", 20, 2).write(tmp_path / "view.holdfast")
    path = changed(path, lambda h: h.update(depth=depth))
    if depth != 1000:  # no cell is so wide, and the others are as they were
        with pytest.raises((NotValidError, TypeError)):
            check(str(path), share=0.01)
    with pytest.raises(OutputError):
        hf.read_certificate(path)


def test_number_that_no_cell_has_is_refused(braked, tmp_path):
    path, total = braked.write(tmp_path / "cart.holdfast"), braked.cells.total
    for number in (total + 1, 2 * total + 2, 3 * total, 2 * total - 1):
        more = {"cells_kept": len(braked.kept.members) + 1}
        odd = changed(path, lambda h, m=more: h.update(m), entries=with_row(number))
        with pytest.raises(NotValidError, match=r"no cell|no such cell"):
            check(str(odd))
        with pytest.raises(OutputError, match="there is none of"):
            hf.read_certificate(odd)


# -- numbers ---------------------------------------------------------------------------------------


def test_numbers_of_cells_name_their_box_and_the_smallest_cells_in_it():
    rng = np.random.default_rng(8)
    cells = Cells((np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, 2.5, 5.0])), (False, True))
    halvings = Halvings(cells.halved().halved(), 2)
    assert halvings.grid(0).counts == (2, 3)
    assert halvings.finest.edges[0].tolist() == [0, 0.25, 0.5, 0.75, 1, 1.5, 2, 2.5, 3]
    for depth in range(3):
        grid = halvings.grid(depth)
        flat = rng.permutation(grid.total)
        numbers = halvings.numbers(flat, depth)
        assert halvings.has(numbers)
        small, rows = halvings.spread(numbers)
        assert sorted(small) == list(range(halvings.finest.total))
        low, high = grid.corners(flat)
        a, b = halvings.finest.corners(small)
        assert (a >= low[rows]).all()
        assert (b <= high[rows]).all()
        for k in range(len(flat)):
            assert (a[rows == k].min(axis=0) == low[k]).all()
            assert (b[rows == k].max(axis=0) == high[k]).all()


@pytest.mark.parametrize(("halvings", "said"), [(-1, "halvings is -1"), (40, "halvings is 40"),
                                              (15, "cells of the smallest size")])  # fmt: skip
def test_cells_that_cannot_be_halved_so_often_are_refused(halvings, said):
    with pytest.raises(SimulationError, match=said):
        certified("view", 25, halvings)


def test_cell_between_neighbouring_floats_is_not_halved():
    edges = [-1.0, 0.0, np.nextafter(0.5, 0), 0.5, 1.0]
    system, region = cart()
    with pytest.raises(SimulationError, match="too narrow to be halved"):
        hf.certify(system, region, box=CART, cells={"x": edges, "v": 5}, halvings=1)
