"""The result of a search for gains: what was tried, what each cost, and what was chosen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from holdfast.analysis.safety.gain_conditions import JudgedCondition

COSTS = ("time", "effort", "clearance")
"""What gains may be best for."""


@dataclass(frozen=True)
class Costs:
    """What a candidate costs in closed loop: means over the starts, at the worst corner.

    time: seconds until a run is in the goal for good, the horizon for a run that is not; NaN
    without a goal. effort: the integral of sum (input / its limit)^2 [s], actuators in place of
    inputs where there are any; an input without limits counts in its own unit. clearance: the
    share of its distance at the start that the run keeps from each constraint, of the worst one, 1
    at most and 0 where it touches; a start nearer than a twentieth of the farthest counts as that
    far; NaN without a region. lost: the share of runs that end outside the goal, or without one
    leave the region.
    """

    time: float
    effort: float
    clearance: float
    lost: float

    def of(self, cost: str) -> float:
        """The number to minimise: clearance counts as its negative."""
        value: float = getattr(self, cost)
        return -value if cost == "clearance" else value

    def dominates(self, other: Costs) -> bool:
        """No cost is larger, and one is smaller; costs that do not exist are left out."""
        pairs = [(self.of(c), other.of(c)) for c in COSTS if not math.isnan(self.of(c))]
        return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)


@dataclass(frozen=True)
class Candidate:
    """Gains by their keys, the least slack of their conditions, and their costs."""

    gains: Mapping[str, float]
    slack: float
    costs: Costs


@dataclass(frozen=True)
class Tuning:
    """Gains that meet every condition of a law, best for a cost.

    case: of the scenario's comparison, "" for none. gains, shipped: the chosen gains and those of
    the scenario, by key. conditions, shipped_conditions: each where its slack is least.
    candidates: all admissible ones that were simulated, from `starts` starts. before, after: the
    costs of the scenario's gains and of the chosen ones, from one simulation of `checked` fresh
    starts. tried: gains whose conditions were
    judged. corners: of the varied numbers. instants: samples of the inputs that the effort is
    taken from. text: the scenario file with the chosen gains.
    """

    title: str
    scenario: str
    case: str
    cost: str
    margin: float
    seed: int
    gains: Mapping[str, float]
    shipped: Mapping[str, float]
    units: Mapping[str, str]
    conditions: tuple[JudgedCondition, ...]
    shipped_conditions: tuple[JudgedCondition, ...]
    candidates: tuple[Candidate, ...]
    shipped_costs: Costs
    before: Costs
    after: Costs
    tried: int
    starts: int
    checked: int
    corners: int
    instants: int
    text: str

    @property
    def settings(self) -> tuple[str, ...]:
        """The overrides KEY=VALUE that give the scenario the chosen gains."""
        return tuple(f"{key}={value!r}" for key, value in self.gains.items())

    @property
    def front(self) -> tuple[Candidate, ...]:
        """The candidates that no other betters in every cost (Pareto)."""
        able = [c for c in self.candidates if c.costs.lost <= self.shipped_costs.lost]
        return tuple(c for c in able if not any(o.costs.dominates(c.costs) for o in able))

    @property
    def shipped_violations(self) -> tuple[JudgedCondition, ...]:
        """The conditions that the scenario's own gains violate at some corner."""
        return tuple(c for c in self.shipped_conditions if c.slack < -1e-12)

    def summary(self) -> dict[str, Any]:
        """Everything but the text as plain data; NaN appears as None."""
        whole = asdict(self) | {
            "settings": list(self.settings),
            "front": [asdict(c) for c in self.front],
        }
        del whole["text"]
        plain: dict[str, Any] = _plain(whole)
        return plain


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
