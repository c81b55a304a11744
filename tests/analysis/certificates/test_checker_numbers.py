"""The checker's intervals, slopes and series: what they contain, and what is unknown."""

import itertools
import math

import flint
import numpy as np
import pytest
from flint import arb, arb_series

from holdfast_check import intervals
from holdfast_check.intervals import Expression, Tape, TextError, interval, point

TEXTS = [
    "x**3 - y*x*y", "sqrt(x**2 + y**2 + 1)*y", "(x*y)*(x*y)/(2 + y**2)", "-x*x*sin(y) + x*y**3",
    "exp(x)*cos(2*y)/3", "atan(x*y) - tanh(y)", "tan(x/3)*log(3 + y)", "(2 + x)**(-3/2) + y**5",
    "1/(x*y - 3)**2", "sqrt(2 + sin(x))**3",
]  # fmt: skip
KINKED = ["least(x, y*y)", "greatest(x - y, magnitude(x))*y", "length(x, y, 1/1000)",
          "Abs(x*y)", "angle(y, x + 3, 1/1000)", "wrap(x + y)"]  # fmt: skip


@pytest.fixture(autouse=True)
def bits():
    flint.ctx.prec = 80


def ends(q):
    return float(q[0]), float(q[1])


def boxes(generator, count):
    """Of which some have an end at 0, and some are numbers."""
    for _ in range(count):
        pair = np.sort(generator.choice([-1.1, -0.5, 0, 0.25, 1], (2, 2)), axis=1)
        yield [tuple(map(float, e)) for e in pair]


@pytest.mark.parametrize("text", TEXTS + KINKED)
def test_values_and_slopes_over_a_box_have_those_at_its_places(text):
    generator, tape = np.random.default_rng(5), Tape([Expression(text)])

    def at(x, y):
        known = {"x": x, "y": y}
        values = tape.values(known)
        slopes = tape.slopes(values, [{"x": point(1)}, {"y": point(1)}])
        return tape.of(values)[0], [s[0] or point(0) for s in slopes]

    for pair in boxes(generator, 60):
        value, slopes = at(*(interval(*e) for e in pair))
        for _ in range(5):
            here, there = at(*(point(float(generator.uniform(*e))) for e in pair))
            for inner, outer in zip([here, *there], [value, *slopes], strict=True):
                assert not inner[0] < outer[0], pair
                assert not inner[1] > outer[1], pair


@pytest.mark.parametrize("text", TEXTS)
def test_series_are_those_of_another_library(text):
    """Of x' = text, y' = x - y: coefficients by python-flint's power series, term by term."""
    rates = [Expression(text), Expression("x - y")]
    found = Tape(rates).series({"x": point(0.3), "y": point(-0.4)}, ["x", "y"], 4)
    code = compile(text.replace("(-3/2)", "(-1.5)"), "", "eval")

    def powered(base, exponent):
        return base**exponent if exponent == int(exponent) else (base**3).sqrt() ** -1

    class Series:
        """A series with the operators of Python, whose numbers are exact."""

        def __init__(self, s):
            self.s = s if isinstance(s, arb_series) else arb_series([s])

        def __neg__(self):
            return Series(-self.s)

        def __add__(self, o):
            return Series(self.s + of(o))

        def __sub__(self, o):
            return Series(self.s - of(o))

        def __mul__(self, o):
            return Series(self.s * of(o))

        def __truediv__(self, o):
            return Series(self.s / of(o))

        def __radd__(self, o):
            return Series(of(o) + self.s)

        __rmul__ = __mul__

        def __rtruediv__(self, o):
            return Series(of(o) / self.s)

        def __pow__(self, n):
            return Series(powered(self.s, n))

    def of(o):
        return o.s if isinstance(o, Series) else arb_series([o])

    functions = {
        n: (lambda q, n=n: Series(getattr(q.s, n)()))
        for n in ("sin", "cos", "tan", "atan", "exp", "log", "sqrt")
    }
    two = arb_series([2])
    functions["tanh"] = lambda q: Series(1 - two / ((two * q.s).exp() + 1))
    flint.ctx.cap = 4
    x, y = [arb(0.3)], [arb(-0.4)]
    for k in range(3):
        names = {"x": Series(arb_series(x)), "y": Series(arb_series(y))}
        rate = eval(code, functions, names).s[k]  # of the texts of this module
        x.append(rate / (k + 1))
        y.append((x[k] - y[k]) / (k + 1))
    for row, exact in zip(found, (x, y), strict=True):
        for (low, high), true in zip(row, exact, strict=True):
            assert float(high - low) < 1e-18 * (1 + abs(float(low)))
            assert abs(float((low - true).mid())) < 1e-15 * (1 + abs(float(low)))


def test_series_that_the_search_takes_are_the_same():
    """Every coefficient of the checker lies in that of `certify`, over boxes and at places."""
    import sympy as sp

    from holdfast.execution.arithmetic.steps import Steps
    from holdfast.execution.codegen.llvm_text import Leaf
    from holdfast.execution.intervals.enclosure import pairs
    from holdfast.execution.intervals.tape import Tape as Searched
    from holdfast.execution.leaf import compiled_leaves

    names = dict(zip("xy", sp.symbols("x y", real=True), strict=True))
    generator = np.random.default_rng(2)
    for text in TEXTS:
        rates = [sp.sympify(text, locals=names), names["x"] - names["y"]]
        steps, searched = Steps(expanded=True), Searched(rates)
        columns = [f"q{k}" for k in range(4)]
        known = dict(zip("xy", pairs(steps, columns), strict=True))
        series = searched.series(steps, known, "xy", 4)
        results = [end for row in series for q in row for end in (q.low, q.high)]
        leaves = compiled_leaves({"series": Leaf(steps, {"q": columns}, results)})
        checked = Tape([Expression(str(r)) for r in rates])
        for pair in boxes(generator, 20):
            said = leaves.values("series", 1, len(results), np.ravel(pair)[None])[0]
            here = {n: interval(*e) for n, e in zip("xy", pair, strict=True)}
            inner = [end for row in checked.series(here, ["x", "y"], 4) for q in row for end in q]
            for k, (a, b) in enumerate(zip(said, inner, strict=True)):
                if math.isfinite(a):
                    assert b >= arb(a) if k % 2 == 0 else b <= arb(a), (text, pair)


def test_squares_and_slopes_of_roots_are_as_narrow_as_they_can_be():
    known = {"x": interval(-0.25, 0.125), "y": interval(0.5, 0.75)}
    for text, low, high in (
        ("x*x", 0, 0.0625),
        ("x*x*x", -0.015625, 0.0078125),
        ("x**3", -0.015625, 0.001953125),
    ):
        tape = Tape([Expression(text)])
        assert ends(tape.of(tape.values(known))[0]) == (low, high)
    tape = Tape([Expression("sqrt(x*x + y*y)")])
    ((slope,),) = tape.slopes(tape.values(known), [{"y": point(1)}])
    assert ends(slope) == pytest.approx((0.5 / math.hypot(0.25, 0.75), 0.75 / 0.5), abs=1e-15)


@pytest.mark.parametrize("name", ["greatest", "least", "magnitude"])
def test_kink_that_is_not_met_has_one_slope(name):
    text = "magnitude(x)" if name == "magnitude" else f"{name}(x, 0)"
    tape = Tape([Expression(text)])

    def slope(low, high):
        ((found,),) = tape.slopes(tape.values({"x": interval(low, high)}), [{"x": point(1)}])
        return ends(found)

    right, left = {"greatest": (1, 0), "least": (0, 1), "magnitude": (1, -1)}[name]
    assert slope(1, 2) == (right, right)
    assert slope(-2, -1) == (left, left)
    assert slope(-0.5, 0.5) == (min(left, right), max(left, right))


@pytest.mark.parametrize("text", ["sqrt(x*y)", "sqrt(x - 1)", "sqrt(x*x - y*y)", "sqrt(x**3)",
                                  "log(x)", "1/x", "tan(2*x)", "x**(-1/2)", "0*(1/x)"])  # fmt: skip
def test_what_may_be_no_number_is_unknown(text):
    tape, across = Tape([Expression(text)]), interval(-1, 1)
    (value,) = tape.of(tape.values({"x": across, "y": across}))
    assert not value[1] <= 10
    assert not value[0] >= -10


def test_unknown_stays_unknown_through_every_operation():
    one, unknown = interval(-1, 2), intervals.UNKNOWN
    for function in (intervals.add, intervals.sub, intervals.mul, intervals.hull,
                     intervals.least, intervals.greatest, intervals.length, intervals.angle):  # fmt: skip
        for a, b in itertools.permutations((one, unknown)):
            low, high = function(a, b)
            assert not any((low <= 1e9, low >= -1e9, high <= 1e9, high >= -1e9)), function
    for function in (intervals.neg, intervals.inverse, intervals.root, intervals.size,
                     intervals.sine, intervals.cosine, intervals.tangent, intervals.exponential,
                     intervals.logarithm, intervals.arctangent, intervals.wrap,
                     lambda q: intervals.power(q, 2), lambda q: intervals.power(q, 3)):  # fmt: skip
        low, high = function(unknown)
        assert not any((low <= 1e9, low >= -1e9, high <= 1e9, high >= -1e9))


@pytest.mark.parametrize(
    "text",
    ["x # y", "x\n", "\uff58", "x; y", "x.y", "x[0]", "lambda: 1", "x if y else 1", "1.5*x",
     "True", "x**y", "x**(1/3)", "x**65", "2**64**64", "((2**64)**64)**64", "f(x)", "sin(x, y)",
     "sin()", "sin(x=1)", "least(x)", "'x'", "", "+x", "x // 2", "x % 2", "1e400", "~x",
     "__import__('os')", "x" * 200_000 + "(", "(" * 500 + "x" + ")" * 500, "-" * 100_000 + "x"],
)  # fmt: skip
def test_text_that_no_certificate_has_is_refused_by_name(text):
    with pytest.raises(TextError, match=r"it (has|is)|the exponent"):
        Expression(text)


def test_sum_of_many_terms_is_read():
    tape = Tape([Expression(" + ".join(f"{k}*x" for k in range(1, 1500)))])
    assert ends(tape.of(tape.values({"x": point(1)}))[0]) == (1124250, 1124250)


def test_angle_that_may_jump_is_any():
    """It was from 0 to pi where the box crosses the cut, and a false constraint was valid."""
    for name in ("atan2(y, x)", "angle(y, x, 1/1000)"):
        tape = Tape([Expression(name)])
        across = tape.of(tape.values({"x": interval(-2, -1), "y": interval(-1, 1)}))[0]
        assert ends(across) == pytest.approx((-math.pi, math.pi))
        tape = Tape([Expression("wrap(x)")])
    assert ends(tape.of(tape.values({"x": interval(3, 3.5)}))[0]) == pytest.approx(
        (-math.pi, math.pi)
    )


def test_greatest_in_parentheses_is_a_greatest():
    for text in ("greatest(x - 1, -5)", "(greatest(x - 1, -5))", "( greatest (x - 1, -5) )"):
        assert Expression(text).all_parts
    assert not Expression("least(x - 1, greatest(x, 2))").all_parts


@pytest.mark.parametrize(
    "text",
    ["(0*exp(exp(exp(exp(x)))) - 1 + y)**2", "Abs(k*exp(exp(exp(exp(x)))) - 1 + y)",
     "exp(exp(exp(exp(x)))) - exp(exp(exp(exp(x))))", "sin(exp(exp(exp(exp(exp(x))))))*y - 2"],
)  # fmt: skip
def test_what_overflows_is_unknown_and_never_half_known(text):
    """0 times infinity was no number at one end, which an even power took for a bound."""
    tape = Tape([Expression(text)])
    known = {"x": interval(2, 3), "y": interval(0, 100), "k": point(0)}
    for low, high in tape.values(known):
        assert (low <= high) or not (low <= 1e9 or low >= 1e9 or high <= 1e9 or high >= 1e9)
    (value,) = tape.of(tape.values(known))
    assert not value[1] <= 90
