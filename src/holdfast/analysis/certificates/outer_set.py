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

import math
from collections.abc import Callable, Mapping
from typing import TypedDict

from holdfast.analysis.certificates.driven_out import kept_outside
from holdfast.analysis.certificates.outer_cells import AHEAD, BACK, KEPT, OuterSet
from holdfast.analysis.certificates.problem import INPUTS
from holdfast.analysis.certificates.reached_cells import reached_within
from holdfast.analysis.reachability.problem import with_disturbance
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import Count, Seconds, checked, renamed
from holdfast.errors import SimulationError
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System


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
    value: ValueFunction,
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
