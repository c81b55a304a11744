"""The regulation map: inputs that keep a state in a region, as a polytope, (5.11)-(5.13)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.arrays import Array
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.system import System


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

    def contains(self, u: Sequence[float] | npt.NDArray[Any], slack: float = 1e-9) -> bool:
        """Whether the input is admissible and keeps the state inside."""
        point = np.asarray(u, dtype=np.float64)
        if point.shape != (len(self.inputs),) or not np.isfinite(point).all():
            raise SimulationError(f"the input is {u!r}", expected=f"{len(self.inputs)} numbers")
        return not self.hopeless and bool((self.normals @ point <= self.offsets + slack).all())

    def least_violation(self) -> tuple[Array, float]:
        """The input in U whose worst outward rate is least, and that rate (below 0: inward).

        A rate is d^k c / dt^k in the constraint's own unit; where no condition is active it is
        minus infinity. Raises `SimulationError` where the bounds admit no input.
        """
        active, m = len(self.conditions), len(self.inputs)
        if not active:
            return self._any_input(), -math.inf
        upper = np.hstack([self.normals[:active], -np.ones((active, 1))])
        bounds = np.hstack([self.normals[active:], np.zeros((len(self.offsets) - active, 1))])
        found = linprog(
            [*np.zeros(m), 1.0],
            A_ub=np.vstack([upper, bounds]),
            b_ub=self.offsets,
            bounds=[(None, None)] * m + [(-1e6, None)],
        )
        if found.status != 0:
            raise SimulationError(f"the linear program was not solved ({found.message})")
        return np.asarray(found.x[:m]), float(found.x[m])

    def _any_input(self) -> Array:
        found = linprog(
            np.zeros(len(self.inputs)),
            A_ub=self.normals if len(self.normals) else None,
            b_ub=self.offsets if len(self.offsets) else None,
            bounds=[(None, None)] * len(self.inputs),
        )
        if found.x is None:
            raise SimulationError(f"the bounds of the inputs admit no input ({found.message})")
        return np.asarray(found.x)

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
        found = []
        for rows in itertools.combinations(range(len(self.offsets)), m):
            matrix = self.normals[list(rows)]
            if abs(np.linalg.det(matrix)) > 1e-12 * np.prod(np.linalg.norm(matrix, axis=1)):
                point = np.linalg.solve(matrix, self.offsets[list(rows)])
                if self.contains(point, 1e-9 * (1.0 + float(np.abs(point).max()))):
                    found.append(point)
        if not found and self.empty:
            return np.zeros((0, m))
        self._refuse_unbounded()
        corners = np.array(found).reshape(-1, m)
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
    """The bounds of the inputs as normals u <= offsets; an unbounded input has no row."""
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
