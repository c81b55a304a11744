"""What a kind of attack is, and what comes of a case."""

from __future__ import annotations

import re
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from holdfast.errors import HoldfastError


@dataclass
class Fault:
    """Something that is not so: what kind of thing (signature), and in numbers (message)."""

    signature: str
    message: str
    suffix: str = ".py"
    text: str = ""
    """Of a file that runs alone and prints what is wrong; written when the fault is shrunk."""


@dataclass
class Outcome:
    """What came of a case: how many claims were judged, why it was refused, what is wrong."""

    judged: int = 0
    refused: str = ""
    faults: list[Fault] = field(default_factory=list)
    counts: dict[str, float] = field(default_factory=dict)
    notes: list[Any] = field(default_factory=list)
    """For the end of the kind, such as whether an interval held the truth."""


@dataclass(frozen=True)
class Kind:
    """A family of attacks.

    attempt(seed, number) is a case, deterministic. shrink(seed, number, fault) gives the fault a
    file. conclude(notes of all cases) judges what only many cases can, such as a coverage. share:
    of the budget. seconds: that a case may take; longer is a hang. shown: the counts that stand in
    the table.
    """

    name: str
    attempt: Callable[[int, int], Outcome]
    shrink: Callable[[int, int, Fault], None]
    share: float = 1.0
    seconds: float = 60.0
    conclude: Callable[[list[Any]], list[Fault]] = lambda notes: []
    shown: tuple[str, ...] = ()


def without_numbers(text: str) -> str:
    """A message without its numbers, to count messages of one kind."""
    return re.sub(r"[-+]?[0-9]+([.][0-9]+)?(e[-+]?[0-9]+)?", "#", text)


def attacked(trial: Callable[[Outcome], None]) -> Outcome:
    """The outcome of a trial: refusals have their reason, every other exception is a fault.

    Warnings of NumPy are faults: they tell a user nothing. Those of the product are its words.
    """
    outcome = Outcome()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", RuntimeWarning)
            trial(outcome)
    except HoldfastError as error:
        outcome.refused = without_numbers(str(error))[:160]
    except MemoryError:
        outcome.faults.append(Fault("more memory than the limit", "MemoryError"))
    except Exception as error:
        outcome.faults.append(raised(error))
    return outcome


def raised(error: BaseException) -> Fault:
    """An exception that is no refusal, by its kind and the place where it was raised."""
    place = "elsewhere"
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if "holdfast" in frame.filename and "benchmarks" not in frame.filename:
            place = f"{frame.filename.split('holdfast/')[-1]}:{frame.name}"
            break
    told = without_numbers(f"{type(error).__name__}: {error}")[:100]
    return Fault(f"{told} in {place}", "".join(traceback.format_exception(error))[-1500:])
