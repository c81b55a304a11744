"""A lookup table: a function known at the nodes of a grid, as symbols in a law's expressions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import sympy as sp


@dataclass(frozen=True)
class Lookup:
    """V and its slopes at `places`: expressions of quantities a law reads, one for every axis.

    `value` and `slopes` (dV/d place, one for every axis) stand for them in expressions. `table`
    holds the numbers; its type is known only to the code that runs laws. timed: whether the first
    axis is the remaining time. first_time: then the least remaining time that is stored; below it
    the function is constant in time. unit: of V.
    """

    places: tuple[sp.Expr, ...]
    table: object = field(repr=False, compare=False)
    first_time: float = 0.0
    timed: bool = False
    unit: str = "1"

    @property
    def value(self) -> sp.Symbol:
        return sp.Symbol("_V", real=True)

    @property
    def slopes(self) -> tuple[sp.Symbol, ...]:
        return tuple(sp.Symbol(f"_V{i}", real=True) for i in range(len(self.places)))

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        return (self.value, *self.slopes)

    def subs(self, values: Mapping[sp.Symbol, sp.Expr]) -> Lookup:
        """The same function, looked up where the symbols have these values."""
        return replace(self, places=tuple(e.xreplace(values) for e in self.places))
