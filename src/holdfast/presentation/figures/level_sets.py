"""Level sets in a plane: V as colours, its zero level, and other sets for comparison."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.contour import ContourSet
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from holdfast.analysis.reachability.grid import Axis
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.execution.arrays import AnyArray, Array
from holdfast.presentation.figures import style
from holdfast.presentation.figures.style import BLACK, BLUE, GREEN, PURPLE, RED

DASHES: tuple[tuple[str, Any], ...] = (
    (BLACK, (0, (4, 2))),
    (RED, (0, (1, 1))),
    (PURPLE, (0, (5, 1, 1, 1))),
    (GREEN, (0, (7, 2))),
)
"""Colour and dashes of the sets for comparison, in their order."""

_SHADES = np.concatenate([np.linspace(0.27, 0.5, 128), np.linspace(0.5, 0.9, 128)])
SIGNED = LinearSegmentedColormap.from_list("signed", colormaps["RdBu"](_SHADES))
"""Blue in the set, pale red outside: distinguishable by colour-blind readers."""

MOST = 6
"""The most times drawn."""

FILL = "#bfdcec"  # of the set


def nodes(axis: Axis) -> Array:
    """The nodes of an axis; a periodic one is closed by its first node: shape (nodes,)."""
    return np.append(axis.nodes, axis.high) if axis.ends == "periodic" else axis.nodes


def closed(value: ValueFunction, values: AnyArray) -> Array:
    """An array over the grid of a value function; periodic axes are closed. The shape is (nodes of
    the first axis, nodes of the second, and so on)."""
    table: Array = np.asarray(values, dtype=np.float64)
    for k, axis in enumerate(value.grid.axes):
        if axis.ends == "periodic":
            table = np.concatenate([table, np.take(table, [0], axis=k)], axis=k)
    return table


def mesh(value: ValueFunction, plane: tuple[str, str]) -> tuple[Array, Array]:
    """The nodes along both axes of the plane, each of the shape (nodes,)."""
    axes = {a.name: a for a in value.grid.axes}
    return nodes(axes[plane[0]]), nodes(axes[plane[1]])


def on_mesh(value: ValueFunction, plane: tuple[str, str], values: AnyArray) -> Array:
    """An array over the grid of a value function of two states, as (second, first) of the plane."""
    table = closed(value, values)
    return table.T if value.names == tuple(plane) else table


def curve(value: ValueFunction, time: float | None = None) -> tuple[Array, Array]:
    """The nodes and the values of a value function of one state, both of the shape (nodes,)."""
    return nodes(value.grid.axes[0]), closed(value, value.values(time))


def times(value: ValueFunction) -> list[float]:
    """The times [s] of a value function to draw, if it has several: at most `MOST`."""
    data = value.dataset["value"]
    seconds = [float(t) for t in data["time"].values] if "time" in data.dims else []
    if len(seconds) < 2:
        return []
    apart = -(-len(seconds) // MOST)
    return seconds[::-1][::apart][::-1]  # the last one among them


def time_colours(value: ValueFunction) -> dict[float, Any]:
    """A colour for every time, from dark to light."""
    seconds = times(value)
    return dict(zip(seconds, colormaps["viridis"](np.linspace(0, 0.88, len(seconds))), strict=True))


def draw_zero(axis: Axes, x: Array, y: Array, values: Array, **drawn: Any) -> None:
    """The zero level, if it exists. x: shape (columns,). y: shape (rows,). values: shape (rows,
    columns)."""
    if (values > 0).any() and (values <= 0).any():
        axis.contour(x, y, values, levels=[0.0], **drawn)


def draw_set(axis: Axes, value: ValueFunction, plane: tuple[str, str]) -> str:
    """The set of a value function of two states, at all its times; "empty", "full" or ""."""
    x, y = mesh(value, plane)
    last = on_mesh(value, plane, value.values())
    colours = time_colours(value)
    if (last > 0).any():
        top = float(last.max()) + 1.0
        axis.contourf(x, y, last, levels=[0.0, top], colors=[FILL], zorder=0.5)
    if colours:
        for time, colour in colours.items():
            table = on_mesh(value, plane, value.values(time))
            draw_zero(axis, x, y, table, colors=[colour], linewidths=1.4)
    else:
        draw_zero(axis, x, y, last, colors=[BLUE], linewidths=1.8)
    return extent(last)


def draw_others(axis: Axes, others: Iterable[ValueFunction], plane: tuple[str, str]) -> None:
    """The zero levels of other value functions of the same two states, dashed."""
    for other, (colour, dashes) in zip(others, cycle(DASHES), strict=False):
        table = on_mesh(other, plane, other.values())
        drawn: dict[str, Any] = {"colors": [colour], "linestyles": [dashes], "linewidths": 1.1}
        draw_zero(axis, *mesh(other, plane), table, **drawn)


def draw_values(axis: Axes, value: ValueFunction, plane: tuple[str, str]) -> ContourSet:
    """V as colours about zero, and the zero level."""
    x, y = mesh(value, plane)
    table = on_mesh(value, plane, value.values())
    # the depth of the set is the scale; values far outside need no distinct colours
    most = float(table.max()) if (table > 0).any() else float(np.abs(table).max()) or 1.0
    levels = MaxNLocator(16, symmetric=True).tick_values(-most, most)
    filled = axis.contourf(x, y, table, levels=levels, cmap=SIGNED, extend="both")
    draw_zero(axis, x, y, table, colors=[BLACK], linewidths=2.0)
    return filled


def draw_arrival(
    axis: Axes, value: ValueFunction, plane: tuple[str, str], arrival: AnyArray
) -> ContourSet | None:
    """The least times as colours, and the edge of the set; None if nothing is reached. arrival:
    seconds, shape (nodes of the first state, nodes of the second)."""
    x, y = mesh(value, plane)
    table, seconds = (on_mesh(value, plane, v) for v in (value.values(), arrival))
    if not (table > 0).any():
        return None
    inside = axis.contourf(x, y, table, levels=[0.0, float(table.max()) + 1.0])
    shown = np.ma.masked_invalid(_widened(seconds))
    filled = axis.contourf(x, y, shown, 12, cmap="viridis_r")
    filled.set_clip_path(inside.get_paths()[0], axis.transData)  # to the edge, between nodes
    inside.remove()
    draw_zero(axis, x, y, table, colors=[BLACK], linewidths=1.8)
    return filled


def _widened(seconds: Array) -> Array:
    """Nodes next to those with a time get the largest time of their neighbours."""
    rows, columns = seconds.shape
    room = np.pad(seconds, 1, constant_values=np.nan)
    near = np.fmax.reduce([room[i : i + rows, j : j + columns] for i in range(3) for j in range(3)])
    return np.where(np.isnan(seconds), near, seconds)


def extent(table: Array) -> str:
    """Whether the set is "empty" or "full" here; else "": a table of any shape."""
    if not (table > 0).any():
        return "empty"
    return "" if (table <= 0).any() else "full"


def in_set(label: str, edge: str = BLUE, face: str = FILL) -> Artist:
    """The legend of a set."""
    return Patch(facecolor=face, edgecolor=edge, linewidth=1.5, label=label)


def entries(
    value: ValueFunction, alone: Artist, others: Mapping[str, ValueFunction]
) -> list[Artist]:
    """The legend of the set, `alone` or at its times if it is not empty, and of those compared."""
    handles: list[Artist] = [
        Line2D([], [], color=colour, linewidth=1.4, label=f"{time:g} s")
        for time, colour in time_colours(value).items()
    ]
    for name, (colour, dashes) in zip(others, cycle(DASHES), strict=False):
        handles.append(Line2D([], [], color=colour, linestyle=dashes, label=name))
    return [alone, *handles] if not times(value) and (value.values() > 0).any() else handles


def set_up(axis: Axes, value: ValueFunction, plane: tuple[str, str]) -> None:
    """Limits, labels with units, and equal scales where both states are lengths."""
    axes = {a.name: a for a in value.grid.axes}
    first, second = (axes[name] for name in plane)
    axis.set_xlim(first.low, first.high)
    axis.set_ylim(second.low, second.high)
    axis.set_xlabel(style.axis_label(first.name, first.state.unit))
    axis.set_ylabel(style.axis_label(second.name, second.state.unit))
    if lengths(value, plane):
        axis.set_aspect("equal")


def label_outer(axis: Axes, k: int, columns: int, count: int) -> None:
    """Of `count` panels in rows, keep the labels of the left column and the lowest panels."""
    first, last = k % columns == 0, k + columns >= count
    axis.tick_params(labelleft=first, labelbottom=last)
    axis.xaxis.label.set_visible(last)
    axis.yaxis.label.set_visible(first)


def lengths(value: ValueFunction, plane: tuple[str, str]) -> bool:
    """Whether both states of the plane are in metres."""
    return all(a.state.unit == "m" for a in value.grid.axes if a.name in plane)


def panel_height(value: ValueFunction, plane: tuple[str, str], width: float) -> float:
    """The height of a panel `width` inches wide, between 0.5 and 1.5 times the width."""
    if not lengths(value, plane):
        return 0.8 * width
    spans = {a.name: a.high - a.low for a in value.grid.axes}
    return float(np.clip(spans[plane[1]] / spans[plane[0]], 0.5, 1.5)) * width


def add_bar(axis: Axes, filled: ContourSet, label: str) -> None:
    """A colour bar as high as the panel."""
    place = axis.inset_axes((1.03, 0.0, 0.04, 1.0))
    axis.figure.colorbar(filled, cax=place, label=label)
