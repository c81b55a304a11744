"""Section 4.4 and appendix 4.6: the underactuated marine vehicle, what holds and what does not.

Vehicle A is the VideoRay with the assumed rigid body (m11 = 7.34, m22 = 11.45, m33 = .0368),
vehicle B has the inertias read as totals (1.94, 6.05, .0118). Reference numbers were measured
independently with SciPy; their random starts are not described, the counts here are ours.
"""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.control.gain_conditions import docking_metric
from holdfast.maths.expressions.functions import magnitude
from tests.thesis.closed_loops import solved, with_gains

TOTALS = {"mass": 1.0, "Xudot": -0.94, "Yvdot": -5.05, "Iz": 0.0059, "Nrdot": -0.0059}
INERTIA = {"A": {}, "B": TOTALS}
GAINS = {"u": 5.0, "r": 5.0}
START = [-1, 0.5, 0, 0, 0, 0]


def at_rest(seed, count, low=(-2, -2, -np.pi), high=(2, 2, np.pi)):
    poses = np.random.default_rng(seed).uniform(low, high, (count, 3))
    return np.hstack([poses, np.zeros((count, 3))])


@pytest.fixture(scope="module", params=["A", "B"])
def name(request):
    return request.param


@pytest.fixture(scope="module")
def vessels():
    """Without a limit of thrust that would act."""
    return {n: hf.systems.marine_vehicle(thrust_limit=1e7, **i) for n, i in INERTIA.items()}


@pytest.fixture(scope="module")
def projecting(vessels):
    """(4.33), (4.34), (4.38), (4.40) with uv, k1 = 1, k2 = 2, ku = kr = 5."""
    return {
        n: hf.track_velocity(v, hf.laws.project_marine(v, k1=1.0, k2=2.0), GAINS)
        for n, v in vessels.items()
    }


@pytest.fixture(scope="module")
def docking(vessels):
    return {
        n: hf.track_velocity(v, hf.laws.dock_marine(v, k1=0.2, k2=2.0, freeze=1e-6), GAINS)
        for n, v in vessels.items()
    }


def distance(q):
    return np.hypot(q[..., 0], q[..., 1])


def around(angle):
    return np.angle(np.exp(1j * angle))


# -- the metric (4.36), symbolically

X, Y, PSI, U, V, R = (hf.symbol(n) for n in ("x", "y", "psi", "u", "v", "r"))
FIELD = sp.Matrix([X**2 - Y**2, 2 * X * Y])
METRIC = docking_metric(X, Y, sp.S.Zero)
"""(4.36) without s: cos(arctan(y / x))^2 = x^2 / (x^2 + y^2)."""


def test_metric_is_the_printed_one():
    printed = (X**2 + Y**2) / sp.cos(sp.atan(Y / X)) ** 2 / 2
    assert sp.simplify(METRIC - printed) == 0


def test_gradient_of_the_metric_is_along_the_field():
    """grad V = (rho^2 / x^3) F, and the rows of (4.37)."""
    gradient = sp.Matrix([METRIC.diff(X), METRIC.diff(Y)])
    assert sp.simplify(gradient - (X**2 + Y**2) / X**3 * FIELD) == sp.zeros(2, 1)
    printed = (X**2 + Y**2) / X**4 * sp.Matrix([X**3 - X * Y**2, 2 * X**2 * Y])
    assert sp.simplify(gradient - printed) == sp.zeros(2, 1)


@pytest.mark.smoke
def test_control_4_38_gives_the_rate_4_39_of_the_metric():
    k1, side = sp.symbols("k1 side")  # side = sgn(x)
    system = hf.systems.marine_vehicle()
    along = FIELD.dot([sp.cos(PSI), sp.sin(PSI)])
    still = {hf.symbol("Vx"): 0, hf.symbol("Vy"): 0}
    rate = sum(METRIC.diff(q) * system.rates[q.name] for q in (X, Y)).subs(still)
    rate = rate.subs(U, -k1 * side * along)
    first = -k1 * side * (X**2 + Y**2) / X**3 * along**2  # side / x^3 = 1 / |x|^3
    row = sp.Matrix([[X**3 - X * Y**2, 2 * X**2 * Y]])
    drift = (X**2 + Y**2) / X**4 * row.dot([-sp.sin(PSI), sp.cos(PSI)]) * V
    assert sp.simplify(rate - first - drift) == 0


def test_squared_gradient_of_the_metric_is_larger_than_the_thesis_takes_it_for():
    """|grad V|^2 = rho^2 / cos^6, not the rho^2 / cos^2 put in its place with "="; since it is
    subtracted, only "<=" holds there."""
    squared = METRIC.diff(X) ** 2 + METRIC.diff(Y) ** 2
    cos2, rho2 = X**2 / (X**2 + Y**2), X**2 + Y**2
    assert sp.simplify(squared - rho2 / cos2**3) == 0
    assert sp.simplify(squared - rho2 / cos2) != 0
    assert squared.subs({X: 1, Y: 1}) > (rho2 / cos2).subs({X: 1, Y: 1})


def metric(q):
    s = around(q[..., 2] - 2 * np.arctan2(q[..., 1], q[..., 0]))
    return distance(q) ** 4 / q[..., 0] ** 2 / 2 + s**2 / 2


@pytest.mark.parametrize(("vessel", "k1"), [("A", 1.0), ("B", 1.0), ("B", 4.0)])
def test_metric_falls_along_every_run_from_one_side(vessels, projecting, vessel, k1):
    """100 of 100 at rest, x in (-2, -.5), |y| < 1, any heading, for 60 s."""
    starts = at_rest(1, 100, (-2, -1, -np.pi), (-0.5, 1, np.pi))
    law = with_gains(projecting[vessel], k1=k1)
    data = solved(vessels[vessel], law, starts, 60.0, record_every=0.05, relative=1e-9)
    assert np.diff(metric(data["state"].values), axis=1).max() < 0


def test_metric_may_rise_at_first_next_to_the_line_where_it_is_infinite(vessels, projecting):
    """From |x|, |y| < 2 it falls in 98 of 100 runs; in two it rises for up to 0.25 s, while the
    velocities catch up with (4.38) and x is small."""
    data = solved(
        vessels["A"], projecting["A"], at_rest(1, 100), 60.0, record_every=0.05, relative=1e-9
    )
    rises = np.diff(metric(data["state"].values), axis=1) > 0
    assert rises.any(axis=1).sum() == 2
    assert not rises[:, 5:].any()


# -- (4.38), (4.40)


@pytest.mark.parametrize(
    ("vessel", "rho", "heading", "force", "moment"),
    [("B", 1.657e-2, -0.0313, 7.27, 0.768), ("A", 1.654e-2, -0.173, 27.52, 0.808)],
)
def test_projection_law_arrives_as_measured(
    vessels, projecting, vessel, rho, heading, force, moment
):
    """From (-1, .5, 0) at rest, after 60 s: 1.7 cm off."""
    data = solved(vessels[vessel], projecting[vessel], START, 60.0)
    q = data["state"].values[0, -1]
    assert distance(q) == pytest.approx(rho, rel=5e-4)
    assert q[2] == pytest.approx(heading, rel=2e-3)
    assert data["peak_input"].values[0] == pytest.approx([force, moment], rel=1e-3)


def test_projection_law_converges_only_as_one_over_time(vessels, projecting, name):
    """k1 T rho = .9996 (A), .9994 (B) at 600 s, reference .999; psi ~ 1/t, v ~ t^-4."""
    data = solved(vessels[name], projecting[name], START, 600.0, record_every=1.0, relative=1e-9)
    q, t = data["state"].values[0], data["time"].values
    assert 600 * distance(q[-1]) == pytest.approx({"A": 0.9996, "B": 0.9994}[name], abs=1e-4)
    late = t > 100
    slopes = [
        np.polyfit(np.log(t[late]), np.log(np.abs(z[late])), 1)[0]
        for z in (distance(q), q[:, 2], q[:, 4])
    ]
    assert slopes == pytest.approx([-1, -1, -4.05], abs=0.05)


def printed_4_40b(law):
    """tau_r with -(m11 - m22) u r, as printed, in place of -(m11 - m22) u v."""
    difference = hf.symbol("Yvdot") - hf.symbol("Xudot")
    tau_r = law.outputs["tau_r"] + difference * U * (V - R)
    outputs = {"tau_u": law.outputs["tau_u"], "tau_r": tau_r}
    return replace(law, outputs=outputs, empirical="as printed")


def test_printed_4_40b_spins_the_vehicle(vessels, projecting, name):
    """With ur for uv a pole of about -(m11 - m22) u / m33 destabilises the yaw rate. From
    (-1, .5, 0): |r| to 113 (A), 188 rad/s (B), |tau_r| to 5.9e3, 1.6e4 N m; reference, start not
    given, up to 359 and 5.8e4. Corrected: below 3 rad/s. Bounds, since it is an instability."""
    settings = {"relative": 1e-9, "absolute": 1e-10}
    law = printed_4_40b(projecting[name])
    data = solved(vessels[name], law, START, 20.0, **settings)
    assert np.abs(data["state"].values[0, :, 5]).max() > 50
    assert data["peak_input"].values[0, 1] > 1e3
    data = solved(vessels[name], projecting[name], START, 20.0, **settings)
    assert np.abs(data["state"].values[0, :, 5]).max() < 3


def test_velocities_follow_their_references_exponentially(vessels, projecting, name):
    """Under (4.40) with uv, u - u_d decays as exp(-ku t), exactly, on one side of x = 0."""
    data = solved(vessels[name], projecting[name], START, 3.0)
    q, t = data["state"].values[0], data["time"].values
    phi = 2 * np.arctan2(q[:, 1], q[:, 0])
    error = q[:, 3] - distance(q) ** 2 * np.cos(q[:, 2] - phi)  # x < 0: sgn(x) = -1
    assert q[:, 0].max() < 0
    assert error == pytest.approx(error[0] * np.exp(-5 * t), rel=1e-5, abs=1e-10)


def test_leaving_out_the_accelerations_of_phi_is_benign(vessels, projecting, name):
    """The thesis differentiates gamma2 along eta = (x, y, psi) only, though it contains u and v
    through phidot. From (-1, .5, 0) the vehicle is 1.7 cm off after 60 s all the same."""
    vessel = vessels[name]
    gamma = hf.laws.project_marine(vessel, k1=1.0, k2=2.0).outputs["r"]
    rates, tau_r = vessel.undisturbed_rates, hf.symbol("tau_r")
    along = sum(gamma.diff(q) * rates[q.name] for q in (X, Y, PSI))
    wanted = -hf.symbol("k_r") * (R - gamma) + along
    moment = (wanted - rates["r"].subs(tau_r, 0)) / rates["r"].diff(tau_r)
    law = projecting[name]
    law = replace(law, outputs={"tau_u": law.outputs["tau_u"], "tau_r": moment})
    data = solved(vessel, law, START, 60.0, relative=1e-9)
    assert distance(data["state"].values[0, -1]) == pytest.approx(1.66e-2, rel=0.02)


# -- appendix 4.6


def test_sway_is_driven_by_the_product_u_r_and_damped():
    """d/dt v^2 / 2 = -(m11 / m22) v (u r) - (|Yv| v^2 + |Yvv| |v| v^2) / m22."""
    system = hf.systems.marine_vehicle()
    values = {p.symbol: p.value for p in system.parameters}
    expected = -7.34 / 11.45 * V * U * R - (5.87 * V**2 + 30.73 * magnitude(V) * V**2) / 11.45
    residual = (V * system.rates["v"]).subs(values) - expected
    generator = np.random.default_rng(0)
    for u, v, r in generator.uniform(-1, 1, (20, 3)):
        assert float(residual.subs({U: u, V: v, R: r})) == pytest.approx(0, abs=1e-12)


def test_ultimate_bound_of_the_sway_is_not_the_one_of_the_appendix():
    """The appendix: |v| <= m11 |u r| / theta. The drag is missing: at constant u r the sway rests
    where |Yv| |v| + |Yvv| v^2 = m11 |u r|, beyond that bound for a hull with little drag."""
    slippery = hf.systems.marine_vehicle(Yv=-0.5, Yvv=-1e-9)
    values = {p.symbol: p.value for p in slippery.parameters}
    m11, product, theta = 7.34, 0.02, 0.99
    rest = m11 * product / 0.5
    rate = slippery.rates["v"].subs(values | {U: -0.2, R: 0.1, V: rest})
    assert float(rate) == pytest.approx(0, abs=1e-9)
    assert rest > m11 * product / theta


def collisions(vessel, law, starts, seconds=30.0):
    """Runs that come within 1 mm of the origin moving sideways at more than 1 mm/s.

    There phi is not defined and nothing after it means anything; a run that converges has
    v << rho.
    """
    data = solved(vessel, law, starts, seconds, relative=1e-9, absolute=1e-10)
    q = data["state"].values
    near = distance(q) < 1e-3
    sway = np.abs(q[np.arange(len(q)), near.argmax(axis=1), 4])
    return (near.any(axis=1) & (sway > 1e-3)).sum()


@pytest.mark.parametrize(
    ("vessel", "k1", "lost"),
    [
        ("A", 0.2, 0),
        ("A", 1.0, 0),
        ("A", 1.5, 31),
        ("A", 2.0, 36),
        ("A", 4.0, 40),
        ("B", 0.2, 0),
        ("B", 4.0, 0),
        ("B", 8.0, 31),
    ],
)
def test_large_k1_sends_the_hull_sideways_into_the_origin(vessels, projecting, vessel, k1, lost):
    """Of 40 starts, here: A 0, 0, 31, 36, 40; B 0, 0, 31. Reference: A k1 = 1: 0, 1.5: 32,
    2: 38, 4: 38; B 4: 0, 8: 29. Rounding may decide two starts."""
    law = with_gains(projecting[vessel], k1=k1)
    found = collisions(vessels[vessel], law, at_rest(0, 40))
    assert found == pytest.approx(lost, abs=2 if lost else 0)


def test_gain_condition_of_the_appendix_is_neither_necessary_nor_sufficient(vessels, projecting):
    """It asks k1 > m11 / (2 theta theta1 cos^6) >= m11 / 2: 3.67 for A, .97 for B. k1 = .2 is far
    below and works for both; k1 = 4 (A), 8 (B) satisfy it and collide (the test above)."""
    asked = {"A": 7.34 / 2, "B": 1.94 / 2}
    assert min(asked.values()) > 0.2
    assert asked["A"] < 4
    assert asked["B"] < 8
    for n, vessel in vessels.items():
        law = with_gains(projecting[n], k1=0.2)
        data = solved(
            vessel, law, at_rest(0, 40), 300.0, record_every=0.1, relative=1e-9, absolute=1e-10
        )
        rho = distance(data["state"].values)
        assert (0.2 * 300 * rho[:, -1]).max() == pytest.approx(1, abs=0.01)
        assert rho.min() > 0.01


# -- the bounded form of (4.38)


def test_gain_limit_is_that_of_the_linearised_closed_loop(name):
    """k1 < min(|Yv| / m22, |Yv| / (2 m11)): A .400, B .970. The linearisation in (alpha, v / rho)
    is [[-k1, 1], [-2 m k1^2, 2 m k1 - d + k1]], m = m11 / m22, d = |Yv| / m22."""
    m11, m22 = {"A": (7.34, 11.45), "B": (1.94, 6.05)}[name]
    m, d = m11 / m22, 5.87 / m22
    limit = min(d, 5.87 / (2 * m11))
    assert limit == pytest.approx({"A": 0.400, "B": 0.970}[name], abs=5e-4)
    for share, stable in ((0.99, True), (1.01, False)):
        k1 = share * limit
        matrix = np.array([[-k1, 1], [-2 * m * k1**2, 2 * m * k1 - d + k1]])
        assert (np.linalg.eigvals(matrix).real.max() < 0) == stable


@pytest.mark.parametrize(
    ("vessel", "k1", "lost"),
    [
        ("A", 0.3, 0),
        ("A", 0.5, 29),
        ("B", 0.5, 0),
        ("B", 0.9, 2),
        pytest.param("B", 1.2, 33, marks=pytest.mark.heavy),
    ],
)
def test_bounded_law_docks_only_below_its_gain_limit(vessels, docking, vessel, k1, lost):
    """Of 40 starts, collisions here: A .3: 0, .5: 29; B .5: 0, .9: 2, 1.2: 33. Reference: 0, 37;
    0, 1, 40. Close below the limit the sway dies out slowly."""
    law = with_gains(docking[vessel], k1=k1)
    starts = at_rest(0, 40)
    if k1 > {"A": 0.400, "B": 0.970}[vessel]:
        with pytest.warns(hf.GainWarning, match="side-slips into the origin"):
            found = collisions(vessels[vessel], law, starts)
    else:
        found = collisions(vessels[vessel], law, starts)
    assert found == pytest.approx(lost, abs=2 if lost else 0)


@pytest.mark.smoke
@pytest.mark.parametrize(("vessel", "k1", "limit"), [("A", 0.5, "0.3999"), ("B", 1.2, "0.9702")])
def test_dock_marine_refuses_a_gain_above_its_limit(vessels, vessel, k1, limit):
    with pytest.raises(DefinitionError, match=f"k1 = {k1} is not below its limit {limit}") as no:
        hf.laws.dock_marine(vessels[vessel], k1=k1)
    assert "side-slips into the origin" in str(no.value)


def test_bounded_law_converges_exponentially(vessels, docking, name):
    """k1 = .2: rho at k1; alpha and v / rho at the eigenvalues -.128 +- .215i (A), -.269 (B)."""
    law = with_gains(docking[name], freeze=1e-9)
    data = solved(vessels[name], law, START, 60.0, record_every=0.1)
    q, t = data["state"].values[0], data["time"].values
    late = t > 30
    rate = np.polyfit(t[late], np.log(distance(q[late])), 1)[0]
    assert rate == pytest.approx(-0.2, rel=1e-4)
    if name == "B":  # real eigenvalues: the heading decays without turning about zero
        assert np.polyfit(t[late], np.log(np.abs(q[late, 2])), 1)[0] == pytest.approx(
            -0.269, rel=0.01
        )
    assert abs(q[-1, 2]) < 1e-3


@pytest.mark.parametrize("hold", [0.01, 0.05, 0.1])
def test_bounded_law_docks_with_the_thrusters_it_has(name, hold):
    """|tau_u| <= 10 N, |tau_r| <= 1 N m held for 10 to 100 ms, r_d = -k2 psi within 1 cm: 100 of
    100, rho(60) <= 2.0 mm (A), 0.7 mm (B); reference 0.45 mm from other starts."""
    system = hf.systems.marine_vehicle(thrust_limit=5.0, thruster_arm=0.1, **INERTIA[name])
    law = hf.track_velocity(system, hf.laws.dock_marine(system, k1=0.2, k2=2.0), GAINS)
    data = hf.simulate(
        system,
        law,
        starts=at_rest(1, 100),
        horizon=60.0,
        sample_time=hold,
        stepper="dormand-prince",  # the compiled code of the tests above
        record_every=60.0,
    ).dataset
    end = data["state"].values[:, -1]
    assert distance(end).max() < {"A": 2.2e-3, "B": 0.9e-3}[name]
    assert np.abs(around(end[:, 2])).max() < 1e-9
    assert (data["peak_input"].values <= [10, 1 + 1e-12]).all()


@pytest.mark.smoke
@pytest.mark.parametrize("law", ["dock_marine", "project_marine"])
def test_marine_law_is_refused_for_another_system(law):
    with pytest.raises(DefinitionError, match=f"{law} needs '.*', which system 'unicycle'"):
        getattr(hf.laws, law)(hf.systems.unicycle())
