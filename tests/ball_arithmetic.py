"""Values of expressions in ball arithmetic of many digits, by another library, and random boxes."""

import math

import flint
import numpy as np
import sympy as sp
from flint import arb

from holdfast.maths.expressions import functions as own

X, Y = sp.symbols("x y", real=True)

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


OPERATIONS = {
    "sum": X + Y,
    "difference": X - Y,
    "product": X * Y,
    "quotient": X / Y,
    "square": X**2,
    "cube": X**3,
    "inverse square": X**-2,
    "root": sp.sqrt(X),
    "root of a cube": X ** sp.Rational(3, 2),
    "real power": X ** sp.Float(1.7),
    "numbers that are no floats": sp.pi * X + Y / 3 + sp.Float(0.1),
    "sine": sp.sin(X),
    "cosine": sp.cos(X),
    "tangent": sp.tan(X),
    "arctangent": sp.atan(X),
    "angle": own.angle(Y, X, 0),
    "exponential": sp.exp(X),
    "logarithm": sp.log(X),
    "hyperbolic tangent": sp.tanh(X),
    "absolute value": sp.Abs(X),
    "length": own.length(X, Y, 0),
    "least": own.least(X, Y),
    "greatest": own.greatest(X, Y),
    "sgn": own.sgn(X),
    "sign": sp.sign(X),
    "select": own.select(X, X + Y, 3 * Y),
    "wrap": own.wrap(X),
}


def boxes(generator, count):
    """Of sizes and widths of many orders; some are a point, some have zero inside or as an end."""
    sizes = 10 ** generator.uniform(-6, 2, (count, 2)) * generator.choice([-1, 1], (count, 2))
    widths = np.abs(sizes) * 10 ** generator.uniform(-9, 0.7, (count, 2))
    low = sizes - widths * generator.choice([0, 0.5, 1], (count, 2))
    special = generator.choice([0.0, math.pi / 2, -math.pi / 2, math.pi, 1.0], (count, 2))
    low = np.where(generator.random((count, 2)) < 0.1, special, low)
    return low, low + np.where(generator.random((count, 2)) < 0.1, 0.0, widths)
