"""The inequalities of a region and of a goal in the plane of a figure.

An inequality of the two states of the plane alone has a zero level there: a line, with what it
forbids on one side. One that depends on other states too has another line at each of their values;
it is named and not drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from holdfast.analysis.simulation.result import Result
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.region import CONSTRAINT, GOAL, Shape, ZeroLevel
from holdfast.maths.expressions.numeric import parameter_values
from holdfast.maths.expressions.traversal import at_numbers
from holdfast.presentation.figures import style

NODES, CLOSE = 181, 91
"""Along each side of the window of a figure, and of one around a single set."""

ZOOMS = 6
"""How often a window is narrowed about the least value, to find what is smaller than its cells."""

AROUND = 0.5
"""Of its size on every side: how far beyond the frame a set may go to be shown whole."""

SMALL = 0.03
"""Of the frame's size: a goal that is smaller than this is hard to see."""

MOST_NAMED = 6
"""Lines that have a name each in the legend."""

FORBIDDEN, HATCH, ALLOWED = "#f1efec", "/////", "#dff0e6"
HATCHED = "#bdb6ae"

Window = tuple[float, float, float, float]
"""Limits: x from, x to, y from, y to."""


@dataclass(frozen=True)
class Line:
    """A zero level in the plane, by the values around it: above 0 on the forbidden side, or outside
    the goal. place: of the inequality in its region. x: shape (columns,). y: shape (rows,). values:
    shape (rows, columns)."""

    role: str
    name: str
    place: int
    x: Array
    y: Array
    values: Array

    @property
    def pieces(self) -> list[Array]:
        """The parts of the line, each of the shape (points, 2)."""
        axis = Figure().subplots()
        parts = axis.contour(self.x, self.y, self.values, levels=[0.0]).allsegs[0]
        return [np.asarray(part, dtype=float) for part in parts if len(part) > 1]


@dataclass(frozen=True)
class PlaneLevels:
    """The inequalities that have a line in the plane, and those that depend on more.

    names: of the constraints, and then of the goal, if it has inequalities here. values: at so many
    nodes along each side of a window, row after row, one column for each name. hidden: the others,
    with the role of each. places: of the constraints in their region. unread: those of a result
    without a scene, as one of a file is.
    """

    names: tuple[str, ...]
    constraints: int
    values: Callable[[Window, int], Array]
    hidden: tuple[tuple[str, str], ...]
    places: tuple[int, ...] = ()
    unread: tuple[str, ...] = ()

    @classmethod
    def of(cls, result: Result, plane: Sequence[str]) -> PlaneLevels:
        """Those of a result; what varies from run to run has no one line either."""
        data = result.arrays
        varied = {str(n) for n in data["varied_name"].values} if "varied_name" in data else set()
        values = {n: v for n, v in (result.parameters or {}).items() if n not in varied}
        among = cls.among(result.scene, plane, values)
        if among.names or among.hidden:
            return among
        unread = [str(n) for n in data["constraint_name"].values]
        return replace(among, unread=(*unread, *(["the goal"] if data.attrs.get("goal") else [])))

    @classmethod
    def among(
        cls, scene: Iterable[Shape], plane: Sequence[str], fixed_values: Mapping[str, float] | None
    ) -> PlaneLevels:
        """Those of a scene, where the parameters and states of these names have these values."""
        numbers = parameter_values(fixed_values)
        at = [symbol(name) for name in plane]
        shown: dict[str, list[ZeroLevel]] = {CONSTRAINT: [], GOAL: []}
        hidden = []
        levels = [x for x in scene if isinstance(x, ZeroLevel)]
        for level in levels:
            free = level.expression.free_symbols
            if free <= {*at, *numbers} and free & {*at}:
                shown[level.role].append(level)
            else:
                hidden.append((level.role, level.name))
        chosen = [*shown[CONSTRAINT], *shown[GOAL]]
        first = len(shown[CONSTRAINT])
        expressions = [at_numbers(level.expression, numbers) for level in chosen]
        evaluator = Evaluator(expressions, at, ()) if chosen else None

        @lru_cache(maxsize=2)  # all lines of a figure are looked for in the same window
        def values(window: Window, nodes: int) -> Array:
            x, y = np.linspace(*window[:2], nodes), np.linspace(*window[2:], nodes)
            points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            if evaluator is None:
                return np.empty((len(points), 0))
            all_values = evaluator.values(points)
            columns = [all_values[:, :first]]
            if first < len(chosen):  # a goal is met where all of its inequalities are
                columns.append(all_values[:, first:].max(axis=1, keepdims=True))
            return np.hstack(columns)

        names = [level.name for level in shown[CONSTRAINT]]
        shown_names = (*names, *([GOAL] if shown[GOAL] else []))
        every = [level.name for level in levels if level.role == CONSTRAINT]
        places = tuple(every.index(name) for name in names)
        return cls(shown_names, len(names), values, tuple(hidden), places)

    def role(self, k: int) -> str:
        return CONSTRAINT if k < self.constraints else GOAL

    def _on(self, k: int, window: Window, nodes: int) -> tuple[Array, Array, Array]:
        x, y = np.linspace(*window[:2], nodes), np.linspace(*window[2:], nodes)
        return x, y, self.values(window, nodes)[:, k].reshape(nodes, nodes)

    def _bounded(self, k: int, window: Window) -> Window | None:
        """The box around an obstacle, or around the goal; None where it goes beyond the window or
        is not in it."""
        sign = -1.0 if self.role(k) == CONSTRAINT else 1.0
        looked: Window = window
        box: Window | None = None
        for _ in range(ZOOMS):
            nodes = NODES if looked == window else CLOSE
            x, y, values = self._on(k, looked, nodes)
            inside = sign * values <= 0
            across, up = x[1] - x[0], y[1] - y[0]
            if inside.any():
                rows, columns = (np.flatnonzero(inside.any(axis=a)) for a in (1, 0))
                ends = {int(v) for v in (rows[0], rows[-1], columns[0], columns[-1])}
                if looked == window and {0, nodes - 1} & ends:
                    return None
                (x0, x1), (y0, y1) = x[columns[[0, -1]]], y[rows[[0, -1]]]
                if x1 < window[0] or x0 > window[1] or y1 < window[2] or y0 > window[3]:
                    return None  # narrowing about a value at the edge has led out of the window
                left, right, low, high = x0 - across, x1 + across, y0 - up, y1 + up
                box = looked = float(left), float(right), float(low), float(high)
                if max(len(rows), len(columns)) > nodes / 4:
                    break
            elif np.isfinite(values).any():
                row, column = np.unravel_index(np.nanargmin(sign * values), values.shape)
                at = float(x[column]), float(y[row])
                looked = (at[0] - 2 * across, at[0] + 2 * across, at[1] - 2 * up, at[1] + 2 * up)
            else:
                break
        return box

    def corners(self, window: Window, *, equal: bool) -> Array:
        """Of the boxes around the obstacles and the goal in and beside a window, shape (n, 2).

        equal: both states have one unit, so that the long side says what is beside the short one.
        """
        (x0, x1), (y0, y1) = window[:2], window[2:]
        sizes = x1 - x0, y1 - y0
        least = 0.5 * max(sizes) if equal else 0.0
        wide, high = (0.5 * max((1 + 2 * AROUND) * size, least) for size in sizes)
        x, y = (x0 + x1) / 2, (y0 + y1) / 2
        around = (x - wide, x + wide, y - high, y + high)
        boxes = [self._bounded(k, around) for k in range(len(self.names))]
        ends = [corner for b in boxes if b is not None for corner in ((b[0], b[2]), (b[1], b[3]))]
        return np.array(ends, dtype=float).reshape(-1, 2)

    def lines(self, window: Window) -> list[Line]:
        """The lines that pass through a window; a small set has nodes of its own."""
        lines = []
        for k, name in enumerate(self.names):
            box = self._bounded(k, window)
            if box is not None:
                wide, high = 0.2 * (box[1] - box[0]), 0.2 * (box[3] - box[2])
                box = (box[0] - wide, box[1] + wide, box[2] - high, box[3] + high)
            x, y, values = self._on(k, *((window, NODES) if box is None else (box, CLOSE)))
            if (values > 0).any() and (values <= 0).any():
                place = self.places[k] if k < self.constraints else 0
                lines.append(Line(self.role(k), name, place, x, y, values))
        return lines

    def note(self, lines: Sequence[Line]) -> str:
        """What is not drawn, and why; empty where all is."""
        drawn = [(line.role, line.name) for line in lines]
        beyond = [n for k, n in enumerate(self.names) if (self.role(k), n) not in drawn]
        of_goal = [n for role, n in self.hidden if role == GOAL]
        others = [n for role, n in self.hidden if role == CONSTRAINT]
        others += [f"{n} of the goal" for n in of_goal]
        depend = "depends" if len(others) == 1 else "depend"
        said = [
            f"{_listed(names)} ({why})"
            for why, names in (
                ("beyond the frame", beyond), (f"{depend} on other states", others),
                ("a result file has no shapes", self.unread),
            )
            if names
        ]  # fmt: skip
        return f"not drawn: {'; '.join(said)}" if said else ""


def _listed(names: Sequence[str], most: int = 4) -> str:
    text = ", ".join(n.replace("_", " ") for n in names[:most])
    return text if len(names) <= most else f"{text} and {len(names) - most} more"


def line_look(place: int) -> dict[str, Any]:
    """Colour and dashes of the line of a constraint, by its place in the region."""
    return {"color": style.LIMIT, "linestyle": style.dashes(place), "linewidth": 1.0}


GOAL_LOOK: dict[str, Any] = {"color": style.GREEN, "linestyle": "--", "linewidth": 1.2}


MARK: dict[str, Any] = {"markersize": 9, "markeredgewidth": 1.8}


def draw_lines(axis: Axes, lines: Sequence[Line], window: Window) -> list[Artist]:
    """Draw what is forbidden, the goal, and their edges; the entries of the legend.

    window: of the figure, in which a small goal has a mark at its place.
    """
    constraints = [line for line in lines if line.role == CONSTRAINT]
    several = len(constraints) > MOST_NAMED
    entries: list[Artist] = []
    goal: Artist = Patch(facecolor=ALLOWED, edgecolor=style.GREEN, linestyle="--", label=GOAL)
    for line in lines:
        above = float(np.nanmax(line.values, initial=0.0, where=np.isfinite(line.values))) + 1.0
        below = float(np.nanmin(line.values, initial=0.0, where=np.isfinite(line.values))) - 1.0
        values = np.clip(line.values, below, above)
        if line.role == GOAL:
            axis.contourf(line.x, line.y, values, [below, 0.0], colors=[ALLOWED], zorder=0.3)
            look = GOAL_LOOK
            size = max(
                np.ptp(line.x) / (window[1] - window[0]), np.ptp(line.y) / (window[3] - window[2])
            )
            if size < SMALL:
                middle = [np.mean(line.x)], [np.mean(line.y)]
                (goal,) = axis.plot(*middle, "+", color=style.GREEN, zorder=5, **MARK)
                goal.set_label(GOAL)
        else:
            area = axis.contourf(
                line.x,
                line.y,
                values,
                [0.0, above],
                colors=[FORBIDDEN],
                hatches=[HATCH],
                zorder=0.2,
            )
            area.set_edgecolor(HATCHED)
            area.set_linewidth(0.0)
            look = line_look(0 if several else line.place)
        axis.contour(
            line.x, line.y, values, levels=[0.0], colors=[look["color"]],
            linestyles=[look["linestyle"]], linewidths=look["linewidth"], zorder=2.2,
        )  # fmt: skip
        if line.role == CONSTRAINT and not several:
            entries.append(Line2D([], [], label=line.name.replace("_", " "), **look))
    if several:
        label = f"{len(constraints)} constraints"
        entries.append(Line2D([], [], label=label, **line_look(0)))
    if constraints:
        entries.append(
            Patch(
                facecolor=FORBIDDEN,
                edgecolor=HATCHED,
                hatch=HATCH,
                linewidth=0.0,
                label="forbidden",
            )
        )
    if len(constraints) < len(lines):
        entries.append(goal)
    return entries
