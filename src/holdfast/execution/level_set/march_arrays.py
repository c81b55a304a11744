"""The arrays of a march over one grid, and a stage of a step for some of its units."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.mirrored_grid import Flags
from holdfast.execution.level_set.sweep_code import address
from holdfast.execution.level_set.workers import Counts, Workers

if TYPE_CHECKING:
    from holdfast.execution.level_set.march import March


class MarchArrays:
    """arrays[0] are the values at the beginning of a step and at its end, the others those of its
    stages. flags: of every stage the units that are to be computed.

    What is in no unit that is computed stays as it is, in every array.
    """

    def __init__(
        self,
        march: March,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        another: Callable[[Array], Array],
    ) -> None:
        """upper, lower: bounds at every node. another: gives the arrays for values of stages."""
        stages = march.method.stages
        self.march, self.stages = march, stages
        self.arrays = [values, *(another(values) for _ in range(max(stages - 1, 1)))]
        self.flags = np.ones((max(stages, 2), march.units), dtype=np.uint8)
        plain, measured, self.sizes = march.leaves.found(
            lower=lower is not None, upper=upper is not None
        )
        self._leaves = {False: plain, True: measured}
        self.kept = upper, lower
        self._room = march.code.room(march.shape.tolist(), march.cut.tolist(), self.sizes.tolist())

    def out(self, s: int) -> Array:
        """What comes out of a stage."""
        return self.arrays[(s + 1) % len(self.arrays)]

    def marks(self, s: int) -> tuple[Flags, Flags, Flags]:
        """The units to be computed in a stage, those in the next, and which of the later ones."""
        flags, stages = self.flags, self.stages
        last = s == stages - 1
        return flags[s], flags[(s + 1) % len(flags)], flags[1:stages] if last else flags[:0]

    def swept(self, workers: Workers, s: int, u: Array, numbers: Array, measures: bool) -> Counts:
        """A stage of the units at the places that the workers share."""
        march, arrays, out = self.march, self.arrays, self.out(s)
        here, there, own = self.marks(s)
        before = arrays[0] if self.stages == 1 else out
        return workers.run(march.code.sweep, self._room, [
            *map(address, (u, numbers, arrays[s], arrays[0], out, before)),
            *(0 if bound is None else address(bound) for bound in self.kept), len(out),
            *map(address, (here, there, own)), len(own), march.units,
            address(march.shape), len(march.shape), address(march.cut), address(march.kinds),
            address(self._leaves[measures]), address(self.sizes),
            address(march.axes), march.axes.shape[1],
        ])  # fmt: skip

    def ended(self, s: int) -> None:
        """After a stage: of a method with a single one the arrays change places."""
        if self.stages == 1:
            self.arrays.reverse()
            self.flags = self.flags[::-1]
