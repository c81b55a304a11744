"""Runs among obstacles that move, judged by the distance of the hulls: who touched one, and when.

Shapely measures the distances, which shares no code with what a filter is told. Between two
records a vehicle is taken to be on the line between them, at every control sample.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
import shapely

from holdfast.analysis.simulation.files import NamedArray, NamedArrays
from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.simulate import NO_CONSTRAINT, flags, labels
from holdfast.execution.arrays import Array
from holdfast.execution.simulation.settings import Outcome

if TYPE_CHECKING:
    from holdfast.analysis.online.obstacle_slots import Parts

CONSTRAINT = "moving_obstacles"
"""The constraint of `judged`: how deep the hull is in an obstacle, below 0 outside [m]."""


class Track(Protocol):
    """An obstacle along its way: bodies as of `Obstacle`, at the way (0, 0)."""

    @property
    def name(self) -> str: ...

    @property
    def bodies(self) -> Parts: ...

    def way(self, times: Array) -> Array:
        """How far it is from there at times, shape (times,), as an array (times, 2) [m]."""


def judged(
    result: Result,
    obstacles: Sequence[Track],
    hull: Parts,
    position: tuple[str, str],
    heading: str,
    sample_time: float,
) -> Result:
    """The result with the constraint that no obstacle is touched, and with the obstacles.

    hull: its parts in the axes of the vehicle. position, heading: names of the states; an empty
    heading is that of a point. sample_time [s]: between the places that are looked at.
    """
    data = result.arrays
    time = data["time"].values
    stride = max(1, round(float(time[1] - time[0]) / sample_time)) if len(time) > 1 else 1
    fine = np.interp(np.arange((len(time) - 1) * stride + 1) / stride, np.arange(len(time)), time)
    names = [str(n) for n in data["state_name"].values]
    columns = [names.index(n) for n in (*position, *([heading] if heading else []))]
    ways = [o.way(fine) for o in obstacles]
    runs = data.sizes["run"]
    history = np.full((runs, len(time)), math.nan)
    worst, since = np.full(runs, -math.inf), np.full(runs, math.inf)
    for run in range(runs):
        pose = np.stack([np.interp(fine, time, data["state"].values[run, :, c]) for c in columns])
        depth = np.full(len(fine), -math.inf)
        for track, way in zip(obstacles, ways, strict=True):
            for body in track.bodies:
                depth = np.maximum(depth, -gaps(pose, way, hull, body))
        depth[~np.isfinite(pose).all(axis=0)] = math.nan
        history[run] = depth[::stride]
        worst[run] = np.nanmax(depth)
        if (touched := np.flatnonzero(depth > 0)).size:
            since[run] = fine[touched[0]]
    with_depth = _with_constraint(result, CONSTRAINT, "m", history, worst, since)
    return _with_tracks(with_depth, obstacles, time, position)


def gaps(
    pose: Array, way: Array, hull: Parts, body: tuple[Sequence[Sequence[float]], float]
) -> Array:
    """How far a hull is from a body at every place [m]; below 0 where they overlap.

    pose: x, y and the heading, or x and y alone, shape (2 or 3, places). way: how far the body has
    gone, shape (places, 2). The distances have the shape (places,).
    """
    outline, radius = body
    fixed = geometry(outline)
    x, y = pose[0] - way[:, 0], pose[1] - way[:, 1]
    cos, sin = (np.cos(pose[2]), np.sin(pose[2])) if len(pose) > 2 else (1.0, 0.0)
    least = np.full(len(x), math.inf)
    good = np.isfinite(x + y) & np.isfinite(cos + sin)
    for corners, around in hull:
        placed = np.stack(
            [
                np.stack([x + a * cos - b * sin, y + a * sin + b * cos], axis=-1)
                for a, b in corners
            ],
            axis=1,
        )  # fmt: skip
        placed = np.where(good[:, np.newaxis, np.newaxis], placed, 0.0)
        if len(corners) == 1:
            shapes = shapely.points(placed[:, 0])
        elif len(corners) == 2:
            shapes = shapely.linestrings(placed)
        else:
            shapes = shapely.polygons(np.concatenate([placed, placed[:, :1]], axis=1))
        apart = shapely.distance(fixed, shapes)
        for k in np.flatnonzero(apart == 0):
            apart[k] = -_overlap(fixed, shapes[k])
        least = np.minimum(least, apart - radius - around)
    return np.where(good, least, math.nan)


def _overlap(fixed: shapely.Geometry, shape: shapely.Geometry) -> float:
    """How deep a point is within a polygon, else the root of the area that two have in common."""
    for one, other in ((fixed, shape), (shape, fixed)):
        if one.geom_type == "Polygon" and other.geom_type == "Point":
            return float(one.exterior.distance(other))
    return math.sqrt(fixed.intersection(shape).area)


def geometry(corners: Sequence[Sequence[float]]) -> shapely.Geometry:
    """A point, a line or a polygon."""
    if len(corners) == 1:
        return shapely.Point(corners[0])
    return shapely.LineString(corners) if len(corners) == 2 else shapely.Polygon(corners)


def _with_constraint(
    result: Result, name: str, unit: str, values: Array, worst: Array, since: Array
) -> Result:
    """A result that is judged by one more constraint, which was evaluated beside the loop.

    values: at every recorded sample, shape (runs, samples), safe where <= 0. worst: the largest of
    each run, also between records; since [s]: when it was first violated, infinite where it was
    not, both of the shape (runs,). A run that violates it before it ended otherwise has left the
    region there.
    """
    data = result.arrays
    names = [*map(str, data["constraint_name"].values), name]
    units = [*map(str, data["constraint_unit"].values), unit]
    exit_time = data["exit_time"].values
    first = since < np.where(np.isnan(exit_time), math.inf, exit_time)
    exits = np.where(first, len(names) - 1, data["exit_constraint"].values)
    exits = exits.astype(data["exit_constraint"].values.dtype)
    outcome = np.where(first, int(Outcome.LEFT), data["outcome"].values)
    every = [NO_CONSTRAINT, *range(len(names))]
    changed = {
        "constraint": np.concatenate([data["constraint"].values, values[:, :, np.newaxis]], axis=2),
        "worst_constraint": np.column_stack([data["worst_constraint"].values, worst]),
        "exit_time": np.where(first, since, exit_time),
        "goal_time": np.where(first, math.nan, data["goal_time"].values),
        "exit_constraint": exits,
        "outcome": outcome.astype(data["outcome"].values.dtype),
        "constraint_name": labels(names),
        "constraint_unit": labels(units),
    }
    about = {
        "constraint": {
            **data["constraint"].attrs, "names": ", ".join(names), "units": ", ".join(units),
        },
        "exit_constraint": flags(exits, every, ["none", *names], "first constraint violated"),
    }  # fmt: skip
    variables = {
        key: NamedArray(v.dims, changed.get(key, v.values), about.get(key, v.attrs))
        for key, v in data.variables.items()
    }
    return Result(
        NamedArrays(variables, data.coordinates, data.attrs),
        result.scene, result.parameters, result.reference, result.system,
    )  # fmt: skip


def _with_tracks(
    result: Result, obstacles: Sequence[Track], time: Array, position: tuple[str, str]
) -> Result:
    """The result with the outlines of the obstacles and their ways, a row for each body."""
    each = [(o.name, body, o.way(time)) for o in obstacles for body in o.bodies]
    most = max(len(corners) for _, (corners, _), _ in each)
    outlines = np.full((len(each), most, 2), math.nan)
    for row, (_, (corners, _), _) in zip(outlines, each, strict=True):
        row[: len(corners)] = corners
    data = result.arrays
    more = {
        "obstacle_outline": NamedArray(
            ("obstacle", "corner", "axis"), outlines,
            {"units": "m", "long_name": "corners of an obstacle before it moves"},
        ),
        "obstacle_radius": NamedArray(
            ("obstacle",), np.array([radius for _, (_, radius), _ in each]),
            {"units": "m", "long_name": "radius around the corners of an obstacle"},
        ),
        "obstacle_way": NamedArray(
            ("obstacle", "time", "axis"), np.stack([way for *_, way in each]),
            {
                "units": "m", "names": ", ".join(position),
                "long_name": "how far an obstacle has moved",
            },
        ),
        "obstacle": NamedArray(("obstacle",), np.array([name for name, *_ in each], dtype=str), {}),
    }  # fmt: skip
    arrays = NamedArrays(
        {**data.variables, **more}, (*data.coordinates, "obstacle"), data.attrs
    )  # fmt: skip
    return Result(arrays, result.scene, result.parameters, result.reference, result.system)


def outlines_at(data: NamedArrays, k: int) -> Iterator[tuple[str, Array]]:
    """The name and the rim, shape (points, 2), of every obstacle of a result at the record k."""
    if "obstacle_outline" not in data:
        return
    rows = zip(
        data["obstacle"].values, data["obstacle_outline"].values, data["obstacle_radius"].values,
        data["obstacle_way"].values[:, k], strict=True,
    )  # fmt: skip
    for name, corners, radius, way in rows:
        body = geometry(corners[np.isfinite(corners[:, 0])] + way)
        rim = body.buffer(max(float(radius), 1e-6), quad_segs=16)
        yield str(name), np.array(rim.exterior.coords)
