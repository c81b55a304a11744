"""The monotone rate: H for one slope, no less for a larger slope above, no more for one below."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.maths.games.hamiltonian import is_sharp, monotone_flux
from tests.conftest import number_at

X, Y, U, W, D, E = (hf.symbol(n) for n in ("x", "y", "u", "w", "d", "e"))
STRAIGHT, TURNED = (Y + U, X + W), (Y * U - X, Y + W - X * U)
BALL, BOX = hf.Ball(sp.Float(0.8), 2), hf.Box((-1, -0.5), (0.7, 1))
SUMS = hf.LinearImage(sp.Matrix([[0.5, 0.5], [0.5, -0.5]]), hf.Box((-1, -1), (1, 1)))
PUSHED = (("d",), hf.Box((-0.3,), (0.2,)))
BLOWN = (("d", "e"), hf.Ball(sp.Float(0.3), 2))


def game(rates, bounds, others=()):
    pushes = {1: (0, D), 2: (D, E)}[len(others[0])] if others else (0, 0)
    names, disturbance_bounds = others or ((), None)
    return hf.System(
        "s", (hf.Quantity("x"), hf.Quantity("y")), (hf.Quantity("u"), hf.Quantity("w")),
        {"x": rates[0] + pushes[0], "y": rates[1] + pushes[1]}, input_bounds=bounds,
        disturbances=tuple(map(hf.Quantity, names)), disturbance_bounds=disturbance_bounds,
    )  # fmt: skip


GAMES = {  # whether upwind takes it
    "box": (game(STRAIGHT, BOX), True),
    "sums": (game(STRAIGHT, SUMS), True),
    "sums against a ball": (game(STRAIGHT, SUMS, BLOWN), True),
    "ball": (game(STRAIGHT, BALL), False),
    "ball against a push": (game(STRAIGHT, BALL, PUSHED), False),
    "turned ball": (game(TURNED, BALL), False),
    "turned ball against a push": (game(TURNED, BALL, PUSHED), False),
    "turned box against a ball": (game(TURNED, BOX, BLOWN), True),
    "two balls": (game(STRAIGHT, BALL, BLOWN), False),
}


@pytest.mark.few("False-sides1-turned ball")
@pytest.mark.parametrize("name", GAMES)
@pytest.mark.parametrize("sides", [("max", "min"), ("min", "max")])
@pytest.mark.parametrize("over_points", [True, False])
def test_rate_is_h_for_one_slope_and_monotone_in_both(name, sides, over_points):
    case, sharp = GAMES[name]
    h = hf.hamiltonian(case, inputs=sides[0], disturbances=sides[1])
    assert is_sharp(h) == sharp
    gaps = sp.symbols("g0:2", real=True)
    rate = monotone_flux(h, gaps, over_points=over_points)
    generator = np.random.default_rng(4)

    def at(expression, state, below, above):
        mean, gap = (above + below) / 2, (above - below) / 2
        names = (X, Y, *h.costates, *gaps)
        return number_at(expression, dict(zip(names, (*state, *mean, *gap), strict=True)))

    for _ in range(40):
        state, below, above = generator.uniform(-1, 1, (3, 2))
        assert at(rate, state, below, below) == pytest.approx(at(h.value, state, below, below))
        now = at(rate, state, below, above)
        speeds = np.array([at(e, state, below, above) for e in h.speeds])
        for k in range(2):
            rise = generator.uniform(0, 1) * np.eye(2)[k]
            most = speeds @ rise + 2e-9
            assert 0 <= at(rate, state, below, above + rise) - now + 1e-9 <= most
            assert 0 <= now - at(rate, state, below + rise, above) + 1e-9 <= most
        higher = at(rate, state, below + 1, above - 1)  # the value at the node itself
        assert 0 <= now - higher + 1e-9 <= speeds.sum() + 2e-9
