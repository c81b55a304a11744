"""The contingent cone: velocities that keep a state in a region, as a cone with generators."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array


@dataclass(frozen=True)
class ContingentCone:
    """T_K(q) = { v : normals v <= 0 }: the velocities along which q does not leave the region.

    This is the linearised cone. It is the contingent cone where the constraints are `qualified`
    (`constraint_qualification.py`): linear ones always are. Where they are not, as at a cusp, the
    contingent cone may be smaller, and a velocity of this one may leave the region.

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
    """Rays and lines of { v : normals v <= 0 }, each of length 1."""
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
