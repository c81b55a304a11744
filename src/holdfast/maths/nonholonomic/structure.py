"""The uniform logic of the thesis: the reference field F from the constraint A(q) q' = b(q).

    zero columns of A -> transverse states t, the others leafwise states x, N of them
    p in ker A(0) on the leafwise columns -> F = lambda (p . x) x - p |x|^2      (4.6)
    h = A F                                                                      (4.4)

Everything here is derived from A alone; chapter 4 of the thesis, introduction.

The law that follows the field is determined by this logic alone where there is one leaf direction
g(t) in a plane, one transverse state t, and no drift. Then the misalignment s between g and F is
a scalar that t moves, and

    s = atan2(g x F, g . F)
    u = -k1 sgn(g . x) |x| / |g|             along g
    dt/dt = (-k s - ds/dx . g u) / (ds/dt)   hence sdot = -k s

The null space of A(q) holds the motions that a constraint allows; conversely, motions obey rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.quantity import Parameter, Quantity, given_number, symbol
from holdfast.maths.definitions.system import FlatOutput, PfaffianRow, System
from holdfast.maths.definitions.units import Empirical, Free, Units, power, product, unit_text
from holdfast.maths.expressions.functions import (
    angle,
    greatest,
    least,
    length,
    magnitude,
    select,
    sgn,
    wrap,
)
from holdfast.maths.expressions.random_points import Sampler, value_at
from holdfast.maths.reference_fields.dipole import UNSEEN, dipolar_field


@checked
def kinematic_system(
    name: str,
    states: tuple[Quantity, ...],
    rows: tuple[PfaffianRow, ...],
    parameters: tuple[Parameter, ...] = (),
    description: str = "",
    source: str = "",
    empirical: Empirical = "",
) -> System:
    """The system q' = sum_i g_i(q) w_i of all motions that A(q) q' = 0 allows.

    For use when only the constraint is known. Inputs w1, w2, ...: along the leaf first, then one
    for each transverse state. Raises `DefinitionError` for rows with b != 0, rows that are
    dependent at the origin, and units that do not fit, unless it says why (`empirical`).
    """
    if any(row.rhs != 0 for row in rows):
        raise DefinitionError(
            f"system '{name}': the motions of A qdot = b with b != 0 are not fixed by A alone",
            remedy="write the rates",
        )
    names = [q.name for q in states]
    for row in rows:
        for state in row.coefficients:
            if state not in names:
                raise DefinitionError(
                    f"a Pfaffian row of system '{name}' names '{state}', which is not a state",
                    remedy=suggestion(state, names),
                )
    matrix = sp.Matrix([[row.coefficients.get(n, sp.S.Zero) for n in names] for row in rows])
    leaf = tuple(q for j, q in enumerate(states) if any(e != 0 for e in matrix.col(j)))
    directions = kernel(name, states, matrix, leaf, parameters)
    units = Units(f"system '{name}'", (*states, *parameters))
    if not empirical:
        for number, row in enumerate(rows, start=1):
            entries = {symbol(n): c for n, c in row.coefficients.items()}
            units.check_row(entries, row.rhs, f"Pfaffian row {number}")
    inputs = tuple(
        Quantity(f"w{i}", "1/s" if empirical else _unit_of_motion(units, states, g), f"motion {i}")
        for i, g in enumerate(directions, start=1)
    )
    return System(
        name=name,
        empirical=empirical,
        states=states,
        inputs=inputs,
        rates={
            q.name: sp.Add(*(w.symbol * g[j] for w, g in zip(inputs, directions, strict=True)))
            for j, q in enumerate(states)
        },
        parameters=parameters,
        pfaffian=rows,
        description=description,
        source=source,
    )


def _unit_of_motion(units: Units, states: tuple[Quantity, ...], g: sp.Matrix) -> str:
    """The unit of w in q' = g(q) w."""
    for q, along in zip(states, g, strict=True):
        if along != 0:
            inverse = power(units.of(along, "a motion"), -1.0)
            kind = product(units.per_second(units.kinds[q.symbol]), inverse)
            if not isinstance(kind, Free):
                return unit_text(kind)
    return "1/s"


def signed_minors(matrix: sp.Matrix) -> sp.Matrix:
    """The kernel of a (k, k + 1) matrix by its signed maximal minors: smooth where A is.

    A null space by elimination divides by an entry of A and turns its sign over where that
    entry vanishes, as (cot(theta), 1) does for the unicycle.
    """
    rows, columns = list(range(matrix.rows)), list(range(matrix.cols))
    minors = [matrix.extract(rows, [i for i in columns if i != j]).det() for j in columns]
    return sp.Matrix([(-1) ** j * minor for j, minor in enumerate(minors)])


def columns_of(
    matrix: sp.Matrix, coordinates: tuple[Quantity, ...], wanted: tuple[Quantity, ...]
) -> sp.Matrix:
    """The columns of A that belong to the wanted coordinates."""
    return matrix.extract(
        list(range(matrix.rows)), [i for i, q in enumerate(coordinates) if q in wanted]
    )


def kernel(
    name: str,
    coordinates: tuple[Quantity, ...],
    matrix: sp.Matrix,
    leaf: tuple[Quantity, ...],
    parameters: tuple[Parameter, ...],
) -> tuple[sp.ImmutableMatrix, ...]:
    """A basis of ker A, regular near the origin: the leaf's directions, then the transverse."""
    on_leaf = columns_of(matrix, coordinates, leaf)
    if on_leaf.cols == on_leaf.rows + 1:
        inner = [signed_minors(on_leaf)]
    else:
        inner = _eliminated(name, coordinates, on_leaf, parameters)
    place = {q: i for i, q in enumerate(leaf)}
    directions = [
        sp.ImmutableMatrix([v[place[q]] if q in place else 0 for q in coordinates]) for v in inner
    ]
    directions += [
        sp.ImmutableMatrix([int(q == t) for q in coordinates]) for t in coordinates if t not in leaf
    ]
    return tuple(directions)


def _eliminated(
    name: str,
    coordinates: tuple[Quantity, ...],
    on_leaf: sp.Matrix,
    parameters: tuple[Parameter, ...],
) -> list[sp.Matrix]:
    rows = list(range(on_leaf.rows))
    values = {p.symbol: sp.nsimplify(p.value) for p in parameters}
    origin = on_leaf.subs({q.symbol: 0 for q in coordinates}).subs(values)
    for pivots in combinations(reversed(range(on_leaf.cols)), on_leaf.rows):
        chosen = sorted(pivots)
        if origin.extract(rows, chosen).det() == 0:
            continue
        inverse = on_leaf.extract(rows, chosen).inv()
        free = [j for j in range(on_leaf.cols) if j not in chosen]
        basis = []
        for j in free:
            vector = sp.zeros(on_leaf.cols, 1)
            vector[j] = 1
            for i, e in zip(chosen, -inverse * on_leaf.col(j), strict=True):
                vector[i] = sp.simplify(e)
            basis.append(vector)
        return basis
    raise DefinitionError(
        f"system '{name}': A at the origin is {origin.tolist()}",
        expected=f"rank {on_leaf.rows}, one for each constraint",
        remedy="leave out a dependent row",
    )


def annihilators(system: System) -> tuple[PfaffianRow, ...]:
    """Rows that every rate without drift satisfies: the left kernel of the input directions."""
    inputs = [u.symbol for u in system.inputs]
    rates = sp.Matrix(list(system.rates.values()))
    effect = rates.jacobian(inputs) if inputs else sp.Matrix()
    if not inputs or effect.free_symbols & set(inputs) or any(rates.subs(dict.fromkeys(inputs, 0))):
        return ()
    origin = effect.subs({q.symbol: 0 for q in system.states})
    names = list(system.state_names)
    if effect.rows == effect.cols + 1:  # one row: its signed minors are smooth wherever it is
        row = signed_minors(effect.T)
        return (PfaffianRow({n: e for n, e in zip(names, row, strict=True) if e != 0}),)
    for chosen in combinations(range(effect.rows), effect.cols):
        columns = list(range(effect.cols))
        if origin.extract(list(chosen), columns).det() == 0:
            continue
        inverse = effect.extract(list(chosen), columns).inv()
        rows = []
        for i in (i for i in range(effect.rows) if i not in chosen):
            weights = effect.row(i) * inverse
            rows.append(
                PfaffianRow(
                    {names[i]: sp.S.One}
                    | {
                        names[j]: -sp.simplify(w)
                        for j, w in zip(chosen, weights, strict=True)
                        if sp.simplify(w) != 0
                    }
                )
            )
        return tuple(rows)
    return ()


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


def relative_degrees(constraint: Structure, t: Quantity) -> tuple[int, ...]:
    """The number of differentiations of each output until the rate of t appears; 0: never."""
    moved = {
        q.symbol: set().union(*(g[i].free_symbols for g in constraint.directions))
        for i, q in enumerate(constraint.coordinates)
    }
    degrees = []
    for h in constraint.output:
        reached, degree = set(h.free_symbols) & set(moved), 1
        while t.symbol not in reached:
            larger = reached | set().union(*(moved[s] & set(moved) for s in reached))
            if larger == reached:
                degree = 0
                break
            reached, degree = larger, degree + 1
        degrees.append(degree)
    return tuple(degrees)


def inputs_at_rest(constraint: Structure) -> tuple[sp.Expr, ...]:
    """The inputs that hold the system at an equilibrium against its drift."""
    return tuple(constraint.speeds(-sp.Matrix(constraint.drift)))


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
    allowed = {q.symbol for q in (*coordinates, *system.parameters)}
    odd = sorted(str(s) for s in matrix.free_symbols - allowed)
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
    moment: Sequence[float] | None,
) -> tuple[sp.Expr, ...]:
    if moment is None:
        return tuple(admissible[0])
    names = ", ".join(q.name for q in leaf)
    listed = list(moment) if isinstance(moment, (list, tuple)) else []
    if len(listed) != len(leaf):
        raise DefinitionError(
            f"the moment p = {moment!r} has {len(listed)} components",
            expected=f"{len(leaf)}, one for each of {names}",
        )
    p = tuple(sp.nsimplify(given_number(v, "the moment p", moment)) for v in listed)
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
    allowed = {q.symbol for q in (*coordinates, *system.parameters)}
    if any(g.free_symbols - allowed or g.has(*KINKS) for g in effect):
        inputs = []  # they depend on more than the coordinates
    if len(inputs) == matrix.cols - matrix.rows:
        directions = tuple(map(sp.ImmutableMatrix, effect))
        return directions, tuple(inputs), drift
    return kernel(system.name, coordinates, matrix, leaf, system.parameters), (), drift


SPEED, SIDE = symbol("motion_along"), symbol("motion_across")


@dataclass(frozen=True)
class Alignment:
    """The pieces of the field-following law.

    direction: g on the leaf, with p . g(0) > 0. error: s. slope: ds/dt of the transverse
    state. turns: whether g can point every way; if not, s is known up to half a turn and the
    law is local. regular: whether ds/dt keeps its sign as the transverse state runs through its
    range; if not, the law divides by zero on the way and is local too.
    """

    direction: sp.ImmutableMatrix
    error: sp.Expr
    slope: sp.Expr
    turns: bool
    regular: bool

    @property
    def everywhere(self) -> bool:
        """Whether the law is valid everywhere except at x = 0."""
        return self.turns and self.regular


def alignment(constraint: Structure) -> Alignment | str:
    """The pieces of the law, or a sentence that names the missing one."""
    kappa, transverse = constraint.matrix.rows, constraint.transverse
    if not constraint.catastatic:
        shown = ", ".join(str(b) for b in constraint.rhs if b != 0)
        return (
            f"the constraint is acatastatic: b = {shown} moves the system across F for any "
            "inputs; a separate condition has to make b vanish at the origin"
        )
    if any(f != 0 for f in constraint.drift):
        return "the system drifts with its inputs at zero"
    if not transverse:
        return (
            f"the system has no transverse state: {kappa} equation{'s' * (kappa > 1)} h = 0 "
            f"for {len(constraint.directions)} inputs; which consistency errors to bring to zero "
            "first is a choice that A does not make (for the nonholonomic integrator x3, then x2)"
        )
    deficient = [
        i for i, h in enumerate(constraint.output) if not h.has(*(t.symbol for t in transverse))
    ]
    if deficient:
        numbers = ", ".join(f"h{i + 1}" for i in deficient)
        has = "contains" if len(deficient) == 1 else "contain"
        return (
            f"relative-degree deficit: {numbers} {has} no transverse state, so no input turns "
            "the system along F as it stands; alignment h -> 0 along F is not available"
        )
    if len(transverse) != kappa or len(constraint.leaf) != 2:
        return (
            f"{len(constraint.leaf)} leafwise and {len(transverse)} transverse states for {kappa} "
            "constraints: the misalignment with F is not a single angle (needed: 2, 1 and 1)"
        )
    g = signed_minors(constraint.leaf_matrix)
    sampler = constraint.sampler()
    at = sampler.origin(constraint.symbols)
    along = sp.Add(*(p * e for p, e in zip(constraint.moment, g, strict=True)))
    if not sampler.nonzero(along, at):
        return "the direction g(0) is normal to p, or not a number"
    g = sp.ImmutableMatrix(g * (1 if value_at(along, at) > 0 else -1))
    f = constraint.field
    error = angle(g[0] * f[1] - g[1] * f[0], g[0] * f[0] + g[1] * f[1], UNSEEN)
    t = transverse[0]
    # the turn of g itself: s = angle(F) - angle(g), and F does not contain t
    slope = -(g[0] * g[1].diff(t.symbol) - g[1] * g[0].diff(t.symbol)) / (g[0] ** 2 + g[1] ** 2)
    slope = sp.trigsimp(sp.simplify(slope))
    if sampler.vanishes(slope):
        return f"{t.name} does not turn the direction g: dh/dt is singular"
    if not sampler.nonzero(slope, at):
        return f"{t.name} does not turn the direction g at the origin: dh/dt is singular there"
    turned, regular = _range(constraint, g, slope)
    return Alignment(g, error, slope, abs(turned) > 2 * math.pi - 0.1, regular)


def _range(constraint: Structure, g: sp.Matrix, slope: sp.Expr) -> tuple[float, bool]:
    """The angle by which g turns over the range of the transverse state, at x = 0, and whether
    ds/dt keeps its sign on the way, there and at a few other x."""
    t, sampler = constraint.transverse[0], constraint.sampler()
    reach = [math.pi * i / 90 for i in range(-90, 91)] if t.angle else _wide()
    points = [
        sampler.origin(constraint.symbols),
        *(sampler.point(constraint.symbols, i) for i in (0, 1)),
    ]
    points = points if slope.free_symbols & {q.symbol for q in constraint.leaf} else points[:1]
    angles: list[float] = []
    slopes: list[float] = []
    for number, place in enumerate(points):
        for value in reach:
            at = place | {t.symbol: sp.Float(value)}
            slopes.append(float(value_at(slope, at)))
            x, y = (float(value_at(e, at)) for e in g)
            if number == 0 and math.hypot(x, y) > 0:
                angles.append(math.atan2(y, x))
    turned = math.fsum(math.remainder(b - a, 2 * math.pi) for a, b in pairwise(angles))
    return turned, all(v > 0 for v in slopes) or all(v < 0 for v in slopes)


def _wide() -> list[float]:
    grid = [10 ** (0.1 * i) for i in range(-30, 61)]
    return [-v for v in reversed(grid)] + [0.0, *grid]


def law_outputs(system: System, constraint: Structure, pieces: Alignment) -> dict[str, sp.Expr]:
    """The inputs of `system`, from the speed along g and the rate of the transverse state."""
    g, t = pieces.direction, constraint.transverse[0]
    x = [q.symbol for q in constraint.leaf]
    rho = length(x[0], x[1], UNSEEN)
    along = sp.Add(*(a * b for a, b in zip(g, x, strict=True)))
    size = sp.sqrt(sp.trigsimp(g[0] ** 2 + g[1] ** 2))
    forward = -symbol("k1") * sgn(along) * rho / size
    drift = sp.Add(*(pieces.error.diff(a) * b for a, b in zip(x, g, strict=True)))
    turn = (-symbol("k") * pieces.error - drift * forward) / pieces.slope
    outside = rho - symbol("freeze")
    chosen = {
        SPEED: select(outside, forward, sp.S.Zero),
        SIDE: select(outside, turn, -symbol("k") * (wrap(t.symbol) if t.angle else t.symbol)),
    }
    return {name: e.subs(chosen) for name, e in own_inputs(system, constraint, pieces).items()}


def own_inputs(system: System, constraint: Structure, pieces: Alignment) -> dict[str, sp.Expr]:
    """The inputs of `system` for the motions `SPEED` along g and `SIDE` of the transverse state."""
    if not constraint.kinematic:
        raise DefinitionError(
            f"the inputs of system '{system.name}' do not move its coordinates directly",
            remedy="use velocities as inputs (promote), and track them (track_velocity)",
        )
    rates = {constraint.transverse[0].name: SIDE}
    rates |= {q.name: e * SPEED for q, e in zip(constraint.leaf, pieces.direction, strict=True)}
    solved = constraint.speeds(sp.Matrix([rates[q.name] for q in constraint.coordinates]))
    return {
        u.name: sp.Add(*(sp.simplify(sp.expand(e).coeff(m)) * m for m in (SPEED, SIDE)))
        for u, e in zip(constraint.inputs, solved, strict=True)
    }
