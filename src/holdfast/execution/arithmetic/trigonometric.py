"""Sine, cosine, tangent and their inverses, by steps of IEEE 754.

The polynomials are those of fdlibm (Sun Microsystems, 1993). An argument is brought to
[-pi/4, pi/4] by three parts of pi/2 (W. J. Cody, W. Waite, 1980), a large one by the binary digits
of 2/pi (M. Payne, R. Hanek, SIGNUM Newsletter 18, 1983). The tangent and the inverse functions
carry the rounding errors of quotients and roots along.
"""

from __future__ import annotations

from holdfast.execution.arithmetic.steps import (
    SIGN,
    Function,
    Pair,
    Value,
    bits,
    choose,
    entry,
    exact_product,
    exact_sum,
    from_bits,
    ordered_sum,
    rint,
    root,
)

MEDIUM = 823549.0
"""Quarter turns times pi/2 with products that are exact: 2^19 of them."""

TURNS = 0.6366197723675814  # 2/pi
QUARTER = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624871116645580e-21)
QUARTER_REST = 8.47842766036889956997e-32
"""pi/2 in three parts of 33 bits, and the rest."""

EIGHTH = 0.7853981633974483  # pi/4
HALF_PI = (1.5707963267948966, 6.123233995736766e-17)
PI = (3.141592653589793, 1.2246467991473532e-16)

WORDS = 39
ROUNDER = 6755399441055744.0  # 1.5 * 2^52: the last bits of the sum are those of a whole number

SINE = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
    2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
COSINE = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
    -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip
ARCTANGENT = (
    3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01,
    -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02,
    6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02,
    -3.65315727442169155270e-02, 1.62858201153657823623e-02,
)  # fmt: skip
ARCTANGENT_OF_HALF = (4.63647609000806093515e-01, 2.26987774529616870924e-17)


def _digits() -> tuple[int, ...]:
    """2/pi in words of 32 bits, after two words of zeros."""
    count = 32 * (WORDS - 2)
    guard = 64
    one = 1 << (count + guard)

    def arctangent_of_inverse(n: int) -> int:
        total, term, k = 0, one // n, 1
        while term:
            total += term // k if k % 4 == 1 else -(term // k)
            term //= n * n
            k += 2
        return total

    pi = 4 * (4 * arctangent_of_inverse(5) - arctangent_of_inverse(239))  # J. Machin, 1706
    ratio = (2 * one * one // pi) >> guard
    words = [(ratio >> (count - 32 * (i + 1))) & 0xFFFFFFFF for i in range(WORDS - 2)]
    return (0, 0, *words)


DIGITS = _digits()
LOW = 0xFFFFFFFF


def _float_of(word: Value) -> Value:
    """A whole number below 2^52 as a float."""
    return from_bits(word | 0x4330000000000000) - 4503599627370496.0


def reduced_by_digits(x: Value) -> tuple[Value, Value, Value]:
    """`reduced` of an argument beyond MEDIUM: the digits of 2/pi that matter, times its own.

    For others the result has no meaning, but the digits are looked up within their table.
    """
    pattern = bits(x)
    exponent = (pattern >> 52) & 0x7FF
    mantissa = (pattern & 0xFFFFFFFFFFFFF) | 0x10000000000000
    finite = abs(x) < float("inf")
    place = (
        choose(finite & (abs(x) >= MEDIUM), exponent, pattern.steps.constant(1100, "whole")) - 1013
    )
    first, shift = place >> 5, place & 31
    words = [entry(DIGITS, first + i) for i in range(7)]
    aligned = [
        (((words[i] << 32) | words[i + 1]) >> (32 - shift)) & LOW for i in range(6)
    ]  # most significant first
    low, high = mantissa & LOW, mantissa >> 32
    zero = pattern.steps.constant(0, "whole")
    product, carry = [], zero
    for word in reversed(aligned):
        total = low * word + carry
        product.append(total & LOW)
        carry = total >> 32
    carry = zero
    for i, word in enumerate(reversed(aligned[1:]), start=1):
        total = product[i] + high * word + carry
        product[i] = total & LOW
        carry = total >> 32
    top = product[5]
    upper = (top >> 29) & 1  # the fraction is a half or more: one quarter turn less it
    flip = zero - upper
    parts = [(top ^ flip) & 0x3FFFFFFF] + [(p ^ flip) & LOW for p in product[4:0:-1]]
    total, rest = _float_of(parts[0]) * 2.0**-30, x.steps.constant(0.0, "float")
    for i, part in enumerate(parts[1:], start=1):
        total, error = exact_sum(total, _float_of(part) * 2.0 ** (-30 - 32 * i))
        rest = rest + error
    p, e = exact_product(total, x.steps.constant(HALF_PI[0], "float"))
    y, z = ordered_sum(p, e + (total * HALF_PI[1] + rest * HALF_PI[0]))
    sign = (pattern & SIGN) ^ (upper << 63)
    quarter = (top >> 30) + upper
    quarter = choose((pattern >> 63).equals(1), zero - quarter, quarter) & 3
    nan = x - x
    return (
        choose(finite, from_bits(bits(y) ^ sign), nan),
        choose(finite, from_bits(bits(z) ^ sign), nan),
        quarter,
    )


REDUCED_BY_DIGITS = Function(reduced_by_digits)


def reduced(x: Value) -> tuple[Value, Value, Value]:
    """(y, z, n): x = n pi/2 + y + z with |y| <= pi/4 and n modulo 4, a whole number."""
    turns = rint(x * TURNS)
    y, first = exact_sum(x - turns * QUARTER[0], -(turns * QUARTER[1]))
    y, second = exact_sum(y, -(turns * QUARTER[2]))
    high, low = ordered_sum(y, (first + second) - turns * QUARTER_REST)
    small = abs(x) <= EIGHTH
    high = choose(small, x, high)
    low = choose(small, 0.0, low)
    quarter = bits(turns + ROUNDER) & 3
    large = ~(abs(x) < MEDIUM)
    y, z, n = x.steps.rare(large, (high, low, quarter), REDUCED_BY_DIGITS, x)
    return y, z, n


def _sine(y: Value, z: Value) -> Pair:
    """(a, b): the sine of y + z is a - b."""
    s = y * y
    v = s * y
    r = SINE[1] + s * (SINE[2] + s * (SINE[3] + s * (SINE[4] + s * SINE[5])))
    return y, (s * (0.5 * z - v * r) - z) - v * SINE[0]


def _cosine(y: Value, z: Value) -> Pair:
    """(a, b): the cosine of y + z is a + b."""
    s = y * y
    w = s * s
    r = s * (COSINE[0] + s * (COSINE[1] + s * COSINE[2]))
    r = r + w * w * (COSINE[3] + s * (COSINE[4] + s * COSINE[5]))
    half = 0.5 * s
    a = 1.0 - half
    return a, ((1.0 - a) - half) + (s * r - y * z)


@Function
def sine_and_cosine(x: Value) -> Pair:
    """The sine and the cosine of x [rad]."""
    y, z, n = reduced(x)
    a, b = _sine(y, z)
    s = a - b
    a, b = _cosine(y, z)
    c = a + b
    odd = (n & 1).equals(1)
    sine, cosine = choose(odd, c, s), choose(odd, s, c)
    return (
        from_bits(bits(sine) ^ ((n & 2) << 62)),
        from_bits(bits(cosine) ^ (((n + 1) & 2) << 62)),
    )


@Function
def tangent(x: Value) -> Value:
    """The tangent of x [rad]: the quotient of sine and cosine with their errors."""
    y, z, n = reduced(x)
    a, b = _sine(y, z)
    s, s_rest = ordered_sum(a, -b)
    a, b = _cosine(y, z)
    c, c_rest = ordered_sum(a, b)
    odd = (n & 1).equals(1)
    top, top_rest = choose(odd, -c, s), choose(odd, -c_rest, s_rest)
    below, below_rest = choose(odd, s, c), choose(odd, s_rest, c_rest)
    q = top / below
    p, e = exact_product(q, below)
    more = (((top - p) - e) + (top_rest - q * below_rest)) / below
    return choose(abs(x) < 2.0**-500, x, q + more)


def _angle(y: Value, y_rest: Value, x: Value, x_rest: Value) -> Value:
    """atan2(y + y_rest, x + x_rest), with rests of less than an ulp."""
    steep = abs(y) > abs(x)
    down, down_rest = choose(steep, x, y), choose(steep, x_rest, y_rest)
    over, over_rest = choose(steep, y, x), choose(steep, y_rest, x_rest)
    down_rest = from_bits(bits(down_rest) ^ (bits(down) & SIGN))
    over_rest = from_bits(bits(over_rest) ^ (bits(over) & SIGN))
    n, d = abs(down), abs(over)
    infinite = d.equals(float("inf"))
    n = choose(infinite, choose(n.equals(float("inf")), 1.0, 0.0), n)
    d = choose(infinite | d.equals(0.0), 1.0, d)
    scale = choose(d > 2.0**900, 2.0**-200, choose(d < 2.0**-900, 2.0**200, 1.0))
    n, d, down_rest, over_rest = n * scale, d * scale, down_rest * scale, over_rest * scale
    # the angle of a place that is nearest: 0, atan(1/2) or pi/4
    some, much = n > 0.4375 * d, n > 0.6875 * d
    c = choose(much, 1.0, choose(some, 0.5, 0.0))
    near = choose(much, EIGHTH, choose(some, ARCTANGENT_OF_HALF[0], 0.0))
    near_rest = choose(much, 0.5 * HALF_PI[1], choose(some, ARCTANGENT_OF_HALF[1], 0.0))
    top = n - c * d
    below, below_rest = ordered_sum(d, c * n)
    w = top / below
    p, e = exact_product(w, below)
    rests = (down_rest - c * over_rest) - w * (below_rest + (over_rest + c * down_rest))
    rest = (((top - p) - e) + rests) / below
    rest = choose(n > 2.0**-800, rest, 0.0)
    z = w * w
    u = z * z
    a = ARCTANGENT
    even = z * (a[0] + u * (a[2] + u * (a[4] + u * (a[6] + u * (a[8] + u * a[10])))))
    odd = u * (a[1] + u * (a[3] + u * (a[5] + u * (a[7] + u * a[9]))))
    behind = bits(x) & SIGN
    turned = choose(steep, behind ^ SIGN, behind)  # whether the angle is taken off
    back = behind.equals(SIGN)
    base = choose(steep, HALF_PI[0], choose(back, PI[0], 0.0))
    base_rest = choose(steep, HALF_PI[1], choose(back, PI[1], 0.0))

    def signed(v: Value) -> Value:
        return from_bits(bits(v) ^ turned)

    total, first = exact_sum(base, signed(near))
    total, second = exact_sum(total, signed(w))
    less = near_rest + ((rest - rest * z) - w * (even + odd))
    found = total + (first + second + (base_rest + signed(less)))
    found = from_bits(bits(abs(found)) | (bits(y) & SIGN))
    return choose(x.differs(x) | y.differs(y), x + y, found)


@Function
def angle_of(y: Value, x: Value) -> Value:
    """atan2(y, x) [rad]."""
    none = y.steps.constant(0.0, "float")
    return _angle(y, none, x, none)


@Function
def arctangent(x: Value) -> Value:
    """The inverse of the tangent [rad]."""
    none, one = (x.steps.constant(c, "float") for c in (0.0, 1.0))
    return _angle(x, none, one, none)


def _other_side(x: Value) -> Pair:
    """sqrt(1 - x^2) and its rest; NaN for |x| > 1."""
    one = x.steps.constant(1.0, "float")
    p, e = exact_product(x, x)
    d, d_rest = ordered_sum(one, -p)
    d, d_rest = ordered_sum(d, d_rest - e)
    s = root(d)
    p, e = exact_product(s, s)
    rest = ((d - p) - e + d_rest) / (2.0 * s)
    return s, choose(s > 0.0, rest, 0.0)


@Function
def arcsine(x: Value) -> Value:
    """The inverse of the sine [rad]; NaN for |x| > 1."""
    s, rest = _other_side(x)
    return _angle(x, x.steps.constant(0.0, "float"), s, rest)


@Function
def arccosine(x: Value) -> Value:
    """The inverse of the cosine [rad]; NaN for |x| > 1."""
    s, rest = _other_side(x)
    return _angle(s, rest, x, x.steps.constant(0.0, "float"))
