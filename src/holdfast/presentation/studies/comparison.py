"""A comparison of laws as text and as a figure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from holdfast.analysis.simulation.law_comparison import CONFIDENCE, Comparison, Rate, Trial
from holdfast.arguments import checked
from holdfast.presentation.figures.style import LINES, WIDTH, look


def comparison_text(comparison: Comparison) -> str:
    """A table for each case: rates at which each law keeps the region and reaches the goal."""
    runs = len(comparison.trials[0].viable)
    lines = [
        comparison.title,
        "",
        f"  of {runs} starts, the same for every law of a case; {comparison.horizon:g} s, seed "
        f"{comparison.seed}",
        "  viable: never leaves the region"
        + ("; rescued: viable, and in the goal at the end;" if comparison.to_goal else ";"),
        f"  in brackets Wilson's interval at {CONFIDENCE:.0%}"
        + ("; detour: path length over the shortest found" if comparison.to_goal else ""),
    ]
    if comparison.references:
        outcome = "rescued" if comparison.to_goal else "viable"
        lines.append(
            f"  inside kernel: {outcome} of the starts inside a viability kernel;"
            " outside kernel: viable of those outside"
        )
    width = max(len(title) for title in comparison.laws.values()) + 2
    for case, title in comparison.cases.items():
        lines += ["", f"  {title}", *_judged(comparison, case)]
        rows = [_row(comparison, law, case) for law in comparison.laws]
        wide = [max(map(len, (name, *(r[name] for r in rows)))) + 3 for name in rows[0]]
        lines.append("    " + " " * width + _columns(rows[0], wide))
        for (law, name), row in zip(comparison.laws.items(), rows, strict=True):
            remarks = ", ".join(_remarks(comparison.of(law, case)))
            lines.append(f"    {name:<{width}}{_columns(row.values(), wide)}{remarks}")
    return "\n".join(line.rstrip() for line in lines)


def _judged(comparison: Comparison, case: str) -> list[str]:
    """The kernel's verdict on the starts of a case, or the reason why it has none."""
    if case in comparison.unjudged:
        return [f"    no reference kernel: {comparison.unjudged[case]}"]
    if case not in comparison.references:
        return []
    r = comparison.references[case]
    lasts = f"for {r.horizon:g} s" if isfinite(r.horizon) else "for ever"
    lines = [
        f"    kernel of {r.kernel}: {r.inside.sum()} starts inside ({lasts}), "
        f"{r.given_up.sum()} outside, by more than {r.margin:.3g} {r.unit}"
    ]
    if beyond := int(np.isnan(r.value).sum()):
        lines.append(f"    {beyond} starts are beyond its grid")
    return lines


def _row(comparison: Comparison, law: str, case: str) -> dict[str, str]:
    """The columns of a law in a case."""
    t = comparison.of(law, case)
    row = {"viable": _rate(comparison.viable(law, case))}
    if comparison.to_goal:
        row["rescued"] = _rate(comparison.rescued(law, case))
    if case in comparison.references:
        row["inside kernel"] = _rate(comparison.of_kernel(law, case))
        row["outside kernel"] = _rate(comparison.of_given_up(law, case))
    if comparison.to_goal:
        detours = sorted(comparison.detours(law, case))
        middle = len(detours) // 2
        row["detour"] = f"{detours[middle]:.2f}, {detours[-1]:.2f}" if detours else "-, -"
    row["switches"] = f"up to {t.switches[t.rescued].max()}" if t.rescued.any() else "-"
    return row


def _columns(cells: Iterable[str], wide: Sequence[int]) -> str:
    return "".join(f"{cell:<{w}}" for cell, w in zip(cells, wide, strict=True))


def _remarks(t: Trial) -> list[str]:
    counts = {"chattered": t.chattered, "diverged": t.diverged, "relaxed": t.relaxed}
    remarks = [f"{count} {what}" for what, count in counts.items() if count]
    if t.vertices:
        least = min(t.vertices, key=lambda v: v["viable"])
        share = f"{least['viable']} of {least['runs']} or more"
        remarks.append(f"{share} viable at each of {len(t.vertices)} vertices")
    return remarks


def _rate(rate: Rate | None) -> str:
    if rate is None:
        return "-"
    low, high = rate.interval
    return f"{rate.value:.3f} [{low:.3f}, {high:.3f}]"


MARKS: dict[str, dict[str, Any]] = {
    "rescued": {"marker": "o", "markersize": 4},
    "viable": {
        "marker": "o", "markersize": 6.5, "markerfacecolor": "none", "markeredgewidth": 0.8,
    },
    "of starts inside the kernel": {"marker": "D", "markersize": 4},
    "of starts outside the kernel": {"marker": "x", "markersize": 4.5, "markeredgewidth": 1.0},
}  # fmt: skip
"""The markers of the shares in the figure."""


@checked
def comparison_figure(found: Comparison) -> Figure:
    """The rescue rate of every law in every case with its interval; rings: the viable fraction.

    found: a `Comparison`.

    Without a goal these are the same, and the rings have the interval. With a reference kernel,
    diamonds with an interval: the share of the starts inside the kernel; crosses: the share of
    those outside that stayed nevertheless.

    >>> few = {"overrides": ["run.horizon=0.5"], "runs": 1}
    >>> rescue = hf.compare("wheeled_camera", ["wheeled_camera"], **few)
    >>> hf.comparison_figure(rescue).savefig("rescue.png")
    """
    cases, laws = list(found.cases), list(found.laws)
    shown = {case: _shares(found, laws, case) for case in cases}
    precise = ("rescued" if found.to_goal else "viable", "of starts inside the kernel")
    with look():
        height = 1.1 + 0.17 * len(cases) * (len(laws) + 1)
        figure, axis = plt.subplots(figsize=(WIDTH, height), layout="constrained")
        for i, law in enumerate(laws):
            colour = LINES[i % len(LINES)]
            offset = (i - (len(laws) - 1) / 2) / (len(laws) + 1)
            axis.plot([], [], "o", color=colour, markersize=4, label=found.laws[law])
            for j, case in enumerate(cases):
                for what, rates in shown[case].items():
                    if (rate := rates[i]) is None:
                        continue
                    y = j + offset
                    if what in precise:
                        axis.plot(rate.interval, [y, y], color=colour, linewidth=1.6, alpha=0.6)
                    mark = {"color": colour, "clip_on": False, "linestyle": "none", **MARKS[what]}
                    axis.plot(rate.value, y, **mark)
        for j in range(1, len(cases)):
            axis.axhline(j - 0.5, color="#dddddd", linewidth=0.6)
        for what in dict.fromkeys(what for case in cases for what in shown[case]):
            label = what + (", with interval" if what in precise else "")
            axis.plot([], [], color="#222222", linestyle="none", label=label, **MARKS[what])
        axis.set_yticks(range(len(cases)), [found.cases[c] for c in cases])
        axis.set_ylim(len(cases) - 0.5, -0.5)
        axis.set_xlim(0, 1)
        axis.xaxis.set_major_formatter(PercentFormatter(1.0))
        runs = len(found.trials[0].viable)
        judged = ", and of starts inside or outside the kernel" if found.references else ""
        axis.set_xlabel(f"share of {runs} starts{judged}")
        axis.set_title(found.title, loc="left")
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def _shares(comparison: Comparison, laws: Sequence[str], case: str) -> dict[str, list[Rate | None]]:
    """Label of each drawn share of a case -> the rate of every law."""
    shares: dict[str, Any] = {"viable": comparison.viable}
    if comparison.to_goal:
        shares = {"rescued": comparison.rescued, **shares}
    if case in comparison.references:
        shares["of starts inside the kernel"] = comparison.of_kernel
        shares["of starts outside the kernel"] = comparison.of_given_up
    return {what: [rate(law, case) for law in laws] for what, rate in shares.items()}
