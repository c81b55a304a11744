"""The functions of control laws that C and SymPy lack, as steps: `maths/expressions/functions.py`.

And the nearest points of walls (`maths/formations/walls.py`): a wall is x0, y0, x1, y1.
"""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.execution.arithmetic.steps import FLOAT, Function, Value, ceil, choose, root

Point = tuple[Value, Value]


def nearest_on_walls(x: Value, y: Value, *ends: Value) -> tuple[Value, ...]:
    """The point of the walls that is nearest to (x, y)."""
    nearest, least = (x, y), x.steps.constant(float("inf"), FLOAT)
    for ax, ay, bx, by in _walls(ends):
        s, _ = _foot(x, y, ax, ay, bx, by)
        at = (ax + s * (bx - ax), ay + s * (by - ay))
        squared = (x - at[0]) * (x - at[0]) + (y - at[1]) * (y - at[1])
        nearer = squared < least
        nearest = (choose(nearer, at[0], nearest[0]), choose(nearer, at[1], nearest[1]))
        least = choose(nearer, squared, least)
    return nearest


def nearest_face(x: Value, y: Value, *ends: Value) -> tuple[Value, ...]:
    """(kind, side, x, y, nx, ny): the nearest corner or side of closed polygons.

    kind: 1 inside a side, -1 at a corner; side: 1 outside all polygons, -1 inside one (or an odd
    number); (x, y): the corner, or the beginning of the side; (nx, ny): the unit normal on the
    right of the side. Polygons have no sides of length 0.
    """
    zero, one = (x.steps.constant(c, FLOAT) for c in (0.0, 1.0))
    least, side = x.steps.constant(float("inf"), FLOAT), one
    face: tuple[Value, ...] = (one, zero, zero, zero, zero)
    for ax, ay, bx, by in _walls(ends):
        dx, dy = bx - ax, by - ay
        s, squared = _foot(x, y, ax, ay, bx, by)
        within = (s > 0.0) & (s < 1.0)
        last = s >= 1.0
        size = root(dx * dx + dy * dy)
        corner = choose(last, bx, ax), choose(last, by, ay)
        nearer = squared < least
        here = (choose(within, 1.0, -1.0), *corner, dy / size, -dx / size)
        face = tuple(choose(nearer, new, old) for new, old in zip(here, face, strict=True))
        least = choose(nearer, squared, least)
        turn = _turn(ax, ay, bx, by, x, y)
        upwards = (ay <= y) & (by > y) & (turn > 0.0)
        downwards = (by <= y) & (ay > y) & (turn < 0.0)
        side = choose(upwards | downwards, -side, side)
    kind, *rest = face
    return (kind, side, *rest)


def nearest_to_sight(ax: Value, ay: Value, bx: Value, by: Value, *ends: Value) -> tuple[Value, ...]:
    """(s, x, y, side): the line at a + s (b - a) is nearest to the wall at (x, y).

    side is -1 if a wall crosses the line; the point is then that of the least displacement.
    """
    zero, one = (ax.steps.constant(c, FLOAT) for c in (0.0, 1.0))
    infinite = ax.steps.constant(float("inf"), FLOAT)
    nearest: tuple[Value, ...] = (zero, ax, ay, one)
    least = infinite
    for px, py, qx, qy in _walls(ends):
        turns = _turn(ax, ay, bx, by, px, py), _turn(ax, ay, bx, by, qx, qy)
        others = _turn(px, py, qx, qy, ax, ay), _turn(px, py, qx, qy, bx, by)
        crossed = (turns[0] * turns[1] < 0.0) & (others[0] * others[1] < 0.0)
        side = choose(crossed, -1.0, 1.0)
        at: tuple[Value, ...] = (zero, px, py)
        shortest = infinite
        for end, x, y in ((zero, ax, ay), (one, bx, by)):  # from the ends of the line
            w, squared = _foot(x, y, px, py, qx, qy)
            place = (end, px + w * (qx - px), py + w * (qy - py))
            at, shortest = _nearer(place, squared, at, shortest)
        for x, y in ((px, py), (qx, qy)):  # and from those of the wall
            s, squared = _foot(x, y, ax, ay, bx, by)
            at, shortest = _nearer((s, x, y), squared, at, shortest)
        nearer = side * shortest < least
        nearest = tuple(
            choose(nearer, new, old) for new, old in zip((*at, side), nearest, strict=True)
        )
        least = choose(nearer, side * shortest, least)
    return nearest


def _walls(ends: Sequence[Value]) -> list[Sequence[Value]]:
    return [ends[k : k + 4] for k in range(0, len(ends), 4)]


def _nearer(
    place: tuple[Value, ...], squared: Value, at: tuple[Value, ...], shortest: Value
) -> tuple[tuple[Value, ...], Value]:
    closer = squared < shortest
    chosen = tuple(choose(closer, new, old) for new, old in zip(place, at, strict=True))
    return chosen, choose(closer, squared, shortest)


def _foot(x: Value, y: Value, ax: Value, ay: Value, bx: Value, by: Value) -> Point:
    """The share of the way from a to b that is nearest to (x, y), and the distance squared."""
    dx, dy = bx - ax, by - ay
    size = dx * dx + dy * dy
    s = choose(size > 0.0, ((x - ax) * dx + (y - ay) * dy) / size, 0.0)
    s = choose(s < 0.0, 0.0, s)
    s = choose(s > 1.0, 1.0, s)
    u, v = x - ax - s * dx, y - ay - s * dy
    return s, u * u + v * v


def _turn(ax: Value, ay: Value, bx: Value, by: Value, x: Value, y: Value) -> Value:
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
