"""Expressions as steps: their values are those of SymPy, whatever the expression is made of."""

import math

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.arithmetic.steps import Steps
from holdfast.execution.codegen.lowering import lowered
from holdfast.execution.leaf import Evaluator
from holdfast.maths.expressions.functions import (
    FUNCTIONS,
    PROCESSES,
    angle,
    greatest,
    least,
    length,
    select,
    sgn,
    wrap,
)
from holdfast.maths.expressions.parser import parse_expression

X, Y = sp.symbols("x y", real=True)
POINTS = np.random.default_rng(3).uniform(0.05, 0.95, (37, 2))


def values(expression, points=POINTS):
    return Evaluator([expression], [X, Y], ()).values(points)[:, 0]


@pytest.mark.slow("acos", "atan2", "clip", "cos", "log", "sin", "tan")
@pytest.mark.parametrize("name", sorted(FUNCTIONS.keys() - PROCESSES))
def test_every_function_of_a_file_is_computed(name):
    fewest, _, function = FUNCTIONS[name]
    expression = function(*([X, Y, X * Y][:fewest]))
    exact = [float(expression.subs({X: sp.Float(a, 30), Y: sp.Float(b, 30)})) for a, b in POINTS]
    assert values(expression) == pytest.approx(exact, rel=1e-15, abs=0)


@pytest.mark.slow("-Max(x, y) + Min(1/2, x, y)", "atan2(y, x)")
@pytest.mark.parametrize(
    "expression",
    [
        X - Y,
        -X,
        -2 * X / (3 * Y),
        X**8 + Y**-3,
        X**9,
        sp.sqrt(X) / Y ** sp.Rational(3, 2),
        X**Y,
        X ** sp.Rational(1, 3),
        (X + Y) ** -1,
        sp.pi * X + sp.sqrt(2),
        X / 7 - sp.Rational(22, 7),
        -(X + Y) * (X - Y) / (X**2 + Y**2 + 1),
        sp.Min(X, Y, sp.Rational(1, 2)) - sp.Max(X, Y),
        sp.Abs(X - Y) + sp.sign(Y - X),
        sp.S(3),
        sp.exp(-X) * sp.E,
        sp.atan2(Y, X),
    ],
    ids=str,
)
def test_sums_products_and_powers_are_those_of_sympy(expression):
    exact = [float(expression.evalf(30, subs={X: a, Y: b})) for a, b in POINTS]
    assert values(expression) == pytest.approx(exact, rel=2e-15, abs=1e-16)


@given(st.floats(-30, 30), st.floats(-30, 30))
@settings(max_examples=30)
def test_conventions_of_the_functions_of_laws(a, b):
    at = np.array([[a, b]])
    assert values(angle(Y, X, 1e-12), at)[0] == pytest.approx(math.atan2(b, a), rel=1e-15)
    assert values(length(X, Y, 1e-12), at)[0] == pytest.approx(math.hypot(a, b), rel=4e-16)
    assert values(least(X, Y), at)[0] == min(a, b)
    assert values(greatest(X, Y), at)[0] == max(a, b)
    assert values(sgn(X), at)[0] == (1.0 if a >= 0 else -1.0)
    assert values(select(X, Y, -Y), at)[0] == (b if a >= 0 else -b)
    turned = values(wrap(X), at)[0]
    assert -math.pi <= turned <= math.pi
    assert math.sin(turned) == pytest.approx(math.sin(a), abs=1e-14)


def test_parts_that_repeat_are_computed_once():
    steps = Steps(expanded=True)
    inputs = {X: steps.input("x"), Y: steps.input("y")}
    one, other = lowered(steps, [sp.sin(X * Y) + 1, sp.cos(X * Y) * sp.sin(X * Y)], inputs)
    before = len(steps.list)
    assert lowered(steps, [sp.sin(X * Y) + 1], inputs) == [one]
    assert len(steps.list) == before
    assert one.number != other.number


def test_walls_are_those_of_a_search():
    from holdfast.maths.formations.walls import nearest_on_walls

    walls = [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 1.0]
    found = Evaluator([nearest_on_walls(i, X, Y, *walls) for i in (0, 1)], [X, Y], ()).values(
        POINTS
    )
    for (x, y), (u, v) in zip(POINTS, found, strict=True):
        assert math.hypot(x - u, y - v) == pytest.approx(min(y, 1 - x), abs=1e-15)


def test_what_has_no_steps_is_refused():
    with pytest.raises(DefinitionError, match="function 'gamma' cannot be compiled"):
        values(sp.gamma(X))
    with pytest.raises(DefinitionError, match="the expression uses 'z'"):
        values(hf.symbol("z") + X)


def test_text_of_a_file_is_compiled():
    found = parse_expression("1 - x**2 + sin(3*x)*y", {"x": X, "y": Y})
    a, b = POINTS.T
    assert values(found) == pytest.approx(1 - a**2 + np.sin(3 * a) * b, rel=1e-14)
