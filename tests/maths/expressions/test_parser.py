"""Text from a stranger becomes mathematics or a refusal, and never runs."""

import contextlib
import math
import random

import pytest
import sympy as sp
from hypothesis import example, given, settings
from hypothesis import strategies as st

from holdfast.errors import ExpressionError
from holdfast.maths.expressions.parser import FUNCTIONS, parse_condition, parse_expression

NAMES = {n: sp.Symbol(n, real=True) for n in ("x", "y", "theta")}
VALUES = {"x": 0.7, "y": -1.3, "theta": 2.1}

PYTHON = {
    "sin": math.sin,
    "cos": math.cos,
    "tanh": math.tanh,
    "exp": math.exp,
    "abs": abs,
    "min": min,
    "max": max,
    "hypot": math.hypot,
    "atan2": math.atan2,
    "sgn": lambda v: 1.0 if v >= 0 else -1.0,
    "select": lambda c, a, b: a if c >= 0 else b,
    "clip": lambda v, a, b: min(max(v, a), b),
}

leaves = st.one_of(
    st.sampled_from(sorted(VALUES)),
    st.floats(0.1, 9.0).map(lambda v: repr(round(v, 3))),
)


def grown(children):
    pair = st.tuples(children, children)
    return st.one_of(
        st.tuples(children, st.sampled_from("+-*"), children).map(
            lambda p: f"({p[0]} {p[1]} {p[2]})"
        ),
        children.map(lambda a: f"(-{a})"),
        children.map(lambda a: f"sin({a})"),
        children.map(lambda a: f"tanh({a})"),
        children.map(lambda a: f"abs({a})"),
        children.map(lambda a: f"({a})**2"),
        pair.map(lambda p: f"hypot({p[0]}, {p[1]})"),
        pair.map(lambda p: f"min({p[0]}, {p[1]})"),
        pair.map(lambda p: f"({p[0]} if {p[1]} > 0.25 else {p[1]})"),
    )


@settings(max_examples=150)
@given(st.recursive(leaves, grown, max_leaves=8))
@example("(-(theta if (0.5)**2 > 0.25 else (0.5)**2))")
def test_parsed_text_has_the_value_that_arithmetic_gives_it(text):
    """Conditions hold at equality: `> 0.25` is true of 0.5**2."""
    expected = eval(text.replace(" > ", " >= "), {"__builtins__": {}}, PYTHON | VALUES)
    parsed = parse_expression(text, NAMES)
    value = float(parsed.subs({NAMES[n]: sp.Float(v) for n, v in VALUES.items()}))
    assert value == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.heavy
@settings(max_examples=300)
@given(st.text(max_size=60))
def test_any_text_is_parsed_or_refused_and_nothing_else_happens(text):
    try:
        result = parse_expression(text, NAMES)
    except ExpressionError:
        return
    assert isinstance(result, sp.Expr)
    assert result.free_symbols <= set(NAMES.values())


@settings(max_examples=200)
@given(st.integers(0, 10**9))
def test_scrambled_python_is_parsed_or_refused(seed):
    pieces = [
        "x",
        "(",
        ")",
        "**",
        "9",
        ".",
        "__class__",
        "lambda",
        ":",
        "[",
        "]",
        "sin",
        ",",
        "import",
        "if",
        "else",
        "not",
        "and",
        "<",
        "e400",
        "'",
        "exec",
        "@",
        "~",
        "%",
    ]
    text = "".join(random.Random(seed).choices(pieces, k=8))
    with contextlib.suppress(ExpressionError):
        parse_expression(text, NAMES)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x.__class__", "attribute access"),
        ("().__class__.__bases__", "attribute access"),
        ("__import__('os')", "function '__import__' is not allowed"),
        ("open('f')", "function 'open' is not allowed"),
        ("eval('1')", "function 'eval' is not allowed"),
        ("(lambda: 1)()", "call of anything but a function name"),
        ("x[0]", "indexing"),
        ("[x for x in y]", "comprehension"),
        ("10**10000000", "exponent 1e+07"),
        ("9**9**9", "exponent"),
        ("x**(9**9)", "exponent"),
        ("1e400", "finite number"),
        ("9" * 400, "out of range"),
        ("1/0", "division by zero"),
        ("x/(2-2)", "division by zero"),
        ("x ^ 2", "write ** for a power"),
        ("thta + 1", "did you mean 'theta'?"),
        ("sni(x)", "did you mean 'sin'?"),
        ("sin", "without arguments"),
        ("sin(x, y)", "2 arguments"),
        ("sin(*x)", "unpacked"),
        ("x if y", "is not an expression"),
        ("x < 1", "a condition where a value is wanted"),
        ("x == 1", "a condition where a value is wanted"),
        ("'x'", "the constant 'x'"),
        ("True", "the constant True"),
        ("1j", "the constant 1j"),
        ("x % 2", "operator Mod"),
        ("x := 1", "is not an expression"),
        ("", "is not an expression"),
        ("sqrt(-1)", "not a finite real number"),
        ("log(0)", "not a finite real number"),
        ("(" * 90 + "x" + ")" * 90 + "+1" * 10, None),
        ("-" * 100 + "x", "nested"),
        ("x+" * 1500 + "x", "at most 2000"),
        ("diff(x, x + 1)", "diff(expression, name)"),
    ],
)
def test_forbidden_or_wrong_text_is_refused_with_its_reason(text, complaint):
    if complaint is None:  # redundant parentheses are no nesting
        assert parse_expression(text, NAMES) == NAMES["x"] + 10
        return
    with pytest.raises(ExpressionError) as caught:
        parse_expression(text, NAMES)
    assert complaint in str(caught.value)


def test_every_listed_function_can_be_called():
    for name, (fewest, _, _) in FUNCTIONS.items():
        text = f"{name}({', '.join(['x/3'] * fewest)})"
        assert isinstance(parse_expression(text, NAMES), sp.Expr)


def test_partial_derivatives_are_derived():
    assert parse_expression("diff(x**2*sin(y), x)", NAMES) == 2 * NAMES["x"] * sp.sin(NAMES["y"])


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("x > 0.5 and y < 0", True),
        ("x > 0.5 and y > 0", False),
        ("x < 0 or y < 0", True),
        ("not x < 0", True),
        ("0 < x < 1", True),
        ("0 < y < 1", False),
    ],
)
def test_a_condition_holds_where_its_level_is_not_negative(text, holds):
    level = parse_condition(text, NAMES)
    value = float(level.subs({NAMES[n]: v for n, v in VALUES.items()}))
    assert (value >= 0) == holds
