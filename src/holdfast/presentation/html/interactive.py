"""Interactive figures for a browser: sets of three states, paths, and robots on their map."""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go  # type: ignore[import-untyped]
from matplotlib.colors import to_rgb

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.simulation.result import Result
from holdfast.execution.arrays import Array
from holdfast.execution.simulation.settings import Outcome
from holdfast.maths.definitions.region import GOAL, WALLS, Circle, Segment
from holdfast.maths.expressions.numeric import evaluated, parameter_values
from holdfast.planning.obstacles import kept_points
from holdfast.presentation.figures import level_sets, style
from holdfast.presentation.figures.formation import Ground, robots_of
from holdfast.presentation.figures.paths import Frame, frame_of, framed
from holdfast.presentation.figures.surface import BODY, DARK, brightness, zero_surface
from holdfast.presentation.figures.zero_levels import Line, PlaneLevels

MOST_RUNS, OF_EACH = 40, 3
"""The first runs, and the first of each other outcome, that are drawn, to limit the page's size."""

FINENESS = 1 / 2000
"""Of the size of the plot: the farthest that a point may be from the line drawn."""

SQUAT = 0.6
"""The height of a plot in widths whose axes have different units."""

INK = style.BLACK
"""A line of this colour takes that of the text, in the dark theme too."""


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
    camera = {"eye": {"x": 1.35, "y": 1.35, "z": 0.95}, "center": {"x": 0, "y": 0, "z": -0.12}}
    shown = {**scene, "aspectmode": "cube", "camera": camera}
    return _figure([body], scene=shown, margin={"l": 0, "r": 0, "t": 0, "b": 0})


def paths_data(result: Result, plane: Sequence[str] | None) -> dict[str, Any] | None:
    """The paths of runs in the plane, with the time at every point; None without a plane.

    The colour is that of the outcome; the first runs are drawn, and the first of every outcome.
    """
    data = result.arrays
    names = [str(n) for n in data["state_name"].values]
    if plane is None or not data.sizes["run"]:
        return None
    columns = [names.index(n) for n in plane]
    units = [str(data["state_unit"].values[c]) for c in columns]
    equal = units[0] == units[1]
    outcomes = data["outcome"].values
    chosen = _chosen(outcomes)
    paths = data["state"].values[chosen][:, :, columns]
    levels = PlaneLevels.of(result, plane)
    frame = framed(paths, result, levels, equal=equal)
    lines = levels.lines((*frame.x, *frame.y))
    traces = [trace for line in lines for trace in _level(line)] + _scene(result)
    shown: set[str] = set()
    for run, path in zip(chosen, paths, strict=True):
        outcome = Outcome(int(outcomes[run]))
        dash = plotly_dash(style.OUTCOME_DASHES[outcome], 1.3)
        line = {"width": 1.3, "color": style.OUTCOMES[outcome], "dash": dash}
        traces.append(
            _path(f"run {run}", path, data["time"].values, frame, outcome.label, line)
            | {"showlegend": outcome.label not in shown}
        )
        shown.add(outcome.label)
    titles = [_title(n, u) for n, u in zip(plane, units, strict=True)]
    said = _said(len(chosen), len(outcomes), frame.beyond)
    note = levels.note(lines)
    return _plane(traces, frame, titles, f"{said}; {note}" if note else said)


def robots_data(result: Result, ground: Ground, run: int = 0) -> dict[str, Any]:
    """The paths of all robots of a run among the cells, with the time at every point."""
    robots = {name: path[:, :2] for name, path in robots_of(result, run).items()}
    cells = [np.array([*cell, cell[0]], dtype=float) for cell in ground.cells]
    corners = np.vstack([*cells, [ground.goal]])
    count = len(next(iter(robots.values())))
    frame = frame_of(corners[None], np.vstack(list(robots.values())))
    traces = [_line(cell, {"color": style.GREY, "dash": "dot", "width": 1}) for cell in cells]
    traces += _scene(result)
    for number, (name, path) in enumerate(robots.items()):
        line = {
            "width": 2,
            "color": style.LINES[number % len(style.LINES)],
            "dash": plotly_dash(style.DASHES[number % len(style.DASHES)], 2),
        }
        traces.append(_path(name, path, result.arrays["time"].values[:count], frame, name, line))
    goal = {"mode": "markers", "marker": {"symbol": "star", "size": 12, "color": style.PURPLE}}
    x, y = ground.goal
    traces.append({"type": "scatter", "x": [x], "y": [y], "name": "goal", **goal})
    return _plane(traces, frame, ["x [m]", "y [m]"], "leader and followers")


def _said(drawn: int, count: int, beyond: int) -> str:
    said = "one path" if count == 1 else f"{count} paths"
    if drawn < count:
        said = f"{drawn} of {said}"
    return f"{said}, {beyond} of which leave the frame" if beyond else said


def _chosen(outcomes: Array) -> list[int]:
    """The first runs, and the first of every outcome that is not among them."""
    first = set(range(min(len(outcomes), MOST_RUNS)))
    for outcome in set(outcomes.tolist()) - set(outcomes[:MOST_RUNS].tolist()):
        first |= set(np.flatnonzero(outcomes == outcome)[:OF_EACH].tolist())
    return sorted(first)


def _path(
    who: str, path: Array, time: Array, frame: Frame, group: str, line: dict[str, Any]
) -> dict[str, Any]:
    """One path by as few points as its look needs; what is NaN is left out."""
    finite = np.isfinite(path).all(axis=1)
    path, time = path[finite], time[finite]
    indices = kept_points(frame.scaled(path), FINENESS)
    x, y = path[indices].T
    return {
        **_line(np.empty((0, 2)), line), "x": _short(x), "y": _short(y),
        "customdata": _short(time[indices]), "name": group, "legendgroup": group,
        "hovertemplate": f"{who}, %{{customdata}} s<br>(%{{x}}, %{{y}})<extra></extra>",
        "hoverinfo": "all", "showlegend": True,
    }  # fmt: skip


def plotly_dash(pattern: Sequence[float], width: float) -> str:
    """Dashes and gaps in widths of the line, as Plotly takes them."""
    return ",".join(f"{part * width:.3g}px" for part in pattern) or "solid"


def _level(level: Line) -> list[dict[str, Any]]:
    """The pieces of a zero level, named once."""
    if level.role == GOAL:
        look = {"color": style.GREEN, "width": 1.5, "dash": plotly_dash((4, 2), 1.5)}
    else:
        pattern = style.DASHES[level.place % len(style.DASHES)]
        look = {"color": style.LIMIT, "width": 1.5, "dash": plotly_dash(pattern, 1.5)}
    name = level.name.replace("_", " ")
    named = {"name": name, "legendgroup": f"{level.role} {name}"}
    return [
        _line(piece, look) | named | {"showlegend": k == 0} for k, piece in enumerate(level.pieces)
    ]


def _line(points: Array, line: dict[str, Any]) -> dict[str, Any]:
    x, y = points.T
    return {
        "type": "scatter", "mode": "lines", "x": _short(x), "y": _short(y), "line": line,
        "showlegend": False, "hoverinfo": "skip",
    }  # fmt: skip


def _scene(result: Result) -> list[dict[str, Any]]:
    """The walls, targets and circles of the scene, each role named once."""
    values = parameter_values(result.parameters)
    looks = {
        "target": {"color": style.BLACK, "width": 5},
        **{role: {"color": style.GREY, "width": 2} for role in WALLS},
        "goals": {"color": style.BLUE, "width": 1.3, "dash": "dash"},
    }  # fmt: skip
    traces: list[dict[str, Any]] = []
    for shape in result.scene:
        if isinstance(shape, Segment):
            points = np.array([evaluated(end, values) for end in (shape.start, shape.end)])
        elif isinstance(shape, Circle):
            x, y, radius = evaluated((*shape.centre, shape.radius), values)
            turn = np.linspace(0.0, 2 * np.pi, 91)
            points = np.column_stack([x + radius * np.cos(turn), y + radius * np.sin(turn)])
        else:
            continue
        first = all(t["name"] != shape.role for t in traces)
        look = looks.get(shape.role, {"color": style.BLACK, "width": 1.3})
        named = {"name": shape.role, "legendgroup": shape.role, "showlegend": first}
        traces.append(_line(points, look) | named)
    return traces


def _plane(traces: list[Any], frame: Frame, titles: Sequence[str], says: str) -> dict[str, Any]:
    """A figure of two states; tall: its height in widths. says: what is drawn."""
    across, up = frame.size
    axes: dict[str, Any] = {
        name: {"title": {"text": title}, "range": limits, "constrain": "domain", "zeroline": False}
        for name, title, limits in zip(
            ("xaxis", "yaxis"), titles, ([*frame.x], [*frame.y]), strict=True
        )
    }
    if frame.equal:
        axes["yaxis"]["scaleanchor"] = "x"
    tall = round(up / across, 3) if frame.equal else SQUAT
    return _figure(traces, **axes, meta={"tall": tall, "says": says})


def _figure(traces: list[Any], **layout: Any) -> dict[str, Any]:
    """Data and layout as plain tables; the page adds the colours of its theme."""
    margin = {"l": 56, "r": 10, "t": 34, "b": 44}
    figure = go.Figure(
        traces,
        {
            "margin": margin,
            **layout,
            "template": "none",
            "paper_bgcolor": "rgba(0,0,0,0)",
            "plot_bgcolor": "rgba(0,0,0,0)",
            "legend": {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom"},
        },
    )
    tables: dict[str, Any] = json.loads(figure.to_json())
    return tables


def _title(name: str, unit: str) -> str:
    """The name with its unit: psi -> the Greek letter, x1 -> x with a subscript."""
    head, _, tail = name.partition("_")
    if not tail and (numbered := re.fullmatch(r"([A-Za-z]+?)(\d+|[LF])", name)):
        head, tail = numbered.groups()
    try:
        shown = unicodedata.lookup(f"GREEK SMALL LETTER {head.upper()}")
    except KeyError:
        shown = head
    shown = f"{shown}<sub>{tail}</sub>" if tail else shown
    return shown if unit == "1" else f"{shown} [{unit}]"


def _short(values: Array) -> list[float]:
    return [float(f"{v:.5g}") for v in values]
