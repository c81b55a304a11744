"""A kernel or a capture basin in a page: the law that keeps it, from states of the set."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.depth import inside_states
from holdfast.analysis.safety.safety_filter import LAWFUL, decided, safety_law, sampled_margin
from holdfast.errors import ScenarioError
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.definitions.variation import Varied
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.studies.exploration import FAN, MOST_BYTES, Explored

SAMPLE_TIME, RECORDED = 0.02, 0.1
"""Of a kernel whose scenario tries no promise [s]."""


def explored_kernel(loaded: KernelScenario, progress: Progress | None = None) -> Explored:
    """The set with its law: the optimal inputs, or the least change of those of its [law].

    Raises `ScenarioError` for a set that no law keeps, one that is empty, one of a single state,
    and one that is too large for a page.
    """
    if loaded.kind not in LAWFUL:
        raise ScenarioError(
            f"'{loaded.name}' is a {loaded.kind}, in which no law decides",
            expected="one of " + ", ".join(LAWFUL),
        )
    names = loaded.system.state_names
    if len(names) < 2:
        raise ScenarioError(f"'{loaded.name}' has one state", expected="two states to draw in")
    size = 8 * int(np.prod([a.count for a in loaded.grid.axes]))
    if size > 2 * MOST_BYTES:
        raise ScenarioError(
            f"the kernel of '{loaded.name}' has {size / 2**20:.0f} MiB at one time",
            expected=f"at most {2 * MOST_BYTES / 2**20:.0f} MiB for a page",
            remedy="take fewer nodes: --set grid.nodes=...",
        )
    value = loaded.solve(progress)
    if value.values().max() <= 0:
        raise ScenarioError(f"the set of '{loaded.name}' is empty", remedy="take a smaller bound")
    shown, note = _thinned(value)
    step = float((loaded.promised or {}).get("sample_time", SAMPLE_TIME))
    law = safety_law(loaded.system, shown, loaded.law, sample_time=step)
    loss = sampled_margin(loaded.system, shown, step) if loaded.system.inputs else 0.0
    starts, _, _ = inside_states(shown, np.random.default_rng(loaded.seed), FAN, None, loss)
    stride = max(round(RECORDED / step), 1)
    records = max(round(loaded.horizon / (stride * step)), 1)
    return Explored(
        name=loaded.name, title=loaded.title, source=loaded.source,
        system=decided(loaded.system, shown), law=law, alone=loaded.law,
        region=loaded.region, goal=loaded.goal,
        disturbance={}, plant={}, varied=Varied(),
        settings=Settings(
            horizon=records * stride * step, sample_time=step, record_every=stride * step,
            until_goal=loaded.goal is not None,
        ),
        stepper="rk4", plane=loaded.figures.plane or (names[0], names[1]), starts=starts,
        drawn=np.empty((len(starts), 0)), keys={}, tables=None, note=note,
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
    raise ScenarioError(
        f"the kernel has {single['value'].nbytes / times / 2**20:.0f} MiB at one time",
        expected=f"at most {MOST_BYTES / 2**20:.0f} MiB in a page", remedy="take fewer nodes",
    )  # fmt: skip


def _divisors(number: int) -> Iterable[int]:
    return (k for k in range(1, max(number, 1) + 1) if number % k == 0)
