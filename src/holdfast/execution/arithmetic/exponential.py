"""Exponential, logarithm, powers and hyperbolic functions, by steps of IEEE 754.

Exponential, logarithm and power are those of fdlibm (Sun Microsystems, 1993), without its branches;
the rational functions of small arguments are those of Cephes (S. Moshier, 1989).
"""

from __future__ import annotations

from holdfast.execution.arithmetic.steps import (
    Function,
    Pair,
    Value,
    bits,
    choose,
    exact_product,
    exact_sum,
    floor,
    from_bits,
    greatest_of,
    least_of,
    ordered_sum,
    rint,
    with_sign_of,
)

INF = float("inf")
NAN = float("nan")
LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
INVERSE_LN2 = 1.4426950408889634
ROUNDER = 6755399441055744.0  # 1.5 * 2^52: the last bits of the sum are those of a whole number
EXPONENTIAL = (
    1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05,
    -1.65339022054652515390e-06, 4.13813679705723846039e-08,
)  # fmt: skip
LOGARITHM = (
    6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01,
    2.222219843214978396e-01, 1.818357216161805012e-01, 1.531383769920937332e-01,
    1.479819860511658591e-01,
)  # fmt: skip
ROOT_HALF = 0.7071067811865476


def power_of_two(k: Value) -> Value:
    """2^k for a whole number k, as a float, from -1022 to 1023."""
    return from_bits(bits(k + (ROUNDER + 1023.0)) << 52)


def scaled(y: Value, k: Value) -> Value:
    """y 2^k, rounded once, for y near 1 and |k| < 2044."""
    half = floor(0.5 * k)
    return y * power_of_two(half) * power_of_two(k - half)


def _exponential(x: Value, rest: Value) -> tuple[Value, Value, Value]:
    """(a, b, k): exp(x + rest) = (a + b) 2^k, for |x| < 1400."""
    k = rint(x * INVERSE_LN2)
    high, low = x - k * LN2[0], k * LN2[1] - rest
    r = high - low
    t = r * r
    p = EXPONENTIAL
    c = r - t * (p[0] + t * (p[1] + t * (p[2] + t * (p[3] + t * p[4]))))
    total, first = ordered_sum(x.steps.constant(1.0, "float"), high)
    total, second = ordered_sum(total, (r * c) / (2.0 - c) - low)
    return total, first + second, k


@Function
def exponential(x: Value) -> Value:
    """e^x."""
    inside = least_of(greatest_of(x, -750.0), 712.0)
    a, b, k = _exponential(inside, x.steps.constant(0.0, "float"))
    return choose(x.differs(x), x, scaled(a + b, k))


def _mantissa_and_exponent(x: Value) -> Pair:
    """m in [1, 2) and k with x = m 2^k, for x > 0."""
    tiny = x < 2.0**-1022
    pattern = bits(choose(tiny, x * 2.0**54, x))
    exponent = from_bits((pattern >> 52) | 0x4330000000000000) - (4503599627370496.0 + 1023.0)
    m = from_bits((pattern & 0xFFFFFFFFFFFFF) | 0x3FF0000000000000)
    return m, exponent - choose(tiny, 54.0, 0.0)


@Function
def logarithm(x: Value) -> Value:
    """The natural logarithm; -inf at 0, NaN below."""
    m, exponent = _mantissa_and_exponent(x)
    upper = m > 2.0 * ROOT_HALF
    m = choose(upper, 0.5 * m, m)
    k = choose(upper, exponent + 1.0, exponent)
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    g = LOGARITHM
    r = w * (g[1] + w * (g[3] + w * g[5])) + z * (g[0] + w * (g[2] + w * (g[4] + w * g[6])))
    half = 0.5 * f * f
    found = k * LN2[0] - ((half - (s * (half + r) + k * LN2[1])) - f)
    found = choose(x.equals(0.0), -INF, choose(x < 0.0, NAN, found))
    return choose(x < INF, found, x + 0.0)


def _both_exponentials(x: Value) -> tuple[Pair, Pair, Value]:
    """e^x / 2^k, e^-x 2^k and k, the first two with their rests, for 0 <= x < 1400."""
    a, b, k = _exponential(x, x.steps.constant(0.0, "float"))
    q = 1.0 / a
    p, e = exact_product(q, a)
    return (a, b), (q, ((1.0 - p) - e - q * b) * q), k


def _half_of_both(x: Value, sign: float) -> Value:
    """(e^x + sign e^-x) / 2 of x >= 0, where it is not small."""
    inside = least_of(x, 720.0)
    (a, a_rest), (b, b_rest), k = _both_exponentials(inside)
    far = k < 40.0
    down = choose(far, power_of_two(-2.0 * least_of(k, 40.0)), 0.0)
    total, rest = exact_sum(a, sign * (b * down))
    return scaled(total + (rest + (a_rest + sign * (b_rest * down))), k - 1.0)


SINH_TOP = (
    -7.89474443963537015605e-1, -1.63725857525983828727e2, -1.15614435765005216044e4,
    -3.51754964808151394800e5,
)  # fmt: skip
SINH_BELOW = (-2.77711081420602794433e2, 3.61578279834431989373e4, -2.11052978884890840399e6)
TANH_TOP = (-9.64399179425052238628e-1, -9.92877231001918586564e1, -1.61468768441708447952e3)
TANH_BELOW = (1.12811678491632931402e2, 2.23548839060100448583e3, 4.84406305325125486048e3)


def _polynomial(z: Value, coefficients: tuple[float, ...], first: Value | float) -> Value:
    total: Value | float = first
    for c in coefficients:
        total = z * total + c
    assert isinstance(total, Value)
    return total


@Function
def hyperbolic_sine(x: Value) -> Value:
    """sinh x."""
    z = x * x
    small = x + x * (
        z * (_polynomial(z, SINH_TOP[1:], SINH_TOP[0]) / _polynomial(z, SINH_BELOW, 1.0))
    )
    large = with_sign_of(_half_of_both(abs(x), -1.0), x)
    return choose(abs(x) < 1.0, choose(x.equals(0.0), x, small), choose(x.differs(x), x, large))


@Function
def hyperbolic_cosine(x: Value) -> Value:
    """cosh x."""
    return choose(x.differs(x), x, _half_of_both(abs(x), 1.0))


@Function
def hyperbolic_tangent(x: Value) -> Value:
    """tanh x."""
    z = x * x
    small = x + x * (
        z * (_polynomial(z, TANH_TOP[1:], TANH_TOP[0]) / _polynomial(z, TANH_BELOW, 1.0))
    )
    size = abs(x)
    a, b, k = _exponential(2.0 * least_of(size, 22.0), x.steps.constant(0.0, "float"))
    up = power_of_two(k)
    total, rest = exact_sum(a * up, x.steps.constant(1.0, "float"))
    rest = rest + b * up
    q = 2.0 / total
    p, e = exact_product(q, total)
    more = (((2.0 - p) - e) - q * rest) / total
    one, less = ordered_sum(x.steps.constant(1.0, "float"), -q)
    large = with_sign_of(one + (less - more), x)
    found = choose(size < 0.625, choose(x.equals(0.0), x, small), large)
    return choose(x.differs(x), x, found)


# -- x^y --------------------------------------------------------------------------------

POWER_LOG = (
    5.99999999999994648725e-01, 4.28571428578550184252e-01, 3.33333329818377432918e-01,
    2.72728123808534006489e-01, 2.30660745775561754067e-01, 2.06975017800338417784e-01,
)  # fmt: skip
TWO_THIRDS_OF_LOG2E = (
    9.61796693925975554329e-01,
    9.61796700954437255859e-01,
    -7.02846165095275826516e-09,
)
"""2 / (3 ln 2), its upper part, and the rest."""
LOG2_OF_3_2 = (5.84962487220764160156e-01, 1.35003920212974897128e-08)
LN2_PARTS = (6.93147180559945286227e-01, 6.93147182464599609375e-01, -1.90465429995776804525e-09)
UPPER = 0xFFFFFFFF00000000


def _upper(x: Value) -> Value:
    """x without the last 32 bits of its mantissa."""
    return from_bits(bits(x) & UPPER)


def _binary_logarithm(x: Value) -> Pair:
    """log2 of x > 0 as the sum of two floats, the first of few digits."""
    m, exponent = _mantissa_and_exponent(x)
    most = m > 1.7320508075688772
    some = (m > 1.224744871391589) & ~most
    m = choose(most, 0.5 * m, m)
    n = choose(most, exponent + 1.0, exponent)
    place = choose(some, 1.5, 1.0)
    u, v = m - place, 1.0 / (m + place)
    s = u * v
    s_high = _upper(s)
    t_high = _upper(m + place)
    t_low = m - (t_high - place)
    s_low = v * ((u - s_high * t_high) - s_high * t_low)
    z = s * s
    g = POWER_LOG
    r = z * z * (g[0] + z * (g[1] + z * (g[2] + z * (g[3] + z * (g[4] + z * g[5])))))
    r = r + s_low * (s_high + s)
    z = s_high * s_high
    t_high = _upper(3.0 + z + r)
    t_low = r - ((t_high - 3.0) - z)
    u, v = s_high * t_high, s_low * t_high + t_low * s
    p_high = _upper(u + v)
    p_low = v - (p_high - u)
    c = TWO_THIRDS_OF_LOG2E
    high = c[1] * p_high
    low = c[2] * p_high + p_low * c[0] + choose(some, LOG2_OF_3_2[1], 0.0)
    more = choose(some, LOG2_OF_3_2[0], 0.0)
    found = _upper(((high + low) + more) + n)
    return found, low - (((found - n) - more) - high)


@Function
def power(x: Value, y: Value) -> Value:
    """x^y, with the conventions of C99 (F.9.4.4)."""
    size = abs(x)
    usable = (size > 0.0) & (size < INF) & (abs(y) < INF)
    a, b = _binary_logarithm(choose(usable, size, 1.0))
    w = least_of(greatest_of(choose(usable, y, 0.0), -(2.0**70)), 2.0**70)
    w_high = _upper(w)
    low, high = (w - w_high) * a + w * b, w_high * a
    z = low + high
    over, under = z > 1100.0, z < -1200.0
    outside = over | under
    high, low = choose(outside, 0.0, high), choose(outside, 0.0, low)
    n = rint(low + high)
    high = high - n
    t = _upper(low + high)
    c = LN2_PARTS
    u, v = t * c[1], (low - (t - high)) * c[0] + t * c[2]
    z = u + v
    rest = v - (z - u)
    t = z * z
    p = EXPONENTIAL
    t = z - t * (p[0] + t * (p[1] + t * (p[2] + t * (p[3] + t * p[4]))))
    r = (z * t) / (t - 2.0) - (rest + z * rest)
    found = scaled(1.0 - (r - z), n)
    found = choose(over, INF, choose(under, 0.0, found))
    # the conventions
    whole = floor(y).equals(y) & (abs(y) < INF)
    odd = whole & ~(floor(0.5 * y) * 2.0).equals(y)
    negative = (bits(x) >> 63).equals(1)
    grows = choose(y > 0.0, size, choose(size.equals(0.0), INF, choose(size < INF, 1.0, 0.0)))
    found = choose(size.equals(0.0) | ~(size < INF), grows, found)
    same = ((size > 1.0) & (y > 0.0)) | ((size < 1.0) & (y < 0.0))
    large = choose(same, INF, 0.0)
    found = choose(abs(y).equals(INF), choose(size.equals(1.0), 1.0, large), found)
    found = choose(negative & odd, -found, found)
    found = choose((x < 0.0) & (x > -INF) & ~whole & (abs(y) < INF), NAN, found)
    found = choose(x.differs(x) | y.differs(y), x + y, found)
    return choose(x.equals(1.0) | y.equals(0.0), 1.0, found)
