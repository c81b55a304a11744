"""The functions of control laws that C and SymPy lack, as steps: `maths/expressions/functions.py`.

And the nearest points of walls (`maths/formations/walls.py`): a wall is x0, y0, x1, y1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from holdfast.execution.arithmetic.steps import (
    FLOAT,
    Function,
    Operand,
    Value,
    ceil,
    choose,
    root,
)

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
