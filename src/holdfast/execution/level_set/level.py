"""One step of a march over a grid, of all units or of some."""

from __future__ import annotations

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import March
from holdfast.execution.level_set.march_arrays import MarchArrays
from holdfast.execution.level_set.sweeping import first_not_finite
from holdfast.execution.level_set.workers import Workers


class Level(MarchArrays):
    """The arrays of a march, and one step of it."""

    def __init__(
        self,
        march: March,
        values: Array,
        bounds: tuple[Array | None, Array | None],
        numbers: tuple[float, float, float],
    ) -> None:
        """bounds: upper and lower, at every node. numbers: floor, ceiling, nearest."""
        super().__init__(march, values, *bounds, np.empty_like)
        self.numbers = numbers

    def start_over(self, units: Array | None = None) -> None:
        """All units, or these, are to be computed in every stage."""
        self.flags[:] = 1 if units is None else units

    def step(
        self, workers: Workers, begin: float, dt: float, *, measure: bool, units: Array | None
    ) -> tuple[int, float]:
        """A step of all units, or of these, that are not settled: how many it computed, and how
        fast the set moved [cells/s]."""
        march, computed = self.march, 0
        found, u = np.zeros(3), march.u(begin)
        for s, (weight, _) in enumerate(march.method.steps.stages):
            if units is not None:
                here = self.marks(s)[0]
                here &= units
            measures = s == self.stages - 1 and measure and self.numbers[2] > 0
            found = self.swept(workers, s, u, march.numbers(dt, weight, self.numbers), measures)
            computed += int(found[0])
            if found[1]:
                place = first_not_finite(self.out(s))
                raise march.not_finite(place, int(found[1]), begin + dt)
            self.ended(s)
        return computed, float(found[2]) / dt
