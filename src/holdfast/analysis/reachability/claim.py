"""What a set claims, and what came of trying it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from holdfast.maths.definitions.region import Region


@dataclass(frozen=True)
class Claim:
    """What the states of a set are said to be able to do: stay in `region`, or reach `goal`."""

    region: Region | None
    goal: Region | None = None


class Tried(Protocol):
    """A closed-loop validation, as `Promise`."""

    @property
    def outcome(self) -> str: ...

    @property
    def conclusion(self) -> str: ...

    @property
    def kept_share(self) -> float: ...


def recorded(promise: Tried) -> dict[str, Any]:
    """What a validation came to, as entries of the report."""
    return {
        "promise_outcome": promise.outcome,
        "promise_conclusion": promise.conclusion,
        "promise_share": promise.kept_share,
    }
