"""Cells that an exact set may touch, and the flow of a system with all its players free."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from holdfast.analysis.certificates.candidate_cells import SetOnGrid
from holdfast.analysis.certificates.cells import Cells, Floats, Truths, Wholes
from holdfast.analysis.certificates.certificate import Certificate, check_functions
from holdfast.analysis.certificates.problem import parameters_of, ranges_of
from holdfast.analysis.simulation.files import write_netcdf
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.maths.definitions.bounds import Bounds
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.sets.product import Product
from holdfast.maths.definitions.system import System
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
) -> tuple[HeldFlow, Callable[[Floats, Floats], tuple[Floats, Floats]]]:
    """Enclosures of the flow with everything free, and of its rates over boxes of states."""
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

    def over(low: Floats, high: Floats) -> tuple[Floats, Floats]:
        ends = [np.tile([e[k] for e in intervals.values()], (len(low), 1)) for k in (0, 1)]
        return enclosure.over(np.hstack([low, ends[0]]), np.hstack([high, ends[1]]))

    return flow, over
