"""The values of a march on a graphics processor, its stages there, and their text.

The text is that of the leaves of the march on a processor (`stage_leaf.py`, the schemes), printed
as C++ for a node, not as LLVM for a run of nodes, and of the sweep that calls them
(`device_sweep.py`). It is the same for a GPU and for the C++ compiler of this machine. The values
differ from those of the march on a processor by roundings alone: the latter lets LLVM choose which
product is fused with which sum.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from importlib import resources
from types import TracebackType
from typing import Any

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.codegen.c_printer import ATOM, Body, c_functions, heading_c, scalars_c
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import FUNCTIONS
from holdfast.execution.codegen.scalar_reader import Scalars, read
from holdfast.execution.device.program import Device
from holdfast.execution.level_set.fold import Fold
from holdfast.execution.level_set.schemes import Scheme
from holdfast.execution.level_set.stage_leaf import Stage, names_of_numbers
from holdfast.execution.level_set.sweeping import (
    Bounds,
    Counts,
    Marched,
    StageOrder,
    StagesHere,
    first_not_finite,
    layout,
    on_one_side,
)

MOST_NODES = 256
"""Nodes of a unit, at most."""

SHARED = 1 << 15
"""Bytes that a block of threads shares, at most."""


def device_layout(shape: Sequence[int], of_row: int) -> tuple[int, int, int, int]:
    """As `layout`: what depends on the rows of a unit is shared by a block of threads."""
    rows = max(1, SHARED // (8 * (of_row + 1)))
    return layout(shape, min(MOST_NODES, rows * shape[-1]), MOST_NODES)


def march_text(stage: Stage, scheme: Scheme, precision: str, rows: int) -> str:
    """The kernels of `device_sweep.py`, from `last_axis` on, and what belongs to one program.

    rows: of the last axis in a unit.
    """
    real = "float" if precision == "float32" else "double"
    rates = stage.rates
    named = {
        "AXES": stage.axes, "ACROSS": max(stage.axes - 2, 0), "GHOSTS": scheme.ghosts,
        "FALLS": names_of_numbers(stage.axes).index("low0"),
        "NUMBERS_OF_ROW": rates.of_row + rates.outer, "MOST_ROWS": int(rows),
    }  # fmt: skip
    folder = resources.files(__package__)
    files = ((folder / f"{name}.py").read_text("utf-8") for name in ("stencils", "device_sweep"))
    numbers = "\n".join(f"{name} = {value}" for name, value in named.items())
    parsed = read("\n".join((next(files), numbers, next(files))))
    kernels = ["last_axis", "stage", "measured", "reflect"]
    sweep = scalars_c(parsed, kernels, scope="HF_FUNCTION", kernels=kernels, fused=True)
    leaves = [
        _leaf(parsed, "along_last_axis", rates.leaves["along"], "table[{} * pitch]", real),
        _leaf(parsed, "of_a_row", rates.leaves["rows"], f"row[{{}} * {rows}]"),
        *_scheme(parsed, scheme, precision, real),
        _node(parsed, stage, real, int(rows)),
    ]
    text = "\n\n".join(leaves)
    functions = c_functions(text, FUNCTIONS).replace("static inline", "HF_FUNCTION")
    return "\n\n".join([f"typedef {real} hf_real;", functions + text, sweep])


def _function(parsed: Scalars, name: str, body: Body | None, ends: Iterable[str]) -> str:
    """One of the functions that the sweep has without a body."""
    lines = body.lines if body else ()
    return "\n".join([f"{heading_c(parsed, name, 'HF_FUNCTION')} {{", *lines, *ends, "}"])


def _leaf(parsed: Scalars, name: str, leaf: Leaf, place: str, real: str = "double") -> str:
    """A leaf of nodes or rows: w its states, u what is the same everywhere."""
    inputs = {n: f"{a}[{k}]" for a in ("w", "u") for k, n in enumerate(leaf.arguments[a])}
    body = Body(leaf.steps, leaf.results, "    ", inputs=inputs)
    texts = (body.text(v.number, ATOM) for v in leaf.results)
    ends = (f"    {place.format(i)} = ({real}){text};" for i, text in enumerate(texts))
    return _function(parsed, name, body, ends)


def _scheme(parsed: Scalars, scheme: Scheme, precision: str, real: str) -> Iterator[str]:
    """The slope at the upper and at the lower end of an interval, from the nodes n[0], n[1], ...

    The plain difference, which its leaf may have too, is a subtraction in `device_sweep.py`.
    """
    names = ("upper_slope", "lower_slope")
    if scheme.one_slope:
        for k, name in enumerate(names):
            yield _function(parsed, name, None, [f"    return n[{k}];"])
        return
    leaf = scheme.leaf(precision, plain=False)
    inputs = {f"n{k}": f"n[{k}]" for k in range(2 * scheme.ghosts)}
    for name, result in zip(names, leaf.results, strict=True):
        body = Body(leaf.steps, [result], "    ", of_fused=real, inputs=inputs)
        yield _function(parsed, name, body, [f"    return {body.text(result.number)};"])


def _node(parsed: Scalars, stage: Stage, real: str, rows: int) -> str:
    """From the slopes in cells on both sides of a node, and its plain differences, to its value."""
    rates, results = stage.rates, stage.results()
    of_rate = real if rates.rate.algebraic else "double"
    inputs = {x: f"({real})numbers[{k}]" for k, x in enumerate(names_of_numbers(stage.axes))}
    for kind, i in itertools.product(("below", "above"), range(stage.axes)):
        inputs |= {f"{x}{kind}{i}": f"{x}{kind}[{i}]" for x in ("", "plain_")}
    for k, x in enumerate(rates.rate.arguments["w"][: rates.along + rates.of_row]):
        of_row = f"({real})of_row[{(rates.outer + k - rates.along) * rows}]"
        inputs[x] = f"({of_rate})" + (f"along[{k} * pitch]" if k < rates.along else of_row)
    for k, x in enumerate(rates.rate.arguments["u"]):
        inputs[x] = f"({of_rate})of_row[{k * rows}]"
    body = Body(results[0].steps, results, "    ", of_rate, real, inputs=inputs)
    names = ("answer[0]", "verdicts[0]", "verdicts[1]", "answer[1]")
    ends = (f"    {x} = {body.text(v.number)};" for x, v in zip(names, results, strict=True))
    return _function(parsed, "node", body, ends)


class DeviceSweeping(StagesHere):
    """As `Sweeping`, with arrays of the device. Values come to the host when they are asked for.

    values, upper, lower: (nodes,). flags: as of `MarchArrays`.
    """

    def __init__(
        self,
        march: Marched,
        device: Device,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        bounds: Bounds | None,
    ) -> None:
        self._device, self._stages = device, march.method.stages
        self._xp: Any = device.arrays
        self.march, self._host, self.bounds = march, values, bounds
        stage = march.leaves.stage(lower=lower is not None, upper=upper is not None)
        self._along = stage.rates.along
        text = march_text(stage, march.scheme, march.precision, march.cut[0])
        self._program = device.program(text)
        self._units = march.units
        arrays = 1 + max(self._stages - 1, 1) + sum(b is not None for b in (upper, lower))
        device.check_memory(arrays * values.nbytes, f"{arrays} arrays of {len(values):,} nodes")
        on_device = self._xp.asarray(values)
        on_device = on_device.copy() if on_device is values else on_device
        self._arrays = [on_device, *(on_device.copy() for _ in range(max(self._stages - 1, 1)))]
        self.flags = self._xp.ones((max(self._stages, 2), self._units), dtype=np.uint8)
        self._bounds_here = upper, lower
        self._bounds: list[Any] = []
        self._bounds_moved()
        self._grid = self._xp.asarray(_grid(march.shape.tolist(), march.cut.tolist(), march.kinds))
        self._axes = self._xp.asarray(march.axes)
        self._pitch = np.int64(march.axes.shape[1])
        self._nodes = int(march.shape[-1])
        # A row for each number, so that threads of nodes side by side read numbers side by side.
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

    def _bounds_moved(self) -> None:
        """Bring the bounds at nodes to the device; where there are none, something stands there."""
        self._bounds = [
            self._xp.asarray(bound) if bound is not None else self._arrays[0]
            for bound in reversed(self._bounds_here)
        ]

    def _carry_out(self, order: StageOrder) -> Counts:
        s = order.s
        xp, stages, arrays, flags = self._xp, self._stages, self._arrays, self.flags
        last = s == stages - 1
        later = flags[1:stages] if last and stages > 1 else flags[:1]
        many = stages - 1 if last else 0
        self._out = arrays[1] if stages == 1 else arrays[0 if last else s + 1]
        here, there = flags[s], flags[(s + 1) % len(flags)]
        if self._fold is not None:
            self._fold.narrow(here)
        before = arrays[0] if stages == 1 else self._out
        u, numbers = xp.asarray(order.u), xp.asarray(order.numbers)
        counts = xp.zeros(3, dtype=np.uint64)
        axis = self._axes[-1]
        self._program.run("hf_last_axis", 1, axis, np.int64(self._nodes), u, self._table)
        self._program.run(
            "hf_measured" if order.measures else "hf_stage",
            min(self._units, self._device.blocks),
            self._grid, np.int64(self._units), self._axes, self._pitch, u, numbers, self._table,
            arrays[s], arrays[0], before, *self._bounds, self._out, here, there, later,
            np.int64(many), counts,
        )  # fmt: skip
        if self._fold is not None:
            self._mirror(self._out, self._fold.needed)
        if stages == 1:
            arrays.reverse()
            self.flags = flags[::-1]
        totals = self._device.fetched(counts)
        return np.array([totals[0], totals[1], totals[2:].view(np.float64)[0]], dtype=np.float64)

    def not_finite(self) -> int:
        return first_not_finite(self._device.fetched(self._out))

    def values(self) -> Array:
        """The values at the nodes, shape (nodes,), between two steps, on the host."""
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
            "hf_reflect", self._device.blocks, self._grid, np.int64(array.size), fold.places, pitch,
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
    """What the kernels have to know of a grid (`device_sweep.py`), shape (4 * axes + 4,)."""
    n = len(shape)
    nodes = [math.prod(shape[i + 1 :]) for i in range(n)]
    local = cut[1] * cut[2]
    units = [math.prod(shape[i + 1 : n - 2]) * local for i in range(n)]
    return np.array([*shape, *nodes, *units, *kinds.tolist(), *cut], dtype=np.int64)
