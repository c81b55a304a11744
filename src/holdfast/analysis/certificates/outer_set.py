"""Outer sets: outside them a state is lost, or not reached, for sure.

A state is lost to a kernel where whoever works against it can drive the system out of the region:
the disturbance, against any input. That is a proof of arrival with the players exchanged, and a
certificate of its own:

    held d,  any u(t) in U:    the state comes to max_j c_j(q) > 0

What can be reached is bounded by the images of cells: with R the cells that the start may touch,
all cells that the way from a cell of R may touch are of R, for any u(t) in U and d(t) in D.

Both hold for every measurable input, since an enclosure for a set of values is one for every signal
in it. Input sets count as the boxes around them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt
import sympy as sp
import xarray as xr

from holdfast.analysis.certificates.cells import Cells, Halvings
from holdfast.analysis.certificates.certificate import Certificate, Range, check_functions
from holdfast.analysis.certificates.certify import SetOnGrid, certify, comes_back
from holdfast.analysis.certificates.images import sure_of, where
from holdfast.analysis.certificates.problem import INPUTS, parameters_of, ranges_of
from holdfast.analysis.reachability.problem import with_disturbance
from holdfast.analysis.simulation.files import write_netcdf
from holdfast.arguments import Count, Seconds, checked, renamed
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array, Truths, Wholes
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.maths.definitions.bounds import Bounds
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.sets.product import Product
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import least
from holdfast.maths.expressions.traversal import exact

KEPT = ("viability-kernel", "discriminating-kernel", "invariance-kernel")
AHEAD, BACK = (
    ("forward-reachable-set",),
    ("backward-reachable-tube", "backward-reachable-at", "capture-basin"),
)


@dataclass(frozen=True)
class OuterSet:
    """Cells outside which no state is of the exact set: lost, or not reached, for sure.

    states: their names and units. members: the numbers of the cells that the set may touch. hold
    [s]: of the enclosures. lost: of a kernel the certificate of the others, which `holdfast-check`
    checks: of a system whose inputs are the disturbances and whose disturbances are the inputs, and
    whose target is outside of the region. None for what can be reached, and where nothing is lost.
    """

    kind: str
    states: tuple[tuple[str, str], ...]
    cells: Cells
    members: Wholes
    hold: float
    lost: Certificate | None = None

    @checked
    def contains(self, states: npt.ArrayLike) -> Truths:
        """Whether states, shape (count, states), may be of the exact set.

        A state on the edge of cells may be where one of them does. Beyond the cells none is
        reached; of a kernel nothing is known there, a thousand widths of the grid away.
        """
        points = np.atleast_2d(np.asarray(states, dtype=np.float64))
        noted = self._noted()
        first, last, inside = self.cells.touched(points, points)
        possible = ~inside & (self.kind in KEPT)
        for row in np.flatnonzero(inside):
            block = [
                np.arange(a, b + 1) % n
                for a, b, n in zip(first[row], last[row], self.cells.counts, strict=True)
            ]
            possible[row] = noted[np.ix_(*block)].any()
        return possible

    @property
    def names(self) -> tuple[str, ...]:
        """Of the states."""
        return tuple(n for n, _ in self.states)

    @property
    def volume(self) -> float:
        """In the product of the units of the states."""
        low, high = self.cells.corners(self.members)
        return float((high - low).prod(axis=1).sum())

    def extent(self) -> dict[str, tuple[float, float]]:
        """State -> the least and the largest value; NaN where nothing is left."""
        if not len(self.members):
            return dict.fromkeys(self.names, (math.nan, math.nan))
        low, high = self.cells.corners(self.members)
        ends = zip(low.min(axis=0).tolist(), high.max(axis=0).tolist(), strict=True)
        return dict(zip(self.names, ends, strict=True))

    def summary(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "kind": self.kind,
            "approximation": "outer approximation",
            "cells": list(self.cells.counts),
            "members": len(self.members),
            "volume": self.volume,
            "extent": {n: list(e) for n, e in self.extent().items()},
            "hold": self.hold,
            "certificate": None if self.lost is None else self.lost.summary(),
        }

    def dataset(self) -> xr.Dataset:
        """1 at the middles of cells that the set may touch, and 0 at those of the others."""
        middles = {
            n: (n, 0.5 * (e[:-1] + e[1:]), {"units": unit})
            for (n, unit), e in zip(self.states, self.cells.edges, strict=True)
        }
        says = "1 where the cell may have a state of the set, 0 where it has none for sure"
        members = self._noted().astype(np.int8), {"units": "1", "long_name": says}
        attributes = {"kind": self.kind, "approximation": "outer approximation"}
        return xr.Dataset({"member": (self.names, *members)}, middles, attributes)

    def save(self, path: str | Path) -> Path:
        """Write `dataset` as NetCDF-4, whole or not at all."""
        return write_netcdf(self.dataset(), path)

    def _noted(self) -> Truths:
        noted = np.zeros(self.cells.total, dtype=bool)
        noted[self.members] = True
        return noted.reshape(self.cells.counts)


def states_of(value: SetOnGrid) -> tuple[tuple[str, str], ...]:
    """The names and units of the states of a value function."""
    return tuple((a.name, a.state.unit) for a in value.grid.axes)


def both_bounds(system: System) -> Bounds | None:
    """The bounds of inputs and disturbances together; refused where one lacks them."""
    parts = []
    for what, some, bounds in (
        ("inputs", system.inputs, system.input_bounds),
        ("disturbances", system.disturbances, system.disturbance_bounds),
    ):
        if some and bounds is None:
            raise SimulationError(f"system '{system.name}' has no bounds of its {what}")
        if some and bounds is not None:
            parts.append(bounds)
    return Product(tuple(parts)) if len(parts) > 1 else parts[0] if parts else None


def even_cells(value: SetOnGrid, counts: Mapping[str, int]) -> Cells:
    axes = value.grid.axes
    return Cells.even(
        tuple((a.low, a.high) for a in axes),
        tuple(counts[a.name] for a in axes),
        tuple(a.ends == "periodic" for a in axes),
    )


def free_flow(
    system: System, regions: tuple[Region, ...], hold: float, *, back: bool = False
) -> tuple[HeldFlow, Callable[[Array, Array], tuple[Array, Array]]]:
    """Enclosures of the flow with everything free, and of its rates over boxes of states. Boxes are
    their lower and upper corners, shape (boxes, states), as those of the rates."""
    players = (*system.inputs, *system.disturbances)
    free_system = replace(
        system, inputs=(), input_bounds=None, disturbances=players,
        disturbance_bounds=both_bounds(system), measurements=(), flat_output=None,
    )  # fmt: skip
    ranges = ranges_of(free_system, regions, {}, {})
    rates = [(-1 if back else 1) * exact(system.rates[q.name]) for q in system.states]
    check_functions([*rates, *(c.expression for r in regions for c in r.inequalities)])
    states = [q.symbol for q in system.states]
    free = {q.symbol: ranges[q.name] for q in players}
    fixed = {p.symbol: ranges[p.name] for p in parameters_of(system, regions).values()}
    flow = HeldFlow(rates, [], states, [], free, fixed, hold)
    intervals = {**free, **fixed}
    enclosure = Enclosure(rates, [*states, *intervals])

    def over(low: Array, high: Array) -> tuple[Array, Array]:
        ends = [np.tile([e[k] for e in intervals.values()], (len(low), 1)) for k in (0, 1)]
        return enclosure.over(np.hstack([low, ends[0]]), np.hstack([high, ends[1]]))

    return flow, over


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
    from holdfast.analysis.certificates.certificate import flow_of

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


LEGS = (1, 2, 4, 8, 16)
"""Numbers of legs into which a horizon is divided, of which all are tried."""

STEPS = (1, 4, 16, 64)
"""Numbers of steps of a leg: more of them as long as that makes the set smaller."""


def _possible(system: System, region: Region) -> Callable[[Array, Array], Truths]:
    """Whether a box may have a state of the region: no constraint is violated all over it."""
    parameters = list(parameters_of(system, (region,)).values())
    names = [*(q.symbol for q in system.states), *(p.symbol for p in parameters)]
    enclosure = Enclosure([exact(c.expression) for c in region.inequalities], names)
    numbers = [float(p.value) for p in parameters]

    def possible(low: Array, high: Array) -> Truths:
        fixed = np.tile(numbers, (len(low), 1)).reshape(len(low), len(numbers))
        smallest, _ = enclosure.over(np.hstack([low, fixed]), np.hstack([high, fixed]))
        allowed: Truths = np.logical_not((smallest > 0).any(axis=1))
        return allowed

    return possible


def reached_within(
    value: SetOnGrid,
    system: System,
    start: Region,
    within: Region | None,
    counts: Mapping[str, int],
    sample_time: float | None,
) -> OuterSet:
    """The cells that ways from the start may touch; the smallest set of several times."""
    seconds = math.inf if value.report.converged else value.report.horizon_s
    tries = [float(sample_time)] if sample_time is not None else [
        value.report.horizon_s / k for k in LEGS
    ]  # fmt: skip
    cells = even_cells(value, counts)
    regions = (start,) if within is None else (start, within)
    _check_within(system, regions, cells)
    begun = where(_possible(system, start), cells)
    room = np.ones(cells.total, dtype=bool)
    if within is not None:
        room[:] = False
        room[where(_possible(system, within), cells)] = True
    best: OuterSet | None = None
    trouble = ""
    for hold in tries:
        legs = math.inf if math.isinf(seconds) else math.ceil(seconds / hold - 1e-9)
        last = math.inf
        for steps in STEPS:
            flow, _ = free_flow(system, regions, hold / steps, back=value.report.kind in BACK)
            members, why = _spread(flow, steps, cells, begun, room, legs)
            trouble = why or trouble
            if members is None:
                continue
            outer = OuterSet(value.report.kind, states_of(value), cells, members, hold)
            if best is None or outer.volume < best.volume:
                best = outer
            if outer.volume >= last:
                break
            last = outer.volume
    if best is None:
        raise SimulationError(
            f"no outer set is found: {trouble}",
            remedy="take a wider grid, smaller cells, or another sample_time",
        )
    return best


def _check_within(system: System, regions: tuple[Region, ...], cells: Cells) -> None:
    """Refuse where ways may begin beyond the grid, and angles that do not come back."""
    possible = [_possible(system, r) for r in regions]
    expressions = [*system.rates.values(), *(c.expression for r in regions for c in r.inequalities)]
    for k, (q, periodic) in enumerate(zip(system.states, cells.periodic, strict=True)):
        if periodic and not all(comes_back(e, q.symbol) for e in expressions):
            raise SimulationError(
                f"'{q.name}' is periodic, and does not stand in sines and cosines alone",
                remedy="take other ends",
            )
        for end in (0, -1) if not periodic else ():
            low, high = (np.full((1, len(cells.edges)), s * math.inf) for s in (-1, 1))
            for i, turns in enumerate(cells.periodic):
                if turns:
                    low[0, i], high[0, i] = cells.edges[i][0], cells.edges[i][-1]
            (high if end == 0 else low)[0, k] = cells.edges[k][end]
            if all(there(low, high)[0] for there in possible):
                raise SimulationError(
                    f"'{regions[0].name}' may reach beyond the grid at {q.name} = "
                    f"{cells.edges[k][end]:g}",
                    remedy="bound it by a constraint, or take a wider grid",
                )


def _spread(
    flow: HeldFlow, steps: int, cells: Cells, begun: Wholes, room: Truths, legs: float
) -> tuple[Wholes | None, str]:
    """All cells that ways of so many legs from these may touch, in turn; or what is not known.

    A leg is so many steps of the flow from each cell; only then is what it leads to cells again.
    """
    touched = np.zeros(cells.total, dtype=bool)
    started = np.zeros(cells.total, dtype=bool)
    fresh = begun[room[begun]]
    touched[fresh] = started[fresh] = True
    open_sides = _open_sides(cells, room)
    leg = 0
    while len(fresh) and leg < legs:
        low, high = cells.corners(fresh)
        for _ in range(steps):
            held = flow.held(low, high, np.empty((len(low), 0)))
            if not held.kept.all():
                return None, f"no enclosure of the way for {flow.sampling.hold:g} s"
            way = _clipped(cells, held.way_low, held.way_high, open_sides)
            end = _clipped(cells, held.low, held.high, open_sides)
            if left := way[2]:
                return None, f"a way leaves the grid at '{flow.states[left - 1]}'"
            _note(touched, cells, way[0], way[1])
            low, high = end[0], end[1]
        before = started.copy()
        _note(started, cells, low, high)
        started &= room
        fresh = np.flatnonzero(started & ~before)
        leg += 1
    return np.flatnonzero((touched | started) & room), ""


def _open_sides(cells: Cells, room: Truths) -> list[tuple[bool, bool]]:
    """At which ends of each axis a way may leave the grid: where a cell there is possible."""
    grid = room.reshape(cells.counts)
    sides = []
    for axis, periodic in enumerate(cells.periodic):
        ends = tuple(bool(np.take(grid, k, axis=axis).any()) and not periodic for k in (0, -1))
        sides.append((ends[0], ends[1]))
    return sides


def _clipped(
    cells: Cells, low: Array, high: Array, open_sides: list[tuple[bool, bool]]
) -> tuple[Array, Array, int]:
    """Boxes within the grid, and one more than the axis at which a way may leave it, or 0.

    A way in the region never passes the impossible cells at a closed end.
    """
    low, high = low.copy(), high.copy()
    for k, ((at_low, at_high), periodic) in enumerate(zip(open_sides, cells.periodic, strict=True)):
        if periodic:
            turn = cells.edges[k][-1] - cells.edges[k][0]
            whole = ~(high[:, k] - low[:, k] < 0.99 * turn)
            low[whole, k] = 0.5 * (cells.edges[k][0] + cells.edges[k][1])
            high[whole, k] = 0.5 * (cells.edges[k][-2] + cells.edges[k][-1])
            continue
        first, last = cells.edges[k][0], cells.edges[k][-1]
        if (at_low and (low[:, k] < first).any()) or (at_high and (high[:, k] > last).any()):
            return low, high, k + 1
        low[:, k], high[:, k] = np.clip(low[:, k], first, last), np.clip(high[:, k], first, last)
    return low, high, 0


def _note(noted: Truths, cells: Cells, low: Array, high: Array) -> None:
    """Note all cells that boxes within the grid touch: sums of one at each corner of the blocks."""
    first, last, inside = cells.touched(low, high)
    assert inside.all()
    shape = [n * (1 + p) for n, p in zip(cells.counts, cells.periodic, strict=True)]
    sums = np.zeros([n + 1 for n in shape], dtype=np.int32)
    for corner in itertools.product((0, 1), repeat=len(shape)):
        ends = [last[:, k] + 1 if c else first[:, k] for k, c in enumerate(corner)]
        np.add.at(sums, tuple(ends), (-1) ** sum(corner))
    for axis, (count, periodic) in enumerate(zip(cells.counts, cells.periodic, strict=True)):
        sums = np.cumsum(sums, axis=axis)
        covered = np.moveaxis(sums, axis, 0)[:-1]
        if periodic:  # blocks may go on beyond the last cell
            covered = covered[:count] + covered[count:]
        sums = np.moveaxis(covered, 0, axis)
    noted |= (sums > 0).reshape(-1)


class OuterOptions(TypedDict, total=False):
    """Those of `outer_set`."""

    target: Region | None
    cells: int | Mapping[str, int] | None
    sample_time: Seconds | None
    inputs: int
    halvings: Count
    progress: Callable[[str, float], None] | None


@renamed(refine="halvings")
@checked
def outer_set(
    value: SetOnGrid,
    system: System,
    region: Region | None,
    *,
    target: Region | None = None,
    cells: int | Mapping[str, int] | None = None,
    sample_time: Seconds | None = None,
    inputs: int = INPUTS,
    halvings: Count = 0,
    progress: Callable[[str, float], None] | None = None,
) -> OuterSet:
    """Cells outside which no state is of the set that `value` approximates, every rounding counted.

    region: what a kernel or a capture basin keeps; of a tube or a forward set where it begins or
    ends. target: the goal of a capture basin. cells: along each state, by default as many as the
    grid has. sample_time [s]: for which enclosures go, and the disturbance of a kernel is held; by
    default several are tried, and the smallest set is taken. inputs: values of each disturbance
    that are tried; halvings: how often cells of a kernel are halved that are left near lost ones.

    A set for a horizon is bounded for that horizon; one at exactly a horizon by the tube to it. A
    disturbance that works against reaching is counted as one that helps, which is outside too.

    Raises `SimulationError` for a problem that depends on time, another system, a grid with
    "limited" ends, and for what can be reached where a way leaves the grid or no enclosure of it is
    found; `DefinitionError` for functions without a proved enclosure.

    >>> outer = hf.outer_set(kernel, cart, track, cells=9, sample_time=0.2, inputs=3)
    >>> outer.contains([[0.0, 0.0], [5000.0, 0.0]])
    array([ True,  True])
    """
    report = value.report
    if value.names != system.state_names or report.system != system.name:
        raise SimulationError(
            f"the set belongs to system '{report.system}' with the states "
            + ", ".join(value.names),
            expected=f"system '{system.name}' with " + ", ".join(system.state_names),
        )
    if report.kind not in (*KEPT, *AHEAD, *BACK):
        raise SimulationError(
            f"an outer set of a '{report.kind}'",
            expected="one of " + ", ".join((*KEPT, *AHEAD, *BACK)),
        )
    if report.depends_on_time:
        raise SimulationError("an outer set of a problem that depends on time")
    limited = [a.name for a in value.grid.axes if a.ends == "limited"]
    if limited:
        raise SimulationError(
            f"an outer set over a grid whose '{limited[0]}' is limited: its rates lead beyond it",
            remedy='take other ends, such as "contained"',
        )
    if sample_time is not None and not (math.isfinite(sample_time) and sample_time > 0):
        raise SimulationError(f"sample_time is {sample_time:g}", expected="seconds, above 0")
    model = with_disturbance(system, report.disturbance)
    counts = {
        a.name: cells if isinstance(cells, int) else (cells or {}).get(
            a.name, a.count - (a.ends != "periodic")
        )
        for a in value.grid.axes
    }  # fmt: skip
    if report.kind in KEPT:
        if region is None:
            raise SimulationError("an outer set of a kernel without its region")
        outer = kept_outside(value, model, region, counts, sample_time, inputs, halvings, progress)
    else:
        start = target if report.kind == "capture-basin" else region
        within = region if report.kind == "capture-basin" else None
        if start is None:
            raise SimulationError(
                f"an outer set of a '{report.kind}' without where it ends",
                remedy="give the target of a capture basin, the region of another",
            )
        outer = reached_within(value, model, start, within, counts, sample_time)
    return outer
