"""The values of a march on a graphics processor, its stages there, and their text.

The text is that of the leaves of the march on a processor (`stage_leaf.py`, `stage_leaf.py`, the
schemes), printed as C++ for a node, not as LLVM for a run of nodes, and of the sweep that calls
them. It is the same for a GPU and for the C++ compiler of this machine. The values differ from
those of the march on a processor by roundings alone: the latter lets LLVM choose which product is
fused with which sum.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from types import TracebackType
from typing import Any

import numpy as np

from holdfast.execution.arithmetic.steps import Steps, Value
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.codegen.c_printer import Body, c_functions
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import FUNCTIONS
from holdfast.execution.device.program import Device
from holdfast.execution.level_set.schemes import Scheme
from holdfast.execution.level_set.stage_leaf import Stage, names_of_numbers
from holdfast.execution.level_set.sweeping import (
    Bounds,
    Counts,
    Fold,
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

TABLE = "hf_real *table, hf_int pitch"
"""The results of the leaf of the last axis: rows that are `pitch` numbers apart."""


def device_layout(shape: Sequence[int], of_row: int) -> tuple[int, int, int, int]:
    """As `units.layout`: what depends on the rows of a unit is shared by a block of threads."""
    rows = max(1, SHARED // (8 * (of_row + 1)))
    return layout(shape, min(MOST_NODES, rows * shape[-1]), MOST_NODES)


def march_text(stage: Stage, scheme: Scheme, precision: str, rows: int) -> str:
    """The kernels `hf_last_axis`, `hf_stage`, `hf_measured` and `hf_mirror`.

    rows: of the last axis in a unit.
    """
    real = "float" if precision == "float32" else "double"
    rates = stage.rates
    leaves = [
        _leaf("along", rates.leaves["along"], real, "table[{} * pitch]", TABLE),
        _leaf("row", rates.leaves["rows"], "double", "of_row[{} * HF_MOST_ROWS]", "double *of_row"),
        *_scheme(scheme, precision, real),
        _node(stage, real),
    ]
    text = "\n\n".join(leaves)
    functions = c_functions(text, FUNCTIONS).replace("static inline", "HF_FUNCTION")
    named = {
        "AXES": stage.axes, "GHOSTS": scheme.ghosts, "ONE_SLOPE": int(scheme.one_slope),
        "FILTERED": int(stage.filtered), "LOWER": int(stage.lower), "UPPER": int(stage.upper),
        "FALLS": names_of_numbers(stage.axes).index("low0"),
        "ROW": rates.of_row + rates.outer,
        "MOST_ROWS": int(rows),
    }  # fmt: skip
    head = [f"#define HF_{name} {value}" for name, value in named.items()]
    sweep = (resources.files(__package__) / "device_sweep.h").read_text("utf-8")
    return "\n".join([f"typedef {real} hf_real;", *head, "", functions + text, "", sweep])


def _leaf(name: str, leaf: Leaf, real: str, place: str, into: str) -> str:
    """A leaf of nodes or rows: w its states, u what is the same everywhere."""
    body = Body(leaf.steps, leaf.results, "    ")
    used = _inputs(leaf.steps, leaf.results)
    places = {
        n: f"{a}[{k}]" for a in ("w", "u") for k, n in enumerate(leaf.arguments[a]) if n in used
    }
    ends = [
        f"    {place.format(i)} = {_cast(body.text(v.number), real)};"
        for i, v in enumerate(leaf.results)
    ]
    return "\n".join(
        [
            f"HF_FUNCTION void hf_{name}(const double *w, const double *u, {into})",
            "{",
            *_declared(places, "double"),
            *body.lines,
            *ends,
            "}",
        ]
    )


def _cast(text: str, real: str) -> str:
    return text if real == "double" else f"(hf_real)({text})"


def _scheme(scheme: Scheme, precision: str, real: str) -> Iterable[str]:
    """The slope at the upper and at the lower end of an interval, from the nodes n[0], n[1], ...

    The plain difference, which its leaf may have too, is a subtraction in `device_sweep.h`.
    """
    if scheme.one_slope:
        return
    leaf = scheme.leaf(precision, plain=False)
    for name, result in zip(("upper", "lower"), leaf.results, strict=True):
        body = Body(leaf.steps, [result], "    ", real, fused=True)
        places = {f"n{k}": f"n[{k}]" for k in range(2 * scheme.ghosts)}
        used = _inputs(leaf.steps, [result])
        yield "\n".join(
            [
                f"HF_FUNCTION hf_real hf_{name}(const hf_real *n)",
                "{",
                *_declared({k: v for k, v in places.items() if k in used}, real),
                *body.lines,
                f"    return {body.text(result.number)};",
                "}",
            ]
        )


def _node(stage: Stage, real: str) -> str:
    """From the slopes in cells on both sides of a node, and its plain differences, to its value."""
    n = stage.axes
    places = {name: f"numbers[{k}]" for k, name in enumerate(names_of_numbers(n))}
    names = [f"{x}{i}" for x in ("mean", "gap") for i in range(n)]
    lines = [
        *_declared(places, real),
        f"    {real} {', '.join(names)}, rate;",
        *_rate(stage, real, "", "rate", 0, declared=False),
    ]
    if stage.filtered:
        sides = {
            f"{kind}{x}{i}": f"{kind}{x}[{i}]"
            for kind in ("", "plain_")
            for i in range(n)
            for x in ("below", "above")
        }
        steps, results = stage.apart()
        apart = Body(steps, results, "        ", real, fused=True)
        steps, (held,) = stage.filter()
        last = Body(steps, [held], "            ", real, fused=True)
        lines += [
            "    {",
            f"    {real} {', '.join(f'speed{i}' for i in range(n))};",
            *(
                x
                for i in range(n)
                for x in _rate(stage, real, "", f"speed{i}", 2 + i, declared=True)
            ),
            *_declared(sides, real, "        "),
            *apart.lines,
            f"        if ({apart.text(results[2].number)}) {{",
            f"            const {real} apart = {apart.text(results[0].number)};",
            f"            const {real} own_leeway = {apart.text(results[1].number)};",
            f"            {real} monotone;",
            *_rate(stage, real, "plain_", "monotone", 1, declared=True),
            "            {",
            f"            const {real} leeway = own_leeway;",
            *last.lines,
            f"            rate = {last.text(held.number)};",
            "            }",
            "        }",
            "    }",
        ]
    steps, results = stage.step(measured=True)
    last = Body(steps, results, "    ", real, fused=True)
    lines += last.lines
    for name, value in zip(("new_value", "differs", "odd", "move"), results, strict=True):
        lines.append(f"    *{name} = {last.text(value.number)};")
    return "\n".join(
        [
            "HF_FUNCTION void hf_node(const double *numbers, const hf_real *along, hf_int pitch,",
            "    const double *of_row, const hf_real *below, const hf_real *above,",
            "    const hf_real *plain_below, const hf_real *plain_above, hf_real value,",
            "    hf_real base, hf_real before, hf_real lower, hf_real upper, hf_real *new_value,",
            "    int *differs, int *odd, hf_real *move)",
            "{",
            *lines,
            "}",
        ]
    )


def _rate(
    stage: Stage, real: str, kind: str, name: str, result: int, *, declared: bool
) -> list[str]:
    """A block that sets `name` to a result of the leaf of the rate, from the slopes of a kind.

    declared: whether the means and gaps are the block's own, and not those outside it.
    """
    n, rates = stage.axes, stage.rates
    rate, along = rates.rate, rates.along
    of_rate = real if rate.algebraic else "double"
    slopes, results = stage.slopes()
    means = Body(slopes, results, "            ", real, fused=True)
    names = [f"{x}{i}" for x in ("mean", "gap") for i in range(n)]
    sides = {f"{x}{i}": f"{kind}{x}[{i}]" for i in range(n) for x in ("below", "above")}
    wanted = rate.results[result]
    used = _inputs(rate.steps, [wanted])
    places: dict[str, str] = {}
    for k, argument in enumerate(rate.arguments["w"]):
        if k < along:
            places[argument] = f"along[{k} * pitch]"
        elif k < along + rates.of_row:
            places[argument] = f"(hf_real)of_row[{rates.outer + k - along} * HF_MOST_ROWS]"
        else:
            i = k - along - rates.of_row
            places[argument] = f"{'mean' if i < n else 'gap'}{i % n}"
    places |= {x: f"of_row[{k} * HF_MOST_ROWS]" for k, x in enumerate(rate.arguments["u"])}
    body = Body(rate.steps, [wanted], "            ", of_rate)
    return [
        "    {",
        *([f"        {real} {', '.join(names)};"] if declared else []),
        "        {",
        *_declared(sides, real, "            "),
        *means.lines,
        *(
            f"            {x} = {means.text(v.number)};"
            for x, v in zip(names, results, strict=True)
        ),
        "        }",
        "        {",
        *_declared({k: v for k, v in places.items() if k in used}, of_rate, "            "),
        *body.lines,
        f"            {name} = ({real})({body.text(wanted.number)});",
        "        }",
        "    }",
    ]


def _inputs(steps: Steps, results: Sequence[Value]) -> set[str]:
    """The names of the inputs that results need."""
    needed = steps.needed([v.number for v in results])
    return {steps.list[k].given for k in needed if steps.list[k].operation == "input"}


def _declared(places: Mapping[str, str], real: str, indent: str = "    ") -> list[str]:
    return [f"{indent}const {real} {name} = ({real}){place};" for name, place in places.items()]


class DeviceSweeping(StagesHere):
    """As `Sweeping`, with arrays of the device. Values come to the host when they are asked for."""

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
