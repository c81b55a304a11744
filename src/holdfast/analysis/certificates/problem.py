"""What is given of a problem that is certified: ranges, candidates, how it is sampled, a law."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import sympy as sp

from holdfast.analysis.certificates.certificate import Range
from holdfast.errors import SimulationError, check_name, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.maths.definitions.bounds import Bounds
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.sets.ball import Ball
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact

ROUNDED = 1e-12
"""By which an input on a bound may exceed it, as floats do."""

INPUTS = 5
"""Values of each input that are tried, evenly between its bounds."""


def check_among(what: str, names: Iterable[str], among: Sequence[str], kind: str) -> None:
    """Raises `SimulationError` for a name that an argument has and the system has not."""
    for name in names:
        check_name(name, among, SimulationError, f"{what} names '{name}', which is no {kind}")


def errors_of(system: System, errors: Mapping[str, float]) -> tuple[float, ...]:
    check_among("errors", errors, system.state_names, "state")
    for name, value in errors.items():
        if not (math.isfinite(value) and value >= 0):
            raise SimulationError(f"errors: {name} is {value:g}", expected="a number from 0 on")
    return tuple(float(errors.get(q.name, 0.0)) for q in system.states)


def delay_of(delay: float, sample_time: float) -> float:
    if not 0 <= delay < sample_time:
        raise SimulationError(
            f"delay is {delay:g} s", expected=f"from 0 to below the sample time, {sample_time:g} s"
        )
    return delay


def parameters_of(system: System, regions: Sequence[Region]) -> dict[str, Parameter]:
    """Those of all. Raises `SimulationError` where one name has two values."""
    by_name: dict[str, tuple[str, Parameter]] = {}
    named = [(f"region '{r.name}'", r.parameters) for r in regions]
    named.append((f"system '{system.name}'", system.parameters))
    for name, parameters in named:
        for p in parameters:
            where, other = by_name.setdefault(p.name, (name, p))
            if other.value != p.value:
                raise SimulationError(
                    f"'{p.name}' is {p.value:g} in {name} and {other.value:g} in {where}"
                )
    return {name: p for name, (_, p) in by_name.items()}


def ranges_of(
    system: System,
    regions: Sequence[Region],
    uncertain: dict[str, Range],
    constants: dict[str, float],
) -> dict[str, Range]:
    """What each parameter and disturbance may be."""
    every = parameters_of(system, regions).values()
    ranges = {p.name: (float(p.value), float(p.value)) for p in every}
    for name, (low, high) in uncertain.items():
        check_name(
            name, ranges, SimulationError, f"uncertain names '{name}', which is no parameter"
        )
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise SimulationError(f"uncertain: {name} is {low:g} to {high:g}")
        ranges[name] = (float(low), float(high))
    for name in constants:
        if name not in system.disturbance_names:
            raise SimulationError(
                f"disturbance names '{name}', which is none",
                remedy=suggestion(name, system.disturbance_names),
            )
    if set(system.disturbance_names) - set(constants):
        if system.disturbance_bounds is None:
            raise SimulationError(f"system '{system.name}' has no bounds of its disturbances")
        ends = _ends(system, system.disturbance_bounds, ranges)
        for name, (least, most) in zip(system.disturbance_names, ends, strict=True):
            ranges[name] = least[0], most[1]
    return ranges | {name: (float(v), float(v)) for name, v in constants.items()}


def _ends(system: System, bounds: Bounds, ranges: Mapping[str, Range]) -> list[tuple[Range, Range]]:
    """Of each component what its least and its greatest value may be, every rounding counted."""
    ends = [e for pair in bounds.ranges() for e in pair]
    enclosed = _over_parameters(system, ends, ranges)
    if not np.isfinite(enclosed).all():
        raise SimulationError("a bound is not finite", expected="finite bounds of all")
    rows = [(float(a), float(b)) for a, b in enclosed]
    return list(zip(rows[0::2], rows[1::2], strict=True))


def _over_parameters(
    system: System, expressions: Sequence[sp.Expr], ranges: Mapping[str, Range]
) -> Array:
    """Enclosures of expressions of the parameters, a row each."""
    parameters = list(system.parameters)
    corners = np.array([[ranges[p.name][end] for p in parameters] for end in (0, 1)]).reshape(
        2, 1, -1
    )
    enclosure = Enclosure([exact(e) for e in expressions], [p.symbol for p in parameters])
    low, high = enclosure.over(corners[0], corners[1])
    return np.stack([low[0], high[0]], axis=1)


def counts_of(system: System, counts: int | Mapping[str, int]) -> list[int]:
    """How many values of each input are tried, or parts of its range."""
    if isinstance(counts, int):
        return [counts] * len(system.inputs)
    check_among("inputs", counts, system.input_names, "input")
    return [counts.get(q.name, INPUTS) for q in system.inputs]


def parts_of(
    system: System, counts: int | Mapping[str, int], ranges: Mapping[str, Range]
) -> tuple[tuple[float, ...], ...]:
    """The edges of so many parts of the range of each input; none where inputs have no bounds."""
    if system.input_bounds is None:
        return ()
    ends = _ends(system, system.input_bounds, ranges)
    edges = []
    numbers = counts_of(system, counts)
    for q, (least, most), count in zip(system.inputs, ends, numbers, strict=True):
        if count < 1:
            raise SimulationError(f"{q.name}: {count} parts")
        edges.append(tuple(np.linspace(least[0], most[1], count + 1).tolist()))
    return tuple(edges)


def candidates_of(
    system: System, counts: int | Mapping[str, int], ranges: Mapping[str, Range]
) -> Array:
    """Inputs that are tried: within the bounds for every number that is uncertain, shape (tried,
    inputs)."""
    if not system.inputs:
        return np.empty((1, 0))
    if system.input_bounds is None:
        raise SimulationError(f"system '{system.name}' has no bounds of its inputs")
    ends = _ends(system, system.input_bounds, ranges)
    axes = []
    for k, (q, count) in enumerate(zip(system.inputs, counts_of(system, counts), strict=True)):
        low, high = ends[k][0][1], ends[k][1][0]  # for every number that is uncertain
        if count < 2 or not low <= high:
            raise SimulationError(f"{q.name}: {count} values from {low:g} to {high:g}")
        axes.append(np.linspace(low, high, count))
    tried = np.array(list(itertools.product(*axes)))
    if isinstance(system.input_bounds, Ball):
        return _drawn_in(tried)
    inside = np.ones(len(tried), dtype=bool)
    for normal, bound in system.input_bounds.half_spaces():
        *weights, (_, most) = _over_parameters(system, [*normal, -bound], ranges)
        for k, (a, b) in enumerate(weights):
            most = most + np.maximum(a * tried[:, k], b * tried[:, k])
        inside &= most <= ROUNDED
    if not inside.any():
        raise SimulationError(
            f"none of the {len(tried)} inputs that are tried is within the bounds",
            expected="more values of each input",
            remedy="take an odd number, which has the middle",
        )
    return tried[inside]


def _drawn_in(cube: Array) -> Array:
    """The points of a cube around zero drawn in to the ball in it, each along its ray."""
    sizes = np.linalg.norm(cube, axis=1)
    shares = np.abs(cube).max(axis=1) / np.where(sizes > 0, sizes, 1.0)
    return cube * (shares * (1.0 - ROUNDED))[:, None]
