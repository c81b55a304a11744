"""Stationary shapes in the plane: walls, targets, obstacles, sets of goals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle as CirclePatch

from holdfast.maths.definitions.region import Circle, Segment, Shape
from holdfast.maths.expressions.numeric import evaluated, parameter_values
from holdfast.presentation.figures import style


def draw_fixed(axis: Axes, scene: Iterable[Shape], parameters: Mapping[str, float] | None) -> None:
    """The segments and circles of a scene, each role labelled; cones belong to a path."""
    values = parameter_values(parameters)
    for shape in scene:
        drawn = _fixed_style(shape.role)
        if isinstance(shape, Segment):
            (x0, y0), (x1, y1) = (evaluated(p, values) for p in (shape.start, shape.end))
            axis.plot([x0, x1], [y0, y1], label=shape.role, solid_capstyle="butt", **drawn)
        elif isinstance(shape, Circle):
            x, y, radius = evaluated((*shape.centre, shape.radius), values)
            axis.add_patch(CirclePatch((x, y), radius, fill=False, **drawn))
            axis.plot([], [], label=shape.role, **drawn)


def labelled(axis: Axes) -> list[Artist]:
    """The legend entries of a panel, without those outside its limits."""
    return [
        handle
        for handle in axis.get_legend_handles_labels()[0]
        if not (isinstance(handle, Line2D) and len(handle.get_path()))
        or handle.get_path().get_extents().overlaps(axis.viewLim)
    ]


def seen_from(x: float, y: float, heading: float, corners: Any) -> Any:
    """The corners (ahead, left), shape (n, 2), of a view from a pose, in the plane."""
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    return (x, y) + corners[:, :1] * ahead + corners[:, 1:] * left


def _fixed_style(role: str) -> dict[str, Any]:
    return {
        "target": {"color": style.BLACK, "linewidth": 4.5, "zorder": 5},
        "wall": {"color": style.GREY, "linewidth": 1.5, "zorder": 2},
        "goals": {"color": style.PURPLE, "linewidth": 1.0, "linestyle": "--", "zorder": 2},
    }.get(role, {"color": style.BLACK, "linewidth": 1.2, "zorder": 2})
