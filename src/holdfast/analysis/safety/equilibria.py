"""Equilibria in a region: where a system can rest in a disturbance, farthest inside.

The search is one problem, compiled once, for any steady disturbance.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from holdfast.arguments import checked, renamed
from holdfast.errors import DefinitionError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.quantity import TIME, expression_of, merge_parameters, symbol
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import derivatives

Values = tuple[Array, Array, Array, Array]

DEPENDENT = (5, 6)
"""What SLSQP answers where equations depend on each other."""
STEPS, ENDLESS = 200, 1e6
"""Iterations of a search, and the margin beyond which a region counts as unbounded."""
REPEATS, RANK = 40, 1e-9
"""Gauss-Newton steps, and the relative size of a singular value that counts as none."""
CLEAR = 1e-3
"""How far inside, in the units of the constraints, a place is that counts without a search."""
UNBOUNDED = "the margin still grew when the search ended: the region may be unbounded"
EXACT = 1e-6
"""Largest rate, and largest excess of a bound, of what counts as at rest, in SI units."""


@dataclass(frozen=True)
class RestingState:
    """The equilibrium farthest inside a region, or the best that was found, and what it lacks.

    state, inputs, disturbance: name -> value in SI units. margin: the least -c_j there, in the unit
    of c_j; below 0 it is outside. residual: the largest rate left. missing: empty for an
    equilibrium in the region, else the reason why there is none. current_names: those of the
    components of the current along x and y.
    """

    state: Mapping[str, float]
    inputs: Mapping[str, float]
    disturbance: Mapping[str, float]
    margin: float
    residual: float
    missing: str = ""
    current_names: tuple[str, ...] = ()

    @property
    def exists(self) -> bool:
        return not self.missing

    def words(self, units: Mapping[str, str]) -> str:
        """The disturbance: a current by its speed and direction, else number by number."""
        d = self.disturbance
        if set(d) == set(self.current_names) != set():
            vx, vy = (d[n] for n in self.current_names)
            along = math.degrees(math.atan2(vy, vx))
            return f"a current of {math.hypot(*d.values()):.3g} m/s along {along:.4g} degrees"
        return ", ".join(f"{n} = {v:.3g} {units[n]}" for n, v in d.items()) or "no disturbance"


class Search:
    """The problem of one system and region, compiled once, for any disturbance.

    field: disturbances that are expressions of states and parameters, of the system or `drawn`:
    what the system feels is the value where it rests. The numbers of a search are those of every
    disturbance, in order (0 for a field), then the drawn ones.
    """

    def __init__(
        self,
        system: System,
        region: Region,
        box: Mapping[str, tuple[float, float]] | None,
        searches: int,
        seed: int,
        field: Mapping[str, sp.Expr] | None = None,
        drawn: Sequence[sp.Symbol] = (),
    ) -> None:
        region.check_reads(system.name, system.states)
        if not searches >= 1:
            raise DefinitionError(f"searches is {searches}", expected="at least 1")
        if seed < 0:
            raise DefinitionError(f"seed is {seed}", expected="0 or more")
        self.system, self.region, self.seed, self.searches = system, region, seed, searches
        self.states, self.inputs = len(system.states), len(system.inputs)
        self.box = self._box(box or {})
        self.current_names = tuple(q.name for q in system.current_along("x", "y") or ())
        of_place = {symbol(n): e for n, e in (field or {}).items()}
        felt = [of_place.get(q.symbol, q.symbol) for q in system.disturbances]
        rates = [system.rates[n].xreplace(of_place) for n in system.state_names]
        inequalities = [c.expression for c in region.inequalities]
        if any(sp.sympify(e).has(TIME) for e in (*rates, *inequalities)):
            raise DefinitionError(
                f"system '{system.name}', its region or its disturbance depends on time"
            )
        names = [q.symbol for q in (*system.states, *system.inputs, *system.disturbances)]
        names += drawn
        free = names[: self.states + self.inputs]
        slopes = [s for e in (*rates, *inequalities) for s in derivatives(e, free).values()]
        self.count = len(rates), len(inequalities)
        parameters = merge_parameters(system.parameters, region.parameters)
        self.evaluator = Evaluator([*rates, *inequalities, *slopes], names, parameters)
        self.felt = Evaluator(felt, names, parameters)
        self._last: tuple[bytes, Values] | None = None

    def _box(self, box: Mapping[str, tuple[float, float]]) -> Array:
        for name, ends in box.items():
            if name not in self.system.state_names:
                raise DefinitionError(
                    f"box: '{name}' is not a state of system '{self.system.name}'",
                    remedy=suggestion(name, self.system.state_names),
                )
            if not (len(ends) == 2 and -math.inf < ends[0] <= ends[1] < math.inf):
                raise DefinitionError(f"box: {name} = {ends}", expected="(lowest, highest)")
        usual = {q.name: math.pi if q.angle else 1.0 for q in self.system.states}
        return np.array([box.get(n, (-half, half)) for n, half in usual.items()], dtype=float)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """A, b of A u <= b: shapes (rows, inputs) and (rows,)."""
        numbers = {p.symbol: p.value for p in self.system.parameters}
        input_bounds = self.system.input_bounds
        rows = [] if input_bounds is None else input_bounds.at(numbers).half_spaces()
        a = np.array([[float(e) for e in normal] for normal, _ in rows]).reshape(
            len(rows), self.inputs
        )
        return a, np.array([float(limit) for _, limit in rows])

    def of_points(self, points: Array, d: Array) -> Values:
        """f, c and their slopes along (q, u) at points (q, u), a row for each."""
        n, m = self.count
        values = self.evaluator.values(np.hstack([points, np.tile(d, (len(points), 1))]))
        slopes = values[:, n + m :].reshape(len(points), n + m, self.states + self.inputs)
        return values[:, :n], values[:, n : n + m], slopes[:, :n], slopes[:, n:]

    def values(self, z: Array, d: Array) -> Values:
        """The same at z = (q, u, t); the solver asks for each in turn."""
        key = z[:-1].tobytes() + d.tobytes()
        if self._last is None or self._last[0] != key:
            f, c, of_f, of_c = self.of_points(z[None, :-1], d)
            self._last = key, (f[0], c[0], of_f[0], of_c[0])
        return self._last[1]

    def nearby(self, points: Array, d: Array, inside: float | None = None) -> Array:
        """Gauss-Newton steps from points (q, u) to f = 0; with `inside` also c + inside <= 0 and
        the bounds. What did not arrive stays where it ended, as numbers that are not finite too.
        """
        a, b = self.bounds
        limits = np.hstack([np.zeros((len(b), self.states)), a])
        z = points.copy()
        for _ in range(REPEATS):
            f, c, of_f, of_c = self.of_points(z, d)
            left, slopes = f, of_f
            if inside is not None:
                over, beyond = c + inside, z @ limits.T - b
                left = np.hstack([f, np.maximum(over, 0.0), np.maximum(beyond, 0.0)])
                slopes = np.concatenate(
                    [
                        of_f,
                        of_c * (over > 0)[:, :, None],
                        limits[None] * (beyond > 0)[:, :, None],
                    ],
                    axis=1,
                )
            sound = np.isfinite(left).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
            going = sound & (np.abs(left).max(axis=1, initial=0.0) > EXACT**2)
            if not going.any():
                break
            inverse = np.linalg.pinv(slopes[going], rcond=RANK)
            z[going] -= (inverse @ left[going][:, :, None])[:, :, 0]
        return z

    def surely_held(self, disturbance: Mapping[str, float]) -> bool:
        """Whether a place at rest more than `CLEAR` inside is found at once, without an optimiser.

        False: nothing is said; `solve` finds the best place, or what is missing.
        """
        d = np.array(list(disturbance.values()), dtype=float)
        begin = np.array(self._begin(self.states + self.inputs))
        with np.errstate(all="ignore"):
            ends = self.nearby(begin, d, inside=2 * CLEAR)
            f, c, _, _ = self.of_points(ends, d)
            a, b = self.bounds
            beyond = (ends[:, self.states :] @ a.T - b).max(axis=1, initial=-math.inf)
            still = (np.abs(f).max(axis=1) <= EXACT) & (c.max(axis=1) < -CLEAR) & (beyond <= EXACT)
        return bool(still.any())

    def solve(self, disturbance: Mapping[str, float], guesses: list[Array]) -> RestingState:
        """The best within the bounds, else the one that only the bounds of the inputs forbid.
        guesses: states, inputs and a margin, each of the shape (states + inputs + 1,)."""
        best = self._best(disturbance, guesses, bounded=True)
        if best.exists or best.missing == UNBOUNDED or not len(self.bounds[1]):
            return best
        free = self._best(disturbance, guesses, bounded=False)
        return free if free.residual <= EXACT and free.margin > EXACT else best

    def _best(
        self, disturbance: Mapping[str, float], guesses: list[Array], *, bounded: bool
    ) -> RestingState:
        from scipy.optimize import minimize  # half a second, which `surely_held` does without

        d = np.array(list(disturbance.values()), dtype=float)
        a, b = self.bounds
        width = self.states + self.inputs + 1
        zero_q = np.zeros((len(b), self.states))
        limits = np.hstack([zero_q, a, np.zeros((len(b), 1))])
        constraints = [
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
        ends = [(None, None)] * (width - 1) + [(None, 2 * ENDLESS)]
        falling = np.zeros(width)
        falling[-1] = -1.0

        def local(begin: Array, rows: list[int], method: str, **settings: Any) -> Any:
            """The largest t that a local solver reaches from there, with these rates zero."""
            still = {
                "type": "eq",
                "fun": lambda z: self.values(z, d)[0][rows],
                "jac": lambda z: np.hstack([self.values(z, d)[2][rows], np.zeros((len(rows), 1))]),
            }
            return minimize(
                lambda z: -z[-1], begin, jac=lambda z: falling, method=method,
                constraints=[still, *constraints], bounds=ends, **settings,
            )  # fmt: skip

        best: RestingState | None = None
        for begin in [*guesses, *self._begin(width)]:
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of steps that do not count
                begin, rows = self._at_rest(begin, d)
                answer = local(begin, rows, "SLSQP", options={"maxiter": STEPS, "ftol": 1e-10})
                if answer.status in DEPENDENT:
                    every = list(range(self.states))
                    answer = local(
                        begin, every, "trust-constr", hess=lambda z: np.zeros((width, width)),
                        options={"maxiter": STEPS},
                    )  # fmt: skip
            if not np.isfinite(answer.x).all():
                continue
            resting = self._judged(answer.x, d, ended=answer.nit < STEPS)
            if best is None or _rank(resting) > _rank(best):
                best = resting
        if best is None:
            raise DefinitionError(
                f"the rates of system '{self.system.name}' have no value at any start",
                remedy="give a box in which they have",
            )
        return best

    def _at_rest(self, begin: Array, d: Array) -> tuple[Array, list[int]]:
        """A start at rest near `begin`, and rates whose slopes are independent there.

        In still water the sway rate of a vessel at rest follows from its velocities: an equation
        more than the solver can do with. `_judged` looks at all of them.
        """
        z = begin.copy()
        z[:-1] = self.nearby(begin[None, :-1], d)[0]
        f, c, slopes, _ = self.values(z, d)
        if not (np.abs(f).max() <= EXACT and np.isfinite(slopes).all()):
            return begin, list(range(self.states))
        z[-1] = -c.max()
        rows: list[int] = []
        basis = np.zeros((0, slopes.shape[1]))
        for k, slope in enumerate(slopes):
            rest = slope - basis.T @ (basis @ slope)
            size = float(np.linalg.norm(rest))
            if size > 1e-6 * float(np.linalg.norm(slope)):
                rows.append(k)
                basis = np.vstack([basis, rest / size])
        return z, rows

    def _begin(self, width: int) -> list[Array]:
        """Points all over the box, evenly: x_k = {offset + k alpha}, alpha of the generalised
        golden ratio (M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018).
        """
        ratio = 2.0
        for _ in range(60):
            ratio = (1.0 + ratio) ** (1.0 / (self.states + 1))
        alpha = ratio ** -np.arange(1.0, self.states + 1)
        offset = np.random.default_rng(self.seed).random(self.states) if self.seed else 0.5
        points = (offset + np.arange(self.searches)[:, None] * alpha) % 1.0
        low, high = self.box[:, 0], self.box[:, 1]
        begin = np.zeros((self.searches, width))
        begin[:, : self.states] = low + points * (high - low)
        return list(begin)

    def _judged(self, z: Array, d: Array, *, ended: bool) -> RestingState:
        """What holds at z, from its own rates, constraints and bounds."""
        f, c, _, _ = self.values(z, d)
        a, b = self.bounds
        u = z[self.states : self.states + self.inputs]
        felt = self.felt.values(np.concatenate([z[:-1], d])[None])[0].tolist()
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
        elif margin <= EXACT:
            missing = f"the best place is on the edge of the region, where '{worst.name}' ends"
        elif margin > ENDLESS or not ended:
            missing = UNBOUNDED
        turned = [
            math.remainder(float(v), 2 * math.pi) if q.angle else float(v)
            for v, q in zip(z, self.system.states, strict=False)
        ]
        return RestingState(
            state=dict(zip(self.system.state_names, turned, strict=True)),
            inputs=dict(zip(self.system.input_names, u.tolist(), strict=True)),
            disturbance=dict(zip(self.system.disturbance_names, felt, strict=True)),
            margin=margin,
            residual=residual,
            missing=missing,
            current_names=self.current_names,
        )


def _rank(resting: RestingState) -> tuple[bool, float, float]:
    """Those at rest inside by their margin, the others by how nearly they are at rest."""
    if resting.exists or resting.missing == UNBOUNDED:
        return True, resting.margin, 0.0
    return False, -max(resting.residual, EXACT), resting.margin


SEARCHES = 16


@renamed(starts="searches")
@checked
def resting_state(
    system: System,
    region: Region,
    disturbance: Mapping[str, float | sp.Expr] | None = None,
    *,
    box: Mapping[str, tuple[float, float]] | None = None,
    searches: int = SEARCHES,
    seed: int = 0,
) -> RestingState:
    """Where `system` rests in `region` in a steady disturbance d, as far inside as can be.

        maximise t   subject to   f(q, u, d(q)) = 0,   c_j(q) + t <= 0 for every j,   u in bounds

    A local solver (SLSQP, derivatives of the same expressions) begins at points of an even
    sequence.

    searches: how many points. box: state -> (lowest, highest), where they are; unless given [-1, 1]
    in SI units and a whole turn of an angle.

    The answer is verified by its own rates, constraints and bounds. It is the best of the local
    ones: another may exist, and none found does not prove that there is none. c_j of different
    units count alike, 1 m as 1 rad.

    disturbance: name -> number, or expression of the states and parameters (a field, such as an
    eddy); those left out are 0.

    Raises `DefinitionError` for unknown names, rates, fields or constraints that depend on time, a
    region of other states, and inputs whose bounds are no half-spaces.

    >>> hf.resting_state(gusty, track, {"d": 0.1}).inputs
    {'a': -0.1}
    """
    field, numbers = _disturbance(system, disturbance)
    return Search(system, region, box, searches, seed, field).solve(numbers, [])


@renamed(starts="searches")
@checked
def resting_directions(
    system: System,
    region: Region,
    speed: float,
    *,
    count: int = 360,
    box: Mapping[str, tuple[float, float]] | None = None,
    searches: int = SEARCHES,
    seed: int = 0,
) -> tuple[RestingState, ...]:
    """`resting_state` for a current of one speed in all directions of its plane.

        d = speed (cos theta, sin theta),   theta = 2 pi k / count,   k = 0 ... count - 1

    d is the current along x and y, other disturbances are 0; of a system that says of none that it
    is the current, its two disturbances.

    speed [m/s]: of the current. count: of directions. box, searches: as of `resting_state`.

    Each search begins at the answer of the direction before it too.

    Raises `DefinitionError` for a system that has neither, and as `resting_state`.

    >>> drifting = hf.systems.drifting_unicycle()
    >>> near = hf.regions.near_origin(drifting)
    >>> len(hf.resting_directions(drifting, near, 0.1, count=4, searches=2))
    4
    """
    names = [q.name for q in system.current_along("x", "y") or system.disturbances]
    if len(names) != 2:
        raise DefinitionError(
            f"system '{system.name}' has {len(names)} disturbances", expected="two, as a current"
        )
    still = dict.fromkeys(system.disturbance_names, 0.0)
    if not 0 <= speed < math.inf:
        raise DefinitionError(f"speed is {speed:g}", expected="0 or more")
    if not count >= 1:
        raise DefinitionError(f"count is {count}", expected="at least 1")
    search = Search(system, region, box, searches, seed)
    answers: list[RestingState] = []
    last: list[Array] = []
    for theta in 2 * math.pi * np.arange(count) / count:
        d = still | {names[0]: speed * math.cos(theta), names[1]: speed * math.sin(theta)}
        answers.append(search.solve(d, last))
        if answers[-1].exists:
            values = [*answers[-1].state.values(), *answers[-1].inputs.values(), answers[-1].margin]
            last = [np.array(values)]
    return tuple(answers)


def _disturbance(
    system: System, disturbance: Mapping[str, float | sp.Expr] | None
) -> tuple[dict[str, sp.Expr], dict[str, float]]:
    """The disturbances that are fields, and the numbers of all, 0 for a field."""
    field: dict[str, sp.Expr] = {}
    numbers = dict.fromkeys(system.disturbance_names, 0.0)
    for name, value in (disturbance or {}).items():
        if name not in numbers:
            raise DefinitionError(
                f"'{name}' is not a disturbance of system '{system.name}'",
                remedy=suggestion(name, system.disturbance_names),
            )
        expression = expression_of(value)
        if expression.free_symbols:
            field[name] = expression
        elif math.isfinite(expression):
            numbers[name] = float(expression)
        else:
            raise DefinitionError(f"disturbance '{name}' is {value}", expected="a finite number")
    return field, numbers
