"""Which inputs and velocities keep a state inside: exact cases, the thesis's formulas, a peer."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import brentq, linprog

import holdfast as hf
from holdfast.analysis.boundary import (
    Boundary,
    check_viability,
    contingent_cone,
    generators,
    regulation_map,
)
from holdfast.errors import DefinitionError, SimulationError
from holdfast.maths.control.barrier_conditions import viability_conditions

X, Y, V, A, B, W = (hf.symbol(n) for n in "xyvabw")


def point(x=X, y=Y, **more):
    """Two coordinates moved by two inputs in [-1, 1]."""
    states = (hf.Quantity("x"), hf.Quantity("y"))
    inputs = (hf.Quantity("a"), hf.Quantity("b"))
    chosen = {"input_bounds": hf.Box((-1, -1), (1, 1))} | more
    return hf.System("point", states, inputs, {"x": A, "y": B}, **chosen)


def region(*expressions, system=None):
    reads = (system or point()).states
    named = tuple(hf.Inequality(f"c{i}", e) for i, e in enumerate(expressions, 1))
    return hf.Region("room", reads, named)


def cart():
    """x'' = a + w, |a| <= 2, |w| <= 1/2."""
    return hf.System(
        "cart",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        (hf.Quantity("a", "m/s^2"),),
        {"x": V, "v": A + W},
        disturbances=(hf.Quantity("w", "m/s^2"),),
        input_bounds=hf.Box((-2,), (2,)),
        disturbance_bounds=hf.Ball(sp.Rational(1, 2), 1),
    )


WALL = hf.Region("room", cart().states, (hf.Inequality("wall", X - 1, "m"),))


def test_inside_the_region_every_input_and_every_velocity_is_allowed():
    boundary = Boundary(point(), region(X - 1))
    found = boundary.regulation_map([0.0, 0.0])
    assert found.conditions == ()
    assert len(found.vertices) == 4
    assert boundary.contingent_cone([0.0, 0.0]).contains([5.0, -7.0])


def test_at_a_wall_the_inputs_are_the_half_that_points_away_from_it():
    found = regulation_map(point(), region(X - 1), [1.0, 0.3])
    assert found.conditions == ("c1",)
    assert {tuple(v) for v in np.round(found.vertices, 12)} == {
        (-1, -1),
        (0, -1),
        (0, 1),
        (-1, 1),
    }
    assert found.contains([0.0, 1.0])
    assert not found.contains([0.01, 0.0])


def test_in_a_corner_the_cone_has_the_two_walls_for_generators():
    found = contingent_cone(point(), region(X - 1, Y - 1), [1.0, 1.0])
    assert found.active == ("c1", "c2")
    assert {tuple(np.round(r, 12)) for r in found.rays} == {(-1, 0), (0, -1)}
    assert len(found.lines) == 0


@pytest.mark.parametrize("expression", ["abs(x) - 1", "max(x, -x) - 1", "2*max(x - 1, -x - 1)"])
def test_constraint_with_a_kink_is_as_many_conditions_as_it_has_sides(expression):
    """|x| <= 1 at x = 1 forbids a > 0, at x = -1 it forbids a < 0; |y| - x at the origin both."""
    written = hf.parse_expression(expression, {"x": X})
    boundary = Boundary(point(), region(written))
    assert len(boundary.conditions) == 2
    assert boundary.regulation_map([1.0, 0.0]).vertices[:, 0].max() == pytest.approx(0)
    assert boundary.regulation_map([-1.0, 0.0]).vertices[:, 0].min() == pytest.approx(0)


def test_point_of_a_wedge_where_the_constraint_is_not_smooth():
    """|y| - x <= 0 at its tip: the cone is |v_y| <= v_x."""
    wedge = hf.parse_expression("abs(y) - x", {"x": X, "y": Y})
    boundary = Boundary(point(), region(wedge))
    cone = boundary.contingent_cone([0.0, 0.0])
    generator = np.random.default_rng(0)
    for v in generator.normal(size=(200, 2)):
        assert cone.contains(v) == (abs(v[1]) <= v[0])
    corners = boundary.regulation_map([0.0, 0.0]).vertices
    assert {tuple(c) for c in np.round(corners, 9)} == {(0, 0), (1, 1), (1, -1)}


def test_union_of_two_cones_is_refused_and_each_side_of_it_answered():
    """min(x, y) <= 0: at the origin a velocity may leave by either, which is no convex cone."""
    either = hf.parse_expression("min(x, y)", {"x": X, "y": Y})
    boundary = Boundary(point(), region(either))
    with pytest.raises(SimulationError, match="not an intersection of half-spaces"):
        boundary.contingent_cone([0.0, 0.0])
    assert boundary.contingent_cone([0.0, 1.0]).contains([-1.0, 5.0])


@pytest.mark.parametrize(
    ("expression", "at", "refused"),
    [
        ("k*max(x, y)", (0.0, 0.0), False),
        ("k*abs(x) + abs(y) - 1", (0.0, 1.0), False),
        ("exp(max(x, y)) - 1", (0.0, 0.0), True),
        ("y - abs(x)", (0.0, 0.0), True),
        ("-max(x, y)", (0.0, 0.0), True),
        ("1 - max(abs(x), abs(y))", (1.0, 1.0), True),
        ("x if x > 0 else -y", (0.0, 0.0), True),
    ],
)
def test_kink_is_split_where_it_is_convex_and_refused_at_its_edge_elsewhere(
    expression, at, refused
):
    """A positive parameter before a kink is no obstacle; a concave kink is a union of cones."""
    k = hf.Parameter("k", "1", value=2.0, above=0.0)
    names = {"x": X, "y": Y, "k": k.symbol}
    kinked = hf.Inequality("c", hf.parse_expression(expression, names))
    boundary = Boundary(point(), hf.Region("room", point().states, (kinked,), (k,)))
    if refused:
        with pytest.raises(SimulationError, match="not an intersection of half-spaces"):
            boundary.contingent_cone(at)
    else:
        assert len(boundary.contingent_cone(at).normals) == 2


def test_cusp_is_said_not_to_qualify():
    """y + x^2 <= 0 and y >= 0 leave one point; the linearised cone has a line in it."""
    cusp = Boundary(point(), region(Y + X**2, -Y)).contingent_cone([0.0, 0.0])
    assert not cusp.qualified
    assert Boundary(point(), region(X - 1, Y - 1)).contingent_cone([1.0, 1.0]).qualified


def test_generators_span_exactly_the_cone_of_random_gradients():
    """Membership by generators (non-negative least squares) and by half-spaces agree."""
    generator = np.random.default_rng(1)
    for rows, columns in itertools.product((1, 2, 3, 4, 6), (2, 3, 4)):
        normals = generator.normal(size=(rows, columns))
        rays, lines = generators(normals)
        for v in generator.normal(size=(20, columns)):
            spanned = np.vstack([rays, lines, -lines]).T
            if spanned.size:
                found = linprog(
                    np.zeros(spanned.shape[1]), A_eq=spanned, b_eq=v, bounds=[(0, None)]
                )
                inside = found.status == 0
            else:
                inside = False
            assert inside == bool((normals @ v <= 1e-9).all())


# -- second derivatives


def test_cart_is_free_moving_away_stopped_at_rest_and_lost_moving_on():
    boundary = Boundary(cart(), WALL)
    assert boundary.conditions[0].relative_degree == 2
    away = boundary.regulation_map([1.0, -0.1])
    assert away.vertices.ravel().tolist() == [-2, 2]
    rest = boundary.regulation_map([1.0, 0.0])
    assert sorted(rest.vertices.ravel()) == pytest.approx([-2, 0])
    lost = boundary.regulation_map([1.0, 0.1])
    assert lost.hopeless == ("wall",)
    assert lost.empty
    assert lost.vertices.shape == (0, 1)


def test_high_order_condition_is_the_one_of_its_gains():
    """c'' + (k1 + k2) c' + k1 k2 c <= 0: a <= -3 v - 2 (x - 1) for k = (1, 2)."""
    found = regulation_map(cart(), WALL, [0.2, 0.5], gains=(1.0, 2.0))
    assert max(found.vertices.ravel()) == pytest.approx(-1.5 + 1.6)


def test_worst_disturbance_counts_where_the_first_derivative_decides():
    drifting = point(
        disturbances=(hf.Quantity("w"), hf.Quantity("v")),
        disturbance_bounds=hf.Ball(sp.Rational(1, 4), 2),
    )
    drifting = hf.System(
        "drifting point",
        drifting.states,
        drifting.inputs,
        {"x": A + W, "y": B + V},
        disturbances=drifting.disturbances,
        input_bounds=drifting.input_bounds,
        disturbance_bounds=drifting.disturbance_bounds,
    )
    boundary = Boundary(drifting, region((X + Y) / sp.sqrt(2) - 1, system=drifting))
    at = [math.sqrt(0.5), math.sqrt(0.5)]
    still, worst, given = (
        boundary.regulation_map(at, disturbance=d).offsets[0]
        for d in ("none", "worst", {"w": 0.1, "v": 0.0})
    )
    assert still == pytest.approx(0, abs=1e-12)
    assert worst == pytest.approx(-0.25)
    assert given == pytest.approx(-0.1 / math.sqrt(2))


def carried(x, disturbance, bounds):
    """x' = `x`, v' = a, with one disturbance d."""
    return hf.System(
        "carried",
        (hf.Quantity("x"), hf.Quantity("v")),
        (hf.Quantity("a"),),
        {"x": x, "v": A},
        disturbances=(hf.Quantity("w"),),
        input_bounds=hf.Box((-5,), (5,)),
        disturbance_bounds=bounds,
    )


def test_worst_disturbance_that_is_no_closed_form_is_refused_and_a_given_one_exact():
    """Before the inputs (x' = v + w), not affine (w^2), times the input (a (1 + w))."""
    ball = hf.Ball(2, 1)
    for rates in (V + W, A + W**2, A * (1 + W)):
        boundary = Boundary(carried(rates, W, ball), WALL)
        with pytest.raises(SimulationError, match="worst disturbance of 'wall' is not known"):
            boundary.regulation_map([1.0, -0.2], disturbance="worst")
    drifting = Boundary(carried(V + W, W, ball), WALL)
    assert drifting.regulation_map([1.0, -0.2], disturbance={"w": 0.5}).hopeless == ("wall",)
    squared = Boundary(carried(A + W**2, W, ball), WALL)
    found = squared.regulation_map([1.0, -0.2], disturbance={"w": 1.0})
    assert max(found.vertices.ravel()) == pytest.approx(-1.0)


def test_one_force_of_two_thrusters_has_the_sum_of_their_bounds():
    single = hf.System(
        "sled",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        (hf.Quantity("a", "m/s^2"),),
        {"x": V, "v": A},
        input_bounds=hf.LinearImage(sp.ImmutableMatrix([[1, 1]]), hf.Box((-1, -2), (1, 2))),
    )
    assert Boundary(single, WALL).regulation_map([0.0, 0.0]).vertices.ravel() == pytest.approx(
        [-3, 3]
    )


# -- the thesis's region and vehicle


@pytest.fixture(scope="module")
def view():
    """Surge and yaw rate as inputs: what the thesis's (5.24), (5.25) are written for."""
    return Boundary(hf.promote(hf.systems.marine_vehicle(), ("u", "r")), hf.regions.camera_view())


def edge(psi, low=True):
    """A pose on the edge of the view at the far range limit."""
    x = -2.0 * math.cos(psi)

    def off(y):
        end = (-0.1 if low else 0.1) - y
        bearing = math.atan2(end, -x)
        return (psi - bearing if low else bearing - psi) - math.pi / 6

    return [x, brentq(off, -3.0, 3.0), psi, 0.0]


@pytest.mark.parametrize("psi", [-0.3, 0.0, 0.2, 0.4])
def test_rates_at_the_edge_of_view_are_those_of_the_thesis(view, psi):
    """(5.24): d/dt c1 = [sin(alpha) u + cos(alpha) v - x r / cos(psi - alpha)] / cos(psi - alpha)
    for the printed constraint; the angular one has the same ratio of the coefficients."""
    alpha = math.pi / 6
    state = edge(psi)
    found = view.regulation_map(state)
    row = found.normals[found.conditions.index("edge_low")]
    printed = math.sin(alpha), -state[0] / math.cos(psi - alpha)
    assert row[0] / row[1] == pytest.approx(printed[0] / printed[1], rel=1e-5)
    far = found.normals[found.conditions.index("too_far")]
    assert far == pytest.approx([-math.cos(psi), 2.0 * math.sin(psi)], abs=1e-9)


def test_with_the_far_limit_and_an_edge_active_forwards_and_turning_back_suffices(view):
    """At c1 = c4 = 0 u > 0 and r < 0 keep both: the kinematic map is not empty."""
    for psi in (0.05, 0.2, 0.4):
        found = view.regulation_map(edge(psi))
        assert set(found.conditions) == {"edge_low", "too_far"}
        assert not found.empty
        assert found.contains([0.1, -0.5])


def test_view_is_viable_for_the_kinematic_vehicle_on_its_whole_sampled_boundary(view):
    box = {"x": (-2, -0.3), "y": (-1.6, 1.6), "psi": (-1.0, 1.0), "v": (-0.1, 0.1)}
    found = check_viability(view, box, count=200)
    assert found.viable
    assert len(found.states) == 200
    assert np.abs(view.worst(found.states)).max() < 1e-9


def test_moving_vehicle_loses_the_view_where_it_moves_out_of_it_whatever_the_thrust():
    """Relative degree 2: from the edge no thrust saves a start that moves outwards."""
    boundary = Boundary(hf.systems.marine_vehicle(), hf.regions.camera_view())
    assert [c.by_input for c in boundary.conditions] == [(2, 2)] * 4
    box = {"x": (-2, -0.3), "y": (-1.6, 1.6), "psi": (-1, 1), "u": (-0.2, 0.2), "r": (-0.5, 0.5)}
    found = check_viability(boundary, box, count=200)
    assert not found.viable
    state, margin, active = found.worst
    assert margin == -math.inf
    assert boundary.regulation_map(state).hopeless == active[-1:]
    assert 0.3 < found.share < 0.7


def test_thrusters_make_a_parallelogram_of_forces_and_moments():
    vehicle = hf.systems.marine_vehicle(thrust_limit=5.0)
    found = regulation_map(vehicle, hf.regions.camera_view(), [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    corners = {tuple(np.round(c, 9)) for c in found.vertices}
    assert corners == {(10, 0), (0, 1), (-10, 0), (0, -1)}


def test_least_violation_is_that_of_an_independent_search(view):
    """Bounded inputs, both constraints of an edge pose shifted: compared with a fine grid."""
    state = edge(0.2)
    found = view.regulation_map(state)
    rows = np.vstack([found.normals, [[1, 0], [-1, 0], [0, 1], [0, -1]]])
    limits = np.concatenate([found.offsets, [0.3] * 4])
    boxed = replace(found, normals=rows, offsets=limits)
    u, rate = boxed.least_violation()
    grid = np.stack(np.meshgrid(*[np.linspace(-0.3, 0.3, 601)] * 2), axis=-1).reshape(-1, 2)
    scaled = boxed.normals[:2]
    assert rate == pytest.approx((grid @ scaled.T).max(axis=1).min(), abs=2e-3)
    assert (scaled @ u).max() == pytest.approx(rate, abs=1e-9)


# -- what is refused


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: regulation_map(point(), region(X - 1), [2.0, 0.0]), "lies outside the region"),
        (lambda: regulation_map(point(), region(X - 1), [1.0]), "finite numbers for x, y"),
        (lambda: regulation_map(point(), region(X - 1), [math.nan, 0.0]), "finite numbers"),
        (lambda: regulation_map(point(), region((X - 1) ** 3), [1.0, 0.0]), "gradient of 'c1'"),
        (
            lambda: regulation_map(point(), region(X - 1), [1.0, 0.0], disturbance="most"),
            "'none', 'worst'",
        ),
        (
            lambda: regulation_map(point(), region(X - 1), [1.0, 0.0], disturbance={"q": 1}),
            "no disturbance 'q'",
        ),
        (
            lambda: regulation_map(point(input_bounds=hf.Ball(1, 2)), region(X - 1), [1.0, 0.0]),
            "bounded by a ball",
        ),
        (
            lambda: regulation_map(point(input_bounds=None), region(X - 1), [1.0, 0.0]).vertices,
            "not bounded",
        ),
        (lambda: Boundary(point(), region(X - 1), parameters={"k": 1.0}), "no parameter 'k'"),
        (
            lambda: check_viability(Boundary(point(), region(X - 1)), {"x": (2, 3)}),
            "no state of the region's boundary",
        ),
        (lambda: Boundary(point(), region(X - 1), tolerance=math.nan), "tolerance is nan"),
        (
            lambda: regulation_map(cart(), WALL, [1.0, 0.0], disturbance={"w": 5.0}),
            "finite, within its bounds",
        ),
        (lambda: regulation_map(cart(), WALL, [1.0, 0.0], gains=(1.0, -1.0)), "gains is"),
        (lambda: regulation_map(cart(), WALL, "ab"), "finite numbers for x, v"),
        (lambda: contingent_cone(cart(), WALL, [1.0, 0.0]).contains([1.0]), "2 numbers"),
        (lambda: check_viability(Boundary(cart(), WALL), {"x": (0, 2)}, count=-1), "count is -1"),
    ],
)
def test_questions_without_an_answer_are_refused(make, complaint):
    with pytest.raises((DefinitionError, SimulationError), match=complaint):
        make()


def test_relative_degree_above_two_is_refused():
    states = tuple(hf.Quantity(n) for n in "xyv")
    chain = hf.System("chain", states, (hf.Quantity("a"),), {"x": Y, "y": V, "v": A})
    wall = hf.Region("room", states, (hf.Inequality("wall", X - 1),))
    with pytest.raises(DefinitionError, match="relative degree is above 2"):
        viability_conditions(chain, wall)
