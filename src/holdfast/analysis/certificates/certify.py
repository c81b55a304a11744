"""Certify: a proof that held inputs keep a system in a region, whatever the disturbances."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import sympy as sp

from holdfast.analysis.certificates.cells import Cells, Floats
from holdfast.analysis.certificates.certificate import (
    Certificate,
    Range,
    check_functions,
    check_names,
)
from holdfast.analysis.certificates.keeping import kept
from holdfast.arguments import checked
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.execution.intervals.held_flow import HeldFlow, exact
from holdfast.execution.intervals.interval import TURN
from holdfast.maths.definitions.bounds import Bounds
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import symbols_of

ROUNDED = 1e-12
"""By which an input on a bound may exceed it, as floats do."""

INPUTS = 5
"""Values of each input that are tried, evenly between its bounds."""


@checked
def certify(
    system: System,
    region: Region,
    *,
    box: Mapping[str, Range],
    cells: int | Mapping[str, int] = 101,
    sample_time: float = 0.1,
    horizon: float | None = None,
    inputs: int | Mapping[str, int] = INPUTS,
    uncertain: Mapping[str, Range] | None = None,
    disturbance: Mapping[str, float] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Certificate:
    """The largest set of cells in `region` that inputs held for `sample_time` [s] keep there.

    A cell belongs to it if an input leads from every state of the cell to cells of the set, and
    keeps the region at every instant between the samples, for every disturbance within its bounds
    and every number of `uncertain` within its range. Every rounding is counted: the set is a subset
    of the sampled-data viability (discriminating) kernel, and `Certificate.write` makes a file
    that `holdfast-check` checks.

    box: state -> (low, high), the cells of which are tried; an angle over a whole turn comes back
    to itself where rates and constraints have it in sines and cosines alone. cells: along each
    state. horizon [s]: None is for ever. inputs: how many values of each input are tried between
    its bounds. uncertain: parameter -> range, such as a mass that is wrong by a fifth. disturbance:
    those that are known and constant; others are any within their bounds, at every instant.

    Raises `SimulationError` for a box that lacks a state, inputs without bounds and numbers out of
    range, `DefinitionError` for functions without a proved enclosure.
    """
    ranges = _ranges(system, region, dict(uncertain or {}), dict(disturbance or {}))
    expressions = [*system.rates.values(), *(c.expression for c in region.inequalities)]
    check_functions(expressions)
    check_names([q.name for q in (*system.states, *system.inputs, *system.disturbances)])
    check_names([p.name for p in (*system.parameters, *region.parameters)])
    grid = _cells(system, box, cells, expressions)
    if not (math.isfinite(sample_time) and sample_time > 0):
        raise SimulationError(f"sample_time is {sample_time:g}", expected="seconds, above 0")
    holds = None
    if horizon is not None:
        if not (math.isfinite(horizon) and horizon > 0):
            raise SimulationError(f"horizon is {horizon:g}", expected="seconds, above 0")
        holds = math.ceil(horizon / sample_time - 1e-9)
    parameters = _parameters(system, region)
    rates = tuple(system.rates[q.name] for q in system.states)
    constraints = tuple((c.name, c.unit, c.expression) for c in region.inequalities)
    symbols = {q.name: q.symbol for q in (*system.disturbances, *parameters.values())}
    used = symbols_of(expressions)
    told = [p for p in parameters.values() if p.symbol in used]
    candidates = _candidates(system, inputs, {n: ranges[n] for n in parameters})
    flow = HeldFlow(
        rates,
        [e for _, _, e in constraints],
        [q.symbol for q in system.states],
        [q.symbol for q in system.inputs],
        {symbols[q.name]: ranges[q.name] for q in system.disturbances},
        {p.symbol: ranges[p.name] for p in told},
        sample_time,
    )
    tell = progress or (lambda what, share: None)
    found = kept(flow, grid, candidates, holds, lambda share: tell("images of cells", share))
    return Certificate(
        title=f"{system.name} in {region.name}",
        states=tuple((q.name, q.unit) for q in system.states),
        inputs=tuple((q.name, q.unit) for q in system.inputs),
        disturbances=tuple((q.name, q.unit) for q in system.disturbances),
        parameters=tuple((p.name, p.unit) for p in told),
        ranges={q.name: ranges[q.name] for q in (*system.disturbances, *told)},
        rates=rates,
        constraints=constraints,
        hold=float(sample_time),
        candidates=candidates,
        kept=found,
    )


def _parameters(system: System, region: Region) -> dict[str, Parameter]:
    """Those of both. Raises `SimulationError` where one name has two values."""
    found = {p.name: p for p in region.parameters}
    for p in system.parameters:
        if found.setdefault(p.name, p).value != p.value:
            raise SimulationError(
                f"'{p.name}' is {p.value:g} in system '{system.name}' and {found[p.name].value:g} "
                f"in region '{region.name}'"
            )
    return found


def _ranges(
    system: System, region: Region, uncertain: dict[str, Range], known: dict[str, float]
) -> dict[str, Range]:
    """What each parameter and disturbance may be."""
    found = {p.name: (p.value, p.value) for p in (*system.parameters, *region.parameters)}
    for name, (low, high) in uncertain.items():
        if name not in found:
            raise SimulationError(
                f"uncertain names '{name}', which is no parameter",
                remedy=suggestion(name, found),
            )
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise SimulationError(f"uncertain: {name} is {low:g} to {high:g}")
        found[name] = (float(low), float(high))
    for name in known:
        if name not in system.disturbance_names:
            raise SimulationError(
                f"disturbance names '{name}', which is none",
                remedy=suggestion(name, system.disturbance_names),
            )
    if set(system.disturbance_names) - set(known):
        if system.disturbance_bounds is None:
            raise SimulationError(f"system '{system.name}' has no bounds of its disturbances")
        ends = _ends(system, system.disturbance_bounds, found)
        for name, (least, most) in zip(system.disturbance_names, ends, strict=True):
            found[name] = least[0], most[1]
    return found | {name: (float(v), float(v)) for name, v in known.items()}


def _ends(system: System, bounds: Bounds, ranges: Mapping[str, Range]) -> list[tuple[Range, Range]]:
    """Of each component what its least and its greatest value may be, every rounding counted."""
    ends = [e for pair in bounds.ranges() for e in pair]
    found = _over_parameters(system, ends, ranges)
    if not np.isfinite(found).all():
        raise SimulationError("a bound is not finite", expected="finite bounds of all")
    rows = [(float(a), float(b)) for a, b in found]
    return list(zip(rows[0::2], rows[1::2], strict=True))


def _over_parameters(
    system: System, expressions: Sequence[sp.Expr], ranges: Mapping[str, Range]
) -> Floats:
    """Enclosures of expressions of the parameters, a row each."""
    known = list(system.parameters)
    corners = np.array([[ranges[p.name][end] for p in known] for end in (0, 1)]).reshape(2, 1, -1)
    enclosure = Enclosure([exact(e) for e in expressions], [p.symbol for p in known])
    low, high = enclosure.over(corners[0], corners[1])
    return np.stack([low[0], high[0]], axis=1)


def _cells(
    system: System,
    box: Mapping[str, Range],
    counts: int | Mapping[str, int],
    expressions: Sequence[sp.Expr],
) -> Cells:
    edges, periodic = [], []
    for name in box:
        if name not in system.state_names:
            raise SimulationError(
                f"box names '{name}', which is no state",
                remedy=suggestion(name, system.state_names),
            )
    for q in system.states:
        if q.name not in box:
            raise SimulationError(f"box lacks the state '{q.name}'")
        low, high = box[q.name]
        count = counts if isinstance(counts, int) else counts.get(q.name, 101)
        if not (math.isfinite(low) and math.isfinite(high) and low < high) or count < 1:
            raise SimulationError(f"{q.name}: {count} cells from {low:g} to {high:g}")
        turns = q.unit == "rad" and abs(high - low - TURN) < 1e-9
        turns = turns and all(_comes_back(e, q.symbol) for e in expressions)
        if turns:  # a turn lies between two floats: the axis has the larger
            low, high = -TURN / 2, TURN / 2
        edges.append(np.linspace(low, high, count + 1))
        periodic.append(turns)
    return Cells(tuple(edges), tuple(periodic))


def _comes_back(e: sp.Expr, angle: sp.Symbol) -> bool:
    """Whether an expression has an angle in sums inside sines and cosines alone."""
    if angle not in e.free_symbols:
        return True
    if isinstance(e, sp.sin | sp.cos):
        return e.args[0].diff(angle) in (1, -1)
    return bool(e.args) and all(_comes_back(a, angle) for a in e.args)


def _candidates(
    system: System, counts: int | Mapping[str, int], ranges: Mapping[str, Range]
) -> Floats:
    """Inputs that are tried: within the bounds for every number that is uncertain."""
    if not system.inputs:
        return np.empty((1, 0))
    if system.input_bounds is None:
        raise SimulationError(f"system '{system.name}' has no bounds of its inputs")
    ends = _ends(system, system.input_bounds, ranges)
    axes = []
    for k, q in enumerate(system.inputs):
        low, high = ends[k][0][1], ends[k][1][0]  # for every number that is uncertain
        count = counts if isinstance(counts, int) else counts.get(q.name, INPUTS)
        if count < 2 or not low <= high:
            raise SimulationError(f"{q.name}: {count} values from {low:g} to {high:g}")
        axes.append(np.linspace(low, high, count))
    tried = np.array(list(itertools.product(*axes)))
    inside = np.ones(len(tried), dtype=bool)
    for normal, bound in system.input_bounds.half_spaces():
        *weights, (_, most) = _over_parameters(system, [*normal, -bound], ranges)
        for k, (a, b) in enumerate(weights):
            most = most + np.maximum(a * tried[:, k], b * tried[:, k])
        inside &= most <= ROUNDED
    return tried[inside]
