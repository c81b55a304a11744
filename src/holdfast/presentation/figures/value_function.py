"""Figure of a value function: its set { V > 0 } in slices and in projection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import checked
from holdfast.execution.arrays import Array
from holdfast.maths.definitions.scene import Shape
from holdfast.presentation.figures import level_sets, style
from holdfast.presentation.figures.shapes import draw_fixed, labelled
from holdfast.presentation.figures.view import Held, View, check_same_states, look_at, told, where


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
    scene: shapes in the plane, as in `Region.scene`, with the values of `parameters`.

    Raises `OutputError` for a plane that is not two of the remaining states and for others of other
    states, `SimulationError` for a state fixed outside the grid.
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
    level_sets.add_legend(figure, axis.get_legend_handles_labels()[0])
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
    draw_fixed(axis, scene, parameters)
    level_sets.set_up(axis, flat, plane)
    figure.suptitle(_title(value, view.held), fontsize=9)
    found = level_sets.entries(flat, alone, others)
    level_sets.add_legend(figure, found + labelled(axis))
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
    for k, (axis, held) in enumerate(zip(panels, [*cuts, None], strict=False)):

        def part(whole: ValueFunction, held: dict[str, float] | None = held) -> ValueFunction:
            if held is None:
                return whole.slice(**view.given).projection(*plane)
            return whole.slice(**held)

        shown = part(value)
        extent = level_sets.draw_set(axis, shown, plane)
        level_sets.draw_others(axis, [part(o) for o in others.values()], plane)
        draw_fixed(axis, scene, parameters)
        level_sets.set_up(axis, shown, plane)
        level_sets.label_outer(axis, k, columns, count)
        title = where(value, {view.along: held[view.along]}) if held else "projection, any "
        title += "" if held else ", ".join(style.label(n) for n in over)
        axis.set_title(title + (f" ({extent})" if extent else ""))
    for axis in panels[count:]:
        axis.set_visible(False)
    figure.suptitle(_title(value, view.held), fontsize=9)
    found = level_sets.entries(value, level_sets.in_set(label), others)
    level_sets.add_legend(figure, found + labelled(panels[0]))
    return figure


def _title(value: ValueFunction, held: Mapping[str, float]) -> str:
    return told(value) + ("\n" + where(value, held) if held else "")


def _value_label(value: ValueFunction) -> str:
    return style.axis_label("V", str(value.dataset["value"].attrs.get("units", "1")))


def _arrival(value: ValueFunction, held: Mapping[str, float]) -> Array:
    """The least times, with the same states fixed as for the values."""
    times = value.dataset[["arrival"]].rename(arrival="value")
    return ValueFunction(times, value.grid).slice(**held).values()
