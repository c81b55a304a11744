"""Whether a constraint is kept between samples: every part of how the checker decides it counts.

Cases have answers that follow by hand from a start, a way, an end and rates. Mutants of the two
deciding functions, for cells and for flowpipes, answer one of them otherwise.
"""

import ast
import sys

import pytest
from flint import arb
from mutation import replaced

import holdfast as hf
from holdfast.maths.expressions.functions import greatest, least
from holdfast_check import flowpipe, held, reading
from tests.analysis.certificates.mutants import SOURCE, beside, others

WAYS = {
    # constraint: per state start, way, end, rate; whether it is known at the start and at the end
    "below 0 all the way": ("x", {"x": ((-1, -0.5), (-1, -0.1), (-1, -0.1), (-9, 9))}, 0, 0, True),
    "up to 0": ("x", {"x": ((-1, -0.5), (-1, 0), (-1, 1), (-9, 9))}, 0, 0, True),
    "above 0, and it may turn": ("x", {"x": ((-1, 1), (-1, 1), (-1, 1), (-9, 9))}, 1, 0, False),
    "one of two": ("least(x, y)", {"x": ((-1, 1),) * 3 + ((-9, 9),),
                                   "y": ((-2, -1),) * 3 + ((-9, 9),)}, 0, 0, True),
    "one of two, when both are": ("greatest(x, y)", {"x": ((-1, 1),) * 3 + ((-9, 9),),
                                                     "y": ((-2, -1),) * 3 + ((-9, 9),)}, 1, 1, False),
    "one falls, the other rises": ("greatest(x, y)", {
        "x": ((-1, 0), (-2, 0.5), (-2, 0.5), (-1, -0.1)),
        "y": ((-2, 0.5), (-2, 0.5), (-1, 0), (0.1, 1)),
    }, 0, 0, True),
    "it falls from what is known": ("x", {"x": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (-1, 0))}, 1, 0, True),
    "it falls from what is not": ("x", {"x": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (-1, 0))}, 0, 1, False),
    "it falls from 0": ("x", {"x": ((-1, 0), (-1, 0.5), (-1, 0.5), (-1, 0))}, 0, 0, True),
    "it stays, whatever it is": ("x", {"x": ((-1, 0.5),) * 3 + (None,)}, 1, 0, True),
    "it rises to what is known": ("x", {"x": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (0, 1))}, 0, 1, True),
    "it rises to what is not": ("x", {"x": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (0, 1))}, 1, 0, False),
    "it rises to 0": ("x", {"x": ((-1, 0.5), (-1, 0.5), (-1, 0), (0, 1))}, 0, 0, True),
    "one of both was, and falls no more": ("least(x, y)", {
        "x": ((0.5, 1), (0.1, 1), (0.1, 1), (-1, -0.1)),
        "y": ((-1, -1), (-1, 2), (1, 2), (1, 3)),
    }, 1, 0, False),
    "one of both will be": ("least(x, y)", {
        "x": ((0.1, 1), (0.1, 1), (0.5, 1), (0.1, 1)),
        "y": ((1, 2), (-1, 2), (-1, -1), (-3, -1)),
    }, 0, 1, False),
    "both began below": ("greatest(x, y)", {
        "x": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (-1, 0)),
        "y": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (-1, 0)),
    }, 1, 0, True),
    "both fall from what is not": ("greatest(x, y)", {
        "x": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (-1, 0)),
        "y": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (-1, 0)),
    }, 0, 1, False),
    "both rise to what is not": ("greatest(x, y)", {
        "x": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (0, 1)),
        "y": ((-1, 0.5), (-1, 0.5), (-1, 0.5), (0, 1)),
    }, 1, 0, False),
    "lines that meet below 0": ("x", {"x": ((-1, -1), (-1, 1), (-1, -1), (-1.5, 1.5))}, 0, 0, True),
    "lines that meet at 0": ("x", {"x": ((-1, -1), (-1, 1), (-1, -1), (-2, 2))}, 0, 0, True),
    "lines that meet above 0": ("x", {"x": ((-0.5, -0.5), (-1, 1), (-0.5, -0.5), (-1.5, 1.5))}, 0, 0, False),
    "lines of which one begins above 0": ("x", {"x": ((-1, 0.5), (-1, 1), (-10, -10), (-1, 1))}, 0, 0, False),
    "lines of which one ends above 0": ("x", {"x": ((-10, -10), (-1, 1), (-1, 0.5), (-1, 1))}, 0, 0, False),
}  # fmt: skip


def answer(module, constraint, states, begins, ends):
    """What the function for cells says, of a step of one second."""

    def box(place):
        return {name: tuple(map(arb, w[place])) for name, w in states.items() if w[place]}

    limit = module.Limit(module.Expression(constraint))
    at, step = [box(k) for k in range(3)], (arb(1), arb(1))
    try:
        return module._kept(limit, at, box(3), step, begins=bool(begins), ends=bool(ends))
    except (ArithmeticError, TypeError):  # of a mutant
        return None


@pytest.mark.parametrize("name", WAYS)
def test_a_constraint_is_kept_on_the_way_where_that_follows(name):
    *case, holds = WAYS[name]
    assert answer(held, *case) is holds


SAME = {
    "low < high and begins and ends without low < high": "with one rate alone it was decided before",
    "low < high with another": "with one rate alone it was decided before",
}
"""Mutants that say the same."""


def test_each_part_of_the_decision_counts(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    file = SOURCE / "held.py"
    tree = ast.parse(file.read_text(encoding="utf-8"))
    decides = next(n for n in ast.walk(tree) if getattr(n, "name", "") == "_kept")
    alive = []
    for number, (node, other, what) in enumerate(others([decides])):
        module = beside(tmp_path, number, file, replaced(tree, node, other), "held")
        if all(answer(module, *case) is holds for *case, holds in WAYS.values()):
            alive.append(what)
    assert number > 20
    assert [what for what in alive if not any(part in what for part in SAME)] == []
    assert "holdfast_check.held" in sys.modules


X = hf.symbol("x")
FLOWS = {
    # rate, constraint, where it starts: whether it is kept where it starts, and in a box around
    "up to 0": (-X, X - 0.25, (0.125, 0.25), True, True),
    "above 0": (-X, X - 0.25, (0.125, 0.5), False, False),
    "it rises from 0": (X, X - 0.25, (0.125, 0.25), True, False),
    "it stays": (0 * X, X - 0.25, (0.125, 0.25), True, True),
    "it falls to 0": (-X - 0.125, X - 0.25, (0, 0.25), True, True),
    "of no state": (X, X, (0.125, 0.25), False, False),
    "one of two": (X, least(X - 9, X + 9), (0.125, 0.25), True, True),
    "one of two, when both are": (X, greatest(X - 9, X + 9), (0.125, 0.25), False, False),
    "one of two, and which is less changes": (
        0 * X,
        least(X - 0.25, 40 * (0.1875 - X)),
        (0.125, 0.25),
        True,
        True,
    ),
}


def header_of(rate, constraint, start):
    system = hf.System("line", (hf.Quantity("x"),), (), {"x": rate})
    region = hf.Region("region", system.states, (hf.Inequality("c", constraint),))
    pipe = hf.flowpipe(system, region, start={"x": start}, horizon=1, degrees=(1, 2), parts=1)
    header = {**pipe.header, "splits": [], "entries": 0}
    return reading.formed(header, reading.FLOWPIPE, "the header")


def answers(module, header):
    """Whether the constraint is kept at the start, and on a way 1/8 around it."""
    pipe = module.Flowpipe(header)
    x = pipe.begun(pipe.box)
    around = [module.hull(module.NONE, (arb(-0.125), arb(0.125)))]
    wide = pipe.at(x, around)
    during = [pipe.models.range(wide["x"])]
    return pipe.failing(pipe.constraints, pipe.at(x, x.off)) is None, pipe._leaving(
        x, wide, during
    ) is None


@pytest.fixture(scope="module")
def headers():
    every = {name: header_of(*case[:3]) for name, case in FLOWS.items()}
    every["of no state"]["constraints"][0]["expression"] = held.Expression("1")
    return every


@pytest.mark.parametrize("name", FLOWS)
def test_a_flowpipe_keeps_a_constraint_where_that_follows(headers, name):
    assert answers(flowpipe, headers[name]) == FLOWS[name][3:]


def test_each_part_of_the_decision_of_a_flowpipe_counts(headers, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    file = SOURCE / "flowpipe.py"
    tree = ast.parse(file.read_text(encoding="utf-8"))
    deciding = [n for n in ast.walk(tree) if getattr(n, "name", "") in ("_kept", "_leaving")]
    alive = []
    for number, (node, other, what) in enumerate(others(deciding)):
        module = beside(tmp_path, number, file, replaced(tree, node, other), "flowpipe")
        try:
            if all(answers(module, headers[name]) == case[3:] for name, case in FLOWS.items()):
                alive.append(what)
        except (ArithmeticError, TypeError):
            pass
    assert number >= 4
    assert alive == []
