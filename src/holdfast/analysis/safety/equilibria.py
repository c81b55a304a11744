"""Equilibria in a region: where a system can rest under a constant disturbance, farthest inside."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp
from scipy.optimize import minimize
from scipy.stats import qmc

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.control.outward_rates import check_reads
from holdfast.maths.definitions.quantity import TIME, merge_parameters
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import derivatives

Values = tuple[Array, Array, Array, Array]

STARTS = 16
DEPENDENT = (5, 6)
"""What SLSQP answers where equations depend on each other, as those of a unicycle at rest."""
STEPS, ENDLESS = 200, 1e6
"""Iterations of a search, and the margin beyond which a region counts as unbounded."""
UNBOUNDED = "the margin still grew when the search ended: the region may be unbounded"
EXACT = 1e-6
"""Largest rate, and largest excess of a bound, of what counts as at rest, in SI units."""


@dataclass(frozen=True)
class RestingState:
    """The equilibrium farthest inside a region, or the best that was found, and what it lacks.

    state, inputs, disturbance: name -> value in SI units. margin: the least -c_j there, in the unit
    of c_j; below 0 it is outside. residual: the largest rate left. missing: empty for an
    equilibrium in the region, else the reason why there is none.
    """

    state: Mapping[str, float]
    inputs: Mapping[str, float]
    disturbance: Mapping[str, float]
    margin: float
    residual: float
    missing: str = ""

    @property
    def exists(self) -> bool:
        return not self.missing


@checked
def resting_state(
    system: System,
    region: Region,
    disturbance: Mapping[str, float] | None = None,
    *,
    box: Mapping[str, tuple[float, float]] | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> RestingState:
    """Where `system` rests in `region` under a constant disturbance d, as far inside as can be.

        maximise t   subject to   f(q, u, d) = 0,   c_j(q) + t <= 0 for every j,   u within bounds

    A local solver (SLSQP, derivatives of the same expressions) begins at `starts` points of a Sobol
    sequence over `box`: state -> (lowest, highest), unless given [-1, 1] in SI units and a whole
    turn of an angle. The answer is verified by its own rates, constraints and bounds. It is the
    best of the local ones: another may exist, and none found does not prove that there is none.
    c_j of different units count alike, 1 m as 1 rad. Disturbances left out are 0.

    Raises `DefinitionError` for unknown names, rates or constraints that depend on time, a region
    of other states, and inputs whose bounds are no half-spaces.
    """
    return _Search(system, region, box, starts, seed).solve(_disturbance(system, disturbance), [])


@checked
def resting_directions(
    system: System,
    region: Region,
    speed: float,
    *,
    count: int = 360,
    box: Mapping[str, tuple[float, float]] | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> tuple[RestingState, ...]:
    """`resting_state` for a disturbance of one size in `count` directions of its plane.

        d = speed (cos theta, sin theta),   theta = 2 pi k / count,   k = 0 ... count - 1

    Each search begins at the answer of the direction before it too. Raises `DefinitionError` for a
    system that has not two disturbances, and as `resting_state`.
    """
    names = system.disturbance_names
    if len(names) != 2:
        raise DefinitionError(
            f"system '{system.name}' has {len(names)} disturbances", expected="two, as a current"
        )
    if not 0 <= speed < math.inf:
        raise DefinitionError(f"speed is {speed:g}", expected="0 or more")
    if not count >= 1:
        raise DefinitionError(f"count is {count}", expected="at least 1")
    search = _Search(system, region, box, starts, seed)
    found: list[RestingState] = []
    last: list[Array] = []
    for theta in 2 * math.pi * np.arange(count) / count:
        d = {names[0]: speed * math.cos(theta), names[1]: speed * math.sin(theta)}
        found.append(search.solve(d, last))
        if found[-1].exists:
            values = [*found[-1].state.values(), *found[-1].inputs.values(), found[-1].margin]
            last = [np.array(values)]
    return tuple(found)


def _disturbance(system: System, given: Mapping[str, float] | None) -> dict[str, float]:
    given = dict(given or {})
    for name, value in given.items():
        if name not in system.disturbance_names:
            raise DefinitionError(
                f"'{name}' is not a disturbance of system '{system.name}'",
                remedy=suggestion(name, system.disturbance_names),
            )
        if not math.isfinite(value):
            raise DefinitionError(f"disturbance '{name}' is {value}", expected="a finite number")
    return {name: float(given.get(name, 0.0)) for name in system.disturbance_names}


class _Search:
    """The problem of one system and region, compiled once, for any disturbance."""

    def __init__(
        self,
        system: System,
        region: Region,
        box: Mapping[str, tuple[float, float]] | None,
        starts: int,
        seed: int,
    ) -> None:
        check_reads(system, region)
        if not starts >= 1:
            raise DefinitionError(f"starts is {starts}", expected="at least 1")
        if seed < 0:
            raise DefinitionError(f"seed is {seed}", expected="0 or more")
        self.system, self.region, self.seed, self.starts = system, region, seed, starts
        self.states, self.inputs = len(system.states), len(system.inputs)
        self.box = self._box(box or {})
        rates = [system.rates[n] for n in system.state_names]
        inequalities = [c.expression for c in region.inequalities]
        if any(sp.sympify(e).has(TIME) for e in (*rates, *inequalities)):
            raise DefinitionError(f"system '{system.name}' or its region depends on time")
        names = [q.symbol for q in (*system.states, *system.inputs, *system.disturbances)]
        free = names[: self.states + self.inputs]
        slopes = [s for e in (*rates, *inequalities) for s in derivatives(e, free).values()]
        self.count = len(rates), len(inequalities)
        parameters = merge_parameters(system.parameters, region.parameters)
        self.evaluator = Evaluator([*rates, *inequalities, *slopes], names, parameters)
        self._last: tuple[bytes, Values] | None = None

    def _box(self, given: Mapping[str, tuple[float, float]]) -> Array:
        for name, ends in given.items():
            if name not in self.system.state_names:
                raise DefinitionError(
                    f"box: '{name}' is not a state of system '{self.system.name}'",
                    remedy=suggestion(name, self.system.state_names),
                )
            if not (len(ends) == 2 and -math.inf < ends[0] <= ends[1] < math.inf):
                raise DefinitionError(f"box: {name} = {ends}", expected="(lowest, highest)")
        usual = {q.name: math.pi if q.angle else 1.0 for q in self.system.states}
        return np.array([given.get(n, (-half, half)) for n, half in usual.items()], dtype=float)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """A, b of A u <= b."""
        numbers = {p.symbol: p.value for p in self.system.parameters}
        given = self.system.input_bounds
        rows = [] if given is None else given.at(numbers).half_spaces()
        a = np.array([[float(e) for e in normal] for normal, _ in rows]).reshape(-1, self.inputs)
        return a, np.array([float(limit) for _, limit in rows])

    def values(self, z: Array, d: Array) -> Values:
        """f, c and their slopes along (q, u) at z = (q, u, t); the solver asks for each in turn."""
        n, m = self.count
        point = np.concatenate([z[:-1], d])
        key = point.tobytes()
        if self._last is None or self._last[0] != key:
            found = self.evaluator.values(point[None])[0]
            slopes = found[n + m :].reshape(n + m, self.states + self.inputs)
            self._last = key, (found[:n], found[n : n + m], slopes[:n], slopes[n:])
        return self._last[1]

    def solve(self, disturbance: Mapping[str, float], known: list[Array]) -> RestingState:
        """The best within the bounds, else the one that only the bounds of the inputs forbid."""
        best = self._best(disturbance, known, bounded=True)
        if best.exists or best.missing == UNBOUNDED or not len(self.bounds[1]):
            return best
        free = self._best(disturbance, known, bounded=False)
        return free if free.residual <= EXACT and free.margin >= -EXACT else best

    def _best(
        self, disturbance: Mapping[str, float], known: list[Array], *, bounded: bool
    ) -> RestingState:
        d = np.array(list(disturbance.values()), dtype=float)
        a, b = self.bounds
        width = self.states + self.inputs + 1
        zero_q = np.zeros((len(b), self.states))
        limits = np.hstack([zero_q, a, np.zeros((len(b), 1))])
        constraints = [
            {
                "type": "eq",
                "fun": lambda z: self.values(z, d)[0],
                "jac": lambda z: np.hstack([self.values(z, d)[2], np.zeros((self.states, 1))]),
            },
            {
                "type": "ineq",
                "fun": lambda z: -self.values(z, d)[1] - z[-1],
                "jac": lambda z: -np.hstack([self.values(z, d)[3], np.ones((self.count[1], 1))]),
            },
        ]
        if bounded and len(b):
            constraints.append(
                {"type": "ineq", "fun": lambda z: b - limits @ z, "jac": lambda z: -limits}
            )
        falling = np.zeros(width)
        falling[-1] = -1.0

        def local(begin: Array, method: str, **settings: Any) -> Any:
            """The largest t that a local solver reaches from there."""
            return minimize(
                lambda z: -z[-1], begin, jac=lambda z: falling, method=method,
                constraints=constraints, **settings,
            )  # fmt: skip

        best: RestingState | None = None
        for begin in [*known, *self._begin(width)]:
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of steps that do not count
                answer = local(begin, "SLSQP", options={"maxiter": STEPS, "ftol": 1e-10})
                if answer.status in DEPENDENT:
                    answer = local(
                        begin, "trust-constr", hess=lambda z: np.zeros((width, width)),
                        options={"maxiter": STEPS},
                    )  # fmt: skip
            if not np.isfinite(answer.x).all():
                continue
            found = self._judged(answer.x, disturbance, d, ended=answer.nit < STEPS)
            if best is None or _rank(found) > _rank(best):
                best = found
        if best is None:
            raise DefinitionError(
                f"the rates of system '{self.system.name}' have no value at any start",
                remedy="give a box in which they have",
            )
        return best

    def _begin(self, width: int) -> list[Array]:
        sampler = qmc.Sobol(self.states, rng=np.random.default_rng(self.seed))
        points = sampler.random(2 ** math.ceil(math.log2(self.starts)))
        low, high = self.box[:, 0], self.box[:, 1]
        begin = np.zeros((self.starts, width))
        begin[:, : self.states] = low + points[: self.starts] * (high - low)
        return list(begin)

    def _judged(
        self, z: Array, disturbance: Mapping[str, float], d: Array, *, ended: bool
    ) -> RestingState:
        """What holds at z, from its own rates, constraints and bounds."""
        f, c, _, _ = self.values(z, d)
        a, b = self.bounds
        u = z[self.states : self.states + self.inputs]
        residual, margin = float(np.abs(f).max()), float(-c.max())
        excess = float((a @ u - b).max()) if len(b) else 0.0
        worst = self.region.inequalities[int(c.argmax())]
        moving = self.system.state_names[int(np.abs(f).argmax())]
        missing = ""
        if residual > EXACT:
            missing = f"the inputs do not stop '{moving}': a rate of {residual:.3g} is left"
        elif excess > EXACT * float(np.abs(b).max(initial=1.0)):
            missing = f"the inputs exceed their bounds by {excess:.3g}"
        elif margin < -EXACT:
            missing = f"'{worst.name}' is violated by {-margin:.3g} {worst.unit}"
        elif margin > ENDLESS or not ended:
            missing = UNBOUNDED
        turned = [
            math.remainder(float(v), 2 * math.pi) if q.angle else float(v)
            for v, q in zip(z, self.system.states, strict=False)
        ]
        return RestingState(
            state=dict(zip(self.system.state_names, turned, strict=True)),
            inputs=dict(zip(self.system.input_names, u.tolist(), strict=True)),
            disturbance=dict(disturbance),
            margin=margin,
            residual=residual,
            missing=missing,
        )


def _rank(found: RestingState) -> tuple[bool, float, float]:
    """Those at rest inside by their margin, the others by how nearly they are at rest."""
    if found.exists or found.missing == UNBOUNDED:
        return True, found.margin, 0.0
    return False, -max(found.residual, EXACT), found.margin
