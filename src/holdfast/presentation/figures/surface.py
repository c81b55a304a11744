"""Surface of a set of three states, thesis figures 7.7 and 7.9."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import checked
from holdfast.errors import OutputError
from holdfast.execution.arrays import Array
from holdfast.presentation.figures import level_sets, style
from holdfast.presentation.figures.value_function import check_same_states, told, where

BODY, OTHER = "#7cc0e6", "#c4c4c4"
DARK = 0.4
_LIGHT = np.array([-0.3, -0.6, 0.75]) / np.linalg.norm([-0.3, -0.6, 0.75])
_OUTSIDE = -1e12


@checked
def surface_figure(
    value: ValueFunction,
    *,
    at: Mapping[str, float] | None = None,
    others: Mapping[str, ValueFunction] | None = None,
    label: str = "in the set",
    view: tuple[float, float] = (25.0, -60.0),
) -> Figure:
    """The surface of the set in three states, at its last time; the others first, in grey.

    at: state -> its fixed value, in its unit, for all but three states. others: label -> value
    function of the same states, each in its own panel. label: of the set itself. view: elevation
    and azimuth of the eye [deg]. If the set continues beyond the grid, it is cut flat there. Thesis
    figures 7.7 and 7.9.

    Raises `OutputError` unless three states remain, `SimulationError` for a state fixed outside
    the grid.

    >>> place = hf.grid(robot, {"x": (-2, 2), "y": (-2, 2), "psi": (-np.pi, np.pi)}, 11)
    >>> near = hf.Region("near", robot.states[:1], (hf.Inequality("far", abs(x) - 1, "m"),))
    >>> hf.surface_figure(hf.viability_kernel(robot, near, place, 0.2)).savefig("surface.png")
    """
    others, held = dict(others or {}), {n: float(v) for n, v in (at or {}).items()}
    check_same_states(value, others)
    body = value.slice(**held)
    if len(body.names) != 3:
        raise OutputError(
            f"the states to draw are: {', '.join(body.names) or 'none'}",
            expected="three",
            remedy="fix the others (at)",
        )
    with style.look():
        panels = {name: (other.slice(**held), OTHER) for name, other in others.items()}
        panels[label] = (body, BODY)
        columns = min(3, len(panels))
        rows = -(-len(panels) // columns)
        width = style.WIDTH * (0.62, 1.0)[columns > 1]
        figure = plt.figure(figsize=(width, rows * 0.78 * width / columns + 0.6))
        figure.set_layout_engine("constrained")
        bodies = {
            name: zero_surface(
                [level_sets.nodes(a) for a in shown.grid.axes],
                level_sets.closed(shown, shown.values()),
            )
            for name, (shown, _) in panels.items()
        }
        limits = _limits(body, np.concatenate(list(bodies.values())))
        for k, (name, (shown, colour)) in enumerate(panels.items()):
            axis = figure.add_subplot(rows, columns, k + 1, projection="3d")
            extent = level_sets.extent(np.asarray(shown.values()))
            axis.set_title(name + (f" ({extent})" if extent else ""))
            _draw_body(axis, bodies[name], limits[1] - limits[0], colour)
            for q, letter, low, high in zip(body.grid.axes, "xyz", *limits, strict=True):
                said = style.axis_label(q.name, q.state.unit)
                axis.set(**{f"{letter}lim": (low, high), f"{letter}label": said})
                places = MaxNLocator(4, steps=[1, 2, 5, 10])
                getattr(axis, f"{letter}axis").set_major_locator(places)
            axis.view_init(*view)
            axis.set_box_aspect(None, zoom=0.88)
        figure.suptitle(told(value) + ("\n" + where(value, held) if held else ""), fontsize=9)
    return figure


def _limits(value: ValueFunction, faces: Array) -> Array:
    """Low and high of every state: around all bodies, or of the grid without any body."""
    if not len(faces):
        return np.array([[a.low, a.high] for a in value.grid.axes]).T
    low, high = faces.min(axis=(0, 1)), faces.max(axis=(0, 1))
    room = 0.06 * (high - low)
    return np.array([low - room, high + room])


def _draw_body(axis: Axes3D, faces: Array, span: Array, colour: str) -> None:
    """The triangles, bright where they face the light; rasterized in vector files."""
    if not len(faces):
        return
    colours = np.array(to_rgb(colour)) * brightness(faces, span)[:, None]
    axis.add_collection3d(
        Poly3DCollection(
            faces, facecolors=colours, edgecolors=colours, linewidths=0.1, rasterized=True
        )
    )


def brightness(faces: Array, span: Array) -> Array:
    """Brightness of triangles, DARK to 1, in states scaled by `span`; both sides are lit. faces:
    shape (triangles, 3, states). span: shape (states,). The result has the shape (triangles,)."""
    one, two = ((faces[:, k] - faces[:, 0]) / span for k in (1, 2))
    normal = np.cross(one, two)
    size = np.linalg.norm(normal, axis=1)
    size[size == 0.0] = 1.0
    shade: Array = DARK + (1 - DARK) * np.abs(normal @ _LIGHT) / size
    return shade


def zero_surface(nodes: list[Array], values: Array) -> Array:
    """Triangles of shape (count, 3 corners, 3 states) around { V > 0 }, cut flat at the grid's end.

    Marching tetrahedra: every cell is split into six about its diagonal. In each V is linear, and
    the zero level is one triangle or two (A. Doi, A. Koide, IEICE Transactions E74, 1991).
    """
    table = np.pad(values, 1, constant_values=_OUTSIDE)
    places = np.stack(np.meshgrid(*(np.pad(n, 1, "edge") for n in nodes), indexing="ij"), axis=-1)
    triangles = [np.empty((0, 3, 3))]
    for order in permutations(range(3)):
        corners = np.cumsum([np.zeros(3, dtype=int), *np.eye(3, dtype=int)[list(order)]], axis=0)
        cuts = [
            tuple(slice(c, n - 1 + c) for c, n in zip(corner, table.shape, strict=True))
            for corner in corners
        ]
        v = np.stack([table[cut].ravel() for cut in cuts], axis=1)
        crossed = (v > 0).any(axis=1) & (v <= 0).any(axis=1)
        v = v[crossed]
        p = np.stack([places[cut].reshape(-1, 3)[crossed] for cut in cuts], axis=1)
        first = np.argsort(v <= 0, axis=1, kind="stable")  # the corners inside come first
        v = np.take_along_axis(v, first, axis=1)
        p = np.take_along_axis(p, first[:, :, None], axis=1)
        inside = (v > 0).sum(axis=1)
        for count, edges in _TRIANGLES:
            w, q = v[inside == count], p[inside == count]
            shares = [(w[:, a] / (w[:, a] - w[:, b]))[:, None] for a, b in edges]
            ends = zip(edges, shares, strict=True)
            cut = [q[:, a] + s * (q[:, b] - q[:, a]) for (a, b), s in ends]
            triangles.append(np.stack(cut, axis=1))
    return np.concatenate(triangles)


_TRIANGLES = (
    (1, ((0, 1), (0, 2), (0, 3))),
    (2, ((0, 2), (0, 3), (1, 3))),
    (2, ((0, 2), (1, 3), (1, 2))),
    (3, ((0, 3), (1, 3), (2, 3))),
)
"""By number of corners inside: the edges, from inside to outside, that a triangle cuts."""
