"""Interactive figures for a browser: sets of three states, and paths."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go  # type: ignore[import-untyped]
from matplotlib.colors import to_rgb

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.simulation.result import Result
from holdfast.execution.arrays import Array
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.presentation.figures import level_sets, style
from holdfast.presentation.figures.surface import BODY, DARK, brightness, zero_surface

MOST_RUNS, MOST_PLACES = 40, 150
"""Most paths, and points of each, that are drawn, to limit the size of the page."""


def set_data(value: ValueFunction) -> dict[str, Any] | None:
    """The surface of a set of three states at its last time as a Plotly figure; None for others."""
    if len(value.names) != 3 or not value.values().max() > 0:
        return None
    axes = value.grid.axes
    corners = zero_surface(
        [level_sets.nodes(a) for a in axes], level_sets.closed(value, value.values())
    )
    points, places = np.unique(corners.reshape(-1, 3).round(4), axis=0, return_inverse=True)
    i, j, k = places.reshape(-1, 3).T
    span = np.ptp(points, axis=0)
    shades = brightness(points[np.stack([i, j, k], axis=1)], np.where(span > 0, span, 1.0))
    dark = "#" + "".join(f"{round(DARK * 255 * c):02x}" for c in to_rgb(BODY))
    body = go.Mesh3d(
        **dict(zip("xyz", points.T.tolist(), strict=True)),
        i=i.tolist(),
        j=j.tolist(),
        k=k.tolist(),
        intensity=shades.round(2).tolist(),
        intensitymode="cell",
        colorscale=[[0, dark], [1, BODY]],
        cmin=DARK,
        cmax=1,
        showscale=False,
        hoverinfo="x+y+z",
        lighting={"ambient": 1, "diffuse": 0, "specular": 0, "fresnel": 0},
    )
    titles = [_title(q.name, q.state.unit) for q in axes]
    scene: dict[str, Any] = {
        f"{letter}axis": {"title": {"text": title}}
        for letter, title in zip("xyz", titles, strict=True)
    }
    camera = {"eye": {"x": 1.5, "y": 1.5, "z": 1.2}}
    return _figure([body], scene={**scene, "aspectmode": "cube", "camera": camera})


def paths_data(result: Result, plane: Sequence[str] | None) -> dict[str, Any] | None:
    """The paths of runs in the plane, with the time at every point; None without a plane.

    The colour is that of the outcome; only the first of many runs are drawn.
    """
    data = result.arrays
    names = [str(n) for n in data["state_name"].values]
    if plane is None or not data.sizes["run"]:
        return None
    columns = [names.index(n) for n in plane]
    units = [str(data["state_unit"].values[c]) for c in columns]
    time = data["time"].values
    places = np.unique(np.linspace(0, len(time) - 1, MOST_PLACES).astype(int))
    traces: list[Any] = []
    shown: set[str] = set()
    for run in range(min(data.sizes["run"], MOST_RUNS)):
        x, y = data["state"].values[run][np.ix_(places, np.array(columns))].T
        outcome = Outcome(int(data["outcome"].values[run]))
        label = outcome.label
        kept = np.isfinite(x) & np.isfinite(y)
        traces.append(
            go.Scatter(
                x=_short(x[kept]),
                y=_short(y[kept]),
                customdata=_short(time[places][kept]),
                hovertemplate=f"run {run}, %{{customdata}} s<br>(%{{x}}, %{{y}})<extra></extra>",
                mode="lines",
                line={"width": 1.3, "color": style.OUTCOMES[outcome]},
                name=label,
                legendgroup=label,
                showlegend=label not in shown,
            )
        )
        shown.add(label)
    titles = [_title(n, u) for n, u in zip(plane, units, strict=True)]
    equal = {"scaleanchor": "x"} if units[0] == units[1] else {}
    return _figure(
        traces, xaxis={"title": {"text": titles[0]}}, yaxis={"title": {"text": titles[1]}, **equal}
    )


def _figure(traces: list[Any], **layout: Any) -> dict[str, Any]:
    """Data and layout as plain tables; the page adds the colours of its theme."""
    margin = {"l": 50, "r": 10, "t": 10, "b": 40}
    figure = go.Figure(
        traces,
        {
            **layout,
            "margin": margin,
            "template": "none",
            "paper_bgcolor": "rgba(0,0,0,0)",
            "plot_bgcolor": "rgba(0,0,0,0)",
            "legend": {"orientation": "h"},
        },
    )
    found: dict[str, Any] = json.loads(figure.to_json())
    return found


def _title(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} [{unit}]"


def _short(values: Array) -> list[float]:
    return [float(f"{v:.5g}") for v in values]
