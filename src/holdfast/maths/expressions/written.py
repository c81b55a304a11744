"""Expressions as plain data, each part of them once, and the same expressions from it.

An expression is a list of steps: a symbol, a number, or a function of earlier steps.

    ["symbol", "x"], ["integer", "2"], ["Pow", 0, 1], ["rational", "1", "3"], ["Mul", 3, 2]

A float has its mantissa, its exponent of two and the bits of its precision. Nothing is evaluated as
code: a step calls one of `FUNCTIONS`, and what is too large to have been written is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import sympy as sp

from holdfast.errors import ExpressionError
from holdfast.maths.expressions import functions
from holdfast.maths.formations import walls

NUMBERS: Mapping[str, sp.Expr] = {"pi": sp.pi, "E": sp.E}

FUNCTIONS: Mapping[str, Callable[..., sp.Expr]] = {
    f.__name__: f
    for f in (
        sp.Add, sp.Mul, sp.Pow, sp.sin, sp.cos, sp.tan, sp.asin, sp.acos, sp.atan, sp.atan2, sp.exp,
        sp.log, sp.sinh, sp.cosh, sp.tanh, sp.Abs, sp.sign, sp.Min, sp.Max, functions.sgn,
        functions.wrap, functions.select, functions.least, functions.greatest, functions.angle,
        functions.length, functions.magnitude, walls.nearest_on_walls, walls.nearest_face,
        walls.nearest_to_sight, walls.separating_sides, walls.passing,
    )
}  # fmt: skip

MOST_BITS = 4096
"""Bits of a whole number."""
MOST_EXPONENT = 64
"""The largest exponent of a number."""
MOST_PARTS = 10**7
"""Parts of an expression, those that stand in it twice counted twice."""


class Steps:
    """Steps that expressions are written to: `rows`, as lists of text and whole numbers."""

    def __init__(self) -> None:
        self.rows: list[list[Any]] = []
        self._known: dict[sp.Basic, int] = {}

    def number(self, expression: sp.Expr) -> int:
        """The number of the step that is the expression; its steps are added where they lack.

        Raises `ExpressionError` for a symbol that is not real, and for a function that no step has.
        """
        waiting: list[sp.Basic] = [expression]
        while waiting:
            part = waiting[-1]
            arguments = _arguments(part)
            if missing := [a for a in arguments if a not in self._known]:
                waiting += missing
                continue
            waiting.pop()
            if part not in self._known:
                self.rows.append(_row(part, [self._known[a] for a in arguments]))
                self._known[part] = len(self.rows) - 1
        return self._known[expression]


def _arguments(part: sp.Basic) -> tuple[sp.Basic, ...]:
    if part.is_Number or not part.args or FUNCTIONS.get(type(part).__name__) is type(part):
        return () if part.is_Number else part.args
    raise _refusal(part)


def _row(part: sp.Basic, arguments: Sequence[int]) -> list[Any]:
    if isinstance(part, sp.Float) and part.is_finite:
        sign, mantissa, exponent, _ = part._mpf_
        return ["float", str(-int(mantissa) if sign else int(mantissa)), int(exponent), part._prec]
    if isinstance(part, sp.Integer):
        return ["integer", str(int(part))]
    if isinstance(part, sp.Rational):
        return ["rational", str(part.p), str(part.q)]
    if isinstance(part, sp.Symbol) and part == sp.Symbol(part.name, real=True):
        return ["symbol", part.name]
    for name, number in NUMBERS.items():
        if part == number:
            return [name]
    if arguments:
        return [type(part).__name__, *arguments]
    raise _refusal(part)


def _refusal(part: sp.Basic) -> ExpressionError:
    return ExpressionError(
        f"'{part!s:.60}' cannot be written to a file",
        expected="real symbols, numbers, " + ", ".join(FUNCTIONS),
    )


def expressions(rows: Sequence[Sequence[Any]]) -> list[sp.Expr]:
    """The expression of every step; `ExpressionError` for steps that nobody wrote."""
    by_step: list[sp.Expr] = []
    sizes: list[int] = []
    for row in rows:
        kind, *rest = row
        arguments = [_earlier(k, len(by_step)) for k in rest] if kind in FUNCTIONS else []
        sizes.append(1 + sum(sizes[k] for k in arguments))
        if sizes[-1] > MOST_PARTS:
            raise ExpressionError("an expression is too large", expected=f"{MOST_PARTS:,} parts")
        by_step.append(_made(kind, rest, [by_step[k] for k in arguments]))
    return by_step


def _earlier(number: Any, count: int) -> int:
    if type(number) is not int or not 0 <= number < count:
        raise ExpressionError(f"step {number!r:.20} is no earlier step")
    return number


def _made(kind: Any, rest: Sequence[Any], arguments: Sequence[sp.Expr]) -> sp.Expr:
    match kind, *rest:
        case "symbol", str(name):
            return sp.Symbol(name, real=True)
        case "integer", str(value):
            return sp.Integer(_whole(value))
        case "rational", str(over), str(under) if _whole(under):
            return sp.Rational(_whole(over), _whole(under))
        case "float", str(value), int(exponent), int(precision):
            return _float(_whole(value), exponent, precision)
        case (str(name),) if name in NUMBERS:
            return NUMBERS[name]
    if not arguments:
        raise ExpressionError(f"step {[kind, *rest]!r:.60} is none of an expression")
    _check_power(kind, arguments)
    made = sp.sympify(FUNCTIONS[kind](*arguments))
    if isinstance(made, sp.Rational) and max(abs(made.p), made.q).bit_length() > MOST_BITS:
        raise ExpressionError("a number is too large", expected=f"{MOST_BITS} bits")
    return made


def _whole(text: str) -> int:
    if len(text) > MOST_BITS // 3:
        raise ExpressionError("a number is too large", expected=f"{MOST_BITS} bits")
    return int(text)


def _float(mantissa: int, exponent: int, precision: int) -> sp.Expr:
    if not (abs(exponent) <= MOST_BITS and 1 <= precision <= MOST_BITS):
        raise ExpressionError(f"a float of {precision} bits, with the exponent {exponent}")
    if not mantissa:
        return sp.Float(0, precision=precision)
    size = abs(mantissa)
    return sp.Float((int(mantissa < 0), size, exponent, size.bit_length()), precision=precision)


def _check_power(kind: str, arguments: Sequence[sp.Expr]) -> None:
    """Refuse a power of a number that takes for ever."""
    if kind == "Pow" and all(a.is_number for a in arguments):
        exponent = arguments[-1]
        if not (exponent.is_Number and abs(exponent) <= MOST_EXPONENT):
            raise ExpressionError(
                f"the exponent {exponent!s:.40}", expected=f"a number up to {MOST_EXPONENT}"
            )
