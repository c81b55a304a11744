"""Expressions as readable mathematics: for the terminal and as LaTeX."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable

import sympy as sp
from sympy.printing.latex import LatexPrinter, translate
from sympy.printing.pretty.pretty import PrettyPrinter
from sympy.printing.pretty.pretty_symbology import greek_unicode
from sympy.printing.pretty.stringpict import prettyForm

WIDTH = 100


def equations(
    pairs: Iterable[tuple[str, sp.Expr]], relation: str = "=", taken: Iterable[str] = ()
) -> list[str]:
    """Equations set in two dimensions; long ones are split by naming their parts.

    taken: names that mean something else beside these equations.
    """
    given = dict(pairs)
    used = {str(s) for e in given.values() for s in e.free_symbols} | {*given, *taken}
    free = (s for s in sp.numbered_symbols("s", start=1) if s.name not in used)
    if max(width(e) for e in given.values()) > WIDTH:
        shared, reduced = sp.cse(list(given.values()), symbols=free, order="none")
        given = {str(s): e for s, e in shared} | dict(zip(given, reduced, strict=True))
    lines = []
    for left, expression in given.items():
        rows = pretty(expression)
        middle = len(rows) // 2
        if max(len(row) for row in rows) > WIDTH:
            rows = textwrap.wrap(sp.sstr(expression), WIDTH, break_long_words=False)
            middle = 0
        head = f"    {left} {relation} "
        lines += [
            (head if i == middle else " " * len(head)) + row.rstrip() for i, row in enumerate(rows)
        ]
    return lines


class _Printer(PrettyPrinter):
    """Names and functions as in a scenario file, except for Greek letters."""

    def _print_Symbol(self, e: sp.Symbol) -> prettyForm:  # noqa: N802
        return prettyForm(greek_unicode.get(e.name, e.name))

    def _print_angle(self, e: sp.Expr) -> prettyForm:
        return self._call("atan2", *e.args[:2])

    def _print_length(self, e: sp.Expr) -> prettyForm:
        return self._call("hypot", *e.args[:2])

    def _print_magnitude(self, e: sp.Expr) -> prettyForm:
        return self._call("abs", *e.args)

    def _print_least(self, e: sp.Expr) -> prettyForm:
        return self._call("min", *e.args)

    def _print_greatest(self, e: sp.Expr) -> prettyForm:
        return self._call("max", *e.args)

    def _call(self, name: str, *arguments: sp.Expr) -> prettyForm:
        return self._print_Function(sp.Function(name)(*arguments))


def pretty(expression: sp.Expr) -> list[str]:
    text: str = _Printer({"use_unicode": True, "wrap_line": False}).doprint(expression)
    return text.splitlines()


def width(expression: sp.Expr) -> int:
    return max(len(row) for row in pretty(expression))


class _Latex(LatexPrinter):
    """Greek letters, subscripts, and whole words upright."""

    def _print_Symbol(self, e: sp.Symbol, style: str = "plain") -> str:  # noqa: N802
        return latex_name(e.name)


def latex(expression: sp.Basic) -> str:
    """The expression as LaTeX."""
    text: str = _Latex({"mat_delim": "(", "fold_short_frac": False, "mul_symbol": r" \, "}).doprint(
        expression
    )
    return text


def latex_name(name: str) -> str:
    """A name as LaTeX: psi0 -> \\psi_{0}, tau_u -> \\tau_{u}, threshold upright."""
    head, _, tail = name.partition("_")
    if not tail and (numbered := re.fullmatch(r"([A-Za-z]+?)(\d+)", name)):
        head, tail = numbered.groups()
    shown = "\\lambda" if head == "lam" else translate(head)
    if len(head) > 1 and not shown.startswith("\\"):
        shown = f"\\mathrm{{{head}}}"
    if not tail:
        return shown
    if len(tail) > 1 and not tail.isdigit():
        words = tail.replace("_", "\\ ")
        tail = f"\\mathrm{{{words}}}"
    return f"{shown}_{{{tail}}}"
