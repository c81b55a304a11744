"""What a law may do at a sample, all of it: its modes, its safeguard and its table as cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import sympy as sp

from holdfast.analysis.certificates.certificate import Range
from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.codegen.controller_program import ControllerProgram, controller_program
from holdfast.execution.intervals.law_ranges import MOST_SETS, sets_of
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.law import Law, Safeguard
from holdfast.maths.definitions.law_cases import Conditions, LawCases, Option, Program
from holdfast.maths.definitions.lookup import CellLookup
from holdfast.maths.definitions.quantity import SAMPLE_TIME, TIME, TIME_IN_MODE
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.branches import branches
from holdfast.maths.expressions.functions import least
from holdfast.maths.expressions.traversal import exact, exchanged, symbols_of

Parts = tuple[tuple[float, ...], ...]
_Branch = tuple[Conditions, tuple[Option | Program, ...]]


def law_of_cases(
    system: System,
    law: Law | Switching,
    ranges: Mapping[str, Range],
    sample_time: float,
    parts: Parts,
) -> LawCases:
    """The cases of a law for a system whose inputs are held for `sample_time` [s].

    ranges: of parameters and disturbances. parts: see `LawCases`. At every sample the first
    transition whose guard holds is taken. What is handed to the law may be anything: then its
    inputs are any within their bounds, and within its safeguard where it has one. A guard on the
    time in the mode may hold or not.

    Raises `DefinitionError` for a law that does not fit the system, `SimulationError` for one that
    remembers, depends on time or on an uncertain parameter, or looks up what is no stationary
    value.
    """
    program = controller_program(system, law)
    _check(program, ranges)
    found = _Cases(program, sample_time, bool(parts))
    options = tuple(found.of_mode(k) for k in range(len(program.modes)))
    lookup = program.lookup
    if lookup is not None:
        lookup = lookup.subs(found.numbers)
    given = LawCases(program.modes, program.initial_mode, options, parts, lookup)
    _check_symbols(program, given)
    return given


class _Cases:
    def __init__(self, program: ControllerProgram, sample_time: float, bounded: bool) -> None:
        self.program, self.system, self.bounded = program, program.system, bounded
        numbers = {p.symbol: exact(p.value) for p in program.parameters}
        self.numbers = {**numbers, SAMPLE_TIME: exact(sample_time)}
        self.inputs = program.inputs
        self.handed = {q.symbol for q in program.handed}
        self._known: dict[int, list[_Branch]] = {}

    def of_mode(self, mode: int) -> tuple[Option | Program, ...]:
        """The options of a sample before which the law is in this mode."""
        passed: list[Conditions] = [()]  # the ways in which no guard before holds
        found: list[Option | Program] = []
        for guard, target in self.program.transitions.get(self.program.modes[mode], ()):
            parts = _all_of(guard)
            for way in passed:
                found += self._after((*way, *(-e for e in parts)), target)
            passed = [(*way, e) for way in passed for e in parts]
        return (*found, *(o for way in passed for o in self._after(way, mode)))

    def _after(self, taken: Conditions, mode: int) -> list[Option | Program]:
        """The options of the law of a mode, where these conditions hold."""
        return [
            replace(o, when=(*more, *conditions, *now, *o.when), to=mode)
            for more, now in branches(self._exact(taken))
            for conditions, options in self._law(mode)
            for o in options
        ]

    def _law(self, mode: int) -> list[_Branch]:
        """The branches of the law of a mode: conditions, and options within them."""
        if mode not in self._known:
            name, m = self.program.modes[mode], len(self.inputs)
            guard = self.program.safeguards.get(name)
            rows = guard.rows(self.system.input_names) if guard else []
            self._known[mode] = []
            for conditions, now in branches(self._exact([*self.program.commands(name), *rows])):
                wanted, numbers = now[:m], now[m:]
                options: tuple[Option | Program, ...] = self._plain(wanted)
                if guard:
                    options = (self._guarded(guard, wanted, numbers),)
                self._known[mode].append((conditions, options))
        return self._known[mode]

    def _exact(self, expressions: Sequence[Any]) -> list[sp.Expr]:
        return [exact(e) for e in exchanged(map(exact, expressions), self.numbers)]

    def _plain(self, wanted: Sequence[sp.Expr]) -> tuple[Option, ...]:
        if self.handed & symbols_of(wanted):
            return (self._free(),)
        return (Option((), self._saturated(wanted)),)

    def _free(self) -> Option:
        if not self.bounded:
            raise SimulationError(
                f"the inputs of law '{self.program.switching.name}' may be anything",
                expected="a system with bounds of its inputs",
            )
        return Option(self._within(), tuple(self.inputs))

    def _guarded(
        self, guard: Safeguard, wanted: Sequence[sp.Expr], numbers: Sequence[sp.Expr]
    ) -> Program:
        m, count = len(self.inputs), len(guard.offsets)
        free, box = bool(self.handed & symbols_of(wanted)), self._box()
        if box is None and not self.bounded:
            self._free()  # which refuses
        if len(sets := sets_of(count, m, wanted=not free)) > MOST_SETS:
            raise DefinitionError(
                f"a safeguard with {len(sets)} sets of conditions", expected=f"at most {MOST_SETS}"
            )
        rows = tuple(tuple(numbers[j * (m + 1) : (j + 1) * (m + 1)]) for j in range(count))
        return Program(
            when=(),
            wanted=None if free else tuple(wanted),
            rows=rows,
            hard=guard.hard,
            scales=tuple(numbers[count * (m + 1) :]),
            limits=self._saturated(self.inputs),
            box=None if box is None else tuple(zip(box.lower, box.upper, strict=True)),
        )

    def _box(self) -> Box | None:
        bounds = self.system.input_bounds
        if not isinstance(bounds, Box):
            return None
        return Box(tuple(self._exact(bounds.lower)), tuple(self._exact(bounds.upper)))

    def _saturated(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """The inputs that the actuators make of those that are asked for."""
        bounds = self.system.input_bounds
        return tuple(self._exact(bounds.saturate(values) if bounds is not None else values))

    def _within(self) -> Conditions:
        """What limited inputs meet, beyond their ranges."""
        bounds = self.system.input_bounds
        if bounds is None or isinstance(bounds, Box) or len(self.inputs) < len(bounds.actuators):
            return ()
        try:
            rows = bounds.half_spaces()
        except DefinitionError:
            return ()
        left = [
            sp.Add(*(a * u for a, u in zip(normal, self.inputs, strict=True))) - most
            for normal, most in rows
        ]
        return tuple(self._exact(left))


def _all_of(guard: sp.Expr) -> list[sp.Expr]:
    """What all has to hold where a guard holds."""
    if isinstance(guard, least | sp.Min):
        return [e for part in guard.args for e in _all_of(part)]
    return [guard]


def _check(program: ControllerProgram, ranges: Mapping[str, Range]) -> None:
    law, system = program.switching, program.system
    if program.remembered:
        raise SimulationError(
            f"law '{law.name}' remembers {', '.join(q.name for q in program.remembered)}",
            expected="a law without memory, such as one without an observer or limits of rates",
        )
    if isinstance(program.lookup, CellLookup):
        raise SimulationError(
            f"law '{law.name}' is that of a certificate, which proves it",
            remedy="check the certificate: holdfast-check FILE",
        )
    if any(guard.foresight for guard in program.safeguards.values()):
        raise SimulationError(
            f"law '{law.name}' looks at a value a sample ahead, which is no half-space of inputs",
            expected="a law of the slopes of a value",
            remedy="take safety_law(..., ahead=False)",
        )
    if program.lookup is not None and program.lookup.timed:
        raise SimulationError(
            f"law '{law.name}' looks up a value that depends on the time left",
            expected="a kernel that has converged, or one that is stored at its last time only",
        )
    limits = system.input_bounds.free_symbols if system.input_bounds is not None else set()
    used = symbols_of([*program.expressions, *limits])
    for p in system.parameters:
        if p.symbol in used and ranges[p.name] != (p.value, p.value):
            raise SimulationError(
                f"law '{law.name}' or the limits of its inputs use '{p.name}', which is uncertain",
                expected="a law whose inputs do not depend on it",
            )


def _check_symbols(program: ControllerProgram, given: LawCases) -> None:
    known = {q.symbol for q in (*program.measurements, *program.system.inputs)}
    known |= set(given.lookup.symbols) if given.lookup else set()
    known |= {TIME_IN_MODE}
    if odd := symbols_of(given.expressions) - known:
        told = {TIME: "the time"}
        handed = {q.symbol for q in program.handed}
        which = ", ".join(sorted(told.get(s, str(s)) for s in odd))
        raise SimulationError(
            f"law '{program.switching.name}' uses {which}"
            + (", which others hand it, beyond its outputs" if odd & handed else ""),
            expected="states, and disturbances that are measured",
        )
