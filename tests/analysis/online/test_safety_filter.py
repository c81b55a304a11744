"""A filter around a controller of one's own: the inputs of `simulate`, and names for all the rest."""

import copy
import math
import pickle
import re
import warnings

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import ArgumentError, DefinitionError, HoldfastError, SimulationError
from tests.c_code import built, needs_gcc


@pytest.fixture(scope="module")
def view():
    return hf.regions.camera_view()


@pytest.fixture(scope="module")
def keeper(vehicle, view):
    return hf.SafetyFilter(vehicle, view, gains=(1.5, 8))


@pytest.fixture(scope="module")
def braking(double_integrator, wall):
    return hf.SafetyFilter(double_integrator, wall, gains=(1.0, 4.0))


@pytest.fixture(scope="module")
def boat():
    """x' = u + d, |u| <= 1, |d| <= 0.5, kept in |x| <= 1 for 2 s."""
    x, u, d = (hf.symbol(n) for n in ("x", "u", "d"))
    system = hf.System(
        "boat", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": u + d},
        disturbances=(hf.Quantity("d", "m/s"),), input_bounds=hf.Box((-1,), (1,)),
        disturbance_bounds=hf.Box((-0.5,), (0.5,)),
    )  # fmt: skip
    region = hf.Region("canal", system.states, (hf.Inequality("banks", x**2 - 1, "m^2"),))
    value = hf.discriminating_kernel(system, region, hf.grid(system, {"x": (-1.3, 1.3)}, 131), 2.0)
    return system, value


def around(center, size, count=400, seed=0):
    return np.array(center) + size * np.random.default_rng(seed).normal(size=(count, len(center)))


# -- the numbers


def test_inputs_of_the_filter_are_those_of_the_safeguard_in_the_closed_loop(vehicle, view):
    """The filter around the law's own commands drives the vehicle as the safeguarded law does."""
    law = hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})
    whole = hf.safeguard(vehicle, law, view, gains=(1.5, 8))
    start = [-1.5, 0.55, -0.3, 0.0, 0.0, 0.0]
    data = hf.simulate(
        vehicle, whole, starts=[start], horizon=6.0, record_every=0.02, region=view
    ).dataset
    keeper = hf.SafetyFilter(vehicle, view, gains=(1.5, 8))
    states, wanted = data["state"].values[0], data["nominal"].values[0]
    given = data["input"].values[0]
    changed = 0
    for t, q, w, u in zip(data["time"].values, states, wanted, given, strict=True):
        decision = keeper.step(q, w, t)
        assert decision.actuators == pytest.approx(data["actuator"].sel(time=t).values[0], abs=0)
        assert decision.input == pytest.approx(u, abs=1e-14)
        assert np.array_equal(decision.nominal, w)
        changed += decision.overruled
    assert changed == data["overruled"].values[0] > 20


def test_input_after_a_measurement_that_was_none_ramps_from_the_fallback_that_was_sent():
    """1 m/s^2 at most, samples of 0.1 s: from 0.5 to 0.6 m/s, although it was the first sample."""
    x, u = hf.symbol("x"), hf.symbol("u")
    line = hf.System(
        "line", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": u},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    far = hf.Region("far", line.states, (hf.Inequality("right", x - 10, "m"),))
    keep = hf.SafetyFilter(line, far, sample_time=0.1, rates={"u": 1.0}, fallback=[0.5])
    for blind, seen in (
        (keep.step([math.nan], [1.0]).input, keep.step([0.0], [1.0]).input),
        (keep.step_many([[math.nan]], [[1.0]]).input[0], keep.step_many([[0.0]], [[1.0]]).input[0]),
    ):
        assert (*blind, *seen) == pytest.approx((0.5, 0.6))


def test_many_decisions_are_those_of_one_at_a_time(vehicle, keeper):
    states = around([-1.5, 0.5, -0.3, 0.1, 0.0, 0.0], 0.2)
    commands = around([1.0, 0.1], 4.0, seed=1)
    states[7, 2] = math.nan
    commands[11, 0] = math.inf
    found = keeper.step_many(states, commands)
    assert len(found.status) == 400
    kinds = set()
    for k, (q, w) in enumerate(zip(states, commands, strict=True)):
        keeper.reset()
        one = keeper.step(q, w, 0.0)
        assert one.status is found.status[k]
        assert np.array_equal(one.input, found.input[k])
        assert np.array_equal(one.actuators, found.actuators[k])
        assert np.array_equal(one.nominal, found.nominal[k], equal_nan=True)
        assert one.overruled == found.overruled[k]
        assert one.slack == found.slack[k]
        assert one.value == pytest.approx(found.value[k], abs=0, nan_ok=True)
        kinds.add(one.status)
    assert kinds >= {hf.Status.PASSED, hf.Status.CHANGED, hf.Status.NOT_A_NUMBER}
    assert keeper.step_many(states[:0], commands[:0]).input.shape == (0, 2)


def test_input_is_the_admissible_one_nearest_to_the_command(braking):
    """x <= 1: v' = a <= -(5 v + 4 (x - 1)), |a| <= 1; in closed form."""
    for x, v, w in around([0.8, 0.2, 0.0], [0.2, 0.2, 1.0], 300):
        limit = -(5 * v + 4 * (x - 1))
        decision = braking.step([x, v], [w])
        if limit >= -1:
            assert decision.slack == 0
            assert decision.input[0] == pytest.approx(min(max(w, -1), limit, 1), abs=1e-12)
            same = decision.input[0] == w
            assert decision.status is (hf.Status.PASSED if same else hf.Status.CHANGED)
            assert decision.overruled == (limit < min(max(w, -1), 1))
        else:
            assert decision.status is hf.Status.INFEASIBLE
            assert decision.slack == pytest.approx(-1 - limit, rel=1e-9)
            assert decision.input[0] == pytest.approx(-1, abs=1e-9)
        assert decision.value == 1 - x


def test_wall_is_never_touched_whatever_is_commanded(double_integrator, wall, braking):
    """A hundred carts that are pushed towards it, sample by sample, for 10 s."""
    rng = np.random.default_rng(3)
    x, v = np.zeros(100), rng.uniform(0, 0.5, 100)
    h = braking.sample_time
    for k in range(500):
        command = rng.uniform(-0.5, 1.0, (100, 1)) if k % 2 else np.ones((100, 1))
        found = braking.step_many(np.stack([x, v], axis=1), command)
        a = found.input[:, 0]
        x, v = x + h * v + h**2 / 2 * a, v + h * a
        assert x.max() <= 1.0
    assert x.min() > 0.9, "and it is approached"


def test_kernel_is_kept_against_the_worst_disturbance(boat):
    """A command that drives out, the disturbance with it: V stays above 0 for its 2 s."""
    system, value = boat
    keeper = hf.SafetyFilter(system, value, sample_time=0.02)
    x, changed = 0.0, 0
    for _ in range(100):
        decision = keeper.step([x], [1.0])
        changed += decision.overruled
        assert decision.status in (hf.Status.PASSED, hf.Status.CHANGED)
        assert decision.value == pytest.approx(value.at([[x]])[0], abs=1e-3)
        assert decision.value <= value.at([[x]])[0], "what held inputs keep is within the kernel"
        x += 0.02 * (decision.input[0] + 0.5)
    assert changed > 40
    assert 0.8 < x < 1.0


@pytest.mark.heavy
def test_time_of_a_kernel_runs_out_by_name():
    """With values at several times the set is that of the remaining time."""
    scenario = hf.load_scenario(
        "ch7-any-current",
        ["grid.nodes=21", "march.horizon=0.4", "march.times=[0, 0.2, 0.4]", "promise="],
    )
    value = scenario.solve()
    with pytest.warns(hf.ModelWarning):
        keeper = hf.SafetyFilter(scenario.system, value, margin=0.0)
    inside = [-1.0, 0.0, 0.0]
    assert keeper.step(inside, [0.0, 0.0]).status is not hf.Status.OUTSIDE_GRID
    assert keeper.step(inside, [0.0, 0.0], t=-0.1).status is hf.Status.OUTSIDE_GRID
    late = keeper.step(inside, [0.0, 0.0], t=0.5)
    assert late.status is hf.Status.OUTSIDE_GRID
    assert "at 0.5 s the horizon of the discriminating-kernel has passed" in late.why
    assert keeper.step(inside, [0.0, 0.0], t=0.1).status is not hf.Status.OUTSIDE_GRID


# -- what a decision says


def test_decision_names_the_constraint_that_changed_the_command_beside_the_first_ahead():
    """The wall is near; the command, held, would have met the pillar first, which it may still."""
    x, y, u, w = (hf.symbol(n) for n in ("x", "y", "u", "w"))
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Quantity("u", "m/s"), hf.Quantity("w", "m/s")), {"x": u, "y": w},
        input_bounds=hf.Box((-10, -10), (10, 10)),
    )  # fmt: skip
    room = hf.Region(
        "room", cart.states,
        (hf.Inequality("wall", x - 1, "m"), hf.Inequality("pillar", y**2 - 4, "m^2")),
    )  # fmt: skip
    keep = hf.SafetyFilter(cart, room, gains=(1.0, 4.0))
    decision = keep.step([0.5, 0.2], [0.6, 9.0])  # u <= 1 - x; 2 y w <= 4 - y^2
    assert decision.input == pytest.approx([0.5, 9.0])
    assert decision.why == (
        "changed u from 0.6 to 0.5 m/s: 'wall' is 0.5 m away; with the command held 'pillar' "
        "would have been violated in 0.2 s"
    )
    assert keep.step([0.5, 0.2], [0.6, 0.0]).why.endswith(
        "'wall' is 0.5 m away; with the command held it would have been violated in 0.83 s"
    )


def test_subsystem_is_no_reduced_model_of_the_whole():
    """What it leaves out does not act on it: a filter of it stands in the loop of the whole."""
    v, u = hf.symbol("v"), hf.symbol("u")
    whole = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
        {"x": v, "v": u}, input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    alone = hf.subsystem(whole, ("v",))
    slow = hf.Region("slow", alone.states, (hf.Inequality("speed", v**2 - 1, "m^2/s^2"),))
    assert hf.SafetyFilter(alone, slow, around=whole).step([0.0], [0.5]).input == [0.5]
    late = hf.lagged(whole, {"u": 0.1})
    with pytest.warns(hf.ModelWarning, match="which leaves out how"):
        hf.SafetyFilter(alone, slow, around=late)


def test_decision_names_the_constraint_its_distance_and_what_would_have_followed(braking):
    decision = braking.step([0.9, 0.15], [1.0])
    assert decision.status is hf.Status.CHANGED
    # with a = 1: 0.1 = 0.15 t + t^2 / 2
    crossing = -0.15 + math.sqrt(0.15**2 + 0.2)
    assert decision.why == (
        "changed a from 1 to -0.35 m/s^2: 'wall' is 0.1 m away; with the command held it would "
        f"have been violated in {crossing:.2g} s"
    )
    assert "beyond the bounds of the inputs" in braking.step([0.0, 0.0], [3.0]).why
    assert braking.step([0.0, 0.0], [0.0]).why == (
        "the command meets every condition; the nearest: 'wall' is 1 m away"
    )
    lost = braking.step([0.99, 1.0], [1.0])
    assert lost.status is hf.Status.INFEASIBLE
    assert "no input within its bounds meets all conditions" in lost.why
    assert "m/s^2" in lost.why
    assert "'wall' is violated by 0.5 m already" in braking.step([1.5, 0.0], [0.0]).why
    assert repr(lost).startswith(f"<Decision at {lost.t:g} s: infeasible, input [-")


def test_decision_can_be_copied_and_sent_elsewhere(braking):
    decision = braking.step([0.9, 0.15], [1.0])
    assert copy.deepcopy(decision) is decision
    sent = pickle.loads(pickle.dumps(decision))
    assert (sent.status, sent.t, sent.overruled) == (decision.status, decision.t, True)
    assert np.array_equal(sent.input, decision.input)
    assert (sent.value, sent.why) == (decision.value, decision.why)


def test_decision_of_a_kernel_names_its_value(boat):
    system, value = boat
    keeper = hf.SafetyFilter(system, value)
    decision = keeper.step([0.93], [1.0])
    assert decision.overruled
    assert re.search(
        r"the value of the discriminating-kernel is 0\.\d+ m\^2 (above|below) its margin of 0\.\d+; "
        r"with the command held the set would have been left in 0\.\d+ s$", decision.why,
    )  # fmt: skip
    outside = keeper.step([1.4], [0.0])
    assert outside.status is hf.Status.OUTSIDE_GRID
    assert outside.why.startswith("x = 1.4 is outside -1.3 to 1.3: the filter used the nearest")
    assert keeper.step([0.0], [0.0]).status is hf.Status.PASSED, "it goes on afterwards"


def test_measurements_that_are_not_finite_are_a_status_and_the_fallback_is_applied(
    double_integrator, wall
):
    keeper = hf.SafetyFilter(double_integrator, wall, fallback=[-5.0])
    for state, command, said in (
        ([math.nan, 0.0], [1.0], "x is nan"),
        ([0.0, -math.inf], [1.0], "v is -inf"),
        ([0.0, 0.0], [math.nan], "a is nan"),
    ):
        decision = keeper.step(state, command)
        assert decision.status is hf.Status.NOT_A_NUMBER
        assert decision.overruled
        assert decision.input.tolist() == [-1.0], "within its bounds"
        assert math.isnan(decision.value)
        assert said in decision.why
    assert "the time is nan" in keeper.step([0.0, 0.0], [0.0], t=math.nan).why
    assert keeper.step([0.0, 0.0], [0.5]).status is hf.Status.PASSED


def test_conditions_that_are_not_finite_at_a_state_are_a_status(double_integrator):
    """sqrt(x) at x < 0, and where its slope is infinite."""
    root = hf.Region(
        "root", double_integrator.states, (hf.Inequality("c", sp.sqrt(hf.symbol("x")) - 1),)
    )
    keep = hf.SafetyFilter(double_integrator, root, fallback=[-0.5])
    for state in ([-0.1, 0.1], [0.0, 0.1]):
        decision = keep.step(state, [0.5])
        assert decision.status is hf.Status.NOT_A_NUMBER
        assert decision.input.tolist() == [-0.5]
        assert "the conditions are not finite at this state" in decision.why
        many = keep.step_many([state, [0.2, 0.0]], [[0.5], [0.1]])
        assert many.status == (hf.Status.NOT_A_NUMBER, hf.Status.PASSED)
        assert many.input.tolist() == [[-0.5], [0.1]]


def test_observer_forgets_a_sample_at_which_the_conditions_are_not_finite():
    x, v, a = (hf.symbol(n) for n in ("x", "v", "a"))
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("a", "m/s^2"),),
        {"x": v, "v": a}, input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    root = hf.Region("root", cart.states, (hf.Inequality("c", sp.sqrt(x) - 1),))
    keep, other = (hf.SafetyFilter(cart, root, states=("x",), bandwidth=4.0) for _ in range(2))
    for keeper in (keep, other):
        keeper.step([0.5], [0.3], t=0.0)
    assert keep.step([-0.1], [0.3], t=0.02).status is hf.Status.NOT_A_NUMBER
    after, same = (k.step([0.5], [0.3], t=0.04) for k in (keep, other))
    assert np.array_equal(after.input, same.input)
    assert after.status is same.status is not hf.Status.NOT_A_NUMBER


def test_numbers_of_a_decision_cannot_be_changed(braking):
    decision = braking.step([0.9, 0.15], [1.0])
    with pytest.raises(ValueError, match="read-only"):
        decision.input[0] = 9.0


def test_states_and_commands_may_be_given_by_name(braking):
    by_order = braking.step([0.9, 0.15], [1.0])
    by_name = braking.step({"v": 0.15, "x": 0.9}, {"a": 1.0})
    assert np.array_equal(by_order.input, by_name.input)
    for state, command, said in (
        ({"x": 0.1}, [0.0], "the state lacks v"),
        ({"x": 0.1, "w": 0.0, "v": 0.0}, [0.0], "unknown state 'w'; allowed: v, x"),
        ([0.1], [0.0], r"the state has the shape \(1,\); expected 2 numbers: x, v"),
        (0.1, [0.0], r"the state has the shape \(\)"),
        ("ab", [0.0], "the state is 'ab'; expected numbers"),
        ([0.1, 0.0], [0.0, 0.0], "the command has the shape"),
        ([0.1, None], [object()], "the command is"),
        ([0.1, 0.0], None, "the command is None; expected a"),
        ([0.1, 0.0], np.array(1.0), r"the command has the shape \(\)"),
        ([0.1, 0.0], [1j], "the command is"),
    ):
        with pytest.raises(SimulationError, match=said):
            braking.step(state, command)
    with pytest.raises(SimulationError, match="a disturbance is given, and the law measures none"):
        braking.step([0.0, 0.0], [0.0], disturbance={"d": 1.0})
    with pytest.raises(
        SimulationError, match=r"commands has the shape \(2, 2\); expected \(3, 1\)"
    ):
        braking.step_many(np.zeros((3, 2)), np.zeros((2, 2)))


def test_disturbances_that_are_measured_are_asked_for():
    robot = hf.systems.drifting_unicycle()
    x, y = hf.symbol("x"), hf.symbol("y")
    near = hf.Region(
        "near", (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Inequality("far", x**2 + y**2 - 1, "m^2"),),
    )  # fmt: skip
    keeper = hf.SafetyFilter(robot, near, disturbance_measured=True)
    with pytest.raises(SimulationError, match="the law measures Vx, Vy; expected disturbance="):
        keeper.step([0.9, 0, 0], [0.0, 0.0])
    still, pushed = (
        keeper.step([0.9, 0, math.pi], [0.0, 0.0], disturbance={"Vx": speed, "Vy": 0.0})
        for speed in (0.0, 0.3)
    )
    assert still.status is hf.Status.PASSED
    assert pushed.overruled


# -- a vehicle that is not all measured


@pytest.mark.few("observe-more0")
@pytest.mark.parametrize(
    ("observed", "more"),
    [
        (hf.observe, {}),
        (hf.observe_set, {"error_bounds": {"x": 0.01, "y": 0.01, "v": 0.005, "r": 0.01}}),
        (
            hf.observe_set,
            {
                "error_bounds": {"x": 0.01, "y": 0.01, "v": 0.005, "r": 0.01},
                "rate_bounds": {"Vx": 0.05, "Vy": 0.05},
            },
        ),
    ],
)
def test_observer_estimates_what_is_not_measured(vehicle, view, observed, more):
    """Pose only: the filter's inputs are those of the observed, safeguarded law in `simulate`."""
    x, y, psi = (hf.symbol(n) for n in ("x", "y", "psi"))
    pose = [q for q in vehicle.states if q.name in ("x", "y", "psi")]
    outputs = {"tau_u": 0.3 - 0.1 * x, "tau_r": 0.2 - 0.01 * psi * y}
    steady = hf.Law("steady", tuple(pose), outputs, empirical="gains are numbers")
    guarded = hf.safeguard(vehicle, steady, view)
    whole = observed(vehicle, guarded, measured=("x", "y", "psi"), bandwidth=3.0, **more)
    data = hf.simulate(
        vehicle, whole, starts=[[-1.5, 0.3, -0.2, 0.1, 0, 0]], horizon=4.0, record_every=0.02, region=view,
        disturbance={"Vx": 0.02, "Vy": 0.0},
    ).dataset  # fmt: skip
    keeper = hf.SafetyFilter(vehicle, view, states=("x", "y", "psi"), bandwidth=3.0, **more)
    for _ in range(2):  # and again after a reset
        for k, t in enumerate(data["time"].values):
            q = data["state"].values[0, k]
            wanted = data["nominal"].values[0, k]
            decision = keeper.step(q[:3], wanted, t)
            assert decision.actuators == pytest.approx(data["actuator"].values[0, k], abs=0)
        keeper.reset()
    assert data["overruled"].values[0] > 10
    for k, t in enumerate(data["time"].values[:50]):  # each row is a vehicle
        q, wanted = data["state"].values[0, k, :3], data["nominal"].values[0, k]
        several = keeper.step_many([q, q + 0.1 * k, q], [wanted, wanted, wanted], t)
        assert several.actuators[::2] == pytest.approx(
            np.tile(data["actuator"].values[0, k], (2, 1)), abs=0
        )


def test_error_bounds_without_an_observer_are_refused(vehicle, view):
    with pytest.raises(DefinitionError, match="no observer"):
        hf.SafetyFilter(vehicle, view, error_bounds={"x": 0.01})
    with pytest.raises(DefinitionError, match="no error bounds"):
        hf.SafetyFilter(vehicle, view, states=("x", "y", "psi"), rate_bounds={"Vx": 0.01})


# -- what it is not made for


@pytest.mark.heavy
def test_reduced_kernel_around_a_whole_vehicle_is_warned_of_once_and_by_name(vehicle):
    scenario = hf.load_scenario(
        "ch7-discriminating", ["grid.nodes=15", "march.horizon=0.2", "promise="]
    )
    value = scenario.solve()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        keeper = hf.SafetyFilter(scenario.system, value, around=vehicle)
        for _ in range(3):
            keeper.step([-1.0, 0.0, 0.0], [0.0, 0.0])
    (only,) = said
    assert only.category is hf.ModelWarning
    assert "which leaves out how u and v and r change" in str(only.message)
    assert "around 'marine_vehicle' its promise does not hold" in str(only.message)
    assert only.filename == __file__
    with pytest.warns(hf.ModelWarning, match="around the vehicle itself"):
        hf.SafetyFilter(scenario.system, value)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hf.SafetyFilter(scenario.system, value, around=scenario.system)
    point = hf.System("point", (hf.Quantity("z"),), (hf.Quantity("w"),), {"z": hf.symbol("w")})
    with pytest.raises(DefinitionError, match="has the state 'x', and 'point'"):
        hf.SafetyFilter(scenario.system, value, around=point)


@pytest.mark.heavy
def test_controller_of_the_page_loses_the_target_from_15_of_40_starts_and_with_the_filter_from_none(
    vehicle, view, keeper
):
    rng, starts = np.random.default_rng(1), []
    while len(starts) < 40:
        low, high = (-2.0, -0.8, -0.8), (-0.6, 0.8, 0.8)
        start = np.concatenate([rng.uniform(low, high), np.zeros(3)])
        if keeper.step(start, [0.0, 0.0]).value > 0.02:
            starts.append(start)
    lost, boundary = {False: 0, True: 0}, hf.Boundary(vehicle, view)
    for start in starts:
        for filtered in lost:
            boat, seen = hf.Plant(vehicle, start), []
            for _ in range(1000):
                state = boat.state
                seen.append(state)
                x, y, psi, u, _, r = state.tolist()
                command = [4 * (-0.5 - x) - 6 * u, -0.6 * psi - 1.2 * y - 0.4 * r]
                boat.step(keeper.step(state, command).input if filtered else command)
            lost[filtered] += bool(boundary.worst(seen).max() > 1e-3)
    assert lost == {False: 15, True: 0}


def test_what_a_filter_cannot_be_is_refused(double_integrator, wall, boat):
    system, value = boat
    for keep, options, said in (
        (wall, {"sample_time": 0.0}, "sample_time is 0.0"),
        (wall, {"sample_time": math.nan}, "sample_time"),
        (wall, {"margin": 0.1}, "margin is given, which a region's filter has not"),
        (wall, {"delay": 0.1}, "a delay of 0.1 s, for which a region's filter has no margin"),
        (wall, {"fallback": [1.0, 2.0]}, "fallback is"),
        (wall, {"gains": (1.0, -4.0)}, "gains of the safeguard"),
        (wall, {"states": ("z",)}, "'z' is not a state"),
        (value, {}, "the value function belongs to system 'boat'"),
        ("wall", {}, "keep is 'wall'; expected a Region, a kernel"),
    ):
        with pytest.raises(HoldfastError, match=said):
            hf.SafetyFilter(double_integrator, keep, **options)
    with pytest.raises(DefinitionError, match="gains is given, which a kernel's filter has not"):
        hf.SafetyFilter(system, value, gains=(1.0, 2.0))
    with pytest.raises(ArgumentError):
        hf.SafetyFilter(None, wall)


def test_law_that_is_handed_its_command_cannot_be_simulated_alone(double_integrator, wall):
    keeper = hf.SafetyFilter(double_integrator, wall)
    with pytest.raises(SimulationError, match="is handed command_a by others at every sample"):
        hf.simulate(double_integrator, keeper.law, starts=[[0.0, 0.0]], horizon=1.0)


# -- as C


@pytest.mark.few("kernel")
@needs_gcc
@pytest.mark.parametrize("kind", ["region", "kernel"])
def test_filter_in_c_takes_the_command_as_an_argument_and_gives_the_same_bits(
    kind, vehicle, view, boat, tmp_path
):
    if kind == "region":
        keeper = hf.SafetyFilter(vehicle, view, gains=(1.5, 8))
        states = around([-1.5, 0.5, -0.3, 0.1, 0.0, 0.0], 0.3, 2000)
        commands = around([1.0, 0.1], 4.0, 2000, seed=1)
    else:
        keeper = hf.SafetyFilter(*boat)
        states, commands = around([0.0], 0.6, 2000), around([0.0], 1.0, 2000, seed=1)
    c = built(tmp_path, keeper.export_c("keep") + ONE_STEP, "keep")
    found = keeper.step_many(states, commands)
    import ctypes

    for k in range(2000):
        answer = np.zeros(commands.shape[1] * 2 + 2)
        c.one(
            *(a.ctypes.data_as(ctypes.c_void_p) for a in (states[k].copy(), commands[k].copy())),
            answer.ctypes.data_as(ctypes.c_void_p),
        )
        m = commands.shape[1]
        assert np.array_equal(answer[:m], found.input[k])
        assert np.array_equal(answer[m : 2 * m], found.actuators[k])
        assert answer[-2] == found.slack[k]
        assert answer[-1] == (found.status[k] is hf.Status.OUTSIDE_GRID)


ONE_STEP = """
void one(const double *seen, const double *handed, double *answer) {
    keep_state s;
    keep_start(&s);
    keep_step(&s, 0.0, 0.02, seen, handed, keep_parameters, answer, answer + KEEP_INPUTS);
    answer[2 * KEEP_INPUTS] = s.slack;
    answer[2 * KEEP_INPUTS + 1] = s.outside;
}
"""


def test_two_constraints_that_no_input_keeps_together_are_crossed_only_after_infeasible():
    """x' = u + 1/2, y' = u - 1/2: x - y grows by 1 m/s whatever u does, towards x <= 1 and y >= 0."""
    x, y, u = (hf.symbol(n) for n in ("x", "y", "u"))
    system = hf.System(
        "pair", (hf.Quantity("x", "m"), hf.Quantity("y", "m")), (hf.Quantity("u", "m/s"),),
        {"x": u + 0.5, "y": u - 0.5}, input_bounds=hf.Box((-2,), (2,)),
    )  # fmt: skip
    both = hf.Region(
        "both", system.states, (hf.Inequality("x", x - 1, "m"), hf.Inequality("y", -y, "m"))
    )
    keep = hf.SafetyFilter(system, both, gains=(2, 2), sample_time=0.01)
    assert not keep.crossings, "nothing is crossed because inputs are held"
    state, statuses, worst = np.array([0.2, 0.8]), [], []
    for _ in range(300):
        decision = keep.step(state, [0.3])
        statuses.append(decision.status)
        worst.append(max(state[0] - 1, -state[1]))
        if statuses[-1] == hf.Status.INFEASIBLE and hf.Status.INFEASIBLE not in statuses[:-1]:
            assert set(decision.gave_way) <= {"x", "y"}
            assert decision.gave_way
        state = state + 0.01 * (decision.input[0] + np.array([0.5, -0.5]))
    ended = statuses.index(hf.Status.INFEASIBLE)
    assert max(worst[: ended + 1]) < 0 < worst[-1]
    assert set(statuses[ended:]) == {hf.Status.INFEASIBLE}
