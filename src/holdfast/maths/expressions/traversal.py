"""Expressions taken apart, differentiated, and brought to the functions that can be compiled.

SymPy's own methods walk the tree, whose size may be a thousand times that of an expression with
repeated parts: here each part is visited once.

SymPy differentiates `Max` and `Min` to `Heaviside`, `sign` to `DiracDelta`, and `atan2` to 0/0 at
the origin. A definition exchanges them once, where it takes an expression (`canonical`), so that
whatever is derived from it has the derivatives of `functions.py`:

| of SymPy | becomes |
|---|---|
| Abs, Max, Min | magnitude, greatest, least |
| sign(x) | select(x, select(-x, 0, 1), -1): 0 at 0, with the derivative 0 |
| Heaviside(x, h) | select(x, select(-x, h, 1), 0) |
| Piecewise | select of the difference in each comparison |
| atan2(y, x) | angle(y, x) |
| cot, sec, csc, coth, sech, csch | the inverses of tan, cos, sin, tanh, cosh, sinh |

An expression that jumps becomes cases that do not (`branches`).

As text an expression has names, whole numbers, operators and functions: nothing is rounded. Texts
of Python are parsed to syntax trees in any number of threads.
"""

from __future__ import annotations

import ast
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import sympy as sp
from sympy.logic.boolalg import Boolean
from sympy.printing.str import StrPrinter

from holdfast.errors import DefinitionError
from holdfast.maths.expressions.functions import (
    FUNCTIONS,
    Frozen,
    RealFunction,
    greatest,
    least,
    magnitude,
    pairwise,
    select,
    sgn,
)


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
        if isinstance(e, Frozen):
            memo[e] = sp.S.Zero
        elif isinstance(e, select):  # the condition has no slope
            of_cases = [_derivative(a, s, memo) for a in e.args[1:]]
            memo[e] = _by_chain(e, s, [sp.S.Zero, *of_cases])
        elif isinstance(e, CHAINED):
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


MOST_CASES = 256
"""Cases of one group of expressions."""

JUMPS = (select, sgn, sp.sign)

Branch = tuple[tuple[sp.Expr, ...], list[sp.Expr]]
"""Conditions that are all at most 0 there, and the expressions."""


def branches(expressions: Sequence[sp.Expr]) -> list[Branch]:
    """The expressions without `select`, `sgn` and `sign`: one case for each way these may go.

    Somewhere on the border of two cases both have their conditions. Raises `DefinitionError` for
    more than `MOST_CASES` cases.
    """
    waiting: list[Branch] = [((), list(expressions))]
    finished: list[Branch] = []
    while waiting:
        if len(waiting) + len(finished) > MOST_CASES:
            raise DefinitionError(
                f"expressions with more than {MOST_CASES} cases of select and sgn"
            )
        conditions, now = waiting.pop()
        at = _first_level(now)
        if at is None:
            finished.append((conditions, now))
            continue
        for sign, more in ((1, (-at,)), (-1, (at,)), (0, (at, -at))):
            jumps = [p for p in parts(now) if isinstance(p, JUMPS) and p.args[0] == at]
            if sign or any(isinstance(p, sp.sign) for p in jumps):
                values = {p: _value(p, sign) for p in jumps}
                waiting.append(((*conditions, *more), exchanged(now, values)))
    return finished


def _first_level(expressions: Sequence[sp.Expr]) -> sp.Expr | None:
    """What a jump depends on, in which nothing jumps."""
    for part in parts(expressions):
        if isinstance(part, JUMPS) and not any(isinstance(p, JUMPS) for p in parts(part.args[:1])):
            level: sp.Expr = part.args[0]
            return level
    return None


def _value(jump: sp.Expr, sign: int) -> sp.Expr:
    if isinstance(jump, select):
        return jump.args[1] if sign >= 0 else jump.args[2]
    if isinstance(jump, sgn):
        return sp.Integer(1 if sign >= 0 else -1)
    return sp.Integer(sign)


def _sign(x: sp.Expr) -> sp.Expr:
    return select(x, select(-x, 0, 1), -1)


def _step(x: sp.Expr, half: sp.Expr) -> sp.Expr:
    return select(x, select(-x, half, 1), 0)


def _cases(*pairs: sp.Basic) -> sp.Expr:
    """The value of the first pair (value, condition) whose condition holds."""
    if sp.Or(*(condition for _, condition in pairs)) != sp.true:
        raise DefinitionError(
            f"Piecewise has no value where none of its conditions holds: {pairs[-1]}",
            remedy="end it with (value, True)",
        )
    nested, _ = pairs[-1]
    for value, condition in reversed(pairs[:-1]):
        nested = _chosen(condition, value, nested)
    return nested


def _chosen(condition: Boolean, then: sp.Expr, other: sp.Expr) -> sp.Expr:
    """`then` where the condition holds, `other` elsewhere."""
    if condition in (sp.true, sp.false):
        return then if condition == sp.true else other
    if isinstance(condition, sp.Not):
        return _chosen(condition.args[0], other, then)
    if isinstance(condition, sp.And):
        for part in condition.args:
            then = _chosen(part, then, other)
        return then
    if isinstance(condition, sp.Or):
        for part in condition.args:
            other = _chosen(part, then, other)
        return other
    if isinstance(condition, sp.Rel):
        difference = condition.lhs - condition.rhs
        match condition:
            case sp.Ge():
                return select(difference, then, other)
            case sp.Le():
                return select(-difference, then, other)
            case sp.Gt():
                return select(-difference, other, then)
            case sp.Lt():
                return select(difference, other, then)
            case sp.Eq():
                return select(difference, select(-difference, then, other), other)
            case sp.Ne():
                return select(difference, select(-difference, other, then), then)
    raise DefinitionError(
        f"the condition {condition} of Piecewise cannot be compiled",
        expected="comparisons, joined by And, Or and Not",
    )


OWN: Mapping[type, Callable[..., sp.Expr]] = {
    sp.Abs: magnitude,
    sp.Max: pairwise(greatest),
    sp.Min: pairwise(least),
    sp.sign: _sign,
    sp.Heaviside: _step,
    sp.Piecewise: _cases,
    sp.atan2: FUNCTIONS["atan2"][2],
    sp.cot: lambda x: 1 / sp.tan(x),
    sp.sec: lambda x: 1 / sp.cos(x),
    sp.csc: lambda x: 1 / sp.sin(x),
    sp.coth: lambda x: 1 / sp.tanh(x),
    sp.sech: lambda x: 1 / sp.cosh(x),
    sp.csch: lambda x: 1 / sp.sinh(x),
}
"""Function of SymPy -> the same of the project's own, from its arguments."""


def by_names(e: sp.Basic) -> sp.Basic:
    """With the real symbol of its name in place of every other: a name is enough."""
    others = {
        s: real
        for s in symbols_of([e])
        if type(s) is sp.Symbol and s != (real := sp.Symbol(s.name, real=True))
    }
    return e.xreplace(others) if others else e


def canonical(expression: Any) -> sp.Expr:
    """The expression with the project's own functions in place of those of SymPy in `OWN`, and with
    symbols that are known by their names.

    Raises `DefinitionError` for a Piecewise that has no value somewhere, or whose conditions are
    no comparisons.
    """
    e = sp.sympify(expression)
    if not isinstance(e, sp.Basic):
        return e
    e = by_names(e)
    if not any(type(p) in OWN for p in parts([e])):
        return e
    memo: dict[sp.Basic, sp.Basic] = {}

    def converted(part: sp.Basic) -> sp.Basic:
        if part not in memo:
            arguments = [converted(a) for a in part.args]
            if type(part) in OWN:
                memo[part] = sp.sympify(OWN[type(part)](*arguments))
            else:
                same = all(a is b for a, b in zip(arguments, part.args, strict=True))
                memo[part] = part if same else part.func(*arguments)
        return memo[part]

    return converted(e)


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
