"""The exceptions and warnings of holdfast.

An error names the cause (with the value that was given), the expectation, and the remedy.
"""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Callable, Collection, Iterable
from importlib import import_module
from typing import NoReturn


class HoldfastError(Exception):
    """Base class of all errors: the cause, the expectation, and the remedy."""

    def __init__(self, cause: str, *, expected: str = "", remedy: str = "", key: str = "") -> None:
        self.cause = cause
        self.key = key  # the table of the scenario file that the error refers to, if known
        self.expected = expected
        self.remedy = remedy
        parts = [cause]
        if expected:
            parts.append(f"expected {expected}")
        if remedy:
            parts.append(remedy)
        super().__init__("; ".join(parts))


class ArgumentError(HoldfastError):
    """An argument of the wrong type."""


class DefinitionError(HoldfastError):
    """A system, law, region or set of bounds that contradicts itself."""


class ExpressionError(HoldfastError):
    """A text expression with an unknown name or a forbidden construct."""


class ScenarioError(HoldfastError):
    """A scenario or vehicle file, or an override of one, that cannot be used."""


class SimulationError(HoldfastError):
    """A simulation that cannot start: invalid starts, steps, bounds or settings."""


class OutputError(HoldfastError):
    """A result that cannot be written or read."""


class GainWarning(UserWarning):
    """A gain outside the range for which the law is known to converge."""


class ModelWarning(UserWarning):
    """A model that leaves out what a vehicle has: what was computed with it need not hold."""


class AngleWarning(UserWarning):
    """An angle without a unit that is more than a turn: it is read in radians."""


class PromiseNotTriedWarning(UserWarning):
    """A kernel in use whose promise was never tried in closed loop."""


class PromiseFellShortWarning(UserWarning):
    """A kernel in use whose promise was tried in closed loop, and fell short."""


class DisputedSetWarning(UserWarning):
    """A set to be reached against a disturbance, part of which only one of two schemes reaches."""


class SlowWarning(UserWarning):
    """A computation that takes much longer than it would with more memory."""


class RenamedWarning(FutureWarning):
    """Deprecation: a word that has been replaced and is still accepted for one release."""


class CacheWarning(UserWarning):
    """A cache of compiled code that is not used, because other users could change its content; or
    what an earlier run has left, because it is of another problem."""


def suggestion(name: str, allowed: Iterable[str]) -> str:
    """'did you mean ...?' for a misspelt name, or the list of the allowed ones."""
    choices = sorted(allowed)
    if near := nearest(name, choices):
        return f"did you mean '{near}'?"
    return "allowed: " + ", ".join(choices) if choices else "none is allowed here"


def nearest(name: str, names: Iterable[str]) -> str:
    """The name that a misspelt one is meant to be; "" where none is near."""
    close = difflib.get_close_matches(name, list(names), n=5, cutoff=0.6)
    return max(close, key=lambda other: _alike(name, other), default="")


MOST_LISTED = 40
"""Of names of a module, where none is near to the one that is asked for."""


def refused_attribute(module: str, names: Collection[str]) -> Callable[[str], NoReturn]:
    """The `__getattr__` of a module: what it says of a name that it does not have.

    The glossary, of a later room, is asked by its name: what the word is here, or the nearest name.
    """

    def refuse(name: str) -> NoReturn:
        cause = f"{module} has no '{name}'"
        if not name.startswith("_"):
            remedy = import_module("holdfast.scenario.glossary").meant(name, names)
            too_many = remedy.startswith("allowed: ") and len(names) > MOST_LISTED
            cause = f"{cause}; {f'dir({module}) lists all names' if too_many else remedy}"
        raise AttributeError(cause, name=name)

    return refuse


def _alike(name: str, other: str) -> float:
    """How alike two names are; a common beginning counts, as in cosine and cos."""
    pairs = zip(name, other, strict=False)
    begins = sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], pairs))
    longest = max(len(name), len(other), 1)
    return difflib.SequenceMatcher(None, name, other).ratio() + begins / longest


def check_name(
    name: object, names: Collection[str], error: type[HoldfastError], cause: str, **more: str
) -> None:
    """Refuse a name that is none of `names`; the remedy is the name that is meant."""
    if name not in names:
        raise error(cause, remedy=suggestion(str(name), names), **more)
