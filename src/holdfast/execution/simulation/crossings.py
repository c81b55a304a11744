"""The text of a closer look at constraints inside a step: their peaks and crossings."""

from __future__ import annotations

from collections.abc import Mapping

from holdfast.execution.codegen.crossing_leaves import BISECTION_STEPS, GOLDEN_STEPS
from holdfast.execution.codegen.loop_text import Instructions

Places = Mapping[str, int]
"""Where the rows of a block are."""


def look_closely(body: Instructions, at: Places, constraints: int) -> None:
    """The largest c_j inside the step, and which of them first exceeds the tolerance, and when."""
    _search(body, at, "search", "number")
    for j in range(constraints):
        _look_at(body, at, j * body.width)
    _search(body, at, "leave", "outcome")


def _search(body: Instructions, at: Places, leaf: str, out: str, x: int = 0, p: int = 0) -> None:
    body.call(leaf, t=at["length"], q=at["number"], x=x, p=p, out=at[out])


def _constraints_inside(body: Instructions, at: Places) -> None:
    """inside = c_j of every lane at its fraction of the step."""
    body.call(
        "between", t=at["length"], q=at["q"], x=at["new"], p=at["fraction"], out=at["between"]
    )
    body.call("constraints", t=at["time"], q=at["between"], p=at["plant"], out=at["inside"])


def _look_at(body: Instructions, at: Places, j: int) -> None:
    """The largest c_j inside the step, and when it first exceeds the tolerance."""
    inside, worst, rises = at["inside"] + j, at["worst"] + j, at["rises"] + j
    _search(body, at, "open", "number", at["c1"] + j)
    with body.if_any(rises):
        _search(body, at, "golden", "lower")
        _constraints_inside(body, at)
        _search(body, at, "golden_left", "c_left", inside)
        _constraints_inside(body, at)
        _search(body, at, "golden_right", "c_right", inside)
        with body.repeat(GOLDEN_STEPS):
            _search(body, at, "golden_turn", "lower")
            _constraints_inside(body, at)
            _search(body, at, "golden_take", "c_left", inside)
        _search(body, at, "golden_end", "fraction")
        _constraints_inside(body, at)
        _search(body, at, "peaked", "top", inside, rises)
    body.call("raise", q=at["number"], x=worst, p=at["close"], out=worst)
    _search(body, at, "crosses", "crosses", p=at["close"])
    with body.if_any(at["crosses"]):
        _search(body, at, "bisect", "lower")
        with body.repeat(BISECTION_STEPS):
            _constraints_inside(body, at)
            _search(body, at, "bisect_turn", "lower", inside)
        _search(body, at, "crossed", "earliest")
