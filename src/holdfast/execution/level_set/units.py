"""The units of a sweep: the nodes that are computed, or skipped, together."""

from __future__ import annotations

from collections.abc import Sequence

LONGEST = 128
"""Nodes of a stretch of a row, at most."""

SHORT = 64
"""Nodes up to which several rows are one unit."""


def layout(shape: Sequence[int], longest: int | None = None) -> tuple[int, int, int, int]:
    """The units of the last two axes: several whole rows, or a stretch of a single one.

    Rows in a unit, groups of rows, stretches of a row, nodes in a stretch. longest: nodes of a
    stretch at most, of one row then.
    """
    rows = shape[-2] if len(shape) > 1 else 1
    groups = rows if longest else -(-rows // max(1, SHORT // shape[-1]))
    stretches = -(-shape[-1] // (longest or LONGEST))
    return -(-rows // groups), groups, stretches, longest or -(-shape[-1] // stretches)
