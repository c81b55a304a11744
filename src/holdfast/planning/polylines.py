"""Lines through many points, drawn by few of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

from holdfast.execution.arrays import Array


def kept_points(line: Array, within: float) -> Any:
    """The numbers of the points by which a line, shape (n, 2), is drawn, in order.

    No point of the line is farther than `within` from the line through these (Douglas and Peucker).
    """
    if len(line) < 3:
        return np.arange(len(line))
    numbered = shapely.linestrings(np.column_stack([line, np.arange(len(line))]))
    drawn = shapely.simplify(numbered, within, preserve_topology=False)
    return shapely.get_coordinates(drawn, include_z=True)[:, 2].astype(int)
