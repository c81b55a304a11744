"""Conditions that hold for every model of a box of parameters: bounds, exactness, refusals."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, ScenarioError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.control.barrier_conditions import viability_conditions
from holdfast.maths.control.parameter_box import parameter_box
from holdfast.maths.expressions.functions import magnitude
from holdfast.maths.expressions.traversal import symbols_of

K1, K2 = 1.5, 8.0
X, V, F = (hf.symbol(n) for n in ("x", "v", "f"))


def point(rates, *parameters, low=-5, high=5, disturbances=(), **more):
    """x' = v, v' = rates, with a force f."""
    return hf.System(
        "point",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        (hf.Quantity("f", "N"),),
        {"x": V, "v": rates},
        parameters=parameters,
        input_bounds=hf.Box((low,), (high,)),
        disturbances=disturbances,
        **more,
    )


def wall(expression=X - 1):
    states = tuple(hf.Quantity(str(s)) for s in sorted(symbols_of([expression]), key=str))
    return hf.Region("wall", states, (hf.Inequality("wall", expression, "m"),))


def mass(value=2.0, **more):
    return hf.Parameter("m", "kg", value=value, **more)


def idle(system):
    return hf.Law("idle", system.states, dict.fromkeys(system.input_names, sp.S.Zero))


def rows(system, region, uncertain, **settings):
    """The conditions after the bounds, as numbers of (states, inputs): normals . u - offset."""
    guard = hf.safeguard(
        system, idle(system), region, gains=(K1, K2), uncertain=uncertain, **settings
    )
    s = guard.safeguard
    u = [q.symbol for q in system.inputs]
    given = [
        sp.Add(*(s.normals[n][j] * e for n, e in zip(system.input_names, u, strict=True)))
        - s.offsets[j]
        for j in range(s.hard, len(s.offsets))
    ]
    return given, guard.parameters


def condition(system, region):
    """The condition of one model, as an expression of its parameters."""
    c = viability_conditions(system, region)
    u = [q.symbol for q in system.inputs]
    found = []
    for one in c:
        e = sp.Add(*(n * s for n, s in zip(one.effect, u, strict=True))) + one.drift
        e += (K1 + K2) * one.rate + K1 * K2 * one.value
        found.append(e)
    return found


def worst_and_rows(system, region, uncertain, points, per_axis=5, **settings):
    """At points of (states, inputs): the worst of a grid of models, and the largest row."""
    moving = [q.symbol for q in (*system.states, *system.inputs)]
    given, parameters = rows(system, region, uncertain, **settings)
    largest = Evaluator(given, moving, parameters).values(points).max(axis=1)
    axes = [np.linspace(*limits, per_axis) for limits in uncertain.values()]
    worst = np.full(len(points), -np.inf)
    known = {p.name: p for p in (*system.parameters, *region.parameters)}
    for values in itertools.product(*axes):
        here = dict(zip(uncertain, map(float, values), strict=True))
        model = [replace(p, value=here.get(n, p.value)) for n, p in known.items()]
        worst = np.maximum(
            worst, Evaluator(condition(system, region), moving, model).values(points).max(axis=1)
        )
    return worst, largest


RNG = np.random.default_rng(5)
POINTS = RNG.uniform(-2, 2, (400, 3))


def test_condition_affine_in_a_reciprocal_is_met_exactly_at_the_two_ends():
    """m v' = f: f / m, so that two conditions are the worst of every mass."""
    system = point(F / hf.symbol("m"), mass())
    given, _ = rows(system, wall(), {"m": (1.5, 3.0)})
    assert len(given) == 1  # m multiplied out: the bound of f is the least of two
    worst, largest = worst_and_rows(system, wall(), {"m": (1.5, 3.0)}, POINTS, per_axis=41)
    assert np.array_equal(worst <= 0, largest <= 0)


@pytest.mark.heavy
def test_drag_and_mass_take_the_worst_of_every_vertex():
    """m v' = f - d v |v|: one condition, in which the drag costs half its range times v |v|."""
    d = hf.Parameter("d", "kg/m", value=1.0)
    system = point((F - hf.symbol("d") * V * magnitude(V)) / hf.symbol("m"), mass(), d)
    box = {"m": (1.5, 3.0), "d": (0.5, 2.0)}
    assert len(rows(system, wall(), box)[0]) == 1
    worst, largest = worst_and_rows(system, wall(), box, POINTS, per_axis=21)
    assert np.array_equal(worst <= 0, largest <= 0)


def test_input_beside_what_the_parameter_does_not_divide_needs_a_condition_at_each_end():
    """v' = f / m + g with the bound on f + c: the normals differ, and both ends stand."""
    system = hf.System(
        "two",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        (hf.Quantity("f", "N"), hf.Quantity("a", "m/s^2")),
        {"x": V, "v": F / hf.symbol("m") + hf.symbol("a")},
        parameters=(mass(),),
        input_bounds=hf.Box((-5, -1), (5, 1)),
    )
    box = {"m": (1.5, 3.0)}
    given, _ = rows(system, wall(), box)
    assert len(given) == 2
    points = RNG.uniform(-2, 2, (400, 4))
    worst, largest = worst_and_rows(system, wall(), box, points, per_axis=41)
    assert largest == pytest.approx(worst, abs=1e-12)


@pytest.mark.heavy
@pytest.mark.parametrize("power", [2, 3])
def test_polynomial_of_a_higher_degree_is_bounded_from_above(power):
    """v' = f/m - (v - 1) m^k: concave in m where v > 1, where the bound is above, else tight."""
    m = hf.symbol("m")
    system = hf.System(
        "curved",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        (hf.Quantity("f", "N"), hf.Quantity("a", "m/s^2")),
        {"x": V, "v": F / m + hf.symbol("a") - (V - 1) * m**power / 10},
        parameters=(mass(),),
        input_bounds=hf.Box((-5, -1), (5, 1)),
    )
    points = RNG.uniform(-2, 2, (400, 4))
    gaps = []
    for half in (0.8, 0.4, 0.2):
        box = {"m": (2 - half, 2 + half)}
        worst, largest = worst_and_rows(system, wall(), box, points, per_axis=101)
        assert (largest >= worst - 1e-12).all()
        gaps.append((largest - worst).max())
    assert gaps[0] > 1e-3  # there is something to bound
    assert gaps[2] < gaps[0] / 8  # of second order in the width


def test_parameter_that_multiplies_inputs_to_the_second_degree_has_three_conditions():
    m = hf.symbol("m")
    system = hf.System(
        "squared",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        (hf.Quantity("f", "N"), hf.Quantity("a", "m/s^2")),
        {"x": V, "v": F * m**2 + hf.symbol("a")},
        parameters=(mass(),),
        input_bounds=hf.Box((-5, -1), (5, 1)),
        empirical="any power of the mass",
    )
    box = {"m": (1.5, 3.0)}
    assert len(rows(system, wall(), box)[0]) == 3
    points = RNG.uniform(-2, 2, (400, 4))
    worst, largest = worst_and_rows(system, wall(), box, points, per_axis=101)
    assert (largest >= worst - 1e-12).all()
    pushes = points[:, 2] > 0  # convex in m: the ends are the worst, and the middle is below them
    assert largest[pushes] == pytest.approx(worst[pushes], abs=1e-12)


@pytest.mark.parametrize(
    ("rate", "conditions"),
    [
        (lambda f, a, m: f + a - m * V, 1),
        (lambda f, a, m: f + a - m**2 * V, 1),
        (lambda f, a, m: f / m + a, 2),
        (lambda f, a, m: f * m + a, 2),
        (lambda f, a, m: (f + a) / m, 1),
        (lambda f, a, m: f * m**2 + a, 3),
        (lambda f, a, m: f * m**3 + a, 4),
    ],
)
def test_conditions_of_one_are_as_many_as_the_page_says(rate, conditions):
    """docs/viability.md, the table of a box of parameters, with two inputs."""
    a = hf.symbol("a")
    system = hf.System(
        "two",
        (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        (hf.Quantity("f", "N"), hf.Quantity("a", "m/s^2")),
        {"x": V, "v": rate(F, a, hf.symbol("m"))},
        parameters=(mass(),),
        input_bounds=hf.Box((-5, -1), (5, 1)),
        empirical="any power of the mass",
    )
    assert len(rows(system, wall(), {"m": (1.5, 3.0)})[0]) == conditions


def test_box_of_one_point_is_the_filter_without_a_box():
    system = point(F / hf.symbol("m") - 1.0 * V, mass())
    given, parameters = rows(system, wall(), {"m": (2.0, 2.0)})
    plain, nominal = rows(system, wall(), None)
    moving = [q.symbol for q in (*system.states, *system.inputs)]
    a = Evaluator(given, moving, parameters).values(POINTS)
    b = Evaluator(plain, moving, nominal).values(POINTS)
    assert a == pytest.approx(b, abs=1e-12)


def test_worst_disturbance_is_that_of_every_model():
    """m v' = f + w, |w| <= 1: w / m at the lightest and at the heaviest mass."""
    w = hf.symbol("w")
    system = point(
        (F + w) / hf.symbol("m"),
        mass(),
        disturbances=(hf.Quantity("w", "N"),),
        disturbance_bounds=hf.Box((-1,), (1,)),
    )
    box = {"m": (1.5, 3.0)}
    given, parameters = rows(system, wall(), box, worst=("w",))
    largest = Evaluator(given, [X, V, F], parameters).values(POINTS).max(axis=1)
    worst = np.full(len(POINTS), -np.inf)
    for m, push in itertools.product(np.linspace(1.5, 3, 31), (-1.0, 1.0)):
        x, v, f = POINTS.T
        worst = np.maximum(worst, (f + push) / m + (K1 + K2) * v + K1 * K2 * (x - 1))
    assert np.array_equal(worst <= 0, largest <= 0)


@pytest.fixture(scope="module")
def craft():
    scene = hf.load_scenario("inspection")
    return scene.model, scene.region


def fifths(system):
    """Inertia and drag of every axis of the craft 20 % up and down."""
    value = {p.name: p.value for p in system.parameters}
    found = {}
    for name, rigid in (("Xudot", "mass"), ("Yvdot", "mass"), ("Nrdot", "Iz")):
        inertia = value[rigid] - value[name]
        found[name] = (value[rigid] - 1.2 * inertia, value[rigid] - 0.8 * inertia)
    for name in ("Xu", "Xuu", "Yv", "Yvv", "Nr", "Nrr"):
        found[name] = (1.2 * value[name], 0.8 * value[name])
    return found


@pytest.mark.heavy
def test_craft_has_four_conditions_a_constraint_which_hold_at_every_vertex(craft):
    """Surge and yaw inertia multiply inputs; 1,000 states and inputs at 512 vertices and within.

    The Coriolis force is a quotient of inertias: the bound is above the worst model by nothing at
    half of the states, and nowhere by more than 7 % of what the thrusters can do.
    """
    system, region = craft
    box = fifths(system)
    given, parameters = rows(system, region, box)
    assert len(given) == 4 * len(region.inequalities) == 16
    rng = np.random.default_rng(1)
    high = np.array([-0.3, 1.6, 1, 0.5, 0.3, 1, 10, 1])
    points = rng.uniform([-2, *-high[1:]], high, (1000, 8))
    moving = [q.symbol for q in (*system.states, *system.inputs)]
    still = {d.symbol: sp.S.Zero for d in system.disturbances}
    given = [e.xreplace(still) for e in given]
    largest = Evaluator(given, moving, parameters).values(points).reshape(1000, 4, 4).max(axis=2)
    known = {p.name: p for p in (*system.parameters, *region.parameters)}
    nominal = [e.xreplace(still) for e in condition(system, region)]
    models = Evaluator(
        nominal,
        [*moving, *(hf.symbol(n) for n in box)],
        [p for n, p in known.items() if n not in box],
    )
    force, moment = (q.symbol for q in system.inputs)  # of two thrusters of 5 N, 0.1 m off
    reach = [10 * sp.Abs(e.diff(force)) + 1.0 * sp.Abs(e.diff(moment)) for e in nominal]
    reach = [e.replace(sp.Abs, magnitude) for e in reach]
    thrust = Evaluator(reach, moving, list(known.values())).values(points)
    worst = np.full((1000, 4), -np.inf)
    inside = [rng.uniform(*np.transpose(list(box.values()))) for _ in range(100)]
    for values in (*itertools.product(*box.values()), *inside):
        at = np.hstack((points, np.tile(values, (1000, 1))))
        worst = np.maximum(worst, models.values(at))
    assert (largest >= worst - 1e-9).all()
    excess = (largest - worst) / thrust
    assert np.median(excess) < 1e-3
    assert excess.max() < 0.07


def test_boundaries_of_the_box_are_parameters_of_the_law(craft):
    system, region = craft
    made = hf.SafetyFilter(system, region, uncertain={"Xu": (-1.2, -0.8)})
    values = {p.name: (p.value, p.unit) for p in made.law.parameters}
    assert values["Xu_least"] == (-1.2, "N s/m")
    assert values["Xu_most"] == (-0.8, "N s/m")
    assert len(made.law.safeguard.names) == 4  # a drag is in no normal: no condition more


@pytest.mark.parametrize(
    ("uncertain", "says"),
    [
        ({"n": (1, 3)}, "uncertain 'n' is not a parameter of system 'point'"),
        ({"m": (3, 1)}, "'m' is [3, 1]; expected the least number first"),
        ({"m": (3, 4)}, "'m' is [3, 4], and its value 2 is not in it"),
        ({"m": (1, float("inf"))}, "'m' is [1, inf]; expected finite numbers"),
        ({"m": (1, float("nan"))}, "'m' is [1, nan]; expected finite numbers"),
        ({"m": (0, 3)}, "'m' is [0, 3]; expected numbers above 0"),
        ({"m": (1, 2, 3)}, "expected two numbers, [least, most]"),
        ({"m": "12"}, "expected two numbers, [least, most]"),
        ({"m": (True, 3)}, "expected two numbers, [least, most]"),
        (["m"], "expected names to ranges [least, most]"),
        ({"limit": (1, 9)}, "'limit' is in the bounds of the inputs"),
    ],
)
def test_box_that_is_none_is_refused_in_one_line(uncertain, says):
    limit = hf.Parameter("limit", "N", value=5.0)
    system = point(
        F / hf.symbol("m"), mass(above=0.0), limit, low=-hf.symbol("limit"), high=hf.symbol("limit")
    )
    with pytest.raises(DefinitionError) as refused:
        parameter_box(uncertain, system, wall())
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("rates", "says"),
    [
        (F * sp.exp(hf.symbol("m")), "not rational in uncertain 'm'"),
        (F + sp.sqrt(hf.symbol("m") + V), "not rational in uncertain 'm'"),
        (F / (hf.symbol("m") - 3), "'m' may make m - 3 zero"),
        (F / (hf.symbol("m") + V**2), "divided by a term of uncertain 'm' and 'v'"),
    ],
)
def test_condition_without_a_bound_is_refused_by_the_name_of_the_parameter(rates, says):
    system = point(rates, mass(), empirical="functions of a mass")
    with pytest.raises(DefinitionError, match=says):
        rows(system, wall(), {"m": (1.0, 4.0)})


def test_filter_of_a_kernel_has_no_box(craft):
    from holdfast.analysis.online.filter_law import _check_options

    with pytest.raises(
        DefinitionError, match="uncertain is given, which a kernel's filter has not"
    ):
        _check_options(True, False, False, uncertain={"m": (1, 2)}, gains=None, margins=None,
                       constraints=None, disturbance_measured=False, worst=())  # fmt: skip


def test_scenario_reads_the_box_in_units_and_refuses_by_its_key():
    sets = ["safeguard.uncertain={ Xu = [-1.2, -0.8] }", "starts.random=1"]
    scene = hf.load_scenario("inspection", sets)
    values = {p.name: p.value for p in scene.law.parameters}
    assert (values["Xu_least"], values["Xu_most"]) == (-1.2, -0.8)
    with pytest.raises(
        ScenarioError, match=r"safeguard\.uncertain\.Xuv: unknown name; did you mean 'Xu'"
    ):
        hf.load_scenario("inspection", ["safeguard.uncertain={ Xuv = [-1.2, -0.8] }"])
    with pytest.raises(ScenarioError, match=r"safeguard.uncertain.Xudot: "):
        hf.load_scenario("inspection", ["safeguard.uncertain={ Xudot = ['1 m', '2 m'] }"])
