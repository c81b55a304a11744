"""The arrays of a march over one grid, and one step of them: of all units, or of some.

What is in no unit that is computed stays as it is, in every array.
"""

from __future__ import annotations

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import STAGES, March
from holdfast.execution.level_set.sweep_code import address
from holdfast.execution.level_set.sweeping import first_not_finite
from holdfast.execution.level_set.workers import Workers


class Level:
    """The arrays of a march, and one step of it."""

    def __init__(
        self,
        march: March,
        values: Array,
        bounds: tuple[Array | None, Array | None],
        numbers: tuple[float, float, float],
    ) -> None:
        """bounds: upper and lower, at every node. numbers: floor, ceiling, nearest."""
        self.march, self.numbers = march, numbers
        order = march.method.order
        self.arrays = [values, *(np.empty_like(values) for _ in range(max(order - 1, 1)))]
        self.flags = np.ones((max(order, 2), march.units), dtype=np.uint8)
        upper, lower = bounds
        self.plain, self.measured, sizes = march.leaves.found(
            lower=lower is not None, upper=upper is not None
        )
        self.bounds = [0 if a is None else address(a) for a in (upper, lower)]
        self.kept = (upper, lower)
        self.room = march.code.room(march.shape.tolist(), march.cut.tolist(), sizes.tolist())
        self.sizes = sizes

    def start_over(self, units: Array | None = None) -> None:
        """All units, or these, are to be computed in every stage."""
        self.flags[:] = 1 if units is None else units

    def step(
        self, workers: Workers, begin: float, dt: float, *, measure: bool, units: Array | None
    ) -> tuple[int, float]:
        """A step of all units, or of these, that are not settled: how many it computed, and how
        fast the set moved [cells/s]."""
        march, order = self.march, self.march.method.order
        floor, ceiling, nearest = self.numbers
        found, computed = np.zeros(3), 0
        for s, (weight, _) in enumerate(STAGES[order]):
            last = s == order - 1
            own = self.flags[1:order] if last else self.flags[:0]
            source = self.arrays[s]
            out = self.arrays[1] if order == 1 else self.arrays[0 if last else s + 1]
            here, there = self.flags[s], self.flags[(s + 1) % max(order, 2)]
            if units is not None:
                here &= units
            spaces = [*0.5 / march.steps, *march.steps]
            given = np.array([dt, weight, floor, ceiling, nearest, *spaces])
            u = np.concatenate([[march.clock[0] + march.clock[1] * begin], march.p, march.speeds])
            leaves = self.measured if last and measure and nearest > 0 else self.plain
            found = workers.run(march.code.sweep, self.room, [
                *map(address, (u, given, source, self.arrays[0], out)),
                address(self.arrays[0] if order == 1 else out), *self.bounds, len(source),
                *map(address, (here, there, own)), len(own), march.units,
                address(march.shape), len(march.shape), address(march.cut), address(march.kinds),
                address(leaves), address(self.sizes), address(march.axes), march.axes.shape[1],
            ])  # fmt: skip
            computed += int(found[0])
            if found[1]:
                raise march.not_finite(first_not_finite(out), int(found[1]), begin + dt)
        if order == 1:
            self.arrays.reverse()
            self.flags = self.flags[::-1]
        return computed, float(found[2]) / dt
