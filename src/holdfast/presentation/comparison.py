"""A comparison of laws as text and as a figure."""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from holdfast.analysis.comparison import CONFIDENCE, Comparison, Rate
from holdfast.presentation.style import LINES, WIDTH, look


def comparison_text(found: Comparison) -> str:
    """For each case a table: of how many starts each law keeps the region and reaches the goal."""
    runs = len(found.trials[0].viable)
    lines = [
        found.title,
        "",
        f"  of {runs} starts, the same for every law of a case; {found.horizon:g} s, seed "
        f"{found.seed}",
        "  viable: never leaves the region; rescued: viable, and in the goal at the end;",
        f"  in brackets Wilson's interval at {CONFIDENCE:.0%}; detour: path by the shortest found",
    ]
    width = max(len(title) for title in found.laws.values()) + 2
    for case, title in found.cases.items():
        lines += ["", f"  {title}", f"    {'':<{width}}viable               rescued              "]
        lines[-1] += "detour        switches"
        for law, name in found.laws.items():
            t = found.of(law, case)
            detours = found.detours(law, case)
            median, worst = (
                (f"{sorted(detours)[len(detours) // 2]:.2f}", f"{detours.max():.2f}")
                if len(detours)
                else ("-", "-")
            )
            switches = f"up to {t.switches[t.rescued].max()}" if t.rescued.any() else "-"
            remarks = [
                f"{count} {what}"
                for count, what in (
                    (t.chattered, "chattered"),
                    (t.diverged, "diverged"),
                    (t.relaxed, "relaxed"),
                )
                if count
            ]
            lines.append(
                f"    {name:<{width}}{_rate(found.viable(law, case))}"
                f"{_rate(found.rescued(law, case))}{median + ', ' + worst:<14}{switches:<10}"
                + ("  " + ", ".join(remarks) if remarks else "")
            )
    return "\n".join(line.rstrip() for line in lines)


def _rate(rate: Rate) -> str:
    low, high = rate.interval
    return f"{rate.value:.3f} [{low:.3f}, {high:.3f}] "


def comparison_figure(found: Comparison) -> Figure:
    """The rescue rate of every law in every case with its interval; rings: the viable fraction."""
    cases, laws = list(found.cases), list(found.laws)
    with look():
        height = 1.1 + 0.17 * len(cases) * (len(laws) + 1)
        figure, axis = plt.subplots(figsize=(WIDTH, height), layout="constrained")
        for i, law in enumerate(laws):
            colour = LINES[i % len(LINES)]
            offset = (i - (len(laws) - 1) / 2) / (len(laws) + 1)
            for j, case in enumerate(cases):
                rate = found.rescued(law, case)
                low, high = rate.interval
                y = j + offset
                axis.plot([low, high], [y, y], color=colour, linewidth=1.6, alpha=0.6)
                axis.plot(
                    rate.value,
                    y,
                    "o",
                    color=colour,
                    markersize=4,
                    clip_on=False,
                    label=found.laws[law] if j == 0 else None,
                )
                axis.plot(
                    found.viable(law, case).value,
                    y,
                    "o",
                    markerfacecolor="none",
                    markeredgecolor=colour,
                    markersize=6.5,
                    markeredgewidth=0.8,
                    clip_on=False,
                )
        for j in range(1, len(cases)):
            axis.axhline(j - 0.5, color="#dddddd", linewidth=0.6)
        axis.plot([], [], "o", color="#222222", markersize=4, label="rescued, with interval")
        axis.plot(
            [], [], "o", markerfacecolor="none", markeredgecolor="#222222", markersize=6.5,
            label="viable",
        )  # fmt: skip
        axis.set_yticks(range(len(cases)), [found.cases[c] for c in cases])
        axis.set_ylim(len(cases) - 0.5, -0.5)
        axis.set_xlim(0, 1)
        axis.xaxis.set_major_formatter(PercentFormatter(1.0))
        runs = len(found.trials[0].viable)
        axis.set_xlabel(f"share of {runs} starts")
        axis.set_title(found.title, loc="left")
        figure.legend(loc="outside lower center", ncols=2)
    return figure
