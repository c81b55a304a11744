"""How much of something can be stood: what was tried, what was left, and where the limit is."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from holdfast.errors import OutputError
from holdfast.presentation import level_sets, style


def margin_figure(
    values: npt.ArrayLike,
    fractions: npt.ArrayLike,
    name: str,
    unit: str = "1",
    *,
    threshold: float = 0.0,
) -> Figure:
    """The share of the box in the kernel against the bound of a disturbance, as it was tried.

    values: the bounds tried, in `unit`, in any order; fractions: of the box in the kernel of each,
    0 to 1; threshold: at or below this share a kernel counts as empty. The limit lies between the
    largest bound that leaves a kernel and the least that leaves none (shaded). name: of the
    disturbance or its bound.

    Raises `OutputError` unless there are as many shares as bounds, and at least one of each.
    """
    tried, left = (np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in (values, fractions))
    if tried.shape != left.shape or tried.ndim != 1 or not tried.size:
        raise OutputError(
            f"{tried.size} values and {left.size} fractions", expected="one fraction for each value"
        )
    order = np.argsort(tried)
    tried, left = tried[order], left[order]
    kept = left > threshold
    lost = tried[~kept]
    below = tried[kept & (tried < lost[0])] if lost.size else tried[kept]
    said = "" if unit == "1" else f" {unit}"
    with style.look():
        figure, axis = plt.subplots(figsize=(0.62 * style.WIDTH, 3.0), layout="constrained")
        axis.plot(tried, left, color=style.GREY, linewidth=0.8, zorder=1)
        for chosen, face, label in (
            (kept, style.BLUE, "a kernel is left"),
            (~kept, "white", "empty"),
        ):
            if chosen.any():
                axis.plot(
                    tried[chosen], left[chosen], "o", markerfacecolor=face, label=label,
                    markeredgecolor=style.BLUE, markersize=5, clip_on=False, zorder=3,
                )  # fmt: skip
        if below.size and lost.size:
            low, high = float(below[-1]), float(lost[0])
            axis.axvspan(low, high, color=style.ORANGE, alpha=0.35, zorder=0.5, label="the limit")
            title = f"up to {low:.3g}{said} leaves a kernel, {high:.3g}{said} none"
        elif below.size:
            title = f"up to {below[-1]:.3g}{said} leaves a kernel: no limit found"
        else:
            title = f"{lost[0]:.3g}{said} leaves no kernel: no limit found"
        axis.set_title(f"{style.label(name)}: {title}")
        axis.set_xlabel(style.axis_label(name, unit))
        axis.set_ylabel("share of the box in the kernel")
        axis.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
        axis.set_ylim(0, 1.12 * max(float(left.max()), 1e-3))
        level_sets.add_legend(figure, axis.get_legend_handles_labels()[0])
    return figure
