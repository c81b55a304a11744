"""What the checker takes an option of a law to give, where the answer follows by hand."""

import pytest
from flint import arb

from holdfast_check import law, reading


def law_of(when, inputs, parts, *others):
    """A law with one mode, with this option and others of the same inputs; x is measured."""
    mode = [[conditions, inputs, 0] for conditions in (when, *others)]
    value = {
        "names": ["only"], "initial": 0, "modes": [mode], "under_way": [],
        "parts": [[float(edge).hex() for edge in edges] for edges in parts],
        "table": {"axes": [], "nodes": {}},
    }  # fmt: skip
    return law.Law(reading.formed(value, reading.LAW, "the law"), ["u"])


def options(of, x):
    """(may, surely, ends of the inputs) where x is in an interval."""
    here = of.all_known({"x": tuple(map(arb, x))})
    ((option,),) = of.modes
    return [
        (may, surely, [(float(low), float(high)) for low, high in inputs])
        for may, surely, inputs in of._of(option, here)
    ]


FREE = {
    # condition on an input that is free, between 0 and 1 or 1 and 2: whether each may be, surely is
    "u - 1": ((True, False), (True, False)),
    "u - 1/2": ((True, False), (False, False)),
    "u - 3": ((True, True), (True, True)),
    "u - 2": ((True, True), (True, False)),
    "u - 3/2 + x": ((True, True), (True, False)),
    "-u": ((True, False), (True, True)),
    "-1/2 - u": ((True, True), (True, True)),
    "u": ((True, False), (False, False)),
    "u + 1/2": ((False, False), (False, False)),
}


@pytest.mark.parametrize("condition", FREE)
def test_a_free_input_may_be_in_every_part_that_meets_the_conditions_somewhere(condition):
    both = options(law_of([condition], ["u"], [[0, 1, 2]]), (0, 0.25))
    assert both == [(*FREE[condition][0], [(0, 1)]), (*FREE[condition][1], [(1, 2)])]


def program(row, wanted=None):
    """Any input, or the one closest to `wanted`, with row . u <= the last number of the row."""
    return {
        "wanted": wanted, "rows": [row], "hard": 1, "scales": ["1"], "limits": ["u"],
        "box": [["0", "2"]],
    }  # fmt: skip


PROGRAMS = {
    # row of u <= b: which of the parts [0, 1] and [1, 2] an input may be in
    ("1", "0"): (True, False),  # u = 0 alone, the end of a part
    ("1", "1"): (True, True),
    ("1", "1/2"): (True, False),
    ("-1", "-2"): (False, True),  # u = 2 alone
    ("-1", "-3/2"): (False, True),
    ("-1", "0"): (True, True),
}


@pytest.mark.parametrize("row", PROGRAMS)
def test_an_input_that_meets_a_program_at_the_end_of_a_part_may_be_given(row):
    first, second, *_ = options(law_of([], program(list(row)), [[0, 1, 2]]), (0, 1))
    assert first == (PROGRAMS[row][0], False, [(0, 1)])
    assert second == (PROGRAMS[row][1], False, [(1, 2)])


def test_parts_that_are_not_all_that_a_free_input_may_be_are_refused():
    of = law_of([], program(["1", "1"]), [[0.5, 1, 2]])
    with pytest.raises(law.NotValidError, match="the parts of the inputs are not all"):
        options(of, (0, 1))


COVERED = {
    # conditions of two options: whether one of both holds wherever x is between -1 and 1
    ("x", "-x"): True,
    ("x", "1/10 - x"): False,
    ("x", "-x*(1 + x*x)"): True,  # each half of the box by itself
    ("x - 1/8", "-x*(1 + x*x)"): True,
    ("x + 1/8", "-x*(1 + x*x)"): False,
}


@pytest.mark.parametrize("both", COVERED)
def test_options_cover_a_box_where_they_cover_its_parts(both):
    one, other = ([condition] for condition in both)
    of = law_of(one, ["u"], [[0, 1]], other)
    assert of.covered({"x": (arb(-1), arb(1))}, 0) is COVERED[both]
