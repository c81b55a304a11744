"""The march of a posed problem: over its grid, over a part of it, or over another one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.problem import Posed
from holdfast.execution.device.program import device_named
from holdfast.execution.level_set.layers import Part
from holdfast.execution.level_set.march import March
from holdfast.execution.level_set.units import layout
from holdfast.maths.games.hamiltonian import Hamiltonian


def march_of(
    posed: Posed, h: Hamiltonian, grid: Grid, *, part: Part | None = None, **options: Any
) -> March:
    """The march of a problem over a grid, or a part of it; options: others of `March`."""
    marching = posed.marching
    axes, kinds = [a.nodes for a in grid.axes], [a.ends for a in grid.axes]
    if part is not None and not part.whole:
        axes[0] = axes[0][part.nodes]
        kinds[0] = "extrapolated" if kinds[0] == "periodic" else kinds[0]
        options["cut"] = _cut(grid.shape, len(part.nodes))
    return March(
        h,
        posed.parameters,
        axes,
        [a.step for a in grid.axes],
        kinds,
        method=marching.method,
        limit=posed.limit,
        clock=posed.clock,
        precision=marching.precision,
        device=device_named(marching.device),
        **options,
    )


def _cut(shape: Sequence[int], nodes: int) -> tuple[int, int, int, int]:
    """The units of a part of so many nodes along the first axis: those of the grid."""
    many, groups, stretches, longest = layout(shape)
    if len(shape) == 1:
        return many, groups, -(-nodes // longest), longest
    if len(shape) == 2:
        return many, -(-nodes // many), stretches, longest
    return many, groups, stretches, longest


def reflected(posed: Posed, part: Part) -> list[npt.NDArray[np.int64]] | None:
    """The place of every node's reflection along each axis, where there is a symmetry."""
    signs = posed.marching.symmetry
    if signs is None:
        return None
    found = [
        a.reflected if signs.get(a.name) == -1 else np.arange(a.count, dtype=np.int64)
        for a in posed.grid.axes
    ]
    if not part.whole:
        found[0] = np.arange(len(part.nodes))
    return found
