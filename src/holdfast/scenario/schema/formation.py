"""Schema of a scenario of a leader and its followers (Pydantic)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from holdfast.scenario.schema.closed_loop import RunSpec
from holdfast.scenario.schema.values import Name, NoiseSpec, Section, Text, Value


class FormationHeader(Section):
    """[scenario]"""

    title: Text
    kind: Literal["formation"]
    description: Text = ""
    source: Text = ""


class EnvironmentSpec(Section):
    """[environment]: the free space as convex cells, name -> corners [x, y], or a GeoJSON file."""

    robot_radius: Value
    cells: dict[Text, Any] = Field(default_factory=dict)
    geojson: Text | None = None


class LeaderSpec(Section):
    """[leader]: start { x, y, theta }, goal [x, y]; radius: of all arcs, by default a safe one.

    rule: the start of an arc, from the leader's present heading or from the thesis's tangent.
    """

    start: dict[Name, Value]
    goal: Annotated[list[Value], Field(min_length=2, max_length=2)]
    speed: Value
    gain: Value = 2.0
    exponent: float = 3.0
    goal_radius: Value = 0.05
    radius: Value | None = None
    rule: Literal["arc", "tangent"] = "arc"


class FollowersSpec(Section):
    """[followers]: one start for each, the law of all, the assumed `leader_speed` of each.

    within: tolerance [m] of a follower's distance at the end.
    """

    starts: Annotated[list[dict[Name, Value]], Field(min_length=1)]
    law: dict[str, Any]
    leader_speeds: list[Value] | None = None
    within: Value = 0.1


class CameraSpec(Section):
    """[camera]: the range and angle of a follower's view."""

    range_max: Value
    half_angle: Value


class FormationFigures(Section):
    """[figures]: the number of drawn instants; animate: simulated seconds per second, 0: none."""

    cones: Annotated[int, Field(ge=2, le=100)] = 4
    animate: Annotated[float, Field(ge=0)] = 0.0


class FormationSpec(Section):
    """A whole file; the followers' law is a table of { name, parameters }."""

    scenario: FormationHeader
    environment: EnvironmentSpec
    leader: LeaderSpec
    followers: FollowersSpec
    camera: CameraSpec
    run: RunSpec
    noise: NoiseSpec = Field(default_factory=NoiseSpec)
    figures: FormationFigures = FormationFigures()
