"""Other libraries get the same vehicle: their answers are ours."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, OutputError


def test_closed_loop_of_python_control_goes_the_same_way():
    control = pytest.importorskip("control")
    from holdfast.interop.control import closed_loop

    scenario = hf.load_scenario("ch4-marine", ["run.horizon=20"], runs=1)
    law = hf.track_velocity(
        scenario.system,
        hf.laws.dock_marine(scenario.system, k1=0.2, k2=2.0, freeze=0.01),
        {"u": 5.0, "r": 5.0},
    )
    loop = closed_loop(scenario.system, law)
    assert list(loop.output_labels) == ["x", "y", "psi", "u", "v", "r", "tau_u", "tau_r"]
    ours = hf.simulate(
        scenario.system, law, starts=[[-1, 0.5, 0, 0, 0, 0]], horizon=20, sample_time=0.02,
        substeps=2, record_every=1.0, continuous=True,
    ).dataset  # fmt: skip
    times = ours["time"].values
    found = control.input_output_response(
        loop, times, np.zeros((loop.ninputs, len(times))), X0=[-1, 0.5, 0, 0, 0, 0],
        solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-10},
    )  # fmt: skip
    assert pytest.approx(ours["state"].values[0], abs=1e-4) == found.states.T
    changed = control.input_output_response(
        loop, times, np.zeros((loop.ninputs, len(times))), X0=[-1, 0.5, 0, 0, 0, 0],
        params={"k1": 0.1},
    )  # fmt: skip
    assert abs(changed.states[0, 5]) > abs(found.states[0, 5]) + 0.05, "a smaller gain is slower"


@pytest.mark.few("ch2-integrator")
@pytest.mark.parametrize("name", ["inspection", "ch2-integrator", "observed"])
def test_sampled_loop_of_python_control_makes_the_very_steps(name):
    """With modes, a safeguard, a memory: every sample as `simulate` has it."""
    control = pytest.importorskip("control")
    from holdfast.interop.control import sampled_loop

    changes = ["run.sample_time=0.02", "run.substeps=2", "run.horizon=20", "run.record_every=0.02"]
    scenario = hf.load_scenario("inspection" if name == "observed" else name, changes, runs=3)
    law, disturbance = scenario.law, {}
    if name == "observed":
        law = hf.observe(scenario.system, law, measured=("x", "y", "psi"), bandwidth=5.0)
        disturbance = {"Vx": -0.03, "Vy": 0.01}
    ours = hf.simulate(
        scenario.system, law, starts=scenario.starts, region=scenario.region, horizon=20,
        record_every=0.02, disturbance=disturbance,
    ).dataset  # fmt: skip
    loop = sampled_loop(scenario.system, law)
    times = ours["time"].values
    fed = [np.full(len(times), disturbance.get(n, 0.0)) for n in scenario.system.disturbance_names]
    start = np.zeros(loop.nstates)
    run = int(ours["switches"].values.argmax())
    assert ours["switches"].values[run] > 0 or name == "observed"
    start[: ours.sizes["state_name"]] = ours["state"].values[run, 0]
    start[-2] = loop.initial_mode
    found = control.input_output_response(loop, times, np.array(fed) if fed else 0, X0=start)
    states, inputs = (ours[n].values[run].T for n in ("state", "input"))
    assert np.abs(found.outputs[: len(states)] - states).max() < 1e-12
    told = dict(zip(loop.output_labels, found.outputs, strict=True))
    assert np.abs([told[n] for n in scenario.system.input_names] - inputs).max() < 1e-9
    assert ("slack" in told) == ("slack" in ours) == (name != "ch2-integrator")
    if "slack" in told:
        asked = np.array([told[f"nominal_{n}"] for n in scenario.system.input_names])
        assert np.abs(asked - ours["nominal"].values[run].T).max() < 1e-6
        assert np.abs(told["slack"] - ours["slack"].values[run]).max() < 1e-6
    assert np.array_equal(found.outputs[-1], ours["mode"].values[run])


def test_plant_of_python_control_is_linearised_as_it_should_be():
    pytest.importorskip("control")
    from holdfast.interop.control import closed_loop, plant

    robot = plant(hf.systems.unicycle())
    linear = robot.linearize([0, 0, 0], [1, 0])
    assert pytest.approx(np.array([[0, 0, 0], [0, 0, 1], [0, 0, 0]]), abs=1e-5) == linear.A
    assert pytest.approx(np.array([[1, 0], [0, 0], [0, 1]]), abs=1e-5) == linear.B
    scenario = hf.load_scenario("ch2-integrator")
    with pytest.raises(DefinitionError, match="has modes"):
        closed_loop(scenario.system, scenario.law)


@pytest.mark.filterwarnings("ignore:.*infinity")  # of observations: a position has no bound
def test_environment_passes_the_checker_of_gymnasium():
    gymnasium = pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    from holdfast.interop.gymnasium import Environment

    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    box = {"x": (-2.0, -0.3), "y": (-1.6, 1.6), "psi": (-1.0, 1.0)}
    made = Environment(vehicle, view, goal=hf.regions.near_pose(goal_x=-0.5), box=box, horizon=5)
    check_env(made, skip_render_check=True)
    assert isinstance(made, gymnasium.Env)
    state, info = made.reset(seed=4)
    assert made.reset(seed=4)[0] == pytest.approx(state)
    assert max(info["constraints"].values()) <= 0
    assert made.action_space.shape == (2,), "two thrusters"


@pytest.mark.filterwarnings("ignore")  # of observations: a position has no bound
def test_environment_with_a_filter_passes_the_checker_of_gymnasium():
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    from holdfast.interop.gymnasium import Environment, Filtered

    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    box = {"x": (-1.2, -0.8), "y": (-0.1, 0.1), "psi": (-0.1, 0.1)}
    inner = Environment(vehicle, view, box=box, horizon=5, sample_time=0.05)
    check_env(Filtered(inner, hf.SafetyFilter(vehicle, view, sample_time=0.05)),
              skip_render_check=True)  # fmt: skip


def test_environment_moves_as_the_simulation_does():
    pytest.importorskip("gymnasium")
    from holdfast.interop.gymnasium import Environment

    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    made = Environment(vehicle, view, box={"x": (-1.2, -1.2)}, sample_time=0.05, substeps=4)
    state, _ = made.reset(seed=0)
    tau = hf.Law(
        "push",
        vehicle.states,
        {"tau_u": hf.parse_expression("3", {}), "tau_r": hf.parse_expression("0", {})},
    )
    ours = hf.simulate(
        vehicle, tau, starts=[state], region=view, horizon=4.0, sample_time=0.05, substeps=4,
        record_every=0.05,
    ).dataset  # fmt: skip
    left = None
    for k in range(80):
        state, reward, over, _, _ = made.step(np.array([0.3, 0.3]))
        assert state == pytest.approx(ours["state"].values[0, k + 1], abs=1e-9)
        if over:
            left = (k + 1) * 0.05
            break
    assert reward == -1.0
    assert left == pytest.approx(float(ours["exit_time"].values[0]), abs=0.05)
    with pytest.raises(DefinitionError, match="has no 'z'"):
        Environment(vehicle, view, box={"z": (0, 1)})
    made = Environment(vehicle, view, box={"x": (1.0, 2.0)})
    with pytest.raises(DefinitionError, match="none of 10000 starts"):
        made.reset(seed=0)


def test_environment_rewards_the_goal_and_ends_there():
    pytest.importorskip("gymnasium")
    from holdfast.interop.gymnasium import Environment

    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    goal = hf.regions.near_pose(goal_x=-0.5)
    made = Environment(vehicle, view, goal=goal, box={"x": (-0.5, -0.5)})
    made.reset(seed=0)
    _, reward, over, cut_off, _ = made.step(np.zeros(2))
    assert (reward, over, cut_off) == (1.0, True, False)


def test_bag_holds_the_trajectories(tmp_path):
    pytest.importorskip("rosbags")
    from pathlib import Path

    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    from holdfast.interop.bag import write_bag

    result = hf.load_scenario("inspection", ["run.horizon=4"], runs=3).run()
    folder = write_bag(result, tmp_path / "bag", runs=[0, 2])
    assert list(Path(folder).glob("*.mcap"))
    store, data = get_typestore(Stores.ROS2_JAZZY), result.dataset
    with Reader(folder) as bag:
        assert {c.topic for c in bag.connections} == {
            "/run_0/odometry", "/run_0/mode", "/run_2/odometry", "/run_2/mode",
        }  # fmt: skip
        seen = [c for c in bag.connections if c.topic == "/run_2/odometry"]
        for k, (connection, stamp, raw) in enumerate(bag.messages(connections=seen)):
            message = store.deserialize_cdr(raw, connection.msgtype)
            state = data["state"].values[2, k]
            place, turned = message.pose.pose.position, message.pose.pose.orientation
            assert (place.x, place.y) == tuple(state[:2])
            assert 2 * math.atan2(turned.z, turned.w) == pytest.approx(state[2], abs=1e-12)
            assert message.twist.twist.angular.z == state[5]
            assert stamp == round(float(data["time"].values[k]) * 1e9)
        assert k == data.sizes["time"] - 1
    with pytest.raises(OutputError, match="exists already"):
        write_bag(result, tmp_path / "bag")
    with pytest.raises(OutputError, match="has no state 'theta'"):
        write_bag(result, tmp_path / "other", pose=("x", "y", "theta"))


# -- a filter around environments


def random_episodes(env, episodes, seed=0):
    """A random agent that holds its action for a while: what its steps told."""
    rng = np.random.default_rng(seed)
    ends = env.action_space.low, env.action_space.high
    for episode in range(episodes):
        env.reset(seed=episode)
        action, over, cut_off = rng.uniform(*ends), False, False
        while not (over or cut_off):
            if rng.random() < 0.1:
                action = rng.uniform(*ends)
            seen, reward, over, cut_off, info = env.step(action)
            yield seen, reward, info


@pytest.mark.slow("True")
@pytest.mark.parametrize("filtered", [False, True])
def test_random_agent_loses_the_view_in_every_episode_and_behind_the_filter_in_none(filtered):
    pytest.importorskip("gymnasium")
    from holdfast.interop.gymnasium import Environment, Filtered

    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    box = {"x": (-1.8, -0.5), "y": (-1.0, 1.0), "psi": (-1.0, 1.0)}
    env = Environment(vehicle, view, box=box, horizon=15.0)
    if filtered:
        inside = {"edge_low": 0.02, "edge_high": 0.02, "too_near": 0.01, "too_far": 0.03}
        keep = hf.SafetyFilter(vehicle, view, gains=(1.5, 8), margins=inside, sample_time=0.05)
        env = Filtered(env, keep)
    told = list(random_episodes(env, 12))
    lost = sum(reward < 0 for _, reward, _ in told)
    assert lost == (0 if filtered else 12)
    if filtered:
        assert sum(info["overruled"] for *_, info in told) > 300
        first = told[0][2]["decision"]
        assert np.allclose(env.unwrapped.command(env.unwrapped.action(first)), first.input)


def test_filter_keeps_an_environment_that_nobody_here_wrote_below_its_speed():
    """Gymnasium's pendulum, in weak gravity, below 3 rad/s; by its documented equations."""
    gymnasium = pytest.importorskip("gymnasium")
    from holdfast.interop.gymnasium import Filtered

    theta, w, u = (hf.symbol(n) for n in ("theta", "w", "u"))
    pendulum = hf.System(
        "pendulum",
        (hf.Quantity("theta", "rad", angle=True), hf.Quantity("w", "rad/s")),
        (hf.Quantity("u"),),
        {"theta": w, "w": 3 * sp.sin(theta) + 3 * u},
        input_bounds=hf.Box((-2,), (2,)),
    )
    slow = hf.Region("slow", pendulum.states, (hf.Inequality("speed", w**2 - 9, "rad^2/s^2"),))
    keep = hf.SafetyFilter(
        pendulum, slow, gains=(2.0, 4.0), margins={"speed": 1.0}, sample_time=0.05
    )
    bare = gymnasium.make("Pendulum-v1", g=2.0)
    maps = {
        "state": lambda seen: [math.atan2(seen[1], seen[0]), seen[2]],
        "command": lambda action: action,
        "action": lambda decision: decision.input.astype(np.float32),
    }
    fastest = {}
    for name, env in (("alone", bare), ("kept", Filtered(bare, keep, **maps))):
        fastest[name] = max(abs(float(seen[2])) for seen, *_ in random_episodes(env, 10))
    assert fastest["alone"] > 4
    assert 2.5 < fastest["kept"] <= 3
    with pytest.raises(DefinitionError, match="the environment is not one of the filter's system"):
        Filtered(bare, keep)


def test_filter_of_other_samples_than_its_environment_is_refused():
    pytest.importorskip("gymnasium")
    from holdfast.interop.gymnasium import Environment, Filtered

    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    env = Environment(vehicle, view, box={"x": (-1.0, -0.9)}, sample_time=0.05)
    with pytest.raises(DefinitionError, match=r"samples of 0\.05 s, the filter of 0\.02 s"):
        Filtered(env, hf.SafetyFilter(vehicle, view))
