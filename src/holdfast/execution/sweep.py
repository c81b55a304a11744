"""The text of a sweep over a grid: derivatives, Hamiltonian, dissipation and step in one pass.

Generated for the dimension, the Hamiltonian and the scheme at hand. A unit is a run of about
`LONGEST` nodes, several rows of the last axis or a stretch of one; it is computed, or skipped where
nothing that it depends on has changed since it was computed last.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.execution.compile import single
from holdfast.execution.over_grid import fastest_source, names_in, names_used, unpacked
from holdfast.execution.printer import text_of
from holdfast.execution.schedule import BEFORE, Schedule, renamed
from holdfast.maths.hamiltonian import Hamiltonian
from holdfast.maths.quantity import TIME, Parameter

LONGEST = 64
"""The same as in `differences.py`; a multiple of its VECTOR."""

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
    precision: str = "float64",
) -> str:
    """The functions `sweep` and `fastest` for this Hamiltonian.

    What is computed at every node is so in the precision of the value.
    """
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
    (total,) = renamed([total.xreplace(width)], names)
    axes = [sp.Symbol(f"q{i}", real=True) for i in range(n)]
    at_node = [sp.Symbol(s, real=True) for i in range(n) for s in (f"p{i}", f"g{i}")]
    plan = Schedule(axes, frozenset(at_node))
    (rate,) = plan.add([total])
    sweep = _sweep(plan, rate, n, scheme, limit, names)
    text = [
        f"GHOSTS = {SCHEMES[scheme]}",
        single(sweep) if precision == "float32" else sweep,
    ]
    bounds = renamed(list(hamiltonian.speeds), names)
    text.append(fastest_source(bounds, n, names))
    return "\n\n\n".join(text) + "\n"


def _names(h: Hamiltonian, parameters: Sequence[Parameter]) -> dict[sp.Symbol, str]:
    names = {q.symbol: f"q{i}" for i, q in enumerate(h.system.states)}
    names |= {q.symbol: f"k{i}" for i, q in enumerate(parameters)}
    for i, s in enumerate(h.costates):
        names[s] = f"p{i}"
        names[sp.Symbol(f"_g{i}", real=True)] = f"g{i}"
        names[sp.Symbol(f"_a{i}", real=True)] = f"a{i}"
    return names | {TIME: "t"}


def layout(shape: Sequence[int]) -> tuple[int, int, int, int]:
    """How the last two axes are cut into units of at most `LONGEST` nodes, if one row is no longer.

    Rows in a unit, groups of rows, stretches of a row, nodes in a stretch. Several whole rows are
    one run in memory, or one stretch of a single row is.
    """
    rows = shape[-2] if len(shape) > 1 else 1
    groups = -(-rows // max(1, LONGEST // shape[-1]))
    stretches = -(-shape[-1] // LONGEST)
    return -(-rows // groups), groups, stretches, -(-shape[-1] // stretches)


def _sweep(
    plan: Schedule, rate: sp.Expr, n: int, scheme: str, limit: str, names: dict[sp.Symbol, str]
) -> str:
    last, by_row = n - 1, n - 2
    used = names_used(plan, [rate])
    at_node = names_in([e for _, e in plan.levels.get(n, [])] + [rate])
    of_row = [str(s) for s, _ in plan.levels.get(by_row, [])] if n > 1 else []
    held = [name for name in ([f"q{by_row}"] if n > 1 else []) + of_row if name in at_node]
    fixed = [(str(s), text_of(e)) for s, e in plan.tables]
    known = {str(s) for s, _ in plan.levels.get(n, [])} | {name for name, _ in fixed} | set(held)
    known |= {f"q{last}", *(f"{s}{i}" for i in range(n) for s in "pg")}
    outside = sorted(at_node - known)  # the same at all nodes of a unit
    here = {sp.Symbol(s, real=True): sp.Symbol(f"{s}_", real=True) for s in outside}
    outer = range(n - 2)
    head = (
        "def sweep(first, last, t, dt, weight, values, base, out, before, upper, lower, floor, "
        "ceiling, near, slow, active, marks, own, shape, cut, steps, kinds, speeds, axes, p, "
        "counts):"
    )
    body = [f"n{i} = shape[{i}]" for i in range(n)]
    body += [f"rows_of = n{by_row}" if n > 1 else "rows_of = 1"]
    body += ["many, groups, stretches, longest = cut[0], cut[1], cut[2], cut[3]"]
    body += ["local = groups * stretches"]
    for i in range(n - 1):
        body.append(f"s{i} = " + " * ".join(f"n{k}" for k in range(i + 1, n)))
    body += unpacked(names, used, "k", "p") + unpacked(names, used, "a", "speeds")
    body += plan.lines(BEFORE)
    body += [
        f"fixed = np.empty(({len(fixed) + 1}, many * n{last}), dtype=values.dtype)",
        "for row in range(many):",
        f"    for place in range(n{last}):",
        f"        at = row * n{last} + place",
        f"        q{last} = axes[{last}, place]",
        f"        fixed[{len(fixed)}, at] = q{last}",
    ]
    for k, (name, text) in enumerate(fixed):
        body += [f"        {name} = {text}", f"        fixed[{k}, at] = {name}"]
    body += [
        "rows = np.zeros((2 * GHOSTS + 1) * LONGEST, dtype=values.dtype)",
        "line = np.zeros(LONGEST + VECTOR + 2 * GHOSTS, dtype=values.dtype)",
        "of_line = np.arange(2 * GHOSTS + 1).astype(np.uint64)",
        "of_rows = of_line * np.uint64(LONGEST)",
        "at = np.zeros(2 * GHOSTS + 1, dtype=np.uint64)  # without a sign: never from the end",
        f"mean = np.zeros({n} * LONGEST + VECTOR, dtype=values.dtype)",
        f"gap = np.zeros({n} * LONGEST + VECTOR, dtype=values.dtype)",
        f"held = np.empty(({max(len(held), 1)}, LONGEST), dtype=values.dtype)",
        "rate = np.empty(LONGEST, dtype=values.dtype)",
        "was = np.empty(LONGEST, dtype=values.dtype)",
        "wrong, moving, computed = 0, 0, 0",
        "block = 0",
    ]
    indent, index = "", ""
    for i in outer:
        body.append(
            f"{indent}for i{i} in " + ("range(first, last):" if i == 0 else f"range(n{i}):")
        )
        indent += "    "
        if f"q{i}" in used:
            body.append(f"{indent}q{i} = axes[{i}, i{i}]")
        body += [indent + x for x in plan.lines(i)]
        index = f"i{i}" if i == 0 else f"({index}) * n{i} + i{i}"
    body += [f"{indent}block = {index}"] if index else []
    body += [f"{indent}for part in range({'0, local' if n > 2 else 'first, last'}):"]
    indent += "    "
    inner = [
        "unit = block * local + part",
        "if active[unit] == 0:",
        "    continue",
        "active[unit] = 0",
        "computed += 1",
        "row, begin = part // stretches * many, part % stretches * longest",
        f"tall, wide = min(many, rows_of - row), min(longest, n{last} - begin)",
        "count = tall * wide",
        f"here = (block * rows_of + row) * n{last} + begin",
    ]
    if held or any(
        f"q{by_row}" in {str(x) for x in e.free_symbols} for _, e in plan.levels.get(by_row, [])
    ):
        inner += ["for k in range(tall):"]
        if n > 1 and f"q{by_row}" in used:
            inner += [f"    q{by_row} = axes[{by_row}, row + k]"]
        inner += ["    " + x for x in (plan.lines(by_row) if n > 1 else [])]
        inner += ["    for j in range(k * wide, (k + 1) * wide):"] if held else []
        inner += [f"        held[{k}, j] = {name}" for k, name in enumerate(held)]
    for i in range(n - 1):
        place = f"i{i}, 1, n{i}, s{i}" if i < by_row else f"row, tall, rows_of, n{last}"
        wide = "count" if i < by_row else "wide"
        rest = f"count, float(1.0 / steps[{i}]), mean, gap, {i} * LONGEST)"
        inner += [
            f"if reach(at, here, {place}, kinds[{i}], GHOSTS, len(values)):",
            f"    {scheme}(values, at, {rest}",
            "else:",
            f"    gather(values, here, {place}, {wide}, kinds[{i}], GHOSTS, rows)",
            f"    {scheme}(rows, of_rows, {rest}",
        ]
    inner += [
        "for k in range(tall):",
        f"    gather_along(values, here - begin + k * n{last}, begin, n{last}, wide,",
        f"        kinds[{last}], GHOSTS, line)",
        f"    {scheme}(line, of_line, wide, float(1.0 / steps[{last}]), mean, gap,",
        f"        {last} * LONGEST + k * wide)",
        "table = fixed[:, begin : begin + count]",
        *(f"{name}_ = float({name})" for name in outside),
        "for j in range(count):",
    ]
    if f"q{last}" in at_node:
        inner.append(f"    q{last} = table[{len(fixed)}, j]")
    inner += [f"    {name} = table[{k}, j]" for k, (name, _) in enumerate(fixed) if name in at_node]
    inner += [f"    {name} = held[{k}, j]" for k, name in enumerate(held)]
    for i in range(n):
        inner += [f"    p{i} = mean[{i} * LONGEST + j]"] if f"p{i}" in at_node else []
        inner += [f"    g{i} = gap[{i} * LONGEST + j]"] if f"g{i}" in at_node else []
    inner += [f"    {s} = {text_of(e.xreplace(here))}" for s, e in plan.levels.get(n, [])]
    inner += [
        f"    rate[j] = {text_of(rate.xreplace(here))}",
        "changes, odd, fast = advance(",
        "    rate, values, was, count, here, float(dt), float(weight), base, out, before, upper,",
        "    lower, float(floor), float(ceiling), float(near), float(slow),",
        ")",
        "wrong += odd",
        "moving += fast",
        "if changes > 0:",
        "    for k in range(own.shape[0]):",
        "        own[k, unit] = 1",
        f"    mark(marks, unit, part % stretches, stretches, 1, kinds[{last}], GHOSTS)",
    ]
    units = "local"
    for i in reversed(outer):
        inner.append(f"    mark(marks, unit, i{i}, n{i}, {units}, kinds[{i}], GHOSTS)")
        units += f" * n{i}"
    if n > 1:
        inner += [
            "    mark_rows(marks, block * local + part % stretches, row, tall, rows_of, many,",
            f"        stretches, kinds[{by_row}], GHOSTS)",
        ]
    body += [indent + x for x in inner]
    body += ["counts[0] += computed", "counts[1] += wrong", "counts[2] += moving"]
    text = f"@swept\n{head}\n" + "\n".join("    " + x for x in body)
    # the sign that the rate is limited to is a constant of the text
    return f"{_ADVANCE.replace('LIMITED_RATE', LIMITS[limit].format('r'))}\n\n\n{text}"


_ADVANCE = '''@swept
def advance(
    rate, values, was, count, here, dt, weight, base, out, before, upper, lower, floor, ceiling,
    near, slow,
):
    """One stage of a step of a unit; how many nodes changed, are no numbers, still move.

    What is no number stays so through every bound, so that it is seen.
    """
    changes, odd, fast = 0, 0, 0
    old = before[here : here + count]  # may be the same memory as out
    for j in range(count):
        was[j] = old[j]
    old = values[here : here + count]
    old_base = base[here : here + count]
    for j in range(count):
        r = rate[j]
        r = LIMITED_RATE
        b = float(old_base[j])
        rate[j] = b + weight * ((float(old[j]) - b) + dt * r)
    if len(lower) > 0:
        lowest = lower[here : here + count]
        for j in range(count):
            rate[j] = rate[j] if not rate[j] < lowest[j] else float(lowest[j])
    if len(upper) > 0:
        highest = upper[here : here + count]
        for j in range(count):
            rate[j] = rate[j] if not rate[j] > highest[j] else float(highest[j])
    new = out[here : here + count]
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
'''
