"""Light simplification of sines, cosines and tangents, in bounded time."""

from __future__ import annotations

import sympy as sp


def plain(expression: sp.Expr) -> sp.Expr:
    """Light simplification in bounded time: sin / cos to tan, tan^2 + 1 to 1 / cos^2."""
    swaps: dict[sp.Expr, sp.Expr] = {}
    for a in {f.args[0] for f in expression.atoms(sp.tan)}:
        swaps |= {sp.tan(a) ** 2 + 1: sp.cos(a) ** -2, -(sp.tan(a) ** 2) - 1: -(sp.cos(a) ** -2)}
    return sp.powsimp(expression.xreplace(swaps).replace(sp.Mul, _tangents))


def _tangents(*factors: sp.Expr) -> sp.Expr:
    product = sp.Mul(*factors)
    powers = product.as_powers_dict()
    for base in [b for b in powers if isinstance(b, sp.sin)]:
        inner, up = base.args[0], powers[base]
        down = sp.sympify(powers.get(sp.cos(inner), 0))
        if up == 1 and down.is_number and down < 0:
            product = product / sp.sin(inner) * sp.cos(inner) * sp.tan(inner)
    return product
