"""The null space of A(q): the motions a constraint allows; conversely, the rows motions obey."""

from __future__ import annotations

from itertools import combinations

import sympy as sp

from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.quantity import Parameter, Quantity
from holdfast.maths.definitions.system import PfaffianRow, System


def kinematic_system(
    name: str,
    states: tuple[Quantity, ...],
    rows: tuple[PfaffianRow, ...],
    parameters: tuple[Parameter, ...] = (),
    description: str = "",
    source: str = "",
) -> System:
    """The system q' = sum_i g_i(q) w_i of all motions that A(q) q' = 0 allows.

    For use when only the constraint is known. Inputs w1, w2, ...: along the leaf first, then one
    for each transverse state. Raises `DefinitionError` for rows with b != 0 or rows that are
    dependent at the origin.
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
    inputs = tuple(Quantity(f"w{i}", "1/s", f"motion {i}") for i in range(1, len(directions) + 1))
    return System(
        name=name,
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
