"""Values of expressions in ball arithmetic of many digits, by another library."""

import flint
import sympy as sp
from flint import arb

DIGITS = 60
"""Of the balls; their radius is negligible beside that of a float."""

FUNCTIONS = {
    "sin": arb.sin, "cos": arb.cos, "tan": arb.tan, "atan": arb.atan, "exp": arb.exp,
    "log": arb.log, "tanh": arb.tanh, "Abs": abs, "magnitude": abs,
    "atan2": lambda y, x: arb.atan2(y, x), "angle": lambda y, x: arb.atan2(y, x),
    "length": lambda x, y: (x * x + y * y).sqrt(),
    "least": lambda a, b: a.min(b), "greatest": lambda a, b: a.max(b),
    "Min": lambda a, *more: a if not more else FUNCTIONS["Min"](a.min(more[0]), *more[1:]),
    "Max": lambda a, *more: a if not more else FUNCTIONS["Max"](a.max(more[0]), *more[1:]),
    "sgn": lambda x: arb(1) if x >= 0 else arb(-1),
    "sign": lambda x: arb(1) if x > 0 else arb(-1) if x < 0 else arb(0),
    "select": lambda x, a, b: a if x >= 0 else b,
    "wrap": lambda x: x - 2 * arb.pi() * ((x / (2 * arb.pi())) - arb(1) / 2).ceil(),
}  # fmt: skip


def ball(e, at):
    """The value of an expression; `at`: symbol -> float."""
    flint.ctx.dps = DIGITS
    if e.is_Symbol:
        return arb(at[e])
    if e is sp.pi:
        return arb.pi()
    if e.is_Rational:
        return arb(int(e.p)) / int(e.q)
    if e.is_Float:
        return arb(float(e))
    parts = [ball(a, at) for a in e.args[: 2 if type(e).__name__ in ("angle", "length") else None]]
    if e.is_Add:
        return sum(parts[1:], parts[0])
    if e.is_Mul:
        found = parts[0]
        for part in parts[1:]:
            found = found * part
        return found
    if e.is_Pow:
        if e.exp.is_Integer:
            return parts[0] ** int(e.exp)
        return parts[0].sqrt() ** int(2 * e.exp) if (2 * e.exp).is_Integer else parts[0] ** parts[1]
    return FUNCTIONS[type(e).__name__](*parts)
