"""What other numbers would certify: the trials of single changes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Change:
    """One number changed alone.

    option: of the command. share: that is certified with it, `before`: without it, on as many
    `cells`; none where these are those of the option, or those that were asked for.
    """

    option: str
    share: float
    before: float
    cells: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Advice:
    """tried: the options of all trials that ran. changes: the best of sample times, of cells and
    of inputs, where they gain, the best one first."""

    tried: tuple[str, ...]
    changes: tuple[Change, ...]
