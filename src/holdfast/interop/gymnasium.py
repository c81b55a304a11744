"""A system within its region as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np

from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.interop.numeric_system import Numeric
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

DRAWS = 10_000


class Environment(gymnasium.Env[Array, Array]):
    """The plant, sampled: an action is held for `sample_time` [s], an observation is the state.

    An action is a number from -1 (least value) to 1 (largest value) for every actuator (thruster,
    or input). An episode ends
    when the region is left (reward -1) or the goal is entered (reward +1), and is truncated at
    `horizon` [s]; before that the reward is 0. box: state -> (low, high) of the starts, uniform,
    in the region; states left out start at 0. disturbance: constant values by name, else 0.
    `info["constraints"]` are the c_j, safe where <= 0. A sample takes `substeps` classical
    Runge-Kutta steps; an exit from the region is detected after each.

    Raises `DefinitionError` for inputs without a least and a largest value, for unknown names, and
    if no start is found in the region.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        system: System,
        region: Region,
        *,
        goal: Region | None = None,
        box: Mapping[str, tuple[float, float]],
        sample_time: float = 0.05,
        horizon: float = 60.0,
        substeps: int = 2,
        disturbance: Mapping[str, float] | None = None,
    ) -> None:
        for name in (*box, *(disturbance or {})):
            if name not in (*system.state_names, *system.disturbance_names):
                raise DefinitionError(f"system '{system.name}' has no '{name}'")
        if not (sample_time > 0 and horizon > 0 and substeps >= 1):
            raise DefinitionError("sample_time, horizon and substeps have to be above 0")
        self.system, self.sample_time, self.substeps = system, sample_time, substeps
        self.most = round(horizon / sample_time)
        self.numeric = Numeric(system)
        self.low, self.high = self.numeric.limits()
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, self.low.shape, dtype=np.float64)
        size = (len(system.states),)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, size, dtype=np.float64)
        self.ends = np.array([box.get(n, (0.0, 0.0)) for n in system.state_names], dtype=float)
        given = disturbance or {}
        self.pushed = np.array([given.get(n, 0.0) for n in system.disturbance_names])
        self.names = region.inequality_names
        self._safe = self._watch(region)
        self._goal = self._watch(goal) if goal is not None else None
        self.state, self.count = np.zeros(size), 0

    def _watch(self, region: Region) -> Evaluator:
        states = [q.symbol for q in self.system.states]
        return Evaluator([c.expression for c in region.inequalities], states, region.parameters)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """A new random start in the region."""
        super().reset(seed=seed)
        for _ in range(DRAWS):
            start = self.np_random.uniform(self.ends[:, 0], self.ends[:, 1])
            if (self._safe.values(start[np.newaxis]) <= 0).all():
                self.state, self.count = start, 0
                return start.copy(), self._info()
        raise DefinitionError(f"none of {DRAWS} starts from the box is in the region")

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """The state after one sample of the action, the reward, and whether the episode is over."""
        share = (np.clip(action, -1.0, 1.0) + 1.0) / 2.0
        held = self.low + share * (self.high - self.low)
        h, left = self.sample_time / self.substeps, False
        for _ in range(self.substeps):
            self.state = self._moved(self.state, held, h)
            left = left or bool((self._safe.values(self.state[np.newaxis]) > 0).any())
        self.count += 1
        arrived = self._goal is not None and bool(
            (self._goal.values(self.state[np.newaxis]) <= 0).all()
        )
        reward = -1.0 if left else float(arrived)
        over = self.count >= self.most
        return self.state.copy(), reward, left or arrived, over, self._info()

    def _moved(self, q: Array, held: Array, h: float) -> Array:
        t = self.count * self.sample_time

        def rates(state: Array, at: float) -> Array:
            return self.numeric.rates(np.concatenate([state, held, self.pushed, [at]]))

        one = rates(q, t)
        two = rates(q + h / 2 * one, t + h / 2)
        three = rates(q + h / 2 * two, t + h / 2)
        four = rates(q + h * three, t + h)
        found: Array = q + h / 6 * (one + 2 * two + 2 * three + four)
        return found

    def _info(self) -> dict[str, Any]:
        values = self._safe.values(self.state[np.newaxis])[0]
        return {"constraints": dict(zip(self.names, values.tolist(), strict=True))}
