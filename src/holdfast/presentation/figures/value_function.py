"""Figure of a value function: its set { V > 0 } in slices and in projection.

A view says which states are drawn, which are fixed, and the titles; other figures have it too.
The regulation map of a value is drawn in the plane of two inputs: what a state admits. The optimal
law is drawn in a plane of states: the sign of each input, and the velocity of the state.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from holdfast.analysis.boundary import RegulationMap
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import checked
from holdfast.errors import OutputError, check_name
from holdfast.execution.arrays import Array
from holdfast.maths.definitions.region import Shape
from holdfast.presentation.figures import level_sets, style
from holdfast.presentation.figures.style import draw_fixed, labelled
from holdfast.presentation.figures.zero_levels import PlaneLevels, draw_lines

SLICES = 5
"""The default number of slices."""

TABLES = ("region", "goal", "system")
"""What a file calls a region or a system that has no name of its own."""

TITLE_WIDTH = 62
"""Letters in a line of the title."""

Held = Mapping[str, float | Sequence[float]]


@dataclass(frozen=True)
class View:
    """One or two states are drawn; `held` are the fixed ones, `given` by the caller or by default.

    along: the state of the slices, at `values`; "" for a single picture.
    """

    plane: tuple[str, ...]
    held: dict[str, float]
    given: dict[str, float]
    along: str = ""
    values: tuple[float, ...] = ()


def look_at(
    value: ValueFunction,
    plane: tuple[str, str] | None,
    at: Held | None,
    others: Iterable[ValueFunction] = (),
) -> View:
    """The view to draw; `OutputError` for a plane or fixed states that leave no picture."""
    at = dict(at or {})
    for name in at:
        check_name(name, value.names, OutputError, f"'{name}' is not a state")
    fixed = {n: float(v) for n, v in at.items() if not isinstance(v, Sequence | np.ndarray)}
    several = {n: [float(x) for x in v] for n, v in at.items() if n not in fixed}  # type: ignore[union-attr]
    free = [n for n in value.names if n not in at]
    if not free or len(several) > 1 or (len(free) == 1 and several):
        raise OutputError(
            f"the states to draw are: {', '.join(free) or 'none'}",
            expected="one; or two, with several values of at most one other",
        )
    if plane is not None and (len(set(plane)) != 2 or not set(plane) <= set(free)):
        raise OutputError(
            f"the plane is ({', '.join(plane)})", expected="two of the states " + ", ".join(free)
        )
    drawn = tuple(plane or free[:2])
    rest = [n for n in free if n not in drawn]
    along = next(iter([*several, *rest]), "")
    usual = {a.name: _usual(a.low, a.high) for a in value.grid.axes if a.name in rest}
    held = {n: v for n, v in (fixed | usual).items() if n != along}
    values = several.get(along) or (
        _across(along, [v.slice(**held) for v in (value, *others)]) if along else []
    )
    return View(drawn, held, fixed, along, tuple(values))


def check_same_states(value: ValueFunction, others: Mapping[str, ValueFunction]) -> None:
    """Refuse a comparison with a value function of other states."""
    for name, other in others.items():
        if other.names != value.names:
            raise OutputError(
                f"'{name}' is a value function of {', '.join(other.names)}",
                expected=f"the states {', '.join(value.names)}",
            )


def _usual(low: float, high: float) -> float:
    return 0.0 if low <= 0.0 <= high else (low + high) / 2


def _across(name: str, values: Sequence[ValueFunction]) -> list[float]:
    """Nodes of one state, evenly spaced over the extent of all sets at all their times."""
    (axis,) = (a for a in values[0].grid.axes if a.name == name)
    inside = [axis.nodes[[0, -1]]]
    for value in values:
        shadow = value.projection(name)
        data = shadow.dataset["value"]
        in_set = (data.max("time") if "time" in data.dims else data).values > 0
        inside.append(shadow.grid.axes[0].nodes[in_set])
    places = np.concatenate(inside[1:] if sum(map(len, inside[1:])) else inside)
    first, last = (int(np.abs(axis.nodes - x).argmin()) for x in (places.min(), places.max()))
    wanted = np.linspace(first, last, SLICES + 2)[1:-1]
    return [float(axis.nodes[k]) for k in np.unique(np.round(wanted).astype(int))]


def told(value: ValueFunction) -> str:
    """Title: that of the scenario, the set, its convergence, and whether it is empty or covers the
    grid."""
    report, last = value.report, value.values()
    text = "value function"
    if report.kind:
        names = [n for n in (report.region, report.system) if n not in TABLES]
        text = report.kind.replace("-", " ") + (f" of {', '.join(names)}" if names else "")
        reached = f"{report.reached_s:.3g} s"
        if report.converged:
            text += f"\nconverged after {reached}"
        elif "kernel" in report.kind:
            text += f"\nfor {reached}, not converged"
        else:
            text += f"\nwithin {reached}"
        if report.approximation:
            text += f", {report.approximation}"
    if not (last > 0).any():
        text += "; empty: no node of the grid is in the set"
    elif (last > 0).all():
        text += "; every node of the grid is in the set"
    text = text.replace("_", " ")
    if report.title:
        text = "\n".join([*textwrap.wrap(report.title, TITLE_WIDTH), text])
    return text


def where(value: ValueFunction, held: Mapping[str, float]) -> str:
    """The fixed states, with units."""
    units = {a.name: a.state.unit for a in value.grid.axes}
    return style.numbers((n, v, units[n]) for n, v in held.items())


@checked
def value_function_figure(
    value: ValueFunction,
    *,
    plane: tuple[str, str] | None = None,
    at: Held | None = None,
    others: Mapping[str, ValueFunction] | None = None,
    label: str = "in the set",
    scene: Sequence[Shape] = (),
    parameters: Mapping[str, float] | None = None,
) -> Figure:
    """The set { V > 0 } of one to six states.

    One state not fixed: V over that state. Two: V in colours; of a capture basin the least time; if
    V is known at several times, its zero level at each. More: slices through the plane at several
    values of a third state, and the projection onto the plane.

    plane: the two states to draw, the first across; by default the first two that are not fixed.
    at: state -> its fixed value, in its unit; or several values of one state: the slices. A state
    that is neither drawn nor fixed is set to zero, or to the middle if that is outside the grid.
    others: label -> value function of the same states, drawn dashed. label: of the set itself.
    scene: shapes in the plane, as in `Region.scene`, and zero levels of inequalities, drawn where
    they depend on nothing else that varies. parameters: name -> value, of these.

    Raises `OutputError` for a plane that is not two of the remaining states and for others of other
    states, `SimulationError` for a state fixed outside the grid.

    >>> hf.value_function_figure(kernel, label="viable").savefig("kernel.png")
    """
    others = dict(others or {})
    check_same_states(value, others)
    view = look_at(value, plane, at, others.values())
    with style.look():
        if view.along:
            return _slices(value, view, others, label, scene, parameters)
        flat = {name: other.slice(**view.held) for name, other in others.items()}
        if len(view.plane) == 1:
            return _line(value, view, flat, label)
        return _plane(value, view, flat, label, scene, parameters)


def _line(
    value: ValueFunction, view: View, others: Mapping[str, ValueFunction], label: str
) -> Figure:
    """V over one state, at all its times; the set is shaded."""
    flat = value.slice(**view.held)
    (state,) = flat.grid.axes
    figure, axis = plt.subplots(figsize=(0.62 * style.WIDTH, 3.0), layout="constrained")
    x, last = level_sets.curve(flat)
    axis.fill_between(
        x, 0, last, where=last > 0, interpolate=True, color=level_sets.FILL, label=label
    )
    colours = level_sets.time_colours(flat)
    for time, colour in colours.items():
        axis.plot(*level_sets.curve(flat, time), color=colour, label=f"{time:g} s")
    if not colours:
        axis.plot(x, last, color=style.BLUE, label="$V$")
    for (name, other), (colour, dashes) in zip(
        others.items(), cycle(level_sets.DASHES), strict=False
    ):
        axis.plot(*level_sets.curve(other), color=colour, linestyle=dashes, label=name)
    axis.axhline(0.0, color=style.BLACK, linewidth=0.7)
    axis.set_xlim(state.low, state.high)
    axis.set_xlabel(style.axis_label(state.name, state.state.unit))
    axis.set_ylabel(_value_label(value))
    figure.suptitle(_title(value, view.held), fontsize=9)
    style.add_legend(figure, axis.get_legend_handles_labels()[0])
    return figure


def _plane(
    value: ValueFunction,
    view: View,
    others: Mapping[str, ValueFunction],
    label: str,
    scene: Sequence[Shape],
    parameters: Mapping[str, float] | None,
) -> Figure:
    """One picture of two states: V, its zero level at several times, or the least time."""
    plane = (view.plane[0], view.plane[1])
    flat = value.slice(**view.held)
    width = 0.62 * style.WIDTH
    height = level_sets.panel_height(flat, plane, width - 1.4) + 1.3
    figure, axis = plt.subplots(figsize=(width, height), layout="constrained")
    alone = level_sets.in_set(label)
    if "arrival" in value.dataset:
        flat = flat.last()  # the colours represent the times
        filled = level_sets.draw_arrival(axis, flat, plane, _arrival(value, view.held))
        if filled is not None:
            level_sets.add_bar(axis, filled, "least time [s]")
        alone = level_sets.in_set(label, style.BLACK, "none")
    elif level_sets.times(value):
        level_sets.draw_set(axis, flat, plane)
    else:
        filled = level_sets.draw_values(axis, flat, plane)
        level_sets.add_bar(axis, filled, _value_label(value))
        alone = level_sets.in_set(label, style.BLACK)
    level_sets.draw_others(axis, others.values(), plane)
    level_sets.set_up(axis, flat, plane)
    lines = _draw_scene(axis, plane, scene, {**(parameters or {}), **view.held})
    figure.suptitle(_title(value, view.held), fontsize=9)
    entries = level_sets.entries(flat, alone, others)
    style.add_legend(figure, entries + labelled(axis) + lines)
    return figure


def _slices(
    value: ValueFunction,
    view: View,
    others: Mapping[str, ValueFunction],
    label: str,
    scene: Sequence[Shape],
    parameters: Mapping[str, float] | None,
) -> Figure:
    """The set in slices along a third state, and its projection on the plane."""
    plane = (view.plane[0], view.plane[1])
    cuts = [view.held | {view.along: v} for v in view.values]
    over = [n for n in value.names if n not in plane and n not in view.given]
    count = len(cuts) + 1
    columns = 2 if count in (2, 4) else 3
    rows = -(-count // columns)
    width = style.WIDTH * columns / 3
    height = rows * (level_sets.panel_height(value, plane, width / columns - 0.4) + 0.3) + 1.0
    figure, table = plt.subplots(
        rows,
        columns,
        figsize=(width, height),
        layout="constrained",
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    panels: list[Axes] = list(table.flat)
    lines: list[Artist] = []
    for k, (axis, held) in enumerate(zip(panels, [*cuts, None], strict=False)):

        def part(whole: ValueFunction, held: dict[str, float] | None = held) -> ValueFunction:
            if held is None:
                return whole.slice(**view.given).projection(*plane)
            return whole.slice(**held)

        shown = part(value)
        extent = level_sets.draw_set(axis, shown, plane)
        level_sets.draw_others(axis, [part(o) for o in others.values()], plane)
        level_sets.set_up(axis, shown, plane)
        fixed = view.given if held is None else held
        lines += _draw_scene(axis, plane, scene, {**(parameters or {}), **fixed})
        level_sets.label_outer(axis, k, columns, count)
        title = where(value, {view.along: held[view.along]}) if held else "projection, any "
        title += "" if held else ", ".join(style.label(n) for n in over)
        axis.set_title(title + (f" ({extent})" if extent else ""))
    for axis in panels[count:]:
        axis.set_visible(False)
    figure.suptitle(_title(value, view.held), fontsize=9)
    entries = level_sets.entries(value, level_sets.in_set(label), others)
    style.add_legend(figure, entries + labelled(panels[0]) + lines)
    return figure


def _draw_scene(
    axis: Axes, plane: tuple[str, str], scene: Sequence[Shape], values: Mapping[str, float]
) -> list[Artist]:
    """What stands still, and the inequalities that have a line where the parameters and the fixed
    states have these values; the legend of these lines."""
    draw_fixed(axis, scene, values)
    window = (*axis.get_xlim(), *axis.get_ylim())
    return draw_lines(axis, PlaneLevels.among(scene, plane, values).lines(window), window)


def _title(value: ValueFunction, held: Mapping[str, float]) -> str:
    return told(value) + ("\n" + where(value, held) if held else "")


def _value_label(value: ValueFunction) -> str:
    return style.axis_label("V", str(value.dataset["value"].attrs.get("units", "1")))


def _arrival(value: ValueFunction, held: Mapping[str, float]) -> Array:
    """The least times, with the same states fixed as for the values."""
    times = value.dataset[["arrival"]].rename(arrival="value")
    return ValueFunction(times, value.grid).slice(**held).values()


@checked
def regulation_map_figure(found: RegulationMap) -> Figure:
    """The bounds of the inputs, the edge of every active condition, and the regulation map.

    found: a regulation map.

    An arrow at each edge points to the inputs that its condition allows.

    Raises `OutputError` unless there are two inputs with bounds.

    >>> ahead = hf.Region("ahead", robot.states[:1], (hf.Inequality("behind", -x, "m"),))
    >>> edge = hf.regulation_map(robot, ahead, [0.0, 0.0, 0.5])
    >>> hf.regulation_map_figure(edge).savefig("inputs.png")
    """
    count = len(found.conditions)
    if len(found.inputs) != 2 or len(found.offsets) - count < 3:
        raise OutputError(
            f"a regulation map in {len(found.inputs)} inputs cannot be drawn",
            expected="two inputs, both bounded",
        )
    everything = replace(
        found,
        normals=found.normals[count:],
        offsets=found.offsets[count:],
        conditions=(),
        hopeless=(),
    ).vertices
    low, high = everything.min(axis=0), everything.max(axis=0)
    pad, span = 0.12 * (high - low), high - low
    with style.look():
        figure, axis = plt.subplots(figsize=(0.6 * style.WIDTH, 3.6), layout="constrained")
        axis.add_patch(Polygon(everything, facecolor="none", edgecolor=style.GREY, linestyle="--"))
        axis.plot([], [], color=style.GREY, linestyle="--", label="bounds of the inputs")
        corners = found.vertices
        if len(corners) > 2:
            axis.add_patch(Polygon(corners, facecolor=style.GREEN, alpha=0.25, edgecolor="none"))
            axis.plot([], [], color=style.GREEN, alpha=0.4, linewidth=6, label="regulation map")
        elif len(corners):
            axis.plot(
                *corners.T, color=style.GREEN, marker="o", linewidth=3, label="regulation map"
            )
        for j, name in enumerate(found.conditions):
            # in units of the figure, so that arrows stand upright on their edges
            normal, offset = found.normals[j] * span, found.offsets[j] - found.normals[j] @ low
            size = float(np.linalg.norm(normal))
            if size < 1e-12:
                continue
            foot, along = normal * offset / size**2, np.array([-normal[1], normal[0]]) / size
            middle = foot + along * float(along @ (0.5 - foot))
            ends = np.array([middle - 2 * along, middle + 2 * along]) * span + low
            colour = style.LINES[j % len(style.LINES)]
            drawn = {"color": colour, "linestyle": style.dashes(j)}
            axis.plot(*ends.T, label=name.replace("_", " "), **drawn)
            tip = middle - 0.1 * normal / size
            arrow = {"arrowstyle": "-|>", "color": colour}
            axis.annotate("", tip * span + low, middle * span + low, arrowprops=arrow)
        if not len(corners):
            reason = ", ".join(found.hopeless) or "no admissible input"
            axis.set_title(f"empty: {reason.replace('_', ' ')}")
        axis.set_xlim(low[0] - pad[0], high[0] + pad[0])
        axis.set_ylim(low[1] - pad[1], high[1] + pad[1])
        axis.set_xlabel(style.axis_label(found.inputs[0].name, found.inputs[0].unit))
        axis.set_ylabel(style.axis_label(found.inputs[1].name, found.inputs[1].unit))
        figure.legend(loc="outside lower center", ncols=2)
    return figure


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
    nodes of the second), with NaN at empty places.

    An arrow is the displacement in the time that the legend gives. plane, at, others, scene,
    parameters: as in `value_function_figure`; all states outside the plane are fixed by `at`.
    Thesis figures 7.10 and 7.11.

    Raises `OutputError` for a state that is neither drawn nor fixed and for arrays of other shapes.

    >>> from holdfast.analysis.safety.safety_filter import optimal_inputs
    >>> inputs, velocity = optimal_inputs(cart, kernel, ("x", "v"), {})
    >>> hf.optimal_input_figure(kernel, inputs, velocity).savefig("inputs.png")
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
            level_sets.set_up(axis, flat, plane)
            lines = _draw_scene(axis, plane, scene, {**(parameters or {}), **view.held})
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
        style.add_legend(figure, handles + labelled(panels[0, 0]) + lines)
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
