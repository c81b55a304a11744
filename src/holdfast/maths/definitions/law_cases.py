"""What a sampled law may do: options, with the conditions under which each is taken."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from holdfast.maths.definitions.lookup import Lookup

Conditions = tuple[sp.Expr, ...]
"""Expressions that are all at most 0 where something is done."""


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

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        return (*self.when, *self.inputs)


@dataclass(frozen=True)
class Program:
    """Inputs that a safeguard gives where `when` < 0, and no option before has its own conditions.

        minimise  sum_i ((u_i - w_i) / s_i)^2   subject to   n_j . u <= b_j

    wanted: w, None where it may be anything. rows: n_j and b_j of each condition in turn, of which
    the first `hard` are not relaxed where not all can be met. scales: s. limits: what actuators
    make of inputs, by the symbols of these. box: the bounds of each input, if they are such.
    """

    when: Conditions
    wanted: tuple[sp.Expr, ...] | None
    rows: tuple[tuple[sp.Expr, ...], ...]
    hard: int
    scales: tuple[sp.Expr, ...]
    limits: tuple[sp.Expr, ...]
    box: tuple[tuple[sp.Expr, sp.Expr], ...] | None
    to: int = 0

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """All but the limits, of which the inputs are those of the program."""
        rows = (e for row in self.rows for e in row)
        ends = (e for pair in self.box or () for e in pair)
        return (*self.when, *(self.wanted or ()), *rows, *self.scales, *ends)


@dataclass(frozen=True)
class LawCases:
    """A sampled law: in each mode the options of which one is taken at a sample.

    modes: their names. initial: the number of the first one. options: of each mode, in order: the
    first whose conditions hold is taken. parts: for each input the edges of the parts that its
    range is divided into, where an option leaves it free. lookup: the table whose symbols the
    expressions use. What depends on the time in the mode is not known.
    """

    modes: tuple[str, ...]
    initial: int
    options: tuple[tuple[Option | Program, ...], ...]
    parts: tuple[tuple[float, ...], ...] = ()
    lookup: Lookup | None = None

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """All of them."""
        options = [o for mode in self.options for o in mode]
        places = self.lookup.places if self.lookup else ()
        limits = (e for o in options if isinstance(o, Program) for e in o.limits)
        return (*(e for o in options for e in o.expressions), *limits, *places)
