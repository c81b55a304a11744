"""A lookup table: a function known at the nodes of a grid, as symbols in a law's expressions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import sympy as sp

from holdfast.maths.definitions.quantity import symbol

T = TypeVar("T", bound="Lookup")


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

    def subs(self: T, values: Mapping[sp.Symbol, sp.Expr]) -> T:
        """The same function, looked up where the symbols have these values."""
        return replace(self, places=tuple(e.xreplace(values) for e in self.places))


@dataclass(frozen=True)
class SampledLookup(Lookup):
    """The value of a sampled game, of inputs that are held for `hold` [s].

    predicted [s]: the delay over which the law predicts the state; a run has no other. sloped:
    whether its slopes are looked up too.
    """

    hold: float = 0.0
    predicted: float = 0.0
    sloped: bool = False

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        return super().symbols if self.sloped else (self.value,)


@dataclass(frozen=True)
class CellLookup(Lookup):
    """What is known of the cell that `places` are in, in place of a value between nodes.

    `value` is how long the cell lasts, `entries` are its `width` numbers. hold: the sampling period
    [s] for which these are; a law that uses them is run at no other. errors: by how much each place
    may be measured wrong; delay [s]: by how long an input may come late.
    """

    width: int = 0
    hold: float = 0.0
    errors: tuple[float, ...] = ()
    delay: float = 0.0

    def error_of(self, state: str) -> float:
        """By how much a state may be measured wrong: not at all where it is no place."""
        among = [e for p, e in zip(self.places, self.errors, strict=False) if p == symbol(state)]
        return among[0] if among else 0.0

    @property
    def entries(self) -> tuple[sp.Symbol, ...]:
        return tuple(sp.Symbol(f"_C{i}", real=True) for i in range(self.width))

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        return (self.value, *self.entries)
