"""Expressions of a certificate, read exactly: whole numbers of any size, and no rounding.

The text is parsed to Python's syntax tree, and only what a certificate can contain is translated;
nothing is evaluated as code.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping

import sympy as sp

from holdfast.analysis.certificates.certificate import KNOWN
from holdfast.errors import ExpressionError
from holdfast.maths.expressions import functions
from holdfast.maths.expressions.syntax import syntax_tree

LONGEST = 100_000
MOST, LONGEST_NUMBER = 64, 10_000
"""The largest exponent, and bits of a number."""

FUNCTIONS: Mapping[str, Callable[..., sp.Expr]] = {
    name: getattr(functions, name, None) or getattr(sp, name) for name in KNOWN
} | {"sqrt": sp.sqrt}

Names = Mapping[str, sp.Expr]


def exact_expression(text: object, names: Names) -> sp.Expr:
    """The expression of a text that `Certificate.header` made; names: every symbol by its name.

    Raises `ExpressionError` for text that is none.
    """
    if not isinstance(text, str) or len(text) > LONGEST:
        raise ExpressionError(f"{text!r:.40} is no expression", expected="text")
    try:
        return _of(syntax_tree(text, "eval").body, names)
    except (SyntaxError, RecursionError, MemoryError, ValueError) as error:
        raise ExpressionError(f"'{text:.40}' is no expression ({error})") from None


def _of(node: ast.expr, names: Names) -> sp.Expr:
    match node:
        case ast.Constant(value=int() as value) if not isinstance(value, bool):
            return sp.Integer(value)
        case ast.Name(id="pi"):
            return sp.pi
        case ast.Name(id=name) if name in names:
            return names[name]
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_of(inner, names)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as op, right=b):
            first, other = _of(left, names), _of(b, names)
            if isinstance(op, ast.Add):
                return first + other
            if isinstance(op, ast.Sub):
                return first - other
            return first * other if isinstance(op, ast.Mult) else first / other
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            exponent = _of(right, names)
            if not (exponent.is_Rational and abs(exponent) <= MOST):
                raise ExpressionError(
                    f"the exponent {ast.unparse(right):.40}", expected=f"a number up to {MOST}"
                )
            base = _of(left, names)
            if base.is_Rational and exponent.is_Integer:
                bits = base.p.bit_length() + base.q.bit_length()
                if bits * abs(int(exponent)) > LONGEST_NUMBER:
                    raise ExpressionError(f"a number is too long in '{ast.unparse(node):.40}'")
            several = exponent * base.exp if base.is_Pow and base.exp.is_Rational else exponent
            if abs(several) > MOST:
                raise ExpressionError(f"a power of a power is above {MOST}")
            return base**exponent
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            return FUNCTIONS[name](*(_of(a, names) for a in arguments))
    raise ExpressionError(
        f"'{ast.unparse(node):.40}' is nothing of a certificate",
        expected="its names, " + ", ".join(KNOWN),
    )
