"""The value of a set in a page, for its slices alone: one byte at each node, compressed."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import ScenarioError

MOST_BYTES = 7 * 2**20
"""Of the compressed values: a page holds them as text, which is a third longer."""

MOST_NODES = 2**27
"""Nodes at one time; the browser needs a byte for each."""

LEVELS = 127
"""The values go from -LEVELS to LEVELS, and are 0 or less outside the set."""


def check_size(name: str, nodes: int) -> None:
    """Raises `ScenarioError` for a grid that no page can hold, before its march."""
    if nodes > MOST_NODES:
        raise ScenarioError(
            f"the grid of '{name}' has {nodes / 1e6:.0f} million nodes",
            expected=f"at most {MOST_NODES / 1e6:.0f} million for a page",
            remedy="take fewer: --set grid.nodes=...",
        )


def packed_slices(value: ValueFunction) -> tuple[dict[str, Any], list[bytes], str]:
    """The grid of the values, the values at as many times as fit, and what the page says of them.

    A value is rounded to 1/`LEVELS` of the largest beside the set's boundary, and values beyond
    that are cut: a slice needs the sign, and near the boundary the ratio. Nodes keep their side.
    Raises `ScenarioError` for values that are too many even at one time.
    """
    axes, data = value.grid.axes, value.dataset["value"]
    periodic = [a.ends == "periodic" for a in axes]
    times = [float(t) for t in data["time"].values] if "time" in data.dims else []
    parts: list[bytes] = []
    nodes = size = 0
    asked: list[float | None] = [*times] or [None]
    for time in reversed(asked):  # the last one is the answer
        levels = _levels(value.values(time), periodic)
        part = zlib.compress(levels.tobytes(), 9)
        nodes, size = nodes + levels.size, size + len(part)
        if nodes > MOST_NODES or size > MOST_BYTES:
            break
        parts.insert(0, part)
    if not parts:
        raise ScenarioError(
            f"the values have {size / 2**20:.0f} MiB, compressed",
            expected=f"at most {MOST_BYTES / 2**20:.0f} MiB", remedy="take fewer nodes",
        )  # fmt: skip
    grid = {
        "low": [a.low for a in axes], "steps": [a.step for a in axes],
        "shape": [a.count for a in axes], "periodic": periodic, "times": times[-len(parts) :],
    }  # fmt: skip
    fewer = f", at {len(parts)} of their {len(times)} times" if len(parts) < len(times) else ""
    return grid, parts, f"its values have one byte each{fewer}"


def _levels(values: npt.NDArray[Any], periodic: list[bool]) -> npt.NDArray[np.int8]:
    inside = values > 0
    largest = 0.0
    for axis, closed in enumerate(periodic):
        first, second = (np.moveaxis(a, axis, 0) for a in (inside, values))
        ends = [(slice(1, None), slice(None, -1))]
        if closed:
            ends.append((slice(0, 1), slice(-1, None)))
        for one, other in ends:
            crossed = first[one] != first[other]
            for part in (one, other):
                beside = np.abs(second[part][crossed])
                largest = max(largest, float(beside.max(initial=0.0)))
    scaled = values * (LEVELS / (largest or 1.0))
    levels = np.rint(np.clip(scaled, -LEVELS, LEVELS, out=scaled), out=scaled).astype(np.int8)
    np.maximum(levels, 1, out=levels, where=inside)
    np.minimum(levels, 0, out=levels, where=~inside)
    return levels
