"""The outcomes of a run, and the answers of a safeguard."""

from __future__ import annotations

from enum import IntEnum


class Outcome(IntEnum):
    """The outcome of a trajectory, with the label that users read.

    A run that left the grid stayed in its region, but reached a state where the value function of
    its law is not known.
    """

    STAYED = 0, "stayed"
    REACHED = 1, "reached goal"
    LEFT = 2, "left region"
    DIVERGED = 3, "diverged"
    CHATTERED = 4, "chattered"
    OFF_GRID = 5, "left grid"

    label: str

    def __new__(cls, number: int, label: str = "") -> Outcome:
        made = int.__new__(cls, number)
        made._value_, made.label = number, label
        return made


OUTCOMES = tuple(one.label for one in Outcome)
"""The labels, in the order of `Outcome`."""


class SafeguardAnswer(IntEnum):
    """The action of a safeguard on the command of its law at a sample."""

    KEPT = 0
    OVERRULED = 1
    INFEASIBLE = 2

    @property
    def label(self) -> str:
        return ("kept", "overruled", "no admissible input")[self]
