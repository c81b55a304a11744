"""A map of occupied cells: obstacles for a filter, polygons for a kernel, distances.

The distance to the occupied cells is exact at every corner of a cell: the nearest point of a square
to a corner of the lattice is a corner too, so that the Euclidean distance transform of the corners
(scipy.ndimage) is the distance D to the squares. Between corners it is interpolated, with the
weights w_i of the corners c_i of the cell of p, I(p) = sum of w_i D(c_i). Let q be the point of the
squares that is nearest to p. Inside a side of a square, all c_i are no farther from that side than
their distance along its normal, and I(p) <= D(p). Else q is a corner of the lattice, and

    I(p) - D(p) <= sum of w_i |c_i - q| - |p - q| <= (2 - sqrt 2) / 4 cells

with the most at the middle of a cell of which q is a corner. D(p) - I(p) <= sqrt(1 / 2) cells, as
the slope of D is 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self, overload

import numpy as np
import numpy.typing as npt
import shapely
from scipy.ndimage import distance_transform_edt

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array, Truths
from holdfast.planning.map_files import read_map
from holdfast.planning.moving_obstacles import Obstacle
from holdfast.planning.outlines import (
    bodies_of,
    enclosing,
    outlines,
    rectangles,
    uncovered,
)

Unknown = Literal["occupied", "free"]

TOO_FAR = (2 - math.sqrt(2)) / 4
"""By how much an interpolated distance is above the exact one, in cells, at most."""


class OccupancyMap:
    """A map of occupied cells, in place of known obstacles: what is near it gives to a filter.

    cells: shape (rows, columns), the first row at the smallest y; true where occupied, or occupancy
    in percent as of nav_msgs/OccupancyGrid: 0 to 100, -1 unknown. resolution [m]: the side of a
    cell. origin: x [m], y [m] and yaw [rad] of the outer corner of the first cell. unknown: whether
    an unknown cell, and what is outside the map, counts as "occupied" or as "free".
    occupied_thresh, free_thresh: a cell is occupied from the one share on, free below the other,
    and unknown between.

    Raises `DefinitionError` for cells that are none, a resolution that is not above 0, an origin
    that is not finite, and thresholds that are not in order.

    >>> room = hf.OccupancyMap([[100, 100, 100], [100, 0, 0], [100, 0, 0]], 0.5, unknown="free")
    >>> room.distance([[1.25, 0.75]]).round(3).tolist()
    [0.25]
    >>> [obstacle.name for obstacle in room.near([1.0, 1.0], within=0.6)]
    ['body 1 of the map, at (0.63, 0.63)']
    """

    @checked
    def __init__(
        self,
        cells: npt.ArrayLike,
        resolution: float,
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        unknown: Unknown = "occupied",
        occupied_thresh: float = 0.65,
        free_thresh: float = 0.25,
    ) -> None:
        if not (math.isfinite(resolution) and resolution > 0):
            raise DefinitionError(
                f"the resolution of the map is {resolution:g}", expected="m, above 0"
            )
        if len(origin) != 3 or not all(math.isfinite(x) for x in origin):
            raise DefinitionError(
                f"the origin of the map is {tuple(origin)!r}"[:80], expected="finite (x, y, yaw)"
            )
        if not 0 <= free_thresh <= occupied_thresh <= 1:
            raise DefinitionError(
                f"free_thresh is {free_thresh:g} and occupied_thresh {occupied_thresh:g}",
                expected="0 <= free_thresh <= occupied_thresh <= 1",
            )
        self.resolution, self.unknown = float(resolution), unknown
        x, y, yaw = (float(v) for v in origin)
        self.origin = x, y, yaw
        self._thresholds = float(occupied_thresh), float(free_thresh)
        within = self._occupied(cells)
        if not within.size:
            raise DefinitionError(
                f"the map has the shape {within.shape}", expected="a cell or more"
            )
        self._cells: Truths = np.full([n + 2 for n in within.shape], unknown == "occupied")
        """With a border of what is outside."""
        self._cells[1:-1, 1:-1] = within
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        self._axes: Array = resolution * turn
        self._corner: Array = np.array([x, y]) - self._axes @ [1.0, 1.0]
        self._field: Array | None = None
        self._by_outline: dict[bytes, list[shapely.Polygon]] = {}
        self._bodies: list[shapely.Polygon] | None = None
        self._tree: Any = None
        self._obstacles: list[Obstacle | None] = []

    @classmethod
    @checked
    def from_file(cls, path: str | Path, *, unknown: Unknown = "occupied") -> Self:
        """The map of a map_server file, YAML with its PGM or PNG image.

        unknown: as of the class. Raises `DefinitionError` for a file that cannot be read, lacks a
        key, or has a number that cannot be.

        >>> flat = hf.OccupancyMap.from_file("examples/rooms.yaml")
        >>> flat.shape, flat.resolution
        ((200, 200), 0.1)
        """
        cells, about = read_map(path)
        try:
            return cls(cells, unknown=unknown, **about)
        except DefinitionError as error:
            raise DefinitionError(
                f"{path}: {error.cause}", expected=error.expected, remedy=error.remedy
            ) from None

    @classmethod
    @checked
    def from_distances(
        cls,
        distances: npt.ArrayLike,
        resolution: float,
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        unknown: Unknown = "occupied",
    ) -> Self:
        """The map of a distance field: a cell is occupied if an obstacle may be in it.

        distances [m]: at the middles of the cells, shape (rows, columns), up to 0 in obstacles; NaN
        is unknown. resolution, origin, unknown: as of the class. A cell whose middle is farther
        from all obstacles than its corners is free. Raises `DefinitionError` as the class does.

        >>> hf.OccupancyMap.from_distances([[0.0, 1.0, 2.0]], 1.0).occupied([[1.5, 0.5]])
        array([False])
        """
        field = _numbers(distances)
        in_it = np.where(field <= resolution * math.sqrt(0.5), 100, 0)
        return cls(np.where(np.isnan(field), -1, in_it), resolution, origin, unknown=unknown)

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of rows and columns."""
        rows, columns = self._cells.shape
        return rows - 2, columns - 2

    @property
    def cells(self) -> Truths:
        """A copy of the occupied cells, shape (rows, columns)."""
        return self._cells[1:-1, 1:-1].copy()

    def __repr__(self) -> str:
        rows, columns = self.shape
        return (
            f"<OccupancyMap of {rows} x {columns} cells of {self.resolution:g} m, "
            f"{int(self.cells.sum())} occupied>"
        )

    @checked
    def update(self, patch: npt.ArrayLike, row: int = 0, column: int = 0) -> None:
        """Replace cells in place: those of the patch, from a row and a column of the map on.

        patch: cells as of the class, shape (rows, columns). Distances are computed again where the
        patch may change them, and bodies along the outlines that it changes. Raises
        `DefinitionError` for a patch that is not inside the map.

        >>> flat = hf.OccupancyMap.from_file("examples/rooms.yaml")
        >>> flat.update([[100, 100], [100, 100]], row=50, column=20)
        >>> flat.occupied([[2.05, 5.05]])
        array([ True])
        """
        cells = self._occupied(patch)
        (rows, columns), (height, width) = self.shape, cells.shape
        if min(row, column) < 0 or row + height > rows or column + width > columns:
            raise DefinitionError(
                f"a patch of {height} x {width} cells at row {row}, column {column}",
                expected=f"one inside {rows} x {columns} cells",
            )
        before = self._cells[row + 1 : row + 1 + height, column + 1 : column + 1 + width]
        changed = np.nonzero(before != cells)
        if not len(changed[0]):
            return
        before[...] = cells
        self._bodies = None
        if self._field is not None:
            rows_changed, columns_changed = (
                (int(k.min()) + shift + 1, int(k.max()) + shift + 2)
                for k, shift in zip(changed, (row, column), strict=True)
            )
            self._transform_near(rows_changed, columns_changed)

    def _occupied(self, cells: npt.ArrayLike) -> Truths:
        """Which of some cells count as occupied."""
        try:
            values = np.asarray(cells)
        except (ValueError, OverflowError):
            values = np.empty(0)
        if values.ndim != 2 or values.dtype.kind not in "biuf":
            raise DefinitionError(
                f"the cells of a map have the shape {values.shape}, type {values.dtype}",
                expected="(rows, columns), of truths or of 0 to 100 and -1",
            )
        if values.dtype.kind == "b":
            return values
        wrong = ~((values >= -1) & (values <= 100))
        if wrong.any():
            row, column = (int(k[0]) for k in np.nonzero(wrong))
            raise DefinitionError(
                f"the cell in row {row}, column {column} is {values[row, column]:g}",
                expected="0 to 100 in percent, or -1 for unknown",
            )
        occupied_thresh, free_thresh = self._thresholds
        taken = values >= 100 * occupied_thresh
        if self.unknown == "occupied":
            taken |= (values < 0) | (values >= 100 * free_thresh)
        return np.asarray(taken)

    # -- places ------------------------------------------------------------------------------

    def _in_cells(self, points: npt.ArrayLike) -> Array:
        """Points in the axes of the cells with their border; shape (points, 2)."""
        places = _numbers(points)
        if places.ndim != 2 or places.shape[1] != 2:
            raise DefinitionError(
                f"points have the shape {places.shape}", expected="(points, 2): x, y [m]"
            )
        return np.asarray((places - self._corner) @ self._axes / self.resolution**2)

    def occupied(self, points: npt.ArrayLike) -> Truths:
        """Whether points are in occupied cells; outside the map as `unknown` says.

        points: shape (points, 2), x and y [m]. Raises `DefinitionError` for another shape.
        """
        places = np.floor(self._in_cells(points))
        rows, columns = self._cells.shape
        with np.errstate(invalid="ignore"):
            column = np.clip(np.nan_to_num(places[:, 0]), 0, columns - 1).astype(int)
            row = np.clip(np.nan_to_num(places[:, 1]), 0, rows - 1).astype(int)
        return np.asarray(self._cells[row, column] | np.isnan(places).any(axis=1))

    @property
    def distance_error(self) -> tuple[float, float]:
        """How far `distance` may be below and above the exact distance [m], at most."""
        return math.sqrt(0.5) * self.resolution, TOO_FAR * self.resolution

    def distance(self, points: npt.ArrayLike) -> Array:
        """The distance of points to the occupied cells [m], 0 in them, shape (points,).

        It is interpolated between corners of cells, where it is exact; `distance_error` has the
        bounds. Outside a map whose outside is free it is sqrt(a^2 + b^2), with the distance a to
        the map and b from there on, which is no more than the exact one. It is infinite where
        nothing is occupied. points: shape (points, 2), x and y [m]; NaN for a point that is not
        finite.
        """
        places = self._in_cells(points)
        field = self._distances()
        inside = np.clip(places, 0, np.array(field.shape[::-1]) - 1.0)
        finite = np.nan_to_num(inside)
        if np.isinf(field[0, 0]):
            return np.where(np.isfinite(places).all(axis=1), math.inf, math.nan)
        low = np.minimum(np.floor(finite), np.array(field.shape[::-1]) - 2.0).astype(int)
        (x, y), (column, row) = (finite - low).T, low.T
        upper = (1 - x) * field[row + 1, column] + x * field[row + 1, column + 1]
        between = (1 - y) * ((1 - x) * field[row, column] + x * field[row, column + 1]) + y * upper
        if self.unknown == "free":
            beyond = np.linalg.norm(places - inside, axis=1)
            between = np.where(beyond > 0, np.hypot(between, beyond), between)
        return self.resolution * np.where(np.isfinite(places).all(axis=1), between, math.nan)

    def _distances(self) -> Array:
        """The distance at every corner, in cells."""
        if self._field is None:
            self._field = np.empty([n + 1 for n in self._cells.shape])
            self._field[...] = _transformed(self._cells)
        return self._field

    def _transform_near(self, rows: tuple[int, int], columns: tuple[int, int]) -> None:
        """The distances again after cells in these rows and columns have changed.

        A corner is concerned if it was as near to the patch as to what was nearest to it. It is
        transformed with what is around it, as far as its new distance reaches.
        """
        field = self._field
        assert field is not None
        down, across = (
            np.maximum(np.maximum(low - np.arange(count), np.arange(count) - high), 0.0)
            for (low, high), count in zip((rows, columns), field.shape, strict=True)
        )
        concerned = np.nonzero(field >= np.hypot(down[:, np.newaxis], across))
        if not len(concerned[0]):
            return
        low = [int(k.min()) for k in concerned]
        high = [int(k.max()) + 1 for k in concerned]
        margin = 16
        while True:
            first = [max(0, a - margin) for a in low]
            last = [min(n, b + margin) for n, b in zip(field.shape, high, strict=True)]
            around = tuple(slice(a, max(a, b - 1)) for a, b in zip(first, last, strict=True))
            again = _transformed(self._cells[around])
            part = again[
                low[0] - first[0] : high[0] - first[0], low[1] - first[1] : high[1] - first[1]
            ]
            if part.max() <= margin or (*first, *last) == (0, 0, *field.shape):
                field[low[0] : high[0], low[1] : high[1]] = part
                return
            margin *= 2

    # -- obstacles ---------------------------------------------------------------------------

    def _convex(self) -> list[shapely.Polygon]:
        """The bodies in the plane."""
        if self._bodies is None:
            before, self._by_outline = self._by_outline, {}
            rings = outlines(self._cells)
            for ring, hollow in zip(rings, enclosing(rings), strict=True):
                of_ring = ring.tobytes() + bytes([hollow])
                bodies = before.get(of_ring)
                if bodies is None:
                    bodies = [self._placed(body) for body in bodies_of(ring, hollow=hollow)]
                self._by_outline[of_ring] = bodies
            self._bodies = [body for bodies in self._by_outline.values() for body in bodies]
            self._tree = shapely.STRtree(self._bodies)
            self._obstacles = [None] * len(self._bodies)
        return self._bodies

    def _placed(self, shape: shapely.Polygon) -> shapely.Polygon:
        """A shape in the axes of the cells with their border, in the plane."""
        placed: shapely.Polygon = shapely.transform(
            shape, lambda points: points @ self._axes.T + self._corner
        )
        return placed

    @overload
    def near(self, points: Sequence[float], within: float) -> list[Obstacle]: ...
    @overload
    def near(self, points: Array, within: float) -> Any: ...
    @checked
    def near(self, points: npt.ArrayLike, within: float) -> Any:
        """The obstacles that are near: convex bodies that cover the sides of the occupied cells.

        points: x and y [m] of a vehicle, or shape (vehicles, 2) for a list of each. within [m]: all
        bodies are there that are no farther. A body reaches beyond the occupied cells by a cell at
        most, and by nothing along walls that follow the rows of cells. In an occupied cell, and
        outside a map whose outside is occupied, the cell of the place is an obstacle too.

        Raises `DefinitionError` for a distance that is none.

        >>> flat = hf.OccupancyMap.from_file("examples/rooms.yaml")
        >>> guard = hf.SafetyFilter(robot, obstacles=hf.Obstacles(20, lead=0.3), gains=(1, 4))
        >>> guard.step([2, 2, 0], [1, 0], obstacles=flat.near([2, 2], within=2.0))
        <Decision at 0 s: passed, input [1.0, 0.0]>
        """
        if not (math.isfinite(within) and within >= 0):
            raise DefinitionError(f"within is {within:g}", expected="m, 0 or more")
        places = _numbers(points)
        one = places.ndim == 1
        places = places[np.newaxis] if one else places
        inside = self.occupied(places)
        self._convex()
        listed: list[list[Obstacle]] = [[] for _ in places]
        finite = np.flatnonzero(np.isfinite(places).all(axis=1))
        marks = shapely.points(places[finite])
        vehicle, body = self._tree.query(marks, predicate="dwithin", distance=within)
        for k, number in zip(finite[vehicle].tolist(), body.tolist(), strict=True):
            listed[k].append(self._obstacle(number))
        for k in finite[inside[finite]].tolist():
            listed[k].append(self._cell_at(places[k]))
        return listed[0] if one else listed

    def _obstacle(self, number: int) -> Obstacle:
        obstacle = self._obstacles[number]
        if obstacle is None:
            shape = self._convex()[number]
            x, y = shape.centroid.coords[0]
            name = f"body {number + 1} of the map, at ({x:.2f}, {y:.2f})"
            obstacle = self._obstacles[number] = Obstacle(((_corners(shape), 0.0),), name=name)
        return obstacle

    def _cell_at(self, place: Array) -> Obstacle:
        column, row = np.floor(self._in_cells(place[np.newaxis])[0])
        square = self._placed(shapely.box(column, row, column + 1.0, row + 1.0))
        return Obstacle(((_corners(square), 0.0),), name="the occupied cell at the place itself")

    def polygons(
        self, box: Sequence[Sequence[float]] | None = None
    ) -> Mapping[str, tuple[tuple[float, float], ...]]:
        """Convex polygons that cover all occupied cells, for `holdfast.obstacles`: name -> corners.

        Those of `near`, and rectangles of the cells that they leave. box: the ends of x and of y
        [m]; of what does not touch it nothing is there. Raises `DefinitionError` for one that is
        none.

        >>> island = hf.OccupancyMap([[0, 0, 0], [0, 100, 0], [0, 0, 0]], 1.0, unknown="free")
        >>> island.polygons()
        {'map_1': ((1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0))}
        """
        rings = outlines(self._cells)
        solid = zip(rings, enclosing(rings), strict=True)
        shapes = [body for ring, hollow in solid for body in bodies_of(ring, hollow=hollow)]
        left = rectangles(uncovered(self._cells, shapes))
        placed = [self._placed(shape) for shape in (*shapes, *(shapely.box(*r) for r in left))]
        if box is not None:
            ends = _numbers(box)
            if ends.shape != (2, 2) or not np.isfinite(ends).all():
                raise DefinitionError(
                    f"the box is {box!r}"[:80], expected="((x low, x high), (y low, y high)) [m]"
                )
            (x0, x1), (y0, y1) = ends.tolist()
            seen = shapely.box(x0, y0, x1, y1)
            placed = [shape for shape in placed if shape.intersects(seen)]
        return {f"map_{k}": _corners(shape) for k, shape in enumerate(placed, 1)}


def _transformed(cells: Truths) -> Array:
    """The distance of every corner of some cells to the occupied ones, in cells; infinite without
    any. cells: shape (rows, columns)."""
    corners = np.zeros([n + 1 for n in cells.shape], dtype=bool)
    for rows in (slice(0, -1), slice(1, None)):
        for columns in (slice(0, -1), slice(1, None)):
            corners[rows, columns] |= cells
    if not corners.any():
        return np.full(corners.shape, math.inf)
    distances: Array = distance_transform_edt(~corners)
    return distances


def _numbers(values: npt.ArrayLike) -> Array:
    """An array of numbers; empty where they are none."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.empty(0)


def _corners(shape: shapely.Polygon) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in shape.exterior.coords[:-1])
