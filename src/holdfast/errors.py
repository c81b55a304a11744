"""Everything that holdfast refuses, and how it says so.

A refusal names the cause (with what was got), what was expected, and the remedy.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class HoldfastError(Exception):
    """A refusal: the cause, what was expected, and what to do about it."""

    def __init__(self, cause: str, *, expected: str = "", remedy: str = "", key: str = "") -> None:
        self.cause = cause
        self.key = key  # the table of a scenario file it is about, where that is known
        self.expected = expected
        self.remedy = remedy
        parts = [cause]
        if expected:
            parts.append(f"expected {expected}")
        if remedy:
            parts.append(remedy)
        super().__init__("; ".join(parts))


class ArgumentError(HoldfastError):
    """An argument of another kind than the function asks for."""


class DefinitionError(HoldfastError):
    """A system, law, region or set of bounds that contradicts itself."""


class ExpressionError(HoldfastError):
    """A text expression with an unknown name or a forbidden construct."""


class ScenarioError(HoldfastError):
    """A scenario or vehicle file, or an override of one, that cannot be used."""


class SimulationError(HoldfastError):
    """A simulation that cannot start: bad starts, steps, bounds or settings."""


class OutputError(HoldfastError):
    """A result that cannot be written or read."""


class GainWarning(UserWarning):
    """A gain outside the range for which the law is known to converge."""


class RenamedWarning(FutureWarning):
    """A word that has been replaced by another, and is understood for one release more."""


class CacheWarning(UserWarning):
    """A cache of compiled code that is not used, since others could change what is in it."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """'did you mean ...?' for a misspelt name, or the list of the allowed ones."""
    choices = sorted(known)
    close = difflib.get_close_matches(name, choices, n=1, cutoff=0.6)
    if close:
        return f"did you mean '{close[0]}'?"
    return "allowed: " + ", ".join(choices) if choices else "none is allowed here"
