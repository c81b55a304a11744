"""Flow lines of a field with its critical points: sectors, kind, index, and the moment p."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]

from holdfast.arguments import checked
from holdfast.errors import OutputError
from holdfast.execution.arrays import Array
from holdfast.maths.expressions.numeric import Expression, array_function, evaluated
from holdfast.maths.reference_fields.critical_points import (
    CriticalPoint,
    frame,
    meridian,
    plane_by_plane,
)
from holdfast.maths.reference_fields.facts import (
    FlowLine,
    critical_point_name,
    critical_points,
    flow_line,
    loop_exponent,
)
from holdfast.maths.reference_fields.field import Field
from holdfast.presentation.figures import style

SECTORS = {"elliptic": style.SKY, "parabolic": style.GREEN, "hyperbolic": style.ORANGE}
_SIZES = (0.12, 0.25, 0.42, 0.64, 0.94, 1.4, 2.2, 3.6, 6.5)
_LOCAL = 0.22
"""Radius of the sectors in a local phase portrait, as a fraction of the figure's reach."""


@checked
def flow_lines_figure(field: Field, *, reach: float = 1.0, planes: int = 4) -> Figure:
    """The flow lines of a field around the origin.

    reach: how far from the origin, in the unit of the coordinates. planes: of a field in three
    dimensions, how many planes through p.

    Planar: closed forms if they exist, otherwise streamlines; sectors are shaded about each
    critical point, out to the edge if the portrait is the same at every scale. Three dimensions:
    loops in these planes. More dimensions, or no closed form: the portrait in one plane through p,
    which is the same in all.

    Raises `OutputError` for a reach that is not above 0, and for less than one plane.

    >>> hf.flow_lines_figure(hf.fields.dipolar(), reach=2.0).savefig("field.png")
    """
    if not 0 < reach < math.inf or planes < 1:
        raise OutputError(
            f"a reach of {reach:g} and {planes} planes", expected="above 0, and at least 1"
        )
    if field.dimension == 3 and loop_exponent(field) is not None:
        return _spatial(field, reach, planes)
    inside = field if field.dimension == 2 else meridian(field)
    caption = "" if field.dimension == 2 else "each plane through p: "
    with style.look():
        figure, axis = plt.subplots(figsize=(style.WIDTH * 0.65, 5.2), layout="constrained")
        axis.set_xlim(-reach, reach)
        axis.set_ylim(-reach, reach)
        axis.set_aspect("equal")
        loops = loop_exponent(inside) is not None
        zeros = critical_points(inside, ((-reach, reach), (-reach, reach)))
        classified = [c for c in zeros.critical_points if c is not None]
        radius = 2 * reach if loops and len(classified) == 1 else _LOCAL * reach
        entries: list[Line2D | Patch] = _draw_sectors(axis, classified, radius)
        if loops:
            _draw_loops(axis, inside, reach)
        else:
            _draw_streams(axis, inside, reach)
        if inside.potential is not None:
            entries.append(_draw_potential(axis, inside, reach))
        entries.insert(0, Line2D([], [], color=style.BLUE, label="flow line"))
        entries += _draw_zeros(axis, zeros.points)
        if inside.moment:
            entries.append(_draw_moment(axis, frame(inside)[0], 0.25 * reach))
        for axis_name, q in zip(("x", "y"), inside.coordinates, strict=True):
            axis.set(**{f"{axis_name}label": style.axis_label(q.name, q.unit)})
        counted = Counter(critical_point_name(c) for c in classified)
        names = [f"{n} times {name}" if n > 1 else name for name, n in counted.items()]
        title = _title(field)
        title += f"\n{caption}{'; '.join(names)}" if names else ""
        title += f" ({classified[0].validity})" if classified and classified[0].validity else ""
        axis.set_title(title.replace("lam", "λ"))
        figure.legend(handles=entries, loc="outside lower center", ncols=4)
    return figure


def _title(field: Field) -> str:
    used = {s for c in field.components for s in c.free_symbols}
    values = [f"{p.name} = {p.value:g}" for p in field.parameters if p.symbol in used]
    name = field.description.partition(":")[0].partition(",")[0] or field.name.replace("_", " ")
    return ", ".join([name, f"N = {field.dimension}", *values])


def _points(line: FlowLine, reach: float) -> Array:
    """The curve in the direction of the field, one row for each point."""
    function = array_function(line.parameter, line.curve)
    upper = float(line.upper) if line.kind == "loop" else 2 * reach
    parameter = upper * np.linspace(0.0, 1.0, 400)
    values = function(parameter)
    rows = np.stack([np.broadcast_to(v, parameter.shape) for v in values], axis=-1)
    ordered: Array = rows if line.forward else rows[::-1]
    return ordered


def _draw_loops(axis: Axes, field: Field, reach: float) -> None:
    p, e = frame(field)
    for side in (1, -1):
        loop = _points(flow_line(field, [side * c for c in e]), reach)
        for size in _SIZES:  # all loops are similar
            _line(axis, size * reach * loop, reach)
        _line(axis, _points(flow_line(field, [side * c for c in p]), reach), reach)


def _line(axis: Axes, points: Array, reach: float) -> None:
    axis.plot(points[:, 0], points[:, 1], color=style.BLUE, linewidth=0.9, zorder=2)
    shown = np.flatnonzero((np.abs(points) < 0.93 * reach).all(axis=1))
    if len(shown) > 2:
        middle = shown[len(shown) // 2]
        middle = min(max(middle, 1), len(points) - 2)
        axis.annotate(
            "",
            xy=points[middle + 1],
            xytext=points[middle],
            arrowprops={"arrowstyle": "-|>", "color": style.BLUE, "lw": 0.9, "mutation_scale": 8},
            zorder=3,
        )


def _draw_streams(axis: Axes, field: Field, reach: float) -> None:
    function = array_function(field.symbols, field.components, field.values)
    ticks = np.linspace(-reach, reach, 161)
    grid = np.meshgrid(ticks, ticks)
    u, v = (np.broadcast_to(np.asarray(c, float), grid[0].shape) for c in function(*grid))
    size = np.hypot(u, v)
    size[size == 0.0] = 1.0
    axis.streamplot(
        ticks,
        ticks,
        u / size,
        v / size,
        color=style.BLUE,
        linewidth=0.8,
        density=1.5,
        arrowsize=0.8,
    )


def _draw_potential(axis: Axes, field: Field, reach: float) -> Line2D:
    """Equipotential lines, equally many on either side."""
    assert field.potential is not None
    function = array_function(field.symbols, field.potential, field.values)
    ticks = np.linspace(-reach, reach, 240)  # even, so that no node lies at the origin
    grid = np.meshgrid(ticks, ticks)
    values = function(*grid)
    sizes = np.quantile(np.abs(values), np.linspace(0.15, 0.97, 6))
    levels = np.unique(np.concatenate([-sizes, [0.0], sizes]))
    axis.contour(
        *grid, values, levels, colors=style.GREY, linewidths=0.7, linestyles="--", zorder=1.5
    )
    return Line2D([], [], color=style.GREY, linewidth=0.7, linestyle="--", label="equipotential")


def _draw_sectors(
    axis: Axes, points: Sequence[CriticalPoint], radius: float
) -> list[Line2D | Patch]:
    counts: dict[str, int] = {}
    for point in points:
        x, y = evaluated(point.point, {})
        for sector in point.sectors:
            start, end = evaluated((sector.start, sector.end), {})
            shade = 0.16 if counts.get(sector.kind, 0) % 2 == 0 else 0.32
            axis.add_patch(
                Wedge(
                    (x, y),
                    radius,
                    np.degrees(start),
                    np.degrees(end),
                    facecolor=SECTORS[sector.kind],
                    alpha=shade,
                    linewidth=0,
                    zorder=1,
                )
            )
            if end - start < 2 * np.pi - 1e-9:
                axis.plot(
                    [x, x + radius * np.cos(start)],
                    [y, y + radius * np.sin(start)],
                    color=style.BLACK,
                    linestyle=(0, (4, 3)),
                    linewidth=0.7,
                    zorder=4,
                )
            counts[sector.kind] = counts.get(sector.kind, 0) + 1
    where = "" if radius > axis.get_xlim()[1] else ", near the point"
    return [
        Patch(color=SECTORS[kind], alpha=0.3, label=f"{kind} sector ({count})" + where)
        for kind, count in counts.items()
    ]


def _draw_zeros(axis: Axes, points: Sequence[Sequence[Expression]]) -> list[Line2D | Patch]:
    if not points:
        return []
    x, y = zip(*(evaluated(point, {}) for point in points), strict=True)
    (dots,) = axis.plot(
        x, y, "o", color=style.BLACK, markersize=4, zorder=6, label="critical point"
    )
    return [dots]


def _draw_moment(axis: Axes, p: Sequence[Expression], length: float) -> Line2D:
    tip = (length * float(p[0]), length * float(p[1]))
    axis.annotate(
        "",
        xy=tip,
        xytext=(0.0, 0.0),
        arrowprops={"arrowstyle": "-|>", "color": style.RED, "lw": 2.2, "mutation_scale": 13},
        zorder=7,
    )
    return Line2D([], [], color=style.RED, linewidth=2.2, label="direction of p")


def _spatial(field: Field, reach: float, planes: int) -> Figure:
    """Loops in planes at equal angles about p, one colour for each plane."""
    p, e = frame(field)
    along, across = (np.array([float(c) for c in v]) for v in (p, e))
    third = np.cross(along, across)
    with style.look():
        figure = plt.figure(figsize=(style.WIDTH * 0.75, 5.4), layout="constrained")
        axis: Axes3D = figure.add_subplot(projection="3d")
        entries = []
        colours = [c for c in style.LINES if c != style.RED]  # red is p
        for number in range(planes):
            turn = np.pi * number / planes
            colour = colours[number % len(colours)]
            for side in (1, -1):
                start = side * (np.cos(turn) * across + np.sin(turn) * third)
                loop = _points(flow_line(field, start.tolist()), reach)
                for size in (0.3, 0.6, 0.95):
                    _line_in_space(axis, size * reach * loop, colour)
            entries.append(
                Line2D([], [], color=colour, label=f"plane at {np.degrees(turn):.0f} deg")
            )
        span = 0.75 * reach
        axis.plot(*np.outer(along, [-span, span]), color=style.GREY, linewidth=0.8)
        axis.quiver(
            0,
            0,
            0,
            *(0.6 * reach * along),
            color=style.RED,
            linewidth=2.2,
            arrow_length_ratio=0.18,
        )
        axis.plot([0], [0], [0], "o", color=style.BLACK, markersize=4)
        entries.append(Line2D([], [], color=style.RED, linewidth=2.2, label="direction of p"))
        _equal_box(axis, reach)
        for letter, q in zip("xyz", field.coordinates, strict=True):
            axis.set(**{f"{letter}label": style.axis_label(q.name, q.unit)})
        point = plane_by_plane(field, 2).points[0]
        name = critical_point_name(point)
        validity = f" ({point.validity})" if point.validity else ""
        axis.set_title(
            f"{_title(field)}\neach plane through p: {name}{validity}".replace("lam", "λ")
        )
        figure.legend(handles=entries, loc="outside lower center", ncols=3)
    return figure


def _line_in_space(axis: Axes3D, points: Array, colour: str) -> None:
    axis.plot(*points.T, color=colour, linewidth=0.9)
    middle = len(points) // 2
    step = points[middle + 6] - points[middle - 6]
    axis.quiver(
        *points[middle], *step, color=colour, linewidth=0.9, arrow_length_ratio=1.0, pivot="middle"
    )


def _equal_box(axis: Axes3D, reach: float) -> None:
    for set_limits in (axis.set_xlim, axis.set_ylim, axis.set_zlim):
        set_limits(-0.8 * reach, 0.8 * reach)
    axis.set_box_aspect((1, 1, 1))
    for one in (axis.xaxis, axis.yaxis, axis.zaxis):
        one.set_major_locator(MaxNLocator(5))
