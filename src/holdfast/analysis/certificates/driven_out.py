"""Outer sets of kernels: cells from which a system is driven out of its region are left out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import reduce

import numpy as np
import sympy as sp

from holdfast.analysis.certificates.candidate_cells import SetOnGrid
from holdfast.analysis.certificates.cells import Halvings
from holdfast.analysis.certificates.certificate import Certificate, Range
from holdfast.analysis.certificates.certify import certify
from holdfast.analysis.certificates.images import sure_of
from holdfast.analysis.certificates.outer_cells import (
    OuterSet,
    both_bounds,
    even_cells,
    free_flow,
    states_of,
)
from holdfast.errors import SimulationError
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import least

BEYOND = sp.Rational(1, 10**64)
"""Of a constraint, so that "not above 0" is not taken for "above 0"."""

FAR = 1000.0
"""Widths of the grid by which the outermost cells of a kernel go beyond it."""

CROSSINGS = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Times that are tried, in those in which a cell is crossed."""


def kept_outside(
    value: SetOnGrid,
    system: System,
    region: Region,
    counts: Mapping[str, int],
    sample_time: float | None,
    inputs: int,
    halvings: int,
    progress: Callable[[str, float], None] | None,
) -> OuterSet:
    """The cells that are not certified to be driven out of the region."""
    against = _exchanged(system, every=value.report.kind == "invariance-kernel")
    out = reduce(least, [BEYOND - c.expression for c in region.inequalities])
    away = Region(
        "outside", region.reads, (Inequality("out", out, region.margin_unit),), region.parameters
    )
    anywhere = Region("anywhere", system.states[:1], (Inequality("always", sp.Integer(-1)),))
    box: dict[str, Range] = {}
    edges: dict[str, int | list[float]] = {}
    for a in value.grid.axes:
        box[a.name], edges[a.name] = (a.low, a.high), counts[a.name]
        if a.ends != "periodic":
            wide = FAR * (a.high - a.low)
            even = np.linspace(a.low, a.high, counts[a.name] + 1).tolist()
            box[a.name] = (a.low - wide, a.high + wide)
            edges[a.name] = [a.low - wide, *even, a.high + wide]
    lasts = value.report.converged or value.report.empty
    seconds = None if lasts else value.report.reached_s
    best: OuterSet | None = None
    for hold in _holds(value, against, counts, sample_time):
        horizon = None if seconds is None else math.floor(seconds / hold + 1e-9) * hold
        if horizon is not None and horizon < hold / 2:
            continue
        certificate = certify(
            against, anywhere, target=away, box=box, cells=edges, sample_time=hold,
            horizon=horizon, inputs=inputs, halvings=halvings, progress=progress,
        )  # fmt: skip
        outer = _less_the_lost(value, certificate)
        if best is None or outer.volume < best.volume:
            best = outer
    if best is None:
        raise SimulationError(
            f"the horizon of {seconds:g} s is shorter than the sample time",
            remedy="take a shorter sample_time",
        )
    return best


def _exchanged(system: System, *, every: bool) -> System:
    """The system of whoever works against a set: what it has no hold of is a disturbance.

    every: inputs work against it as well.
    """
    if every:
        return replace(
            system,
            inputs=(*system.inputs, *system.disturbances),
            disturbances=(),
            input_bounds=both_bounds(system),
            disturbance_bounds=None,
            measurements=(),
            flat_output=None,
        )
    return replace(
        system,
        inputs=system.disturbances,
        disturbances=system.inputs,
        input_bounds=system.disturbance_bounds,
        disturbance_bounds=system.input_bounds,
        measurements=(),
        flat_output=None,
    )


def _less_the_lost(value: SetOnGrid, certificate: Certificate) -> OuterSet:
    """All cells of the grid but those outside of the region, or certified to lead there."""
    from holdfast.analysis.certificates.arrival import flow_of

    halvings = Halvings(certificate.cells, certificate.kept.depth)
    left = np.ones(certificate.cells.total, dtype=bool)
    left[certificate.kept.members] = False
    left[sure_of(flow_of(certificate).arrived, halvings)] = False
    return OuterSet(
        kind=value.report.kind,
        states=states_of(value),
        cells=certificate.cells,
        members=np.flatnonzero(left),
        hold=certificate.hold,
        lost=certificate if len(certificate.kept.members) else None,
    )


def _holds(
    value: SetOnGrid, system: System, counts: Mapping[str, int], sample_time: float | None
) -> Iterator[float]:
    """The times that are tried: the given one, or several of those in which a cell is crossed."""
    if sample_time is not None:
        yield float(sample_time)
        return
    cells = even_cells(value, counts)
    rates = free_flow(system, (), 1.0)[1]
    some = np.arange(0, cells.total, max(1, cells.total // 4096))
    low, high = cells.corners(some)
    least_rate, most_rate = rates(low, high)
    speeds = np.maximum(np.abs(least_rate), np.abs(most_rate))
    usual = np.nanmedian(np.where(np.isfinite(speeds), speeds, np.nan), axis=0)
    widths = np.array([np.diff(e).min() for e in cells.edges])
    crossed = float(
        np.min(widths / np.where(usual > 0, usual, np.inf), initial=math.inf, where=usual > 0)
    )
    if not math.isfinite(crossed):
        raise SimulationError("nothing moves, or no rate is known", remedy="give a sample_time")
    for times in CROSSINGS:
        yield times * crossed
