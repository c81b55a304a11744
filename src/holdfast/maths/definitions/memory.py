"""The discrete-time state of a controller from one sample to the next, as in an observer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import (
    SAMPLE_TIME,
    TIME,
    Parameter,
    Quantity,
    check_symbols,
    check_unique,
    frozen,
    merge_parameters,
)


@checked
@dataclass(frozen=True)
class Memory:
    """z(0) = initial(q), z(k+1) = following(q(k), z(k), u(k)) for the quantities z.

    `reads` are measured quantities. `inputs` are those of the system: the command to the
    actuators at sample k, saturated at the limits that the controller knows. `following` may
    also use `SAMPLE_TIME`.
    """

    quantities: tuple[Quantity, ...]
    initial: Mapping[str, sp.Expr]
    following: Mapping[str, sp.Expr]
    reads: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...] = ()
    parameters: tuple[Parameter, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", merge_parameters(self.parameters))
        object.__setattr__(self, "initial", frozen(self.initial))
        object.__setattr__(self, "following", frozen(self.following))
        names = {q.name for q in self.quantities}
        everything = (*self.quantities, *self.reads, *self.inputs, *self.parameters)
        check_unique((q.name for q in everything), "the memory")
        for what, table in (("first", self.initial), ("following", self.following)):
            if set(table) != names:
                odd = min(names ^ set(table))
                raise DefinitionError(
                    f"'{odd}' " + (f"has no {what} value" if odd in names else "is not remembered")
                )
        known = [q.symbol for q in (*self.reads, *self.parameters)]
        check_symbols(
            {f"first value of '{n}'": e for n, e in self.initial.items()}, known, "the memory"
        )
        own = [q.symbol for q in (*self.quantities, *self.inputs)]
        check_symbols(
            {f"following value of '{n}'": e for n, e in self.following.items()},
            [*known, *own, TIME, SAMPLE_TIME],
            "the memory",
        )


def joined(one: Memory | None, other: Memory) -> Memory:
    """Both memories of a controller; `DefinitionError` where they remember the same name."""
    if one is None:
        return other
    reads = {q.name: q for q in (*one.reads, *other.reads)}
    inputs = {q.name: q for q in (*one.inputs, *other.inputs)}
    return Memory(
        quantities=(*one.quantities, *other.quantities),
        initial={**one.initial, **other.initial},
        following={**one.following, **other.following},
        reads=tuple(reads.values()),
        inputs=tuple(inputs.values()),
        parameters=(*one.parameters, *other.parameters),
    )
