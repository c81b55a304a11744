"""A kernel or a capture basin in a page: the law that keeps it, from states of the set."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

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
from holdfast.studies.packed_slices import check_size, packed_slices

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
