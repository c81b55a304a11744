"""The look-up of a cell: Python's own answer, that of machine code, and a search through all."""

import math

import numpy as np
import pytest

from holdfast.execution.codegen.scalar_llvm import called
from holdfast.execution.look_in_cells import look_in_cells

EDGES = (np.array([-1.0, -0.7, 0.1, 0.25, 1.0]), np.linspace(-math.pi, math.pi, 6))
ROWS = np.array([[0.5, -2.0], [1.5, 0.25], [-0.125, 3.0]])
SHAPE, PERIODIC = np.array([4, 5]), np.array([0, 1])


def table(seed, lasting):
    """Entries of random cells, some of which are not known, and how many holds they last."""
    rng = np.random.default_rng(seed)
    entries = rng.integers(0, 2 * len(ROWS), 20).astype(float)
    numbers = np.concatenate([*EDGES, ROWS.ravel(), [0.5 if lasting else math.inf]])
    return np.concatenate([entries, rng.integers(1, 9, 20)]), numbers


def answer(look, entries, numbers, place):
    out, whole = np.empty(3), np.zeros(4, dtype=np.int64)
    arrays = (np.array(place, dtype=float), numbers, SHAPE, PERIODIC)
    return look(entries, *arrays, 2, len(ROWS), 3, out, whole), out


def machine(*arguments):
    return called("look_in_cells", "look_in_cells", *arguments)


def touched(place):
    """Every cell that a place is in, by a search through all."""
    x, angle = place
    turns = [angle + 2 * k * math.pi for k in (-1, 0, 1)]
    return [
        (i, j)
        for i in range(4)
        for j in range(5)
        if EDGES[0][i] <= x <= EDGES[0][i + 1]
        and any(EDGES[1][j] <= a <= EDGES[1][j + 1] for a in turns)
    ]


def places(count=400):
    """Inside, beyond, on the edges of cells, and on their corners."""
    rng = np.random.default_rng(3)
    for k in range(count):
        x, angle = rng.uniform(-1.3, 1.3), rng.uniform(-math.pi, math.pi)
        yield rng.choice(EDGES[0]) if k % 2 else x, rng.choice(EDGES[1]) if k % 3 == 0 else angle


@pytest.mark.parametrize("lasting", [True, False])
def test_known_cell_is_found_if_the_place_is_in_one_and_machine_code_says_the_same(lasting):
    entries, numbers = table(0, lasting)
    found = 0
    for place in places():
        known, out = answer(look_in_cells, entries, numbers, place)
        same, row = answer(machine, entries, numbers, place)
        assert same == known
        assert row.tobytes() == out.tobytes()
        cells = [i * 5 + j for i, j in touched(place) if entries[i * 5 + j] < len(ROWS)]
        assert known == bool(cells), place
        lasts = [entries[20 + c] * 0.5 if lasting else math.inf for c in cells] or [0.0]
        said = [(last, *ROWS[int(entries[c])]) for last, c in zip(lasts, cells, strict=False)]
        assert tuple(out) in said or (not cells and out[0] == 0.0 and out[1:] in ROWS)
        found += known
    assert 100 < found < 300


def test_angle_of_any_number_of_turns_is_that_of_its_place_in_one():
    entries, numbers = table(0, True)
    for x, angle in [(0.0, 0.3), (-0.9, -2.0), (0.5, 3.0)]:
        _, out = answer(look_in_cells, entries, numbers, (x, angle))
        for turns in (-3, 1, 2):
            place = (x, angle + 2 * math.pi * turns)
            assert answer(look_in_cells, entries, numbers, place)[1].tobytes() == out.tobytes()


@pytest.mark.parametrize("place", [(math.nan, 0.0), (0.0, math.inf), (-math.inf, 0.0)])
def test_place_that_is_no_number_gives_none(place):
    for look in (look_in_cells, machine):
        known, out = answer(look, *table(0, False), place)
        assert not known
        assert np.isnan(out).all()
