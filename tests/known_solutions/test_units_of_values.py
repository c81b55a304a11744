"""The same kernel in metres, in units a thousand times smaller, and in others."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf

X, Y, U, W = (hf.symbol(n) for n in "xyuw")


def kernel(unit=1.0, beyond=0.0, **options):
    """x' = x + u, y' = y + w with |(u, w)| <= 1 m/s in a square of 4 m, for 1.5 s.

    beyond: how much deeper the margin falls a tenth of a metre before the ends of the grid.
    """
    metre = sp.Float(unit)
    states = (hf.Quantity("x"), hf.Quantity("y"))
    system = hf.System(
        "unstable", states, (hf.Quantity("u", "m/s"), hf.Quantity("w", "m/s")),
        {"x": X + metre * U, "y": Y + metre * W}, input_bounds=hf.Ball(1.0, 2),
    )  # fmt: skip
    sides = {"east": X, "west": -X, "north": Y, "south": -Y}
    sides = {n: e - 2 * metre for n, e in sides.items()}
    if beyond:
        sides["far"] = beyond * sp.Max(0, abs(X) / metre - 2.2) - 3 * metre
    square = hf.Region("square", states, tuple(hf.Inequality(n, e, "m") for n, e in sides.items()))
    grid = hf.grid(system, dict.fromkeys("xy", (-2.3 * unit, 2.3 * unit)), 61)
    return hf.viability_kernel(system, square, grid, 1.5, **options)


@pytest.mark.few("1e-09")
@pytest.mark.parametrize("unit", [1e-15, 1e-9, 1e-3, 1e3, 1e9, 1e15])
def test_set_is_the_same_in_every_unit(unit):
    values, same = kernel().values(), kernel(unit).values()
    assert ((values > 0) == (same > 0)).all()
    assert same / unit == pytest.approx(values, abs=1e-5)


@pytest.mark.few("upwind-0.001", "upwind-1000.0")
@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e3, 1e9])
@pytest.mark.parametrize("scheme", ["upwind", "eno2", "weno5"])
def test_set_in_single_precision_is_the_same_in_every_unit(unit, scheme):
    """A value that is flat somewhere has a size of 0 there, beside which no gain is too large."""
    options = {"scheme": scheme, "precision": "float32"}
    values, same = kernel(**options).values(), kernel(unit, **options).values()
    assert ((values > 0) == (same > 0)).mean() > 0.999
    assert same / unit == pytest.approx(values, abs=1e-3)


@pytest.mark.few("1e+100")
@pytest.mark.parametrize("beyond", [1e20, 1e30, 1e100])
def test_margin_that_falls_deep_outside_the_set_changes_nothing(beyond):
    values, same = kernel().values(), kernel(beyond=beyond).values()
    assert np.array_equal(values > 0, same > 0)
