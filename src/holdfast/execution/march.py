"""A value on a grid marched in time, in parallel, skipping what is settled.

    dW/dtau = H(tau, q, grad W),   limited to one sign where the problem says so,
    and after every stage   lower <= W <= upper,   floor <= W <= ceiling

A stretch of nodes is computed again only if something that it depends on has changed since. Where
nothing has, the same numbers would come out, so the answer is that of the full march. Where the
Hamiltonian or a bound depends on time t, of a clock that runs with tau or against it, all is
computed, with steps that are stable at every stage.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.errors import SimulationError
from holdfast.execution.compile import compile_sweep
from holdfast.execution.fold import Fold
from holdfast.execution.over_grid import padded
from holdfast.execution.sweep import layout, sweep_source
from holdfast.execution.sweep_slopes import SCHEMES
from holdfast.execution.workers import Workers
from holdfast.maths.hamiltonian import Hamiltonian
from holdfast.maths.quantity import TIME, Parameter

Array = npt.NDArray[Any]

KINDS = {"contained": 0, "extrapolated": 0, "periodic": 1, "limited": 2}
"""What is beyond the ends of an axis; the numbers of `differences.py`."""

STAGES = {1: ((1.0, 0.0),), 2: ((1.0, 0.0), (0.5, 1.0)), 3: ((1.0, 0.0), (0.25, 1.0), (2 / 3, 0.5))}
"""(weight, time) of the stages of the total-variation-diminishing Runge-Kutta methods
(C.-W. Shu, S. Osher, J. Comput. Phys. 77, 1988)."""

FEW = 30_000
"""Nodes below which one thread is faster than several."""


@dataclass(frozen=True)
class Method:
    """scheme: of the derivatives ("upwind", "eno2", "eno3", "weno5"); order: of the Runge-Kutta
    method, 1 to 3; dissipation: of the Lax-Friedrichs flux ("global", "local", "local-local");
    cfl: share of the largest stable step; skip: leave out what is settled."""

    scheme: str = "weno5"
    order: int = 3
    dissipation: str = "local-local"
    cfl: float = 0.75
    skip: bool = True


@dataclass
class Done:
    """time [s], steps; moving: nodes that changed faster than asked in the last step; computed:
    stretches of nodes computed, of how many a full march would have; seconds: of wall time."""

    time: float = 0.0
    steps: int = 0
    moving: int = -1
    computed: int = 0
    of: int = 0
    seconds: float = 0.0
    stopped: bool = False


class March:
    """Compiled sweeps of one Hamiltonian over one grid."""

    def __init__(
        self,
        hamiltonian: Hamiltonian,
        parameters: Sequence[Parameter],
        axes: Sequence[Array],
        steps: Sequence[float],
        kinds: Sequence[str],
        *,
        method: Method,
        limit: str,
        clock: tuple[float, float] = (0.0, 1.0),
        reflected: Sequence[npt.NDArray[np.int64]] | None = None,
        precision: str = "float64",
        threads: int = 1,
    ) -> None:
        """clock: the time t at tau = 0, and how fast it runs, 1 or -1. reflected: for every axis,
        at which place of it the node is that always has the same value; half is computed then.
        """
        source = sweep_source(
            hamiltonian,
            parameters,
            scheme=method.scheme,
            dissipation=method.dissipation,
            limit=limit,
            precision=precision,
        )
        self.module = compile_sweep(source, precision)
        self.method = method
        self.shape = np.array([len(a) for a in axes], dtype=np.int64)
        self.axes = padded(axes)
        self.steps = np.array(steps, dtype=np.float64)
        self.kinds = np.array([KINDS[k] for k in kinds], dtype=np.int64)
        self.p = np.array([*(float(q.value) for q in parameters), 0.0])
        self.nodes = math.prod(len(a) for a in axes)
        self.threads = threads if self.nodes > FEW else 1
        cut = layout([len(a) for a in axes])
        self.cut = np.array(cut, dtype=np.int64)
        local = cut[1] * cut[2]
        self.units = math.prod(len(a) for a in axes[:-2]) * local
        self.places = len(axes[0]) if len(axes) > 2 else local  # what threads share
        ghosts = SCHEMES[method.scheme]
        self.fold = Fold(reflected, kinds, cut, ghosts) if reflected is not None else None
        self.clock = clock
        self.varying = any(e.has(TIME) for e in (hamiltonian.value, *hamiltonian.speeds))
        self.speeds = np.zeros(len(axes))  # largest along every axis, for a global dissipation
        self.longest_step = self._longest_step((0.0,))

    def _longest_step(self, at: Sequence[float]) -> float:
        """The largest step [s] that is stable with the speeds at those tau, times the chosen share.

        Infinite where nothing moves.
        """
        limits = np.zeros(len(self.speeds) + 1)
        for tau in at:
            rest = (self.axes, self.shape, self.steps, self.p, limits)
            self.module.fastest(self._time(tau), *rest)
        self.speeds[:] = limits[:-1]
        return self.method.cfl / float(limits[-1]) if limits[-1] > 0 else math.inf

    def _time(self, tau: float) -> float:
        return self.clock[0] + self.clock[1] * tau

    def run(
        self,
        values: Array,
        times: Sequence[float],
        *,
        upper: Array | None = None,
        lower: Array | None = None,
        refresh: Callable[[float], None] | None = None,
        floor: float = -math.inf,
        ceiling: float = math.inf,
        near: float = -math.inf,
        slow: float = 0.0,
        keep: Callable[[float, Array], None] | None = None,
        tell: Callable[[Done, Callable[[], Array]], bool] | None = None,
        done: Done | None = None,
    ) -> Done:
        """March `values` (flat; changed in place) to each of `times`, then `keep(time, values)`.

        refresh: puts into `upper` and `lower`, if they move, what they are at a time t.
        A node counts as moving if it is above `near` and changes faster than `slow` [1/s].
        `tell(done, values)` is called after every step, with a function that gives the values, and
        ends the march where it gives True.
        done: what has been done of the same march, up to `values`; it goes on from there.
        """
        done = done or Done()
        if done.stopped:
            return done
        order = self.method.order
        stages = STAGES[order]
        arrays = [values, *(values.copy() for _ in range(max(order - 1, 1)))]
        flags = np.ones((max(order, 2), self.units), dtype=np.uint8)
        none = np.empty(0, dtype=values.dtype)
        bounds = (none if upper is None else upper, none if lower is None else lower)
        rest = (self.shape, self.cut, self.steps, self.kinds, self.speeds, self.axes, self.p)
        turn = np.zeros(1, dtype=np.int64)
        self.module.sweep(  # compiled, or loaded, before the time is taken
            turn, turn, 0.0, 0.0, 1.0, values, values, arrays[1], values, *bounds, floor, ceiling,
            near, 0.0, flags[0], flags[1], flags[:0], *rest, np.zeros(3, dtype=np.int64),
        )  # fmt: skip
        began, step = time.perf_counter() - done.seconds, math.nan
        with Workers(self.module, self.threads, self.places) as workers:

            def mirror(array: Array, chosen: Array) -> Array:
                """Of the half that is not computed, what lies at those places."""
                if self.fold is not None:
                    half = (
                        array,
                        self.shape,
                        self.fold.places,
                        self.fold.axis,
                        chosen,
                    )
                    workers.run(self.module.mirror, *half)
                return array

            def now() -> Array:
                return arrays[0] if self.fold is None else mirror(arrays[0], self.fold.rest)

            for start, dt, ends in itertools.islice(self._steps(times), done.steps, None):
                if dt != step or not self.method.skip or self.varying or refresh is not None:
                    flags[:] = 1
                    step = dt
                found = np.zeros(3, dtype=np.int64)
                for s, (weight, fraction) in enumerate(stages):
                    last = s == order - 1
                    source = arrays[s]
                    out = arrays[1] if order == 1 else arrays[0 if last else s + 1]
                    here = flags[s] if order > 1 else flags[done.steps % 2]
                    there = flags[(s + 1) % order] if order > 1 else flags[1 - done.steps % 2]
                    if refresh is not None:  # what comes out is for the time of the next stage
                        then = 1.0 if last else stages[s + 1][1]
                        refresh(self._time(start + then * dt))
                    if self.fold is not None:
                        self.fold.narrow(here)
                    found = workers.run(
                        self.module.sweep,
                        self._time(start + fraction * dt), dt, weight, source, arrays[0], out,
                        arrays[0] if order == 1 else out, *bounds, floor, ceiling, near,
                        slow * dt, here, there, flags[1:order] if last else flags[:0],
                        *rest,
                    )  # fmt: skip
                    if self.fold is not None:
                        mirror(out, self.fold.needed)
                    done.computed += int(found[0])
                    if found[1]:
                        raise SimulationError(
                            f"{found[1]} nodes are no finite numbers after {start + dt:g} s",
                            remedy="take a smaller cfl, a lower order or a wider grid",
                        )
                if order == 1:
                    arrays.reverse()
                done.of += self.units * order
                done.steps += 1
                done.time = start + dt if ends is None else ends
                done.moving = int(found[2])
                done.seconds = time.perf_counter() - began
                if keep is not None and ends is not None:
                    keep(ends, now())
                done.stopped = tell is not None and tell(done, now)
                if done.stopped:
                    break
            now()
        if arrays[0] is not values:
            values[:] = arrays[0]
        return done

    def _steps(self, times: Sequence[float]) -> Iterator[tuple[float, float, float | None]]:
        """Start and length of every step [s], and which of `times` it ends at."""
        now = 0.0
        for end in times:
            while now < end:
                count = self._count(now, end)
                dt = (end - now) / count
                several = 1 if self.varying else count
                for k in range(several):
                    yield now + k * dt, dt, end if k == count - 1 else None
                now = end if several == count else now + dt

    def _count(self, now: float, end: float) -> int:
        """How many steps to take; with speeds that vary, so that the first is short enough."""
        count, longest = 1, self._longest_step((now,)) if self.varying else self.longest_step
        while (needed := math.ceil((end - now) / longest - 1e-9)) > count:
            count = needed
            if self.varying:
                dt = (end - now) / count
                longest = self._longest_step((now, now + 0.5 * dt, now + dt))
        return count
