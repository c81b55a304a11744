"""The lines of a sweep that leave means and gaps of slopes: from where, by what, shared by whom."""

from __future__ import annotations

from holdfast.execution.level_set.schemes import Scheme


def slope_memory(n: int, scheme: Scheme) -> list[str]:
    """Memory for the slopes that two nodes share: at both ends of intervals, and of a place."""
    if scheme.one_slope:
        return []
    lines = [
        f"{side} = np.zeros(2 * RUN + VECTOR, dtype=values.dtype)" for side in ("left", "right")
    ]
    units = "local"
    for i in reversed(range(n - 2)):
        lines += [
            f"kept = 1 if s{i} <= KEPT else 0",
            f"ahead{i} = np.zeros(kept * s{i}, dtype=values.dtype)",
            f"units{i} = np.full(kept * {units}, -1)",
        ]
        units += f" * n{i}"
    return lines


def slope_lines(n: int, scheme: Scheme, row_of: dict[str, int]) -> list[str]:
    """Means and gaps of the slopes along every axis, at the nodes of a run."""
    last, by_row = n - 1, n - 2
    lines, step = [], "float(1.0 / steps[{}])"
    for i in range(n - 1):
        outer = i < by_row
        place = f"i{i}, 1, n{i}, s{i}" if outer else f"row, tall, rows_of, n{last}"
        wide = "count" if outer else "wide"
        to = f"{step.format(i)}, work, {row_of[f'p{i}']} * PITCH, {row_of[f'g{i}']} * PITCH)"
        if scheme.one_slope:
            lines += _wherever(i, place, wide, [f"{scheme.name}({{0}}, at, count, {to}"])
            continue
        if outer:
            kept = f"(ahead{i}, units{i}, unit, several, here % s{i}, count, left)"
            lines += [f"start = 1 if i{i} > 0 and recall{kept} else 0"]
        one = [
            f"for k in range({'start' if outer else 0}, 2):",
            f"    {scheme.name}({{0}}, at, k, count, left, right, k * count)",
        ]
        if not outer:
            one = [
                "if tall > 1:",
                f"    {scheme.name}({{0}}, at, 0, count + wide, left, right, 0)",
                "else:",
                *("    " + x for x in one),
            ]
        lines += _wherever(i, place, wide, one)
        lines += [f"combine(left, right, {wide}, count, {to}"]
        lines += [f"remember{kept}"] if outer else []
    mean, gap = (f"{row_of[f'{s}{last}']} * PITCH" for s in "pg")
    by_rows = [
        "for k in range(tall):",
        f"    gather_along(values, here - begin + k * n{last}, begin, n{last}, wide,",
        f"        kinds[{last}], GHOSTS, line)",
    ]
    to = f"{step.format(last)}, work, {mean} + k * wide, {gap} + k * wide)"
    if not scheme.one_slope:
        by_rows += [
            f"    {scheme.name}(line, of_line, 0, wide + 1, left, right, 0)",
            f"    combine(left, right, 1, wide, {to}",
        ]
        return [*lines, *by_rows]
    by_rows += [f"    {scheme.name}(line, of_line, wide, {to}"]
    to = f"{step.format(last)}, work, {mean}, {gap})"
    return [
        *lines,
        f"if wide == n{last} and here > 0 and here + count + VECTOR < len(values):",
        "    at[0], at[1], at[2] = here - 1, here, here + 1",
        f"    {scheme.name}(values, at, count, {to}",
        f"    {scheme.name}_ends(values, here, tall, n{last}, kinds[{last}], {to}",
        "else:",
        *("    " + x for x in by_rows),
    ]


def _wherever(i: int, place: str, wide: str, lines: list[str]) -> list[str]:
    """The lines for the values themselves, or for those that are gathered."""
    return [
        f"if reach(at, here, {place}, count, kinds[{i}], GHOSTS, len(values)):",
        *("    " + x.format("values") for x in lines),
        "else:",
        f"    gather(values, here, {place}, {wide}, kinds[{i}], GHOSTS, rows, at)",
        *("    " + x.format("rows") for x in lines),
    ]
