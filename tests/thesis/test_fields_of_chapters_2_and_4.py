"""Chapters 2 and 4, the reference fields: the claims that hold and those that do not.

Each closed form is compared with an independent integration (DOP853), each index with the
winding number, each sector with where integrated lines begin and end.
"""

import math

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from holdfast.errors import DefinitionError
from holdfast.maths.catalogue import fields
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.reference_fields.critical_points import (
    classify,
    plane_by_plane,
    symmetry_residuals,
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

X, Y, LAM = symbol("x"), symbol("y"), symbol("lam")
MOMENTS = {
    2: (math.cos(0.7), math.sin(0.7)),
    3: (1.0, -0.5, 0.3),
    5: (0.2, 1.0, -0.4, 0.0, 0.7),
}


def arc(field, start, sense=1.0, length=40.0, near=1e-3, far=math.inf):
    """The line through a start by arc length, until it is near the origin or far off."""
    function = field.function

    def rate(_, x):
        value = np.array(function(*x))
        return sense * value / np.linalg.norm(value)

    def leaves(_, x):
        return np.linalg.norm(x) - far

    def arrives(_, x):
        return np.linalg.norm(x) - near

    leaves.terminal = arrives.terminal = True
    events = [arrives] if far == math.inf else [arrives, leaves]
    run = solve_ivp(
        rate, (0, length), start, method="DOP853", rtol=1e-12, atol=1e-14, events=events
    )
    end = "origin" if len(run.t_events[0]) else "far" if run.status == 1 else "unfinished"
    return run.y.T, end


def below_one(lam):
    """The dipolar field as printed, for a lambda that the catalogue refuses: 0 < lambda < 1."""
    components = ((LAM - 1) * X**2 - Y**2, LAM * X * Y)
    return Field(
        "dipolar_below_one",
        (Quantity("x", "m"), Quantity("y", "m")),
        components,
        moment=(1, 0),
        parameters=(Parameter("lam", value=lam, above=0),),
    )


@pytest.mark.smoke
def test_components_are_those_printed_in_the_thesis():
    dipolar = fields.dipolar(lam=3).components
    assert [sp.expand(c.subs(LAM, 3)) for c in dipolar] == [2 * X**2 - Y**2, 3 * X * Y]  # (4.10)
    like = fields.dipole_like(lam=3).components  # (2.8a), (2.8b)
    assert like[0].subs(LAM, 3) == 3 * X**2 - 1 + sp.exp(-(X**2) - Y**2)
    assert like[1].subs(LAM, 3) == 3 * X * Y
    x, y, z = (symbol(n) for n in "xyz")
    ndi = [sp.expand(c.subs(LAM, 3)) for c in fields.dipolar(moment=(1, 0, 0)).components]
    assert ndi == [2 * x**2 - y**2 - z**2, 3 * x * y, 3 * x * z]  # (4.16)


def test_electric_field_is_minus_the_gradient_of_the_dipole_potential():
    field = fields.electric_dipole(moment=(1.0, 2.0, -0.5))
    eps0, r = symbol("eps0"), sp.sqrt(sum(s**2 for s in field.symbols))
    along = sum(p * s for p, s in zip(field.moment, field.symbols, strict=True))
    potential = along / (4 * sp.pi * eps0 * r**3)  # (2.4)
    for component, s in zip(field.vector, field.symbols, strict=True):
        assert sp.simplify(component + potential.diff(s)) == 0


def test_electric_field_has_the_printed_polar_components():
    """(2.5): E_r = 2 p cos a / (4 pi eps0 r^3), E_a = p sin a / (4 pi eps0 r^3), in V/m."""
    field = fields.electric_dipole(moment=(3e-9, 0.0))
    a, r = 0.8, 0.25
    at = {X: r * math.cos(a), Y: r * math.sin(a)} | field.values
    ex, ey = (float(c.subs(at)) for c in field.vector)
    scale = 3e-9 / (4 * math.pi * 8.8541878128e-12 * r**3)
    assert ex * math.cos(a) + ey * math.sin(a) == pytest.approx(2 * scale * math.cos(a), rel=1e-12)
    assert ey * math.cos(a) - ex * math.sin(a) == pytest.approx(scale * math.sin(a), rel=1e-12)
    assert field.unit == "V/m"
    assert loop_exponent(field) == 2  # r = R sin^2 a


@pytest.mark.parametrize("dimension", MOMENTS)
@pytest.mark.parametrize("lam", [1.5, 2.0, 3.0, 4.5])
def test_integrated_lines_stay_on_the_closed_form_in_every_dimension(dimension, lam):
    """rho / |sin a|^(lam-1) spreads by no more than 5e-10 along the integrated line."""
    field = fields.dipolar(lam=lam, moment=MOMENTS[dimension])
    p = np.array(MOMENTS[dimension]) / np.linalg.norm(MOMENTS[dimension])
    generator = np.random.default_rng(dimension)
    for _ in range(3):
        across = generator.uniform(-1, 1, dimension)
        across -= (across @ p) * p
        angle = generator.uniform(0.5, 2.6)  # from p: near the axis loops grow without bound
        start = math.cos(angle) * p + math.sin(angle) * across / np.linalg.norm(across)
        points, end = arc(field, start, near=0.05)
        assert end == "origin"
        rho = np.linalg.norm(points, axis=1)
        across = np.linalg.norm(points - np.outer(points @ p, p), axis=1)
        sizes = rho / (across / rho) ** (lam - 1)
        line = flow_line(field, start)
        assert sizes == pytest.approx(float(line.size), rel=5e-10)
        angle = np.arctan2(across, points @ p)
        curve = sp.lambdify(line.parameter, line.curve, "numpy")(angle)
        assert np.abs(np.array(curve).T - points).max() < 5e-10 * float(line.size)


@pytest.mark.parametrize("dimension", MOMENTS)
@pytest.mark.parametrize("lam", [1.5, 2.0, 3.0])
def test_each_line_leaves_and_reaches_the_origin_along_the_moment(dimension, lam):
    field = fields.dipolar(lam=lam, moment=MOMENTS[dimension])
    line = flow_line(field, np.random.default_rng(1).uniform(-1, 1, dimension))
    p = np.array(MOMENTS[dimension]) / np.linalg.norm(MOMENTS[dimension])
    tangent = [c.diff(line.parameter) for c in line.curve]
    for a in (1e-9, math.pi - 1e-9):
        t = np.array([float(sp.N(c.subs(line.parameter, sp.Float(a, 30)), 20)) for c in tangent])
        assert t @ p / np.linalg.norm(t) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("lam", [1.5, 2.0, 3.0])
def test_conserved_quantity_has_no_rate_along_the_field(lam):
    for field in (
        fields.dipolar(lam=lam, moment=(1, 2)),
        fields.dipolar(lam=lam, moment=(1, 0, 2)),
        fields.dipole_like(lam=lam, moment=(1, 2), exponential=False),
        fields.electric_dipole(),
    ):
        conserved = first_integral(field).subs(field.values)
        generator = np.random.default_rng(5)
        for _ in range(10):
            at = dict(zip(field.symbols, generator.uniform(-2, 2, field.dimension), strict=True))
            gradient = np.array([float(conserved.diff(s).subs(at)) for s in field.symbols])
            value = np.array(field.function(*at.values()))
            scale = np.linalg.norm(gradient) * np.linalg.norm(value)
            assert abs(gradient @ value) < 1e-13 * scale


@pytest.mark.parametrize("dimension", MOMENTS)
def test_inversion_solves_the_field_of_lambda_two_exactly(dimension):
    field = fields.dipolar(lam=2.0, moment=MOMENTS[dimension])
    start = np.random.default_rng(7).uniform(-1, 1, dimension)
    function = field.function
    times = np.array([0.1, 0.5, 1.0, 3.0])
    run = solve_ivp(
        lambda _, x: function(*x),
        (0, 3),
        start,
        method="DOP853",
        t_eval=times,
        rtol=1e-13,
        atol=1e-16,
    )
    for t, reached in zip(times, run.y.T, strict=True):
        exact = [float(c) for c in exact_flow(field, start, t)]
        assert np.abs(reached - exact).max() < 1e-12


@pytest.mark.parametrize("lam", [1.01, 1.5, 2.0, 3.0, 10.0])
@pytest.mark.parametrize("direction", [0.0, 0.7, math.pi / 4, 2.5])
def test_origin_of_the_planar_dipolar_field_is_a_rose_of_index_two(lam, direction):
    field = fields.dipolar(lam=lam, moment=(math.cos(direction), math.sin(direction)))
    point = classify(field)
    assert (point.kind, point.index, point.count("elliptic")) == ("rose", 2, 2)
    assert point.validity == "for every lam > 1"
    assert float(point.sectors[0].start) == pytest.approx(direction, abs=1e-12)
    assert critical_points(field).unique
    for radius in (0.01, 1.0, 30.0):
        assert winding_number(field, radius) == 2


@pytest.mark.parametrize("lam", [0.1, 0.5, 0.9])
def test_below_lambda_one_the_origin_is_no_rose_but_two_hyperbolic_sectors(lam):
    field = below_one(lam)
    point = classify(field)
    assert (point.kind, point.index) == ("cross point", 0)
    assert point.count("hyperbolic") == 2
    assert winding_number(field, 0.5) == 0
    with pytest.raises(DefinitionError, match="above 1"):
        fields.dipolar(lam=lam)
    for sense in (1, -1):  # no line but the axis reaches the origin
        points, end = arc(field, (0.1, 0.3), sense, near=1e-2, far=20.0, length=500)
        assert end == "far"
        assert np.linalg.norm(points, axis=1).min() > 0.05


@pytest.mark.smoke
def test_at_lambda_one_the_zeros_fill_the_axis():
    with pytest.raises(DefinitionError, match="share the factor across"):
        critical_points(below_one(1.0))
    with pytest.raises(DefinitionError, match="no motion at all"):
        classify(below_one(1.0))


@pytest.mark.parametrize("moment", [(1, 0, 0), (1, 2, -2), (0, 0, 1, 1), (1, 0, 2, 0, 1)])
@pytest.mark.parametrize("function", [fields.dipolar, fields.dipole_like])
def test_in_more_dimensions_every_plane_through_the_moment_shows_the_rose(moment, function):
    field = function(moment=moment)
    planes = plane_by_plane(field, count=5)
    assert planes.exact
    assert planes.alike
    assert all(c.kind == "rose" and c.index == 2 for c in planes.points)
    assert all(r == 0 for r in symmetry_residuals(field))
    assert critical_points(field).unique


def sphere_degree(field, radius, rows=120):
    """1/(4 pi) times the signed area that F/|F| covers on the sphere: sum over triangles."""
    polar = np.linspace(0, math.pi, rows + 1)
    azimuth = np.linspace(0, 2 * math.pi, 2 * rows + 1)
    a, b = np.meshgrid(polar, azimuth, indexing="ij")
    points = radius * np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)])
    f = np.stack([np.broadcast_to(v, a.shape) for v in field.function_of_arrays(*points)])
    f = np.moveaxis(f / np.linalg.norm(f, axis=0), 0, -1)
    total = 0.0
    for u, v, w in (
        (f[:-1, :-1], f[1:, :-1], f[1:, 1:]),
        (f[:-1, :-1], f[1:, 1:], f[:-1, 1:]),
    ):
        volume = np.einsum("ijk,ijk->ij", u, np.cross(v, w))
        base = 1 + sum(np.einsum("ijk,ijk->ij", p, q) for p, q in ((u, v), (v, w), (w, u)))
        total += 2 * np.arctan2(volume, base).sum()
    return total / (4 * math.pi)


class Arrays:
    """A field as a function of arrays."""

    def __init__(self, symbols, components):
        self.function_of_arrays = sp.lambdify(symbols, components, "numpy")


@pytest.mark.parametrize("function", [fields.dipolar, fields.dipole_like])
def test_degree_on_the_sphere_is_zero_so_no_index_test_may_be_used_in_space(function):
    """The same sum gives 1 for x, -1 for -x and 0 for the rose: planes decide, not the degree."""
    field = function(moment=(1.0, 0.0, 0.0))
    components = [c.subs(field.values) for c in field.components]
    s = field.symbols
    assert len(components) == 3
    assert sphere_degree(Arrays(s, components), 0.7) == pytest.approx(0, abs=1e-9)
    assert sphere_degree(Arrays(s, s), 0.7) == pytest.approx(1, abs=1e-9)
    assert sphere_degree(Arrays(s, [-c for c in s]), 0.7) == pytest.approx(-1, abs=1e-9)
    assert any("an index test says nothing" in f for f in field_facts(field))


@pytest.mark.parametrize("lam", [1.0, 1.5, 2.0, 3.0])
def test_dipole_like_field_vanishes_at_the_origin_only_where_it_is_a_rose(lam):
    field = fields.dipole_like(lam=lam)
    zeros = critical_points(field)
    assert zeros.unique
    assert "monotony" in zeros.method
    assert (zeros.critical_points[0].kind, zeros.critical_points[0].index) == ("rose", 2)
    for radius in (0.01, 0.5, 3.0):
        assert winding_number(field, radius) == 2


def test_below_lambda_one_the_dipole_like_field_has_other_zeros():
    """lam c^2 = 1 - exp(-c^2) has roots c = +-1.2626 at lam = 1/2: hence the refusal."""
    like = fields.dipole_like(lam=1.0)
    half = Field(
        "half", like.coordinates, tuple(c.subs(LAM, sp.Rational(1, 2)) for c in like.components)
    )
    zeros = critical_points(half)
    assert not zeros.exact
    roots = sorted(float(x) for x, _ in zeros.points)
    assert roots[0] == pytest.approx(-1.2625, abs=1e-3)
    assert roots[-1] == pytest.approx(1.2625, abs=1e-3)
    with pytest.raises(DefinitionError, match="lambda >= 1"):
        fields.dipole_like(lam=0.5)


@pytest.fixture(scope="module")
def ends():
    """Where the lines through 300 random points begin and end (backward, forward)."""
    field = fields.dipole_like(lam=3.0)
    starts = np.random.default_rng(0).uniform(-2, 2, (300, 2))
    found = []
    for start in starts:
        backward, forward = (
            arc(field, start, sense, length=400, near=1e-2, far=60.0)[1] for sense in (-1, 1)
        )
        found.append((backward, forward))
    return starts, found


def test_most_lines_of_the_dipole_like_field_go_to_infinity(ends):
    """The printed 'all flow lines converge' fails for 225 of 300 random points."""
    _, found = ends
    assert all("unfinished" not in pair for pair in found)
    assert sum("far" in pair for pair in found) == 225
    assert all("origin" in pair for pair in found)  # but one end of every line is there


def test_the_origin_is_reached_forward_on_one_side_and_backward_on_the_other(ends):
    """The travel sense must follow the sign of p . q, as (4.14) does."""
    starts, found = ends
    for (x, _), (backward, forward) in zip(starts, found, strict=True):
        assert (forward if x < 0 else backward) == "origin"


def test_distance_in_the_dipole_like_field_grows_with_the_sign_of_x():
    """d(rho^2)/dt = 2 (p . q) (lam rho^2 - 1 + exp(-rho^2)), whose last factor is positive."""
    field = fields.dipole_like(lam=3.0)
    fx, fy = (c.subs(field.values) for c in field.components)
    rho2 = X**2 + Y**2
    assert sp.simplify(X * fx + Y * fy - X * (3 * rho2 - 1 + sp.exp(-rho2))) == 0


def test_without_the_exponential_lines_are_those_of_two_charges():
    """x^2 - C y^2 = 1/lam, between a source and a sink at +-1/sqrt(lam)."""
    field = fields.dipole_like(lam=3.0, exponential=False)
    zeros = critical_points(field)
    assert zeros.exact
    assert set(zeros.points) == {(-sp.sqrt(3) / 3, 0), (sp.sqrt(3) / 3, 0)}
    assert all(c.kind == "node" for c in zeros.critical_points)
    assert sp.simplify(first_integral(field) - (X**2 - 1 / LAM) / Y**2) == 0
    c = sp.lambdify((X, Y), first_integral(field).subs(field.values), "numpy")
    for start in ((0.2, 0.9), (1.2, 0.7)):
        points, _ = arc(field, start, length=0.8)  # short of the sink
        assert c(*points.T) == pytest.approx(c(*start), rel=1e-9)


@pytest.mark.parametrize(("lam", "bend"), [(1.5, "zero"), (2.0, "finite"), (3.0, "infinite")])
def test_curvature_at_the_origin_is_infinite_beyond_lambda_two(lam, bend):
    field = fields.dipolar(lam=lam)
    line = flow_line(field, (0, 1))
    x, y = line.curve
    dx, dy = x.diff(line.parameter), y.diff(line.parameter)
    ddx, ddy = dx.diff(line.parameter), dy.diff(line.parameter)
    curvature = sp.lambdify(line.parameter, (dx * ddy - dy * ddx) / (dx**2 + dy**2) ** 1.5, "math")
    near, nearer = abs(curvature(1e-2)), abs(curvature(1e-4))
    growth = {"zero": nearer < 0.2 * near, "finite": abs(nearer - 2) < 1e-3}
    assert growth.get(bend, nearer > 50 * near)
    assert any(f.startswith(f"curvature at the origin: {bend}") for f in field_facts(field))
