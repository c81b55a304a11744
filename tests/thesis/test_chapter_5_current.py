"""Chapter 5 in a current: the law (5.31), its forces (5.36), its bound (5.35), viability (5.38)-(5.41)."""

import contextlib
import itertools
import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.control.gain_conditions import ultimate_bound
from holdfast.maths.expressions.functions import magnitude, wrap
from tests.conftest import number_at

K1, MU = 0.16, 1.5
ARM = "system.thruster_arm=0.11"
SPEED, DIRECTION, TURN = hf.symbol("speed"), hf.symbol("direction"), hf.symbol("turn")
X, Y, PSI, U, V, R = (hf.symbol(n) for n in ("x", "y", "psi", "u", "v", "r"))
VX, VY = hf.symbol("Vx"), hf.symbol("Vy")


def in_current(vehicle, law, starts, draws, angle=DIRECTION, horizon=400.0, **settings):
    """Sigma_1 in a current of that speed and angle; every run draws its own numbers."""
    chosen = {"sample_time": 0.02, "substeps": 1, "record_every": horizon} | settings
    return hf.simulate(
        hf.promote(vehicle, ("u", "r")),
        law,
        starts=starts,
        horizon=horizon,
        disturbance={"Vx": SPEED * sp.cos(angle), "Vy": SPEED * sp.sin(angle)},
        varied=hf.Varied(draws=draws),
        **chosen,
    ).dataset


def somewhere(count, seed=0):
    generator = np.random.default_rng(seed)
    return generator.uniform([-3, -2, -np.pi, 0], [2, 2, np.pi, 0], (count, 4))


def from_goal(data):
    states = data["state"].values
    return np.hypot(states[..., 0] + 0.5, states[..., 1])


# -- the law and its forces -----------------------------------------------------------------


def test_law_in_a_current_is_the_nominal_one_with_the_ground_track_in_the_rate_of_the_field(
    vehicle,
):
    """(5.31): gamma_1 is (5.18a); gamma_2 gains grad(phi) . (Vx, Vy), which Lemma 3 needs."""
    told, still = (
        hf.laws.steer_marine(vehicle, disturbance_measured=True),
        hf.laws.steer_marine(vehicle),
    )
    assert told.outputs["u"] == still.outputs["u"]
    assert sp.expand(told.outputs["r"] - still.outputs["r"]).free_symbols >= {VX, VY}
    kinematic = hf.promote(vehicle, ("u", "r"))
    phi = PSI - wrap_argument(told.outputs["r"])
    values = {p.symbol: p.value for p in (*told.parameters, *vehicle.parameters)}
    closed = {hf.symbol(n): e for n, e in told.outputs.items()}
    error = sp.expand(
        kinematic.derivative(PSI - phi).subs(closed) + hf.symbol("k2") * wrap(PSI - phi)
    )
    generator = np.random.default_rng(2)
    for _ in range(20):
        at = dict(zip((X, Y, PSI, V, VX, VY), generator.uniform(-1, 1, 6), strict=True))
        assert number_at(error, values | at) == pytest.approx(0, abs=1e-9), "Lemma 3"


def wrap_argument(expression):
    (found,) = expression.atoms(wrap)
    return found.args[0]


@pytest.mark.slow("True")
@pytest.mark.smoke
@pytest.mark.parametrize("measured", [True, False])
def test_tracked_forces_are_those_of_5_36_and_5_37(vehicle, measured):
    """With the sway's own rate in grad(gamma_2), which (5.37b) leaves out (E8)."""
    law = hf.laws.steer_marine(vehicle, disturbance_measured=measured)
    forces = hf.track_velocity(vehicle, law, {"u": 5.0, "r": 10.0}).outputs
    p = {q.name: q.symbol for q in vehicle.parameters}
    m11, m22, m33 = p["mass"] - p["Xudot"], p["mass"] - p["Yvdot"], p["Iz"] - p["Nrdot"]
    current = (VX, VY) if measured else (0, 0)
    over_ground = {
        X: U * sp.cos(PSI) - V * sp.sin(PSI) + current[0],
        Y: U * sp.sin(PSI) + V * sp.cos(PSI) + current[1],
        PSI: R,
    }
    g1, g2 = law.outputs["u"], law.outputs["r"]
    alpha = -hf.symbol("k_u") * (U - g1) + sum(g1.diff(q) * rate for q, rate in over_ground.items())
    beta = -hf.symbol("k_r") * (R - g2) + sum(g2.diff(q) * rate for q, rate in over_ground.items())
    sway = (-m11 * U * R + p["Yv"] * V + p["Yvv"] * magnitude(V) * V) / m22
    tau_u = m11 * alpha - m22 * V * R - p["Xu"] * U - p["Xuu"] * magnitude(U) * U
    tau_r = m33 * beta - (m11 - m22) * U * V - p["Nr"] * R - p["Nrr"] * magnitude(R) * R
    left_out = m33 * g2.diff(V) * sway
    differences = (forces["tau_u"] - tau_u, forces["tau_r"] - tau_r - left_out)
    symbols = sorted(set().union(*(d.free_symbols for d in differences)), key=str)
    values = {q.symbol: q.value for q in (*law.parameters, *vehicle.parameters)}
    values |= {hf.symbol("k_u"): 5.0, hf.symbol("k_r"): 10.0}
    generator = np.random.default_rng(4)
    for _ in range(20):
        at = {s: values.get(s, generator.uniform(-0.4, 0.4)) for s in symbols}
        for difference, force in zip(differences, forces.values(), strict=True):
            assert number_at(difference, at) == pytest.approx(
                0, abs=1e-9 * (1 + abs(number_at(force, at)))
            )
    assert left_out != 0


# -- the viability conditions (5.38) ----------------------------------------------------------

ALPHA, HALF, NEAR, FAR = (
    hf.symbol(n) for n in ("half_angle", "target_half_width", "range_min", "range_max")
)
TANGENT = {
    "c1": Y - X * sp.tan(PSI - ALPHA) + HALF,
    "c2": HALF - Y + X * sp.tan(PSI + ALPHA),
    "c3": NEAR + X / sp.cos(PSI),
    "c4": -X / sp.cos(PSI) - FAR,
}
PRINTED = {  # (5.38a-d) with (Vc cos(beta_c), Vc sin(beta_c)) = (Vx, Vy)
    "c1": (-sp.tan(PSI - ALPHA) * sp.cos(PSI) + sp.sin(PSI)) * U
    - X / sp.cos(PSI - ALPHA) ** 2 * R
    + (sp.tan(PSI - ALPHA) * sp.sin(PSI) + sp.cos(PSI)) * V
    - sp.tan(PSI - ALPHA) * VX
    + VY,
    "c2": (sp.tan(PSI + ALPHA) * sp.cos(PSI) - sp.sin(PSI)) * U
    + X / sp.cos(PSI + ALPHA) ** 2 * R
    - (sp.tan(PSI + ALPHA) * sp.sin(PSI) + sp.cos(PSI)) * V
    + sp.tan(PSI + ALPHA) * VX
    - VY,
    "c3": U + X * R - sp.tan(PSI) * V + VX / sp.cos(PSI),
    "c4": sp.tan(PSI) * V - U - X * R - VX / sp.cos(PSI),
}


@pytest.fixture(scope="module")
def tangent_rates(vehicle):
    camera = hf.regions.camera_view()
    inequalities = tuple(hf.Inequality(n, e) for n, e in TANGENT.items())
    region = hf.Region("tangent", camera.reads, inequalities, camera.parameters)
    return hf.outward_rates(hf.promote(vehicle, ("u", "r")), region)


@pytest.mark.parametrize("name", ["c1", "c2"])
def test_conditions_5_38ab_are_the_derived_rates_in_the_current(tangent_rates, name):
    """And (5.24), (5.25a) those in still water."""
    assert sp.simplify((tangent_rates[name] - PRINTED[name]).rewrite(sp.cos)) == 0


@pytest.mark.parametrize(("name", "sign"), [("c3", 1), ("c4", -1)])
def test_conditions_5_38cd_and_5_25bc_have_a_wrong_derivative_in_the_heading(
    tangent_rates, name, sign
):
    """E1: d c3 / d psi = x sec(psi) tan(psi), printed as x; the rest is right."""
    slip = sign * X * R * (sp.tan(PSI) / sp.cos(PSI) - 1)
    assert sp.simplify(tangent_rates[name] - PRINTED[name] - slip) == 0
    away = {X: -1.0, PSI: 0.0, U: 0.0, V: 0.0, VX: 0.0, R: 0.5}
    assert number_at(PRINTED["c3"], away) == -0.5, (
        "turning in front of the wall was said to back off"
    )
    assert number_at(tangent_rates["c3"], away) == 0


def test_angular_and_tangent_forms_ask_the_same_of_the_inputs_in_a_current(vehicle, tangent_rates):
    """On each boundary one rate is a positive multiple of the other, whatever u, r, v and current."""
    angular = hf.outward_rates(hf.promote(vehicle, ("u", "r")), hf.regions.camera_view())
    values = {p.symbol: p.value for p in hf.regions.camera_view().parameters}
    generator = np.random.default_rng(6)
    names = zip(angular, TANGENT, strict=True)
    for (ours, printed), _ in itertools.product(names, range(8)):
        psi = generator.uniform(-0.9, 0.9)
        x = {"c3": -0.35 * math.cos(psi), "c4": -2 * math.cos(psi)}.get(printed, -1.0)
        y = {
            "c1": -0.1 + x * math.tan(psi - math.pi / 6),
            "c2": 0.1 + x * math.tan(psi + math.pi / 6),
        }
        pose = values | {X: x, Y: y.get(printed, 0.1), PSI: psi}
        assert number_at(TANGENT[printed], pose) == pytest.approx(0, abs=1e-12)
        ratios = []
        for _ in range(4):
            moving = pose | {s: generator.uniform(-0.3, 0.3) for s in (U, V, R, VX, VY)}
            ratios.append(
                number_at(angular[ours], moving) / number_at(tangent_rates[printed], moving)
            )
        assert min(ratios) > 0
        assert ratios == pytest.approx([ratios[0]] * 4, rel=1e-3)  # a guard of 1e-6 in the bearing


def test_redesign_in_a_current_blends_velocities_relative_to_the_water(vehicle):
    """(5.39)-(5.41): the same blend; of its laws only r_conv knows of the current."""
    region = hf.regions.camera_view()
    go, face = (
        hf.laws.steer_marine(vehicle, disturbance_measured=True),
        hf.laws.face_target(vehicle),
    )
    near, far = hf.laws.back_off(go), hf.laws.move_ahead(go)
    viable = {"edge_low": face, "edge_high": face, "too_near": near, "too_far": far}
    layers = dict.fromkeys(region.inequality_names, (-0.12, -0.04))
    blend = hf.redesign(go, region, viable=viable, layers=layers)
    for law in viable.values():
        for output in law.outputs.values():
            assert not output.free_symbols & {VX, VY}
    law = blend.modes["protect"]
    values = {p.symbol: p.value for p in law.parameters}
    generator = np.random.default_rng(9)
    served = set()
    for _ in range(80):
        at = values | {X: generator.choice([-1.9, -1.0, -0.42]), Y: generator.uniform(-0.5, 0.5)}
        at |= {PSI: generator.uniform(-0.3, 0.3), V: 0.02, VX: -0.04, VY: 0.03}
        sigma = {n: number_at(blend.signals[f"sigma_{n}"], at) for n in viable}
        active = min(sigma, key=sigma.get)
        if not 0 < sigma[active] < 1:
            continue
        served.add(active)
        for name in ("u", "r"):
            convergent, safe = (number_at(one.outputs[name], at) for one in (go, viable[active]))
            wanted = sigma[active] * convergent + (1 - sigma[active]) * safe
            assert number_at(law.outputs[name], at) == pytest.approx(wanted, rel=1e-9)
    assert len(served) >= 3


# -- the ultimate bound (5.35) ------------------------------------------------------------------


@pytest.mark.few("0.13-0.7562")
@pytest.mark.smoke
@pytest.mark.parametrize(
    ("speed", "bound"),
    [(0.02, 0.0838), (0.05, 0.2155), (0.10, 0.4888), (0.13, 0.7562), (0.15, 1.1447)],
)
def test_bound_is_exact_in_every_direction_of_the_current(vehicle, speed, bound):
    """(5.35) to four digits, cos(beta_c) < 0 or not: the proof has E5, the bound is right.

    And Lemma 4: the vehicle ends along the current, modulo pi.
    """
    assert ultimate_bound(K1, MU, speed) == pytest.approx(bound, abs=5e-5)
    law = hf.laws.steer_marine(vehicle, disturbance_measured=True)
    for direction in (0.0, 60.0, 135.0, 180.0):
        angle = math.radians(direction)
        draws = {"speed": (speed, speed), "direction": (angle, angle)}
        data = in_current(vehicle, law, somewhere(20), draws, horizon=600.0)
        assert from_goal(data)[:, -1] == pytest.approx(ultimate_bound(K1, MU, speed), rel=1e-4)
        assert np.abs(np.sin(data["state"].values[:, -1, 2] - angle)).max() < 1e-3


def test_bound_is_exact_in_currents_drawn_at_random_whether_the_law_is_told_of_them_or_not(vehicle):
    """Of any direction, up to 0.15 m/s."""
    draws = {"speed": (0.005, 0.15), "direction": (-math.pi, math.pi)}
    ends = {}
    for measured in (True, False):
        law = hf.laws.steer_marine(vehicle, disturbance_measured=measured)
        data = in_current(vehicle, law, somewhere(200), draws, horizon=800.0)
        bound = [ultimate_bound(K1, MU, s) for s in data["varied"].values[:, 0]]
        assert from_goal(data)[:, -1] == pytest.approx(bound, rel=1e-3)
        ends[measured] = data["state"].values[:, -1, 0] < -0.5
    assert 0 < (ends[True] != ends[False]).mean() < 0.2, "only the basins of the two ends differ"


def test_vehicle_ends_before_or_behind_the_pose_by_where_it_starts(vehicle):
    """Lemma 4 has psi_e = beta_c +- pi; with beta_c = 135 degrees both ends are reached."""
    law = hf.laws.steer_marine(vehicle, disturbance_measured=True)
    angle = math.radians(135)
    draws = {"speed": (0.05, 0.05), "direction": (angle, angle)}
    end = in_current(vehicle, law, somewhere(60), draws)["state"].values[:, -1]
    behind = end[:, 0] < -0.5
    assert 0.2 < behind.mean() < 0.8
    against, along = np.cos(end[behind, 2] - angle), np.cos(end[~behind, 2] - angle)
    assert against == pytest.approx(-1, abs=1e-6)
    assert along == pytest.approx(1, abs=1e-6)


@pytest.mark.smoke
@pytest.mark.parametrize("current", [0.16, 0.2, -0.1, math.nan])
def test_current_that_the_vehicle_cannot_overcome_has_no_bound(current):
    complaint = "carries away" if current >= K1 else "expected a speed"
    with pytest.raises(DefinitionError, match=complaint):
        ultimate_bound(K1, MU, current)


@pytest.mark.smoke
def test_gains_without_sense_have_no_bound():
    for k1, mu in ((0.0, 1.5), (0.16, -1.0), (math.inf, 1.0)):
        with pytest.raises(DefinitionError, match="expected a finite number above 0"):
            ultimate_bound(k1, mu, 0.0)
    assert ultimate_bound(K1, MU, 0.0) == 0.0


@pytest.mark.parametrize("share", [0.6, 1.3])
def test_heading_settles_in_a_current_on_either_side_of_the_gain_limit(vehicle, share):
    """E6 is about the goal itself, where the surge vanishes; in a current it never does."""
    k1 = share * 0.3508 / MU
    draws = {"speed": (0.05, 0.05), "direction": (-math.pi, math.pi)}
    with pytest.warns(hf.GainWarning) if share > 1 else contextlib.nullcontext():
        data = in_current(
            vehicle,
            hf.laws.steer_marine(vehicle, k1=k1, disturbance_measured=True),
            somewhere(60),
            draws,
        )
    angle = data["varied"].values[:, 1]
    assert np.abs(np.sin(data["state"].values[:, -1, 2] - angle)).max() < 0.01
    assert from_goal(data)[:, -1] == pytest.approx(ultimate_bound(k1, MU, 0.05), rel=1e-3)


def turning(vehicle, measured, rate):
    """The largest distance after the transient, over that of a constant current."""
    law = hf.laws.steer_marine(vehicle, disturbance_measured=measured)
    draws = {"speed": (0.05, 0.05), "direction": (-math.pi, math.pi), "turn": (rate, rate)}
    data = in_current(
        vehicle, law, somewhere(30), draws, DIRECTION + TURN * hf.TIME, 1600.0, record_every=0.5
    )
    return from_goal(data)[:, data["time"].values > 400].max() / ultimate_bound(K1, MU, 0.05)


@pytest.mark.parametrize(
    ("rate", "told", "untold"), [(0.005, 1.058, 1.122), (0.02, 1.038, 1.101), (0.2, 0.812, 0.836)]
)
def test_current_that_turns_slowly_pushes_the_vehicle_a_little_beyond_the_bound(
    vehicle, rate, told, untold
):
    """Remark 2 has the bound for currents of any, not necessarily constant, direction.

    One that turns fast is averaged out; one that turns slowly drags the vehicle from one end to
    the other, by up to 6 % beyond the bound, 12 % where the law is not told.
    """
    assert turning(vehicle, True, rate) == pytest.approx(told, abs=0.01)
    assert turning(vehicle, False, rate) == pytest.approx(untold, abs=0.01)


def test_current_that_jumps_pushes_the_vehicle_far_beyond_the_bound(vehicle):
    """Remark 2 is false: a new direction every 10 s, at random, 1.4 times the bound and more."""
    period = 10.0
    step = hf.TIME / period - (wrap(2 * sp.pi * hf.TIME / period - sp.pi) + sp.pi) / (2 * sp.pi)
    angle = DIRECTION + 1e4 * sp.sin(12.9898 * (step + 1 + 7 * DIRECTION))
    draws = {"speed": (0.05, 0.05), "direction": (-math.pi, math.pi)}
    worst = {}
    for measured in (True, False):
        law = hf.laws.steer_marine(vehicle, disturbance_measured=measured)
        data = in_current(vehicle, law, somewhere(40), draws, angle, 1200.0, record_every=0.2)
        tail = from_goal(data)[:, data["time"].values > 300]
        worst[measured] = tail.max() / ultimate_bound(K1, MU, 0.05)
    assert worst[True] == pytest.approx(1.46, abs=0.02)
    assert worst[False] == pytest.approx(1.59, abs=0.02)


# -- viability in a current ------------------------------------------------------------------------


def resting_pose(speed, angle):
    """Where the vehicle rests behind its goal, bow against a current of direction pi + angle."""
    rho, lam = ultimate_bound(K1, MU, speed), 3.0

    def field(theta):
        a, b = math.cos(theta), math.sin(theta)
        return math.atan2(lam * a * b, (lam - 1) * a**2 - b**2)

    low, high = math.pi / 2 + 1e-9, 3 * math.pi / 2 - 1e-9
    for _ in range(60):  # the direction of the field rises from -pi to pi on this half circle
        middle = (low + high) / 2
        low, high = (middle, high) if field(middle) < angle else (low, middle)
    return -0.5 + rho * math.cos(low), rho * math.sin(low), angle


def in_view(pose):
    x, y, psi = pose
    low, high = math.atan2(-0.1 - y, -x), math.atan2(0.1 - y, -x)
    return (
        psi - math.pi / 6 <= low and high <= psi + math.pi / 6 and -2 <= x / math.cos(psi) <= -0.35
    )


@pytest.mark.parametrize(("speed", "window"), [(0.02, 22), (0.05, 27), (0.08, 32), (0.10, 35.5)])
def test_target_stays_in_view_at_rest_only_in_a_narrow_window_of_directions(speed, window):
    """Remark 3 has cos(beta_c) < 0, a window of 90 degrees either way."""
    seen = [d for d in np.arange(0, 89, 0.25) if in_view(resting_pose(speed, math.radians(d)))]
    assert max(seen) == pytest.approx(window, abs=0.5)
    assert len(seen) == round(max(seen) / 0.25) + 1, "one window, from 0 on"


def test_resting_pose_is_where_the_vehicle_ends(vehicle):
    law = hf.laws.steer_marine(vehicle, disturbance_measured=True)
    for angle in (0.0, 0.3, -0.6):
        draws = {"speed": (0.05, 0.05), "direction": (math.pi + angle, math.pi + angle)}
        end = in_current(vehicle, law, np.array([[-1.5, -0.2, 0.1, 0.0]]), draws)["state"].values[
            0, -1
        ]
        assert end[:3] == pytest.approx(resting_pose(0.05, angle), abs=1e-4)


@pytest.mark.parametrize(
    ("angle", "low", "high"), [("pi", 0.95, 0.97), ("5*pi/6", 0.90, 1.0), ("0", 0.0, 0.2)]
)
def test_blend_keeps_the_view_in_a_current_away_from_the_wall_and_loses_it_towards_the_wall(
    angle, low, high
):
    """At 0.05 m/s and 5 N; reference .985 at 180 degrees, .125 at 0."""
    changes = [
        f"disturbance.Vx=current_limit*cos({angle})",
        f"disturbance.Vy=current_limit*sin({angle})",
    ]
    data = hf.load_scenario("ch5-current", [ARM, *changes]).run().dataset
    viable = (data["worst_constraint"].values <= 1e-3).all(axis=1)
    assert low <= viable.mean() <= high
    if angle == "pi":
        states = data["state"].values[:, -1]
        assert (np.hypot(states[:, 0] + 0.5, states[:, 1]) < 0.2155 + 0.01).all(), (
            "every run in the ball"
        )
        assert (viable.sum(), len(viable)) == (193, 201), "no guarantee even there"
        assert np.hypot(states[0, 0] + 0.5, states[0, 1]) == pytest.approx(0.22, abs=0.005)
        assert data["worst_constraint"].values[0].max() <= 1e-3, "the start of Fig. 5.11"


def test_convergent_law_alone_keeps_no_view_in_a_current_thirty_degrees_off():
    """Vc = 0.05 m/s, beta_c = 150 degrees: reference 0 %."""
    angle = "5*pi/6"
    changes = [
        f"disturbance.Vx=current_limit*cos({angle})",
        f"disturbance.Vy=current_limit*sin({angle})",
    ]
    scenario = hf.load_scenario(
        "ch5-leaves-view",
        [ARM, "system.current_limit=0.05", "law.disturbance_measured=true", *changes],
        runs=200,
    )
    data = scenario.run().dataset
    assert (data["worst_constraint"].values <= 1e-3).all(axis=1).mean() == 0


def test_any_current_leaves_the_vehicle_near_the_goal_set_but_not_in_view():
    """Fig. 5.13: within the bound of G nearly always, in view for the favourable half at most."""
    data = hf.load_scenario("ch5-any-current").run().dataset
    off = 180 - np.abs(np.degrees(data["varied"].values[:, 0]))
    end = data["state"].values[:, -1]
    near = np.abs(np.hypot(end[:, 0], end[:, 1]) - 0.5) < 0.2155 + 0.01
    viable = (data["worst_constraint"].values <= 1e-3).all(axis=1)
    through = data["state"].values[:, :, 0].max(axis=1) > 0
    assert len(near) - near.sum() == pytest.approx(1, abs=1)
    assert viable[off < 80].mean() == pytest.approx(0.97, abs=0.01)
    assert viable[off > 100].mean() == 0
    assert through[off > 100].mean() > 0.95, "through the wall, which the law does not know of"
