"""Schema of the polygons of [region] (Pydantic)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from holdfast.scenario.schema.values import Name, Plane, Point, Section, Value

Corners = Annotated[list[Point], Field(min_length=3)]


class ObstaclesSpec(Section):
    """obstacles: name -> corners of a polygon [m]; room: those of a polygon to stay in."""

    obstacles: dict[Name, Corners] = Field(default_factory=dict)
    room: Corners | None = None
    clearance: Value = 0.0
    position: Plane = ("x", "y")
