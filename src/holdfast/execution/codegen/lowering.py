"""Expressions of SymPy as steps of arithmetic, in one order for every target.

The nearest points of walls (`maths/formations/walls.py`) are steps for each wall in its turn; a
wall is x0, y0, x1, y1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.execution.arithmetic import elementary
from holdfast.execution.arithmetic.steps import (
    FLOAT,
    Function,
    Operand,
    Steps,
    Value,
    choose,
    greatest,
    least,
    length,
    root,
    select,
    sgn,
    sign,
    wrap,
)
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.maths.expressions.traversal import symbols_of

MOST_FACTORS = 8
"""Powers of larger whole numbers are computed by logarithms."""


def lowered(
    steps: Steps, expressions: Sequence[Any], inputs: Mapping[sp.Symbol, Value]
) -> list[Value]:
    """The values of the expressions, as steps that follow those of the inputs.

    Sums and products are taken from left to right in SymPy's printing order. A quotient is a
    product with the inverse, which all quotients with the same divisor share: a division takes as
    long as sixteen products, and derivatives divide by the same thing many times. Only a quotient
    of two symbols is divided, so that x/L is 1 where x is L; others may differ from it by a unit in
    the last place, and a divisor below 6e-309 gives an infinite inverse. Raises
    `DefinitionError` for a function without steps, and for a symbol that is not an input.
    """
    exact = [sp.sympify(e) for e in expressions]
    if unknown := symbols_of(exact) - set(inputs):
        raise DefinitionError(f"the expression uses '{min(map(str, unknown))}'")
    lowering = Lowering(steps, inputs)
    return [lowering.value(e) for e in exact]


def leaf_of(
    arrays: Mapping[str, Sequence[sp.Symbol]],
    results: Sequence[Any],
    uniform: Sequence[str] = (),
    steps: Steps | None = None,
) -> Leaf:
    """The leaf of these expressions; the symbols are the rows of its argument arrays.

    steps: those of other leaves, if values may be shared with them.
    """
    steps = steps or Steps(expanded=True)
    rows = {name: [f"{name}{i}" for i in range(len(symbols))] for name, symbols in arrays.items()}
    inputs = {
        symbol: steps.input(row)
        for name, symbols in arrays.items()
        for symbol, row in zip(symbols, rows[name], strict=True)
    }
    return Leaf(steps, rows, lowered(steps, results, inputs), frozenset(uniform))


def is_algebraic(expressions: Sequence[sp.Expr]) -> bool:
    """Whether the expressions are made of arithmetic, roots and comparisons alone."""
    parts = {part for e in expressions for part in sp.preorder_traversal(e)}
    powers = (p.exp for p in parts if isinstance(p, sp.Pow))
    functions = (p for p in parts if p.args and not p.is_Add and not p.is_Mul and not p.is_Pow)
    return all((2 * e).is_Integer and abs(e) <= MOST_FACTORS for e in powers) and all(
        type(p).__name__ in _ALGEBRAIC for p in functions
    )


class Lowering:
    """Values of expressions; a subclass has another arithmetic."""

    def __init__(self, steps: Steps, inputs: Mapping[sp.Symbol, Value]) -> None:
        self.steps = steps
        self.known: dict[sp.Basic, Value] = dict(inputs)

    def value(self, e: sp.Basic) -> Value:
        """The value of an expression, each part of which is lowered once."""
        if e not in self.known:
            self.known[e] = self._new(e)
        return self.known[e]

    def _new(self, e: sp.Basic) -> Value:
        if e.is_Number or e.is_NumberSymbol:
            return self._number(e)
        if e.is_Symbol:
            raise DefinitionError(f"the expression uses '{e}'")
        if isinstance(e, sp.Add):
            return self._sum(e)
        if isinstance(e, sp.Mul):
            return self._product(e)
        if isinstance(e, sp.Pow):
            return self._power(*e.as_base_exp())
        name = type(e).__name__
        if name in _PICKED:
            function = _PICKED[name]
            values = [self.value(a) for a in e.args[1:]]
            if self.steps.expanded:
                return function(*values)[int(e.args[0])]
            immediate = (name, function.points, int(e.args[0]))
            return self.steps.step(WALLS, *values, immediate=immediate, kind=FLOAT)
        arguments = e.args[:2] if name in _GUARDED else e.args
        return self._function(name, e)(*map(self.value, arguments))

    def _function(self, name: str, e: sp.Basic) -> Callable[..., Any]:
        if name not in _FUNCTIONS:
            raise DefinitionError(f"function '{name}' cannot be compiled: {e}")
        return _FUNCTIONS[name]

    def _number(self, e: sp.Basic) -> Any:
        return self.steps.constant(float(e), FLOAT)

    def _sum(self, e: sp.Add) -> Value:
        first, *rest = e.as_ordered_terms()
        total = self.value(first)
        for term in rest:
            if term.could_extract_minus_sign():
                total = total - self.value(-term)
            else:
                total = total + self.value(term)
        return total

    def _product(self, e: sp.Mul) -> Value:
        if len(e.args) == 2 and sum(a.is_Symbol for a in e.args) == 1:
            (inverse,) = (a for a in e.args if not a.is_Symbol)
            if isinstance(inverse, sp.Pow) and inverse.exp == -1 and inverse.base.is_Symbol:
                (above,) = (a for a in e.args if a.is_Symbol)
                return self.value(above) / self.value(inverse.base)
        factors: list[Value] = []
        minus = False
        for factor in e.as_ordered_factors():
            if factor == -1:
                minus = True
            elif factor.is_Number and factor < 0:
                minus = True
                factors.append(self._number(-factor))
            else:
                factors.append(self.value(factor))
        product = _in_turn(factors)
        return -product if minus else product

    def _power(self, base: sp.Expr, exponent: sp.Expr) -> Value:
        value, size = self.value(base), abs(exponent) if exponent.is_Number else exponent
        whole, half = divmod(2 * size, 2) if (2 * size).is_Integer else (None, None)
        if whole is None or whole > MOST_FACTORS:
            return _value(elementary.power(value, self.value(exponent)))
        if exponent >= 0:
            return _in_turn([value] * int(whole) + ([root(value)] if half else []))
        if half:  # the inverse of the root, for every odd number of halves
            return _in_turn([1.0 / root(value)] * int(2 * size))
        return _in_turn([1.0 / value] * int(whole))


def _in_turn(factors: Sequence[Value]) -> Value:
    product = factors[0]
    for factor in factors[1:]:
        product = product * factor
    return product


def _value(value: Any) -> Value:
    assert isinstance(value, Value)
    return value


Point = tuple[Value, Value]
INFINITE = float("inf")


@dataclass(frozen=True)
class OverWalls:
    """A function of the coordinates of points and of any number of walls, told one after another.

    one: of the coordinates, a wall, and what is known so far, of which the first is the least
    distance: the same with that wall. begin: what is known of no wall, from the coordinates.
    """

    name: str
    one: Function
    begin: Callable[..., tuple[Operand, ...]]
    points: int = 2

    def __call__(self, *values: Value) -> tuple[Value, ...]:
        at, ends = values[: self.points], values[self.points :]
        nearest: tuple[Value, ...] = self.first(*at)
        for k in range(0, len(ends), 4):
            nearest = self.one(*at, *ends[k : k + 4], *nearest)
        return nearest[1:]

    def first(self, *at: Value) -> tuple[Value, ...]:
        """What is known of no wall."""
        return tuple(at[0].steps.lifted(v, FLOAT) for v in self.begin(*at))


@Function
def nearer_on_walls(
    x: Value, y: Value, ax: Value, ay: Value, bx: Value, by: Value,
    least: Value, nx: Value, ny: Value,
) -> tuple[Value, ...]:  # fmt: skip
    """The point of this wall, if it is nearer to (x, y) than that of the walls before."""
    s, _ = foot(x, y, ax, ay, bx, by)
    at = (ax + s * (bx - ax), ay + s * (by - ay))
    squared = (x - at[0]) * (x - at[0]) + (y - at[1]) * (y - at[1])
    return _nearer((squared, *at), (least, nx, ny))


@Function
def nearer_face(
    x: Value, y: Value, ax: Value, ay: Value, bx: Value, by: Value,
    least: Value, kind: Value, side: Value, cx: Value, cy: Value, nx: Value, ny: Value,
) -> tuple[Value, ...]:  # fmt: skip
    """The corner or side of this wall, if it is nearer; and whether (x, y) is inside, so far."""
    dx, dy = bx - ax, by - ay
    s, squared = foot(x, y, ax, ay, bx, by)
    within = (s > 0.0) & (s < 1.0)
    last = s >= 1.0
    size = root(dx * dx + dy * dy)
    corner = choose(last, bx, ax), choose(last, by, ay)
    here = (squared, choose(within, 1.0, -1.0), *corner, dy / size, -dx / size)
    least, kind, *rest = _nearer(here, (least, kind, cx, cy, nx, ny))
    area = turn(ax, ay, bx, by, x, y)
    upwards = (ay <= y) & (by > y) & (area > 0.0)
    downwards = (by <= y) & (ay > y) & (area < 0.0)
    return (least, kind, choose(upwards | downwards, -side, side), *rest)


@Function
def nearer_to_sight(
    ax: Value, ay: Value, bx: Value, by: Value, px: Value, py: Value, qx: Value, qy: Value,
    least: Value, share: Value, x: Value, y: Value, side: Value,
) -> tuple[Value, ...]:  # fmt: skip
    """Where the line from a to b is nearest to this wall, if that is nearer than before."""
    zero, one, infinite = (ax.steps.constant(c, FLOAT) for c in (0.0, 1.0, INFINITE))
    turns = turn(ax, ay, bx, by, px, py), turn(ax, ay, bx, by, qx, qy)
    others = turn(px, py, qx, qy, ax, ay), turn(px, py, qx, qy, bx, by)
    crossed = (turns[0] * turns[1] < 0.0) & (others[0] * others[1] < 0.0)
    here = choose(crossed, -1.0, 1.0)
    at: tuple[Value, ...] = (infinite, zero, px, py)
    for end, ex, ey in ((zero, ax, ay), (one, bx, by)):  # from the ends of the line
        w, squared = foot(ex, ey, px, py, qx, qy)
        at = _nearer((squared, end, px + w * (qx - px), py + w * (qy - py)), at)
    for ex, ey in ((px, py), (qx, qy)):  # and from those of the wall
        s, squared = foot(ex, ey, ax, ay, bx, by)
        at = _nearer((squared, s, ex, ey), at)
    return _nearer((here * at[0], *at[1:], here), (least, share, x, y, side))


@Function
def wider_separation(
    ax: Value, ay: Value, bx: Value, by: Value, px: Value, py: Value, qx: Value, qy: Value,
    least: Value, end: Value, x: Value, y: Value, nx: Value, ny: Value,
    left: Value, lx: Value, ly: Value, right: Value, rx: Value, ry: Value,
) -> tuple[Value, ...]:  # fmt: skip
    """The side of this wall, if it separates better the line from a to b; the outermost corners."""
    dx, dy = qx - px, qy - py
    size = root(dx * dx + dy * dy)
    n = dy / size, -dx / size
    of_a = (ax - px) * n[0] + (ay - py) * n[1]
    of_b = (bx - px) * n[0] + (by - py) * n[1]
    nearer = of_b < of_a
    side = (-choose(nearer, of_b, of_a), choose(nearer, 1.0, 0.0), px, py, *n)
    turned = turn(ax, ay, bx, by, px, py)
    return (
        *_nearer(side, (least, end, x, y, nx, ny)),
        *_nearer((turned, px, py), (left, lx, ly)),
        *_nearer((-turned, px, py), (right, rx, ry)),
    )


@Function
def nearer_past(
    ax: Value, ay: Value, bx: Value, by: Value, px: Value, py: Value, qx: Value, qy: Value,
    first: Value, side: Value, left: Value, right: Value, corner: Value, end: Value,
) -> tuple[Value, ...]:  # fmt: skip
    """How far the line from a to b passes this wall, if that is nearer than before."""
    dx, dy = qx - px, qy - py
    size = root(dx * dx + dy * dy)
    of_a = ((ax - px) * dy - (ay - py) * dx) / size
    of_b = ((bx - px) * dy - (by - py) * dx) / size
    side = greatest(side, least(of_a, of_b))
    turned = turn(ax, ay, bx, by, px, py)
    _, from_line = foot(px, py, ax, ay, bx, by)
    _, from_end = foot(ax, ay, px, py, qx, qy)
    return (
        first, side, least(left, turned), least(right, -turned),
        least(corner, from_line), least(end, from_end),
    )  # fmt: skip


nearest_on_walls = OverWalls("nearest_on_walls", nearer_on_walls, lambda x, y: (INFINITE, x, y))
"""The point of the walls that is nearest to (x, y)."""

nearest_face = OverWalls(
    "nearest_face", nearer_face, lambda x, y: (INFINITE, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
)
"""(kind, side, x, y, nx, ny): the nearest corner or side of closed polygons.

kind: 1 inside a side, -1 at a corner; side: 1 outside all polygons, -1 inside one (or an odd
number); (x, y): the corner, or the beginning of the side; (nx, ny): the unit normal on the
right of the side. Polygons have no sides of length 0.
"""

nearest_to_sight = OverWalls(
    "nearest_to_sight", nearer_to_sight,
    lambda ax, ay, bx, by: (INFINITE, 0.0, ax, ay, 1.0), points=4,
)  # fmt: skip
"""(s, x, y, side): the line at a + s (b - a) is nearest to the wall at (x, y).

side is -1 if a wall crosses the line; the point is then that of the least displacement.
"""

separating_sides = OverWalls(
    "separating_sides", wider_separation,
    lambda ax, ay, bx, by: (
        INFINITE, 0.0, 0.0, 0.0, 0.0, 0.0, INFINITE, 0.0, 0.0, INFINITE, 0.0, 0.0,
    ), points=4,
)  # fmt: skip
"""(end, x, y, nx, ny, left, lx, ly, right, rx, ry): what separates the line from a to b from a
convex polygon, counterclockwise.

(x, y), (nx, ny): the beginning and the outward normal of the side from which the nearer end of the
line, 0 for a, 1 for b, is farthest; (lx, ly): the corner least to the left of the line, at twice
the area `left`; (rx, ry): least to its right, at `right`.
"""

passing = OverWalls(
    "passing", nearer_past,
    lambda ax, ay, bx, by: (0.0, -INFINITE, INFINITE, INFINITE, INFINITE, INFINITE), points=4,
)  # fmt: skip
"""(side, left, right, corner, end): how far the line from a to b passes a convex polygon,
counterclockwise.

side: the largest distance of both its ends from the outside of a side; left, right: twice the least
area to a corner, if all are on that side of the line; corner, end: the squares of the least
distances of a corner to the line, and of a to the polygon.
"""


def _nearer(here: tuple[Value, ...], before: tuple[Value, ...]) -> tuple[Value, ...]:
    """That of the lesser first value."""
    closer = here[0] < before[0]
    return tuple(choose(closer, new, old) for new, old in zip(here, before, strict=True))


@Function
def foot(x: Value, y: Value, ax: Value, ay: Value, bx: Value, by: Value) -> Point:
    """The share of the way from a to b that is nearest to (x, y), and the distance squared."""
    dx, dy = bx - ax, by - ay
    size = dx * dx + dy * dy
    s = choose(size > 0.0, ((x - ax) * dx + (y - ay) * dy) / size, 0.0)
    s = choose(s < 0.0, 0.0, s)
    s = choose(s > 1.0, 1.0, s)
    u, v = x - ax - s * dx, y - ay - s * dy
    return s, u * u + v * v


@Function
def turn(ax: Value, ay: Value, bx: Value, by: Value, x: Value, y: Value) -> Value:
    """Twice the area of the triangle, positive if it is counterclockwise."""
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax)


_GUARDED = ("angle", "length")
"""Functions with a third argument that only their derivatives use."""

WALLS = "walls"
"""The operation of a function of walls where it is called and not expanded."""

_ALGEBRAIC = frozenset(
    ("Abs", "magnitude", "Min", "Max", "sgn", "sign", "select", "least", "greatest", "length")
)

_PICKED = {
    function.name: function
    for function in (nearest_on_walls, nearest_to_sight, nearest_face, separating_sides, passing)
}
"""Functions of some coordinates and of walls, of whose results the first argument picks one."""

FUNCTIONS: tuple[Function | OverWalls, ...] = (
    wrap, least, greatest, sgn, sign, select,
    length, elementary.sine_and_cosine, elementary.tangent, elementary.arctangent,
    elementary.arcsine, elementary.arccosine, elementary.angle_of,
    elementary.REDUCED_BY_DIGITS, elementary.exponential, elementary.logarithm,
    elementary.power, elementary.hyperbolic_sine, elementary.hyperbolic_cosine,
    elementary.hyperbolic_tangent, foot, turn,
    *(f.one for f in _PICKED.values()), *_PICKED.values(),
)  # fmt: skip
"""All functions that steps may call."""

_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": lambda x: elementary.sine_and_cosine(x)[0],
    "cos": lambda x: elementary.sine_and_cosine(x)[1],
    "tan": elementary.tangent,
    "asin": elementary.arcsine,
    "acos": elementary.arccosine,
    "atan": elementary.arctangent,
    "atan2": elementary.angle_of,
    "angle": elementary.angle_of,
    "exp": elementary.exponential,
    "log": elementary.logarithm,
    "sinh": elementary.hyperbolic_sine,
    "cosh": elementary.hyperbolic_cosine,
    "tanh": elementary.hyperbolic_tangent,
    "Abs": abs,
    "magnitude": abs,
    "Min": lambda *a: _folded(least, a),
    "Max": lambda *a: _folded(greatest, a),
    "sgn": sgn,
    "sign": sign,
    "wrap": wrap,
    "select": select,
    "least": least,
    "greatest": greatest,
    "length": length,
}


def _folded(function: Callable[..., Any], values: Sequence[Value]) -> Value:
    folded = values[0]
    for value in values[1:]:
        folded = _value(function(folded, value))
    return folded
