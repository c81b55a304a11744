"""Switching signal, blending and the latch; velocity tracking derived from the plant."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.control.blended_redesign import switching_signals
from tests.conftest import number_at

X = hf.symbol("x")
POSITION = (hf.Quantity("x", "m"),)
LINE = hf.Region("line", POSITION, (hf.Inequality("right", X - 1), hf.Inequality("left", -X - 1)))
GO = hf.Law("go", POSITION, {"v": sp.Float(1.0)})
BACK = hf.Law("back", POSITION, {"v": sp.Float(-1.0)})
AHEAD = hf.Law("ahead", POSITION, {"v": sp.Float(0.5)})
LAYERS = {"right": (-0.2, -0.1), "left": (-0.2, -0.1)}
VIABLE = {"right": BACK, "left": AHEAD}


def output(switching, mode, x):
    return float(switching.modes[mode].outputs["v"].subs(X, x))


def test_switching_signal_is_one_deep_inside_and_zero_near_the_boundary():
    """E2: the printed (5.26) has it the other way round in its middle branch."""
    signal = switching_signals(LINE, LAYERS)["right"]
    assert [float(signal.subs(X, x)) for x in (0.8, 0.85, 0.9)] == pytest.approx([1, 0.5, 0])


def test_blend_is_convergent_inside_viable_at_the_boundary_and_serves_the_nearest_one():
    blend = hf.redesign(GO, LINE, viable=VIABLE, layers=LAYERS)
    assert [output(blend, "protect", x) for x in (0.0, 0.8, 0.85, 0.95, -0.95)] == pytest.approx(
        [1, 1, 0, -1, 0.5]
    )
    assert [float(blend.signals["sigma_right"].subs(X, x)) for x in (0.0, 0.95)] == [1, 0]


def test_modes_say_whether_a_viable_law_is_at_work():
    blend = hf.redesign(GO, LINE, viable=VIABLE, layers=LAYERS)
    to_protect = next(t for t in blend.transitions if t.target == "protect")
    to_pursue = next(t for t in blend.transitions if t.target == "pursue")
    assert float(to_protect.when.subs(X, 0.85)) > 0 > float(to_protect.when.subs(X, 0.5))
    assert float(to_pursue.when.subs(X, 0.5)) > 0 > float(to_pursue.when.subs(X, 0.85))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"viable": {"right": BACK}}, "'left' has no viable law"),
        ({"layers": {"right": (-0.2, -0.1)}}, "'left' has no layer"),
        ({"viable": VIABLE | {"rihgt": BACK}}, "did you mean 'right'"),
        ({"layers": LAYERS | {"left": (-0.1, -0.2)}}, "cmax < cmin < 0"),
        ({"layers": LAYERS | {"left": (-0.1, 0.2)}}, "cmax < cmin < 0"),
        ({"hold": BACK}, "together or not at all"),
        ({"viable": VIABLE | {"left": hf.Law("w", POSITION, {"w": X})}}, "gives w"),
    ],
)
def test_incomplete_redesign_is_refused(changes, complaint):
    with pytest.raises(DefinitionError) as caught:
        hf.redesign(GO, LINE, **({"viable": VIABLE, "layers": LAYERS} | changes))
    assert complaint in str(caught.value)


def test_printed_signal_is_upside_down_between_the_thresholds_and_right_outside_them():
    """E2: (5.26) as printed is 0 at cmax and 1 at cmin, and jumps at both."""
    blend = hf.redesign(GO, LINE, viable=VIABLE, layers=LAYERS, as_printed=True)
    sigma = [float(blend.signals["sigma_right"].subs(X, x)) for x in (0.5, 0.81, 0.85, 0.89, 0.95)]
    assert sigma == pytest.approx([1, 0.1, 0.5, 0.9, 0])
    assert [output(blend, "protect", x) for x in (0.81, 0.89, 0.95)] == pytest.approx(
        [-0.8, 0.8, -1]
    )
    corrected = hf.redesign(GO, LINE, viable=VIABLE, layers=LAYERS)
    for one, other in zip(blend.transitions, corrected.transitions, strict=True):
        assert one == other, "the modes change where they do with the corrected signal"


@pytest.mark.parametrize(
    ("goal", "complaint"),
    [
        ({"x": 0.85}, "(x = 0.85) is inside the switching layer: 'right' is -0.15 1 there"),
        ({"x": 0.8}, "inside the switching layer: 'right' is -0.2 1 there, its layer [-0.2, -0.1]"),
        ({"x": -1.5}, "is outside the region: 'left' is 0.5 1 there"),
        ({"x": float("nan")}, "is outside the region: 'right' is nan"),
        ({"z": 0.0}, "goal of 'z'; allowed: x"),
    ],
)
def test_goal_that_the_convergent_law_is_not_left_alone_at_is_refused(goal, complaint):
    with pytest.raises(DefinitionError) as caught:
        hf.redesign(GO, LINE, viable=VIABLE, layers=LAYERS, goal=goal)
    assert complaint in str(caught.value)
    hf.redesign(GO, LINE, viable=VIABLE, layers=LAYERS, goal={"x": 0.79})


def of_the_camera(vehicle, **changes):
    go, face = hf.laws.steer_marine(vehicle, **changes), hf.laws.face_target(vehicle)
    region = hf.regions.camera_view()
    viable = dict.fromkeys(("edge_low", "edge_high"), face)
    viable |= {"too_near": hf.laws.back_off(go), "too_far": hf.laws.move_ahead(go)}
    layers = dict.fromkeys(region.inequality_names, (-0.12, -0.04))
    return hf.redesign(go, region, viable=viable, layers=layers, hold=face, hold_when=X)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        (
            {"goal_x": -0.3},
            "(x = -0.3, y = 0, psi = 0) is outside the region: 'too_near' is 0.05 m",
        ),
        ({"goal_x": -0.4}, "is inside the switching layer: 'too_near' is -0.05 m there"),
        ({"goal_y": 0.15}, "is inside the switching layer: 'edge_low'"),
    ],
)
def test_goal_of_a_law_that_says_where_it_goes_is_checked_unasked(vehicle, changes, complaint):
    with pytest.raises(DefinitionError) as caught:
        of_the_camera(vehicle, **changes)
    assert complaint in str(caught.value)


def test_every_mode_is_told_what_one_law_is_told(vehicle):
    """(5.37): the forces of every mode take the current into account, or none does."""
    for measured in (True, False):
        safe = of_the_camera(vehicle, disturbance_measured=measured)
        assert {*safe.modes} == {"pursue", "protect", "hold"}
        for law in hf.track_velocity(vehicle, safe, {"u": 5.0, "r": 10.0}).modes.values():
            assert ({"Vx", "Vy"} <= {q.name for q in law.reads}) == measured


def test_laws_that_believe_different_things_are_refused():
    def believing(value):
        return hf.Law("law", POSITION, {"v": X}, believed={"w": sp.Float(value)})

    redesign = {"viable": {"right": believing(1), "left": BACK}, "layers": LAYERS}
    assert float(hf.redesign(GO, LINE, **redesign).modes["pursue"].believed["w"]) == 1
    with pytest.raises(DefinitionError, match="expected one belief in all laws"):
        hf.redesign(believing(2), LINE, **redesign)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ("law.goal_x=-0.3", "redesign: the goal of 'steer_marine'"),
        ("redesign.goal={x=-0.4}", "'too_near' is -0.05 m there, its layer [-0.1, -0.03]"),
        ("redesign.goal={x='goal_x + 0.2'}", "is outside the region"),
        ("redesign.goal={x='psi'}", "redesign.goal.x: psi is not a number"),
        ("redesign.goal={z=0}", "redesign: goal of 'z'"),
        ("redesign.layers.too_far=[-0.03, -0.1]", "cmax < cmin < 0"),
        (
            "redesign.as_printed=['face']",
            "'face' is not a part of this redesign; allowed: back_off",
        ),
        ("redesign.as_printed=1", "redesign.as_printed"),
    ],
)
def test_redesign_of_a_file_is_refused_with_the_reason(change, complaint):
    from holdfast.errors import ScenarioError

    with pytest.raises(ScenarioError) as caught:
        hf.load_scenario("ch5-viable-goal-set", [change])
    assert complaint in str(caught.value)


def test_redesign_of_a_file_as_printed_is_that_of_python(vehicle):
    whole = hf.load_scenario("ch5-viable-goal-set", ["redesign.as_printed=true"]).law
    assert "as printed" in whole.source
    one = hf.load_scenario("ch5-viable-goal-set", ["redesign.as_printed=['back_off']"]).law
    usual = hf.load_scenario("ch5-viable-goal-set").law
    assert one.signals == usual.signals != whole.signals
    assert one.modes["hold"].outputs == usual.modes["hold"].outputs != whole.modes["hold"].outputs
    assert one.modes["protect"].outputs != usual.modes["protect"].outputs
    assert one.modes["pursue"].outputs == usual.modes["pursue"].outputs


@pytest.mark.parametrize(
    "build",
    [
        lambda v: hf.laws.face_target(v, as_printed=1),
        lambda v: hf.laws.back_off(hf.laws.steer_marine(v), as_printed="yes"),
        lambda v: hf.laws.steer_marine(v, disturbance_measured=None),
        lambda v: hf.redesign(GO, LINE, viable=VIABLE, layers=LAYERS, as_printed="no"),
    ],
)
def test_choice_that_is_neither_true_nor_false_is_refused(vehicle, build):
    with pytest.raises(DefinitionError, match="expected true or false"):
        build(vehicle)


def test_law_cannot_measure_a_current_that_the_system_does_not_have():
    bare = ("x", "y", "psi", "v", "u", "r")
    states = tuple(hf.Quantity(n) for n in bare)
    system = hf.System("still", states, (hf.Quantity("a"),), dict.fromkeys(bare, hf.symbol("a")))
    with pytest.raises(DefinitionError):
        hf.laws.steer_marine(system, disturbance_measured=True)


def test_tracked_velocities_approach_the_commanded_ones_exponentially(vehicle):
    """(5.22): along the plant d/dt (w - gamma) = -k (w - gamma), at random states."""
    kinematic = hf.laws.steer_marine(vehicle)
    law = hf.track_velocity(vehicle, kinematic, {"u": 5.0, "r": 10.0})
    still = {hf.symbol("Vx"): 0, hf.symbol("Vy"): 0}
    values = {p.symbol: p.value for p in (*law.parameters, *vehicle.parameters)}
    closed = {hf.symbol(n): e for n, e in law.outputs.items()}
    rates = {n: e.subs(still).subs(closed).subs(values) for n, e in vehicle.rates.items()}
    generator = np.random.default_rng(3)
    for _ in range(10):
        low, high = [-2, -1, -1, -0.3, -0.1, -1], [-0.7, 1, 1, 0.3, 0.1, 1]
        point = dict(
            zip([q.symbol for q in vehicle.states], generator.uniform(low, high), strict=True)
        )
        flow = {n: number_at(e, point) for n, e in rates.items()}
        for name, gain in (("u", 5.0), ("r", 10.0)):
            error = hf.symbol(name) - kinematic.outputs[name].subs(values)
            change = sum(number_at(error.diff(hf.symbol(n)), point) * f for n, f in flow.items())
            assert change == pytest.approx(-gain * number_at(error, point), rel=1e-6, abs=1e-8)


@pytest.mark.parametrize(
    ("outputs", "gains", "complaint"),
    [
        ({"u": X, "w": X}, {"u": 1, "w": 1}, "'w', which is not a state"),
        (
            {"u": X, "v": X, "r": X},
            {"u": 1, "v": 1, "r": 1},
            "at most as many velocities as inputs",
        ),
        ({"u": X, "r": X}, {"u": 1}, "gain for 'r' is missing"),
        ({"u": X, "r": X}, {"u": 1, "r": 0}, "expected > 0"),
        ({"x": X, "y": X}, {"x": 1, "y": 1}, "cannot be solved"),
        ({"u": hf.symbol("r"), "r": hf.symbol("u")}, {"u": 1, "r": 1}, "in a circle: u -> r -> u"),
    ],
)
def test_velocities_that_cannot_be_tracked_are_refused(vehicle, outputs, gains, complaint):
    law = hf.Law("law", vehicle.states, outputs)
    with pytest.raises(DefinitionError) as caught:
        hf.track_velocity(vehicle, law, gains)
    assert complaint in str(caught.value)


def test_velocity_may_depend_on_another_one_that_is_tracked():
    """Its rate is then the one given to that other velocity, so that tracking is exact."""
    a, b, u, r = (hf.symbol(n) for n in ("a", "b", "u", "r"))
    states = tuple(hf.Quantity(n) for n in ("x", "u", "r"))
    system = hf.System("s", states, (hf.Quantity("a"), hf.Quantity("b")), {"x": u, "u": a, "r": b})
    law = hf.Law("law", states, {"u": -X, "r": u * X})
    tracked = hf.track_velocity(system, law, {"u": 2.0, "r": 3.0})
    closed = {a: tracked.outputs["a"], b: tracked.outputs["b"]}
    gains = {hf.symbol("k_u"): 2, hf.symbol("k_r"): 3}
    for name, k in (("u", 2), ("r", 3)):
        error = hf.symbol(name) - law.outputs[name]
        rate = system.derivative(error).subs(closed).subs(gains)
        assert sp.simplify(rate + k * error) == 0
    pushed = hf.System("s", states, (hf.Quantity("a"),), {"x": u, "u": a, "r": a})
    with pytest.raises(DefinitionError, match="which the inputs drive directly"):
        hf.track_velocity(pushed, hf.Law("law", states, {"u": r}), {"u": 1.0})
