"""The elementary functions against multiple precision, and at the values where libm is special."""

import math

import mpmath
import numpy as np
import pytest

from holdfast.execution.arithmetic import elementary, steps
from holdfast.execution.arithmetic.steps import Steps, choose
from holdfast.execution.codegen.llvm_text import LANES, Leaf
from holdfast.execution.leaf import columns, compiled_leaves, padded

GENERATOR = np.random.default_rng(24)
COUNT = 3000
LARGEST = 1.7976931348623157e308
TINIEST = 5e-324


def spread(low, high):
    """Numbers of both signs, uniform in the logarithm."""
    sizes = np.exp(GENERATOR.uniform(math.log(low), math.log(high), COUNT))
    return sizes * GENERATOR.choice([-1.0, 1.0], COUNT)


def around(*places):
    """The floats next to some places."""
    return np.array([p * (1 + k * 2.0**-52) for p in places for k in range(-3, 4)])


QUARTERS = around(*(k * math.pi / 2 for k in (1, 2, 3, 5, 100, 12345, 524287, 524288, 524289)))
HARD = np.array([6381956970095103.0 * 2.0**797, 5.319372648326541e255, 2.0**1023, 823549.0])
"""The first is nearest to a multiple of pi/2 of all floats (J.-M. Muller, Elementary Functions)."""

ANGLES = np.concatenate([spread(1e-300, 1e300), spread(1e-3, 1e6), QUARTERS, HARD])
UNIT = np.clip(np.concatenate([spread(1e-300, 1.0), 1 - spread(1e-16, 1.0), around(0.5, 1)]), -1, 1)
CASES = {
    "sin": (lambda x: elementary.sine_and_cosine(x)[0], mpmath.sin, ANGLES, 0.80),
    "cos": (lambda x: elementary.sine_and_cosine(x)[1], mpmath.cos, ANGLES, 0.80),
    "tan": (elementary.tangent, mpmath.tan, ANGLES, 0.95),
    "asin": (elementary.arcsine, mpmath.asin, UNIT, 0.70),
    "acos": (elementary.arccosine, mpmath.acos, UNIT, 0.75),
    "atan": (
        elementary.arctangent,
        mpmath.atan,
        np.concatenate([spread(1e-300, 1e300), spread(0.1, 10), around(7 / 16, 11 / 16, 1)]),
        0.66,
    ),
    "exp": (
        elementary.exponential,
        mpmath.exp,
        np.concatenate([spread(1e-300, 700), GENERATOR.uniform(-745, 709.7, COUNT)]),
        0.75,
    ),
    "log": (
        elementary.logarithm,
        mpmath.log,
        np.abs(np.concatenate([spread(1e-320, 1e300), 1 + spread(1e-15, 0.5), around(1, 0.7071)])),
        0.90,
    ),
    "sinh": (elementary.hyperbolic_sine, mpmath.sinh, spread(1e-300, 710), 0.80),
    "cosh": (elementary.hyperbolic_cosine, mpmath.cosh, spread(1e-300, 710), 0.80),
    "tanh": (
        elementary.hyperbolic_tangent,
        mpmath.tanh,
        np.concatenate([spread(1e-300, 30), around(0.625), GENERATOR.uniform(-2, 2, COUNT)]),
        0.85,
    ),
}
"""name -> (steps, multiple precision, arguments, largest error in units of the last place)."""

PAIRS = {
    "atan2": (elementary.angle_of, mpmath.atan2, spread(1e-20, 1e20), spread(1e-20, 1e20), 0.68),
    "pow": (
        elementary.power,
        mpmath.power,
        np.abs(spread(1e-100, 1e100)),
        GENERATOR.uniform(-3, 3, COUNT),
        0.90,
    ),
}


def machine_code(function, *names):
    """The function compiled as a leaf: arrays in, an array out."""
    steps = Steps(expanded=True)
    result = function(*(steps.input(n) for n in names))
    leaves = compiled_leaves({"function": Leaf(steps, {"q": names}, [result])})

    def call(*arguments):
        points = np.array(arguments, dtype=np.float64).T
        stride = padded(len(points))
        out = np.empty((1, stride))
        leaves.call("function", columns(points, stride), out)
        return out[0, : len(points)]

    return call


def ulps(found, exact, precision=300):
    """The error in units of the last place of the exact result."""
    with mpmath.workprec(precision):
        gap = abs(mpmath.mpf(float(found)) - exact)
        return float(gap / mpmath.mpf(float(np.spacing(abs(float(exact))))))


def most_ulps(found, exact, arguments, precision=300):
    with mpmath.workprec(precision):
        rows = zip(found, *arguments, strict=True)
        return max(
            ulps(value, exact(*(mpmath.mpf(float(a)) for a in given)), precision)
            for value, *given in rows
            if np.isfinite(value)
        )


@pytest.mark.few("sinh", "cosh", "tanh")
@pytest.mark.parametrize("name", CASES)
def test_error_is_below_an_ulp(name):
    function, exact, arguments, most = CASES[name]
    found = machine_code(function, "x")(arguments)
    assert np.isfinite(found).all()
    precision = 1400 if arguments is ANGLES else 300
    assert most_ulps(found, exact, (arguments,), precision) < most < 1


@pytest.mark.parametrize("name", PAIRS)
def test_error_of_two_arguments_is_below_an_ulp(name):
    function, exact, one, other, most = PAIRS[name]
    found = machine_code(function, "x", "y")(one, other)
    assert np.isfinite(found).all()
    assert most_ulps(found, exact, (one, other)) < most < 1


SPECIAL = np.array(
    [0.0, 1.0, 0.5, 2.0, 3.0, np.inf, TINIEST, 2.0**-1022, 1e-310, LARGEST, 710.0, 746.0, 709.8]
)
SPECIAL = np.concatenate([SPECIAL, -SPECIAL, [np.nan, 1e300, -2.5, 745.2, -745.2]])
LIBM = {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2", "pow": "power"}


def same(found, libm):
    """Equal, with the sign of a zero; rounded results may differ by an ulp."""
    equal = (found == libm) & (np.signbit(found) == np.signbit(libm))
    with np.errstate(invalid="ignore", over="ignore"):
        near = np.abs(found - libm) <= 1.01 * np.spacing(np.abs(libm))
    return equal | (np.isnan(found) & np.isnan(libm)) | (near & (libm != 0) & np.isfinite(libm))


@pytest.mark.parametrize("name", [*CASES, *PAIRS])
def test_zeros_infinities_denormals_and_nan_are_those_of_libm(name):
    function = (CASES | PAIRS)[name][0]
    if name in PAIRS:
        arguments = [a.ravel() for a in np.meshgrid(SPECIAL, SPECIAL)]
        found = machine_code(function, "x", "y")(*arguments)
    else:
        arguments = [SPECIAL]
        found = machine_code(function, "x")(SPECIAL)
    with np.errstate(all="ignore"):
        libm = getattr(np, LIBM.get(name, name))(*arguments)
    wrong = ~same(found, libm)
    assert not wrong.any(), [(*(a[wrong] for a in arguments), found[wrong], libm[wrong])]


def test_a_value_does_not_depend_on_its_neighbours():
    """Also where a neighbour needs the digits of 2/pi: every bit is the same."""
    function = machine_code(CASES["sin"][0], "x")
    arguments = spread(1e-3, 1e300)
    alone = np.array([function(np.array([x]))[0] for x in arguments[:200]])
    turned = function(np.roll(arguments, 3))
    assert np.array_equal(function(arguments)[:200], alone)
    assert np.array_equal(np.roll(turned, -3), function(arguments))


def test_functions_of_laws_pass_nan_on():
    both = machine_code(lambda a, b: steps.least(a, b) + steps.greatest(a, b), "a", "b")
    assert np.isnan(both([np.nan, 1.0], [1.0, np.nan])).all()
    assert both([1.0, 3.0], [2.0, -1.0]).tolist() == [3.0, 2.0]
    chosen = machine_code(lambda x: steps.select(x, x * 0 + 5.0, x * 0 + 7.0), "x")
    assert chosen([0.0, -0.0, 1.0, -1.0]).tolist() == [5.0, 5.0, 5.0, 7.0]
    assert np.isnan(chosen([np.nan]))[0]
    turns = machine_code(steps.wrap, "x")
    assert turns([math.pi, -math.pi]).tolist() == [math.pi, math.pi]
    assert machine_code(steps.sgn, "x")([0.0, -0.0, -2.0]).tolist() == [1.0, 1.0, -1.0]
    assert machine_code(steps.sign, "x")([0.0, 3.0, -2.0]).tolist() == [0.0, 1.0, -1.0]


def test_equal_steps_are_one_and_kinds_are_checked():
    steps = Steps(expanded=True)
    x, y = steps.input("x"), steps.input("y")
    assert x * y + 1.0 is x * y + 1.0
    assert len(steps.list) == 5
    assert steps.constant(0.0, "float") is not steps.constant(-0.0, "float")
    with pytest.raises(ValueError, match="choose of"):
        choose(x, x, y)
    with pytest.raises(ValueError, match="other steps"):
        x + Steps(expanded=True).input("x")
    assert LANES == 8
