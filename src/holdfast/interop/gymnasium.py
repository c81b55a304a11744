"""A system within its region as a Gymnasium environment; a safety filter around any environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np

from holdfast.analysis.online.decision import Decision
from holdfast.analysis.online.safety_filter import SafetyFilter
from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.interop.numeric_system import Numeric
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

DRAWS = 10_000


class Environment(gymnasium.Env[Array, Array]):
    """The plant, sampled: an action is held for `sample_time` [s], an observation is the state.

    An action is a number from -1 (least value) to 1 (largest value) for every actuator (thruster,
    or input). An episode ends when the region is left (reward -1) or the goal is entered (reward
    +1), and is truncated at `horizon` [s]; before that the reward is 0.

    box: state -> (low, high) of the starts, uniform, in the region; states left out start at 0.
    disturbance: constant values by name, else 0. `info["constraints"]` are the c_j, safe where <=
    0. substeps: classical Runge-Kutta steps in a sample; an exit from the region is detected after
    each.

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
        by_name = disturbance or {}
        self.pushed = np.array([by_name.get(n, 0.0) for n in system.disturbance_names])
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
        """A new random start in the region, shape (states,)."""
        super().reset(seed=seed)
        for _ in range(DRAWS):
            start = self.np_random.uniform(self.ends[:, 0], self.ends[:, 1])
            if (self._safe.values(start[np.newaxis]) <= 0).all():
                self.state, self.count = start, 0
                return start.copy(), self._info()
        raise DefinitionError(f"none of {DRAWS} starts from the box is in the region")

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """The state after one sample of the action, the reward, and whether the episode is over.
        action: shape (actuators,), each from -1 to 1. The state has the shape (states,)."""
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

    def command(self, action: Array) -> Array:
        """The inputs of the system that an action produces: shapes (inputs,) and (actuators,)."""
        share = (np.clip(action, -1.0, 1.0) + 1.0) / 2.0
        held = self.low + share * (self.high - self.low)
        return self.numeric.inputs(held)

    def action(self, decision: Decision) -> Array:
        """The action that applies a decision, shape (actuators,)."""
        wide = self.high - self.low
        scaled: Array = 2.0 * (decision.actuators - self.low) / wide - 1.0
        return scaled

    def _moved(self, q: Array, held: Array, h: float) -> Array:
        t = self.count * self.sample_time

        def rates(state: Array, at: float) -> Array:
            return self.numeric.rates(np.concatenate([state, held, self.pushed, [at]]))

        one = rates(q, t)
        two = rates(q + h / 2 * one, t + h / 2)
        three = rates(q + h / 2 * two, t + h / 2)
        four = rates(q + h * three, t + h)
        after: Array = q + h / 6 * (one + 2 * two + 2 * three + four)
        return after

    def _info(self) -> dict[str, Any]:
        values = self._safe.values(self.state[np.newaxis])[0]
        return {"constraints": dict(zip(self.names, values.tolist(), strict=True))}


class Filtered(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Any environment, with a safety filter (shield) between the agent and its actions.

    env: any environment of Gymnasium. keep: the filter. state: what `keep.step` takes as the state,
    from an observation. command: its command, from an action. action: the action that applies a
    decision; of `input`, or of `actuators`. All three have defaults for an `Environment` of the
    filter's system. disturbance: what the filter measures, from an observation.

    `info["decision"]` of a step is the decision, and `info["overruled"]` whether the action was
    changed to stay inside. With an action that is not finite the environment gets the fallback.

    Raises `DefinitionError` for samples of another length than those of the filter.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        keep: SafetyFilter,
        *,
        state: Callable[[Any], Any] | None = None,
        command: Callable[[Any], Any] | None = None,
        action: Callable[[Decision], Any] | None = None,
        disturbance: Callable[[Any], Any] | None = None,
    ) -> None:
        super().__init__(env)
        inner = env.unwrapped
        same_system = isinstance(inner, Environment) and inner.system == keep.system
        if not same_system and None in (state, command, action):
            raise DefinitionError(
                "the environment is not one of the filter's system",
                expected="state, command and action, from observations, actions and decisions",
            )
        if isinstance(inner, Environment) and inner.sample_time != keep.sample_time:
            raise DefinitionError(
                f"the environment has samples of {inner.sample_time:g} s, the filter of "
                f"{keep.sample_time:g} s"
            )
        self.keep, self._disturbance = keep, disturbance
        self._state = state or np.asarray
        self._command = command or inner.command  # type: ignore[attr-defined]
        self._action = action or inner.action  # type: ignore[attr-defined]
        self._seen: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """A new episode of the environment and of the filter."""
        self.keep.reset()
        self._seen, info = self.env.reset(seed=seed, options=options)
        return self._seen, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """The environment after the action that the filter lets through."""
        if self._seen is None:
            raise DefinitionError("the episode has not begun", remedy="reset first")
        felt = None if self._disturbance is None else self._disturbance(self._seen)
        decision = self.keep.step(self._state(self._seen), self._command(action), None, felt)
        self._seen, reward, over, cut_off, info = self.env.step(self._action(decision))
        added = {"decision": decision, "overruled": decision.overruled}
        return self._seen, reward, over, cut_off, {**info, **added}
