"""Means and half gaps of slopes by a scheme that has one slope of every interval between nodes."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.stencils import *  # noqa: F403

# -- joined from here on


@swept
def shared_slopes(values, shape, strides, units_of):
    """No slopes are kept."""
    return 0


@swept
def borrowed_slopes(shared):
    return shared


@swept
def held_slopes(shared):
    return shared


@swept
def slopes_across(
    scheme, values, here, i, outer, place, tall, wide, stride, nodes, kind, ghosts, unit, several,
    count, half, rows, at, shared, work, mean, gap
):  # fmt: skip
    """Means and half gaps along an axis that is not the last, at a run of nodes."""
    if outer:
        tall, wide = 1, count
    if reach(at, here, place, tall, nodes, stride, count, kind, ghosts, len(values)):
        call_scheme(scheme, values, at, 0, half, work, mean, gap - mean, count)
    else:
        gather(values, here, place, tall, nodes, stride, wide, kind, ghosts, rows, at)
        call_scheme(scheme, rows, at, 0, half, work, mean, gap - mean, count)


@swept
def slopes_along_rows(
    scheme, values, here, begin, tall, wide, nodes, kind, ghosts, count, half, line, of_line, at,
    shared, work, mean, gap
):  # fmt: skip
    """Means and half gaps along the last axis."""
    if wide == nodes and here > 0 and here + count + VECTOR < len(values):
        at[0], at[1], at[2] = here - 1, here, here + 1
        call_scheme(scheme, values, at, 0, half, work, mean, gap - mean, count)
        at_ends(values, here, tall, nodes, kind, float(half[0]), work, mean, gap)
        return
    for k in range(tall):
        gather_along(values, here - begin + k * nodes, begin, nodes, wide, kind, ghosts, line)
        call_scheme(scheme, line, of_line, 0, half, work, mean + k * wide, gap - mean, wide)


@called
def at_ends(values, first, tall, nodes, kind, half, work, mean, gap):
    """The same at the first and the last node of whole rows of the last axis."""
    for k in range(tall):
        row = first + k * nodes
        for j in (0, nodes - 1):
            low = values[row + j - 1] if j > 0 else ghost(values, row, -1, nodes, kind)
            high = values[row + j + 1] if j < nodes - 1 else ghost(values, row, nodes, nodes, kind)
            left, right = values[row + j] - low, high - values[row + j]
            work[mean + k * nodes + j] = half * (left + right)
            work[gap + k * nodes + j] = half * (right - left)
