"""The printer from SymPy to source text."""

from __future__ import annotations

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from holdfast.maths.definitions.quantity import SAMPLE_TIME, TIME, TIME_IN_MODE


class Printer(PythonCodePrinter):
    """Numba-compatible text for every expression holdfast can build."""

    def _print_sgn(self, e: sp.Expr) -> str:
        return f"sgn({self._print(e.args[0])})"

    def _print_wrap(self, e: sp.Expr) -> str:
        return f"wrap({self._print(e.args[0])})"

    def _print_select(self, e: sp.Expr) -> str:
        x, a, b = (self._print(arg) for arg in e.args)
        return f"select({x}, {a}, {b})"

    def _print_least(self, e: sp.Expr) -> str:
        a, b = (self._print(arg) for arg in e.args)
        return f"least({a}, {b})"

    def _print_greatest(self, e: sp.Expr) -> str:
        a, b = (self._print(arg) for arg in e.args)
        return f"greatest({a}, {b})"

    def _print_angle(self, e: sp.Expr) -> str:
        return f"math.atan2({self._print(e.args[0])}, {self._print(e.args[1])})"

    def _print_length(self, e: sp.Expr) -> str:
        x, y = (self._print(arg) for arg in e.args[:2])
        return f"length({x}, {y})"

    def _print_nearest_on_walls(self, e: sp.Expr) -> str:
        return self._picked("nearest_on_walls", 2, e)

    def _print_nearest_to_sight(self, e: sp.Expr) -> str:
        return self._picked("nearest_to_sight", 4, e)

    def _picked(self, function: str, points: int, e: sp.Expr) -> str:
        """One of the results of a function of coordinates and of a tuple of all walls."""
        texts = [self._print(arg) for arg in e.args[1:]]
        at, walls = ", ".join(texts[:points]), ", ".join(texts[points:])
        return f"{function}({at}, ({walls},))[{int(e.args[0])}]"

    def _print_magnitude(self, e: sp.Expr) -> str:
        return f"abs({self._print(e.args[0])})"

    def _print_sign(self, e: sp.Expr) -> str:
        return f"sign({self._print(e.args[0])})"

    def _print_Integer(self, e: sp.Expr) -> str:  # noqa: N802
        return f"{int(e)}.0"

    def _print_Rational(self, e: sp.Expr) -> str:  # noqa: N802
        return repr(float(e))

    def _print_Float(self, e: sp.Expr) -> str:  # noqa: N802
        return repr(float(e))

    def _print_Pow(self, e: sp.Expr, rational: bool = False) -> str:  # noqa: N802
        base, exponent = e.as_base_exp()
        other = f"(%s ** ({self._print(exponent)}))"
        return power(f"({self._print(base)})", exponent, "math.sqrt", other)


def power(base: str, exponent: sp.Expr, root: str, other: str) -> str:
    """A power as products, or by the function `root`, or as `other`, with %s for the base."""
    if exponent.is_Integer and 1 <= abs(int(exponent)) <= 8:
        product = " * ".join([base] * abs(int(exponent)))
        return f"({product})" if exponent > 0 else f"(1.0 / ({product}))"
    if exponent == sp.Rational(1, 2):
        return f"{root}({base})"
    if exponent == sp.Rational(-1, 2):
        return f"(1.0 / {root}({base}))"
    return other % base


_PRINTER = Printer({"fully_qualified_modules": True})


def text_of(expression: sp.Expr) -> str:
    """One expression as text."""
    return str(_PRINTER.doprint(expression))


def source_name(s: sp.Symbol) -> str:
    """The name in the source. It ends in '_', unlike arguments and generated names."""
    return s.name if s in (TIME, TIME_IN_MODE, SAMPLE_TIME) else f"{s.name}_"
