"""The uniform logic of the thesis: the reference field F from the constraint A(q) q' = b(q).

    zero columns of A -> transverse states t, the others leafwise states x, N of them
    p in ker A(0) on the leafwise columns -> F = lambda (p . x) x - p |x|^2      (4.6)
    h = A F                                                                      (4.4)

Everything here is derived from A alone; chapter 4 of the thesis, introduction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.flat_output import FlatOutput
from holdfast.maths.definitions.quantity import Parameter, Quantity, given_number, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest, least, magnitude, select, sgn
from holdfast.maths.expressions.random_points import Sampler
from holdfast.maths.nonholonomic.null_space import annihilators, columns_of, kernel
from holdfast.maths.reference_fields.dipole import dipolar_field

LAMBDA = symbol("lam")
RESERVED = ("lam", "motion_along", "motion_across")
KINKS = {
    sgn: "sgn",
    select: "a choice by a condition",
    least: "min",
    greatest: "max",
    magnitude: "abs",
    sp.Abs: "abs",
    sp.sign: "sgn",
}


@dataclass(frozen=True)
class Structure:
    """The structure of A(q) q' = b, independent of any law.

    coordinates: the generalised coordinates q. matrix: A, shape (kappa, n). rhs: b, shape
    (kappa,). leaf, transverse: the states with nonzero and with zero columns. admissible: a
    basis of ker A(0) on the leafwise columns. moment: p. field, output: F and h. directions:
    vector fields that span the motions A allows, as columns of length n. drift: the part of
    q' that no input moves. flat_output: the one that the system declares.
    """

    coordinates: tuple[Quantity, ...]
    matrix: sp.ImmutableMatrix
    rhs: tuple[sp.Expr, ...]
    leaf: tuple[Quantity, ...]
    transverse: tuple[Quantity, ...]
    admissible: tuple[sp.ImmutableMatrix, ...]
    moment: tuple[sp.Expr, ...]
    field: tuple[sp.Expr, ...]
    output: tuple[sp.Expr, ...]
    directions: tuple[sp.ImmutableMatrix, ...]
    inputs: tuple[Quantity, ...]
    drift: tuple[sp.Expr, ...]
    parameters: tuple[Parameter, ...]
    flat_output: FlatOutput | None = None

    @property
    def symbols(self) -> list[sp.Symbol]:
        return [q.symbol for q in self.coordinates]

    @property
    def leaf_matrix(self) -> sp.Matrix:
        """A on the leafwise columns, shape (kappa, N)."""
        return columns_of(self.matrix, self.coordinates, self.leaf)

    @property
    def catastatic(self) -> bool:
        return all(b == 0 for b in self.rhs)

    @property
    def kinematic(self) -> bool:
        """Whether the system's own inputs move the coordinates, one direction each."""
        return bool(self.inputs)

    @property
    def direction_names(self) -> list[str]:
        """A name for each direction: its input's, or its number."""
        return [u.name for u in self.inputs] or [str(i + 1) for i in range(len(self.directions))]

    @property
    def output_rate(self) -> sp.Matrix:
        """d h / d t per unit of each direction, shape (kappa, number of directions)."""
        slopes = sp.Matrix([[h.diff(s) for s in self.symbols] for h in self.output])
        return slopes * self.effect

    @property
    def effect(self) -> sp.Matrix:
        """G, the directions side by side, shape (n, number of directions)."""
        return sp.Matrix.hstack(*(sp.Matrix(g) for g in self.directions))

    def speeds(self, rates: sp.Matrix) -> list[sp.Expr]:
        """The speeds along the directions that give these rates: (G^T G)^-1 G^T rates."""
        effect = self.effect
        normal = (effect.T * effect).applyfunc(sp.trigsimp)
        return [sp.trigsimp(sp.expand(e)) for e in normal.inv() * effect.T * rates]

    def sampler(self) -> Sampler:
        """Evaluates expressions of this structure at random points."""
        values = {p.symbol: p.value for p in self.parameters}
        return Sampler(values | {LAMBDA: 3.0}, [self.matrix, *self.directions])


def structure(system: System, moment: Sequence[float] | None = None) -> Structure:
    """The structure of the system's Pfaffian constraint, thesis chapter 4.

    `moment` is p, one number for each leafwise state; needed where ker A(0) has more than one
    dimension (its first basis vector is the default). If the system declares no
    Pfaffian row, A is derived as the annihilator of its input directions.

    Raises `DefinitionError` for a system without a constraint, one whose A is not a number
    or loses rank at the origin, p = 0, p of the wrong dimension, and A(0) p != 0.
    """
    _check_names(system)
    coordinates, matrix, rhs = constraint(system)
    sampler = Sampler({p.symbol: p.value for p in system.parameters}, [matrix])
    matrix = matrix.applyfunc(lambda e: sp.S.Zero if sampler.vanishes(e) else e)
    rhs = tuple(sp.S.Zero if sampler.vanishes(e) else e for e in rhs)
    columns = [matrix.col(j) for j in range(matrix.cols)]
    moving = [any(e != 0 for e in c) for c in columns]
    leaf = tuple(q for q, m in zip(coordinates, moving, strict=True) if m)
    transverse = tuple(q for q, m in zip(coordinates, moving, strict=True) if not m)
    on_leaf = columns_of(matrix, coordinates, leaf)
    here = _at_origin(system, coordinates, on_leaf)
    admissible = tuple(_tidy(v) for v in here.nullspace())
    if not admissible:
        raise DefinitionError(
            f"system '{system.name}': A(0) leaves no direction p with A(0) p = 0",
            expected="fewer constraints than leafwise states",
        )
    p = _moment(system, here, leaf, admissible, moment)
    field = tuple(sp.factor(f) for f in dipolar_field([q.symbol for q in leaf], LAMBDA, p))
    directions, inputs, drift = _motions(system, coordinates, matrix, leaf)
    return Structure(
        coordinates=coordinates,
        matrix=sp.ImmutableMatrix(matrix),
        rhs=rhs,
        leaf=leaf,
        transverse=transverse,
        admissible=admissible,
        moment=p,
        field=field,
        output=tuple(on_leaf * sp.Matrix(field)),
        directions=directions,
        inputs=inputs,
        drift=drift,
        parameters=system.parameters,
        flat_output=system.flat_output,
    )


def relative_degrees(found: Structure, t: Quantity) -> tuple[int, ...]:
    """The number of differentiations of each output until the rate of t appears; 0: never."""
    moved = {
        q.symbol: set().union(*(g[i].free_symbols for g in found.directions))
        for i, q in enumerate(found.coordinates)
    }
    degrees = []
    for h in found.output:
        reached, degree = set(h.free_symbols) & set(moved), 1
        while t.symbol not in reached:
            larger = reached | set().union(*(moved[s] & set(moved) for s in reached))
            if larger == reached:
                degree = 0
                break
            reached, degree = larger, degree + 1
        degrees.append(degree)
    return tuple(degrees)


def inputs_at_rest(found: Structure) -> tuple[sp.Expr, ...]:
    """The inputs that hold the system at an equilibrium against its drift."""
    return tuple(found.speeds(-sp.Matrix(found.drift)))


def constraint(system: System) -> tuple[tuple[Quantity, ...], sp.Matrix, tuple[sp.Expr, ...]]:
    """(q, A, b) of a system: its coordinates and the rows of A(q) q' = b.

    The coordinates are all states of a system without drift, else those that A names.
    """
    states = {q.name: q for q in system.states}
    undriven = [r.subs({u.symbol: 0 for u in system.inputs}) for r in system.rates.values()]
    rows = system.pfaffian or annihilators(system)
    if not rows:
        raise DefinitionError(
            f"system '{system.name}' has no Pfaffian constraint",
            expected="a row of A(q) qdot = b, or fewer inputs than states without drift",
            remedy="declare the row (pfaffian)",
        )
    named = set().union(*(row.coefficients for row in rows))
    named |= {str(s) for row in rows for e in row.coefficients.values() for s in e.free_symbols}
    chosen = (
        states if all(r == 0 for r in undriven) else {n: states[n] for n in states if n in named}
    )
    coordinates = tuple(chosen.values())
    matrix = sp.Matrix([[row.coefficients.get(n, sp.S.Zero) for n in chosen] for row in rows])
    _check_symbols(system, matrix, coordinates)
    return coordinates, matrix, tuple(row.rhs for row in rows)


def _check_names(system: System) -> None:
    """Refuse names that the derived law uses itself."""
    for q in (*system.states, *system.inputs, *system.disturbances, *system.parameters):
        if q.name in RESERVED:
            raise DefinitionError(
                f"system '{system.name}' calls a quantity '{q.name}'",
                expected=f"a name other than {', '.join(RESERVED)}, which the derived law uses",
                remedy="rename it",
            )


def _check_symbols(system: System, matrix: sp.Matrix, coordinates: tuple[Quantity, ...]) -> None:
    """Refuse an A that is not a smooth function of the coordinates only."""
    known = {q.symbol for q in (*coordinates, *system.parameters)}
    odd = sorted(str(s) for s in matrix.free_symbols - known)
    if odd:
        raise DefinitionError(
            f"system '{system.name}': A depends on '{odd[0]}'",
            expected="a function of the coordinates "
            + ", ".join(q.name for q in coordinates)
            + " and parameters",
            remedy="put other motions of the system into b (rhs)",
        )
    kinks = [name for function, name in KINKS.items() if matrix.has(function)]
    if kinks:
        raise DefinitionError(
            f"system '{system.name}': A contains {kinks[0]}", expected="smooth functions"
        )


def _at_origin(system: System, coordinates: tuple[Quantity, ...], matrix: sp.Matrix) -> sp.Matrix:
    here = matrix.subs({q.symbol: 0 for q in coordinates})
    values = {p.symbol: sp.nsimplify(p.value) for p in system.parameters}
    number = here.subs(values)
    if number.free_symbols or any(not e.is_finite for e in number):
        raise DefinitionError(
            f"system '{system.name}': A at the origin is {here.tolist()}", expected="numbers"
        )
    if number.rank() < matrix.rows:
        raise DefinitionError(
            f"system '{system.name}': A at the origin is {here.tolist()}, of rank {number.rank()}",
            expected=f"rank {matrix.rows}, one for each constraint",
            remedy="shift or change the coordinates, or leave out a dependent row",
        )
    return here


def _tidy(vector: sp.Matrix) -> sp.ImmutableMatrix:
    """A null vector with its first nonzero entry 1."""
    first = next(e for e in vector if e != 0)
    return sp.ImmutableMatrix([sp.simplify(e / first) for e in vector])


def _moment(
    system: System,
    here: sp.Matrix,
    leaf: tuple[Quantity, ...],
    admissible: tuple[sp.ImmutableMatrix, ...],
    given: Sequence[float] | None,
) -> tuple[sp.Expr, ...]:
    if given is None:
        return tuple(admissible[0])
    names = ", ".join(q.name for q in leaf)
    listed = list(given) if isinstance(given, (list, tuple)) else []
    if len(listed) != len(leaf):
        raise DefinitionError(
            f"the moment p = {given!r} has {len(listed)} components",
            expected=f"{len(leaf)}, one for each of {names}",
        )
    p = tuple(sp.nsimplify(given_number(v, "the moment p", given)) for v in listed)
    if all(value == 0 for value in p):
        raise DefinitionError("the moment p is zero", expected="a direction")
    values = {q.symbol: sp.nsimplify(q.value) for q in system.parameters}
    residual = [sp.simplify(e) for e in (here * sp.Matrix(p)).subs(values)]
    if any(e != 0 for e in residual):
        allowed = " and ".join(str(tuple(v)) for v in admissible)
        raise DefinitionError(
            f"the moment p = {p} has A(0) p = {tuple(residual)}",
            expected=f"A(0) p = 0: a combination of {allowed} in {names}",
        )
    return p


def _motions(
    system: System,
    coordinates: tuple[Quantity, ...],
    matrix: sp.Matrix,
    leaf: tuple[Quantity, ...],
) -> tuple[tuple[sp.ImmutableMatrix, ...], tuple[Quantity, ...], tuple[sp.Expr, ...]]:
    """The system's own input directions if they span ker A, else a basis of ker A."""
    rates = sp.Matrix([system.rates[q.name] for q in coordinates])
    inputs = [u for u in system.inputs if any(e != 0 for e in rates.diff(u.symbol))]
    sampler = Sampler({p.symbol: p.value for p in system.parameters}, [rates])
    driven = {u.symbol for u in inputs}
    effect = [rates.diff(u.symbol) for u in inputs]
    if any(g.free_symbols & driven for g in effect):
        raise DefinitionError(
            f"the rates of system '{system.name}' are not affine in its inputs",
            expected="q' = f(q) + sum of g_i(q) u_i",
        )
    drift = tuple(
        sp.S.Zero if sampler.vanishes(e) else e for e in rates.subs(dict.fromkeys(driven, 0))
    )
    known = {q.symbol for q in (*coordinates, *system.parameters)}
    if any(g.free_symbols - known or g.has(*KINKS) for g in effect):
        inputs = []  # they depend on more than the coordinates
    if len(inputs) == matrix.cols - matrix.rows:
        own = tuple(map(sp.ImmutableMatrix, effect))
        return own, tuple(inputs), drift
    return kernel(system.name, coordinates, matrix, leaf, system.parameters), (), drift
