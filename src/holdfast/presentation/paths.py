"""The paths in the plane, with what stands in it: wall, target, field of view, goals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import sympy as sp
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle as CirclePatch
from matplotlib.patches import Polygon

from holdfast.analysis.result import Result
from holdfast.execution.closed_loop import Outcome
from holdfast.maths.quantity import symbol
from holdfast.maths.scene import Circle, Cone, Segment
from holdfast.presentation import style

Array = npt.NDArray[np.float64]

_OUTCOME_COLOURS = {
    Outcome.REACHED: style.GREEN,
    Outcome.STAYED: style.SKY,
    Outcome.LEFT: style.RED,
    Outcome.DIVERGED: style.BLACK,
}
_MAX_POINTS = 160
_SHOWN_RUNS = 300


def paths_figure(
    result: Result, plane: tuple[str, str] = ("x", "y"), highlight: int = 3, cones: int = 4
) -> Figure:
    """All paths coloured by outcome, and the first `highlight` of them coloured by mode.

    `cones` fields of view are drawn along each highlighted path.
    """
    data = result.dataset
    names = [str(n) for n in data["state_name"].values]
    columns = [names.index(n) for n in plane]
    states = data["state"].values
    xy = states[:, :, columns]
    runs = len(states)
    bold = list(range(min(highlight, runs)))
    with style.look():
        both = runs > len(bold)
        figure, axes = plt.subplots(
            1, 2 if both else 1, figsize=(style.WIDTH, 4.3), layout="constrained",
            sharex=True, sharey=True, squeeze=False,
        )  # fmt: skip
        panels = list(axes[0])
        limits = _limits(xy[:_SHOWN_RUNS])
        for axis in panels:
            _draw_fixed(axis, result, limits)
        if both:
            _draw_ensemble(panels[0], xy, data["outcome"].values)
        _draw_highlights(panels[-1], result, xy, bold, names, cones)
        units = data["state_unit"].values
        for axis in panels:
            axis.set_aspect("equal")
            axis.set_xlim(limits[0])
            axis.set_ylim(limits[1])
            axis.set_xlabel(f"{style.label(plane[0])} [{units[columns[0]]}]")
        panels[0].set_ylabel(f"{style.label(plane[1])} [{units[columns[1]]}]")
    return figure


def _limits(xy: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    points = xy[np.isfinite(xy).all(axis=2)]
    low, high = points.min(axis=0), points.max(axis=0)
    pad = 0.06 * max(float((high - low).max()), 1e-9)
    return (
        (float(low[0] - pad), float(high[0] + pad)),
        (float(low[1] - pad), float(high[1] + pad)),
    )


def _thinned(path: Array) -> Array:
    """At most `_MAX_POINTS` points, evenly spaced along the path."""
    path = path[np.isfinite(path).all(axis=1)]
    if len(path) <= _MAX_POINTS:
        return path
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    if along[-1] == 0.0:
        return path[:1]
    wanted = np.searchsorted(along, np.linspace(0.0, along[-1], _MAX_POINTS))
    picked: Array = path[np.unique(np.minimum(wanted, len(path) - 1))]
    return picked


def _draw_ensemble(axis: Axes, xy: Array, outcomes: npt.NDArray[np.int8]) -> None:
    shown = min(len(xy), _SHOWN_RUNS)
    handles = []
    # the rarest outcome last, on top
    for outcome in sorted(Outcome, key=lambda o: -int((outcomes == o).sum())):
        members = np.flatnonzero(outcomes == outcome)
        if not members.size:
            continue
        members = members[members < shown]
        colour = _OUTCOME_COLOURS[outcome]
        many = outcome in (Outcome.REACHED, Outcome.STAYED)
        axis.add_collection(
            LineCollection(
                [_thinned(xy[i]) for i in members], colors=colour,
                linewidths=0.5 if many else 1.0, alpha=0.55 if many else 1.0,
            )
        )  # fmt: skip
        starts = xy[members, 0]
        axis.plot(starts[:, 0], starts[:, 1], ".", color=colour, markersize=2.5)
        count = int((outcomes == outcome).sum())
        handles.append(Line2D([], [], color=colour, label=f"{outcome.label} ({count})"))
    title = f"{len(xy)} starts, by outcome"
    if shown < len(xy):
        title += f" ({shown} drawn)"
    axis.set_title(title)
    _legend_below(axis, handles)


def _draw_highlights(
    axis: Axes, result: Result, xy: Array, runs: list[int], names: list[str], cones: int
) -> None:
    data = result.dataset
    modes = str(data["mode"].attrs["flag_meanings"]).split()
    seen: set[int] = set()
    for run in runs:
        mode = data["mode"].values[run]
        changes = np.flatnonzero(np.diff(mode)) + 1
        edges = [0, *changes, len(mode) - 1]
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            if mode[a] < 0:
                continue
            seen.add(int(mode[a]))
            piece = _thinned(xy[run, a : b + 1])
            axis.plot(piece[:, 0], piece[:, 1], color=_mode_colour(int(mode[a])), linewidth=1.6,
                      zorder=3)  # fmt: skip
        axis.plot(*xy[run, 0], "o", color=style.BLACK, markersize=3.5, zorder=4)
    handles = [
        Line2D([], [], color=_mode_colour(m), linewidth=1.6, label=modes[m].replace("_", " "))
        for m in sorted(seen)
    ]
    handles.append(Line2D([], [], color=style.BLACK, marker="o", markersize=3.5, linestyle="",
                          label="start"))  # fmt: skip
    for shape in result.scene:
        if isinstance(shape, Cone) and cones > 0:
            for run in runs:
                _draw_cones(axis, shape, result, run, names, cones)
            handles.append(
                Line2D([], [], color=style.ORANGE, linewidth=5, alpha=0.3, label=shape.role)
            )
    for shape in result.scene:
        if not isinstance(shape, Cone):
            handles.append(_fixed_handle(shape))
    axis.set_title("reference starts, by mode" if len(runs) > 1 else "path, by mode")
    _legend_below(axis, handles)


def _mode_colour(mode: int) -> str:
    return style.MODES[mode % len(style.MODES)]


def _legend_below(axis: Axes, handles: list[Line2D]) -> None:
    axis.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3,
                handlelength=1.6, columnspacing=1.2)  # fmt: skip


def _fixed_style(role: str) -> dict[str, Any]:
    return {
        "target": {"color": style.RED, "linewidth": 4.0, "solid_capstyle": "butt", "zorder": 5},
        "wall": {"color": style.BLACK, "linewidth": 1.5, "zorder": 2},
        "goals": {"color": style.PURPLE, "linewidth": 1.0, "linestyle": "--", "zorder": 2},
    }.get(role, {"color": style.BLACK, "linewidth": 1.2, "zorder": 2})


def _fixed_handle(shape: Segment | Circle) -> Line2D:
    drawn = {k: v for k, v in _fixed_style(shape.role).items() if k != "solid_capstyle"}
    return Line2D([], [], label=shape.role, **drawn)


def _evaluated(expressions: Any, values: Mapping[sp.Symbol, float]) -> list[float]:
    return [float(sp.sympify(e).subs(values)) for e in expressions]


def _draw_fixed(
    axis: Axes, result: Result, limits: tuple[tuple[float, float], tuple[float, float]]
) -> None:
    values = {symbol(k): v for k, v in (result.parameters or {}).items()}
    for shape in result.scene:
        if isinstance(shape, Segment):
            (x0, y0), (x1, y1) = (_evaluated(p, values) for p in (shape.start, shape.end))
            axis.plot([x0, x1], [y0, y1], **_fixed_style(shape.role))
        elif isinstance(shape, Circle):
            x, y, radius = _evaluated((*shape.centre, shape.radius), values)
            drawn = {k: v for k, v in _fixed_style(shape.role).items() if k != "solid_capstyle"}
            axis.add_patch(CirclePatch((x, y), radius, fill=False, **drawn))


def _draw_cones(
    axis: Axes, cone: Cone, result: Result, run: int, names: list[str], count: int
) -> None:
    states = result.dataset["state"].values[run]
    states = states[np.isfinite(states).all(axis=1)]
    moved = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(states[:, :2], axis=0).T))])
    instants = np.searchsorted(moved, np.linspace(0.0, 0.999 * moved[-1], count))
    base = {symbol(k): v for k, v in (result.parameters or {}).items()}
    for k in np.unique(instants):
        values = base | {symbol(n): float(v) for n, v in zip(names, states[k], strict=True)}
        x, y, heading, half, reach = _evaluated(
            (*cone.apex, cone.heading, cone.half_angle, cone.range), values
        )
        if not (np.isfinite(reach) and reach > 0):
            continue
        # the far side is the line across the view at that range, as on a wall
        rays = np.array([heading - half, heading + half])
        corners = [(x + reach * np.cos(a), y + reach * np.sin(a)) for a in rays]
        axis.add_patch(
            Polygon([(x, y), *corners], closed=True, facecolor=style.ORANGE, alpha=0.13,
                    edgecolor=style.ORANGE, linewidth=0.5, zorder=1)
        )  # fmt: skip
        axis.plot(x, y, marker=(3, 0, np.degrees(heading) - 90), color=style.BLACK, markersize=5,
                  linestyle="", zorder=4)  # fmt: skip
