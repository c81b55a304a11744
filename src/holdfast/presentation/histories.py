"""One run against time: states, inputs, constraints, signals, with the mode as background."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from holdfast.analysis.result import Result
from holdfast.arguments import checked
from holdfast.errors import OutputError
from holdfast.presentation import style

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Panel:
    title: str
    unit: str
    names: list[str]
    values: Array
    zero: bool = False


@checked
def histories_figure(result: Result, run: int = 0) -> Figure:
    """States by unit, actuators (or inputs), constraints by unit and signals of one run.

    Raises `OutputError` when there is no such run.
    """
    data = result.dataset
    if not 0 <= run < data.sizes["run"]:
        raise OutputError(
            f"there is no run {run} to draw", expected=f"0 to {data.sizes['run'] - 1}"
        )
    panels = _panels(result, run)
    time = data["time"].values
    mode = data["mode"].values[run]
    rows = -(-len(panels) // 2)
    end = _settled(time, data["state"].values[run])
    with style.look():
        figure, axes = plt.subplots(
            rows,
            2,
            figsize=(style.WIDTH, 1.55 * rows + 0.6),
            sharex=True,
            layout="constrained",
            squeeze=False,
        )
        flat = list(axes.T.flat)
        shades = _shade(flat[: len(panels)], time, mode, data)
        for axis, panel in zip(flat, panels, strict=False):
            for i, name in enumerate(panel.names):
                axis.plot(
                    time,
                    panel.values[:, i],
                    color=style.LINES[i % len(style.LINES)],
                    label=name,
                    linestyle=("-", "--", "-.", ":")[i % 4],
                )
            if panel.zero:
                axis.axhline(0.0, color=style.BLACK, linewidth=0.6)
            axis.set_title(panel.title, loc="left", fontsize=8, pad=3)
            axis.set_ylabel(f"[{panel.unit}]" if panel.unit != "1" else "")
            axis.margins(x=0.0, y=0.1)
            crowded = len(panel.names) > 2
            if crowded:  # no corner is free: make room above the curves
                low, high = axis.get_ylim()
                axis.set_ylim(low, high + 0.45 * (high - low))
            axis.legend(
                loc="upper center" if crowded else "best",
                ncols=2,
                handlelength=1.8,
                borderaxespad=0.2,
                frameon=True,
                framealpha=0.8,
                edgecolor="none",
            )
            axis.set_xlim(time[0], end)
        for axis in flat[len(panels) :]:
            axis.set_visible(False)
        for column in axes.T:
            last = [a for a in column if a.get_visible()][-1]
            rest = f" (at rest until {time[-1]:g} s)" if end < time[-1] else ""
            last.set_xlabel(f"time [s]{rest}")
            last.tick_params(labelbottom=True)
        if len(shades) > 1:
            figure.legend(
                handles=shades,
                loc="outside lower center",
                ncols=len(shades),
                title="mode",
                title_fontsize=7,
            )
    return figure


def _settled(time: Array, states: Array) -> float:
    """A little after the states have come to rest, or the end."""
    finite = np.isfinite(states).all(axis=1)
    if not finite.all():
        return float(time[-1])
    size = np.ptp(states, axis=0)
    moving = (np.abs(states - states[-1]) > 0.01 * np.maximum(size, 1e-12)).any(axis=1)
    last = np.flatnonzero(moving)
    return float(min(time[-1], 1.4 * time[last[-1]] + time[1])) if last.size else float(time[-1])


def _shade(axes: list[Axes], time: Array, mode: npt.NDArray[np.int16], data: object) -> list[Patch]:
    meanings = str(data["mode"].attrs["flag_meanings"]).split()  # type: ignore[index]
    if len(meanings) == 1:
        return []
    edges = [0, *(np.flatnonzero(np.diff(mode)) + 1), len(mode) - 1]
    for a, b in pairwise(edges):
        if mode[a] >= 0:
            colour = style.MODES[int(mode[a]) % len(style.MODES)]
            for axis in axes:
                axis.axvspan(time[a], time[b], color=colour, alpha=0.10, linewidth=0)
    return [
        Patch(
            color=style.MODES[int(m) % len(style.MODES)],
            alpha=0.25,
            label=meanings[m].replace("_", " "),
        )
        for m in np.unique(mode[mode >= 0])
    ]


def _panels(result: Result, run: int) -> list[_Panel]:
    data = result.dataset
    panels = []
    states = _near_zero(data["state"].values[run], data["state_is_angle"].values)
    names = [style.label(str(n)) for n in data["state_name"].values]
    panels += _by_unit("state", [str(u) for u in data["state_unit"].values], names, states)
    if data.sizes["actuator"]:
        panels.append(
            _Panel(
                "actuators",
                str(data["actuator"].attrs["units"]),
                [str(n) for n in data["actuator_name"].values],
                data["actuator"].values[run],
            )
        )
    else:
        labels = [style.label(str(n)) for n in data["input_name"].values]
        units = [str(u) for u in data["input_unit"].values]
        panels += _by_unit("input", units, labels, data["input"].values[run])
    if data.sizes["constraint"]:
        labels = [str(n).replace("_", " ") for n in data["constraint_name"].values]
        units = [str(u) for u in data["constraint_unit"].values]
        panels += _by_unit(
            "constraints (safe below 0)", units, labels, data["constraint"].values[run], zero=True
        )
    if data.sizes["signal"]:
        labels = [_signal_label(str(n)) for n in data["signal_name"].values]
        panels.append(_Panel("switching signals", "1", labels, data["signal"].values[run]))
    return panels


def _near_zero(states: Array, angles: npt.NDArray[np.int8]) -> Array:
    """The states with every angle less its full turns, as counted at the end."""
    late = states[len(states) // 2 :]
    late = late[np.isfinite(late).all(axis=1)]
    turns = np.round(np.median(late, axis=0) / (2 * np.pi)) if len(late) else 0.0
    shifted: Array = states - 2 * np.pi * np.where(angles == 1, turns, 0.0)
    return shifted


def _signal_label(name: str) -> str:
    head, _, tail = name.partition("_")
    return f"$\\sigma$ {tail.replace('_', ' ')}" if head == "sigma" else name.replace("_", " ")


def _by_unit(
    title: str, units: list[str], names: list[str], values: Array, zero: bool = False
) -> list[_Panel]:
    panels = []
    for unit in dict.fromkeys(units):
        columns = [i for i, u in enumerate(units) if u == unit]
        kind = {"m": "position", "rad": "angle", "m/s": "velocity", "rad/s": "turn rate"}
        shown = kind.get(unit, "state") if title == "state" else title
        panels.append(_Panel(shown, unit, [names[i] for i in columns], values[:, columns], zero))
    return panels
