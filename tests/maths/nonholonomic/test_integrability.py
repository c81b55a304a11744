"""Whether constraints can be integrated: zero is told from small before anything is rescaled."""

import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.expressions.random_points import Sampler, measured, rank
from holdfast.maths.nonholonomic.chained_search import growth
from holdfast.maths.nonholonomic.structure import kinematic_system, structure

X, Y, Z, PSI = (hf.symbol(n) for n in ("x", "y", "z", "psi"))
STATES = (
    hf.Quantity("x"),
    hf.Quantity("y"),
    hf.Quantity("psi", "rad", angle=True),
    hf.Quantity("z"),
)
SYMBOLS = (X, Y, PSI, Z)
NO_SLIP = {X: -sp.sin(PSI), Y: sp.cos(PSI)}


def system(*rows):
    found = [hf.PfaffianRow({str(s): e for s, e in row.items() if e != 0}) for row in rows]
    return kinematic_system("given", STATES, found)


def added(row, other, factor=sp.S.One):
    return {s: row.get(s, sp.S.Zero) + factor * other.get(s, sp.S.Zero) for s in SYMBOLS}


def differential(function):
    return {s: function.diff(s) for s in SYMBOLS}


def test_integrable_combination_of_rows_is_found():
    """Row 2 + 2 x sin(psi) row 1 = d(z - x^2): the second constraint can be integrated."""
    second = {X: -2 * X * sp.cos(PSI) ** 2, Y: -2 * X * sp.sin(PSI) * sp.cos(PSI), Z: sp.S.One}
    given_rows = system(NO_SLIP, second)
    found = growth(structure(given_rows))
    assert found.vector == (2, 3)
    assert found.integrable == 1
    assert found.integrable_rows == (), "neither row is integrable on its own"
    with pytest.raises(DefinitionError, match="1 of its 2 constraints can be integrated"):
        hf.explain(given_rows)


numbers = st.fractions(-3, 3, max_denominator=8).filter(bool)
terms = st.sampled_from(
    (X**2, X * Y, Y**3, X * sp.sin(PSI), Y * sp.cos(PSI), sp.sin(PSI) ** 2, sp.exp(X) * Y)
)
factors = st.sampled_from(
    (2 * X * sp.sin(PSI), X * Y, sp.cos(PSI), PSI, sp.exp(Y), 1 / (2 + X), Z * X, sp.S.One)
)


def combinations(of):
    """Sums of up to two of them, with rational or with decimal numbers before them."""
    coefficients = st.one_of(numbers.map(sp.Rational), numbers.map(float).map(sp.Float))
    return st.lists(st.tuples(coefficients, of), min_size=1, max_size=2).map(
        lambda pairs: sp.Add(*(c * e for c, e in pairs))
    )


@pytest.mark.heavy
@settings(max_examples=12, derandomize=True)
@given(
    potential=combinations(terms),
    disguise=combinations(factors),
    scale=st.sampled_from((sp.S.One, 2 + sp.sin(PSI), sp.Rational(1, 10**9))),
    twist=st.sampled_from((0, 0, 1, sp.Rational(1, 10**6))),
)
def test_combination_of_rows_is_called_integrable_exactly_where_it_is(
    potential, disguise, scale, twist
):
    """dz + twist y dx + d(potential), to which a multiple of the no-slip row is added.

    On the motions without slip y dx is no differential, however small the factor before it.
    """
    row = added(differential(Z + potential), {X: twist * Y})
    hidden = {s: scale * e for s, e in added(row, NO_SLIP, disguise).items()}
    at_origin = [hidden[s].subs(dict.fromkeys(SYMBOLS, 0)) for s in SYMBOLS]
    if at_origin[3] == 0:  # the disguise took dz away there
        return
    found = growth(structure(system(NO_SLIP, hidden)))
    assert found.integrable == (1 if twist == 0 else 0)
    assert found.vector == ((2, 3) if twist == 0 else (2, 3, 4))


def test_number_within_the_rounding_of_its_terms_is_zero_and_a_small_one_is_not():
    a = hf.symbol("a")
    sampler = Sampler({})
    zero = a * (sp.sin(a) ** 2 + sp.cos(a) ** 2 - 1) * sp.exp(100)
    at = sampler.point([a])
    value, size = measured(zero, at)
    assert abs(value) < 1e-35 * size
    assert sampler.vanishes(zero)
    assert not sampler.vanishes(a * sp.Rational(1, 10**60)), "small, yet nothing cancels in it"
    assert rank([sampler.row([zero, zero], at)]) == 0
    assert rank([sampler.row([a / 10**60, zero], at)]) == 1
