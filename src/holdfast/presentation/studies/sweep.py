"""Parameter sweeps (campaigns) as text, and as a heat map."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter

from holdfast.analysis.simulation.sweep_table import Campaign
from holdfast.arguments import checked
from holdfast.errors import OutputError
from holdfast.execution.arrays import Array
from holdfast.presentation.figures import style

COLOURS = "viridis"
WRITTEN = 100
"""Heat maps of at most this many cells show the numbers in the cells."""

MOST_NAMES = 6


def campaign_text(
    campaign: Campaign, variable: str | None = None, files: Sequence[Path] = ()
) -> str:
    """The number of cells, the range of the variable, and its best cell."""
    said = campaign.summary(variable)
    about = campaign.variable(variable)
    data = campaign.dataset
    if campaign.is_grid:
        sizes = " x ".join(str(data.sizes[n]) for n in campaign.names)
        cells = f"{sizes} = {said['cells']:,}" if len(campaign.names) > 1 else sizes
    else:
        cells = f"{said['cells']:,}"
    cells += " cell" if said["cells"] == 1 else " cells"
    if not campaign.is_grid:
        cells += ", a Latin hypercube"
    lines = [said["title"], ""]
    over = ", ".join(campaign.keys.values())
    each = ""
    if "runs" in data:
        each = f", {int(data['runs'].max()):,} runs in each"
    lines.append(f"  {cells} over {over}{each}")
    lines.append(f"  {about.name}: {about.attrs['long_name']}")
    for word in ("least", "most"):
        if word in said:
            place = ", ".join(
                f"{campaign.keys[n]} = {v:.4g}{_unit(data[n].attrs['units'])}"
                for n, v in said[word]["at"].items()
            )
            unit = _unit(about.attrs["units"])
            lines.append(f"    {word + ':':<6} {said[word]['value']:.4g}{unit}, at {place}")
    ended = [f"{said[n]:,} {n}" for n in ("diverged", "chattered") if said.get(n)]
    if ended:
        lines.append(f"  of {said['runs']:,} runs {', '.join(ended)}")
    notes = np.unique(data["note"].values[data["refused"].values == 0])
    warned = [str(note) for note in notes if note]
    if warned:
        lines.append(f"  warnings in some cells, such as: {warned[0]}")
    if said["refused"]:
        refused = "1 cell" if said["refused"] == 1 else f"{said['refused']:,} cells"
        lines.append(f"  {refused} refused, the first: {campaign.notes[0]}")
    if "most" in said:
        lines.append(f"  reproduce     {campaign.command(said['most']['cell'])}")
    if files:
        lines += ["", f"  files in {files[0].parent}: " + ", ".join(f.name for f in files)]
    return "\n".join(lines)


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


@checked
def campaign_figure(found: Campaign, variable: str | None = None) -> Figure:
    """One variable over the swept names; refused cells are hatched.

    found: a `Campaign`. variable: one of its `dataset`.

    One name: a curve, with the interval of a share. Two: a heat map. More: one for each pair, the
    mean over the others. A sample has a dot for every cell.

    Raises `OutputError` for an unknown variable, or more than six names.

    >>> from concurrent.futures import ThreadPoolExecutor
    >>> few = {"runs": 2, "overrides": ["run.horizon=1"], "executor": ThreadPoolExecutor(1)}
    >>> table = hf.sweep("ch2-unicycle", ["k=1:2:2"], **few)
    >>> hf.campaign_figure(table, "peak_v").savefig("sweep.png")
    """
    about = found.variable(variable)
    names = found.names
    if len(names) > MOST_NAMES:
        raise OutputError(
            f"a figure over {len(names)} names", expected=f"at most {MOST_NAMES}",
            remedy="draw the table with a tool of your own",
        )  # fmt: skip
    with style.look():
        if len(names) == 1:
            return _curve(found, about)
        finite = about.values[np.isfinite(about.values)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        if high <= low:
            low, high = low - 0.5, high + 0.5
        scale = ScalarMappable(Normalize(low, high), COLOURS)
        pairs = list(combinations(names, 2))
        size = len(names) - 1
        each = 3.4 if size == 1 else min(2.6, style.WIDTH / size)
        figure, axes = plt.subplots(
            size, size, figsize=(each * size + 1.2, 0.85 * each * size + 0.5), squeeze=False,
            layout="constrained",
        )  # fmt: skip
        for axis in axes.ravel():
            axis.set_visible(False)
        for x, y in pairs:
            axis = axes[names.index(y) - 1, names.index(x)]
            axis.set_visible(True)
            _panel(axis, found, about, (x, y), scale)
            for name, put in ((x, axis.set_xlabel), (y, axis.set_ylabel)):
                put(_named(found, name))
        bar = figure.colorbar(scale, ax=axes, shrink=0.8, aspect=30)
        bar.set_label(_said(about))
        if _is_share(found, about):
            bar.formatter = PercentFormatter(1.0, symbol=" %")
        others = ", mean over the others" if size > 1 and found.is_grid else ""
        figure.suptitle(f"{found.dataset.attrs['title']}{others}", fontsize=9)
        if found.refused:
            figure.legend(
                handles=[Patch(facecolor="white", edgecolor=style.GREY, hatch="////")],
                labels=["refused"], loc="outside lower left",
            )  # fmt: skip
    return figure


def _panel(axis: Axes, campaign: Campaign, about: Any, pair: tuple[str, str], scale: Any) -> None:
    data = campaign.dataset
    x, y = (data[n].values for n in pair)
    logs = [_is_log(campaign, n) for n in pair]
    if logs[0]:
        axis.set_xscale("log")
    if logs[1]:
        axis.set_yscale("log")
    axis.grid(False)
    if not campaign.is_grid:
        good = np.isfinite(about.values)
        size = float(np.clip(2000 / max(len(x), 1), 4, 40))
        axis.scatter(x[~good], y[~good], marker="x", s=size, color=style.GREY, linewidths=0.8)
        axis.scatter(x[good], y[good], c=about.values[good], s=size, norm=scale.norm, cmap=COLOURS)
        return
    others = [n for n in campaign.names if n not in pair]
    shown = about.mean(others, skipna=True) if others else about
    values = shown.transpose(pair[1], pair[0]).values.astype(np.float64)
    edges = [_edges(v, log) for v, log in zip((x, y), logs, strict=True)]
    axis.patch.set(hatch="////", edgecolor=style.GREY, facecolor="white")
    axis.pcolormesh(*edges, values, norm=scale.norm, cmap=COLOURS, rasterized=True)
    if values.size <= WRITTEN and not others:
        share = _is_share(campaign, about)
        for row, column in np.argwhere(np.isfinite(values)):
            value = values[row, column]
            dark = scale.norm(value) < 0.6
            axis.annotate(
                f"{100 * value:.0f}" if share else f"{value:.3g}",
                (x[column], y[row]), ha="center", va="center", fontsize=6,
                color="white" if dark else style.BLACK,
            )  # fmt: skip


def _curve(campaign: Campaign, about: Any) -> Figure:
    (name,) = campaign.names
    data = campaign.dataset
    order = np.argsort(data[name].values)
    at, values = data[name].values[order], about.values[order]
    figure, axis = plt.subplots(figsize=(0.62 * style.WIDTH, 3.0), layout="constrained")
    if f"{about.name}_low" in data:
        low, high = (data[f"{about.name}_{end}"].values[order] for end in ("low", "high"))
        axis.fill_between(
            at, low, high, color=style.BLUE, alpha=0.2, linewidth=0, label="95 % interval"
        )
        figure.legend(loc="outside lower center")
    line = "-" if campaign.is_grid else ""
    axis.plot(at, values, f"o{line}", color=style.BLUE, markersize=3.5)
    for place in at[~np.isfinite(values)]:
        axis.axvline(place, color=style.GREY, linewidth=0.8, linestyle=":")
    if _is_log(campaign, name):
        axis.set_xscale("log")
    if _is_share(campaign, about):
        axis.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    axis.set_xlabel(_named(campaign, name))
    axis.set_ylabel(_said(about))
    axis.set_title(campaign.dataset.attrs["title"])
    return figure


def _edges(values: Array, log: bool) -> Array:
    """The midpoints between values, and as far beyond the first and the last."""
    places = np.log(values) if log else values
    middle = (places[1:] + places[:-1]) / 2
    edges = np.concatenate(
        [[2 * places[0] - middle[0]], middle, [2 * places[-1] - middle[-1]]]
        if middle.size
        else [places - 0.5, places + 0.5]
    )
    return np.exp(edges) if log else edges


def _is_log(campaign: Campaign, name: str) -> bool:
    return bool(campaign.dataset[name].attrs.get("spacing") == "log")


def _is_share(campaign: Campaign, about: Any) -> bool:
    return f"{about.name}_low" in campaign.dataset or about.name == "fraction"


def _named(campaign: Campaign, name: str) -> str:
    attributes = campaign.dataset[name].attrs
    return style.axis_label(str(attributes["long_name"]), str(attributes["units"]))


def _said(about: Any) -> str:
    unit = about.attrs["units"]
    return f"{about.attrs['long_name']}" + ("" if unit == "1" else f" [{unit}]")
