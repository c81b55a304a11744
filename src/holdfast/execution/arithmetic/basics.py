"""The functions of control laws that C and SymPy lack: `maths/expressions/functions.py`."""

from __future__ import annotations

from holdfast.execution.arithmetic.steps import Function, Value, ceil, choose, root

TWO_PI = 6.283185307179586
PI = 3.141592653589793


@Function
def wrap(x: Value) -> Value:
    """An angle [rad] in (-pi, pi]."""
    return x - TWO_PI * ceil((x - PI) / TWO_PI)


# NaN propagates through every choice: a comparison must not hide it


@Function
def least(a: Value, b: Value) -> Value:
    """The smaller of two; NaN if either is NaN."""
    return choose(a.differs(a), a, choose(a < b, a, b))


@Function
def greatest(a: Value, b: Value) -> Value:
    """The larger of two; NaN if either is NaN."""
    return choose(a.differs(a), a, choose(a > b, a, b))


@Function
def sgn(x: Value) -> Value:
    """+1 for x >= 0, else -1."""
    return choose(x >= 0.0, 1.0, choose(x < 0.0, -1.0, x))


@Function
def sign(x: Value) -> Value:
    """The sign with sign(0) = 0, the derivative of the magnitude."""
    return choose(x > 0.0, 1.0, choose(x < 0.0, -1.0, 0.0 * x))


@Function
def select(x: Value, a: Value, b: Value) -> Value:
    """a for x >= 0, else b."""
    return choose(x >= 0.0, a, choose(x < 0.0, b, x))


@Function
def length(x: Value, y: Value) -> Value:
    """sqrt(x^2 + y^2)."""
    return root(x * x + y * y)
