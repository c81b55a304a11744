"""What a sampled law may do: options, with the conditions under which each is taken."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from holdfast.maths.definitions.lookup import Lookup

Conditions = tuple[sp.Expr, ...]
"""Expressions that are all at most 0 where something is done."""

Definitions = tuple[tuple[sp.Symbol, sp.Expr], ...]
"""Symbols and what they stand for; a later one may use earlier ones."""


@dataclass(frozen=True)
class Option:
    """Inputs that are given where `when` < 0, and no option before has its own conditions.

    Where one of `when` is 0 and none is above, they may be given or those of a later option.

    inputs: expressions, one for each input. The symbol of an input itself stands for any number
    that the input may be, the same one in `when`. to: the number of the mode afterwards.
    """

    when: Conditions
    inputs: tuple[sp.Expr, ...]
    to: int = 0


@dataclass(frozen=True)
class LawCases:
    """A sampled law: in each mode the options of which one is taken at a sample.

    modes: their names. initial: the number of the first one. options: of each mode, in order: the
    first whose conditions hold is taken. where: definitions that they use. parts: for each input
    the edges of the parts that its range is divided into, where an option leaves it free. lookup:
    the table whose symbols the expressions use. What depends on the time in the mode is not known.
    """

    modes: tuple[str, ...]
    initial: int
    options: tuple[tuple[Option, ...], ...]
    where: Definitions = ()
    parts: tuple[tuple[float, ...], ...] = ()
    lookup: Lookup | None = None

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """All of them."""
        options = [o for mode in self.options for o in mode]
        places = self.lookup.places if self.lookup else ()
        return (
            *(e for _, e in self.where),
            *(e for o in options for e in (*o.when, *o.inputs)),
            *places,
        )
