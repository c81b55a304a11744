"""Flowpipes: what is proved of all states of one box, as a file that another program follows."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sympy as sp

from holdfast.analysis.certificates.cells import Floats
from holdfast.analysis.certificates.certificate import (
    Range,
    check_functions,
    check_names,
    limits_written,
    named,
    ranged,
    write_checked,
)
from holdfast.analysis.certificates.flowpipe_search import Search
from holdfast.analysis.certificates.law_cells import law_of_cases
from holdfast.analysis.certificates.law_written import written
from holdfast.analysis.certificates.problem import check_among, errors_of, parameters_of, ranges_of
from holdfast.arguments import checked
from holdfast.errors import OutputError, SimulationError
from holdfast.maths.definitions.law import Law, LawCases, Option
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact, exchanged, plain_text, symbols_of

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
    times: Floats
    low: Floats
    high: Floats
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

    def write(self, path: Path) -> Path:
        """The file: its kind and digest, one line of JSON, and how small each step is.

        Raises `OutputError` where nothing is proved.
        """
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
