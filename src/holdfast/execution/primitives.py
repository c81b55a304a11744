"""Primitives of compiled code: branches, angles, sines, random numbers, thread counters.

Generated modules import all of them (`compile.py`). Functions called from Python are `compiled`.
Functions called from compiled code are `inlined` and have no entry from Python: such entries, which
unpack Python's objects around a copy of the function, were a quarter of the compilation.
"""

# mypy: ignore-errors

import math

import numpy as np
from llvmlite import ir  # noqa: F401
from numba import carray, njit, types  # noqa: F401
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from holdfast.execution.cache import kept

OPTIONS = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}


def compiled(function):
    """Machine code that Python may call."""
    return kept(njit(**OPTIONS)(function))


class Inlined(CPUDispatcher):
    """Machine code for compiled code; a call from Python runs the same text in Python."""

    def __call__(self, *arguments):
        return self.py_func(*arguments)


def within(**options):
    """A decorator of functions that only compiled code calls."""

    def decorate(function):
        dispatcher = kept(njit(**OPTIONS, no_cpython_wrapper=True, **options)(function))
        dispatcher.__class__ = Inlined
        return dispatcher

    return decorate


inlined = within(forceinline=True)
apart = within()  # a separate call

TWO_PI = 2.0 * math.pi
WIDTH = 16  # runs that advance together, the lanes of a block
MOST_SLICES = 1 << 20  # the turns of a stage; the next stage has the next so many


# -- helpers that the printer uses ------------------------------------------------------


@inlined
def wrap(x):
    """x in (-pi, pi]."""
    return x - TWO_PI * math.ceil((x - math.pi) / TWO_PI)


# NaN propagates through every branch: a comparison must not hide it


@inlined
def least(a, b):
    """The smaller of two; NaN if either is NaN."""
    if a != a:
        return a
    return a if a < b else b


@inlined
def greatest(a, b):
    """The larger of two; NaN if either is NaN."""
    if a != a:
        return a
    return a if a > b else b


@inlined
def sgn(x):
    """+1 for x >= 0, else -1."""
    return 1.0 if x >= 0.0 else (-1.0 if x < 0.0 else x)


@inlined
def select(x, a, b):
    """a for x >= 0, else b."""
    return a if x >= 0.0 else (b if x < 0.0 else x)


@inlined
def length(x, y):
    """sqrt(x^2 + y^2)."""
    return math.sqrt(x * x + y * y)


@inlined
def sign(x):
    """The sign with sign(0) = 0, the derivative of the magnitude."""
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0 * x)


@apart
def nearest_on_walls(x, y, ends):
    """The point of the segments x0, y0, x1, y1, ... that is nearest to (x, y)."""
    found = (x, y)
    least_squared = np.inf
    for k in range(0, len(ends), 4):
        s, _ = _foot(x, y, ends[k], ends[k + 1], ends[k + 2], ends[k + 3])
        wx = ends[k] + s * (ends[k + 2] - ends[k])
        wy = ends[k + 1] + s * (ends[k + 3] - ends[k + 1])
        squared = (x - wx) ** 2 + (y - wy) ** 2
        if squared < least_squared:
            least_squared, found = squared, (wx, wy)
    return found


@apart
def nearest_to_sight(ax, ay, bx, by, ends):
    """(s, x, y, side): the line at a + s (b - a) is nearest to the wall at (x, y).

    side is -1 if a wall crosses the line; the point is then that of the least displacement.
    """
    found = (0.0, ax, ay, 1.0)
    smallest = np.inf
    for k in range(0, len(ends), 4):
        px, py, qx, qy = ends[k], ends[k + 1], ends[k + 2], ends[k + 3]
        one, other = _turn(ax, ay, bx, by, px, py), _turn(ax, ay, bx, by, qx, qy)
        first, second = _turn(px, py, qx, qy, ax, ay), _turn(px, py, qx, qy, bx, by)
        side = -1.0 if one * other < 0.0 and first * second < 0.0 else 1.0
        shortest, at = np.inf, (0.0, px, py)
        for s, x, y in ((0.0, ax, ay), (1.0, bx, by)):  # from the ends of the line
            w, squared = _foot(x, y, px, py, qx, qy)
            if squared < shortest:
                shortest, at = squared, (s, px + w * (qx - px), py + w * (qy - py))
        for x, y in ((px, py), (qx, qy)):  # and from those of the wall
            s, squared = _foot(x, y, ax, ay, bx, by)
            if squared < shortest:
                shortest, at = squared, (s, x, y)
        if side * shortest < smallest:
            smallest, found = side * shortest, (at[0], at[1], at[2], side)
    return found


@inlined
def _foot(x, y, ax, ay, bx, by):
    """The share of the way from a to b that is nearest to (x, y), and the distance squared."""
    dx, dy = bx - ax, by - ay
    size = dx * dx + dy * dy
    s = ((x - ax) * dx + (y - ay) * dy) / size if size > 0.0 else 0.0
    s = min(max(s, 0.0), 1.0)
    return s, (x - ax - s * dx) ** 2 + (y - ay - s * dy) ** 2


@inlined
def _turn(ax, ay, bx, by, x, y):
    """Twice the area of the triangle, positive if it is counterclockwise."""
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax)


@inlined
def sine_and_cosine(x):
    """Sine and cosine together, in half the time of two library calls; error below 3e-16.

    The argument is brought to [-pi/4, pi/4] by subtracting a multiple of pi/2 in three parts
    (Cody and Waite); the polynomials are those of S. Moshier's Cephes library. Beyond 1e5
    quarter turns, and for NaN and infinity, the library functions are used.
    """
    turns = np.rint(x * 0.6366197723675814)
    if not abs(turns) < 1e5:
        return math.sin(x), math.cos(x)
    y = x - turns * 1.5707963267341256
    y = y - turns * 6.077100506303966e-11
    y = y - turns * 2.0222662487959506e-21
    z = y * y
    s = 1.58962301576546568060e-10
    s = s * z - 2.50507477628578072866e-8
    s = s * z + 2.75573136213857245213e-6
    s = s * z - 1.98412698295895385996e-4
    s = s * z + 8.33333333332211858878e-3
    s = s * z - 1.66666666666666307295e-1
    s = y + y * z * s
    c = -1.13585365213876817300e-11
    c = c * z + 2.08757008419747316778e-9
    c = c * z - 2.75573141792967388112e-7
    c = c * z + 2.48015872888517045348e-5
    c = c * z - 1.38888888888730564116e-3
    c = c * z + 4.16666666666665929218e-2
    c = 1.0 - 0.5 * z + z * z * c
    quarter = int(turns) & 3
    if quarter == 0:
        return s, c
    if quarter == 1:
        return c, -s
    if quarter == 2:
        return -s, -c
    return -c, s


# -- counter-based random numbers -------------------------------------------------------


@inlined
def philox(c0, c1, c2, c3, k0, k1):
    """Philox4x32-10 (J. Salmon et al., SC'11): four 32-bit words from a counter and a key."""
    mask = np.uint64(0xFFFFFFFF)
    half = np.uint64(32)
    x0, x1, x2, x3 = np.uint64(c0), np.uint64(c1), np.uint64(c2), np.uint64(c3)
    a, b = np.uint64(k0), np.uint64(k1)
    for _ in range(10):
        first = np.uint64(0xD2511F53) * x0
        second = np.uint64(0xCD9E8D57) * x2
        x0, x1, x2, x3 = (
            (second >> half) ^ x1 ^ a,
            second & mask,
            (first >> half) ^ x3 ^ b,
            first & mask,
        )
        a = (a + np.uint64(0x9E3779B9)) & mask
        b = (b + np.uint64(0xBB67AE85)) & mask
    return x0, x1, x2, x3


@inlined
def two_uniforms(seed, run, step, channel, stream):
    """Two numbers in (0, 1) that depend on these five integers only."""
    w = philox(
        step & 0xFFFFFFFF,
        run & 0xFFFFFFFF,
        channel,
        stream,
        seed & 0xFFFFFFFF,
        (seed >> 32) & 0xFFFFFFFF,
    )
    scale = 1.0 / 9007199254740992.0
    first = ((w[0] >> np.uint64(5)) * 67108864.0 + (w[1] >> np.uint64(6)) + 0.5) * scale
    second = ((w[2] >> np.uint64(5)) * 67108864.0 + (w[3] >> np.uint64(6)) + 0.5) * scale
    return first, second


# -- shared between threads --------------------------------------------------------------


@intrinsic
def take(typing_context, counter):
    """Atomically returns counter[0] and increments it: no two threads get the same value."""

    def generate(context, builder, signature, arguments):
        (array,) = arguments
        where = make_array(signature.args[0])(context, builder, array).data
        return builder.atomic_rmw("add", where, context.get_constant(types.int64, 1), "monotonic")

    return types.int64(counter), generate


@intrinsic
def look(typing_context, counter):
    """The present counter[0], by an atomic read."""

    def generate(context, builder, signature, arguments):
        (array,) = arguments
        where = make_array(signature.args[0])(context, builder, array).data
        return builder.load_atomic(where, "acquire", 8)

    return types.int64(counter), generate


@compiled
def watch(own, other, value, times):
    """Counts its own start; returns whether the other reaches the value within so many reads."""
    take(own)
    for _ in range(times):  # noqa: SIM110
        if look(other) >= value:
            return True
    return False
