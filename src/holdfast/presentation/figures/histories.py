"""Time histories of one run: states, inputs, constraints, signals, with the mode as background.

For a law with a safeguard (safety filter), the inputs are drawn with the law's requests, and marks
show samples at which the filter intervened or found no admissible input.

A panel has the curves of one unit, with limits and thresholds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from holdfast.analysis.simulation.files import NamedArrays
from holdfast.analysis.simulation.result import Result
from holdfast.arguments import checked
from holdfast.execution.arrays import Array
from holdfast.execution.simulation.settings import Outcome, SafeguardAnswer
from holdfast.presentation.figures import style


@dataclass(frozen=True)
class Panel:
    """Curves against time, values (time, name).

    nominal: the same curves as requested by the law, before its safety filter. limits: (low, high)
    of every curve, infinite without a limit. levels: horizontal lines by label. fed: whether the
    curves are the inputs applied to the vehicle. looks: the number of the look of every curve; by
    default their order in the panel.
    """

    title: str
    unit: str
    names: list[str]
    values: Array
    nominal: Array | None = None
    limits: Array | None = None
    levels: Mapping[str, float] = field(default_factory=dict)
    fed: bool = False
    looks: Sequence[int] = ()


def panels(result: Result, run: int) -> list[Panel]:
    """States by unit, actuators (or inputs), constraints by unit, signals, the kernel's value."""
    data = result.arrays
    states = _near_zero(data["state"].values[run], data["state_is_angle"].values)
    names = [style.label(str(n)) for n in data["state_name"].values]
    all_panels = _by_unit("state", _units(data, "state"), names, states)
    all_panels += _fed(data, run)
    if data.sizes["constraint_name"]:
        labels = [str(n).replace("_", " ") for n in data["constraint_name"].values]
        values, title = data["constraint"].values[run], "constraints (safe below 0)"
        units = _units(data, "constraint")
        limited = zip(_by_unit(title, units, labels, values), _columns(units), strict=True)
        all_panels += [replace(p, levels={"": 0.0}, looks=columns) for p, columns in limited]
    return all_panels + _signals(result, run)


def _fed(data: NamedArrays, run: int) -> list[Panel]:
    """The actuators, or the inputs if these are the same, with nominal values and limits."""
    axis = "actuator" if data.sizes["actuator_name"] else "input"
    names = [str(n) for n in data[f"{axis}_name"].values]
    units = _units(data, "input")
    if axis == "actuator":
        units = [str(data["actuator"].attrs["units"])] * len(names)
    else:
        names = [style.label(n) for n in names]
    asked = "nominal" if axis == "input" else "nominal_actuator"
    nominal = data[asked].values[run] if asked in data else None
    limits = None
    if f"{axis}_low" in data:  # missing in files of format 1
        ends = [data[f"{axis}_{side}"] for side in ("low", "high")]
        limits = np.array([e.values[run] if "run" in e.dims else e.values for e in ends]).T
    title = {"actuator": "actuators", "input": "input"}[axis]
    return [
        replace(
            panel,
            nominal=None if nominal is None else nominal[:, columns],
            limits=None if limits is None else limits[columns],
            fed=True,
        )
        for panel, columns in zip(
            _by_unit(title, units, names, data[axis].values[run]), _columns(units), strict=True
        )
    ]


def _signals(result: Result, run: int) -> list[Panel]:
    """The switching signals, the value of a kernel with its thresholds, and the other signals."""
    data = result.arrays
    names = [str(n) for n in data["signal_name"].values]
    values = data["signal"].values[run]
    has_units = "signal_unit" in data
    units = _units(data, "signal") if has_units else ["1"] * len(names)
    value = str(data["signal"].attrs.get("value_of_kernel", ""))
    leading = []
    for title, chosen in (
        ("switching signals", [i for i, n in enumerate(names) if n.startswith("sigma")]),
        ("value of the kernel (kept above 0)", [i for i, n in enumerate(names) if n == value]),
    ):
        if not chosen:
            continue
        levels = {"boundary": 0.0} if title.startswith("value") else {}
        margin = float((result.parameters or {}).get("safety_margin", 0.0))
        if levels and margin:
            levels["margin"] = margin
        labels = ["$V$"] if levels else [_signal_label(names[i]) for i in chosen]
        leading.append(Panel(title, units[chosen[0]], labels, values[:, chosen], levels=levels))
    rest = [i for i, n in enumerate(names) if not n.startswith("sigma") and n != value]
    labels = [names[i].replace("_", " ") for i in rest]
    return leading + _by_unit("signals", [units[i] for i in rest], labels, values[:, rest])


def _near_zero(states: Array, angles: npt.NDArray[np.int8]) -> Array:
    """The states; every angle is shifted by the full turns counted at its end."""
    late = states[len(states) // 2 :]
    late = late[np.isfinite(late).all(axis=1)]
    turns = np.round(np.median(late, axis=0) / (2 * np.pi)) if len(late) else 0.0
    shifted: Array = states - 2 * np.pi * np.where(angles == 1, turns, 0.0)
    return shifted


def _signal_label(name: str) -> str:
    _, _, tail = name.partition("_")
    return f"$\\sigma$ {tail.replace('_', ' ')}"


def _units(data: NamedArrays, axis: str) -> list[str]:
    return [str(u) for u in data[f"{axis}_unit"].values]


def _columns(units: Sequence[str]) -> list[list[int]]:
    """The columns of every unit."""
    return [[i for i, u in enumerate(units) if u == unit] for unit in dict.fromkeys(units)]


def _by_unit(title: str, units: Sequence[str], names: Sequence[str], values: Array) -> list[Panel]:
    kinds = {"m": "position", "rad": "angle", "m/s": "velocity", "rad/s": "turn rate"}
    return [
        Panel(
            kinds.get(units[columns[0]], "state") if title == "state" else title,
            units[columns[0]],
            [names[i] for i in columns],
            values[:, columns],
        )
        for columns in _columns(units)
    ]


NEAR = 0.5
"""A limit is drawn if an input reaches this share of it, and otherwise only named."""

MARKS = {
    SafeguardAnswer.OVERRULED: (style.OVERRULED, 0.05),
    SafeguardAnswer.INFEASIBLE: (style.INFEASIBLE, 0.05),
}
"""Colour, and height as a fraction of the panel."""


@checked
def histories_figure(result: Result, run: int = 0) -> Figure:
    """States by unit, actuators (or inputs), constraints by unit and signals of one run.

    The title says which run it is, how it ended, and the start. run: its number, from 0.

    Raises `OutputError` for an unknown run.

    >>> hf.histories_figure(result, run=1).savefig("histories.png")
    """
    data = result.arrays
    style.check_run(run, data.sizes["run"])
    shown = panels(result, run)
    time = data["time"].values
    mode = data["mode"].values[run]
    answers = data["safeguard"].values[run] if "safeguard" in data else None
    rows = -(-len(shown) // 2)
    end = _settled(time, data["state"].values[run])
    with style.look():
        figure, axes = plt.subplots(
            rows,
            2,
            figsize=(style.WIDTH, rows),
            sharex=True,
            layout="constrained",
            squeeze=False,
        )
        flat = list(axes.T.flat)
        shades = _shade(flat[: len(shown)], time, mode, data)
        marks: list[Patch] = []
        legends: list[int] = []
        for axis, panel in zip(flat, shown, strict=False):
            _draw(axis, panel, time)
            legends.append(_legend(axis, panel.title))
            if panel.fed and answers is not None:
                marks = _mark(axis, time, answers)
            axis.set_xlim(time[0], end)
        deepest = sum(max(legends[k::rows]) for k in range(rows))
        figure.set_figheight(1.55 * rows + style.ROW_HEIGHT * deepest + 0.6)
        figure.suptitle(told(result, run), fontsize=9)
        for axis in flat[len(shown) :]:
            axis.set_visible(False)
        for column in axes.T:
            last = [a for a in column if a.get_visible()][-1]
            rest = f" (at rest until {time[-1]:g} s)" if end < time[-1] else ""
            last.set_xlabel(f"time [s]{rest}")
            last.tick_params(labelbottom=True)
        if shades or marks:
            titles = [t for t, entries in (("mode", shades), ("safeguard", marks)) if entries]
            figure.legend(
                handles=[*shades, *marks],
                loc="outside lower center",
                ncols=min(6, len(shades) + len(marks)),
                handlelength=3.2,
                title=", ".join(titles),
                title_fontsize=7,
            )
    return figure


TITLE_WIDTH, TITLE_LINES = 110, 2
"""Letters in a line of the title, and lines for the start."""


def told(result: Result, run: int) -> str:
    """Which run it is, how it ended, and its start."""
    data = result.arrays
    names, units = ([str(v) for v in data[f"state_{what}"].values] for what in ("name", "unit"))
    first = data["state"].values[run, 0]
    parts = [style.numbers([one]) for one in zip(names, first.tolist(), units, strict=True)]
    count, outcome = data.sizes["run"], Outcome(int(data["outcome"].values[run]))
    said = f"run {run} of {count}: {outcome.label}" if count > 1 else outcome.label
    rows: list[list[str]] = [[]]
    for part in parts:  # not broken within: it may be a formula
        if rows[-1] and len(", ".join([*rows[-1], part])) > TITLE_WIDTH:
            rows.append([])
        rows[-1].append(part)
    left = sum(map(len, rows[TITLE_LINES:]))
    start = ",\n".join(", ".join(row) for row in rows[:TITLE_LINES])
    return f"{said}\nfrom {start}" + (f" and {left} more states" if left else "")


def _draw(axis: Axes, panel: Panel, time: Array) -> None:
    looks = panel.looks or range(len(panel.names))
    for i, (name, k) in enumerate(zip(panel.names, looks, strict=True)):
        look: dict[str, Any] = {
            "color": style.LINES[k % len(style.LINES)],
            "linestyle": style.dashes(k),
        }
        axis.plot(time, panel.values[:, i], label=name, **look)
        if panel.nominal is not None:
            said = "nominal" if i == len(panel.names) - 1 else f"_nominal {name}"
            faint = {**look, "linewidth": 2.4, "alpha": 0.35, "zorder": 1.5}
            axis.plot(time, panel.nominal[:, i], label=said, **faint)
    for (name, level), dashes in zip(panel.levels.items(), ("-", ":"), strict=False):
        axis.axhline(
            level, color=style.BLACK, linewidth=0.8, linestyle=dashes, label=name or "_level"
        )
    axis.set_ylabel(f"[{panel.unit}]" if panel.unit != "1" else "")
    axis.margins(x=0.0, y=0.1)
    _limit(axis, panel)


LEGEND_WIDTH = 2.9
"""Inches of a legend over a panel."""


def _legend(axis: Axes, title: str) -> int:
    """Title and legend over the panel, where no line is; the number of rows of the legend."""
    labels = axis.get_legend_handles_labels()[1]
    rows = style.rows_of(labels, LEGEND_WIDTH) if labels else 0
    axis.set_title(title, loc="left", fontsize=8, pad=4 + 72 * style.ROW_HEIGHT * rows)
    if labels:
        axis.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=-(-len(labels) // rows),
            handlelength=1.8,
            columnspacing=1.4,
            labelspacing=0.3,
            borderpad=0.0,
            borderaxespad=0.5,
        )
    return rows


def _limit(axis: Axes, panel: Panel) -> None:
    """The limits of the inputs, and a scale from the applied ones: nominal commands may be huge."""
    if panel.limits is None and panel.nominal is None:
        return
    applied = panel.values[np.isfinite(panel.values)]
    ends = [float(applied.min()), float(applied.max())] if applied.size else [0.0, 0.0]
    pairs = [] if panel.limits is None else [(float(a), float(b)) for a, b in panel.limits]
    levels = [v for v in dict.fromkeys(v for pair in pairs for v in pair) if np.isfinite(v)]
    for k, level in enumerate(levels):
        axis.axhline(
            level,
            color=style.BLACK,
            linewidth=0.8,
            linestyle=(0, (1, 2)),
            label=_limits_label(pairs) if k == 0 else "_limit",
        )
    reach = max(abs(v) for v in ends)
    ends += [v for v in levels if reach >= NEAR * abs(v)]
    size = max(ends) - min(ends) or 1.0
    axis.set_ylim(min(ends) - 0.15 * size, max(ends) + 0.15 * size)


def _limits_label(pairs: Iterable[tuple[float, float]]) -> str:
    """The limits as text; equal limits of all curves of the panel appear once."""
    texts = dict.fromkeys(
        f"±{high:.3g}" if low == -high else f"{low:.3g}, {high:.3g}" for low, high in pairs
    )
    word = "limit" if all("," not in text for text in texts) else "limits"
    return f"{word} {' or '.join(texts)}".replace("inf", "∞")


def _mark(axis: Axes, time: Array, answers: npt.NDArray[np.int8]) -> list[Patch]:
    """Bars at the bottom of the panel, at the samples at which the safety filter intervened."""
    step = time[1] - time[0] if len(time) > 1 else 1.0
    patches = []
    for answer, (colour, height) in MARKS.items():
        at = np.flatnonzero(answers == answer)
        if not at.size:
            continue
        edges = np.flatnonzero(np.diff(at) > 1)
        firsts = at[np.concatenate([[0], edges + 1])]
        lasts = at[np.concatenate([edges, [len(at) - 1]])]
        axis.broken_barh(
            [(time[a], time[b] - time[a] + step) for a, b in zip(firsts, lasts, strict=True)],
            (0.0, height),
            transform=axis.get_xaxis_transform(),
            color=colour,
            linewidth=0,
            zorder=3,
        )
        patches.append(Patch(color=colour, label=answer.label))
    return patches


def _settled(time: Array, states: Array) -> float:
    """A time shortly after the states have come to rest, or the end."""
    finite = np.isfinite(states).all(axis=1)
    if not finite.all():
        return float(time[-1])
    size = np.ptp(states, axis=0)
    moving = (np.abs(states - states[-1]) > 0.01 * np.maximum(size, 1e-12)).any(axis=1)
    last = np.flatnonzero(moving)
    return float(min(time[-1], 1.4 * time[last[-1]] + time[1])) if last.size else float(time[-1])


def _shade(
    axes: list[Axes], time: Array, mode: npt.NDArray[np.int16], data: object
) -> list[Line2D]:
    meanings = str(data["mode"].attrs["flag_meanings"]).split()  # type: ignore[index]
    if len(np.unique(mode[mode >= 0])) < 2:  # nothing to tell apart
        return []
    edges = [0, *(np.flatnonzero(np.diff(mode)) + 1), len(mode) - 1]
    for a, b in pairwise(edges):
        if mode[a] >= 0:
            look = _mode_look(int(mode[a]))
            for axis in axes:
                axis.axvspan(time[a], time[b], color=look["color"], alpha=0.10, linewidth=0)
                axis.plot(
                    time[[a, b]], [1.0, 1.0], transform=axis.get_xaxis_transform(),
                    label="_mode", **look,
                )  # fmt: skip
    return [
        Line2D([], [], label=meanings[m].replace("_", " "), **_mode_look(int(m)))
        for m in np.unique(mode[mode >= 0])
    ]


def _mode_look(mode: int) -> dict[str, Any]:
    """The line over the panels while the mode is on; its shade has the same colour."""
    colour = style.MODES[mode % len(style.MODES)]
    return {
        "color": colour, "linestyle": style.dashes(mode), "linewidth": 2.5,
        "dash_capstyle": "butt", "solid_capstyle": "butt",
    }  # fmt: skip
