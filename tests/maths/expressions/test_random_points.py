"""Zeros and ranks of expressions, decided at random points."""

import pytest
import sympy as sp

from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.expressions.functions import select
from holdfast.maths.expressions.random_points import full_rank, is_zero
from holdfast.maths.formations.walls import nearest_on_walls

X, Y = symbol("x"), symbol("y")


@pytest.mark.parametrize(
    ("expression", "zero"),
    [
        (sp.S.Zero, True),
        (sp.S(2), False),
        (X - Y, False),
        (1e-30 * X, False),
        (sp.sqrt(X - 5), False),
        (sp.sin(X) ** 2 + sp.cos(X) ** 2 - 1, True),
        ((X + Y) ** 2 - X**2 - 2 * X * Y - Y**2, True),
        (select(X - 100, Y, sp.S.Zero), False),
        (nearest_on_walls(0, X, Y, -1, 0, 1, 0), False),
        (nearest_on_walls(0, X, Y, -1, 0, 1, 0) * (sp.sin(X) ** 2 + sp.cos(X) ** 2 - 1), True),
        (sp.sqrt(X - 5) - sp.sqrt(X - 5) * (sp.sin(Y) ** 2 + sp.cos(Y) ** 2), True),
    ],
)
def test_an_expression_is_zero_where_all_its_values_are(expression: sp.Expr, zero: bool) -> None:
    assert is_zero(expression) is zero


@pytest.mark.parametrize(
    ("rows", "full"),
    [
        ([[1, 1], [-X, X]], True),
        ([[1, 1], [X, X]], False),
        ([[X, Y, 0]], True),
        ([[sp.sqrt(X - 5), 0], [0, 1]], True),
        ([[1, 0], [0, 1], [1, 1]], False),
    ],
)
def test_rows_are_independent_where_they_are_at_some_values(rows: list, full: bool) -> None:
    assert full_rank(sp.ImmutableMatrix(rows)) is full


@pytest.mark.parametrize(
    ("expression", "zero"),
    [
        (sp.Abs(X), False),
        (sp.sign(X) - sp.sign(X), True),
        (X * sp.sign(Y), False),
        (sp.Abs(X) - sp.Abs(-X), True),
        (sp.Piecewise((X, X > 0), (Y, True)), False),
        (select(1 - sp.sin(X) ** 2 - sp.cos(X) ** 2, X, 0) - X, True),
    ],
)
def test_jumps_and_cases_are_decided(expression, zero):
    assert is_zero(expression) is zero


def test_a_point_where_it_is_not_zero_decides_without_simplification(monkeypatch):
    def refused(expression):
        raise AssertionError(expression)

    monkeypatch.setattr(sp, "simplify", refused)
    for expression in (X, X * sp.sin(Y), sp.Abs(X) - Y, select(X, Y, X), sp.sqrt(X**2 + 1) - X):
        assert not is_zero(expression)
