"""The Hamiltonian in closed form against the best and the worst of many inputs."""

import itertools

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.games.hamiltonian import monotone_flux
from tests.conftest import number_at

X, Y, U, W, D = (hf.symbol(n) for n in ("x", "y", "u", "w", "d"))


def quantities(*names):
    return tuple(hf.Quantity(n, "1") for n in names)


def system(rates, inputs, bounds, disturbances=(), disturbance_bounds=None):
    return hf.System(
        "s", quantities("x", "y"), quantities(*inputs), dict(zip(("x", "y"), rates, strict=True)),
        disturbances=quantities(*disturbances),
        input_bounds=bounds, disturbance_bounds=disturbance_bounds,
    )  # fmt: skip


def boundary(bounds, count=721):
    """Points of a set, its corners and its rim among them."""
    if isinstance(bounds, hf.Product):
        parts = [boundary(part, count) for part in bounds.parts]
        return np.array([np.concatenate(rows) for rows in itertools.product(*parts)])
    if isinstance(bounds, hf.LinearImage):
        inner = boundary(bounds.of, count)
        return inner @ np.array(bounds.matrix, dtype=float).T
    if isinstance(bounds, hf.Ball):
        turn = np.linspace(0, 2 * np.pi, count)
        return float(bounds.radius) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ends = [(float(a), float(b)) for a, b in zip(bounds.lower, bounds.upper, strict=True)]
    return np.array(list(itertools.product(*ends)))


SETS = [
    hf.Box((-1, -0.5), (2, 0.7)),
    hf.Ball(sp.Float(1.3), 2),
    hf.LinearImage(sp.Matrix([[1, 1], [0.3, -0.3]]), hf.Box((-2, -1), (1, 2))),
]


@pytest.mark.parametrize("side", ["max", "min"])
@pytest.mark.parametrize("bounds", SETS)
def test_value_and_optimal_input_are_those_of_a_search(bounds, side):
    rates = (Y + sp.cos(X) * U, X * Y + U * sp.sin(Y) + W)
    s = system(rates, ("u", "w"), bounds)
    h = hf.hamiltonian(s, inputs=side)
    best = max if side == "max" else min
    candidates = boundary(bounds)
    generator = np.random.default_rng(0)
    for _ in range(20):
        x, y, p, q = generator.uniform(-2, 2, 4)
        at = {X: x, Y: y, h.costates[0]: p, h.costates[1]: q}
        flows = [p * (y + np.cos(x) * u) + q * (x * y + u * np.sin(y) + w) for u, w in candidates]
        assert number_at(h.value, at) == pytest.approx(best(flows), abs=2e-4)
        u, w = (number_at(h.inputs[n], at) for n in ("u", "w"))
        assert bounds.contains((u, w), slack=1e-9)
        flow = p * (y + np.cos(x) * u) + q * (x * y + u * np.sin(y) + w)
        assert flow == pytest.approx(number_at(h.value, at), abs=1e-9)


def test_disturbance_works_against_the_input():
    s = system((U + D, U), ("u",), hf.Box((-1,), (1,)), ("d",), hf.Box((-3,), (3,)))
    h = hf.hamiltonian(s)
    p, q = h.costates
    for a, b in [(1.0, 0.5), (-2.0, 0.3), (0.4, -1.0)]:
        at = {p: a, q: b}
        assert number_at(h.value, at) == pytest.approx(abs(a + b) - 3 * abs(a))
        assert number_at(h.disturbances["d"], at) == pytest.approx(-3 * np.sign(a))


def test_speeds_bound_the_slope_of_the_hamiltonian_and_the_tight_ones_are_tighter():
    s = system((Y + U * X, U + W), ("u", "w"), SETS[0])
    h = hf.hamiltonian(s)
    generator = np.random.default_rng(1)
    tighter = 0
    for _ in range(200):
        x, y, p, q, a, b = generator.uniform(-2, 2, 6)
        spread = (abs(a) * 0.2, abs(b) * 0.2)
        at = {X: x, Y: y}
        near = at | dict(zip((*h.costates, *h.spreads), (p, q, *spread), strict=True))
        loose = [number_at(e, at) for e in h.speeds]
        tight = [number_at(e, near) for e in h.tight_speeds]
        tighter += tight[0] < loose[0] - 1e-6
        one, two = (
            np.array([p, q]) + np.array(spread) * generator.uniform(-1, 1, 2) for _ in range(2)
        )
        for k in range(2):
            other = one.copy()
            other[k] = two[k]
            rise = number_at(h.value, at | dict(zip(h.costates, one, strict=True))) - number_at(
                h.value, at | dict(zip(h.costates, other, strict=True))
            )
            gap = abs(one[k] - other[k])
            assert abs(rise) <= tight[k] * gap + 1e-9
            assert tight[k] <= loose[k] + 1e-9
    assert tighter > 50


@pytest.mark.parametrize("bounds", [hf.Box((-1,), (1,)), hf.Ball(1, 1)])
def test_no_rounding_of_a_flat_value_decides_how_fast_an_input_may_be(bounds):
    """Of the slopes 0 above and 1 below, only one end is where the input switches."""
    h = hf.hamiltonian(system((U / 2 + sp.Rational(1, 4), Y), ("u",), bounds), inputs="min")

    def fastest(above):
        near = ((above + 1) / 2, 0, abs(above - 1) / 2, 0)
        return number_at(h.tight_speeds[0], dict(zip((*h.costates, *h.spreads), near, strict=True)))

    assert [fastest(a) for a in (1e-3, 1e-16, 0.0, -1e-16, -1e-9)] == pytest.approx([0.25] * 5)
    assert fastest(-1e-3) == pytest.approx(0.75)


def test_a_ball_of_one_input_is_an_interval():
    ball, box = (
        hf.hamiltonian(system((U * X + D, Y), ("u",), b, ("d",), hf.Box((-0.3,), (0.2,))))
        for b in (hf.Ball(sp.Float(0.6), 1), hf.Box((-0.6,), (0.6,)))
    )
    gaps = sp.symbols("g0:2", real=True)
    assert ball.tight_speeds == box.tight_speeds
    for row in np.random.default_rng(2).uniform(-1, 1, (50, 6)):
        at = dict(zip((X, Y, *ball.costates, *gaps), row, strict=True))
        one, other = (number_at(monotone_flux(h, gaps), at) for h in (ball, box))
        assert one == pytest.approx(other, abs=1e-12)


@pytest.mark.parametrize(
    ("rates", "bounds", "complaint"),
    [
        ((sp.sin(U), Y), hf.Box((-1,), (1,)), "the rate of 'x' is not affine in 'u'"),
        ((U, Y), None, "has no bounds for its inputs"),
        ((U, Y), hf.Box((-sp.oo,), (sp.oo,)), "is unbounded"),
    ],
)
def test_systems_without_a_closed_form_are_refused(rates, bounds, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.hamiltonian(system(rates, ("u",), bounds))


def test_products_of_input_and_disturbance_are_refused():
    s = system((U * D, Y), ("u",), hf.Box((-1,), (1,)), ("d",), hf.Box((-1,), (1,)))
    with pytest.raises(
        DefinitionError, match="not affine in 'u': its derivative by it depends on 'd'"
    ):
        hf.hamiltonian(s)


def test_a_side_is_the_most_or_the_least():
    s = system((U, Y), ("u",), hf.Box((-1,), (1,)))
    with pytest.raises(DefinitionError, match='expected "max" or "min"'):
        hf.hamiltonian(s, inputs="best")


def test_product_is_the_sum_of_what_its_parts_can_do():
    """A current in a ball and a sway velocity in an interval, each working for itself."""
    v, w, z = (hf.symbol(n) for n in ("v", "w", "z"))
    both = hf.Product((hf.Box((-0.6,), (0.4,)), hf.Ball(sp.Float(0.5), 2)))
    s = hf.System(
        "s", quantities("x", "y"), (), {"x": w - v * sp.sin(X), "y": z + v * sp.cos(X) + X},
        disturbances=quantities("v", "w", "z"), disturbance_bounds=both,
    )  # fmt: skip
    h = hf.hamiltonian(s)
    candidates = boundary(both)
    generator = np.random.default_rng(3)
    for _ in range(20):
        x, y, p, q = generator.uniform(-2, 2, 4)
        at = {X: x, Y: y, h.costates[0]: p, h.costates[1]: q}
        a, b, c = candidates.T
        flows = p * (b - a * np.sin(x)) + q * (c + a * np.cos(x) + x)
        assert number_at(h.value, at) == pytest.approx(flows.min(), abs=2e-4)
        worst = [number_at(h.disturbances[n], at) for n in ("v", "w", "z")]
        assert both.contains(worst, slack=1e-9)
        for i, speeds in enumerate((np.abs(b - a * np.sin(x)), np.abs(c + a * np.cos(x) + x))):
            assert number_at(h.speeds[i], at) >= speeds.max() - 1e-9
    assert both.saturate((hf.symbol("a"), sp.Float(3), sp.Float(4)))[1:] == pytest.approx(
        (0.3, 0.4)
    )
