"""The result of an identification: numbers with intervals, and what they leave unexplained."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.identification.log import Floats
from holdfast.maths.definitions.system import System

IDENTIFIED, WIDE, AT_LIMIT, TIED, UNSEEN, GIVEN = (
    "identified",
    "wide",
    "at its limit",
    "tied",
    "not seen",
    "given",
)
"""What became of a number: its interval is useful; wider than itself; at the limit of its values;
held because the motion shows only a combination; held because this log does not show it; held on
request."""


@dataclass(frozen=True)
class Estimate:
    """A parameter of the system, or a constant disturbance during the log.

    before, value: its number before and now. low, high: its interval, NaN if it was held. status:
    `IDENTIFIED` and so on. why: a sentence. manoeuvre: what would show it, and the interval that
    this would give, "" where none is needed or none was found.
    """

    name: str
    unit: str
    before: float
    value: float
    low: float
    high: float
    status: str
    why: str = ""
    manoeuvre: str = ""

    @property
    def half_width(self) -> float:
        return (self.high - self.low) / 2


@dataclass(frozen=True)
class Unexplained:
    """The rates that the model needs in addition, constant in each short window.

    names: of states. units: of their rates. low, high: the bound on each. value: what each window
    needs, shape (windows, names); by_noise: the deviation that measurement noise alone gives it.
    start: of the windows [s]; length: of each [s]. unjudged: how many others had too few
    measurements to tell.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    value: Floats
    by_noise: Floats
    start: Floats
    length: float
    unjudged: int = 0

    @property
    def noise_share(self) -> tuple[float, ...]:
        """The part of each spread that measurement noise explains, 1 for all of it."""
        spread = self.value.std(axis=0)
        noise = (self.by_noise**2).mean(axis=0) ** 0.5
        return tuple(
            float(min(n / s, 1.0)) if s > 0 else 0.0 for n, s in zip(noise, spread, strict=True)
        )


@dataclass(frozen=True)
class HeldOut:
    """A second log beside the bound on what is unexplained.

    needed: what its windows need. outside: how many of them are outside the bound by more than two
    deviations of the noise; beyond: how many are outside at all. worst: how far the farthest is
    from the middle of the bound, in half-widths, of each state. error: the deviation of the
    prediction over a window for each signal, in that of the noise.
    """

    name: str
    needed: Unexplained
    outside: int
    beyond: int
    worst: tuple[float, ...]
    error: Mapping[str, float]

    @property
    def covered(self) -> bool:
        return self.outside == 0


@dataclass(frozen=True)
class Identified:
    """A system with the numbers of its log.

    system: with the estimated parameters. parameters, disturbances: what became of each number.
    unexplained: the bound on what the model leaves out. held_out: the second log, if there is one.
    noise: the deviation of each signal. outliers: the share of measurements with less weight.
    window, step, windows: lengths [s] and number. level: of the intervals. ties: a sentence for
    each combination that the motion shows only together. repairs: of the log. remarks: why the
    numbers may be wrong although their intervals are narrow.
    """

    system: System
    log: str
    parameters: tuple[Estimate, ...]
    disturbances: tuple[Estimate, ...]
    unexplained: Unexplained
    held_out: HeldOut | None
    noise: Mapping[str, float]
    outliers: float
    window: float
    step: float
    windows: int
    left_out: float
    level: float
    ties: tuple[str, ...]
    repairs: tuple[str, ...]
    remarks: tuple[str, ...]
    measured: Mapping[str, Any]
    """For the figure: per signal (time, measured, predicted)."""

    @property
    def values(self) -> dict[str, float]:
        """The estimated parameters by name."""
        return {e.name: e.value for e in self.parameters if not math.isnan(e.low)}

    @property
    def verdict(self) -> str:
        """Whether the bound holds on a second log, in one sentence."""
        if self.held_out is None:
            return "no second log: the bound is that of the log itself"
        second = self.held_out
        count = len(second.needed.start)
        if second.covered:
            less = f", {second.beyond} of them but for noise" if second.beyond else ""
            if second.needed.unjudged:
                less += f"; {second.needed.unjudged} others have too few measurements"
            return f"{second.name}: all {count} windows are within the bound{less}"
        worst = max(second.worst)
        name = self.unexplained.names[second.worst.index(worst)]
        return (
            f"{second.name}: {second.outside} of {count} windows are NOT within the bound; "
            f"the rate of {name} needs {worst:.2g} times its half-width"
        )

    def summary(self) -> dict[str, Any]:
        """Plain data; NaN appears as None."""

        def plain(value: float) -> float | None:
            return value if math.isfinite(value) else None

        def entry(e: Estimate) -> dict[str, Any]:
            return {
                "unit": e.unit,
                "before": plain(e.before),
                "value": plain(e.value),
                "low": plain(e.low),
                "high": plain(e.high),
                "status": e.status,
                "why": e.why,
                "manoeuvre": e.manoeuvre,
            }

        left = self.unexplained
        second = self.held_out
        return {
            "log": self.log,
            "repairs": list(self.repairs),
            "remarks": list(self.remarks),
            "level": self.level,
            "parameters": {e.name: entry(e) for e in self.parameters},
            "disturbances": {e.name: entry(e) for e in self.disturbances},
            "ties": list(self.ties),
            "unexplained": {
                n: {"unit": u, "low": a, "high": b, "noise_share": s}
                for n, u, a, b, s in zip(
                    left.names, left.units, left.low, left.high, left.noise_share, strict=True
                )
            },
            "unexplained_window": left.length,
            "unexplained_windows": len(left.start),
            "noise": dict(self.noise),
            "outliers": self.outliers,
            "window": self.window,
            "windows": self.windows,
            "seconds_left_out": self.left_out,
            "verdict": self.verdict,
            "held_out": None
            if second is None
            else {
                "log": second.name,
                "covered": second.covered,
                "windows": len(second.needed.start),
                "outside": second.outside,
                "beyond": second.beyond,
                "worst": dict(zip(left.names, second.worst, strict=True)),
                "error": dict(second.error),
            },
        }
