"""A set of states given by named inequalities c_j(q) <= 0.

The one sign convention of holdfast: c <= 0 is safe, as in chapters 5 and 6. Chapter 7 of
the thesis calls l > 0 safe; l = -max_j c_j is formed here (`Region.margin`) and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.functions import greatest
from holdfast.maths.quantity import (
    TIME,
    Parameter,
    Quantity,
    check_symbols,
    check_unique,
    merge_parameters,
)
from holdfast.maths.scene import Shape


@checked
@dataclass(frozen=True)
class Inequality:
    """expression <= 0, in the unit given."""

    name: str
    expression: sp.Expr
    unit: str = "1"
    description: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "expression", sp.sympify(self.expression))


@checked
@dataclass(frozen=True)
class Region:
    """K = { q : c_j(q) <= 0 for every j } (thesis (5.4), with its parameters).

    `reads` are the states the inequalities use. `scene` says what to draw. A region that moves,
    whose inequalities depend on `TIME`, is for kernels and reachable sets.
    """

    name: str
    reads: tuple[Quantity, ...]
    inequalities: tuple[Inequality, ...]
    parameters: tuple[Parameter, ...] = ()
    scene: tuple[Shape, ...] = ()
    description: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        owner = f"region '{self.name}'"
        object.__setattr__(self, "parameters", merge_parameters(self.parameters))
        if not self.inequalities:
            raise DefinitionError(f"{owner} has no inequalities")
        check_unique((c.name for c in self.inequalities), owner)
        check_unique((q.name for q in self.reads + self.parameters), owner)
        allowed = [q.symbol for q in self.reads + self.parameters] + [TIME]
        check_symbols(
            {f"inequality '{c.name}'": c.expression for c in self.inequalities}, allowed, owner
        )

    @property
    def moves(self) -> bool:
        return any(c.expression.has(TIME) for c in self.inequalities)

    @property
    def inequality_names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.inequalities)

    @checked
    def inequality(self, name: str) -> Inequality:
        """The inequality of that name; `DefinitionError` if there is none."""
        if name not in self.inequality_names:
            raise DefinitionError(
                f"region '{self.name}' has no inequality {name!r}",
                expected="one of " + ", ".join(self.inequality_names),
            )
        return self.inequalities[self.inequality_names.index(name)]

    @property
    def worst(self) -> sp.Expr:
        """max_j c_j(q): the region is where this is <= 0."""
        value = self.inequalities[0].expression
        for c in self.inequalities[1:]:
            value = greatest(value, c.expression)
        return value

    @property
    def margin(self) -> sp.Expr:
        """l = -max_j c_j(q), the convention of chapter 7: safe where positive."""
        return -self.worst
