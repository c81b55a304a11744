"""Text, table and figure of a tuning: the trade between costs, the gains, the conditions."""

from __future__ import annotations

import csv
import io
import math
import shlex
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from holdfast.analysis.safety.gain_conditions import JudgedCondition
from holdfast.analysis.simulation.sweep_table import COSTS, Costs, Tuning
from holdfast.arguments import checked
from holdfast.presentation.figures import style

LABELS = {
    "time": "time to the goal [s]",
    "effort": "effort: integral of (input / limit)$^2$ [s]",
    "clearance": "clearance, as a share of that at the start",
}
SHOWN = {"time": "time [s]", "effort": "effort [s]", "clearance": "clearance", "lost": "lost"}
WIDE = 34


@checked
def tuning_figure(found: Tuning) -> Figure:
    """Every admissible candidate over two of its costs, coloured by the third where there is one.

    found: a `Tuning`.

    Rings mark the candidates that no other betters in every cost. The scenario's gains and the
    chosen ones are marked, at their costs from the starts of the candidates.

    >>> few = {"candidates": 10, "runs": 1, "overrides": ["run.horizon=4"]}
    >>> gains = hf.tune("ch4-integrator", gains=["k2=0.5:1"], **few)
    >>> hf.tuning_figure(gains).savefig("gains.png")
    """
    costs = [c for c in COSTS if not math.isnan(found.shipped_costs.of(c))]
    across, up = ("time", "effort") if "time" in costs else ("clearance", "effort")
    third = next((c for c in costs if c not in (across, up)), None)
    able = [c for c in found.candidates if c.costs.lost <= found.shipped_costs.lost]
    able = able or list(found.candidates)
    with style.look():
        figure, axis = plt.subplots(figsize=(0.75 * style.WIDTH, 3.4), layout="constrained")
        x, y = (np.array([getattr(c.costs, n) for c in able]) for n in (across, up))
        colour = style.SKY if third is None else [getattr(c.costs, third) for c in able]
        dots = axis.scatter(
            x, y, c=colour, cmap=None if third is None else "viridis", s=14, linewidths=0,
            zorder=2, label="gains that meet every condition",
        )  # fmt: skip
        front = [(getattr(c.costs, across), getattr(c.costs, up)) for c in found.front]
        if front:
            places = np.array(front).T
            axis.scatter(
                places[0], places[1], facecolors="none", edgecolors=style.BLACK, s=32,
                linewidths=0.8, zorder=3, label="bettered by no other in every cost",
            )  # fmt: skip
        chosen = next(c.costs for c in found.candidates if c.gains == found.gains)
        _mark(axis, found.shipped_costs, across, up, "D", style.ORANGE, "gains of the scenario")
        _mark(axis, chosen, across, up, "*", style.RED, f"chosen, best for {found.cost}")
        if third is not None:
            figure.colorbar(dots, ax=axis, label=LABELS[third], shrink=0.9)
        if y.min() > 0 and y.max() > 20 * y.min():
            axis.set_yscale("log")
        axis.set_xlabel(LABELS[across])
        axis.set_ylabel(LABELS[up])
        axis.set_title(f"{found.title}\nmeans over {found.starts} starts, at the worst corner")
        style.add_legend(figure, axis.get_legend_handles_labels()[0])
    return figure


def _mark(
    axis: Axes, costs: Costs, across: str, up: str, marker: str, colour: str, label: str
) -> None:
    size = 12 if marker == "*" else 7
    axis.plot(
        getattr(costs, across), getattr(costs, up), marker, color=colour, markersize=size,
        markeredgecolor="white", markeredgewidth=0.7, linestyle="none", label=label, zorder=4,
    )  # fmt: skip


def tuning_table(tuning: Tuning) -> str:
    """The candidates as CSV: gains, slack of the conditions, costs, and whether on the front."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow([*tuning.gains, "slack", *COSTS, "lost", "front"])
    front = [c.gains for c in tuning.front]
    for c in tuning.candidates:
        costs = [f"{getattr(c.costs, n):.6g}" for n in (*COSTS, "lost")]
        rows.writerow([*c.gains.values(), f"{c.slack:.6g}", *costs, int(c.gains in front)])
    return text.getvalue()


def tuning_text(tuning: Tuning, files: Sequence[Path] = ()) -> str:
    """The gains, their costs beside those of the scenario, and every condition."""
    case = f", case '{tuning.case}'" if tuning.case else ""
    lines = [tuning.title, ""]
    lines.append(
        f"  best for {tuning.cost}{case}; conditions met with a margin of {100 * tuning.margin:g} "
        f"% at {_count(tuning.corners, 'corner')}"
    )
    lines += ["", f"    {'gain':<{WIDE}}{'scenario':<12}tuned"]
    for key, value in tuning.gains.items():
        unit = "" if tuning.units[key] == "1" else f" [{tuning.units[key]}]"
        lines.append(f"    {key + unit:<{WIDE}}{tuning.shipped[key]:<12.4g}{value:.4g}")
    head = f"cost, of {tuning.checked} fresh starts"
    lines += ["", f"    {head:<{WIDE}}{'scenario':<12}tuned"]
    for name, shown in SHOWN.items():
        pair = [getattr(costs, name) for costs in (tuning.before, tuning.after)]
        if not math.isnan(pair[0]):
            lines.append(f"    {shown:<{WIDE}}{pair[0]:<12.4g}{pair[1]:.4g}")
    lines += ["", f"    {'condition':<{WIDE}}{'value':<12}{'limit':<12}nearest to it"]
    lines += [_condition(c) for c in tuning.conditions]
    for c in tuning.shipped_violations:
        lines += [
            "",
            f"  the scenario's own gains violate {c.condition}: {c.value:.4g}, limit "
            f"{c.limit:.4g}, {c.where}: {c.consequence}",
        ]
    simulated = f"{len(tuning.candidates)} admissible of {tuning.tried} tried, {len(tuning.front)}"
    lines += ["", f"  {simulated} bettered by no other; seed {tuning.seed}"]
    if tuning.gains != tuning.shipped:
        changes = " ".join(f"--set {shlex.quote(s)}" for s in tuning.settings)
        lines.append(f"  reproduce      holdfast run {tuning.scenario} {changes}")
    else:
        lines.append("  no candidate is better than the scenario's own gains")
    if files:
        lines += ["", f"  files in {files[0].parent}: " + ", ".join(f.name for f in files)]
    return "\n".join(lines)


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}" + ("s" if number != 1 else "")


def _condition(c: JudgedCondition) -> str:
    name = c.condition if len(c.condition) < WIDE else c.condition[: WIDE - 4] + "..."
    return f"    {name:<{WIDE}}{c.value:<12.4g}{c.limit:<12.4g}{c.where}"
