"""Hamiltonians over points of the inputs and disturbances, against a search among the points."""

import itertools
import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator
from tests.conftest import number_at

X, Y, U, V, H, D = (hf.symbol(n) for n in ("x", "y", "u", "v", "h", "d"))
TURN = hf.Box((-sp.pi,), (sp.pi,))
UNIT = hf.Box((-1,), (1,))


def quantities(*names):
    return tuple(hf.Quantity(n, "1") for n in names)


def system(rates, inputs, bounds, disturbances=(), disturbance_bounds=None):
    return hf.System(
        "s", quantities("x", "y"), quantities(*inputs), dict(zip(("x", "y"), rates, strict=True)),
        disturbances=quantities(*disturbances),
        input_bounds=bounds, disturbance_bounds=disturbance_bounds,
    )  # fmt: skip


def states_and_costates(h, count=20):
    generator = np.random.default_rng(0)
    for x, y, p, q in generator.uniform(-2, 2, (count, 4)):
        yield {X: x, Y: y, h.costates[0]: p, h.costates[1]: q}


def flow(system, h, at, chosen):
    rates = [number_at(r, at | chosen) for r in system.rates.values()]
    return rates, sum(float(at[p]) * r for p, r in zip(h.costates, rates, strict=True))


@pytest.mark.few("min-min")
@pytest.mark.parametrize(("inputs", "disturbances"), [*itertools.product(("max", "min"), repeat=2)])
def test_the_disturbance_answers_the_input(inputs, disturbances):
    """Here neither has a closed form, and it matters who chooses first."""
    s = system((Y + sp.cos(H + D), sp.sin(H + D) * X), ("h",), TURN, ("d",), hf.Box((-2,), (2,)))
    h = hf.hamiltonian(s, inputs=inputs, disturbances=disturbances, samples=5)
    assert not h.separable
    pick = {"max": max, "min": min}
    angles, pushes = np.linspace(-math.pi, math.pi, 5), np.linspace(-2, 2, 5)
    for at in states_and_costates(h):
        table = [[flow(s, h, at, {H: a, D: d}) for d in pushes] for a in angles]
        answered = pick[inputs](pick[disturbances](f for _, f in row) for row in table)
        assert number_at(h.value, at) == pytest.approx(answered)
        chosen = {H: h.inputs["h"].subs(at), D: h.disturbances["d"].subs(at)}
        assert flow(s, h, at, chosen)[1] == pytest.approx(answered)
        for i, speed in enumerate(h.speeds):
            most = max(abs(rates[i]) for row in table for rates, _ in row)
            assert number_at(speed, at) == pytest.approx(most)


def test_the_lower_value_is_below_what_an_input_that_answers_would_get():
    s = system((sp.cos(H + D), Y), ("h",), TURN, ("d",), hf.Box((-sp.pi,), (sp.pi,)))
    h = hf.hamiltonian(s, samples=9)
    at = {X: 0, Y: 0, h.costates[0]: 1, h.costates[1]: 0}
    assert number_at(h.value, at) == pytest.approx(-1)  # max_d min_h the other way about: +1


@pytest.mark.heavy
def test_only_what_has_no_closed_form_is_sampled():
    """A speed and a heading: at every heading the best speed is one of its ends, exactly."""
    s = system(
        (V * sp.cos(H), V * sp.sin(H) + D), ("v", "h"), hf.Box((-0.3, -sp.pi), (1, sp.pi)),
        ("d",), UNIT,
    )  # fmt: skip
    h = hf.hamiltonian(s, samples=33)
    assert h.separable
    assert h.samples == 33
    for at in states_and_costates(h):
        p, q = (float(at[c]) for c in h.costates)
        assert number_at(h.value, at) == pytest.approx(math.hypot(p, q) - abs(q), abs=0.02)
        assert number_at(h.inputs["v"], at) in (pytest.approx(1), pytest.approx(-0.3))
        assert number_at(h.disturbances["d"], at) == pytest.approx(-np.sign(q))


def test_33_headings_get_half_a_percent_less_than_all_of_them():
    """At worst, and a disturbance of as many headings costs so much less."""
    for players, sign in (({"inputs": "max"}, 1), ({"inputs": "min"}, -1)):
        h = hf.hamiltonian(system((sp.cos(H), sp.sin(H)), ("h",), TURN), samples=33, **players)
        directions = np.linspace(0, 2 * math.pi, 257)
        costates = np.stack([np.cos(directions), np.sin(directions)], axis=1)
        got = sign * Evaluator([h.value], h.costates, ()).values(costates)
        assert got.max() == pytest.approx(1.0)
        assert 1 - got.min() == pytest.approx(0.005, abs=0.0005)


@pytest.mark.parametrize("samples", [2, 9])
def test_disturbance_that_multiplies_the_input_keeps_its_closed_form(samples):
    """x' = (1 + d) u, |d| <= 0.3: max_u min_d is 0.7 |p|, met at the ends of u."""
    s = system(((1 + D) * U, Y), ("u",), UNIT, ("d",), hf.Box((-0.3,), (0.3,)))
    h = hf.hamiltonian(s, samples=samples)
    assert not h.separable
    for at in states_and_costates(h):
        p, q = (float(at[c]) for c in h.costates)
        assert number_at(h.value, at) == pytest.approx(0.7 * abs(p) + q * float(at[Y]))
        assert number_at(h.inputs["u"], at) == np.sign(p)
        assert number_at(h.disturbances["d"], at) == pytest.approx(-0.3)
        assert number_at(h.speeds[0], at) == pytest.approx(1.3)


@pytest.mark.parametrize(
    ("bounds", "samples", "count"),
    [
        (hf.Box((-1, 2), (1, 5)), 3, 9),
        (hf.Ball(sp.Float(2), 2), 3, 9),
        (hf.Ball(sp.Float(2), 1), 9, 3),
        (hf.Ball(sp.Float(2), 3), 2, 9),
        (hf.LinearImage(sp.Matrix([[1, 1], [0.3, -0.3]]), hf.Box((-2, -1), (1, 2))), 4, 16),
        (hf.Product((hf.Box((-1,), (1,)), hf.Ball(sp.Float(0.5), 2))), 3, 27),
    ],
)
def test_points_lie_in_the_set_and_reach_its_ends(bounds, samples, count):
    from holdfast.maths.games.hamiltonian import points_of

    members = [hf.symbol(f"m{i}") for i in range(bounds.dimension)]
    points = points_of(bounds, members, set(members), samples)
    assert len(points) == count
    rows = [[float(point[m]) for m in members] for point in points]
    assert all(bounds.contains(row) for row in rows)
    free = [hf.symbol(f"f{i}") for i in range(bounds.dimension)]
    for sign, i in itertools.product((1, -1), range(bounds.dimension)):
        far = [1e6 * sign if k == i else 0 for k in range(len(free))]
        if not isinstance(bounds, hf.LinearImage) and samples == 3:
            corner = float(bounds.saturate([sp.Float(v) for v in far])[i])
            assert max(sign * row[i] for row in rows) == pytest.approx(sign * corner)


def test_what_jumps_is_not_taken_for_affine():
    """The derivative of sgn is zero, and that of wrap is one: neither makes a constant gain."""
    from holdfast.maths.expressions.functions import select, sgn, wrap

    for rate in (sgn(U), wrap(3 * U), select(U, 2, -1)):
        s = system((rate, Y), ("u",), UNIT)
        with pytest.raises(DefinitionError, match="the rate of 'x' is not affine in 'u'"):
            hf.hamiltonian(s)
    h = hf.hamiltonian(system((sgn(U), Y), ("u",), UNIT), samples=2)
    for at in states_and_costates(h):
        p, q = (float(at[c]) for c in h.costates)
        assert number_at(h.value, at) == pytest.approx(abs(p) + q * float(at[Y]))


def test_samples_that_cannot_be_used_are_refused():
    boat = system((sp.cos(H), sp.sin(H)), ("h",), TURN)
    with pytest.raises(DefinitionError, match=r"for example samples=9 \(of a kernel; for a filter"):
        hf.hamiltonian(boat)
    for bad in (1, -3, True, 2.5, "9", math.nan):
        with pytest.raises(DefinitionError, match=r"samples: .*; expected a whole number of at"):
            hf.hamiltonian(boat, samples=bad)
    affine = system((U, Y), ("u",), UNIT)
    with pytest.raises(
        DefinitionError, match=r"samples: 9, but .* closed form exists; leave out samples"
    ):
        hf.hamiltonian(affine, samples=9)
    both = system((sp.cos(H + D), Y), ("h",), TURN, ("d",), UNIT)
    with pytest.raises(
        DefinitionError,
        match="21 points of the inputs times 21 points of the disturbances make 441 pairs; expected at most 400",
    ):
        hf.hamiltonian(both, samples=21)
    free = system((sp.cos(H), Y), ("h",), hf.Box((-sp.oo,), (sp.oo,)))
    with pytest.raises(
        DefinitionError, match=r"unbounded; expected finite bounds; give the largest"
    ):
        hf.hamiltonian(free, samples=9)
