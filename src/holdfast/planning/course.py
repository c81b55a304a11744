"""The result of planning, as data for figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.planning.corners import Corner
from holdfast.planning.environment import Environment
from holdfast.planning.fields import Fields


@dataclass(frozen=True)
class Course:
    """The result of planning: the fields of the route, and the arcs around its corners."""

    fields: Fields
    corners: tuple[Corner, ...]
    followers: int

    @property
    def environment(self) -> Environment:
        return self.fields.route.environment

    @property
    def goal(self) -> tuple[float, float]:
        return self.fields.route.goal

    def arrows(self, apart: float = 0.4) -> Array:
        """(x, y, direction) of the leader's fields at points `apart` [m] from each other."""
        found = []
        for number, leg in enumerate(self.fields.route.legs):
            corners = np.array(leg.cell.corners)
            low, high = corners.min(axis=0), corners.max(axis=0)
            counts = np.maximum(np.ceil((high - low) / apart), 1).astype(int)
            x, y = (
                a + (b - a) * (np.arange(n) + 0.5) / n
                for a, b, n in zip(low, high, counts, strict=True)
            )
            places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            places = places[[leg.cell.contains(place) for place in places]]
            found.append(np.column_stack([places, self.fields.headings(number, places)]))
        return np.vstack(found)
