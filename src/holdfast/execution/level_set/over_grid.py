"""Expressions over a grid, as text: helpers of the sweep, values at every node, largest speeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.execution.codegen.loop_nest import BEFORE, Schedule, renamed
from holdfast.execution.codegen.printer import text_of
from holdfast.execution.compile import compile_sweep
from holdfast.maths.definitions.quantity import TIME, Parameter


def over_grid(
    expression: sp.Expr,
    symbols: Sequence[sp.Symbol],
    parameters: Sequence[Parameter],
    axes: Sequence[npt.NDArray[np.float64]],
    *,
    band: float = math.inf,
    precision: str = "float64",
) -> Callable[[float], npt.NDArray[Any]]:
    """At a time: the expression at every node, flat, cut off at +-band.

    `symbols` are those of the axes.
    """
    names = {s: f"q{i}" for i, s in enumerate(symbols)} | {TIME: "t"}
    names |= {q.symbol: f"k{i}" for i, q in enumerate(parameters)}
    module = compile_sweep(_fill(expression, len(axes), names) + "\n")
    shape = np.array([len(a) for a in axes], dtype=np.int64)
    p = np.array([*(float(q.value) for q in parameters), 0.0])
    rows = padded(axes)

    def at(time: float) -> npt.NDArray[Any]:
        out = np.empty(int(np.prod(shape)), dtype=precision)
        module.fill(float(time), rows, shape, p, float(band), out)
        return out

    return at


def padded(axes: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """The nodes of every axis as the rows of one array."""
    rows = np.zeros((len(axes), max(len(a) for a in axes)))
    for row, axis in zip(rows, axes, strict=True):
        row[: len(axis)] = axis
    return rows


def fastest_source(bounds: Sequence[sp.Expr], n: int, names: dict[sp.Symbol, str]) -> str:
    """max over the grid of the speed along every axis, and of their sum over the steps.

    A speed that is NaN at a node is NaN over the grid.
    """
    body, left, indent = _nest(bounds, n, names, all_nodes=False)
    body.append(f"{indent}total = 0.0")
    for i, e in enumerate(left):
        body += [
            f"{indent}v = {text_of(e)}",
            f"{indent}out[{i}] = v if not v <= out[{i}] and out[{i}] == out[{i}] else out[{i}]",
            f"{indent}total += v / steps[{i}]",
        ]
    body.append(f"{indent}out[{n}] = max(out[{n}], total)")
    head = "@compiled\ndef fastest(t, axes, shape, steps, p, out):\n"
    return head + "\n".join("    " + x for x in body)


def _fill(expression: sp.Expr, n: int, names: dict[sp.Symbol, str]) -> str:
    """The function `fill`: an expression at every node."""
    body, (left,), indent = _nest(renamed([expression], names), n, names, all_nodes=True)
    body += [f"{indent}v = {text_of(left)}", f"{indent}v = v if not v < -band else -band"]
    body += [f"{indent}out[at] = v if not v > band else band", f"{indent}at += 1"]
    head = "@compiled\ndef fill(t, axes, shape, p, band, out):\n    at = 0\n"
    return head + "\n".join("    " + x for x in body)


def _nest(
    expressions: Sequence[sp.Expr], n: int, names: dict[sp.Symbol, str], *, all_nodes: bool
) -> tuple[list[str], list[sp.Expr], str]:
    """Loops over the axes, or those that matter; the lines, what is left at a node, its indent."""
    axes = [sp.Symbol(f"q{i}", real=True) for i in range(n)]
    matters = set().union(*(e.free_symbols for e in expressions))
    plan = Schedule(axes)
    left = plan.add(expressions)
    used = names_used(plan, left)
    body = [*unpacked(names, used, "k", "p"), *plan.lines(BEFORE)]
    indent = ""
    for i, axis in enumerate(axes):
        body.append(
            f"{indent}for i{i} in range({f'shape[{i}]' if all_nodes or axis in matters else 1}):"
        )
        indent += "    "
        if str(axis) in used:
            body.append(f"{indent}q{i} = axes[{i}, i{i}]")
        if i < n - 1:
            body += [indent + x for x in plan.lines(i)]
    body += [f"{indent}{s} = {text_of(e)}" for s, e in plan.tables]
    body += [indent + x for x in plan.lines(n)]
    return body, left, indent


def unpacked(names: dict[sp.Symbol, str], used: set[str], prefix: str, array: str) -> list[str]:
    found = sorted(
        {v for v in names.values() if v[0] == prefix and v in used}, key=lambda v: int(v[1:])
    )
    return [f"{v} = {array}[{v[1:]}]" for v in found]


def names_used(plan: Schedule, rest: Sequence[sp.Expr]) -> set[str]:
    every = (
        [e for rows in plan.levels.values() for _, e in rows]
        + [e for _, e in plan.tables]
        + list(rest)
    )
    return names_in(every)


def names_in(expressions: Sequence[sp.Expr]) -> set[str]:
    return {str(s) for e in expressions for s in e.free_symbols}
