"""Paths in the plane, with the scene: constraints, goal, wall, target, field of view, trailers.

The limits of a plot are not stretched by a few paths that lead far away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon, Wedge

from holdfast.analysis.simulation.files import NamedArrays
from holdfast.analysis.simulation.result import Result
from holdfast.arguments import checked
from holdfast.errors import OutputError, check_name
from holdfast.execution.arrays import Array
from holdfast.execution.simulation.settings import Outcome
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.region import Cone, Footprint, Segment
from holdfast.maths.expressions.numeric import Values, evaluated, parameter_values
from holdfast.maths.nonholonomic.bodies import bodies
from holdfast.presentation.figures import style
from holdfast.presentation.figures.style import draw_fixed, seen_from
from holdfast.presentation.figures.zero_levels import PlaneLevels, draw_lines

FAR = 4.0
"""A path that goes this many times as far as half of them is cut at the frame."""

PAD = 0.06

LONGEST, FLAT = 8.0, 1e-12
"""A frame longer than so many widths has a scale for each axis; its width is at least a part of its
length."""


@dataclass(frozen=True)
class Frame:
    """Limits of both axes. equal: they have one scale. beyond: how many paths leave them."""

    x: tuple[float, float]
    y: tuple[float, float]
    equal: bool
    beyond: int

    @property
    def size(self) -> tuple[float, float]:
        """Width and height."""
        return self.x[1] - self.x[0], self.y[1] - self.y[0]

    def scaled(self, points: Array) -> Array:
        """Points in parts of the size of the plot, both of the shape (points, 2)."""
        size: Array = points / (max(self.size) if self.equal else self.size)
        return size


def frame_of(paths: Array, fixed: Array | None = None, *, equal: bool = True) -> Frame:
    """The frame of paths, shape (runs, times, 2), NaN where a run has ended.

    It has every start and the `fixed` points, shape (n, 2), and the paths that go at most `FAR`
    times as far from the middle of the starts as half of them do. equal: both axes have one unit,
    and one scale unless that would leave a line.
    """
    finite: Any = np.isfinite(paths).all(axis=2)
    starts = paths[:, 0][finite[:, 0]]
    away = np.abs(np.where(finite[..., None], paths - np.median(starts, axis=0), 0.0))
    far = np.hypot(away[..., 0], away[..., 1])[..., None] if equal else away
    reach = far.max(axis=1)
    allowed = np.maximum(FAR * np.median(reach, axis=0), far[:, 0].max(axis=0))
    near = (reach <= allowed).all(axis=1)
    points = np.vstack([paths[near][finite[near]], starts, *([] if fixed is None else [fixed])])
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    if equal:
        size = np.maximum(size, FLAT * size.max())
    equal = equal and bool(size.max() <= LONGEST * size.min())
    middle, half = (low + high) / 2, size / 2 + PAD * (size.max() if equal else size)
    low, high = middle - half, middle + half
    outside = finite & ((paths < low) | (paths > high)).any(axis=2)
    x, y = zip(low.tolist(), high.tolist(), strict=True)
    return Frame(x, y, equal, int(outside.any(axis=1).sum()))


BODY: dict[str, Any] = {
    "facecolor": style.GREY, "alpha": 0.35, "edgecolor": style.BLACK, "linewidth": 0.8, "zorder": 2,
}  # fmt: skip

STANDS = {**BODY, "alpha": 0.7, "zorder": 1.5}
WAY: dict[str, Any] = {"color": style.GREY, "linestyle": ":", "linewidth": 0.9, "zorder": 1}

_MAX_POINTS = 160
_MAX_BOLD = 3000
_SHOWN_RUNS = 300


@checked
def paths_figure(
    result: Result,
    plane: tuple[str, str] = ("x", "y"),
    highlight: int = 3,
    cones: int = 4,
    cone_run: int = 0,
) -> Figure:
    """All paths coloured by outcome, and the first of them coloured by mode.

    Inequalities of the two states of the plane have their line, with the forbidden side hatched;
    others are named under the figure. plane: the two states to draw. highlight: how many paths are
    coloured by mode. cones: how many fields of view, or vehicles with their trailers, are drawn.
    cone_run: along the path of which run, which is coloured by mode too.

    Raises `OutputError` for an unknown run or state.

    >>> figure = hf.paths_figure(result, plane=("x", "v"))
    >>> figure.savefig("paths.png")
    """
    data = result.arrays
    names = [str(n) for n in data["state_name"].values]
    for name in plane:
        check_name(name, names, OutputError, f"'{name}' is not a state")
    columns = [names.index(n) for n in plane]
    states = data["state"].values
    xy = states[:, :, columns]
    runs = len(states)
    style.check_run(cone_run, runs)
    bold = sorted({*range(min(highlight, runs)), cone_run})
    framing = sorted({*range(min(runs, _SHOWN_RUNS)), cone_run})
    with style.look():
        both = runs > len(bold)
        units = data["state_unit"].values[columns]
        one = bool(units[0] == units[1])
        levels = PlaneLevels.of(result, plane)
        placed = _bodies_along(result, plane, cone_run, cones)
        moving = _obstacles_along(result, plane, cone_run, max(cones, 1))
        beside = [*placed, *(rims[0][1] for _, _, rims in moving if _stands(rims))]
        frame = framed(xy[framing], result, levels, beside, equal=one)
        window = (*frame.x, *frame.y)
        lines = levels.lines(window)
        across, up = frame.size
        width = style.WIDTH / 2 if both else style.WIDTH * 0.65
        least = 1.2 if frame.equal else 1.8  # of equal scales, a low frame leaves no gaps
        height = min(max(0.85 * width * up / across, least), 4.4) + 1.1
        figure, axes = plt.subplots(
            1,
            2 if both else 1,
            figsize=(2 * width if both else width, height),
            layout="constrained",
            sharex=True,
            sharey=True,
            squeeze=False,
        )
        panels = list(axes[0])
        legend: list[Artist] = []
        for axis in panels:
            legend = draw_lines(axis, lines, window)
            draw_fixed(axis, result.scene, result.parameters)
        if both:
            _draw_ensemble(panels[0], data, xy, frame.beyond)
        _draw_highlights(panels[-1], result, xy, bold)
        if cones > 0:
            _draw_views(panels[-1], result, xy[cone_run], cone_run, names, cones)
        for axis in panels:
            _draw_ways(axis, data, plane)
        _draw_moving(panels[-1], moving, xy[cone_run], data["time"].values)
        for outline in placed:
            panels[-1].add_patch(Polygon(outline, label="vehicle with trailers", **BODY))
        for axis in panels:
            if frame.equal:
                axis.set_aspect("equal")
            axis.set_xlim(frame.x)
            axis.set_ylim(frame.y)
            axis.set_xlabel(style.axis_label(plane[0], str(units[0])))
        entries = [h for axis in panels for h in axis.get_legend_handles_labels()[0]]
        style.add_legend(figure, [*entries, *legend], levels.note(lines))
        panels[0].set_ylabel(style.axis_label(plane[1], str(units[1])))
    return figure


def framed(
    paths: Array,
    result: Result,
    levels: PlaneLevels,
    beside: Sequence[Array] = (),
    *,
    equal: bool = True,
) -> Frame:
    """The frame of paths with the targets and what is beside the paths, arrays of the shape
    (n, 2), and with the obstacles and the goal in this frame or near it."""
    fixed = np.vstack([_target_ends(result), *beside])
    first = frame_of(paths, fixed, equal=equal)
    near = levels.corners((*first.x, *first.y), equal=equal)
    return frame_of(paths, np.vstack([fixed, near]), equal=equal)


def _target_ends(result: Result) -> Array:
    """The ends of the targets of the scene, shape (n, 2)."""
    targets = [x for x in result.scene if isinstance(x, Segment) and x.role == "target"]
    values = parameter_values(result.parameters)
    ends = [evaluated(end, values) for t in targets for end in (t.start, t.end)]
    return np.array(ends, dtype=float).reshape(-1, 2)


def _thinned(path: Array, most: int = _MAX_POINTS) -> Array:
    """At most `count` points, evenly spaced along the path."""
    path = path[np.isfinite(path).all(axis=1)]
    if len(path) <= most:
        return path
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    if along[-1] == 0.0:
        return path[:1]
    wanted = np.searchsorted(along, np.linspace(0.0, along[-1], most))
    picked: Array = path[np.unique(np.minimum(wanted, len(path) - 1))]
    return picked


def _draw_ensemble(axis: Axes, data: Any, xy: Array, beyond: int) -> None:
    outcomes = data["outcome"].values
    shown = min(len(xy), _SHOWN_RUNS)
    # the rarest outcome last, on top
    for outcome in sorted(Outcome, key=lambda o: -int((outcomes == o).sum())):
        members = np.flatnonzero(outcomes == outcome)
        count = members.size
        if not count:
            continue
        members = members[members < shown]
        colour, dashes = style.OUTCOMES[outcome], style.dashed(style.OUTCOME_DASHES[outcome])
        many = outcome in (Outcome.REACHED, Outcome.STAYED)
        axis.add_collection(
            LineCollection(
                [_thinned(xy[i]) for i in members],
                colors=colour,
                linestyles=[dashes],
                linewidths=0.5 if many else 1.0,
                alpha=0.55 if many else 1.0,
            )
        )
        starts = xy[members, 0]
        axis.plot(starts[:, 0], starts[:, 1], ".", color=colour, markersize=2.5)
        axis.plot([], [], color=colour, linestyle=dashes, label=f"{outcome.label} ({count})")
    _mark_exits(axis, data, xy, range(shown))
    title = f"{len(xy)} starts, by outcome"
    if shown < len(xy):
        title += f" ({shown} drawn)"
    if "obstacle_outline" in data:
        names = data["constraint_name"].values.tolist()
        least = -data["worst_constraint"].values[:, names.index("moving_obstacles")].max()
        title += f"\nat least {least:.3g} m from an obstacle"
    if beyond:
        title += f"\n{beyond} leave{'s' if beyond == 1 else ''} the frame"
    axis.set_title(title)


def _mark_exits(axis: Axes, data: Any, xy: Array, runs: Sequence[int]) -> None:
    """A cross where each of these runs left the region."""
    outcomes, times = data["outcome"].values, data["time"].values
    left = [i for i in runs if outcomes[i] == Outcome.LEFT]
    if not left:
        return
    at = np.minimum(np.searchsorted(times, data["exit_time"].values[left]), len(times) - 1)
    axis.plot(*xy[left, at].T, "x", color=style.BLACK, markersize=4, zorder=5, label="left here")


def _draw_highlights(axis: Axes, result: Result, xy: Array, runs: list[int]) -> None:
    data = result.arrays
    meanings = str(data["mode"].attrs["flag_meanings"]).split()
    modes = data["mode"].values[runs]
    for mode in np.unique(modes[modes >= 0]):
        axis.plot(
            [],
            [],
            **_mode_look(int(mode)),
            label=meanings[mode].replace("_", " "),
        )
    for run, mode in zip(runs, modes, strict=True):
        edges = [0, *(np.flatnonzero(np.diff(mode)) + 1), len(mode) - 1]
        for a, b in pairwise(edges):
            if mode[a] >= 0:
                piece = _thinned(xy[run, a : b + 1], _MAX_BOLD)
                axis.plot(
                    piece[:, 0],
                    piece[:, 1],
                    **_mode_look(int(mode[a])),
                    zorder=3,
                )
    axis.plot(
        xy[runs, 0, 0],
        xy[runs, 0, 1],
        "o",
        color=style.BLACK,
        markersize=3.5,
        zorder=4,
        label="start",
    )
    _mark_exits(axis, data, xy, runs)
    if len(runs) == 1:
        outcome = Outcome(int(data["outcome"].values[runs[0]]))
        axis.set_title(f"path, by mode: {outcome.label}")
        return
    for run in runs:
        axis.annotate(
            str(run), xy[run, 0], xytext=(-3, 2), textcoords="offset points", ha="right",
            fontsize=7, zorder=6,
        )  # fmt: skip
    first, last = runs[0], runs[-1]
    some = f"{first} to {last}" if last - first < len(runs) else f"{first} to {runs[-2]} and {last}"
    axis.set_title(f"runs {some if len(runs) > 2 else f'{first} and {last}'}, by mode")


def _mode_look(mode: int) -> dict[str, Any]:
    colour = style.MODES[mode % len(style.MODES)]
    return {"color": colour, "linestyle": style.dashes(mode), "linewidth": 1.6}


def _draw_views(
    axis: Axes, result: Result, path: Array, run: int, names: list[str], count: int
) -> None:
    """Fields of view at instants evenly spaced along the path of one run."""
    states = result.arrays["state"].values[run]
    good = np.isfinite(states).all(axis=1)
    states, path = states[good], path[good]
    base = parameter_values(result.parameters)
    if not len(states):
        return
    for view in (shape for shape in result.scene if isinstance(shape, Cone | Footprint)):
        for number, k in enumerate(_instants(path, count)):
            values = base | {symbol(n): float(v) for n, v in zip(names, states[k], strict=True)}
            seen = _outline(view, values)
            if seen is None:
                continue
            seen.set(
                facecolor=style.ORANGE, alpha=0.16, edgecolor=style.BLACK, linewidth=0.4, zorder=1
            )
            axis.add_patch(seen)
            x, y, heading = evaluated((*view.apex, view.heading), values)
            axis.plot(
                x,
                y,
                marker=(3, 0, np.degrees(heading) - 90),
                color=style.BLACK,
                markersize=5,
                linestyle="",
                zorder=4,
                label="vehicle" if number == 0 else None,
            )
        axis.plot([], [], color=style.ORANGE, linewidth=5, alpha=0.35, label=view.role)


def _instants(path: Array, count: int) -> Array:
    """The numbers of points evenly spaced along a path of the shape (points, 2)."""
    moved = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    return np.unique(np.searchsorted(moved, np.linspace(0.0, 0.999 * moved[-1], count)))


def _bodies_along(result: Result, plane: Sequence[str], run: int, count: int) -> list[Array]:
    """The outlines of a vehicle with trailers at instants evenly spaced along the path of a run,
    each of the shape (corners, 2); none for other vehicles."""
    parts = bodies(result.system, plane) if result.system is not None and count > 0 else ()
    names = [str(n) for n in result.arrays["state_name"].values]
    states = result.arrays["state"].values[run]
    states = states[np.isfinite(states).all(axis=1)]
    if not parts or not len(states):
        return []
    base, outlines = parameter_values(result.parameters), []
    for k in _instants(states[:, [names.index(n) for n in plane]], count):
        values = base | {symbol(n): float(v) for n, v in zip(names, states[k], strict=True)}
        for part in parts:
            outlines.append(_corners(part, values))
    return outlines


Rims = list[tuple[float, Array]]
"""Times [s] and the rim of an obstacle at each, shape (points, 2)."""


def _obstacles_along(
    result: Result, plane: tuple[str, str], run: int, count: int
) -> list[tuple[str, int, Rims]]:
    """Obstacles that move, each with its name, the number of its first record and its rims, at
    times evenly spaced over the run; none in another plane than that of the position."""
    data = result.arrays
    if "obstacle_outline" not in data or not _is_position(data, plane):
        return []
    from holdfast.planning.encounters import outlines_at  # with polygons

    states = data["state"].values[run]
    last = int(np.flatnonzero(np.isfinite(states).all(axis=1))[-1])
    each: dict[tuple[str, int], Rims] = {}
    for k in np.unique(np.linspace(0, last, count + 1).round().astype(int)).tolist():
        for row, (name, rim) in enumerate(outlines_at(data, k)):
            each.setdefault((name, row), []).append((float(data["time"].values[k]), rim))
    return [(name, row, rims) for (name, row), rims in each.items()]


def _is_position(data: NamedArrays, plane: tuple[str, str]) -> bool:
    """Whether obstacles are in this plane."""
    return ", ".join(plane) == str(data["obstacle_way"].attrs["names"])


def _draw_ways(axis: Axes, data: NamedArrays, plane: tuple[str, str]) -> None:
    """The ways of the middles of obstacles that move, and those that stand, filled."""
    if "obstacle_outline" not in data or not _is_position(data, plane):
        return
    from holdfast.planning.encounters import outlines_at

    middles = np.nanmean(data["obstacle_outline"].values, axis=1)
    stands = [np.ptp(way, axis=0).max() == 0.0 for way in data["obstacle_way"].values]
    for still, (_, rim) in zip(stands, outlines_at(data, 0), strict=True):
        if still:
            axis.add_patch(Polygon(rim, **STANDS))
    if any(stands):
        axis.add_patch(Polygon(np.zeros((3, 2)) * np.nan, label="obstacle", **STANDS))
    for still, middle, way in zip(stands, middles, data["obstacle_way"].values, strict=True):
        if not still:
            axis.plot(*(middle + way).T, **WAY)
    if not all(stands):
        axis.plot([], [], label="way of an obstacle", **WAY)


def _stands(rims: Rims) -> bool:
    return bool(np.array_equal(rims[0][1], rims[-1][1]))


def _draw_moving(
    axis: Axes, moving: Sequence[tuple[str, int, Rims]], path: Array, times: Array
) -> None:
    """The rims of moving obstacles, darker later; along the path where the vehicle was then."""
    drawn = [rims for _, _, rims in moving if not _stands(rims)]
    for rims in drawn:
        for k, (_, rim) in enumerate(rims):
            shade = 0.08 + 0.3 * k / max(len(rims) - 1, 1)
            axis.add_patch(Polygon(rim, **{**BODY, "alpha": shade, "zorder": 1.5}))
    if not drawn:
        return
    axis.add_patch(Polygon(np.zeros((3, 2)) * np.nan, label="obstacle, darker later", **BODY))
    for t, _ in drawn[0][1:]:
        x, y = path[int(np.searchsorted(times, t))]
        axis.plot(x, y, "o", color=style.BLACK, markersize=2.5, zorder=4)
        axis.annotate(
            f"{t:.0f} s", (x, y), xytext=(3, 3), textcoords="offset points", fontsize=6.5, zorder=6
        )


def _outline(view: Cone | Footprint, values: Values) -> Patch | None:
    """The visible area there, or None if the scene has no such shape."""
    x, y, heading = evaluated((*view.apex, view.heading), values)
    if isinstance(view, Cone):
        half, reach = evaluated((view.half_angle, view.range), values)
        if not (np.isfinite([x, y, heading, half]).all() and 0 < reach < np.inf):
            return None
        return Wedge((x, y), reach, np.degrees(heading - half), np.degrees(heading + half))
    return Polygon(_corners(view, values))


def _corners(shape: Footprint, values: Values) -> Array:
    x, y, heading = evaluated((*shape.apex, shape.heading), values)
    corners = np.array([evaluated(corner, values) for corner in shape.corners])
    placed: Array = seen_from(x, y, heading, corners)
    return placed
