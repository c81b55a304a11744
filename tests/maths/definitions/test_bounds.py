"""Saturation: the admissible input taken in place of the wanted one."""

import math

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import product

A, B, L, F = (hf.symbol(n) for n in ("a", "b", "l", "F"))
reals = st.floats(-50, 50)


def saturated(bounds, a, b, **parameters):
    values = {A: a, B: b} | {hf.symbol(k): v for k, v in parameters.items()}
    return [float(e.subs(values)) for e in bounds.saturate((A, B))]


THRUSTERS = hf.LinearImage(sp.Matrix([[1, 1], [-L, L]]), hf.Box((-F, -F), (F, F)))


@given(reals, reals)
def test_box_clips_each_component(a, b):
    box = hf.Box((-1, -sp.oo), (2, sp.oo))
    assert saturated(box, a, b) == pytest.approx([min(max(a, -1), 2), b])


@given(reals, reals)
def test_ball_shortens_and_keeps_the_direction(a, b):
    got = saturated(hf.Ball(2, 2), a, b)
    size = math.hypot(a, b)
    scale = 1 if size <= 2 else 2 / size
    assert got == pytest.approx([scale * a, scale * b], abs=1e-12)


@given(reals, reals)
def test_force_and_moment_come_from_two_thrusters_each_within_its_limit(a, b):
    force, moment = saturated(THRUSTERS, a, b, l=0.1, F=5)
    port, starboard = (force - moment / 0.1) / 2, (force + moment / 0.1) / 2
    assert abs(port) <= 5 + 1e-9
    assert abs(starboard) <= 5 + 1e-9
    wanted = ((a - b / 0.1) / 2, (a + b / 0.1) / 2)
    assert port == pytest.approx(min(max(wanted[0], -5), 5), abs=1e-9)
    assert starboard == pytest.approx(min(max(wanted[1], -5), 5), abs=1e-9)


@pytest.mark.heavy
@given(reals, reals)
def test_every_saturated_input_is_admissible(a, b):
    parameters = {L: 0.1, F: 5}
    for bounds in (hf.Box((-1, -2), (1, 2)), hf.Ball(3, 2), THRUSTERS):
        got = [float(e.subs({A: a, B: b} | parameters)) for e in bounds.saturate((A, B))]
        assert bounds.at(parameters).contains(got)


def test_three_thrusters_share_the_force_evenly():
    image = hf.LinearImage(sp.Matrix([[1, 1, 1]]), hf.Box((-1,) * 3, (1,) * 3))
    assert image.allocate((A,)) == (A / 3, A / 3, A / 3)


@pytest.mark.parametrize(
    ("build", "complaint"),
    [
        (lambda: hf.Box((0,), (1, 2)), "as many of each"),
        (lambda: hf.Box((2,), (1,)), "empty interval"),
        (lambda: hf.Ball(-1, 2), "radius >= 0"),
        (lambda: hf.Ball(1, 0), "at least 1"),
        (lambda: hf.LinearImage(sp.Matrix([[1, 1]]), hf.Box((0,), (1,))), "2 columns"),
        (lambda: hf.LinearImage(sp.Matrix([[1, 1], [2, 2]]), hf.Box((0, 0), (1, 1))), "dependent"),
    ],
)
def test_impossible_bounds_are_refused(build, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        build()


def test_ranges_are_the_extremes_that_some_member_takes():
    """The force of two thrusters goes to 2 F, the moment to 2 F b; of a ball to its radius."""
    box = hf.Box((-2, -1), (2, 3))
    image = hf.LinearImage(sp.Matrix([[1, 1], [0.1, -0.1]]), box, ("port", "starboard"))
    assert box.ranges() == [(-2, 2), (-1, 3)]
    assert image.ranges() == [(-3, 5), (pytest.approx(-0.5), pytest.approx(0.3))]
    assert hf.Ball(2, 2).ranges() == [(-2, 2), (-2, 2)]
    assert hf.LinearImage(sp.Matrix([[3, 4]]), hf.Ball(2, 2)).ranges() == [(-10, 10)]
    assert product(box, hf.Ball(1, 1)).ranges() == [(-2, 2), (-1, 3), (-1, 1)]
    assert hf.Box((-sp.oo,), (1,)).ranges() == [(-sp.oo, 1)]


@pytest.mark.parametrize(
    ("dimension", "sides", "share"), [(1, 2, 1.0), (2, 32, 0.99), (3, 98, 0.93)]
)
def test_polytope_of_a_filter_lies_in_the_ball_and_fills_it(dimension, sides, share):
    rows = hf.Ball(2.0, dimension).inscribed()
    normals = np.array([[float(e) for e in normal] for normal, _ in rows])
    offsets = np.array([float(offset) for _, offset in rows])
    assert len(rows) == sides
    drawn = np.random.default_rng(0).normal(size=(20_000, dimension))
    drawn /= np.linalg.norm(drawn, axis=1)[:, np.newaxis]
    reach = (offsets / np.maximum(drawn @ normals.T, 1e-9)).min(axis=1)  # from the middle outwards
    assert reach.max() <= 2.0 * (1 + 1e-12)
    assert reach.min() >= share * 2.0
