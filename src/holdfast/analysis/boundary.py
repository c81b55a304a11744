"""Viability conditions at a region's boundary: contingent cone, regulation map; (5.11)-(5.13).

The contingent cone is that of the velocities that keep a state in a region; the regulation map that
of the inputs that do. When the linearised cone of active constraints is the contingent cone:

    { v : g_i . v <= 0 for every active i },   g_i = grad c_i

Linear constraints alone need nothing more: the ray along v stays inside (Abadie). Beside others it
suffices that some v has g . v < 0 for these and g . v <= 0 for the linear ones (Mangasarian and
Fromovitz): a velocity of the cone and a little of v stay inside along a straight line. Linearly
dependent, redundant and opposed gradients are no obstacle to either.

Two constraints c <= 0 and -c <= 0 that are not linear are an equality, and the region has no
interior: their gradients have to be independent, and v tangent to them, with g . v < 0 for all
constraints that are no equalities. O. L. Mangasarian, Nonlinear Programming (1969), chapter 11.

A region's viability is checked by samples: the worst state of many on its boundary is told.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from holdfast.analysis.reachability.grid import whole
from holdfast.arguments import checked
from holdfast.errors import DefinitionError, SimulationError, check_name, suggestion
from holdfast.execution.arrays import AnyArray, Array, Truths
from holdfast.execution.leaf import Evaluator
from holdfast.maths.control.barrier_conditions import ViabilityCondition, viability_conditions
from holdfast.maths.definitions.quantity import Quantity, merge_parameters
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.random_points import is_zero
from holdfast.maths.expressions.traversal import derivatives

SMALL = 1e-9
"""Of gradients of length 1."""


def qualified(normals: Array, linear: Truths, equality: npt.NDArray[np.intp]) -> bool:
    """Whether the linearised cone is exact.

    normals: the gradients, shape (active, n), none of them 0. linear: which constraints are affine.
    equality: the number of the equality that each is a side of, or -1 (`equalities`).
    """
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    bent = (equality >= 0) & ~linear
    curved, flat = unit[~linear & ~bent], unit[linear]
    if not bent.any():
        return _has_direction(curved, flat, flat[:0])
    implied = np.array([not _has_direction(row[np.newaxis], flat, flat[:0]) for row in flat], bool)
    _, first = np.unique(equality[bent], return_index=True)
    ties = np.vstack([unit[bent][first], _independent(flat[implied])])
    if np.linalg.matrix_rank(ties, tol=SMALL) < len(ties):
        return False
    return _has_direction(np.vstack([curved, flat[~implied]]), flat[:0], ties)


def equalities(normals: Array, values: Array) -> npt.NDArray[np.intp]:
    """For each constraint the number of the equality that it is a side of, or -1.

    Two are the sides of one where c and -c are the same but for a factor above 0. values: those of
    the constraints at random states, shape (states, active).
    """
    sizes = np.linalg.norm(normals, axis=1)
    unit = normals / sizes[:, np.newaxis]
    values = values[np.isfinite(values).all(axis=1)] / sizes
    scale = np.abs(values).max(initial=0.0, axis=1)
    number, both = np.arange(len(unit)), np.zeros(len(unit), dtype=bool)
    for i in range(len(unit) if len(values) else 0):
        for j in range(i):
            sign = np.sign(unit[i] @ unit[j])
            same = np.abs(values[:, i] - sign * values[:, j]) <= SMALL * scale
            if np.abs(unit[i] - sign * unit[j]).max() <= SMALL and same.all():
                number[i] = number[j]
                both[number[i]] |= sign < 0
                break
    return np.where(both[number], number, -1)


def _has_direction(below: Array, at_most: Array, ties: Array) -> bool:
    """Whether some v has below v < 0, at_most v <= 0 and ties v = 0."""
    if not len(below):
        return True
    n = below.shape[1]
    rows = np.vstack(
        [
            np.hstack([below, np.ones((len(below), 1))]),
            np.hstack([at_most, np.zeros((len(at_most), 1))]),
        ]
    )
    solution = linprog(
        [*np.zeros(n), -1.0],
        A_ub=rows,
        b_ub=np.zeros(len(rows)),
        A_eq=np.hstack([ties, np.zeros((len(ties), 1))]) if len(ties) else None,
        b_eq=np.zeros(len(ties)) if len(ties) else None,
        bounds=[(-1, 1)] * n + [(None, 1)],
    )
    return bool(solution.status == 0 and -solution.fun > SMALL)


def _independent(rows: Array) -> Array:
    """Rows that span what the rows span."""
    if not len(rows):
        return rows
    _, sizes, right = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(right[sizes > SMALL])


@dataclass(frozen=True)
class ContingentCone:
    """T_K(q) = { v : normals v <= 0 }: the velocities along which q does not leave the region.

    This is the linearised cone. It is the contingent cone where the constraints are `qualified`:
    linear ones always are. Where they are not, as at a cusp, the contingent cone may be smaller,
    and a velocity of this one may leave the region.

    `normals` are the gradients of the active pieces (none: every velocity). Every such v is
    a combination of the rows of `rays` with weights >= 0 and of those of `lines` with any.
    """

    state: Array
    normals: Array
    active: tuple[str, ...]
    rays: Array
    lines: Array
    qualified: bool = True

    def contains(self, velocity: Sequence[float], slack: float = 1e-9) -> bool:
        """Whether the velocity points along or into the region."""
        v = np.asarray(velocity, dtype=np.float64)
        if v.shape != self.state.shape or not np.isfinite(v).all():
            raise SimulationError(
                f"the velocity is {velocity!r}", expected=f"{len(self.state)} numbers"
            )
        return bool((self.normals @ v <= slack).all())


def generators(normals: Array) -> tuple[Array, Array]:
    """Rays and lines of { v : normals v <= 0 }, each of length 1: normals (rows, inputs), rays and
    lines (count, inputs)."""
    n = normals.shape[1]
    if not len(normals):
        return np.zeros((0, n)), np.eye(n)
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    _, sizes, right = np.linalg.svd(unit)
    rank = int((sizes > 1e-10).sum())
    span, lines = right[:rank], right[rank:]
    rays: list[Array] = []
    for rows in itertools.combinations(range(len(unit)), rank - 1):
        inside = unit[list(rows)] @ span.T
        _, s, v = np.linalg.svd(inside) if len(rows) else (None, np.zeros(0), np.eye(rank))
        if (s > 1e-10).sum() < rank - 1:
            continue
        for ray in (v[-1] @ span, -v[-1] @ span):
            along = (unit @ ray <= 1e-10).all()
            if along and not any(np.allclose(ray, r, atol=1e-9) for r in rays):
                rays.append(ray)
    return np.array(rays).reshape(-1, n), lines


@dataclass(frozen=True)
class RegulationMap:
    """R_K(z) = { u in U : normals u <= offsets }: the inputs that do not leave the region.

    The rows come from the viability conditions first (`conditions` names their inequalities),
    then from the bounds U of the inputs. `hopeless` are inequalities that are violated for any
    input: they are being crossed, and the input acts only on their second derivative. `qualified`:
    whether the linearised cone of the active constraints is the contingent cone, as
    `ContingentCone.qualified` has it; where it is not, an input of the map may still leave the
    region.
    """

    state: Array
    inputs: tuple[Quantity, ...]
    normals: Array
    offsets: Array
    conditions: tuple[str, ...]
    hopeless: tuple[str, ...] = ()
    qualified: bool = True

    @property
    def empty(self) -> bool:
        """Whether no admissible input keeps the state inside."""
        return bool(self.hopeless) or self.least_violation()[1] > 1e-9

    def contains(self, u: Sequence[float] | AnyArray, slack: float = 1e-9) -> bool:
        """Whether the input is admissible and keeps the state inside: u has the shape (inputs,)."""
        point = np.asarray(u, dtype=np.float64)
        if point.shape != (len(self.inputs),) or not np.isfinite(point).all():
            raise SimulationError(f"the input is {u!r}", expected=f"{len(self.inputs)} numbers")
        return not self.hopeless and bool((self.normals @ point <= self.offsets + slack).all())

    def least_violation(self) -> tuple[Array, float]:
        """The input in U whose worst outward rate is least, and that rate (below 0: inward); the
        input has the shape (inputs,).

        A rate is d^k c / dt^k in the constraint's own unit; where no condition is active it is
        minus infinity. Raises `SimulationError` where the bounds admit no input.
        """
        active, m = len(self.conditions), len(self.inputs)
        if not active:
            return self._any_input(), -math.inf
        upper = np.hstack([self.normals[:active], -np.ones((active, 1))])
        bounds = np.hstack([self.normals[active:], np.zeros((len(self.offsets) - active, 1))])
        solution = linprog(
            [*np.zeros(m), 1.0],
            A_ub=np.vstack([upper, bounds]),
            b_ub=self.offsets,
            bounds=[(None, None)] * m + [(-1e6, None)],
        )
        if solution.status != 0:
            raise SimulationError(f"the linear program was not solved ({solution.message})")
        return np.asarray(solution.x[:m]), float(solution.x[m])

    def _any_input(self) -> Array:
        solution = linprog(
            np.zeros(len(self.inputs)),
            A_ub=self.normals if len(self.normals) else None,
            b_ub=self.offsets if len(self.offsets) else None,
            bounds=[(None, None)] * len(self.inputs),
        )
        if solution.x is None:
            raise SimulationError(f"the bounds of the inputs admit no input ({solution.message})")
        return np.asarray(solution.x)

    @property
    def vertices(self) -> Array:
        """The corners for one or two inputs, in order; shape (0, inputs) where it is empty.

        Raises `DefinitionError` for more inputs, or where the map is not bounded.
        """
        m = len(self.inputs)
        if m > 2:
            raise DefinitionError(
                f"vertices of a regulation map in {m} inputs", expected="one or two inputs"
            )
        if self.hopeless:
            return np.zeros((0, m))
        points = []
        for rows in itertools.combinations(range(len(self.offsets)), m):
            matrix = self.normals[list(rows)]
            if abs(np.linalg.det(matrix)) > 1e-12 * np.prod(np.linalg.norm(matrix, axis=1)):
                point = np.linalg.solve(matrix, self.offsets[list(rows)])
                if self.contains(point, 1e-9 * (1.0 + float(np.abs(point).max()))):
                    points.append(point)
        if not points and self.empty:
            return np.zeros((0, m))
        self._refuse_unbounded()
        corners = np.array(points).reshape(-1, m)
        corners = corners[np.sort(np.unique(np.round(corners, 9), axis=0, return_index=True)[1])]
        if m == 1:
            corners = np.sort(corners, axis=0)
        if m == 2 and len(corners) > 2:
            around = corners - corners.mean(axis=0)
            corners = corners[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]
        return corners

    def _refuse_unbounded(self) -> None:
        m = len(self.inputs)
        for direction in (*np.eye(m), *-np.eye(m)):
            ray = linprog(
                -direction,
                A_ub=self.normals,
                b_ub=np.zeros(len(self.offsets)),
                bounds=[(-1, 1)] * m,
            )
            if ray.status == 0 and -ray.fun > 1e-9:
                raise DefinitionError(
                    "the regulation map is not bounded", remedy="give every input bounds"
                )


def input_half_spaces(system: System, values: Mapping[Any, float]) -> tuple[Array, Array]:
    """The bounds of the inputs as normals u <= offsets; an unbounded input has no row: shapes
    (rows, inputs) and (rows,)."""
    m = len(system.inputs)
    if system.input_bounds is None:
        return np.zeros((0, m)), np.zeros(0)
    bounds = system.input_bounds.at(values)
    try:
        rows = bounds.half_spaces()
    except DefinitionError:  # more actuators than inputs: the hull of the corners
        return _hull(system, np.array(bounds.corners(), dtype=float))
    normals = np.array([normal for normal, _ in rows], dtype=float).reshape(-1, m)
    return normals, np.array([float(offset) for _, offset in rows])


def _hull(system: System, corners: Array) -> tuple[Array, Array]:
    """The convex hull of points as normals u <= offsets."""
    flat = not np.isfinite(corners).all() or (
        np.linalg.matrix_rank(corners - corners.mean(axis=0)) < corners.shape[1]
    )
    if flat:
        raise DefinitionError(
            f"the actuators of system '{system.name}' have no bounds, or their interval is empty",
            expected="finite bounds, lower below upper",
        )
    if corners.shape[1] == 1:
        return np.array([[1.0], [-1.0]]), np.array([corners.max(), -corners.min()])
    hull = ConvexHull(corners)
    return hull.equations[:, :-1], -hull.equations[:, -1]


@checked
class Boundary:
    """Viability conditions of a region: compiled once, evaluated at many states.

    parameters: name -> value, in place of those of the system and the region. tolerance [unit of
    the constraint]: a constraint this near 0 is active.

    Raises `DefinitionError` for constraints whose relative degree is above 2, and for inputs
    bounded by a ball.

    >>> hf.Boundary(cart, track).regulation_map([1.0, -0.2]).empty
    False
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
        region.check_still()
        self.conditions: tuple[ViabilityCondition, ...] = viability_conditions(system, region)
        declared = merge_parameters(system.parameters, region.parameters)
        self.given = dict(parameters or {})
        for name in self.given:
            if name not in (names := [p.name for p in declared]):
                raise DefinitionError(f"no parameter '{name}'", remedy=suggestion(name, names))
        for p in declared:  # the same checks as at the declaration
            replace(p, value=self.given.get(p.name, p.value))
        self._values = {p.symbol: self.given.get(p.name, p.value) for p in declared}
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
        self._evaluate = Evaluator(expressions, arguments, declared)
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
        numbers = self._disturbance(disturbance)
        parts, active = self._at(state, numbers)
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
            check_name(name, names, SimulationError, f"no disturbance '{name}'")
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
    """The inputs that keep a state inside `region`: see `Boundary` and its `regulation_map`.

    For many states build one `Boundary` and reuse it. state: shape (states,). parameters,
    tolerance: as of `Boundary`. disturbance: name -> value, "none" for 0, or "worst". gains [1/s]:
    of constraints of relative degree two. Raises `DefinitionError` and `SimulationError` as
    `Boundary` does.

    >>> hf.regulation_map(cart, slow, [0.0, 0.5]).vertices
    array([[-1.],
           [-0.]])
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
    """The velocities that keep a state inside `region`: see `Boundary.contingent_cone`.

    state: shape (states,). parameters, tolerance: as of `Boundary`.

    >>> hf.contingent_cone(cart, slow, [0.0, 0.5]).active
    ('fast',)
    """
    boundary = Boundary(system, region, parameters=parameters, tolerance=tolerance)
    return boundary.contingent_cone(state)


@dataclass(frozen=True)
class ViabilityCheck:
    """The findings at the sampled states of the boundary.

    `states` (count, n). `margins`: at each state minus the best input's worst outward rate; below
    0 no input keeps the state inside (minus infinity: an inequality is being crossed and the input
    acts only on its second derivative). `active`: the inequalities there. `worst` is the state of
    the least margin, `viable` whether every margin is >= 0. A sample can prove that a region is
    not a viability domain, never that it is one. Margins are in the units of the constraints'
    derivatives. If inputs act only on the second derivative, random states have dc/dt < 0 (any
    input is sufficient) or dc/dt > 0 (no input is): the share is then that of the states that are
    not yet leaving.
    """

    states: Array
    margins: Array
    active: tuple[tuple[str, ...], ...]

    @property
    def viable(self) -> bool:
        return bool((self.margins >= -1e-9).all())

    @property
    def share(self) -> float:
        """The share of the sampled boundary states at which some input keeps the state inside."""
        return float((self.margins >= -1e-9).mean())

    @property
    def worst(self) -> tuple[Array, float, tuple[str, ...]]:
        """The state of the least margin, that margin, and the active inequalities: the state has
        the shape (states,)."""
        index = int(np.argmin(self.margins))
        return self.states[index], float(self.margins[index]), self.active[index]


@checked
def check_viability(
    boundary: Boundary,
    box: Mapping[str, tuple[float, float]],
    *,
    count: int = 500,
    seed: int = 0,
    disturbance: Mapping[str, float] | str = "none",
) -> ViabilityCheck:
    """Evaluate the regulation map at random states of the boundary of a region.

    boundary: of that region. box: state -> (lowest, highest), in its unit; missing ones are 0.
    count: of states. disturbance: as of `regulation_map`.

    A random ray from a random state of the region is followed to its exit.

    Raises `SimulationError` when the box holds no state of the region, or none of its rays leaves
    the region within the box.

    >>> hf.check_viability(hf.Boundary(cart, slow), {"x": (-1, 1), "v": (-1, 1)}, count=10).share
    1.0
    """
    names = boundary.system.state_names
    if not (isinstance(count, int) and count >= 1):
        raise SimulationError(f"count is {count!r}", expected="a whole number, at least 1")
    whole("seed: ", seed, 0)
    for name, sides in box.items():
        check_name(name, names, SimulationError, f"'{name}' is not a state")
        if len(sides) != 2:
            raise SimulationError(f"the box of '{name}' is {sides!r}", expected="lowest, highest")
    low, high = (np.array([box.get(n, (0.0, 0.0))[i] for n in names], float) for i in (0, 1))
    if not (np.isfinite([low, high]).all() and (low <= high).all()):
        raise SimulationError("the box is not finite", expected="lowest first, finite numbers")
    generator = np.random.default_rng(seed)
    batches: list[Array] = []
    for _ in range(200):
        inside = generator.uniform(low, high, (4 * count, len(names)))
        inside = inside[boundary.worst(inside) < 0]
        if not len(inside):
            continue
        direction = generator.normal(size=inside.shape) * (high - low)
        batches.append(_leaving(boundary, inside, direction, low, high))
        if sum(map(len, batches)) >= count:
            break
    states = np.vstack(batches)[:count] if batches else np.zeros((0, len(names)))
    if not len(states):
        raise SimulationError(
            "no state of the region's boundary was found in the box",
            expected="a box that the boundary passes through",
        )
    margins, active = np.empty(len(states)), []
    for i, state in enumerate(states):
        answer = boundary.regulation_map(state, disturbance=disturbance)
        margins[i] = -math.inf if answer.hopeless else -answer.least_violation()[1]
        if not (answer.conditions or answer.hopeless) and not boundary.active_set(state):
            raise SimulationError(
                "a sampled state of the boundary has no active inequality",
                remedy="raise the tolerance of the boundary",
            )
        active.append((*answer.conditions, *answer.hopeless))
    return ViabilityCheck(states, margins, tuple(active))


def _leaving(boundary: Boundary, start: Array, direction: Array, low: Array, high: Array) -> Array:
    """The exit points of rays from inside the region, as far as they are within the box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(direction > 0, (high - start) / direction, (low - start) / direction)
    reach = np.where(direction == 0, np.inf, reach).min(axis=1)
    steps = np.linspace(0.0, 1.0, 65)[1:]
    inside, outside = np.zeros(len(start)), np.full(len(start), np.nan)
    for step in steps:  # the first crossing, not the last
        open_ = np.isnan(outside)
        here = boundary.worst(start + (step * reach)[:, None] * direction)
        outside = np.where(open_ & (here > 0), step * reach, outside)
        inside = np.where(open_ & (here <= 0), step * reach, inside)
    left = ~np.isnan(outside)
    start, direction, inside, outside = (a[left] for a in (start, direction, inside, outside))
    for _ in range(60):
        middle = 0.5 * (inside + outside)
        good = boundary.worst(start + middle[:, None] * direction) <= 0
        inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
    points: Array = start + inside[:, None] * direction
    return points
