"""A kernel or a capture basin in a page: the law that keeps it, from states of the set.

The value is there for the slices of the set alone: one byte at each node, compressed.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.depth import inside_states
from holdfast.analysis.safety.safety_filter import LAWFUL, decided, safety_law, sampled_margin
from holdfast.errors import ScenarioError, SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.variation import Varied
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.studies.exploration import FAN, MOST_BYTES, Explored

MOST_BYTES_PACKED = 7 * 2**20
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
        if nodes > MOST_NODES or size > MOST_BYTES_PACKED:
            break
        parts.insert(0, part)
    if not parts:
        raise ScenarioError(
            f"the values have {size / 2**20:.0f} MiB, compressed",
            expected=f"at most {MOST_BYTES_PACKED / 2**20:.0f} MiB", remedy="take fewer nodes",
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


SAMPLE_TIME, RECORDED = 0.02, 0.1
"""Of a kernel whose scenario tries no promise [s]."""


def explored_kernel(loaded: KernelScenario, progress: Progress | None = None) -> Explored:
    """The set with its law: the optimal inputs, or the least change of those of its [law].

    A set that no law keeps, and one whose law is too large for a page, has its slices alone. Raises
    `ScenarioError` for a set that is empty, one of a single state, and one that is too large for
    slices too.
    """
    if len(loaded.system.state_names) < 2:
        raise ScenarioError(f"'{loaded.name}' has one state", expected="two states to draw in")
    check_size(loaded.name, math.prod(a.count for a in loaded.grid.axes))
    value = loaded.solve(progress)
    if value.values().max() <= 0:
        raise ScenarioError(f"the set of '{loaded.name}' is empty", remedy="take a smaller bound")
    if loaded.kind not in LAWFUL:
        return _alone(loaded, value, f"no law decides in a {loaded.kind.replace('-', ' ')}")
    try:
        return _with_law(loaded, value)
    except SimulationError as error:
        return _alone(loaded, value, error.cause)


def _with_law(loaded: KernelScenario, value: ValueFunction) -> Explored:
    known = decided(loaded.system, value)
    shown, note = _thinned(value)
    step = float((loaded.promised or {}).get("sample_time", SAMPLE_TIME))
    drawn = loaded.law is None  # the table of the optimal inputs is the set's own
    law = safety_law(loaded.system, shown, loaded.law, sample_time=step, ahead=not drawn)
    loss = sampled_margin(loaded.system, shown, step) if loaded.system.inputs else 0.0
    starts, _ = inside_states(shown, np.random.default_rng(loaded.seed), FAN, None, loss)
    stride = max(round(RECORDED / step), 1)
    records = max(round(loaded.horizon / (stride * step)), 1)
    settings = Settings(
        horizon=records * stride * step, sample_time=step, record_every=stride * step,
        until_goal=loaded.goal is not None,
    )  # fmt: skip
    return _explored(
        loaded, system=known, law=law, alone=loaded.law, settings=settings, starts=starts, note=note
    )


def _alone(loaded: KernelScenario, value: ValueFunction, reason: str) -> Explored:
    """The slices of the set, and the scene in the state that is deepest in it."""
    grid, packed, note = packed_slices(value)
    values = value.values()
    deepest = np.unravel_index(int(values.argmax()), values.shape)
    start = [a.nodes[k] for a, k in zip(value.grid.axes, deepest, strict=True)]
    horizon = max(grid["times"], default=1.0)
    still = Law("still", (), {q.name: 0 * q.symbol for q in loaded.system.inputs})
    return _explored(
        loaded, system=loaded.system, law=still, alone=None,
        settings=Settings(horizon=horizon, sample_time=horizon, record_every=horizon),
        starts=np.array([start]), note=f"The set alone: {reason}; {note}.",
        slices=(grid, packed),
    )  # fmt: skip


def _explored(loaded: KernelScenario, starts: Array, **own: Any) -> Explored:
    names = loaded.system.state_names
    return Explored(
        name=loaded.name, title=loaded.title, source=loaded.source,
        region=loaded.region, goal=loaded.goal, disturbance={}, plant={}, varied=Varied(),
        stepper="rk4", plane=loaded.figures.plane or (names[0], names[1]), starts=starts,
        drawn=np.empty((len(starts), 0)), keys={}, tables=None, **own,
    )  # fmt: skip


def _thinned(value: ValueFunction) -> tuple[ValueFunction, str]:
    """The value at as many times as fit into a page, in single precision; what was left out."""
    data = value.dataset
    times = data["value"].sizes.get("time", 1)
    if data["value"].nbytes <= MOST_BYTES:
        return value, ""
    single = data.assign(value=data["value"].astype(np.float32))
    for step in _divisors(times - 1):
        some = single if step == 1 else single.isel(time=slice(None, None, step))
        if some["value"].nbytes <= MOST_BYTES:
            left = some["value"].sizes.get("time", 1)
            fewer = f", at {left} of its {times} times" if step > 1 else ""
            return ValueFunction(
                some, value.grid
            ), f"The kernel is in single precision here{fewer}."
    raise SimulationError(
        f"its law needs {single['value'].nbytes / times / 2**20:.0f} MiB at one time, "
        f"and a page has at most {MOST_BYTES / 2**20:.0f}"
    )


def _divisors(number: int) -> Iterable[int]:
    return (k for k in range(1, max(number, 1) + 1) if number % k == 0)
