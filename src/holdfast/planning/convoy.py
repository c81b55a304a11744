"""Fast simulation of a leader and its followers for the planner, many runs at once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.catalogue.laws.follow_leader import SEEN
from holdfast.maths.definitions.law import Law
from holdfast.planning.fields import Fields

Flags = npt.NDArray[np.bool_]
Pose = tuple[float, float, float]

RULES = ("arc", "tangent")

FINE = 0.02
"""A step of the leader, as a share of the distance between robots."""

QUICK = 0.5
"""A step in time, as a share of the fastest time constant of a follower."""


@dataclass(frozen=True)
class Convoy:
    """The robots: the leader's `speed` [m/s] and `gain` kL [1/s], and the followers.

    laws: one for each follower; distance [m]: of each behind the one before it. rule: "arc" starts
    from the leader's present heading; "tangent", the thesis's rule for right-angled corners, starts
    from the tangent to the circle on which the follower would round the corner.
    """

    speed: float
    gain: float
    laws: tuple[Law, ...]
    distance: float
    rule: str = "arc"

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise DefinitionError(f"rule is {self.rule!r}", expected=" or ".join(map(repr, RULES)))

    @property
    def length(self) -> float:
        """The length from the leader to the last robot [m] with all in their places."""
        return len(self.laws) * self.distance

    @cached_property
    def step(self) -> float:
        """A step [s] in which the leader moves little of the distance, without overshoot."""
        gaps = np.linspace(0.5, 1.5, 41) * self.distance
        angles = np.linspace(-0.5, 0.5, 41)
        steepest = 0.0
        for answer in self._answers:
            speeds = answer.values(np.stack([gaps, np.zeros(41)], axis=1))[:, 0]
            turns = answer.values(np.stack([np.full(41, self.distance), angles], axis=1))[:, 1]
            rates = (np.abs(np.diff(v) / np.diff(x)) for v, x in ((speeds, gaps), (turns, angles)))
            steepest = max(steepest, *(float(r.max()) for r in rates))
        return min(FINE * self.distance / self.speed, QUICK / max(steepest, 1e-9))

    @cached_property
    def _answers(self) -> tuple[Evaluator, ...]:
        """(u, w) of every follower by its range and bearing."""
        arguments = [q.symbol for q in SEEN]
        return tuple(
            Evaluator([law.outputs["uF"], law.outputs["wF"]], arguments, law.parameters)
            for law in self.laws
        )

    def moved(
        self, fields: Fields, number: int, poses: Array, curvature: Array, turning: Flags, on: Flags
    ) -> tuple[Array, Flags]:
        """Poses (run, robot, x y theta) one step later, the leader first, and who still turns.

        The leader moves on an arc of that curvature [1/m] while it is `turning`, until its heading
        is that of the leg's field, and otherwise along the field by (6.23). It is stationary where
        it is not `on`. Each follower moves by its law behind the one before it.
        """
        dt, found = self.step, np.empty_like(poses)
        place, theta = poses[:, 0, :2], poses[:, 0, 2]
        wanted = fields.headings(number, place)
        turning = turning & (curvature * wrapped(wanted - theta) > 0)
        after_arc = theta + curvature * self.speed * dt
        onwards = place + self.speed * dt * unit(np.where(turning, (theta + after_arc) / 2, theta))
        off = wrapped(theta - wanted) * math.exp(-self.gain * dt)
        along = fields.headings(number, onwards) + off
        found[:, 0, :2] = np.where(on[:, None], onwards, place)
        found[:, 0, 2] = np.where(on, np.where(turning, after_arc, along), theta)
        for k, answer in enumerate(self._answers, start=1):
            apart = poses[:, k - 1, :2] - poses[:, k, :2]
            bearing = wrapped(np.arctan2(apart[:, 1], apart[:, 0]) - poses[:, k, 2])
            seen = np.stack([np.hypot(apart[:, 0], apart[:, 1]), bearing], axis=1)
            u, w = answer.values(seen).T
            found[:, k, 2] = poses[:, k, 2] + w * dt
            found[:, k, :2] = poses[:, k, :2] + (u * dt)[:, None] * unit(
                poses[:, k, 2] + w * dt / 2
            )
        return found, turning


def unit(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def wrapped(angle: Array) -> Array:
    found: Array = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
    return found
