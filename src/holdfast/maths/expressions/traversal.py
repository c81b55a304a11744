"""Traversal of expressions with repeated subexpressions: each is visited once.

SymPy's own methods walk the tree, whose size may be a thousand times that of the expression.

As text an expression has names, whole numbers, operators and functions: nothing is rounded. Texts
of Python are parsed to syntax trees in any number of threads.
"""

from __future__ import annotations

import ast
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import sympy as sp
from sympy.printing.str import StrPrinter

from holdfast.maths.expressions.functions import RealFunction


def parts(expressions: Iterable[sp.Basic]) -> Iterator[sp.Basic]:
    """Every part of the expressions, each once."""
    seen: set[sp.Basic] = set()
    waiting = list(expressions)
    while waiting:
        part = waiting.pop()
        if part not in seen:
            seen.add(part)
            waiting.extend(part.args)
            yield part


def symbols_of(expressions: Iterable[sp.Basic]) -> set[sp.Symbol]:
    """All symbols of the expressions."""
    return {part for part in parts(expressions) if isinstance(part, sp.Symbol)}


def exchanged(expressions: Iterable[sp.Expr], values: Mapping[sp.Expr, sp.Expr]) -> list[sp.Expr]:
    """The expressions with parts exchanged for others, as by `xreplace`."""
    memo: dict[sp.Basic, sp.Basic] = dict(values)

    def replaced(part: sp.Basic) -> sp.Basic:
        if part not in memo:
            arguments = [replaced(a) for a in part.args]
            same = all(a is b for a, b in zip(arguments, part.args, strict=True))
            memo[part] = part if same else part.func(*arguments)
        return memo[part]

    return [replaced(e) for e in expressions]


def at_numbers(e: sp.Expr, values: Mapping[sp.Symbol, sp.Expr | float]) -> sp.Expr:
    """The expression where its symbols have these values, as by `subs`; the last ones stay."""
    used = tuple((s, sp.sympify(values[s])) for s in symbols_in(e) if s in values)
    return _at_numbers(e, used)


@lru_cache(maxsize=1024)
def symbols_in(e: sp.Expr) -> tuple[sp.Symbol, ...]:
    """All symbols of an expression; the last answers stay."""
    return tuple(symbols_of([e]))


@lru_cache(maxsize=1024)
def _at_numbers(e: sp.Expr, used: tuple[tuple[sp.Symbol, sp.Expr], ...]) -> sp.Expr:
    return exchanged([e], dict(used))[0] if all(v.is_number for _, v in used) else e.subs(used)


def exact(e: Any) -> sp.Expr:
    """With floats as the rational numbers that they are: derivatives of these are exact."""
    e = sp.sympify(e)
    return e.xreplace({f: sp.Rational(f) for f in e.atoms(sp.Float)})


def derivatives(expression: sp.Expr, by: Iterable[sp.Symbol]) -> dict[sp.Symbol, sp.Expr]:
    """The derivative of the expression by each symbol, as `diff` has it."""
    return {s: _derivative(expression, s, {}) for s in by}


def _derivative(e: sp.Expr, s: sp.Symbol, memo: dict[sp.Basic, sp.Expr]) -> sp.Expr:
    if e not in memo:
        if isinstance(e, CHAINED):
            memo[e] = _by_chain(e, s, [_derivative(a, s, memo) for a in e.args])
        else:
            memo[e] = e.diff(s)
    return memo[e]


_OF_ONE = (sp.sin, sp.cos, sp.tan, sp.tanh, sp.exp, sp.log, sp.atan)
CHAINED = (sp.Add, sp.Mul, sp.Pow, RealFunction, *_OF_ONE)
"""Other functions may have arguments that are not numbers, such as `Piecewise` conditions."""


def _by_chain(e: sp.Expr, s: sp.Symbol, slopes: Sequence[sp.Expr]) -> sp.Expr:
    """The derivative from those of the arguments."""
    if all(slope == 0 for slope in slopes):
        return sp.S.Zero
    if isinstance(e, sp.Add):
        return sp.Add(*slopes)
    if isinstance(e, sp.Mul):
        return sp.Add(
            *(
                sp.Mul(*e.args[:i], slope, *e.args[i + 1 :])
                for i, slope in enumerate(slopes)
                if slope != 0
            )
        )
    if isinstance(e, sp.Pow):
        base, exponent = e.args
        growth = slopes[1] * sp.log(base) if slopes[1] != 0 else sp.S.Zero
        return e * (growth + slopes[0] * exponent / base)
    return e.slope(slopes) if isinstance(e, RealFunction) else e.fdiff(1) * slopes[0]


def plain_text(e: sp.Expr) -> str:
    """The text of an expression, which is read again without a loss."""
    return str(StrPrinter().doprint(exact(e)))


_PARSING = threading.Lock()


def syntax_tree(text: str, mode: str = "exec") -> Any:
    """`ast.parse`, by one thread at a time.

    Python 3.11 counts the depth of a tree once for all threads, and fails where two of them parse
    (`SystemError: AST constructor recursion depth mismatch`; Python's issue 106905).
    """
    with _PARSING:
        return ast.parse(text, mode=mode)
