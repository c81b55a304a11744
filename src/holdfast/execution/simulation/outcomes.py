"""The outcomes of a run, and the answers of a safeguard."""

from __future__ import annotations

from enum import IntEnum


class Outcome(IntEnum):
    """The outcome of a trajectory."""

    STAYED = 0
    REACHED = 1
    LEFT = 2
    DIVERGED = 3
    CHATTERED = 4
    OFF_GRID = 5

    @property
    def label(self) -> str:
        return OUTCOMES[self]


OUTCOMES = ("stayed", "reached goal", "left region", "diverged", "chattered", "left grid")
"""The labels, in the order of `Outcome`. A run that left the grid stayed in its region, but reached
a state where the value function of its law is not known."""


class SafeguardAnswer(IntEnum):
    """The action of a safeguard on the command of its law at a sample."""

    KEPT = 0
    OVERRULED = 1
    INFEASIBLE = 2

    @property
    def label(self) -> str:
        return ("kept", "overruled", "no admissible input")[self]
