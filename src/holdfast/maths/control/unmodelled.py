"""What a model leaves out, and waves: bounded unknown forces, estimated and cancelled.

    qdot = f(q, u + w, d)          w_i in [low_i, high_i]

An observer (`observe`) estimates w from the states, with the inputs that were applied, limited as
they were. So it is integral action that does not wind up: neither where an actuator is at its
limit nor where a safety filter overrules the law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar, cast

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.bounds import Bounds, product
from holdfast.maths.definitions.extension import free_box, per_second
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Quantity, symbol
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System

L = TypeVar("L", bound=Law | Switching)
PREFIX = "unmodelled_"


@checked
def add_unmodelled(system: System, names: Sequence[str], bounds: Bounds) -> System:
    """`system` with unknown parts of inputs, or of the rates of states, as disturbances.

        input i: qdot = f(q, u + w, d)        w_i in the unit of the input
        state s: qdot_s = f_s(q, u, d) + w_s  w_s in the unit of the state, per second

    names: inputs and states; the disturbance of each is called unmodelled_NAME. bounds: what they
    may be, in this order.

    They are zero in a simulation unless given: a constant, an expression of time such as a wave, or
    a worst case. A kernel counts with all that the bounds admit. The part of an input can be
    cancelled (`cancel_unmodelled`); one of a state without an input, such as a force from the side,
    cannot, and a safety filter that knows it counts with it.

    Raises `DefinitionError` for unknown names, and bounds of another dimension.

    >>> hf.add_unmodelled(cart, ["a"], hf.Box((-0.2,), (0.2,))).disturbance_names
    ('unmodelled_a',)
    """
    chosen = tuple(names)
    inputs = {q.name: q for q in system.inputs}
    states = {q.name: q for q in system.states}
    if not chosen or len(set(chosen)) != len(chosen):
        raise DefinitionError(f"names are {list(chosen)}", expected="names, each of them once")
    for name in chosen:
        if name not in inputs and name not in states:
            raise DefinitionError(
                f"'{name}' is neither an input nor a state of system '{system.name}'",
                remedy=suggestion(name, (*inputs, *states)),
            )
    if bounds.dimension != len(chosen):
        raise DefinitionError(
            f"the bounds have the dimension {bounds.dimension}",
            expected=f"{len(chosen)}: {', '.join(chosen)}",
        )
    added = tuple(
        Quantity(
            PREFIX + name,
            inputs[name].unit if name in inputs else per_second(states[name].unit),
            f"unmodelled part of {name}",
        )
        for name in chosen
    )
    pushed = {symbol(n): symbol(n) + q.symbol for n, q in zip(chosen, added, strict=True)}
    pushed = {s: e for s, e in pushed.items() if s.name in inputs}
    rates = {name: rate.xreplace(pushed) for name, rate in system.rates.items()}
    for name, q in zip(chosen, added, strict=True):
        if name not in inputs:
            rates[name] = rates[name] + q.symbol
    more = {n: q.symbol for n, q in zip(chosen, added, strict=True) if n in states}
    rows = tuple(
        replace(
            row,
            rhs=row.rhs.xreplace(pushed)
            + sum(row.coefficients.get(n, 0) * w for n, w in more.items()),
        )
        for row in system.pfaffian
    )
    before = system.disturbance_bounds or free_box(len(system.disturbances))
    return replace(
        system,
        name=f"{system.name}, {' and '.join(chosen)} not exactly known",
        rates=rates,
        pfaffian=rows,
        disturbances=(*system.disturbances, *added),
        disturbance_bounds=product(before, bounds) if system.disturbances else bounds,
    )


@checked
def cancel_unmodelled(system: System, law: L) -> L:
    """`law` less the unmodelled parts of its inputs: u = gamma(q) - w.

    The law then reads w, which `observe` estimates: track velocities first, then cancel, then
    safeguard, then observe. Raises `DefinitionError` for a system without unmodelled parts of
    inputs, and for a law that does not give the inputs.

    >>> waves = hf.add_unmodelled(cart, ["a"], hf.Box((-0.2,), (0.2,)))
    >>> hf.cancel_unmodelled(waves, brake).outputs["a"]
    -c*v - k*x - unmodelled_a
    """
    felt = {q.name.removeprefix(PREFIX): q for q in system.disturbances}
    felt = {n: q for n, q in felt.items() if n in system.input_names and q.name == PREFIX + n}
    if not felt:
        raise DefinitionError(
            f"system '{system.name}' has no unmodelled parts of inputs", remedy="use add_unmodelled"
        )

    def cancelled(mode: Law) -> Law:
        if missing := [n for n in felt if n not in mode.outputs]:
            raise DefinitionError(
                f"law '{mode.name}' does not give {', '.join(missing)}",
                remedy="track its velocities first",
            )
        reads = {q.name: q for q in (*mode.reads, *felt.values())}
        outputs = {n: e - felt[n].symbol if n in felt else e for n, e in mode.outputs.items()}
        return replace(mode, reads=tuple(reads.values()), outputs=outputs)

    if isinstance(law, Switching):
        return cast(L, law.map_laws(cancelled, law.name))
    return cast(L, cancelled(law))
