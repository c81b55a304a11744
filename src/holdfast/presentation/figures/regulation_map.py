"""Figure of a regulation map: admissible inputs of a state, in the plane of two inputs."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from holdfast.analysis.boundary import RegulationMap
from holdfast.arguments import checked
from holdfast.errors import OutputError
from holdfast.presentation.figures import style


@checked
def regulation_map_figure(found: RegulationMap) -> Figure:
    """The bounds of the inputs, the edge of every active condition, and the regulation map.

    An arrow at each edge points to the inputs that its condition allows. Raises `OutputError`
    unless there are two inputs with bounds.
    """
    count = len(found.conditions)
    if len(found.inputs) != 2 or len(found.offsets) - count < 3:
        raise OutputError(
            f"a regulation map in {len(found.inputs)} inputs cannot be drawn",
            expected="two inputs, both bounded",
        )
    everything = replace(
        found,
        normals=found.normals[count:],
        offsets=found.offsets[count:],
        conditions=(),
        hopeless=(),
    ).vertices
    low, high = everything.min(axis=0), everything.max(axis=0)
    pad, span = 0.12 * (high - low), high - low
    with style.look():
        figure, axis = plt.subplots(figsize=(0.6 * style.WIDTH, 3.6), layout="constrained")
        axis.add_patch(Polygon(everything, facecolor="none", edgecolor=style.GREY, linestyle="--"))
        axis.plot([], [], color=style.GREY, linestyle="--", label="bounds of the inputs")
        corners = found.vertices
        if len(corners) > 2:
            axis.add_patch(Polygon(corners, facecolor=style.GREEN, alpha=0.25, edgecolor="none"))
            axis.plot([], [], color=style.GREEN, alpha=0.4, linewidth=6, label="regulation map")
        elif len(corners):
            axis.plot(
                *corners.T, color=style.GREEN, marker="o", linewidth=3, label="regulation map"
            )
        for j, name in enumerate(found.conditions):
            # in units of the figure, so that arrows stand upright on their edges
            normal, offset = found.normals[j] * span, found.offsets[j] - found.normals[j] @ low
            size = float(np.linalg.norm(normal))
            if size < 1e-12:
                continue
            foot, along = normal * offset / size**2, np.array([-normal[1], normal[0]]) / size
            middle = foot + along * float(along @ (0.5 - foot))
            ends = np.array([middle - 2 * along, middle + 2 * along]) * span + low
            colour = style.LINES[j % len(style.LINES)]
            axis.plot(*ends.T, color=colour, label=name.replace("_", " "))
            tip = middle - 0.1 * normal / size
            arrow = {"arrowstyle": "-|>", "color": colour}
            axis.annotate("", tip * span + low, middle * span + low, arrowprops=arrow)
        if not len(corners):
            reason = ", ".join(found.hopeless) or "no admissible input"
            axis.set_title(f"empty: {reason.replace('_', ' ')}")
        axis.set_xlim(low[0] - pad[0], high[0] + pad[0])
        axis.set_ylim(low[1] - pad[1], high[1] + pad[1])
        axis.set_xlabel(style.axis_label(found.inputs[0].name, found.inputs[0].unit))
        axis.set_ylabel(style.axis_label(found.inputs[1].name, found.inputs[1].unit))
        figure.legend(loc="outside lower center", ncols=2)
    return figure
