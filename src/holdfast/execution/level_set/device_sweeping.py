"""The values of a march on a graphics processor, and its stages, carried out there.

The text of the kernels is the same for a GPU and for the C++ compiler of this machine
(`device_text.py`). Their values differ from those of the march on a processor by roundings alone:
the latter lets LLVM choose which product is fused with which sum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.device.program import Device
from holdfast.execution.level_set.device_text import march_text
from holdfast.execution.level_set.mirrored_grid import Fold
from holdfast.execution.level_set.sweeping import first_not_finite, on_one_side
from holdfast.execution.level_set.workers import Counts

if TYPE_CHECKING:
    from holdfast.execution.level_set.march import March


class DeviceSweeping:
    """As `Sweeping`, with arrays of the device. Values come to the host when they are asked for."""

    def __init__(
        self,
        march: March,
        device: Device,
        values: Array,
        upper: Array | None,
        lower: Array | None,
    ) -> None:
        self._device, self._stages = device, march.method.stages
        self._xp: Any = device.arrays
        self._march, self._host = march, values
        stage = march.leaves.stage(lower=lower is not None, upper=upper is not None)
        self._along = stage.rates.along
        text = march_text(stage, march.scheme, march.precision, march.cut[0])
        self._program = device.program(text)
        self._units = march.units
        arrays = 1 + max(self._stages - 1, 1) + sum(b is not None for b in (upper, lower))
        device.check_memory(arrays * values.nbytes, f"{arrays} arrays of {len(values):,} nodes")
        own = self._xp.asarray(values)
        own = own.copy() if own is values else own
        self._arrays = [own, *(own.copy() for _ in range(max(self._stages - 1, 1)))]
        self._flags = self._xp.ones((max(self._stages, 2), self._units), dtype=np.uint8)
        self._bounds_here = upper, lower
        self._bounds: list[Any] = []
        self.bounds_moved()
        self._grid = self._xp.asarray(_grid(march.shape.tolist(), march.cut.tolist(), march.kinds))
        self._axes = self._xp.asarray(march.axes)
        self._pitch = np.int64(march.axes.shape[1])
        self._nodes = int(march.shape[-1])
        self._table = self._xp.zeros(max(self._along, 1) * self._nodes, dtype=values.dtype)
        self._fold = _DeviceFold(march.fold, self._xp) if march.fold is not None else None

    def __enter__(self) -> DeviceSweeping:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        if kind is None:
            self._device.fetched(self._whole(), self._host)

    def all_again(self) -> None:
        """Have all units computed."""
        self._flags[:] = 1

    def bounds_moved(self) -> None:
        """Bring the bounds at nodes to the device; where there are none, something stands there."""
        self._bounds = [
            self._xp.asarray(bound) if bound is not None else self._arrays[0]
            for bound in reversed(self._bounds_here)
        ]

    def stage(self, s: int, u: Array, numbers: Array, measures: bool) -> Counts:
        """Carry out a stage of a step: units computed, nodes not finite, the largest move."""
        xp, stages, arrays, flags = self._xp, self._stages, self._arrays, self._flags
        last = s == stages - 1
        own = flags[1:stages] if last and stages > 1 else flags[:1]
        many = stages - 1 if last else 0
        self._out = arrays[1] if stages == 1 else arrays[0 if last else s + 1]
        here, there = flags[s], flags[(s + 1) % len(flags)]
        if self._fold is not None:
            self._fold.narrow(here)
        before = arrays[0] if stages == 1 else self._out
        u, numbers = xp.asarray(u), xp.asarray(numbers)
        counts = xp.zeros(3, dtype=np.uint64)
        axis = self._axes[-1]
        self._program.run("hf_last_axis", 1, axis, np.int64(self._nodes), u, self._table)
        self._program.run(
            "hf_measured" if measures else "hf_stage",
            min(self._units, self._device.blocks),
            self._grid, np.int64(self._units), self._axes, self._pitch, u, numbers, self._table,
            arrays[s], arrays[0], before, *self._bounds, self._out, here, there, own,
            np.int64(many), counts,
        )  # fmt: skip
        if self._fold is not None:
            self._mirror(self._out, self._fold.needed)
        if stages == 1:
            arrays.reverse()
            self._flags = flags[::-1]
        found = self._device.fetched(counts)
        return np.array([found[0], found[1], found[2:].view(np.float64)[0]], dtype=np.float64)

    def not_finite(self) -> int:
        """The first of the nodes that the last stage has made not finite."""
        return first_not_finite(self._device.fetched(self._out))

    @property
    def fixed(self) -> bool:
        """Whether nothing is left to be computed."""
        return not bool(self._flags[0].any())

    def values(self) -> Array:
        """The values at the nodes, between two steps, on the host."""
        return self._device.fetched(self._whole())

    def largest(self) -> float:
        return float(self._whole().max())

    def on_one_side(self, limit: str) -> bool:
        return on_one_side(self._whole(), limit)

    def _whole(self) -> Any:
        if self._fold is not None:
            self._mirror(self._arrays[0], self._fold.rest)
        return self._arrays[0]

    def _mirror(self, array: Any, chosen: Any) -> None:
        """Of the half that is not computed, what lies at those places."""
        fold = self._fold
        assert fold is not None
        pitch, axis, many = map(np.int64, (fold.places.shape[1], fold.axis, len(chosen)))
        self._program.run(
            "hf_mirror", self._device.blocks, self._grid, np.int64(array.size), fold.places, pitch,
            axis, chosen, many, array,
        )  # fmt: skip


class _DeviceFold(Fold):
    """A fold whose arrays are on the device."""

    def __init__(self, fold: Fold, xp: Any) -> None:
        self.axis = fold.axis
        self.places, self.needed, self.rest, self.computed, self.near = map(
            xp.asarray, (fold.places, fold.needed, fold.rest, fold.computed, fold.near)
        )
        self.images = [xp.asarray(image) for image in fold.images]


def _grid(shape: Sequence[int], cut: Sequence[int], kinds: Array) -> Array:
    """What the kernels have to know of a grid (`device_sweep.h`)."""
    n = len(shape)
    nodes = [math.prod(shape[i + 1 :]) for i in range(n)]
    local = cut[1] * cut[2]
    units = [math.prod(shape[i + 1 : n - 2]) * local for i in range(n)]
    return np.array([*shape, *nodes, *units, *kinds.tolist(), *cut], dtype=np.int64)
