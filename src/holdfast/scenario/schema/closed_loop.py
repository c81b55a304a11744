"""Schema of a scenario file of closed loops, or of a formation (Pydantic); see docs/scenarios.md.

A formation is a leader and its followers.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from holdfast.analysis.online.obstacle_slots import MOST, Clearing
from holdfast.analysis.simulation.starts import Starts
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.control.observer import observe, observe_set
from holdfast.maths.control.safety_filter import limit_rates, safeguard
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.region import (
    Circle,
    Cone,
    Footprint,
    Inequality,
    Region,
    Segment,
    Shape,
)
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import Measurement, PfaffianRow, System
from holdfast.scenario.schema.values import (
    Bounds,
    DrawSpec,
    Expression,
    FlatOutputSpec,
    Interval,
    Layer,
    Name,
    NoiseSpec,
    Parameters,
    Plane,
    Point,
    Renamed,
    Section,
    Text,
    Value,
)  # fmt: skip

Corners = Annotated[list[Point], Field(min_length=3)]


class ObstaclesSpec(Section):
    """obstacles: name -> corners of a polygon [m]; room: those of a polygon to stay in."""

    obstacles: dict[Name, Corners] = Field(default_factory=dict)
    room: Corners | None = None
    clearance: Value = 0.0
    position: Plane = ("x", "y")


class ViewSpec(Section):
    """targets: name -> place, expressions of the states or lengths [m]; the other keys are those of
    `targets_in_view`, past the obstacles and the room of the region."""

    targets: dict[Name, Point]
    at_least: int | None = None
    clearance: Value = 0.0
    half_angle: Value | None = None
    range_min: Value | None = None
    range_max: Value | None = None
    heading: Name = "psi"
    pan: Name | None = None
    pan_limit: Value | None = None
    position: Plane = ("x", "y")


class RunSpec(Section, of=[Settings], without=["noise_uniform", "noise_normal", "threads"]):
    """[run]: the settings of the simulation; noise is in [noise], and threads are of a machine."""

    renamed: ClassVar[Renamed] = {"control": ("continuous", {"continuous": True, "sampled": False})}

    stepper: str = "rk4"


class Header(Section):
    """[scenario]"""

    title: Text
    kind: Literal["closed-loop"] = "closed-loop"
    description: Text = ""
    source: Text = ""


class QuantitySpec(Section, of=[Quantity], without=["name", "role"]):
    """A state: its unit, and whether it is an angle."""


class BoundedSpec(Section, of=[Quantity], without=["name", "angle", "role"]):
    """An input or disturbance: its unit and its bounds (numbers or expressions)."""

    bounds: Bounds | None = None


class DisturbanceSpec(BoundedSpec, of=[Quantity], without=["name", "angle"]):
    """A disturbance; role: "current" of a component of the current."""


class MeasurementSpec(Section, of=[Measurement], without=["name", "angle", "role"]):
    """A measurement: an output equation of the states."""

    expression: Expression


class PfaffianSpec(Section, of=[PfaffianRow]):
    """One row of A(q) qdot = b: { coefficients = { x = "-sin(psi)", ... }, rhs = "0" }.

    The coefficients are those of the rates, the entries of A; missing ones are 0. rhs: the
    entry of b (the sway or the current across the hull), if it is not zero.
    """

    renamed: ClassVar[Renamed] = {"row": ("coefficients", {})}


class SystemSpec(Section, of=[System], without=["samples", "promoted"]):
    """[system], written by expressions: rates, or only Pfaffian rows (all motions they allow)."""

    name: Name = "system"
    states: dict[Name, QuantitySpec]
    inputs: dict[Name, BoundedSpec] = Field(default_factory=dict)
    disturbances: dict[Name, DisturbanceSpec] = Field(default_factory=dict)
    parameters: Parameters = Field(default_factory=dict)
    rates: dict[Name, Expression] = Field(default_factory=dict)
    measurements: dict[Name, MeasurementSpec] = Field(default_factory=dict)
    pfaffian: list[PfaffianSpec] = Field(default_factory=list)
    flat_output: FlatOutputSpec | None = None


class OutputsSpec(Section):
    """A law: its outputs, with definitions that may use earlier ones."""

    outputs: dict[Name, Expression]
    definitions: dict[Name, Expression] = Field(default_factory=dict)


class TransitionSpec(Section):
    """{ from = "far", to = "near", when = "hypot(x, y) < 0.2" }"""

    source: Name = Field(alias="from")
    target: Name = Field(alias="to")
    when: str


class LawSpec(Section, of=[Law, Switching], without=["believed"]):
    """[law], written by expressions: one law, or modes with transitions."""

    name: Name = "law"
    reads: list[Name] | None = None
    parameters: Parameters = Field(default_factory=dict)
    definitions: dict[Name, Expression] = Field(default_factory=dict)
    outputs: dict[Name, Expression] | None = None
    modes: dict[Name, OutputsSpec] | None = None
    transitions: list[TransitionSpec] = Field(default_factory=list)


class InequalitySpec(Section, of=[Inequality], without=["name"]):
    """expression <= 0 is safe. scale: the amount of it that counts as 1 in a depth."""


SHAPES: dict[str, type[Shape]] = {
    "segment": Segment, "circle": Circle, "cone": Cone, "footprint": Footprint,
}  # fmt: skip


class ShapeSpec(Section, of=[*SHAPES.values()]):
    """A shape to draw: a segment, a circle, or a field of view (cone, or polygonal footprint)."""

    kind: Literal["segment", "cone", "circle", "footprint"]
    role: Name
    corners: Corners | None = None


class RegionSpec(Section, of=[Region], without=["name"]):
    """[region] or [goal], written by expressions."""

    name: Name = "region"
    parameters: Parameters = Field(default_factory=dict)
    definitions: dict[Name, Expression] = Field(default_factory=dict)
    constraints: dict[Name, InequalitySpec | Expression]
    scene: list[ShapeSpec] = Field(default_factory=list)


class RedesignSpec(Section):
    """[redesign]: a viable law and a layer for every constraint, and the law that holds.

    `as_printed`: everything as printed in the thesis, or the named parts: "redesign" for (5.26),
    else the name of a viable law.
    """

    viable: dict[Name, Name | OutputsSpec]
    layers: dict[Name, Layer]
    hold: Name | OutputsSpec | None = None
    hold_when: str | None = None
    goal: dict[Name, Expression] | None = None
    as_printed: bool | list[Name] = False
    parameters: dict[Name, Any] = Field(default_factory=dict)


class SafeguardSpec(Section, of=[safeguard, limit_rates], without=["sample_time"]):
    """[safeguard], a safety filter (CBF-QP): the least change of inputs that keeps [region] viable.
    constraints: further enforced ones; violating them does not count as leaving the region.
    uncertain: parameter -> [least, largest]; the conditions hold for every model of this box.
    """

    renamed: ClassVar[Renamed] = {"measured": ("disturbance_measured", {})}

    constraints: dict[Name, InequalitySpec | Expression] = Field(default_factory=dict)


class MovingSpec(Section):
    """An obstacle of [obstacles.moving]: one shape, and how it moves.

    disc = [x, y, radius], capsule = [x, y, x, y, radius], ellipse = [x, y, ahead, across, heading],
    polygon = [[x, y], ...] with a radius. velocity = [vx, vy]: constants. path = [x, y]: how far it
    has moved, expressions of t; its velocity is the derivative, and so is its acceleration, unless
    that is written as a bound.
    """

    disc: Annotated[list[Value], Field(min_length=3, max_length=3)] | None = None
    capsule: Annotated[list[Value], Field(min_length=5, max_length=5)] | None = None
    ellipse: Annotated[list[Value], Field(min_length=5, max_length=5)] | None = None
    polygon: Corners | None = None
    radius: Value | None = None
    velocity: Point | None = None
    path: Point | None = None
    acceleration: Value | None = None
    velocity_error: Value | None = None
    share: Value | None = None


class SurroundingsSpec(Section, of=[Clearing], without=["parts"]):
    """[obstacles]: how the filter keeps clear of what it is told of at run time.

    most: of more the nearest count; 0 for no filter. hull: a radius, corners (x, y) of a polygon,
    or discs (x, y, radius), in the vehicle's axes. moving: what runs of this file meet.
    """

    most: Annotated[int, Field(ge=0, le=MOST)]
    hull: float | list[list[float]] = 0.0
    moving: dict[Name, MovingSpec] = Field(default_factory=dict)


class StartsSpec(Section, of=[Starts]):
    """[starts]: given states, then random ones from a box; `every` for states not in it.

    active: lists of constraints; the random starts are moved, list by list in turn, to states where
    all constraints of the list are active. start_outside: allow starts outside the region.
    """

    renamed: ClassVar[Renamed] = {"outside": ("start_outside", {})}

    every: Interval | None = None
    start_outside: bool = False


class VariedSpec(Section):
    """[varied]: the random draws of every run, and the values computed from them.

    vertices: the draws that take their lowest and highest values instead, in every combination,
    from every start; true for all of them.
    """

    draws: dict[Name, DrawSpec | Interval] = Field(default_factory=dict)
    values: dict[Name, Expression] = Field(default_factory=dict)
    plant: dict[Name, Expression] = Field(default_factory=dict)
    vertices: bool | list[Name] = False

    @property
    def of_vertices(self) -> list[str]:
        """The names of the draws whose vertices are tried."""
        if isinstance(self.vertices, bool):
            return [*self.draws] if self.vertices else []
        return self.vertices

    @property
    def ranges(self) -> dict[str, DrawSpec]:
        """Every draw as a range, with a unit where one is given."""
        return {
            name: draw if isinstance(draw, DrawSpec) else DrawSpec(range=draw)
            for name, draw in self.draws.items()
        }


class FiguresSpec(Section):
    """[figures]: the plane of the paths, the run of the histories, the runs drawn bold."""

    plane: Plane | None = None
    history: Annotated[int, Field(ge=0)] = 0
    highlight: Annotated[int, Field(ge=0, le=100)] = 3
    cones: Annotated[int, Field(ge=0, le=100)] = 4


class ObserverSpec(Section, of=[observe, observe_set]):
    """[observer]: the law measures only these states and estimates all else that it reads.

    error_bounds: the largest error of each state, measured or not: a guaranteed set of the
    disturbance then replaces its estimate, and [safeguard] counts the worst of the set.
    rate_bounds: the most by which a disturbance changes in a second, where the vehicle feels it.
    """


class AlterationSpec(Section):
    """Another law or case of a scenario: removed tables, then replacement tables."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True)

    title: Text = ""
    without: list[Name] = Field(default_factory=list)


class CompareSpec(Section):
    """[compare]: other laws and other cases, for `holdfast compare`.

    kernel: a scenario that computes the viable starts, for the [system] of every case;
    margin: the least depth inside it of a counted start.
    """

    title: Text = ""
    runs: Annotated[int, Field(ge=1)] | None = None
    kernel: Text | None = None
    margin: Value | None = None
    laws: dict[Name, AlterationSpec] = Field(default_factory=dict)
    cases: dict[Text, AlterationSpec] = Field(default_factory=dict)


class ScenarioSpec(Section):
    """A whole scenario file; catalogue entries stay tables of { name, parameters }.

    kernels: name -> tables to alter in the scenarios that `kernel` keys name.
    """

    scenario: Header
    system: dict[str, Any]
    law: dict[str, Any]
    region: dict[str, Any] | None = None
    redesign: RedesignSpec | None = None
    tracking: dict[Name, float] | None = None
    safeguard: SafeguardSpec | None = None
    obstacles: SurroundingsSpec | None = None
    observer: ObserverSpec | None = None
    safety: dict[str, Any] | None = None
    kernels: dict[Text, dict[str, Any]] = Field(default_factory=dict)
    goal: dict[str, Any] | None = None
    reference: dict[Name, Expression] = Field(default_factory=dict)
    starts: StartsSpec
    run: RunSpec
    noise: NoiseSpec = Field(default_factory=NoiseSpec)
    disturbance: dict[Name, Expression] = Field(default_factory=dict)
    plant: dict[Name, Value] = Field(default_factory=dict)
    varied: VariedSpec = VariedSpec()
    figures: FiguresSpec = FiguresSpec()
    compare: CompareSpec = CompareSpec()


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
