"""Breakages of the product, planted on purpose: does the engine find each?

A breakage changes public objects in a process that tries cases, and names what must be found in how
many cases at most. None is a fault of the product; what they stand for has been one somewhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import holdfast as hf


@dataclass(frozen=True)
class Breakage:
    """What is broken, which kind has to find it, by which words, within how many cases."""

    plant: Callable[[], None]
    kind: str
    words: str
    within: int


def _values(change: Callable[[Any, np.ndarray], np.ndarray]) -> None:
    """Change what every value function says, at states and at nodes."""
    at, values = hf.ValueFunction.at, hf.ValueFunction.values

    def shifted_values(self: Any, *a: Any, **k: Any) -> Any:
        return change(self, values(self, *a, **k))

    def shifted_at(self: Any, *a: Any, **k: Any) -> Any:
        return change(self, at(self, *a, **k))

    hf.ValueFunction.at = shifted_at  # type: ignore[method-assign]
    hf.ValueFunction.values = shifted_values  # type: ignore[method-assign]


def larger_sets() -> None:
    """V is larger by what it changes over four cells: lost states are in every set."""
    _values(lambda value, v: v + 4 * value.report.cell)


def smaller_sets() -> None:
    """V is smaller by what it changes over six cells."""
    _values(lambda value, v: v - 6 * value.report.cell)


def ignored_disturbance() -> None:
    """A hundredth of the disturbance is counted in kernels."""
    _solve_with(lambda s: _with_bounds(s, disturbance=0.01))


def enlarged_inputs() -> None:
    """Kernels count with inputs that are half as large again."""
    _solve_with(lambda s: _with_bounds(s, inputs=1.5))


def _solve_with(change: Callable[[hf.System], hf.System]) -> None:
    from attacks import product

    for name in ("discriminating_kernel", "viability_kernel", "capture_basin"):
        real = getattr(hf, name)

        def changed(system: hf.System, *a: Any, real: Any = real, **k: Any) -> Any:
            return real(change(system), *a, **k)

        setattr(product.hf, name, changed)


def _with_bounds(system: hf.System, inputs: float = 1.0, disturbance: float = 1.0) -> hf.System:
    """The system with the bounds of its box times a number."""

    def times(bounds: Any, factor: float) -> Any:
        if isinstance(bounds, hf.Ball):
            return dataclasses.replace(bounds, radius=bounds.radius * factor)
        if isinstance(bounds, hf.Box):
            return hf.Box(
                tuple(v * factor for v in bounds.lower), tuple(v * factor for v in bounds.upper)
            )
        return bounds

    return dataclasses.replace(
        system,
        input_bounds=times(system.input_bounds, inputs),
        disturbance_bounds=times(system.disturbance_bounds, disturbance),
    )


def _decisions(change: Callable[[Any, np.ndarray, np.ndarray], np.ndarray]) -> None:
    """Change the inputs that filters give."""
    real = hf.SafetyFilter.step_many

    class Changed:
        def __init__(self, decisions: Any, u: np.ndarray) -> None:
            self._decisions, self.input = decisions, u

        def __getattr__(self, name: str) -> Any:
            return getattr(self._decisions, name)

    def step_many(self: Any, states: Any, commands: Any, **k: Any) -> Any:
        decisions = real(self, states, commands, **k)
        return Changed(decisions, change(self, np.array(decisions.input), np.asarray(commands)))

    hf.SafetyFilter.step_many = step_many  # type: ignore[method-assign,assignment]


def inputs_beyond_bounds() -> None:
    """Inputs are five per cent larger than the filter means."""
    _decisions(lambda keep, u, w: 1.05 * u)


def commands_let_through() -> None:
    """Every fourth vehicle is given its command, within bounds, instead of the filter's input."""

    def change(keep: Any, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        bold = np.arange(len(u)) % 4 == 0
        return np.where(bold[:, None], np.clip(w, u.min(axis=0), u.max(axis=0)), u)

    _decisions(change)


def passed_in_words() -> None:
    """The status is `passed`, whatever was done."""
    real = hf.SafetyFilter.step_many

    def step_many(self: Any, *a: Any, **k: Any) -> Any:
        decisions = real(self, *a, **k)

        class Told:
            input = decisions.input
            status = [type(decisions.status[0])("passed")] * len(decisions.status)

        return Told()

    hf.SafetyFilter.step_many = step_many  # type: ignore[method-assign,assignment]


def no_margin() -> None:
    """Filters of kernels allow for no loss between samples, and say so."""
    _filter_with(margin=0.0)
    hf.sampled_margin = lambda *a, **k: 0.0  # type: ignore[assignment]


def ignored_delay() -> None:
    """Filters count with measurements that are not late, and so does their margin."""
    _filter_with(delay=0.0)
    real = hf.sampled_margin
    hf.sampled_margin = lambda system, value, sample_time, delay=0.0: real(
        system, value, sample_time
    )  # type: ignore[assignment]


def _filter_with(**fixed: Any) -> None:
    real = hf.SafetyFilter.__init__

    def made(self: Any, system: Any, keep: Any, **k: Any) -> None:
        if isinstance(keep, hf.ValueFunction):
            k |= fixed
        real(self, system, keep, **k)

    hf.SafetyFilter.__init__ = made  # type: ignore[method-assign]


def checker_skips_cells() -> None:
    """The checker looks at every tenth entry."""
    from holdfast_check import checker

    real, seen = checker.Checker.entry, [0]

    def entry(self: Any, *a: Any) -> None:
        seen[0] += 1
        if seen[0] % 10 == 0:
            real(self, *a)

    checker.Checker.entry = entry


def certified_for_weaker_disturbance() -> None:
    """Certificates are found for half of the disturbance, the filter counts with that."""
    from attacks import certificates

    real, filter_ = hf.certify, hf.CertifiedFilter
    certificates.hf.certify = lambda s, *a, **k: real(_with_bounds(s, disturbance=0.5), *a, **k)  # type: ignore[assignment]
    certificates.hf.CertifiedFilter = lambda c, s: filter_(c)  # type: ignore[misc,assignment]


def narrower_intervals() -> None:
    """Intervals are .7 of their width."""
    from attacks import identification

    real = hf.identify

    def narrowed(*a: Any, **k: Any) -> Any:
        found = real(*a, **k)
        return dataclasses.replace(
            found,
            parameters=tuple(
                dataclasses.replace(
                    e,
                    low=e.value - 0.7 * (e.value - e.low),
                    high=e.value + 0.7 * (e.high - e.value),
                )
                for e in found.parameters
            ),
        )

    identification.hf.identify = narrowed  # type: ignore[assignment]


def a_traceback() -> None:
    """Files with a misspelt key end in a KeyError."""
    from holdfast.errors import HoldfastError

    real = HoldfastError.__str__

    def text(self: Any) -> str:
        told = real(self)
        if "unknown" in told or "did you mean" in told:
            raise KeyError(told)
        return told

    HoldfastError.__str__ = text  # type: ignore[method-assign]


def a_long_message() -> None:
    """Refusals take three lines."""
    from holdfast.errors import HoldfastError

    real = HoldfastError.__str__
    HoldfastError.__str__ = lambda self: real(self) + "\nsee\nthe manual"  # type: ignore[method-assign]


LOST, KEPT = "has states that are surely lost", "lacks states that are surely kept"
BREAKAGES: dict[str, Breakage] = {
    "sets larger by four cells": Breakage(larger_sets, "kernels", LOST, 60),
    "sets smaller by six cells": Breakage(smaller_sets, "kernels", KEPT, 60),
    "a disturbance that is ignored": Breakage(ignored_disturbance, "kernels", LOST, 120),
    "inputs half as large again in kernels": Breakage(enlarged_inputs, "kernels", LOST, 120),
    "inputs beyond their bounds": Breakage(
        inputs_beyond_bounds, "filters", "beyond its bounds", 12
    ),
    "a quarter of the commands let through": Breakage(
        commands_let_through, "filters", "loses what it promised", 40
    ),
    "a status that lies": Breakage(passed_in_words, "filters", "its status is not", 12),
    "no margin for the sample time": Breakage(no_margin, "filters", "loses what it promised", 120),
    "a delay that is ignored": Breakage(ignored_delay, "filters", "loses what it promised", 200),
    "a checker that skips cells": Breakage(
        checker_skips_cells, "forged certificates", "passes", 40
    ),
    "half of the disturbance in certificates": Breakage(
        certified_for_weaker_disturbance, "certificates", "a run ", 120
    ),
    "intervals of .7 of their width": Breakage(
        narrower_intervals, "identification", "too seldom", 120
    ),
    "a traceback": Breakage(a_traceback, "scenario files", "KeyError", 100),
    "a message of three lines": Breakage(
        a_long_message, "scenario files", "more than one line", 40
    ),
}


def prove(workers: int = 2, seed: int = 3) -> int:
    """Plant every breakage in turn; 0 if each is found within its cases, and not without it."""
    from attacks import engine

    missed = 0
    by_name = {k.name: k for k in engine.kinds()}
    for name, breakage in BREAKAGES.items():
        tallies = engine.run(
            [by_name[breakage.kind]],
            seed,
            count=breakage.within,
            workers=workers,
            planted=name,
            until=breakage.words,
        )
        t = tallies[breakage.kind]
        at = next((n for s, (n, _) in t.first.items() if breakage.words in s), None)
        missed += at is None
        told = "NOT found" if at is None else f"found in case {at}" if at >= 0 else "found"
        print(f"{name}: {told}, {t.cases} cases of at most {breakage.within}", flush=True)
    return int(missed > 0)
