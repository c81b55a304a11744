"""Elementary functions by steps of IEEE 754.

Exponential, logarithm and power are those of fdlibm (Sun Microsystems, 1993), without its branches;
the rational functions of small arguments, for hyperbolic functions too, are those of Cephes
(S. Moshier, 1989).

The polynomials of sine, cosine, tangent and their inverses are those of fdlibm. An argument is
brought to [-pi/4, pi/4] by three parts of pi/2 (W. J. Cody, W. Waite, 1980), a large one by the
binary digits of 2/pi (M. Payne, R. Hanek, SIGNUM Newsletter 18, 1983). The tangent and the inverse
functions carry the rounding errors of quotients and roots along.
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
    floor,
    from_bits,
    greatest_of,
    least_of,
    ordered_sum,
    rint,
    root,
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
    log = k * LN2[0] - ((half - (s * (half + r) + k * LN2[1])) - f)
    log = choose(x.equals(0.0), -INF, choose(x < 0.0, NAN, log))
    return choose(x < INF, log, x + 0.0)


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
    tanh = choose(size < 0.625, choose(x.equals(0.0), x, small), large)
    return choose(x.differs(x), x, tanh)


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
    leading = _upper(((high + low) + more) + n)
    return leading, low - (((leading - n) - more) - high)


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
    raised = scaled(1.0 - (r - z), n)
    raised = choose(over, INF, choose(under, 0.0, raised))
    # the conventions
    whole = floor(y).equals(y) & (abs(y) < INF)
    odd = whole & ~(floor(0.5 * y) * 2.0).equals(y)
    negative = (bits(x) >> 63).equals(1)
    grows = choose(y > 0.0, size, choose(size.equals(0.0), INF, choose(size < INF, 1.0, 0.0)))
    raised = choose(size.equals(0.0) | ~(size < INF), grows, raised)
    same = ((size > 1.0) & (y > 0.0)) | ((size < 1.0) & (y < 0.0))
    large = choose(same, INF, 0.0)
    raised = choose(abs(y).equals(INF), choose(size.equals(1.0), 1.0, large), raised)
    raised = choose(negative & odd, -raised, raised)
    raised = choose((x < 0.0) & (x > -INF) & ~whole & (abs(y) < INF), NAN, raised)
    raised = choose(x.differs(x) | y.differs(y), x + y, raised)
    return choose(x.equals(1.0) | y.equals(0.0), 1.0, raised)


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
    angle = total + (first + second + (base_rest + signed(less)))
    angle = from_bits(bits(abs(angle)) | (bits(y) & SIGN))
    return choose(x.differs(x) | y.differs(y), x + y, angle)


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
