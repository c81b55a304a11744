"""Text and figure of an identification: the fit, the numbers, and what is left."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from holdfast.analysis.identification.fit import (
    AT_LIMIT,
    IDENTIFIED,
    WIDE,
    Estimate,
    Identified,
)
from holdfast.arguments import checked
from holdfast.presentation.figures import style

_COLOURS = {IDENTIFIED: style.BLUE, WIDE: style.ORANGE, AT_LIMIT: style.RED}


@checked
def identification_figure(found: Identified) -> Figure:
    """One page: each measured signal and the fit, the numbers with intervals, what is left.

    found: an `Identified`.

    The intervals are drawn in parts of their numbers. Of what is unexplained each dot is a window,
    of the log or of the second log; the lines are the bound.
    """
    signals = list(found.measured)
    left = found.unexplained
    rows = max(math.ceil(len(signals) / 2), 1)
    with style.look():
        figure = plt.figure(figsize=(style.WIDTH, 1.35 * rows + 4.4), layout="constrained")
        upper, lower = _halves(figure, 2, 1, height_ratios=[1.35 * rows, 4.4])
        axes = upper.subplots(rows, 2, sharex=True, squeeze=False)
        units = {q.name: q.unit for q in found.system.states}
        for axis, name in zip(axes.flat, signals, strict=False):
            _signal(axis, name, units.get(name, ""), found.measured[name], found.noise[name])
        for axis in axes.flat[len(signals) :]:
            axis.set_visible(False)
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
        axes[0, 0].legend(
            loc="lower left", bbox_to_anchor=(0, 0.98), ncols=2, fontsize="small", borderpad=0
        )
        upper.suptitle(f"{found.log}: measured, and the model in windows of {found.window:.3g} s")
        numbers, rest = _halves(lower, 1, 2, width_ratios=[1, 1.1])
        _numbers(numbers.subplots(), found)
        for k, axis in enumerate(np.atleast_1d(rest.subplots(len(left.names), 1, sharex=True))):
            _left(axis, found, k)
            axis.set_xlabel("time of the window [s]" if k == len(left.names) - 1 else "")
        rest.suptitle(f"unexplained rates in windows of {left.length:.3g} s, bound")
    return figure


def _halves(figure: Any, rows: int, columns: int, **sizes: Any) -> tuple[Any, Any]:
    first, second = figure.subfigures(rows, columns, **sizes)
    return first, second


def _signal(axis: Axes, name: str, unit: str, series: Any, noise: float) -> None:
    time, measured, predicted = series
    axis.plot(time, measured, ".", color=style.GREY, markersize=3, label="measured")
    breaks = np.flatnonzero(np.diff(time) > 10 * np.median(np.diff(time))) + 1
    shown = np.insert(predicted, breaks, np.nan)
    axis.plot(
        np.insert(time, breaks, np.nan), shown, color=style.BLUE, linewidth=0.8, label="model"
    )
    axis.set_ylabel(f"{name} [{unit}]")
    axis.set_title(f"noise {noise:.2g} {unit}", loc="right", fontsize="x-small", pad=2)


def _numbers(axis: Axes, identified: Identified) -> None:
    """Each interval in parts of its number; beside its name the number now and before."""
    shown = [e for e in identified.parameters if not math.isnan(e.low) and e.value]
    narrow = [abs(e.half_width / e.value) for e in shown if e.status == IDENTIFIED]
    most = 130 * max(narrow, default=1.0)
    for k, e in enumerate(shown):
        half = 100 * abs(e.half_width / e.value)
        colour = _COLOURS.get(e.status, style.BLUE)
        axis.plot([-half, half], [k, k], color=colour, linewidth=2, solid_capstyle="butt")
        axis.plot(0, k, "o", color=colour, markersize=3)
    axis.set_yticks(
        range(len(shown)), [f"{e.name} {e.value:.3g} (was {e.before:.3g})" for e in shown]
    )
    axis.tick_params(axis="y", labelsize="small")
    axis.invert_yaxis()
    axis.set_xlim(-most, most)
    axis.set_xlabel("interval, % of the number")
    axis.set_title(f"{100 * identified.level:g} % intervals")


def _left(axis: Axes, identified: Identified, k: int) -> None:
    left, second = identified.unexplained, identified.held_out
    origin = left.start[0]
    axis.plot(
        left.start - origin, left.value[:, k], ".", color=style.BLUE, markersize=3, label="log"
    )
    if second is not None:
        start = second.needed.start
        axis.plot(
            start - start[0], second.needed.value[:, k], ".", color=style.ORANGE, markersize=3,
            label="second log",
        )  # fmt: skip
    for end in (left.low[k], left.high[k]):
        axis.axhline(end, color=style.RED, linewidth=0.8)
    axis.set_ylabel(f"{left.names[k]} [{left.units[k]}]")
    if k == 0:
        axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, fontsize="small")


def identification_text(
    identified: Identified,
    files: Sequence[Path] = (),
    redrawn: Mapping[str, Any] | None = None,
) -> str:
    """Every number with its interval and its status, what is left, and the verdict."""
    level = f"{100 * identified.level:g} %"
    lines = [f"{identified.system.name} from {identified.log}", ""]
    lines += [
        f"  {identified.windows} windows of {identified.window:.3g} s; {identified.left_out:.3g} s "
        "are in none (gaps, remainders)",
        *(f"  repaired       {r}" for r in identified.repairs),
        "  noise          " + ", ".join(f"{n} {v:.2g}" for n, v in identified.noise.items()),
        f"  outliers       {100 * identified.outliers:.2g} % of the measurements count less",
        "",
        f"    {'parameter':<24}{'before':<12}{'now':<12}{level + ' interval':<26}",
    ]
    lines += [_row(e) for e in (*identified.parameters, *identified.disturbances)]
    lines += [f"  NOTE: {remark}" for remark in identified.remarks]
    for tie in identified.ties:
        lines.append(f"  {tie}: the first of them is held")
    for e in identified.parameters:
        if e.manoeuvre:
            lines.append(f"  {e.name}: {e.manoeuvre}")
    left = identified.unexplained
    lines += [
        "",
        f"  left unexplained, as rates constant in {left.length:.3g} s ({len(left.start)} windows)",
        f"    {'rate of':<24}{'from':<12}{'to':<12}by noise alone",
    ]
    for n, u, a, b, share in zip(
        left.names, left.units, left.low, left.high, left.noise_share, strict=True
    ):
        lines.append(f"    {f'{n} [{u}]':<24}{a:<12.4g}{b:<12.4g}{100 * share:.0f} % of the spread")
    lines += ["", f"  {identified.verdict}"]
    if redrawn is not None:
        wide = max(len(row["what"]) for row in redrawn["answers"]) + 2
        lines += ["", f"    {'scenario':<{wide}}{'before':<14}now"]
        for row in redrawn["answers"]:
            of = "" if row["of"] is None else f" of {row['of']:g}"
            lines.append(f"    {row['what']:<{wide}}{row['before']:<14.4g}{row['after']:.4g}{of}")
        if redrawn["no_margin"]:
            lines.append(f"    no margin: {redrawn['no_margin']}")
        if redrawn["not_counted"]:
            names = ", ".join(redrawn["not_counted"])
            lines.append(f"  NOT counted by the scenario, which has no rate of it: {names}")
    if files:
        lines += ["", f"  files in {files[0].parent}: " + ", ".join(f.name for f in files)]
    return "\n".join(lines)


def _row(e: Estimate) -> str:
    name = f"{e.name} [{e.unit}]" if e.unit != "1" else e.name
    interval = "held" if math.isnan(e.low) else f"{e.low:.4g} to {e.high:.4g}"
    remark = "" if e.status == IDENTIFIED else f"{e.status}: {e.why}" if e.why else e.status
    return f"    {name:<24}{e.before:<12.4g}{e.value:<12.4g}{interval:<26}{remark}".rstrip()
