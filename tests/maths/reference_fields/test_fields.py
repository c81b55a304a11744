"""Fields: what is refused, how critical points are found and classified, closed flow lines."""

import itertools
import math

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from holdfast.errors import DefinitionError
from holdfast.maths.catalogue import fields
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.reference_fields.critical_points import (
    axially_symmetric,
    classify,
    frame,
    invariance_residuals,
    meridian,
    plane_by_plane,
    winding_number,
)
from holdfast.maths.reference_fields.facts import (
    critical_points,
    exact_flow,
    field_facts,
    first_integral,
    flow_line,
    loop_exponent,
)
from holdfast.maths.reference_fields.field import Field

X, Y, Z = (symbol(n) for n in "xyz")
LAM = symbol("lam")


def field_of(*components, **more):
    """A hand-built field of x, y (and z)."""
    names = "xyz"[: len(components)]
    return Field("mine", tuple(Quantity(n, "m") for n in names), components, **more)


def kinds(point):
    return [sector.kind for sector in point.sectors]


@pytest.mark.parametrize("value", ["no", 3, None])
def test_choice_of_the_exponential_is_a_yes_or_a_no(value):
    with pytest.raises(DefinitionError, match="expected true or false"):
        fields.dipole_like(exponential=value)


@pytest.mark.few("dipolar")
@pytest.mark.parametrize("function", fields.ALL, ids=lambda f: f.__name__)
def test_every_field_is_described_with_its_source_and_facts(function):
    field = function()
    assert field.name == function.__name__
    assert field.description
    assert "thesis" in field.source
    assert all(p.description and p.unit for p in field.parameters)
    text = "\n".join(field_facts(field))
    if function is fields.charge_pair:
        assert "2 zeros: (-0.4, 0); (0.4, 0)" in text
        assert text.count("node, one parabolic sector, index 1") == 2
        return
    assert "vanishes at the origin only (exact" in text
    assert "rose, two elliptic sectors, index 2" in text


@pytest.mark.parametrize(
    ("definition", "complaint"),
    [
        (lambda: field_of(X), "1 coordinates; expected two or more"),
        (lambda: Field("f", (Quantity("x"), Quantity("y")), (X,)), "1 components; expected 2"),
        (lambda: field_of(X, Z), "undeclared name 'z'"),
        (lambda: field_of(X, Y, factor=Z), "the factor of field 'mine' uses the undeclared"),
        (lambda: field_of(X, Y, moment=(1,)), "moment of dimension 1"),
        (lambda: field_of(X, Y, moment=(0, 0)), "moment p is zero"),
        (lambda: field_of(X, Y, moment=(LAM, 0)), "undeclared name 'lam'"),
        (lambda: field_of(X, Y, factor=X), "expected a positive number away from the origin"),
        (lambda: field_of(X, Y, parameters=(Parameter("x", value=1.0),)), "declares 'x' twice"),
        (lambda: fields.dipolar(lam=1.0), "expected above 1"),
        (lambda: fields.dipolar(moment=(0.0, 0.0)), "moment p is zero"),
        (lambda: fields.dipolar(moment=(math.nan, 1.0)), "expected finite numbers"),
        (lambda: fields.dipole_like(lam=0.9), "lambda >= 1"),
        (lambda: fields.dipole_like(lam=math.nan), "lambda >= 1"),
        (lambda: fields.electric_dipole(moment=(1, 0, 0, 0)), "a moment of 3 numbers"),
        (lambda: fields.electric_dipole(eps0=0.0), "expected above 0"),
    ],
)
def test_contradictory_field_is_refused(definition, complaint):
    with pytest.raises(DefinitionError, match=complaint.replace("(", r"\(")):
        definition()


CLASSICS = {
    "saddle": ((X, -Y), -1, "cross point", ["hyperbolic"] * 4),
    "unequal node": ((X, 2 * Y), 1, "node", ["parabolic"] * 4),
    "star node": ((-X, -Y), 1, "node", ["parabolic"]),
    "improper node": ((X, X + Y), 1, "node", ["parabolic"] * 2),
    "centre": ((-Y, X), 1, "centre or focus", []),
    "focus": ((X - Y, X + Y), 1, "centre or focus", []),
    "monkey saddle": ((X**2 - Y**2, -2 * X * Y), -2, "cross point", ["hyperbolic"] * 6),
    "dipole": ((X**2 - Y**2, 2 * X * Y), 2, "rose", ["elliptic"] * 2),
    "four loops": ((X**3 - 3 * X * Y**2, 3 * X**2 * Y - Y**3), 3, "rose", ["elliptic"] * 4),
    "saddle-node": (
        (X**2, -Y),
        0,
        "mixed",
        ["hyperbolic", "parabolic", "parabolic", "hyperbolic"],
    ),
    "cubic node": ((X**3, Y**3), 1, "node", ["parabolic"] * 8),
}


@pytest.mark.slow("monkey saddle", "four loops", "cubic node")
@pytest.mark.parametrize("name", CLASSICS)
def test_classic_critical_point_has_its_textbook_sectors(name):
    components, index, kind, sectors = CLASSICS[name]
    point = classify(field_of(*components))
    assert (point.kind, point.index, kinds(point)) == (kind, index, sectors)


@pytest.mark.few("star node", "focus")
@pytest.mark.parametrize("name", CLASSICS)
def test_bendixson_index_of_sectors_is_the_winding_number(name):
    components, *_ = CLASSICS[name]
    field = field_of(*components)
    assert classify(field).index == winding_number(field, 0.5)
    # turned and stretched: the directions are no longer those of the axes
    c, s = sp.Rational(3, 5), sp.Rational(4, 5)
    at = {X: c * X + s * Y, Y: 2 * (c * Y - s * X)}
    f, g = (sp.expand(e.subs(at, simultaneous=True)) for e in components)
    turned = field_of(c * f - s * g / 2, s * f + c * g / 2)
    assert classify(turned).index == winding_number(turned, 0.5) == classify(field).index
    assert classify(turned).kind == classify(field).kind


def test_sectors_follow_one_another_once_round():
    for components, *_ in CLASSICS.values():
        sectors = classify(field_of(*components)).sectors
        for a, b in itertools.pairwise(sectors):
            assert sp.simplify(a.end - b.start) == 0
        if sectors:
            turn = sum(float(s.end - s.start) for s in sectors)
            assert turn == pytest.approx(2 * math.pi, abs=1e-12)


@pytest.mark.parametrize(
    ("components", "complaint"),
    [
        ((Y, X**2), "no radial motion along the direction"),
        ((X**2, X * Y + Y**3), "every direction is characteristic"),
        ((X * 0, Y), "no motion at all along"),
        ((sp.sqrt(X**2 + Y**2) * X, Y / (X**2 + Y**2)), "not smooth at the point"),
        ((sp.Abs(X), Y), "not smooth at the point"),
        ((X + 1, Y), "not zero at the point"),
        ((X**13, Y**13), "no part of degree 12"),
    ],
)
def test_undecided_critical_point_is_refused_not_guessed(components, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        classify(field_of(*components))


def test_classification_without_a_value_holds_for_every_value_or_says_at_which():
    a = Parameter("a", value=2.0, above=0)
    focus_or_node = field_of(X, a.symbol * Y, parameters=(a,))
    assert classify(focus_or_node).validity == "at a = 2"  # a = 1 is a star
    saddle = field_of(X, -a.symbol * Y, parameters=(a,))
    assert classify(saddle).validity == "for every a > 0"
    assert classify(saddle).kind == "cross point"


def test_field_in_space_is_not_given_a_planar_index():
    field = fields.dipolar(moment=(1.0, 0.0, 0.0))
    with pytest.raises(DefinitionError, match="plane by plane"):
        classify(field)
    with pytest.raises(DefinitionError, match="only planar fields wind"):
        winding_number(field, 1.0)


def test_winding_number_on_a_circle_through_a_zero_is_refused():
    two_nodes = fields.dipole_like(exponential=False)
    with pytest.raises(DefinitionError, match="take another radius"):
        winding_number(two_nodes, 3**-0.5)
    assert winding_number(two_nodes, 0.3) == 0
    assert winding_number(two_nodes, 1.0) == 2
    assert winding_number(two_nodes, 0.3, centre=(3**-0.5, 0.0)) == 1
    with pytest.raises(DefinitionError, match="a positive number"):
        winding_number(two_nodes, -1.0)


def test_fast_winding_is_resolved():
    """Re and Im of (x + i y)^n turn n times; of the conjugate, -n times."""
    for n in (5, 21):
        power = sp.expand((X + sp.I * Y) ** n)
        f, g = sp.re(power), sp.im(power)
        assert winding_number(field_of(f, g), 0.7, samples=8) == n
        assert winding_number(field_of(f, -g), 0.7, samples=8) == -n


def test_all_real_zeros_of_polynomials_are_found_exactly():
    zeros = critical_points(field_of(X**2 - 2, X * Y - Y**2))
    root = sp.sqrt(2)
    assert zeros.exact
    assert not zeros.unique
    assert set(zeros.points) == {(root, 0), (-root, 0), (root, root), (-root, -root)}
    assert sorted(c.index for c in zeros.critical_points) == [-1, -1, 1, 1]
    assert critical_points(field_of(X**2 + 1, Y)).points == ()


def test_line_of_zeros_is_refused():
    with pytest.raises(DefinitionError, match="share the factor x"):
        critical_points(field_of(X * Y, X * (X + 1)))


def test_search_in_a_box_never_claims_to_have_found_all():
    zeros = critical_points(field_of(sp.sin(X), Y + X**2), ((-4, 4), (-12, 2)))
    assert len(zeros.points) == 3
    assert not zeros.exact
    assert not zeros.unique
    assert "others are not excluded" in zeros.method
    assert "[-4, 4]" in zeros.method
    found = sorted(float(x) for x, _ in zeros.points)
    assert found == pytest.approx([-math.pi, 0.0, math.pi], abs=1e-9)
    assert [c.kind for c in zeros.critical_points] == ["cross point", "node", "cross point"]
    one = critical_points(field_of(sp.sinh(X) + Y, Y - X**2))
    assert not one.unique  # even one zero in the box is not a proof


def test_point_known_in_decimals_is_classified_only_where_its_jacobian_is_regular():
    near = field_of(sp.sin(X), Y)
    assert classify(near, (3.141592653589793, 0.0)).kind == "cross point"
    with pytest.raises(DefinitionError, match="Jacobian is singular"):
        classify(fields.dipolar(), (1e-12, 0.0))
    with pytest.raises(DefinitionError, match="not zero"):
        classify(near, (3.0, 0.0))


@pytest.mark.parametrize(
    "moment", [(1, 0, 0), (1, 2, 3), (0, 0, -2), (0.5, 0, 0, 1), (1, 0, 2, 0, 1)]
)
def test_frame_through_the_moment_is_orthonormal(moment):
    field = fields.dipolar(moment=moment)
    direction = [sp.Integer(3 - 2 * i) for i in range(len(moment))]
    for p, e in (frame(field), frame(field, direction)):
        for (a, b), product in (((p, p), 1), ((e, e), 1), ((p, e), 0)):
            assert sp.simplify(sum(x * y for x, y in zip(a, b, strict=True)) - product) == 0
    with pytest.raises(DefinitionError, match="parallel to the moment"):
        frame(field, moment)


def test_field_that_leaves_the_planes_through_its_axis_is_refused():
    twisted = field_of(X, Y - Z, Z + Y, moment=(1, 0, 0))
    assert any(r != 0 for r in invariance_residuals(twisted))
    with pytest.raises(DefinitionError, match="leaves the planes through p"):
        plane_by_plane(twisted)
    with pytest.raises(DefinitionError, match="not axially symmetric"):
        critical_points(twisted)
    squashed = field_of(X, 2 * Y, 3 * Z, moment=(1, 0, 0))
    assert not axially_symmetric(squashed)


def test_field_in_planes_that_differ_is_not_called_symmetric():
    """Planes are invariant, yet the transverse speed depends on which plane it is."""
    uneven = field_of(X, Y * (1 - 3 * Y**2), Z * (1 - 3 * Y**2), moment=(1, 0, 0))
    result = plane_by_plane(uneven, 4)
    assert not result.exact
    assert result.alike  # near the origin they are


def test_spheres_of_zeros_about_the_axis_are_refused():
    ring = field_of(X, Y * (Y**2 + Z**2 - 1), Z * (Y**2 + Z**2 - 1), moment=(1, 0, 0))
    with pytest.raises(DefinitionError, match="spheres about its axis"):
        critical_points(ring)


def test_meridian_keeps_the_field_in_its_plane():
    field = fields.dipolar(moment=(1, 2, 2), lam=2.5)
    p, e = frame(field, (0, 1, 4))
    plane = meridian(field, (0, 1, 4))
    generator = np.random.default_rng(3)
    for c, s in generator.uniform(-2, 2, (5, 2)):
        position = [c * float(a) + s * float(b) for a, b in zip(p, e, strict=True)]
        full = np.array(field.function(*position))
        along, across = plane.function(c, s)
        inside = along * np.array(p, float) + across * np.array(e, float)
        assert full == pytest.approx(inside, abs=1e-12 * np.abs(full).max())


@pytest.mark.parametrize("side", [1, -1])
def test_starts_on_the_axis_run_along_a_half_line_and_never_return(side):
    field = fields.dipolar(moment=(1.0, 1.0))
    line = flow_line(field, (side * 0.3, side * 0.3))
    assert line.kind == "half-line"
    assert line.forward == (side > 0)
    assert line.size == sp.oo
    tip = [float(c.subs(line.parameter, 2)) for c in line.curve]
    assert tip == pytest.approx([side * 2**0.5] * 2, abs=1e-14)


@pytest.mark.parametrize("start", [(0, 0), (0.0, 0.0)])
def test_line_through_the_origin_is_refused(start):
    field = fields.dipolar(lam=2.0)
    with pytest.raises(DefinitionError, match="off the origin"):
        flow_line(field, start)
    with pytest.raises(DefinitionError, match="off the origin"):
        exact_flow(field, start, 1.0)
    with pytest.raises(DefinitionError, match="start of dimension 3"):
        flow_line(field, (1, 0, 0))


def test_closed_form_is_refused_where_there_is_none():
    with pytest.raises(DefinitionError, match="not rho = R"):
        flow_line(fields.dipole_like(), (1, 1))
    with pytest.raises(DefinitionError, match="not the dipolar field of lambda = 2"):
        exact_flow(fields.dipolar(lam=3.0), (1, 1), 0.1)
    with pytest.raises(DefinitionError, match="not the dipolar field of lambda = 2"):
        exact_flow(fields.electric_dipole(), (1, 1, 0), 0.1)
    with pytest.raises(DefinitionError, match="no first integral"):
        first_integral(fields.dipole_like())
    assert loop_exponent(field_of(X, -Y, moment=(1, 0))) is None  # k = -1: hyperbolae


def test_exact_flow_on_the_axis_escapes_at_the_time_it_says():
    field = fields.dipolar(lam=2.0, moment=(2.0, 0.0))
    assert exact_flow(field, (0.25, 0), 1)[0] == sp.Rational(1, 2)  # xdot = 2 x^2
    with pytest.raises(DefinitionError, match="at infinity at t = 2 s"):
        exact_flow(field, (0.25, 0), 2)
    with pytest.raises(DefinitionError, match="at infinity at t = -2 s"):
        exact_flow(field, (-0.25, 0), -3)
    assert float(exact_flow(field, (-0.25, 0), 100)[0]) == pytest.approx(-1 / 204)


def test_reversed_field_runs_the_same_loops_backwards():
    field = fields.dipolar()
    back = field_of(*(-c.subs(LAM, 3) for c in field.components), moment=(1, 0))
    forth, reverse = flow_line(field, (0, 1)), flow_line(back, (0, 1))
    assert forth.curve == reverse.curve
    assert forth.forward
    assert not reverse.forward


def test_loops_of_the_field_are_tangent_to_it_everywhere():
    field = fields.dipolar(moment=(1, -2, 0.5), lam=2.7)
    line = flow_line(field, (0.3, 0.4, -1.0))
    tangent = [c.diff(line.parameter) for c in line.curve]
    for a in (0.2, 1.0, 1.9, 3.0):
        at = {line.parameter: a}
        f = np.array(field.function(*(float(c.subs(at)) for c in line.curve)))
        t = np.array([float(c.subs(at)) for c in tangent])
        assert f @ t / np.linalg.norm(f) / np.linalg.norm(t) == pytest.approx(1.0, abs=1e-12)


def test_integration_stays_on_the_closed_form_curve_in_time():
    """The independent integrator agrees with the line through its own start, point by point."""
    field = fields.dipolar(lam=2.0, moment=(1.0, 0.5))
    function = field.function
    run = solve_ivp(
        lambda _, x: function(*x), (0, 3), (0.4, -0.9), method="DOP853", rtol=1e-12, atol=1e-14
    )
    exact = [float(c) for c in exact_flow(field, (0.4, -0.9), 3)]
    assert run.y[:, -1] == pytest.approx(exact, abs=1e-11)
