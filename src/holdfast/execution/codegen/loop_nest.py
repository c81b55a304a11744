"""Loop-invariant code motion: every part of an expression moves to the outermost possible loop.

Level k is inside the loop over axis k, and -1 is before all loops. Parts that depend only on the
last axis go into a table, and the rest is computed at every node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import sympy as sp

BEFORE = -1


@dataclass
class Schedule:
    """Statements by level for loops over `axes`; `moving` symbols differ at every node."""

    axes: Sequence[sp.Symbol]
    moving: frozenset[sp.Symbol] = frozenset()
    levels: dict[int, list[tuple[sp.Symbol, sp.Expr]]] = field(default_factory=dict)
    tables: list[tuple[sp.Symbol, sp.Expr]] = field(default_factory=list)
    _level_of: dict[sp.Symbol, frozenset[int]] = field(default_factory=dict)
    _known: dict[sp.Expr, sp.Symbol] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.node = len(self.axes)  # the level of node-dependent parts
        for i, axis in enumerate(self.axes):
            self._level_of[axis] = frozenset({i})
        for s in self.moving:
            self._level_of[s] = frozenset({self.node})

    def add(self, results: Sequence[sp.Expr]) -> list[sp.Expr]:
        """Schedule the parts of these expressions; returns the expressions left at a node."""
        shared, reduced = sp.cse(
            list(results), symbols=sp.numbered_symbols("c_", real=True), order="none"
        )
        for s, e in shared:
            self._define(s, e)
        return [self._part(e) for e in reduced]

    def _where(self, e: sp.Expr) -> frozenset[int]:
        known = (self._level_of.get(s, frozenset()) for s in e.free_symbols)
        return frozenset().union(*known)

    def _level(self, where: frozenset[int]) -> int:
        """The level at which a part with these dependences is computed; the table counts as one."""
        if not where:
            return BEFORE
        last = self.node - 1
        return max(where) if max(where) < last or where == {last} else self.node

    def _define(self, s: sp.Symbol, e: sp.Expr) -> None:
        where = self._where(e)
        level = self._level(where)
        inside = self._rewritten(e, where)
        if level == self.node - 1:
            self.tables.append((s, inside))
        else:
            self.levels.setdefault(level, []).append((s, inside))
        self._level_of[s] = where

    def _part(self, e: sp.Expr) -> sp.Expr:
        """The form of e at a node: a symbol, if it belongs further out."""
        where = self._where(e)
        if self._level(where) == self.node:
            return self._rewritten(e, where)
        return self._symbol(e)

    def _symbol(self, e: sp.Expr) -> sp.Expr:
        if e.is_Atom or (e.is_Mul and len(e.args) == 2 and e.args[0] == -1 and e.args[1].is_Atom):
            return e
        if e not in self._known:
            s = sp.Symbol(f"h_{len(self._known)}", real=True)
            self._known[e] = s
            self._define(s, e)
        return self._known[e]

    def _rewritten(self, e: sp.Expr, where: frozenset[int]) -> sp.Expr:
        """e with every part that belongs further out than e replaced by its symbol."""
        level = self._level(where)
        if e.is_Atom:
            return e
        if e.is_Add or e.is_Mul:
            groups: dict[int, list[sp.Expr]] = {}
            for a in e.args:
                groups.setdefault(self._level(self._where(a)), []).append(a)
            own = [self._rewritten(a, self._where(a)) for a in groups.pop(level, [])]
            outer: list[sp.Expr] = []
            for k in sorted(groups):
                both = e.func(*outer, *groups[k])
                if self._level(self._where(both)) == level:  # an axis and the table
                    outer.append(self._symbol(e.func(*groups[k])))
                else:
                    outer = [self._symbol(both)]
            return e.func(*outer, *own)
        arguments = []
        for a in e.args:
            inside = self._where(a)
            lower = self._level(inside) < level and not a.is_Atom
            arguments.append(self._symbol(a) if lower else self._rewritten(a, inside))
        return e.func(*arguments)
