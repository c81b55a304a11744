"""Text and figure of a bisection: the trials, the remaining kernels, and the limit."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from holdfast.analysis.reachability.solve import Answer, Margin, Tried
from holdfast.arguments import checked
from holdfast.errors import OutputError
from holdfast.presentation.figures import style

FITS = 56
"""Characters of a title on one line."""


@checked
def margin_figure(
    values: npt.ArrayLike,
    fractions: npt.ArrayLike,
    name: str,
    unit: str = "1",
    *,
    threshold: float = 0.0,
    answers: Sequence[Answer] | None = None,
    keeps: bool = False,
) -> Figure:
    """The share of the box in the kernel over the tried bounds of a disturbance.

    values: the bounds tried, in `unit`, in any order, shape (bounds,); fractions: of the box in the
    kernel of each, 0 to 1, shape (bounds,); threshold: at or below this share a kernel counts as
    empty. The limit lies between the largest bound that leaves a kernel and the least that leaves
    none (shaded). name: of the disturbance or its bound. answers: of every bound, if the shares do
    not determine them. keeps:
    the question is whether states are kept; the share is then NaN for a bound that loses them.

    Raises `OutputError` unless there are as many shares as bounds, and at least one of each.

    >>> hf.margin_figure([0.1, 0.2], [0.5, 0.0], "current", "m/s").savefig("margin.png")
    """
    tried, left = (np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in (values, fractions))
    if tried.shape != left.shape or tried.ndim != 1 or not tried.size:
        raise OutputError(
            f"{tried.size} values and {left.size} fractions", expected="one fraction for each value"
        )
    if answers is not None and len(answers) != tried.size:
        raise OutputError(f"{len(answers)} answers to {tried.size} values", expected="one for each")
    order = np.argsort(tried)
    tried, left = tried[order], left[order]
    if answers is None:
        answers = [Answer.HELD if share > threshold else Answer.LOST for share in left]
    else:
        answers = [answers[k] for k in order]
    held, gone, unsure = (
        np.array([a is kind for a in answers])
        for kind in (Answer.HELD, Answer.LOST, Answer.UNDECIDED)
    )
    ends = np.flatnonzero(~held)
    below = tried[: ends[0]] if ends.size else tried
    lost = tried[gone & (tried > below[-1])] if below.size else tried[gone]
    says = "" if unit == "1" else f" {unit}"
    does, does_not, none = (
        ("keeps the states", "does not keep the states", "not")
        if keeps
        else ("leaves a kernel", "leaves no kernel", "none")
    )
    with style.look():
        figure, axis = plt.subplots(figsize=(0.62 * style.WIDTH, 3.0), layout="constrained")
        axis.plot(tried, left, color=style.GREY, linewidth=0.8, zorder=1)
        for chosen, marker, face, label in (
            (held, "o", style.BLUE, "the states are kept" if keeps else "a kernel is left"),
            (gone, "x" if keeps else "o", "white", "a state is lost" if keeps else "empty"),
            (unsure, "o", style.ORANGE, "undecided"),
        ):
            if chosen.any():
                axis.plot(
                    tried[chosen], np.nan_to_num(left[chosen]), marker, markerfacecolor=face,
                    label=label, color=style.BLUE, markersize=5, clip_on=False, zorder=3,
                )  # fmt: skip
        if below.size and lost.size:
            low, high = float(below[-1]), float(lost[0])
            axis.axvspan(low, high, color=style.ORANGE, alpha=0.35, zorder=0.5, label="the limit")
            title = f"up to {low:.3g}{says} {does}, {high:.3g}{says} {none}"
        elif below.size:
            title = f"up to {below[-1]:.3g}{says} {does}: no limit found"
        elif lost.size:
            title = f"{lost[0]:.3g}{says} {does_not}: no limit found"
        else:
            title = "undecided"
        break_ = "\n" if len(name) + len(title) > FITS else " "
        axis.set_title(f"{style.label(name)}:{break_}{title}")
        axis.set_xlabel(style.axis_label(name, unit))
        axis.set_ylabel("share of the box in the kernel")
        axis.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
        axis.set_ylim(0, 1.12 * max(float(np.nan_to_num(left).max()), 1e-3))
        style.add_legend(figure, axis.get_legend_handles_labels()[0])
    return figure


def margin_text(margin: Margin, files: Sequence[Path] = ()) -> str:
    """One line for every trial, and their common result."""
    unit = "" if margin.unit == "1" else f" {margin.unit}"
    until = ", for ever" if margin.forever else f", for {margin.horizon:g} s"
    if margin.key == "march.horizon":
        until = ""
    condition = "the states are kept" if margin.keeps else "a kernel is left"
    what = f"largest value for which {condition}"
    head = f"{margin.name} [{margin.unit}]"
    width = max(len(head), 10) + 2
    lines = [margin.title, "", f"  {margin.key}: {what}{until}", ""]
    lines.append(f"    {head:<{width}}share of the box  least V    simulated  steps  the set")
    for t in margin.trials:
        share = "-" if np.isnan(t.fraction) else f"{100 * t.fraction:.3g} %"
        lines.append(
            f"    {t.value:<{width}.5g}{share:<18}{t.least:<+11.3g}{f'{t.reached:.3g} s':<11}"
            f"{t.steps:<7}{_what(t)}"
        )
    lines += ["", f"  the limit      {_limit(margin, unit)}"]
    if margin.monotone:
        lines.append("  monotone       yes: a larger value only widens disturbance bounds")
    elif margin.holds_again:
        shown = ", ".join(f"{v:.4g}" for v in margin.holds_again)
        lines.append(f"  monotone       no: {shown}{unit} above it are kept too")
    else:
        lines.append("  monotone       in all trials, but not proved")
    if margin.undecided:
        shown = ", ".join(f"{v:.4g}" for v in margin.undecided)
        lines.append(
            f"  undecided      {shown}{unit}: neither lost nor converged within "
            f"{margin.horizon:g} s"
        )
    warm = sum(t.warm for t in margin.trials)
    begun = f", {warm} warm-started from the kernel of a smaller bound" if warm else ""
    steps, seconds = (sum(getattr(t, n) for t in margin.trials) for n in ("steps", "wall_time"))
    lines.append(f"  {len(margin.trials)} trials{begun}: {steps:,} steps, {seconds:.1f} s")
    if margin.settings:
        changes = " ".join(f"--set {shlex.quote(s)}" for s in margin.settings)
        lines.append(f"  reproduce      holdfast run {margin.scenario} {changes}")
    if files:
        lines += ["", f"  files in {files[0].parent}: " + ", ".join(f.name for f in files)]
    return "\n".join(lines)


def _what(tried: Tried) -> str:
    if tried.answer is Answer.UNDECIDED:
        return "undecided"
    if tried.answer is Answer.LOST:
        return "empty" if not np.isnan(tried.fraction) and tried.fraction == 0 else "lost"
    return "kept, converged" if tried.converged else "kept"


def _limit(margin: Margin, unit: str) -> str:
    low, high = margin.low, margin.high
    if low is None:
        least = margin.trials[0]
        return f"none found: {least.value:.4g}{unit} is {_what(least)} already"
    if high is None:
        bounds = ", the largest value within the bounds" if low >= margin.end else ""
        return f"none found: nothing is lost up to {low:.4g}{unit}{bounds}"
    wide = "" if margin.answered else f", wider than the tolerance {margin.tolerance:.2g}{unit}"
    return f"between {low:.4g} and {high:.4g}{unit}{wide}"
