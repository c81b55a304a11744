"""Outlines of occupied cells, and convex bodies that cover them.

Cells are squares of side 1; cell (row, column) lies between the corners (column, row) and
(column + 1, row + 1). An outline runs along the sides between occupied and free cells, with the
occupied ones on its left. A piece of it is replaced by the convex hull of the occupied cells beside
it, as long as no point of that hull is farther than 1 from the outline: a wall is one body, however
many cells it has, and however it lies.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely

from holdfast.execution.arrays import Array, Truths

BESIDE = 1.0
"""How far a body reaches beyond the occupied cells, in cells, at most."""
STEP = 1.25
"""A piece departs from its chord by this, in cells, before hulls are tried."""


def outlines(cells: Truths) -> list[Array]:
    """The outlines of the occupied cells: for each its corners, shape (corners, 2), not closed.

    cells: shape (rows, columns), all free or all occupied along its border, at which no outline
    is. Outer ones turn to the left, those of holes to the right. Cells that touch in a corner alone
    have separate outlines.
    """
    if not cells.any():
        return []
    starts, ends, ways = [], [], []
    for swapped in (False, True):
        grid = (cells.T if swapped else cells).astype(np.int8)
        change = grid[1:] - grid[:-1]  # 1: a lower side of a cell, -1: an upper side
        for kind in (1, -1):
            side = np.zeros((change.shape[0], change.shape[1] + 2), dtype=np.int8)
            side[:, 1:-1] = change == kind
            row, column = np.nonzero(side[:, 1:] != side[:, :-1])
            low = np.stack([column[::2], row[::2] + 1], axis=1)
            high = np.stack([column[1::2], row[1::2] + 1], axis=1)
            forth = (kind == 1) != swapped
            if swapped:
                low, high = low[:, ::-1], high[:, ::-1]
            starts.append(low if forth else high)
            ends.append(high if forth else low)
            ways.append(np.full(len(low), 2 * swapped + (not forth)))
    return _chained(np.vstack(starts), np.vstack(ends), np.concatenate(ways), cells.shape[1] + 2)


def _chained(start: Array, end: Array, way: Array, width: int) -> list[Array]:
    """The rings of straight sides; way: 0 to the right, 1 to the left, 2 up, 3 down."""
    key = 4 * (start[:, 0] + width * start[:, 1]) + way
    order = np.argsort(key)
    here = 4 * (end[:, 0] + width * end[:, 1])
    to_the_left = here + np.array([2, 3, 1, 0])[way]
    to_the_right = here + np.array([3, 2, 0, 1])[way]
    place = np.minimum(np.searchsorted(key, to_the_left, sorter=order), len(key) - 1)
    turns_left = key[order[place]] == to_the_left
    other = np.minimum(np.searchsorted(key, to_the_right, sorter=order), len(key) - 1)
    following = order[np.where(turns_left, place, other)].tolist()
    seen, rings = [False] * len(following), []
    for first in range(len(following)):
        ring, side = [], first
        while not seen[side]:
            seen[side] = True
            ring.append(side)
            side = following[side]
        if ring:
            rings.append(start[ring])
    return rings


def enclosing(rings: Sequence[Array]) -> list[bool]:
    """Which outlines are around a hole. rings: each of the shape (corners, 2)."""
    outer = np.array([_turns_left(ring) for ring in rings], dtype=bool)
    hollow = np.zeros(len(rings), dtype=bool)
    if not outer.all():
        places = np.flatnonzero(outer).tolist()
        tree = shapely.STRtree([shapely.Polygon(rings[k]) for k in places])
        holes = shapely.points([rings[k][0] for k in np.flatnonzero(~outer).tolist()])
        _, around = tree.query(holes, predicate="intersects")
        hollow[[places[k] for k in around.tolist()]] = True
    return [bool(is_hollow) for is_hollow in hollow]


def bodies_of(ring: Array, *, hollow: bool = False) -> list[shapely.Polygon]:
    """Convex polygons that cover the occupied cells beside an outline.

    No point of them is farther than `BESIDE` from an occupied cell. ring: shape (corners, 2).
    hollow: whether it is around a hole, so that its hull is no body.
    """
    ring = np.roll(ring, -np.lexsort((ring[:, 0], ring[:, 1]))[0], axis=0)
    closed = np.vstack([ring, ring[:1]])
    if not hollow and _turns_left(ring):
        shape = shapely.Polygon(closed)
        hull = shapely.convex_hull(shape)
        if shapely.covers(shape.buffer(BESIDE), hull):
            return [_without_flat_corners(hull)]
    line = shapely.linestrings(np.column_stack([closed, np.arange(len(closed))]))
    drawn = shapely.simplify(line, STEP, preserve_topology=False)
    corners = shapely.get_coordinates(drawn, include_z=True)[:, 2].astype(int)
    waiting, hulls = list(pairwise(corners)), []
    while waiting:
        ends = np.array(waiting)
        lines = [closed[a : b + 1] for a, b in waiting]
        beside = np.array([_beside(piece) for piece in lines])
        tried = shapely.convex_hull(beside)
        around = shapely.buffer(beside, BESIDE)
        fits = shapely.covers(around, tried) | (ends[:, 1] - ends[:, 0] == 1)
        hulls += list(tried[fits])
        waiting = [
            half for a, b in ends[~fits].tolist() for half in ((a, (a + b) // 2), ((a + b) // 2, b))
        ]
    unique = {shapely.normalize(hull): hull for hull in hulls}
    return [_without_flat_corners(hull) for hull in unique.values()]


def _turns_left(ring: Array) -> bool:
    x, y = ring[:, 0].astype(float), ring[:, 1].astype(float)
    return bool((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0)


def _beside(piece: Array) -> shapely.MultiPolygon:
    """The occupied cells beside a piece of an outline, a rectangle for each of its sides."""
    along = np.sign(np.diff(piece, axis=0))
    corners = piece[:-1], piece[1:] + np.stack([-along[:, 1], along[:, 0]], axis=1)
    low, high = np.minimum(*corners), np.maximum(*corners)
    return shapely.MultiPolygon(list(shapely.box(*low.T, *high.T)))


def _without_flat_corners(hull: shapely.Polygon) -> shapely.Polygon:
    return shapely.orient_polygons(shapely.simplify(hull, 0.0))


def rectangles(cells: Truths) -> list[tuple[int, int, int, int]]:
    """Rectangles (column, row, column end, row end) that the cells are made of: equal runs of
    neighbouring rows are one. cells: shape (rows, columns)."""
    if not cells.any():
        return []
    padded = np.zeros((cells.shape[0], cells.shape[1] + 2), dtype=bool)
    padded[:, 1:-1] = cells
    rows, columns = np.nonzero(padded[:, 1:] != padded[:, :-1])
    growing: dict[tuple[int, int], list[int]] = {}
    done: list[tuple[int, int, int, int]] = []
    runs = zip(rows[::2].tolist(), columns[::2].tolist(), columns[1::2].tolist(), strict=True)
    for row, low, high in runs:
        rows_of = growing.get((low, high))
        if rows_of is not None and rows_of[1] == row:
            rows_of[1] = row + 1
            continue
        if rows_of is not None:
            done.append((low, rows_of[0], high, rows_of[1]))
        growing[low, high] = [row, row + 1]
    done += [(low, rows_of[0], high, rows_of[1]) for (low, high), rows_of in growing.items()]
    return done


def uncovered(cells: Truths, bodies: Sequence[shapely.Polygon]) -> Truths:
    """The occupied cells that are in no body as a whole; shape (rows, columns), as `cells`."""
    left = cells.copy()
    for body in bodies:
        x0, y0, x1, y1 = (int(v) for v in np.floor(body.bounds))
        part = left[y0 : y1 + 1, x0 : x1 + 1]
        row, column = np.nonzero(part)
        if len(row):
            sides = [(x0 + column + i, y0 + row + j) for i in (0, 1) for j in (0, 1)]
            inside = np.all([shapely.intersects_xy(body, x, y) for x, y in sides], axis=0)
            part[row[inside], column[inside]] = False
    return left
