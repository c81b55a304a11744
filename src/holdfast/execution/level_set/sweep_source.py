"""The text of a sweep over a grid: derivatives, Hamiltonian, dissipation and step in one pass.

Generated for the dimension, the Hamiltonian and the scheme at hand. A unit is a number of nodes,
several rows of the last axis or a stretch of one; it is computed, or skipped where nothing that it
depends on has changed since it was computed last. Units that follow one another are a run, which is
computed in one go.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.execution.codegen.loop_nest import BEFORE, Schedule, renamed
from holdfast.execution.codegen.printer import text_of
from holdfast.execution.compile import single
from holdfast.execution.level_set.over_grid import fastest_source, names_in, names_used, unpacked
from holdfast.execution.level_set.schemes import schemes
from holdfast.execution.level_set.slope_source import slope_lines, slope_memory
from holdfast.maths.definitions.quantity import TIME, Parameter
from holdfast.maths.games.hamiltonian import Hamiltonian

LONGEST = 128
"""Nodes of a stretch of a row, at most."""

SHORT = 64
"""Nodes up to which several rows are one unit."""

DISSIPATIONS = ("global", "local", "local-local")

LIMITS = {
    "free": "{0}",
    "shrink": "({0} if not {0} > 0.0 else 0.0)",
    "grow": "({0} if not {0} < 0.0 else 0.0)",
}
"""The limits of dW/dt: none, never above zero, never below."""


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
        f"GHOSTS = {schemes()[scheme].ghosts}",
        f"SIDE = {1 if limit == 'shrink' else -1}",
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
    """The units of the last two axes: several whole rows, or a stretch of a single one.

    Rows in a unit, groups of rows, stretches of a row, nodes in a stretch.
    """
    rows = shape[-2] if len(shape) > 1 else 1
    groups = -(-rows // max(1, SHORT // shape[-1]))
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
    along = [name for name in (f"q{last}", *(name for name, _ in fixed)) if name in at_node]
    slopes = [f"{s}{i}" for s in "pg" for i in range(n)]
    rows = [
        *along,
        *held,
        *slopes,
        "rate",
        "size",
    ]  # of numbers at the nodes of a run, in one memory
    row_of = {name: k for k, name in enumerate(rows)}
    outer = range(n - 2)
    head = (
        "def sweep(turn, slices, t, dt, weight, values, base, out, before, upper, lower, floor, "
        "ceiling, nearest, active, marks, own, shape, cut, steps, kinds, speeds, axes, p, "
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
        f"unit_nodes = many * n{last}",
        "most = max(1, RUN // unit_nodes) if stretches == 1 else 1  # units computed together",
        f"table = np.zeros(({len(along) + 1}, most * unit_nodes), dtype=values.dtype)",
        f"for place in range(n{last}):",
        f"    q{last} = axes[{last}, place]",
        *(f"    {name} = {text}" for name, text in fixed),
        f"    for at in range(place, most * unit_nodes, n{last}):",
        *(f"        table[{k}, at] = {name}" for k, name in enumerate([*along, f"q{last}"])),
        f"work = np.zeros({len(rows)} * PITCH, dtype=values.dtype)",
        "loaded = -1",
        "rows = np.zeros((2 * GHOSTS + 1) * RUN + VECTOR, dtype=values.dtype)",
        "line = np.zeros(RUN + VECTOR + 2 * GHOSTS, dtype=values.dtype)",
        "of_line = np.arange(2 * GHOSTS + 1).astype(np.uint64)",
        "at = np.zeros(2 * GHOSTS + 1, dtype=np.uint64)  # without a sign: never from the end",
        *slope_memory(n, schemes()[scheme]),
        "was = np.zeros(RUN + VECTOR, dtype=values.dtype)",
        "wrong, computed, fastest = 0, 0, 0.0",
        "block = 0",
        "while True:",
        "    slice_ = take(turn) % MOST_SLICES",
        "    if slice_ >= len(slices) - 1:",
        "        break",
        "    first, last = slices[slice_], slices[slice_ + 1]",
    ]
    indent, index = "    ", ""
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
    body += [f"{indent}part, parts = {'0, local' if n > 2 else 'first, last'}"]
    body += [f"{indent}while part < parts:"]
    indent += "    "
    inner = [
        "unit = block * local + part",
        "if active[unit] == 0:",
        "    part += 1",
        "    continue",
        "several = 0",
        "while several < most and part + several < parts and active[unit + several] != 0:",
        "    active[unit + several] = 0",
        "    several += 1",
        "computed += several",
        "row, begin = part // stretches * many, part % stretches * longest",
        f"tall, wide = min(several * many, rows_of - row), min(longest, n{last} - begin)",
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
        if held:
            inner += ["    for j in range(np.uint64(k * wide), np.uint64((k + 1) * wide)):"]
        inner += [f"        work[np.uint64({row_of[name]} * PITCH) + j] = {name}" for name in held]
    inner += [
        "if begin != loaded:",
        "    loaded = begin",
        f"    for k in range({len(along)}):",
        "        for j in range(min(most * unit_nodes - begin, PITCH)):",
        "            work[k * PITCH + j] = table[k, begin + j]",
    ]
    inner += slope_lines(n, schemes()[scheme], row_of)
    inner += [
        *(f"{name}_ = float({name})" for name in outside),
        "for j in range(lanes(count)):",
    ]
    inner += [
        f"    {name} = work[np.uint64({k} * PITCH) + j]"
        for k, name in enumerate(rows)
        if name in at_node
    ]
    inner += [f"    {s} = {text_of(e.xreplace(here))}" for s, e in plan.levels.get(n, [])]
    inner += [
        f"    work[np.uint64({row_of['rate']} * PITCH) + j] = {text_of(rate.xreplace(here))}",
        f"rate = work[{row_of['rate']} * PITCH :]",
        "advance(",
        "    rate, values, was, count, here, float(dt), float(weight), base, out, before, upper,",
        "    lower, float(floor), float(ceiling),",
        ")",
        "if nearest > 0.0:",
        f"    cell_changes(work, {row_of['p0']} * PITCH, {row_of['g0']} * PITCH, steps, count, "
        f"{row_of['size']} * PITCH)",
        f"    move = largest_move(rate, was, work, {row_of['size']} * PITCH, count, SIDE, "
        "float(nearest))",
        "    fastest = max(fastest, move)",
        "low, high = several, 0",
        "for k in range(several):",
        "    changes, odd = compare(",
        "        rate, was, min(k * unit_nodes, count), min((k + 1) * unit_nodes, count)",
        "    )",
        "    wrong += odd",
        "    if changes > 0:",
        "        low, high = min(low, k), k + 1",
        "        for s in range(own.shape[0]):",
        "            own[s, unit + k] = 1",
        "part += several",
        "if high > 0:",
        "    unit, several, row = unit + low, high - low, row + low * many",
        "    tall = min(several * many, rows_of - row)",
        "    of = (part - 1) % stretches",
        f"    mark(marks, unit, several, of, stretches, 1, kinds[{last}], GHOSTS)",
    ]
    units = "local"
    for i in reversed(outer):
        inner.append(f"    mark(marks, unit, several, i{i}, n{i}, {units}, kinds[{i}], GHOSTS)")
        units += f" * n{i}"
    if n > 1:
        inner += [
            "    mark_rows(marks, block * local + of, row, tall, rows_of, many, stretches,",
            f"        kinds[{by_row}], GHOSTS)",
        ]
    body += [indent + x for x in inner]
    body += ["counts[0] += computed", "counts[1] += wrong", "counts[2] = fastest"]
    text = f"@entered\n{head}\n" + "\n".join("    " + x for x in body)
    # the sign that the rate is limited to is a constant of the text
    return f"{_ADVANCE.replace('LIMITED_RATE', LIMITS[limit].format('r'))}\n\n\n{text}"


_ADVANCE = '''@swept
def advance(
    rate, values, was, count, here, dt, weight, base, out, before, upper, lower, floor, ceiling
):
    """One stage of a step of a run of nodes; `rate` becomes the new values.

    NaN passes every bound, so that it is seen.
    """
    room = min(lanes(count), np.uint64(len(values) - here))
    here = np.uint64(here)
    for j in range(room):
        was[j] = before[here + j]  # may be the same memory as out
    for j in range(room):
        r = rate[j]
        r = LIMITED_RATE
        b = base[here + j]
        rate[j] = b + weight * ((values[here + j] - b) + dt * r)
    if len(lower) > 0:
        for j in range(room):
            lowest = lower[here + j]
            rate[j] = rate[j] if not rate[j] < lowest else lowest
    if len(upper) > 0:
        for j in range(room):
            highest = upper[here + j]
            rate[j] = rate[j] if not rate[j] > highest else highest
    for j in range(room):
        v = rate[j]
        v = v if not v < floor else floor
        rate[j] = v if not v > ceiling else ceiling
    for j in range(np.uint64(count)):
        out[here + j] = rate[j]
'''
