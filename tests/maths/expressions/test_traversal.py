"""Walks over expressions that share their parts: the answers of SymPy, in less time."""

import pytest
import sympy as sp

import holdfast as hf
from holdfast.maths.definitions.switching import as_switching
from holdfast.maths.expressions.functions import (
    angle,
    clip,
    greatest,
    length,
    magnitude,
    select,
    sgn,
    wrap,
)
from holdfast.maths.expressions.traversal import derivatives, exchanged, parts, symbols_of

X, Y, K = (hf.symbol(n) for n in ("x", "y", "k"))
EXPRESSIONS = [
    X * Y * K + 3,
    K * (X**2 + Y**2) ** (K / 2),
    sp.sin(X * Y) * sp.exp(-X) + sp.atan(Y / X) + sp.tanh(K * X) + sp.log(X) + sp.tan(Y),
    select(X, Y * X, sp.cos(X)) + clip(X * Y, -K, K),
    angle(Y, X, K) * length(X, Y, sp.Float(1e-9)),
    magnitude(X - Y) * sgn(X) + wrap(X + 2 * Y) + greatest(X, Y) ** 2,
    sp.Abs(X * Y) + sp.sqrt(X) + sp.asin(X) + sp.sinh(Y),
    sp.Piecewise((-X, X > 0), (Y * X, True)),
    sp.Integer(3),
]


@pytest.mark.parametrize("e", EXPRESSIONS, ids=str)
def test_what_is_found_is_what_sympy_finds(e):
    assert derivatives(e, [X, Y, K, hf.TIME]) == {s: e.diff(s) for s in (X, Y, K, hf.TIME)}
    values = {X: Y + 1, K: sp.Float(2.5)}
    assert exchanged([e], values) == [e.xreplace(values)]
    assert symbols_of([e]) == e.free_symbols
    assert set(parts([e])) == set(sp.preorder_traversal(e))


@pytest.mark.few("ch3-unknown-current")
@pytest.mark.parametrize("name", ["ch3-unknown-current", "ch4-marine", "ch5-nominal"])
def test_slopes_of_laws_are_those_of_sympy(name):
    scenario = hf.load_scenario(name)
    states = [q.symbol for q in scenario.system.states]
    for mode in as_switching(scenario.law).modes.values():
        for e in mode.outputs.values():
            assert derivatives(e, states) == {s: e.diff(s) for s in states}


def test_an_expression_of_a_billion_leaves_takes_no_time():
    e = X
    for _ in range(30):
        e = greatest(e, K) * sp.sin(e)
    (slope,) = derivatives(e, [X]).values()
    assert symbols_of(exchanged([e, slope], {X: Y})) == {Y, K}
    assert sum(1 for _ in parts([e])) < 150
