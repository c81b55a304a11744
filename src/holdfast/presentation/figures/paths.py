"""Paths in the plane, with the scene: wall, target, field of view, goals.

The limits of a plot are not stretched by a few paths that lead far away.
"""

from __future__ import annotations

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

from holdfast.analysis.simulation.result import Result
from holdfast.arguments import checked
from holdfast.errors import OutputError, check_name
from holdfast.execution.arrays import Array
from holdfast.execution.simulation.settings import Outcome
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.region import Cone, Footprint, Segment
from holdfast.maths.expressions.numeric import Values, evaluated, parameter_values
from holdfast.presentation.figures import style
from holdfast.presentation.figures.style import draw_fixed, seen_from

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

    plane: the two states to draw. highlight: how many paths are coloured by mode. cones: how many
    fields of view are drawn. cone_run: along the path of which run.

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
    bold = list(range(min(highlight, runs)))
    with style.look():
        both = runs > len(bold)
        units = data["state_unit"].values[columns]
        one = bool(units[0] == units[1])
        frame = frame_of(xy[:_SHOWN_RUNS], target_ends(result), equal=one)
        across, up = frame.size
        width = style.WIDTH / 2 if both else style.WIDTH * 0.65
        height = min(max(0.85 * width * up / across, 1.8), 4.4) + 1.1
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
        for axis in panels:
            draw_fixed(axis, result.scene, result.parameters)
        if both:
            _draw_ensemble(panels[0], data, xy, frame.beyond)
        _draw_highlights(panels[-1], result, xy, bold)
        if cones > 0 and cone_run < runs:
            _draw_views(panels[-1], result, xy[cone_run], cone_run, names, cones)
        for axis in panels:
            if frame.equal:
                axis.set_aspect("equal")
            axis.set_xlim(frame.x)
            axis.set_ylim(frame.y)
            axis.set_xlabel(style.axis_label(plane[0], str(units[0])))
        entries: dict[str, Artist] = {}
        for axis in panels:
            entries |= {str(h.get_label()): h for h in axis.get_legend_handles_labels()[0]}
        figure.legend(
            handles=list(entries.values()),
            loc="outside lower center",
            ncols=min(6, len(entries)),
            handlelength=1.6,
            columnspacing=1.4,
        )
        panels[0].set_ylabel(style.axis_label(plane[1], str(units[1])))
    return figure


def target_ends(result: Result) -> Array:
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
        colour = style.OUTCOMES[outcome]
        many = outcome in (Outcome.REACHED, Outcome.STAYED)
        axis.add_collection(
            LineCollection(
                [_thinned(xy[i]) for i in members],
                colors=colour,
                linewidths=0.5 if many else 1.0,
                alpha=0.55 if many else 1.0,
            )
        )
        starts = xy[members, 0]
        axis.plot(starts[:, 0], starts[:, 1], ".", color=colour, markersize=2.5)
        axis.plot([], [], color=colour, label=f"{outcome.label} ({count})")
    left = [i for i in np.flatnonzero(outcomes == Outcome.LEFT) if i < shown]
    if left:
        times = data["time"].values
        at = [np.searchsorted(times, data["exit_time"].values[i]) for i in left]
        points = np.array([xy[i, min(k, len(times) - 1)] for i, k in zip(left, at, strict=True)])
        axis.plot(
            points[:, 0],
            points[:, 1],
            "x",
            color=style.BLACK,
            markersize=4,
            zorder=5,
            label="left here",
        )
    title = f"{len(xy)} starts, by outcome"
    if shown < len(xy):
        title += f" ({shown} drawn)"
    if beyond:
        title += f"\n{beyond} leave{'s' if beyond == 1 else ''} the frame"
    axis.set_title(title)


def _draw_highlights(axis: Axes, result: Result, xy: Array, runs: list[int]) -> None:
    data = result.arrays
    meanings = str(data["mode"].attrs["flag_meanings"]).split()
    modes = data["mode"].values[runs]
    for mode in np.unique(modes[modes >= 0]):
        axis.plot(
            [],
            [],
            color=_mode_colour(int(mode)),
            linewidth=1.6,
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
                    color=_mode_colour(int(mode[a])),
                    linewidth=1.6,
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
    axis.set_title(f"first {len(runs)} starts, by mode" if len(runs) > 1 else "path, by mode")


def _mode_colour(mode: int) -> str:
    return style.MODES[mode % len(style.MODES)]


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
        moved = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
        instants = np.searchsorted(moved, np.linspace(0.0, 0.999 * moved[-1], count))
        for number, k in enumerate(np.unique(instants)):
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


def _outline(view: Cone | Footprint, values: Values) -> Patch | None:
    """The visible area there, or None if the scene has no such shape."""
    x, y, heading = evaluated((*view.apex, view.heading), values)
    if isinstance(view, Cone):
        half, reach = evaluated((view.half_angle, view.range), values)
        if not (np.isfinite([x, y, heading, half]).all() and 0 < reach < np.inf):
            return None
        return Wedge((x, y), reach, np.degrees(heading - half), np.degrees(heading + half))
    corners = np.array([evaluated(corner, values) for corner in view.corners])
    return Polygon(seen_from(x, y, heading, corners))
