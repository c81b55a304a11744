"""[obstacles] of a scenario: how the filter keeps clear, and what moves around the vehicle.

The way of an obstacle is an expression of t; its velocity and its acceleration are the derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.online.obstacle_slots import Among, Clearing, ObstacleSlots, Parts
from holdfast.analysis.simulation.result import Result
from holdfast.errors import ScenarioError
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.closed_loop import Alive, Commander
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME, to_si
from holdfast.maths.definitions.switching import Switching, as_switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.value import Value
from holdfast.maths.expressions.parser import parse_expression
from holdfast.planning.encounters import judged
from holdfast.planning.moving_obstacles import MOTION, SHAPES, Obstacle, Obstacles
from holdfast.scenario.schema.closed_loop import MovingSpec, SurroundingsSpec
from holdfast.scenario.schema.values import at

UNITS = {"acceleration": "m/s^2", "velocity_error": "m/s", "share": "1", "radius": "m"}


@dataclass(frozen=True)
class Moving(Value):
    """An obstacle that moves as its file says; standing: where the way is (0, 0). along: the way,
    its rates and their rates, of t."""

    standing: Obstacle
    along: tuple[sp.Expr, ...]
    acceleration: float | None

    @cached_property
    def motion(self) -> Evaluator:
        return Evaluator(self.along, [TIME], ())

    @property
    def name(self) -> str:
        """Its key in the file."""
        return self.standing.name

    @property
    def bodies(self) -> Parts:
        """Its bodies before it moves."""
        return self.standing.bodies

    def way(self, times: Array) -> Array:
        """How far it has gone at times, shape (times,), as an array (times, 2) [m]."""
        return self.motion.values(times[:, np.newaxis])[:, :2]

    def seen(self, t: float) -> Obstacle:
        """The obstacle at a time [s], as a filter is told of it."""
        x, y, vx, vy, ax, ay = self.motion.values(np.array([[t]]))[0].tolist()
        still = self.standing
        bodies = tuple(
            (tuple((a + x, b + y) for a, b in corners), radius) for corners, radius in still.bodies
        )
        change = float(np.hypot(ax, ay)) if self.acceleration is None else self.acceleration
        return Obstacle(
            bodies, velocity=(vx, vy), acceleration=change, velocity_error=still.velocity_error,
            share=still.share, name=still.name,
        )  # fmt: skip


def composed_clearing(file: str, spec: SurroundingsSpec) -> Obstacles:
    """The words of [obstacles] for a filter."""
    said = spec.read(file, "obstacles")
    with at(file, "obstacles"):
        return Obstacles(hull=spec.hull, **{**said, "most": max(spec.most, 1)})


def composed_moving(
    file: str, table: Mapping[str, MovingSpec], values: Mapping[sp.Symbol, float]
) -> tuple[Moving, ...]:
    """The obstacles of [obstacles.moving]; values: of the parameters that ways may name."""
    return tuple(_moving(file, name, spec, values) for name, spec in table.items())


def _moving(file: str, name: str, spec: MovingSpec, values: Mapping[sp.Symbol, float]) -> Moving:
    key = f"obstacles.moving.{name}"
    with at(file, key):
        said: dict[str, Any] = {"name": name}
        for shape in SHAPES:
            if (written := getattr(spec, shape)) is not None:
                said[shape] = _numbers(written, shape)
        for word in MOTION:
            if word in UNITS and (number := getattr(spec, word)) is not None:
                said[word] = to_si(number, UNITS[word])
        acceleration = said.pop("acceleration", None)
        standing = Obstacle.of_table(said)
        if not all(np.isfinite(x) for c, r in standing.bodies for x in (r, *np.ravel(c))):
            raise ScenarioError("a number is not finite", expected="finite numbers")
        if spec.velocity is not None and spec.path is not None:
            raise ScenarioError("velocity and path", expected="one of them")
        way: Sequence[sp.Expr] = (sp.S.Zero, sp.S.Zero)
        if spec.velocity is not None:
            way = [sp.Float(to_si(v, "m/s")) * TIME for v in spec.velocity]
        elif spec.path is not None:
            names = {"t": TIME, **{str(s): s for s in values}}
            numbers = {s: sp.Float(v) for s, v in values.items()}
            way = [parse_expression(e, names).xreplace(numbers) for e in spec.path]
        rates = [e.diff(TIME) for e in way]
        changes = [e.diff(TIME) for e in rates]
        return Moving(standing, (*way, *rates, *changes), acceleration)


def _numbers(written: Any, shape: str) -> Any:
    """Lengths in metres; the last number of an ellipse is an angle."""
    if shape == "polygon":
        return [[to_si(c, "m") for c in corner] for corner in written]
    units = ["m"] * len(written)
    if shape == "ellipse" and len(units) == SHAPES[shape]:
        units[-1] = "rad"
    return [to_si(v, unit) for v, unit in zip(written, units, strict=True)]


@dataclass(frozen=True)
class Surroundings(Value):
    """What a closed loop meets: how its filter keeps clear, and of what.

    hull: of the vehicle, as the file says. clearing: that of the filter, with its lead.
    """

    hull: Parts
    clearing: Clearing
    moving: tuple[Moving, ...]

    def commander(
        self, model: System, law: Law | Switching, other: Commander | None
    ) -> Commander | None:
        """What the law is handed at every sample: the command of another controller, if any, and
        the pairs of discs."""
        guards = [m.safeguard for m in as_switching(law).modes.values() if m.safeguard]
        repeated = next((g.repeated for g in guards if g.repeated is not None), None)
        if repeated is None:  # the filter counts with none
            return other

        def around(t: float, states: Array) -> list[list[Obstacle]]:
            return [[o.seen(t) for o in self.moving]] * len(states)

        return Among(ObstacleSlots(model, repeated), other or _Nobody(), around)

    def check(self, file: str, horizon: float, sample_time: float) -> None:
        """Refuse ways that are not finite at some sample."""
        times: Array = np.arange(round(horizon / sample_time) + 1) * np.float64(sample_time)
        for o in self.moving:
            motion = o.motion.values(times[:, np.newaxis])
            bad = np.flatnonzero(~np.isfinite(motion).all(axis=1))
            if bad.size:
                raise ScenarioError(
                    f"{file}: obstacles.moving.{o.name}: its way is not finite, or has no "
                    f"derivative, at {times[bad[0]]:g} s"
                )

    def judged(self, result: Result, sample_time: float) -> Result:
        """The result, in which a run that touched an obstacle has left the region."""
        if not self.moving:
            return result
        of = self.clearing
        return judged(result, self.moving, self.hull, of.position, of.heading or "", sample_time)


class _Nobody:
    """Of a law that computes its command by itself."""

    most = 1 << 30

    def begin(self, runs: range) -> None:
        pass

    def command(self, t: float, states: Array, alive: Alive) -> Array:
        """No command: shape (runs, 0). states: shape (runs, states). alive: shape (runs,)."""
        return np.empty((len(states), 0))

    def end(self) -> None:
        pass
