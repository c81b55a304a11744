"""Expressions as text of names, whole numbers, operators and functions: nothing is rounded."""

from __future__ import annotations

import sympy as sp
from sympy.printing.str import StrPrinter

from holdfast.maths.expressions.traversal import exact


def plain_text(e: sp.Expr) -> str:
    """The text of an expression, which is read again without a loss."""
    return str(StrPrinter().doprint(exact(e)))
