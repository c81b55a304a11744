"""Viability conditions at many states of a region's boundary: (5.11)-(5.13)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.analysis.boundary.constraint_qualification import equalities, qualified
from holdfast.analysis.boundary.contingent_cone import ContingentCone, generators
from holdfast.analysis.boundary.regulation_map import RegulationMap, input_half_spaces
from holdfast.arguments import checked
from holdfast.errors import DefinitionError, SimulationError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.control.barrier_conditions import ViabilityCondition, viability_conditions
from holdfast.maths.definitions.quantity import merge_parameters
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.random_points import is_zero
from holdfast.maths.expressions.traversal import derivatives


@checked
class Boundary:
    """Viability conditions of a region: compiled once, evaluated at many states.

    `parameters` replaces values of parameters by name; a constraint within `tolerance` of 0
    is active. Raises `DefinitionError` for constraints whose relative degree is above 2, and
    for inputs bounded by a ball.
    """

    def __init__(
        self,
        system: System,
        region: Region,
        *,
        parameters: Mapping[str, float] | None = None,
        tolerance: float = 1e-6,
    ) -> None:
        if not (isinstance(tolerance, (int, float)) and 0 < tolerance < np.inf):
            raise DefinitionError(f"tolerance is {tolerance!r}", expected="a number above 0")
        self.system, self.region, self.tolerance = system, region, tolerance
        self.conditions: tuple[ViabilityCondition, ...] = viability_conditions(system, region)
        known = merge_parameters(system.parameters, region.parameters)
        self.given = dict(parameters or {})
        for name in self.given:
            if name not in (names := [p.name for p in known]):
                raise DefinitionError(f"no parameter '{name}'", remedy=suggestion(name, names))
        for p in known:  # the same checks as at the declaration
            replace(p, value=self.given.get(p.name, p.value))
        self._values = {p.symbol: self.given.get(p.name, p.value) for p in known}
        n, m, w = len(system.states), len(system.inputs), len(system.disturbances)
        self._cut = np.cumsum([1, n, 1, m, w, 1])
        expressions: list[Any] = []
        self._ties: list[range] = []
        for c in self.conditions:
            expressions += [c.value, *c.gradient, c.rate, *c.effect, *c.carried, c.drift]
        self._row = len(expressions) // len(self.conditions)
        for c in self.conditions:
            self._ties.append(range(len(expressions), len(expressions) + len(c.ties)))
            expressions += c.ties
        arguments = [q.symbol for q in (*system.states, *system.disturbances)]
        self._evaluate = Evaluator(expressions, arguments, known)
        self._bounds = input_half_spaces(system, self._values)
        self._is_linear: dict[int, bool] = {}

    def _parts(self, states: Array, disturbance: Array) -> tuple[list[Array], Array]:
        points = np.hstack([states, np.broadcast_to(disturbance, (len(states), len(disturbance)))])
        out = self._evaluate.values(points, self.given)
        count = len(self.conditions)
        table = out[:, : count * self._row].reshape(len(states), count, self._row)
        return np.split(table, self._cut[:-1], axis=2), out

    def _at(self, state: Sequence[float], disturbance: Array) -> tuple[list[Array], list[int]]:
        try:
            point = np.asarray(state, dtype=np.float64)
        except (TypeError, ValueError):
            point = np.zeros(0)
        if point.shape != (len(self.system.states),) or not np.isfinite(point).all():
            raise SimulationError(
                f"the state is {state!r}",
                expected="finite numbers for " + ", ".join(self.system.state_names),
            )
        parts, out = self._parts(point[None], disturbance)
        parts = [p[0] for p in parts]
        values = parts[0][:, 0]
        if not np.isfinite(values).all():
            raise SimulationError("a constraint has no value at this state")
        active = [int(j) for j in np.flatnonzero(np.abs(values) <= self.tolerance)]
        for j in active:
            if any(abs(out[0, k]) <= self.tolerance for k in self._ties[j]):
                raise SimulationError(
                    f"'{self.conditions[j].name}' has a kink here that is not an intersection of "
                    "half-spaces: its cone may be a union",
                    remedy="evaluate at a neighbouring state",
                )
            if np.linalg.norm(parts[1][j]) <= 1e-12:
                raise SimulationError(
                    f"the gradient of '{self.conditions[j].name}' vanishes on the boundary here",
                    remedy="write the constraint with a nonzero gradient: |r| - 1, not (|r| - 1)^3",
                )
        return parts, active

    @checked
    def worst(self, states: Array) -> Array:
        """max_j c_j of each state, shape (count,), which is <= 0 exactly in the region."""
        states = np.asarray(states, dtype=np.float64)
        if states.ndim != 2 or states.shape[1] != len(self.system.states):
            raise SimulationError(
                f"states have the shape {states.shape}",
                expected=f"(count, {len(self.system.states)})",
            )
        parts, _ = self._parts(states, np.zeros(len(self.system.disturbances)))
        largest: Array = parts[0][:, :, 0].max(axis=1)
        return largest

    @checked
    def active_set(self, state: Sequence[float]) -> tuple[str, ...]:
        """The names of the inequalities that are active, each once."""
        _, active = self._at(state, np.zeros(len(self.system.disturbances)))
        return tuple(dict.fromkeys(self.conditions[j].name for j in active))

    @checked
    def outside(self, state: Sequence[float]) -> tuple[str, ...]:
        """The names of the inequalities that the state violates."""
        parts, _ = self._at(state, np.zeros(len(self.system.disturbances)))
        bad = np.flatnonzero(parts[0][:, 0] > self.tolerance)
        return tuple(dict.fromkeys(self.conditions[j].name for j in bad))

    @checked
    def contingent_cone(self, state: Sequence[float]) -> ContingentCone:
        """T_K(q) at a state of the region; `SimulationError` outside it."""
        parts, active = self._at(state, np.zeros(len(self.system.disturbances)))
        self._refuse_outside(state)
        normals = parts[1][active].reshape(-1, len(self.system.states))
        rays, lines = generators(normals)
        fine = self._qualified(parts, active, np.asarray(state, dtype=float))
        names = tuple(self.conditions[j].name for j in active)
        return ContingentCone(np.asarray(state, dtype=float), normals, names, rays, lines, fine)

    def _refuse_outside(self, state: Sequence[float]) -> None:
        if bad := self.outside(state):
            raise SimulationError(
                f"the state lies outside the region: '{bad[0]}' is violated",
                expected="a state of the region",
            )

    @checked
    def regulation_map(
        self,
        state: Sequence[float],
        *,
        disturbance: Mapping[str, float] | str = "none",
        gains: tuple[float, float] | None = None,
    ) -> RegulationMap:
        """R_K at a state: every active condition with d^k c / dt^k <= 0, within the bounds.

        disturbance: "none", values by name, or "worst": the largest outward rate over the
        disturbance's bounds counts (if it enters affinely, and not before the inputs). Where the
        second derivative decides, dc/dt < 0 leaves the input free and dc/dt > 0 is hopeless. With
        `gains` = (k1, k2) in 1/s the conditions are those of a control barrier function, in the
        whole region and not only on its boundary:

            dc/dt + k1 c <= 0,    d2c/dt2 + (k1 + k2) dc/dt + k1 k2 c <= 0

        Raises `SimulationError` for a state outside the region.
        """
        if gains is not None and not (
            isinstance(gains, Sequence)
            and len(gains) == 2
            and all(isinstance(k, (int, float)) and 0 < k < np.inf for k in gains)
        ):
            raise SimulationError(f"gains is {gains!r}", expected="two numbers above 0, in 1/s")
        given = self._disturbance(disturbance)
        parts, active = self._at(state, given)
        self._refuse_outside(state)
        value, _, rate, effect, carried, drift = parts
        rows, offsets, names, hopeless = [], [], [], []
        for j in range(len(self.conditions)) if gains else active:
            c = self.conditions[j]
            speed = float(rate[j, 0])
            if disturbance == "worst" and not c.affine:
                raise SimulationError(
                    f"the worst disturbance of '{c.name}' is not known: it is not affine, or "
                    "enters before the inputs do",
                    remedy="give the disturbance by name",
                )
            if c.relative_degree == 2:
                if gains:
                    k1, k2 = gains
                    rest = (k1 + k2) * speed + k1 * k2 * float(value[j, 0])
                elif speed > self.tolerance:
                    hopeless.append(c.name)
                    continue
                elif speed < -self.tolerance:
                    continue
                else:
                    rest = 0.0
            else:
                rest = gains[0] * float(value[j, 0]) if gains else 0.0
            rest += float(drift[j, 0])
            if disturbance == "worst":
                rest += self._worst(carried[j])
            rows.append(effect[j])
            offsets.append(-rest)
            names.append(c.name)
        bounds, limits = self._bounds
        m = len(self.system.inputs)
        return RegulationMap(
            np.asarray(state, dtype=float),
            self.system.inputs,
            np.vstack([np.array(rows).reshape(-1, m), bounds]),
            np.concatenate([offsets, limits]),
            tuple(names),
            tuple(dict.fromkeys(hopeless)),
            self._qualified(parts, active, np.asarray(state, dtype=float)),
        )

    def _qualified(self, parts: list[Array], active: list[int], state: Array) -> bool:
        """Whether the linearised cone of the active conditions is the contingent cone."""
        if len(active) < 2:  # no gradient vanishes
            return True
        normals = parts[1][active]
        linear = np.array([self._linear(j) for j in active])
        equality = np.full(len(active), -1)
        if not linear.all():
            nearby = (
                state
                + np.random.default_rng(0).normal(size=(32, len(state)))
                * (np.repeat([1e-3, 1e-2, 1e-1, 1.0], 8)[:, np.newaxis])
            )
            still = np.zeros(len(self.system.disturbances))
            with np.errstate(all="ignore"):
                values = self._parts(nearby, still)[0][0][:, active, 0]
            equality = equalities(normals, values)
        return qualified(normals, linear, equality)

    def _linear(self, j: int) -> bool:
        """Whether a condition is affine in the states, away from its ties."""
        if j not in self._is_linear:
            by = [q.symbol for q in self.system.states]
            slopes = (derivatives(g, by).values() for g in self.conditions[j].gradient)
            self._is_linear[j] = all(is_zero(s) for row in slopes for s in row)
        return self._is_linear[j]

    def _disturbance(self, disturbance: Mapping[str, float] | str) -> Array:
        names = self.system.disturbance_names
        if isinstance(disturbance, str):
            if disturbance not in ("none", "worst"):
                raise SimulationError(
                    f"disturbance is '{disturbance}'", expected="'none', 'worst' or values by name"
                )
            if disturbance == "worst" and names and self.system.disturbance_bounds is None:
                raise SimulationError("the disturbance has no bounds, so no worst value")
            return np.zeros(len(names))
        for name in disturbance:
            if name not in names:
                raise SimulationError(f"no disturbance '{name}'", remedy=suggestion(name, names))
        values = np.array([float(disturbance.get(n, 0.0)) for n in names])
        bounds = self.system.disturbance_bounds
        if not np.isfinite(values).all() or (
            bounds is not None and not bounds.at(self._values).contains(list(values))
        ):
            raise SimulationError(
                f"the disturbance is {dict(disturbance)}", expected="finite, within its bounds"
            )
        return values

    def _worst(self, row: Array) -> float:
        """The largest contribution of the disturbance to an outward rate: the support function."""
        bounds = self.system.disturbance_bounds
        if bounds is None or not np.any(row):
            return 0.0
        largest = bounds.at(self._values).support_value(list(map(float, row)))
        if not np.isfinite(largest):
            raise SimulationError("a disturbance that enters the rate here has no bounds")
        return largest


@checked
def regulation_map(
    system: System,
    region: Region,
    state: Sequence[float],
    *,
    parameters: Mapping[str, float] | None = None,
    tolerance: float = 1e-6,
    disturbance: Mapping[str, float] | str = "none",
    gains: tuple[float, float] | None = None,
) -> RegulationMap:
    """The inputs that keep `state` inside `region`: see `Boundary` and its `regulation_map`.

    For many states build one `Boundary` and reuse it.
    """
    boundary = Boundary(system, region, parameters=parameters, tolerance=tolerance)
    return boundary.regulation_map(state, disturbance=disturbance, gains=gains)


@checked
def contingent_cone(
    system: System,
    region: Region,
    state: Sequence[float],
    *,
    parameters: Mapping[str, float] | None = None,
    tolerance: float = 1e-6,
) -> ContingentCone:
    """The velocities that keep `state` inside `region`: see `Boundary.contingent_cone`."""
    boundary = Boundary(system, region, parameters=parameters, tolerance=tolerance)
    return boundary.contingent_cone(state)
