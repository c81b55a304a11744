"""Expressions as C99, with the conventions of the compiled closed loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp
from sympy.printing.c import C99CodePrinter
from sympy.printing.codeprinter import PrintMethodNotImplementedError

from holdfast.errors import DefinitionError
from holdfast.execution.codegen.printer import power, source_name
from holdfast.maths.expressions.traversal import exchanged, symbols_of

_CALLS = {
    "sgn": "hf_sgn",
    "wrap": "hf_wrap",
    "sign": "hf_sign",
    "least": "hf_least",
    "greatest": "hf_greatest",
    "select": "hf_select",
    "length": "hf_length",
    "angle": "atan2",
    "magnitude": "fabs",
}
_GUARDED = ("angle", "length")
"""Functions with a third argument that only their derivatives use."""


class CPrinter(C99CodePrinter):
    """C99 for every expression of a law, with the conventions of the compiled closed loop."""

    def __init__(self) -> None:
        super().__init__({"strict": True})

    def _print_Function(self, e: sp.Expr) -> str:  # noqa: N802
        name = type(e).__name__
        if name not in _CALLS:
            return str(super()._print_Function(e))
        arguments = e.args[:2] if name in _GUARDED else e.args
        return f"{_CALLS[name]}({', '.join(self._print(a) for a in arguments)})"

    def _print_nearest_on_walls(self, e: sp.Expr) -> str:
        return self._picked(2, e)

    def _print_nearest_to_sight(self, e: sp.Expr) -> str:
        return self._picked(4, e)

    def _picked(self, points: int, e: sp.Expr) -> str:
        """One of the results of a function of coordinates and of all walls."""
        texts = [self._print(arg) for arg in e.args[1:]]
        at, walls = ", ".join(texts[:points]), texts[points:]
        ends = f"(const double[]){{{', '.join(walls)}}}"
        return f"hf_{type(e).__name__}({int(e.args[0])}, {at}, {ends}, {len(walls) // 4})"

    def _print_sign(self, e: sp.Expr) -> str:
        return f"hf_sign({self._print(e.args[0])})"

    def _print_Integer(self, e: sp.Expr) -> str:  # noqa: N802
        return f"{int(e)}.0"

    def _number(self, e: sp.Expr) -> str:
        return repr(float(e))

    _print_Rational = _print_Float = _print_Half = _number  # noqa: N815
    _print_Pi = _print_Exp1 = _print_NumberSymbol = _number  # noqa: N815

    def _print_Pow(self, e: sp.Expr) -> str:  # noqa: N802
        base, exponent = e.as_base_exp()
        return power(
            f"({self._print(base)})", exponent, "sqrt", f"pow(%s, {self._print(exponent)})"
        )


_PRINTER = CPrinter()


def c_body(
    unpack: Mapping[str, Sequence[sp.Symbol]],
    results: Sequence[sp.Expr],
    into: str,
    indent: str = "    ",
) -> str:
    """Lines that unpack the used symbols, share subexpressions, and fill the array `into`."""
    used = symbols_of(results)
    lines = [
        f"{indent}const double {_name(s)} = {argument}[{i}];"
        for argument, symbols in unpack.items()
        for i, s in enumerate(symbols)
        if s in used
    ]
    renamed = {s: sp.Symbol(_name(s), real=True) for s in used}
    shared, reduced = sp.cse(
        exchanged(results, renamed),
        symbols=sp.numbered_symbols("c_", real=True),
        order="none",
    )
    try:
        lines += [f"{indent}const double {s} = {_PRINTER.doprint(e)};" for s, e in shared]
        lines += [f"{indent}{into}[{i}] = {_PRINTER.doprint(e)};" for i, e in enumerate(reduced)]
    except PrintMethodNotImplementedError as error:
        raise DefinitionError(f"an expression has no C99 form: {error}") from None
    return "\n".join(lines)


def _name(s: sp.Symbol) -> str:
    """The name in C, where names that begin with an underscore are reserved."""
    name = source_name(s)
    return f"hf{name}" if name.startswith("_") else name
