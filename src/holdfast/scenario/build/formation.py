"""Scenarios of a leader and its followers among walls: planning, checks, composition."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import sympy as sp

from holdfast.analysis.safety.gain_conditions import check_view, visibility_gains
from holdfast.analysis.simulation.starts import Starts
from holdfast.errors import GainWarning, ScenarioError
from holdfast.maths.catalogue.laws.follow_leader import SEEN, TURNS
from holdfast.maths.catalogue.systems.chain import chain, robot_names
from holdfast.maths.catalogue.systems.leader_follower import leader_follower
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter, symbol, to_si
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import magnitude
from holdfast.maths.formations.chain import chain_in_view, joint_law
from holdfast.planning.corners import Convoy, Corner, Course, Pose, lead_along, route_corners
from holdfast.planning.environment import (
    CLOSE,
    Environment,
    environment,
    geojson_cells,
    plan_route,
    route_fields,
)
from holdfast.scenario.build.composer import Composer
from holdfast.scenario.schema.closed_loop import FormationSpec
from holdfast.scenario.schema.values import at

WINDOWS = ("approach_leader", "follow_leader")
"""The laws with a known window of gains."""


@dataclass(frozen=True)
class Formation:
    """The parts of a closed loop, as given by the tables of a closed-loop scenario."""

    system: System
    law: Switching
    region: Region
    goal: Region
    starts: Starts
    course: Course


def composed_formation(file: str, spec: FormationSpec) -> Formation:
    """The parts of the closed loop; `ScenarioError` says why one cannot be planned."""
    radius = _si(file, "environment.robot_radius", spec.environment.robot_radius, "m")
    with at(file, "environment"):
        cells = dict(spec.environment.cells)
        if (spec.environment.geojson is None) == (not cells):
            raise ScenarioError("give either cells or geojson")
        if spec.environment.geojson is not None:
            cells = dict(geojson_cells(spec.environment.geojson))
        free = environment(cells, radius)
    starts = [_pose(file, "leader.start", spec.leader.start)]
    starts += [
        _pose(file, f"followers.starts.{i}", written)
        for i, written in enumerate(spec.followers.starts)
    ]
    _check_together(file, free, starts)
    view = {
        "range_max": _si(file, "camera.range_max", spec.camera.range_max, "m"),
        "half_angle": _si(file, "camera.half_angle", spec.camera.half_angle, "rad"),
        "robot_radius": radius,
    }
    laws = _laws(file, spec, view)
    _check_view(file, free, starts, view["range_max"], view["half_angle"])
    goal = [_si(file, "leader.goal", v, "m") for v in spec.leader.goal]
    lead = {
        name: _si(file, f"leader.{name}", getattr(spec.leader, name), unit)
        for name, unit in (("speed", "m/s"), ("gain", "1/s"), ("goal_radius", "m"))
    }
    written = spec.leader.radius
    arc = None if written is None else _si(file, "leader.radius", written, "m")
    for name, value in (*lead.items(), ("radius", 1.0 if arc is None else arc)):
        if not value > 0:
            raise ScenarioError(f"{file}: leader.{name}: {value:g}", expected="above 0")
    with at(file, "leader"):
        route = plan_route(free, starts[0][:2], goal)
        fields = route_fields(route, spec.leader.exponent)
        distance = next(p.value for p in laws[0].parameters if p.name == "distance")
        convoy = Convoy(lead["speed"], lead["gain"], laws, distance, spec.leader.rule)
        corners = route_corners(fields, convoy, starts, radius=arc)
        leader = lead_along(fields, corners, **lead)
        _check_first(free, route.legs[0].cell.name, starts)
    count = len(laws)
    with at(file, "followers.starts"):
        system = chain(count)
    _check_speeds(file, system, lead["speed"], laws, corners)
    with at(file, "camera"):
        region = chain_in_view(count, free.walls, **view)
    with at(file, "followers.law"):
        law = joint_law(system, leader, laws)
    names = [q.name for q in system.states]
    within = _si(file, "followers.within", spec.followers.within, "m")
    if not within > 0:
        raise ScenarioError(f"{file}: followers.within: {within:g}", expected="above 0")
    return Formation(
        system=system,
        law=law,
        region=region,
        goal=_arrived(system, leader.parameters, distance, within, count),
        starts=Starts(states=[dict(zip(names, sum(starts, ()), strict=True))]),
        course=Course(fields, corners, count),
    )


def _si(file: str, key: str, value: object, unit: str) -> float:
    with at(file, key):
        return to_si(value, unit)


def _pose(file: str, key: str, pose: Mapping[str, Any]) -> Pose:
    units = {"x": "m", "y": "m", "theta": "rad"}
    if set(pose) != set(units):
        odd = min(set(pose) ^ set(units))
        raise ScenarioError(
            f"{file}: {key}: '{odd}' is " + ("missing" if odd in units else "not part of a pose"),
            expected="{ x, y, theta }",
        )
    x, y, theta = (_si(file, f"{key}.{n}", pose[n], unit) for n, unit in units.items())
    return x, y, theta


def _check_together(file: str, free: Environment, starts: list[Pose]) -> None:
    """All robots have to start in one cell, since followers do not plan a way between cells."""
    places = []
    for name, (x, y, _) in zip(robot_names(len(starts) - 1), starts, strict=True):
        who = "the leader" if name == "L" else f"follower {name}"
        cells = free.cells_at((x, y))
        if not cells:
            raise ScenarioError(
                f"{file}: {who} starts at ({x:g}, {y:g}), outside the free space of a robot",
                expected=f"in a cell, at least {free.robot_radius:g} m from its walls",
            )
        places.append((who, cells))
    if not set.intersection(*(cells for _, cells in places)):
        shown = ", ".join(f"{who} in '{free.cells[min(cells)].name}'" for who, cells in places)
        raise ScenarioError(
            f"{file}: the robots start in different cells: {shown}", expected="all of them in one"
        )


def _check_view(
    file: str, free: Environment, starts: list[Pose], reach: float, half_angle: float
) -> None:
    """Initially every follower has to see the robot before it, and none may touch another."""
    names = robot_names(len(starts) - 1)
    for (before, (ax, ay, _)), (name, (x, y, theta)) in pairwise(zip(names, starts, strict=True)):
        who = "the leader" if before == "L" else f"follower {before}"
        bearing = math.remainder(math.atan2(ay - y, ax - x) - theta, math.tau)
        ahead = math.dist((x, y), (ax, ay)) * math.cos(bearing)
        problem = ""
        if abs(bearing) > half_angle + CLOSE:
            problem = (
                f"at a bearing of {bearing:.3g} rad, and sees {half_angle:.3g} rad to each side"
            )
        elif ahead > reach * math.cos(half_angle) + CLOSE:
            problem = f"{ahead:.3g} m ahead, and sees {reach * math.cos(half_angle):.3g} m far"
        elif not free.in_sight((x, y), (ax, ay)):
            problem = "behind a wall"
        if problem:
            raise ScenarioError(
                f"{file}: followers.starts.{int(name) - 1}: follower {name} does not see {who} at "
                f"first: it has it {problem}"
            )
    for (one, here), (other, there) in combinations(zip(names, starts, strict=True), 2):
        if math.dist(here[:2], there[:2]) < 2 * free.robot_radius - CLOSE:
            raise ScenarioError(
                f"{file}: robots {one} and {other} start {math.dist(here[:2], there[:2]):.3g} m "
                "from each other and touch",
                expected=f"at least {2 * free.robot_radius:g} m between their centres",
            )


def _check_first(free: Environment, first: str, starts: list[Pose]) -> None:
    """Refuse followers that start outside the first cell of the leader's way."""
    for name, (x, y, _) in zip(robot_names(len(starts) - 1)[1:], starts[1:], strict=True):
        if first not in [free.cells[i].name for i in free.cells_at((x, y))]:
            raise ScenarioError(
                f"follower {name} starts outside cell '{first}', where the way of the leader begins"
            )


def _check_speeds(
    file: str, system: System, speed: float, laws: tuple[Law, ...], corners: tuple[Corner, ...]
) -> None:
    """Refuse a leader faster than its follower assumes, or than its own limit."""
    limits = {p.name: p.value for p in system.parameters}
    assumed = {p.name: p.value for p in laws[0].parameters}.get("leader_speed", math.inf)
    turn = max((speed / c.radius for c in corners), default=0.0)
    for value, limit, unit, what in (
        (speed, assumed, "m/s", "its follower assumes leader_speed ="),
        (speed, limits["speed_limit"], "m/s", "it can do"),
        (turn, limits["turn_limit"], "rad/s", "on its arcs; it can do"),
    ):
        if value > limit:
            raise ScenarioError(
                f"{file}: leader.speed: {value:g} {unit}, {what} {limit:g} {unit}",
                expected="a slower leader" if what != "its follower assumes leader_speed =" else "",
            )


def _laws(file: str, spec: FormationSpec, view: Mapping[str, float]) -> tuple[Law, ...]:
    """The followers' laws, each with its assumed leader speed; gains are checked."""
    count = len(spec.followers.starts)
    speeds = spec.followers.leader_speeds
    if speeds is not None and len(speeds) != count:
        raise ScenarioError(
            f"{file}: followers.leader_speeds: {len(speeds)} numbers for {count} followers"
        )
    composer = Composer(file)
    composer.system_built = leader_follower()  # the system that a follower's law is written for
    with at(file, "followers.law"):
        law = composer.law(spec.followers.law)
        if not isinstance(law, Law) or "distance" not in [p.name for p in law.parameters]:
            raise ScenarioError(
                f"'{law.name}' does not follow a leader at a distance",
                expected="'follow_leader', 'approach_leader', or a law of your own with a "
                "parameter 'distance'",
            )
        more = [q.name for q in law.reads if q.name not in [s.name for s in SEEN]]
        if more:
            raise ScenarioError(
                f"'{law.name}' reads '{more[0]}', which no follower measures",
                expected="reads = ['range', 'bearing']",
            )
    laws = []
    for i in range(count):
        follower_law = law
        if speeds is not None:
            key = f"followers.leader_speeds.{i}"
            speed = _si(file, key, speeds[i], "m/s")
            with at(file, key):
                follower_law = _told(law, speed)
        _check_gains(file, spec, follower_law, i + 1, view)
        laws.append(follower_law)
    return tuple(laws)


def _told(law: Law, speed: float) -> Law:
    if "leader_speed" not in [p.name for p in law.parameters]:
        raise ScenarioError(f"law '{law.name}' takes no leader speed", remedy="leave it out")
    return replace(
        law,
        parameters=tuple(
            replace(p, value=speed) if p.name == "leader_speed" else p for p in law.parameters
        ),
    )


def _check_gains(
    file: str, spec: FormationSpec, law: Law, number: int, view: Mapping[str, float]
) -> None:
    """Refuse impossible distances; warn of gains outside the window."""
    values = {p.name: p.value for p in law.parameters}
    with at(file, "followers.law"):
        check_view(values["distance"], **view)
        if spec.followers.law.get("name") not in WINDOWS:
            return
        window = visibility_gains(
            k1=values["k1"],
            distance=values["distance"],
            leader_speed=values.get("leader_speed", 0.0),
            softness=values.get("softness", 1e-6),
            turn=spec.followers.law.get("turn", TURNS[0]),
            **view,
        )
    if values["k2"] not in window:
        warnings.warn(
            f"follower {number}: k2 = {values['k2']:g} 1/s may lose its leader: {window}",
            GainWarning,
            stacklevel=2,
        )


def _arrived(
    system: System, parameters: tuple[Parameter, ...], distance: float, within: float, count: int
) -> Region:
    """The leader at its goal, every follower at its distance from the one before it."""
    x, y = symbol("xL") - symbol("goal_x"), symbol("yL") - symbol("goal_y")
    measured = {m.name: m.expression for m in system.measurements}
    used = [p for p in parameters if p.name in ("goal_x", "goal_y", "goal_radius")]
    places = [
        Inequality(
            f"place{k}",
            magnitude(measured[f"range{k}"] - sp.Float(distance)) - sp.Float(within),
            "m",
        )
        for k in range(1, count + 1)
    ]
    return Region(
        name="arrived",
        reads=system.states,
        inequalities=(
            Inequality("goal", sp.sqrt(x**2 + y**2) - 2 * symbol("goal_radius"), "m"),
            *places,
        ),
        parameters=tuple(used),
        description="the leader at its goal, every follower in its place",
        source="thesis section 6.5",
    )
