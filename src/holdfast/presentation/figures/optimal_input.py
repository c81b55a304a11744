"""The optimal law of a value function in a plane: sign of each input, and velocity of the state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import checked
from holdfast.errors import OutputError
from holdfast.execution.arrays import Array
from holdfast.maths.definitions.region import Shape
from holdfast.presentation.figures import level_sets, style
from holdfast.presentation.figures.style import draw_fixed, labelled
from holdfast.presentation.figures.value_function import check_same_states, look_at, told, where

POSITIVE, NEGATIVE = "#f6cf85", "#9fd0ee"  # tints of orange and sky
_ARROWS = 16
"""Arrows along either axis."""


@checked
def optimal_input_figure(
    value: ValueFunction,
    inputs: Mapping[str, npt.ArrayLike],
    velocity: tuple[npt.ArrayLike, npt.ArrayLike],
    *,
    plane: tuple[str, str] | None = None,
    at: Mapping[str, float] | None = None,
    others: Mapping[str, ValueFunction] | None = None,
    scene: Sequence[Shape] = (),
    parameters: Mapping[str, float] | None = None,
) -> Figure:
    """One panel for every input, coloured by its sign, with the velocity in the plane as arrows.

    inputs: name -> the input at the nodes of the plane; velocity: the rates of the plane's two
    states there, in their units per second. Every array has the shape (nodes of the first state,
    nodes of the second), with NaN at empty places. An arrow is the displacement in the time that
    the legend gives. plane, others, scene, parameters: as in `value_function_figure`; all states
    outside the plane are fixed (`at`). Thesis figures 7.10 and 7.11.

    Raises `OutputError` for a state that is neither drawn nor fixed and for arrays of other shapes.
    """
    others = dict(others or {})
    check_same_states(value, others)
    view = look_at(value, plane, at)
    if view.along or len(view.plane) != 2:
        raise OutputError(
            "the number of states to draw is not two",
            expected="a plane, and all other states of "
            + ", ".join(value.names)
            + " fixed at one value (at)",
        )
    plane = (view.plane[0], view.plane[1])
    flat = value.slice(**view.held).last()
    tables = {name: _table(flat, plane, name, array) for name, array in inputs.items()}
    first, second = (
        _table(flat, plane, f"velocity in {n}", v) for n, v in zip(plane, velocity, strict=True)
    )
    beside = [other.slice(**view.held) for other in others.values()]
    count = len(tables)
    if not count:
        raise OutputError("no input to draw", expected="name -> array, at least one")
    with style.look():
        width = style.WIDTH * (0.62, 1.0)[count > 1]
        columns = min(count, 3)
        rows = -(-count // columns)
        height = level_sets.panel_height(flat, plane, width / columns - 0.5) + 0.4
        figure, panels = plt.subplots(
            rows,
            columns,
            figsize=(width, rows * height + 1.0),
            layout="constrained",
            squeeze=False,
        )
        for k, (axis, (name, table)) in enumerate(zip(panels.flat, tables.items(), strict=False)):
            _draw_sign(axis, flat, plane, table)
            seconds = _draw_arrows(axis, flat, plane, first, second)
            level_sets.draw_others(axis, beside, plane)
            draw_fixed(axis, scene, parameters)
            level_sets.set_up(axis, flat, plane)
            level_sets.label_outer(axis, k, columns, count)
            axis.set_title(f"sign of {style.label(name)}")
        for axis in panels.flat[count:]:
            axis.set_visible(False)
        figure.suptitle(
            told(value) + ("\n" + where(value, view.held) if view.held else ""), fontsize=9
        )
        handles: list[Artist] = [
            Patch(color=POSITIVE, label="≥ 0"),
            Patch(color=NEGATIVE, label="< 0"),
            Line2D([], [], color=style.BLUE, linewidth=1.8, label="edge of the set"),
            Line2D(
                [], [], color=style.BLACK, marker=r"$\rightarrow$", markersize=11, linestyle="",
                label=f"displacement in {seconds:g} s",
            ),
        ]  # fmt: skip
        handles += level_sets.entries(flat, handles[2], others)
        level_sets.add_legend(figure, handles + labelled(panels[0, 0]))
    return figure


def _table(value: ValueFunction, plane: tuple[str, str], what: str, array: npt.ArrayLike) -> Array:
    """The caller's array, transposed to (second, first) of the plane."""
    counts = {a.name: a.count for a in value.grid.axes}
    shape = tuple(counts[n] for n in plane)
    try:
        table = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError):
        raise OutputError(f"'{what}' is {array!r}", expected="an array of numbers") from None
    if table.shape != shape:
        raise OutputError(
            f"'{what}' has the shape {table.shape}",
            expected=f"{shape}, the nodes of ({', '.join(plane)})",
        )
    return level_sets.on_mesh(value, plane, table if value.names == plane else table.T)


def _draw_sign(axis: Axes, value: ValueFunction, plane: tuple[str, str], table: Array) -> None:
    """Colours by sign, paler outside the set, and the set's edge."""
    x, y = level_sets.mesh(value, plane)
    sign = np.ma.masked_invalid(np.where(np.isnan(table), np.nan, np.where(table >= 0, 1.0, -1.0)))
    axis.contourf(x, y, sign, levels=[-2.0, 0.0, 2.0], colors=[NEGATIVE, POSITIVE], zorder=0.3)
    inside = level_sets.on_mesh(value, plane, value.values())
    if (inside <= 0).any():
        low = float(inside.min()) - 1.0
        axis.contourf(x, y, inside, levels=[low, 0.0], colors=["white"], alpha=0.7, zorder=0.4)
    level_sets.draw_zero(axis, x, y, inside, colors=[style.BLUE], linewidths=1.8)


def _draw_arrows(
    axis: Axes, value: ValueFunction, plane: tuple[str, str], first: Array, second: Array
) -> float:
    """Draw the displacement in a short time, which is returned [s]; grey outside the set."""
    x, y = level_sets.mesh(value, plane)
    thin = tuple(slice(None, None, -(-len(n) // _ARROWS)) for n in (y, x))
    step = [float(n[s][1] - n[s][0]) for n, s in zip((x, y), (thin[1], thin[0]), strict=True)]
    u, v = first[thin], second[thin]
    size = float(np.nanmax(np.hypot(u / step[0], v / step[1]), initial=0.0))
    seconds = _round_down(1.0 / size) if size > 0 else 1.0
    inside = level_sets.on_mesh(value, plane, value.values())[thin] > 0
    across, up = np.meshgrid(x[thin[1]], y[thin[0]])
    for chosen, colour in ((inside, style.BLACK), (~inside, style.GREY)):
        shown = chosen & np.isfinite(u) & np.isfinite(v)
        if shown.any():
            axis.quiver(
                across[shown], up[shown], seconds * u[shown], seconds * v[shown],
                angles="xy", scale_units="xy", scale=1.0, color=colour, width=0.004, zorder=3,
            )  # fmt: skip
    return seconds


def _round_down(value: float) -> float:
    """The value rounded to one, two or five times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(k for k in (1, 2, 5) if k * power <= value * (1 + 1e-9))
