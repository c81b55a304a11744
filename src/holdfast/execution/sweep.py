"""The text of a sweep over a grid: derivatives, Hamiltonian, dissipation and time step in one pass.

Generated for the dimension, the Hamiltonian and the scheme at hand. The last axis is cut into
stretches of at most `LONGEST` nodes, the unit that is computed, or skipped where nothing it depends
on has changed since it was computed last.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.execution.compile import compile_sweep
from holdfast.execution.printer import text_of
from holdfast.execution.schedule import BEFORE, Schedule, renamed
from holdfast.maths.hamiltonian import Hamiltonian
from holdfast.maths.quantity import TIME, Parameter

LONGEST = 64

SCHEMES = {"upwind": 1, "eno2": 2, "eno3": 3, "weno5": 3}
"""One-sided derivatives and how many nodes they reach on either side."""

DISSIPATIONS = ("global", "local", "local-local")

LIMITS = {
    "free": "{0}",
    "shrink": "({0} if not {0} > 0.0 else 0.0)",
    "grow": "({0} if not {0} < 0.0 else 0.0)",
}
"""What becomes of dW/dt: as it is, never above zero, never below."""


def sweep_source(
    hamiltonian: Hamiltonian,
    parameters: Sequence[Parameter],
    *,
    scheme: str,
    dissipation: str,
    limit: str,
) -> str:
    """The functions `sweep` and `fastest` for this Hamiltonian."""
    n = len(hamiltonian.costates)
    names = _names(hamiltonian, parameters)
    if dissipation == "global":
        speeds: Sequence[sp.Expr] = [sp.Symbol(f"_a{i}", real=True) for i in range(n)]
    else:
        speeds = hamiltonian.speeds if dissipation == "local" else hamiltonian.tight_speeds
    gaps = [sp.Symbol(f"_g{i}", real=True) for i in range(n)]
    total = hamiltonian.value + sum(
        (a * g for a, g in zip(speeds, gaps, strict=True)), start=sp.S.Zero
    )
    width = {s: sp.Abs(g) for s, g in zip(hamiltonian.spreads, gaps, strict=True)}
    (total,), _ = renamed([total.xreplace(width)], names)
    axes = [sp.Symbol(f"q{i}", real=True) for i in range(n)]
    at_node = [sp.Symbol(s, real=True) for i in range(n) for s in (f"p{i}", f"g{i}")]
    plan = Schedule(axes, frozenset(at_node))
    (rate,) = plan.add([total])
    text = [_header(n, SCHEMES[scheme]), _sweep(plan, rate, n, scheme, limit, names)]
    bounds, _ = renamed(list(hamiltonian.speeds), names)
    text.append(_fastest(bounds, n, names))
    return "\n\n\n".join(text) + "\n"


def values_on_grid(
    expression: sp.Expr,
    symbols: Sequence[sp.Symbol],
    parameters: Sequence[Parameter],
    axes: Sequence[npt.NDArray[np.float64]],
) -> npt.NDArray[np.float64]:
    """The expression at every node, flat; `symbols` are those of the axes."""
    names = {s: f"q{i}" for i, s in enumerate(symbols)}
    names |= {q.symbol: f"k{i}" for i, q in enumerate(parameters)}
    module = compile_sweep(_fill(expression, len(axes), names) + "\n")
    shape = np.array([len(a) for a in axes], dtype=np.int64)
    out = np.empty(int(np.prod(shape)))
    module.fill(padded(axes), shape, np.array([*(float(q.value) for q in parameters), 0.0]), out)
    return out


def padded(axes: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """The nodes of every axis as the rows of one array."""
    rows = np.zeros((len(axes), max(len(a) for a in axes)))
    for row, axis in zip(rows, axes, strict=True):
        row[: len(axis)] = axis
    return rows


def _names(h: Hamiltonian, parameters: Sequence[Parameter]) -> dict[sp.Symbol, str]:
    names = {q.symbol: f"q{i}" for i, q in enumerate(h.system.states)}
    names |= {q.symbol: f"k{i}" for i, q in enumerate(parameters)}
    for i, s in enumerate(h.costates):
        names[s] = f"p{i}"
        names[sp.Symbol(f"_g{i}", real=True)] = f"g{i}"
        names[sp.Symbol(f"_a{i}", real=True)] = f"a{i}"
    return names | {TIME: "t"}


def _header(n: int, ghosts: int) -> str:
    return f"DIMENSION = {n}\nGHOSTS = {ghosts}\nLONGEST = {LONGEST}"


def _unpack(names: dict[sp.Symbol, str], used: set[str], prefix: str, array: str) -> list[str]:
    found = sorted(
        {v for v in names.values() if v[0] == prefix and v in used}, key=lambda v: int(v[1:])
    )
    return [f"{v} = {array}[{v[1:]}]" for v in found]


def _used(plan: Schedule, rest: Sequence[sp.Expr]) -> set[str]:
    every = (
        [e for rows in plan.levels.values() for _, e in rows]
        + [e for _, e in plan.tables]
        + list(rest)
    )
    return {str(s) for e in every for s in e.free_symbols}


def _sweep(
    plan: Schedule, rate: sp.Expr, n: int, scheme: str, limit: str, names: dict[sp.Symbol, str]
) -> str:
    last = n - 1
    used = _used(plan, [rate])
    out = ["@swept", "def sweep("]
    out[-1] += (
        "first, last, t, dt, weight, values, base, out, before, upper, lower, floor, ceiling, "
        "near, slow, active, marks, own, shape, steps, kinds, speeds, axes, p, counts):"
    )
    body: list[str] = []
    body += ["ghosts = GHOSTS"]
    body += [f"n{i} = shape[{i}]" for i in range(n)]
    body += [f"stretches = -(-n{last} // LONGEST)", f"longest = -(-n{last} // stretches)"]
    for i in range(n - 1):
        body.append(f"s{i} = " + " * ".join(f"n{k}" for k in range(i + 1, n)))
    body += _unpack(names, used, "k", "p") + _unpack(names, used, "a", "speeds")
    body += plan.lines(BEFORE)
    for s, _ in plan.tables:
        body += [f"{s}_table = np.empty(n{last})"]
    if plan.tables:
        body += [f"for i{last} in range(n{last}):", f"    q{last} = axes[{last}, i{last}]"]
        for s, e in plan.tables:
            body += [f"    {s} = {text_of(e)}", f"    {s}_table[i{last}] = {s}"]
    body += [
        "rows = np.zeros((2 * GHOSTS + 1, LONGEST))",
        f"mean = np.empty(({n}, LONGEST))",
        f"gap = np.empty(({n}, LONGEST))",
        "rate = np.empty(LONGEST)",
        "was = np.empty(LONGEST)",
        "line = np.empty(LONGEST + 2 * GHOSTS)",
        "changed_units, wrong, moving, computed = 0, 0, 0, 0",
    ]
    indent = ""
    for i in range(n - 1):
        r = "range(first, last)" if i == 0 else f"range(n{i})"
        body.append(f"{indent}for i{i} in {r}:")
        indent += "    "
        if f"q{i}" in used:
            body.append(f"{indent}q{i} = axes[{i}, i{i}]")
        body += [indent + x for x in plan.lines(i)]
    index = "0"
    for i in range(n - 1):
        index = f"i{i}" if i == 0 else f"({index}) * n{i} + i{i}"
    body += [f"{indent}row = {index}" if n > 1 else f"{indent}row = 0"]
    start, stop = ("first", "last") if n == 1 else ("0", "stretches")
    body += [f"{indent}for piece in range({start}, {stop}):"]
    indent += "    "
    inner = [
        "unit = row * stretches + piece",
        "if active[unit] == 0:",
        "    continue",
        "active[unit] = 0",
        "computed += 1",
        "begin = piece * longest",
        f"count = min(longest, n{last} - begin)",
        "whole = (count + 3) & ~3  # what is computed beyond count is not used",
        f"here = row * n{last} + begin",
    ]
    for i in range(n - 1):
        inner += [
            f"gather(values, here, i{i}, n{i}, s{i}, kinds[{i}], GHOSTS, count, rows)",
            f"{scheme}(rows, whole, 1.0 / steps[{i}], mean[{i}], gap[{i}])",
        ]
    inner += [
        f"gather_along(values, row * n{last}, begin, n{last}, kinds[{last}], GHOSTS, count, line,",
        "    rows)",
        f"{scheme}(rows, whole, 1.0 / steps[{last}], mean[{last}], gap[{last}])",
        "for j in range(count):",
    ]
    if f"q{last}" in used:
        inner.insert(-1, f"q{last}_here = axes[{last}, begin : begin + count]")
        inner.append(f"    q{last} = q{last}_here[j]")
    for s, _ in plan.tables:
        if str(s) in used:
            at = next(k for k, line in enumerate(inner) if line.startswith("for j in"))
            inner.insert(at, f"{s}_here = {s}_table[begin : begin + count]")
            inner.append(f"    {s} = {s}_here[j]")
    for i in range(n):
        inner += [f"    p{i} = mean[{i}, j]"] if f"p{i}" in used else []
        inner += [f"    g{i} = gap[{i}, j]"] if f"g{i}" in used else []
    inner += ["    " + x for x in plan.lines(n)]
    inner += [f"    rate[j] = {text_of(rate)}"]
    inner += [
        "changes, odd, fast = advance(",
        "    rate, rows[GHOSTS], was, count, here, dt, weight, base, out, before, upper, lower,",
        "    floor, ceiling, near, slow,",
        ")",
        "wrong += odd",
        "moving += fast",
        "if changes > 0:",
        "    changed_units += 1",
        "    for k in range(own.shape[0]):",
        "        own[k, unit] = 1",
        "    for k in range(max(0, piece - GHOSTS), min(stretches, piece + GHOSTS + 1)):",
        "        marks[row * stretches + k] = 1",
        f"    if kinds[{last}] == PERIODIC:",
        "        for k in range(1, GHOSTS + 1):",
        "            marks[row * stretches + (piece - k) % stretches] = 1",
        "            marks[row * stretches + (piece + k) % stretches] = 1",
    ]
    for i in range(n - 1):
        inner += [
            f"    mark(marks, unit, i{i}, n{i}, (s{i} // n{last}) * stretches, kinds[{i}], GHOSTS)"
        ]
    body += [indent + x for x in inner]
    body += ["counts[0] += changed_units", "counts[1] += wrong", "counts[2] += moving"]
    body += ["counts[3] += computed"]
    # the kind of step and limit are constants of the text
    text = "\n".join(out) + "\n" + "\n".join("    " + x for x in body)
    return f"{_ADVANCE.replace('LIMITED_RATE', LIMITS[limit].format('r'))}\n\n\n{text}"


_ADVANCE = '''@swept
def advance(
    rate, values, was, count, here, dt, weight, base, out, before, upper, lower, floor, ceiling,
    near, slow,
):
    """One stage of a step of a stretch; how many nodes changed, are no numbers, still move."""
    changes, odd, fast = 0, 0, 0
    old_base = base[here : here + count]
    new = out[here : here + count]
    old = before[here : here + count]  # may be the same memory as new
    for j in range(count):
        was[j] = old[j]
    for j in range(count):
        r = rate[j]
        r = LIMITED_RATE
        b = float(old_base[j])
        rate[j] = b + weight * ((values[j] - b) + dt * r)
    if len(lower) > 0:
        least_ = lower[here : here + count]
        for j in range(count):
            rate[j] = max(rate[j], float(least_[j]))
    if len(upper) > 0:
        most = upper[here : here + count]
        for j in range(count):
            rate[j] = min(rate[j], float(most[j]))
    for j in range(count):
        v = rate[j]
        v = v if not v < floor else floor
        v = v if not v > ceiling else ceiling
        odd += 0 if abs(v) < 1e300 else 1
        new[j] = v
    for j in range(count):
        now = float(new[j])
        changes += 1 if now != was[j] else 0
        fast += 1 if (abs(now - was[j]) > slow) & (was[j] > near) else 0
    return changes, odd, fast


@swept
def mark(marks, unit, place, nodes, stride, kind, ghosts):
    """The units within reach along an outer axis have to be computed again."""
    for k in range(-ghosts, ghosts + 1):
        there = place + k
        if kind == PERIODIC:
            there = (there + nodes) % nodes
        if 0 <= there < nodes:
            marks[unit + (there - place) * stride] = 1'''


def _fastest(bounds: Sequence[sp.Expr], n: int, names: dict[sp.Symbol, str]) -> str:
    """max over the grid of the speed along every axis, and of their sum over the steps."""
    axes = [sp.Symbol(f"q{i}", real=True) for i in range(n)]
    plan = Schedule(axes)
    left = plan.add(bounds)
    used = _used(plan, left)
    body = [*_unpack(names, used, "k", "p"), *plan.lines(BEFORE)]
    indent = ""
    for i in range(n):
        moves = (
            f"shape[{i}]"
            if any(sp.Symbol(f"q{i}", real=True) in e.free_symbols for e in bounds)
            else "1"
        )
        body.append(f"{indent}for i{i} in range({moves}):")
        indent += "    "
        if f"q{i}" in used:
            body.append(f"{indent}q{i} = axes[{i}, i{i}]")
        body += [indent + x for x in (plan.lines(i) if i < n - 1 else [])]
        if i == n - 1:
            body += [f"{indent}{s} = {text_of(e)}" for s, e in plan.tables]
            body += [indent + x for x in plan.lines(n)]
    body.append(f"{indent}total = 0.0")
    for i, e in enumerate(left):
        body += [
            f"{indent}v = {text_of(e)}",
            f"{indent}out[{i}] = max(out[{i}], v)",
            f"{indent}total += v / steps[{i}]",
        ]
    body.append(f"{indent}out[{n}] = max(out[{n}], total)")
    head = "@compiled\ndef fastest(t, axes, shape, steps, p, out):\n"
    return head + "\n".join("    " + x for x in body)


def _fill(expression: sp.Expr, n: int, names: dict[sp.Symbol, str]) -> str:
    """The function `fill`: an expression at every node."""
    (expression,), _ = renamed([expression], names)
    axes = [sp.Symbol(f"q{i}", real=True) for i in range(n)]
    plan = Schedule(axes)
    (left,) = plan.add([expression])
    used = _used(plan, [left])
    last = n - 1
    body = [*_unpack(names, used, "k", "p"), *plan.lines(BEFORE), "at = 0"]
    indent = ""
    for i in range(n):
        body.append(f"{indent}for i{i} in range(shape[{i}]):")
        indent += "    "
        if f"q{i}" in used:
            body.append(f"{indent}q{i} = axes[{i}, i{i}]")
        if i < last:
            body += [indent + x for x in plan.lines(i)]
    body += [f"{indent}{s} = {text_of(e)}" for s, e in plan.tables]
    body += [indent + x for x in plan.lines(n)]
    body += [f"{indent}out[at] = {text_of(left)}", f"{indent}at += 1"]
    return "@compiled\ndef fill(axes, shape, p, out):\n" + "\n".join("    " + x for x in body)
