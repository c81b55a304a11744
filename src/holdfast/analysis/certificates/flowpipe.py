"""Flowpipes: what is proved of all states of one box, as a file that another program follows.

Its steps are as long as a tolerance lets them be, and a box is divided in parts. What is tried is
what `holdfast-check` follows afterwards, by its own arithmetic: nothing is found that it does not
accept.
"""

from __future__ import annotations

import itertools
import json
import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.certificates.certificate import (
    Range,
    check_functions,
    check_names,
    limits_written,
    named,
    part_of_checker,
    ranged,
    write_checked,
    written,
)
from holdfast.analysis.certificates.law_cells import law_of_cases
from holdfast.analysis.certificates.problem import check_among, errors_of, parameters_of, ranges_of
from holdfast.arguments import checked
from holdfast.errors import OutputError, SimulationError
from holdfast.execution.arrays import Array
from holdfast.maths.definitions.law import Law, LawCases, Option
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact, exchanged, plain_text, symbols_of

FINEST = 24
"""A step is the hold divided by 2^FINEST at least."""
NARROWED = 3
"""How often a step is halved because a constraint may fail on it, before the box is divided."""
GROWTH = 0.01
"""By what part of what the polynomials leave out a step may add to it."""
PATIENCE = 8
"""Steps before one twice as long is tried again."""

Part = list[tuple[Fraction, Fraction]]


class _StuckError(Exception):
    """What could not be proved from a part of the box, and the states there."""

    def __init__(self, said: str, states: Any) -> None:
        super().__init__(said)
        self.states = states


class Search:
    """A flowpipe of a header in the form of its file.

    tolerance: by how much a step may miss trajectories. most: into how many parts the box is
    divided. splits, levels: what the file has of the parts and of the steps.
    """

    def __init__(self, header: Mapping[str, Any], tolerance: float, most: int) -> None:
        reading = part_of_checker("reading")
        part_of_checker("checker").begin()
        self._intervals = part_of_checker("intervals")
        self._stopped = (reading.NotValidError, part_of_checker("taylor").NoModelError)
        blank = {"splits": [], "entries": 0}
        try:
            said = reading.formed({**header, **blank}, reading.FLOWPIPE, "the header")
            self.pipe = part_of_checker("flowpipe").Flowpipe(said)
        except reading.NotValidError as error:
            raise SimulationError(str(error)) from None
        self.tolerance, self.most, self._most_steps = tolerance, most, reading.LITTLE
        self.splits: list[int] = []
        self.levels: list[int] = []
        self._first = self._begin = 0
        self._rows: list[tuple[float, ...]] = []
        self._ends: list[list[tuple[float, float]]] = []

    @property
    def boxes(self) -> tuple[Array, Array, Array]:
        """When, and between what, all states are: shapes (samples, 2), (samples, states) and
        (samples, states)."""
        n = len(self.pipe.states)
        rows = np.array(self._rows, dtype=float).reshape(-1, 2 + 2 * n)
        return rows[:, :2], rows[:, 2 : 2 + n], rows[:, 2 + n :]

    @property
    def ends(self) -> dict[str, tuple[float, float]]:
        """Between what all states are at the end."""
        ends = np.array(self._ends, dtype=float).reshape(-1, len(self.pipe.states), 2)
        return {
            name: (float(q[:, 0].min()), float(q[:, 1].max()))
            for name, q in zip(self.pipe.states, ends.swapaxes(0, 1), strict=True)
        }

    def run(
        self,
        middle: Callable[[dict[str, tuple[float, float]]], Search] | None = None,
        progress: Callable[[str, float], None] | None = None,
    ) -> tuple[bool, str]:
        """Whether it was found, and what could not be proved.

        middle: a search from the middle of a part of the box alone. Where that is stuck too, no
        smaller parts are tried.
        """
        pipe, count = self.pipe, 1
        whole = [(Fraction(a), Fraction(b)) for a, b in pipe.box]
        waiting: list[tuple[Part, float]] = [(whole, 1.0)]
        done = 0.0
        while waiting:
            part, share = waiting.pop()
            rows, ends = len(self._rows), len(self._ends)
            try:
                levels = self._from(part)
            except _StuckError as stuck:
                count += 1
                if count > self.most or not pipe.wide:
                    return False, f"from {pipe.named(part)} {stuck}"
                if middle is not None:
                    sides = [(float(a), float(b)) for a, b in part]
                    proved, why = middle(dict(zip(pipe.carried, sides, strict=False))).run()
                    if not proved:
                        return False, why
                del self._rows[rows:], self._ends[ends:]
                split = self._side(stuck.states)
                side = pipe.wide[split]
                self.splits.append(split)
                low, high = part[side]
                for half in ((low + high) / 2, high), (low, (low + high) / 2):
                    halved = [half if k == side else q for k, q in enumerate(part)]
                    waiting.append((halved, share / 2))
                continue
            self.splits.append(-len(levels))
            self.levels += levels
            done += share
            if progress is not None:
                progress("box", done)
        return True, ""

    def _from(self, part: Part) -> list[int]:
        """The levels of all steps from a part. Raises `_StuckError`."""
        pipe, levels = self.pipe, list[int]()
        self._begin = self._first
        waiting = [(0, pipe.law.initial, pipe.begun(part))]
        while waiting:
            sample, mode, x = waiting.pop()
            when = f"after {sample * pipe.hold:g} s"
            try:
                if sample == pipe.holds:
                    at = pipe.at(x, x.off)
                    if (k := pipe.failing(pipe.target, at)) is not None:
                        raise _StuckError(f"target {k} may be missed {when}", x)
                    ranges = pipe.over(at)
                    self._ends.append([self._outward(ranges[n]) for n in pipe.states])
                    continue
                for begun, to in pipe.after_sample(x, mode):
                    waiting.append((sample + 1, to, self._through(begun, sample, levels)))
            except self._stopped as error:
                raise _StuckError(f"{when}: {error}", x) from None
        return levels

    def _through(self, x: Any, sample: int, levels: list[int]) -> Any:
        """The states at the next sample."""
        pipe, passed, level = self.pipe, Fraction(0), self._begin
        since, coarsest = PATIENCE, FINEST  # that the tolerance alone has let be
        while passed < 1:
            step = None
            for finer in itertools.count(level):
                level, length = finer, Fraction(1, 1 << finer)
                step = pipe.after(x, length)
                when = f"{float((sample + passed) * Fraction(pipe.hold)):g} s"
                if step is not None and self._missed(step, x) <= self.tolerance:
                    coarsest = min(coarsest, level)
                    if step.constraint is None:
                        break
                    if level >= coarsest + NARROWED:
                        raise _StuckError(f"constraint {step.constraint} may fail after {when}", x)
                if level == FINEST:
                    raise _StuckError(f"the states after {when} are too many to be followed", x)
                since = 0
            if len(self.levels) + len(levels) == self._most_steps:  # more are not read
                raise _StuckError(f"more than {self._most_steps} steps are needed", x)
            assert step is not None
            self._drawn(step, sample, passed, length)
            x, passed, since = step.ends, passed + length, since + 1
            levels.append(level)
            self._first = levels[0]
            coarsest = FINEST if level <= coarsest else coarsest
            aligned = level > 0 and (passed * (1 << (level - 1))).denominator == 1
            if aligned and since >= PATIENCE:
                level -= 1
        self._begin = level
        return x

    def _missed(self, step: Any, x: Any) -> float:
        """By how much a step misses trajectories, beyond what was left out before it."""
        added, before = (max((float(q[1] - q[0]) for q in row), default=0.0)
                         for row in (step.left, x.off))  # fmt: skip
        return added - GROWTH * before if added < np.inf else np.inf

    def _drawn(self, step: Any, sample: int, passed: Fraction, length: Fraction) -> None:
        n = len(self.pipe.states)
        times = [float((sample + t) * Fraction(self.pipe.hold)) for t in (passed, passed + length)]
        low, high = zip(*map(self._outward, step.way[:n]), strict=True)
        self._rows.append((*times, *low, *high))

    def _outward(self, q: Any) -> tuple[float, float]:
        return float(self._intervals.down(q)), float(self._intervals.up(q))

    def _side(self, x: Any) -> int:
        """Which side of the box to halve: that of which the states depend in curves the most."""
        scores = np.zeros((2, len(self.pipe.wide)))
        for p in x.polynomials[: len(self.pipe.states)]:
            terms = [(self.pipe.models.exponents[k][:-1], abs(float(c))) for k, c in p.items()]
            scale = sum(size for powers, size in terms if any(powers)) or 1.0
            for powers, size in terms:
                if any(powers):
                    scores[int(sum(powers) == 1)] += np.array(powers) / sum(powers) * size / scale
        curved, straight = scores
        return int(np.argmax(curved if curved.max() > 1e-6 else straight))


MAGIC = "holdfast-flowpipe 1"
DEGREES, TOLERANCE, PARTS = (3, 6), 1e-5, 64


@dataclass(frozen=True)
class Flowpipe:
    """What all trajectories from a box do for a time, whatever the disturbances.

    header: what its file says. proved: whether they keep the region, and are in the target at the
    end where there is one. why: what could not be proved, and from where. splits, levels: the parts
    of the box and the steps from each. times, low, high: boxes that contain all states, each from
    times[k, 0] to times[k, 1] [s]; shapes (boxes, 2), (boxes, states) twice. ends: between what
    each state is at the end.
    """

    header: Mapping[str, Any]
    proved: bool
    why: str
    splits: tuple[int, ...]
    levels: bytes
    times: Array
    low: Array
    high: Array
    ends: Mapping[str, Range]

    @property
    def states(self) -> tuple[tuple[str, str], ...]:
        """Their names and units."""
        return tuple((q["name"], q["unit"]) for q in self.header["states"])

    @property
    def start(self) -> dict[str, Range]:
        """Between what each state is at first."""
        ends = [(float.fromhex(low), float.fromhex(high)) for low, high in self.header["start"]]
        return {name: q for (name, _), q in zip(self.states, ends, strict=True)}

    @property
    def seconds(self) -> float:
        """The horizon [s]."""
        return float.fromhex(self.header["hold"]) * self.header["holds"]

    @property
    def parts(self) -> int:
        """Into how many the box is divided."""
        return sum(split < 0 for split in self.splits)

    def summary(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "title": self.header["title"],
            "proved": self.proved,
            "why": self.why,
            "seconds": self.seconds,
            "start": {name: list(ends) for name, ends in self.start.items()},
            "ends": {name: list(ends) for name, ends in self.ends.items()},
            "parts": self.parts,
            "steps": len(self.levels),
            "target": bool(self.header["target"]),
            "degrees": list(self.header["degrees"]),
        }

    def write(self, path: str | Path) -> Path:
        """The file: its kind and digest, one line of JSON, and how small each step is.

        Raises `OutputError` where nothing is proved.
        """
        path = Path(path)
        if not self.proved:
            raise OutputError(f"nothing is proved: {self.why}")
        header = {**self.header, "splits": list(self.splits), "entries": len(self.levels)}
        write_checked(path, MAGIC, header, zlib.compress(self.levels, 6))
        return path


@checked
def flowpipe(
    system: System,
    region: Region,
    *,
    start: Mapping[str, Range],
    horizon: float,
    law: Law | Switching | None = None,
    sample_time: float | None = None,
    target: Region | None = None,
    uncertain: Mapping[str, Range] | None = None,
    disturbance: Mapping[str, float] | None = None,
    errors: Mapping[str, float] | None = None,
    degrees: tuple[int, int] = DEGREES,
    tolerance: float = TOLERANCE,
    parts: int = PARTS,
    progress: Callable[[str, float], None] | None = None,
) -> Flowpipe:
    """Proves that all trajectories from one box keep `region` for `horizon` [s] (a reachable tube).

        xdot = f(x, u, d; p),    x(0) in the box,    d(t) in D at every instant, p in P

    Every state at every instant is in a Taylor model: a polynomial of the initial state, of the
    uncertain parameters and of time, and a zonotope of what that leaves out (M. Berz, K. Makino;
    R. Lohner and A. Girard for how it is carried on). Every rounding is counted, the arithmetic is
    that of `holdfast-check`, and `Flowpipe.write` makes a file that it follows.

    start: state -> (low, high), which may be one number. law: it gives the inputs, limited as the
    system limits them: at the samples, every `sample_time` [s], or at every instant where that is
    None. target: a region in which all are at the end. uncertain: parameter -> range, one number
    all the time. disturbance: those that are known and constant; others are any within their
    bounds, at every instant. errors: state -> by how much it may be measured wrong. degrees: those
    of the polynomials in the initial state and in time. tolerance: by how much a step may miss
    trajectories, in the units of the states. parts: into how many the box is divided at most.

    Where it is not `proved` the statement may hold all the same: `why` says what failed, and where.

    Raises `SimulationError` for numbers out of range, for a law that remembers, has a safeguard or
    depends on time, and without python-flint; `DefinitionError` for functions without a proved
    enclosure and for a law that does not fit the system.

    >>> start = {"x": (0.4, 0.5), "v": (-0.1, 0.1)}
    >>> hf.flowpipe(cart, track, start=start, horizon=1.0, law=brake).proved
    True
    """
    sizes = len(degrees) == 2 and all(1 <= d <= 12 for d in degrees)
    if not (tolerance > 0 and parts >= 1 and sizes):
        raise SimulationError(
            f"tolerance {tolerance:g}, parts {parts}, degrees {degrees}",
            expected="a tolerance above 0, parts from 1 on, two degrees from 1 to 12",
        )
    header = statement(
        system, region, start=start, horizon=horizon, law=law, sample_time=sample_time,
        target=target, uncertain=uncertain, disturbance=disturbance, errors=errors, degrees=degrees,
    )  # fmt: skip
    search = Search(header, tolerance, parts)
    proved, why = True, ""
    if search.pipe.wide:
        proved, why = Search(_middle(header), tolerance, 1).run()
    if proved:
        proved, why = search.run(lambda part: Search(_middle(header, part), tolerance, 1), progress)
    times, low, high = search.boxes
    return Flowpipe(
        header, proved, why, tuple(search.splits), bytes(search.levels), times, low, high,
        search.ends if proved else {},
    )  # fmt: skip


def statement(
    system: System,
    region: Region,
    *,
    start: Mapping[str, Range],
    horizon: float,
    law: Law | Switching | None = None,
    sample_time: float | None = None,
    target: Region | None = None,
    uncertain: Mapping[str, Range] | None = None,
    disturbance: Mapping[str, float] | None = None,
    errors: Mapping[str, float] | None = None,
    degrees: tuple[int, int] = DEGREES,
) -> dict[str, Any]:
    """What the file of such a flowpipe says is proved, but for its parts and steps."""
    regions = (region, target) if target is not None else (region,)
    ranges = ranges_of(system, regions, dict(uncertain or {}), dict(disturbance or {}))
    box = _start(system, start)
    holds, hold = _holds(horizon, sample_time)
    if sample_time is None and any((errors or {}).values()):
        raise SimulationError(
            "errors of measurement without samples",
            expected="a sample_time, at which a law measures",
        )
    if system.inputs and law is None:
        raise SimulationError(f"the inputs of '{system.name}' are unknown", remedy="give a law")
    rates = tuple(system.rates[q.name] for q in system.states)
    cases = None if law is None else law_of_cases(system, law, ranges, hold, ())
    inputs = list(system.inputs)
    if cases is not None and (sample_time is None or not inputs):
        rates = _at_every_instant(system, rates, cases)
        cases, inputs = None, []
    parameters = parameters_of(system, regions)
    limits = [tuple((c.name, c.unit, c.expression) for c in r.inequalities) for r in regions]
    expressions = [*rates, *(e for several in limits for *_, e in several)]
    expressions += cases.expressions if cases is not None else ()
    check_functions(expressions)
    check_names([q.name for q in (*system.states, *inputs, *system.disturbances)])
    check_names(parameters)
    used = symbols_of(expressions)
    counted = [p for p in parameters.values() if p.symbol in used]
    title = f"{system.name} in {region.name}" + (f" to {target.name}" if target else "")
    return {
        "title": title + (f", by {law.name}" if law else ""),
        "states": named([(q.name, q.unit) for q in system.states]),
        "inputs": named([(q.name, q.unit) for q in inputs]),
        "disturbances": ranged([(q.name, q.unit) for q in system.disturbances], ranges),
        "parameters": ranged([(p.name, p.unit) for p in counted], ranges),
        "rates": [plain_text(r) for r in rates],
        "constraints": limits_written(limits[0]),
        "target": limits_written(limits[1]) if target else [],
        "law": [] if cases is None else written(cases, (), plain_text),
        "hold": hold.hex(),
        "holds": holds,
        "errors": [e.hex() for e in errors_of(system, errors or {})],
        "start": [[v.hex() for v in box[q.name]] for q in system.states],
        "degrees": list(degrees),
    }


def read_statement(file: Path) -> dict[str, Any] | None:
    """What the file of a flowpipe says is proved; None for a file of something else.

    That it is proved `holdfast-check` says. Raises `OutputError` for one that cannot be read.
    """
    if not file.is_file():
        return None
    try:
        first, text, *_ = (*file.read_bytes().split(b"\n", 2), b"")
        if not first.startswith(MAGIC.encode() + b" "):
            return None
        header = json.loads(text)
    except (OSError, ValueError, RecursionError) as error:
        raise OutputError(f"{file} cannot be read ({error})") from None
    if not isinstance(header, dict):
        raise OutputError(f"{file} is damaged: its header is no table")
    return header


def _start(system: System, start: Mapping[str, Range]) -> dict[str, Range]:
    check_among("start", start, system.state_names, "state")
    box = {}
    for name in system.state_names:
        if name not in start:
            raise SimulationError(f"start lacks the state '{name}'")
        low, high = map(float, start[name])
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise SimulationError(f"start: {name} is {low:g} to {high:g}")
        box[name] = low, high
    return box


def _middle(header: Mapping[str, Any], part: Mapping[str, Range] | None = None) -> dict[str, Any]:
    """The same of one state and of one number for each parameter: what fails here fails for all.

    part: the ranges of a part of the box, by names.
    """

    def point(name: str, ends: list[str]) -> list[str]:
        low, high = (part or {}).get(name, tuple(map(float.fromhex, ends)))
        return 2 * [(low + (high - low) / 2).hex()]

    parameters = [{**q, "range": point(q["name"], q["range"])} for q in header["parameters"]]
    start = zip(header["states"], header["start"], strict=True)
    points = [point(q["name"], ends) for q, ends in start]
    return {**header, "start": points, "parameters": parameters}


def _holds(horizon: float, sample_time: float | None) -> tuple[int, float]:
    """How many samples the horizon is, no less, and how long each is."""
    for name, value in (("horizon", horizon), ("sample_time", sample_time)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise SimulationError(f"{name} is {value:g}", expected="seconds, above 0")
    if sample_time is None:
        return 1, float(horizon)
    return math.ceil(horizon / sample_time - 1e-9), float(sample_time)


def _at_every_instant(
    system: System, rates: tuple[sp.Expr, ...], cases: LawCases
) -> tuple[sp.Expr, ...]:
    """The rates with what a law gives in place of the inputs."""
    ((*options,), *others) = cases.options
    only = options[0]
    if others or len(options) > 1 or not isinstance(only, Option) or cases.lookup is not None:
        raise SimulationError(
            "a law with modes, branches, a safeguard or a table gives inputs at samples",
            remedy="give a sample_time",
        )
    by_law = {q.symbol: e for q, e in zip(system.inputs, only.inputs, strict=True)}
    if set(by_law) & symbols_of(only.inputs):
        raise SimulationError("the law leaves its inputs free", expected="one that gives them")
    return tuple(exchanged(map(exact, rates), by_law))
