"""What every craft of the vehicle files promises: a derivation, a law, a kernel, a filter."""

from contextlib import nullcontext

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.vehicle_file import read_vehicle, vehicle_names

CORRIDOR = {
    # craft: half of the corridor [m], speed at its end [m/s], yaw rates [rad/s], seconds, and of the
    # states deep in the kernel all, and those that the controller alone keeps
    "videoray_pro_iii": (1.0, 0.4, 1.0, 2.0, 400, 345),
    "otter": (4.0, 1.5, 0.25, 3.0, 400, 318),
    "remus_100": (4.0, 1.0, 0.3, 4.0, 399, 286),
    "cybership_ii_full": (1.5, 0.3, 0.1, 6.0, 400, 234),
    "bluerov2_planar": (1.0, 0.5, 1.0, 2.0, 400, 367),
    "supply_vessel": (60.0, 1.5, 0.01, 60.0, 400, 146),
    "remus_100_rudder": (8.0, 1.5, 0.3, 6.0, 384, 336),
    "milliampere": (4.0, 0.8, 0.3, 6.0, 400, 229),
}
POSE = {
    # craft: box [m], gains of the law, tracking gain [1/s], seconds, sample [s]
    "cybership_ii_full": (2.0, (0.05, 0.1, 0.03, 0.03), 0.5, 400.0, 0.05),
    "bluerov2_planar": (2.0, (0.3, 0.5, 0.3, 0.5), 3.0, 60.0, 0.05),
    "supply_vessel": (80.0, (0.02, 0.02, 0.4, 0.005), 0.1, 1200.0, 0.5),
    "milliampere": (20.0, (0.05, 0.1, 0.5, 0.1), 0.5, 300.0, 0.1),
}
CRAFT = [n for n in vehicle_names() if read_vehicle(n)[1]["system"] == "marine_craft"]
u, v, r, psi, x = (hf.symbol(n) for n in ("u", "v", "r", "psi", "x"))


def test_every_craft_is_promised():
    assert set(CRAFT) == set(CORRIDOR) - {"videoray_pro_iii"}
    assert set(POSE) == {n for n in CRAFT if not hf.load_vehicle(n).pfaffian}


@pytest.mark.slow("otter", "remus_100", "remus_100_rudder")
@pytest.mark.parametrize("name", CRAFT)
def test_craft_without_a_sway_force_is_explained_and_one_with_it_is_no_nonholonomic_system(name):
    craft = hf.load_vehicle(name)
    if not craft.pfaffian:
        with pytest.raises(DefinitionError, match="no Pfaffian constraint"):
            hf.explain(craft)
    else:
        assert hf.explain(craft).structure.matrix == sp.Matrix([[-sp.sin(psi), sp.cos(psi), 0]])


@pytest.mark.parametrize("name", CRAFT)
def test_coriolis_force_of_every_craft_does_no_work(name):
    """Without damping and thrust d/dt (nu^T M nu) / 2 = 0, with M as the thrusts feel it."""
    craft = hf.load_vehicle(name)
    zero = {p.symbol: 0 for p in craft.parameters if p.name[0] in "XYN" and "dot" not in p.name}
    p = {q.symbol: q.value for q in craft.parameters} | zero
    p |= {q.symbol: 0 for q in craft.inputs}
    n = {q.name: q.value for q in craft.parameters}
    offset, sway_by_yaw = n["mass"] * n.get("x_g", 0), n.get("Yrdot", 0)
    inertia = np.array([
        [n["mass"] - n["Xudot"], 0, 0],
        [0, n["mass"] - n["Yvdot"], offset - sway_by_yaw],
        [0, offset - n.get("Nvdot", sway_by_yaw), n["Iz"] - n["Nrdot"]],
    ])  # fmt: skip
    for nu in np.random.default_rng(3).uniform(-1, 1, (20, 3)):
        at = p | dict(zip((u, v, r), nu, strict=True))
        change = np.array([float(craft.rates[a].xreplace(at)) for a in "uvr"])
        size = abs(nu) @ abs(inertia) @ abs(change)
        assert abs(nu @ inertia @ change) <= 1e-12 * size


@pytest.mark.few("at once-milliampere")
@pytest.mark.parametrize("name", POSE)
@pytest.mark.parametrize("late", [False, True], ids=["at once", "late"])
def test_dynamic_positioning_brings_every_fully_actuated_craft_to_its_pose(name, late):
    """20 of 20 starts within a ten-thousandth of the box and 1e-4 rad, with late thrusters too."""
    size, (k1, k2, speed, turn), gain, horizon, sample = POSE[name]
    craft = hf.load_vehicle(name)
    lag = None if "tau_u" in craft.input_names else dict.fromkeys(craft.input_names, 0.5)
    law = hf.laws.hold_pose(craft, k1=k1, k2=k2, approach_speed=speed, approach_turn=turn)
    result = hf.simulate(
        hf.lagged(craft, lag) if late else craft,
        hf.track_velocity(craft, law, {"u": gain, "v": gain, "r": gain}),
        starts=hf.Starts(random=20, box={"x": (-size, size), "y": (-size, size), "psi": (-2.5, 2.5)}),
        horizon=horizon, sample_time=sample, record_every=horizon / 20, seed=1,
    )  # fmt: skip
    end = np.abs(result.dataset["state"].values[:, -1, :3]).max(axis=0)
    assert (end < (1e-4 * size, 1e-4 * size, 1e-4)).all()


def ahead(craft, speed, time):
    """Straight ahead at a speed: a proportional law for each velocity and the heading."""
    p = {q.symbol: q.value for q in craft.parameters}

    def effect(velocity, force):
        return float(craft.rates[velocity].diff(hf.symbol(force)).xreplace({**p, u: speed}))

    if "tau_u" in craft.input_names:
        surge, yaw = 1 / effect("u", "tau_u"), 1 / effect("r", "tau_r")
        forces = {
            "tau_u": 4 / time * surge * (speed - u),
            "tau_v": -4 / time * surge * v,
            "tau_r": -yaw * (4 / time**2 * psi + 4 / time * r),
        }
    else:  # the inputs of every actuator: what brings about these rates at that speed
        rates = {"u": 4 / time * (speed - u), "r": -(4 / time**2 * psi + 4 / time * r)}
        if not craft.pfaffian:
            rates["v"] = -4 / time * v
        shares = np.linalg.pinv([[effect(a, n) for n in craft.input_names] for a in rates])
        wanted = sp.Matrix(shares) * sp.Matrix([*rates.values()])
        forces = dict(zip(craft.input_names, wanted, strict=True))
    forces = {n: forces[n] for n in craft.input_names}
    return hf.Law("ahead", craft.states, forces)


@pytest.mark.heavy
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[pytest.mark.heavy] * (n not in ("otter", "cybership_ii_full")))
        for n in CORRIDOR
    ],
)
def test_filter_of_a_coarse_kernel_stops_every_craft_before_a_wall_that_its_controller_hits(name):
    """Of 400 states those deep in the kernel all stay; the controller alone loses 8 to 64 % of them.

    The kernel of (x, psi, u, v, r) between two walls, with the true forces of the thrusters.
    """
    half, speed, turn, seconds, inside, lone = CORRIDOR[name]
    craft = hf.subsystem(hf.load_vehicle(name), ("x", "psi", "u", "v", "r"))
    walls = hf.Region(
        "walls", craft.states,
        (hf.Inequality("ahead", x - half, "m"), hf.Inequality("astern", -half - x, "m")),
    )  # fmt: skip
    box = {
        "x": (-1.4 * half, 1.4 * half), "psi": (-1, 1), "u": (-speed, 1.2 * speed),
        "v": (-speed / 2, speed / 2), "r": (-turn, turn),
    }  # fmt: skip
    nodes = {"x": 21, "psi": 7, "u": 9, "v": 5, "r": 7}
    grid = hf.grid(craft, box, nodes, dict.fromkeys(("psi", "u", "v", "r"), "extrapolated"))
    kernel = hf.viability_kernel(
        craft, walls, grid, seconds, disturbance={"Vx": 0, "Vy": 0}, scheme="upwind"
    )
    ends = np.array([half, 0.6, speed, speed / 5, turn / 3])
    q = np.random.default_rng(1).uniform(-1, 1, (400, 5)) * 0.7 * ends
    q[:, 2] = abs(q[:, 2])
    deep = q[kernel.at(q) > 0.1 * half]
    assert len(deep) == inside
    law, sample = ahead(craft, speed, half / speed), seconds / 400
    kept = hf.safety_law(
        craft, kernel, law, rate=10 / seconds, margin=0.08 * half, sample_time=sample
    )
    alone, filtered = (
        hf.simulate(
            craft, one, starts=deep, region=walls, horizon=seconds, sample_time=sample,
            record_every=seconds / 20,
        )
        for one in (law, kept)
    )  # fmt: skip
    assert (filtered.viable, alone.viable) == (inside, lone)


@pytest.mark.heavy
def test_model_ship_passes_the_moored_vessel_that_its_law_alone_touches():
    """300 of 300 arrive, with late thrusters; of the law alone 205 keep clear."""
    with_filter = hf.load_scenario("craft-berth").run()
    assert with_filter.viable == with_filter.outcomes["reached goal"] == 300
    scenario = hf.load_scenario("craft-berth")
    craft = scenario.model
    law = hf.track_velocity(
        craft,
        hf.laws.hold_pose(craft, k1=0.05, k2=0.1, approach_speed=0.05, approach_turn=0.03),
        {"u": 0.3, "v": 0.3, "r": 0.3},
    )
    alone = hf.simulate(
        scenario.system, law, starts=scenario.starts, region=scenario.region, seed=1,
        horizon=300, sample_time=0.1, record_every=1, tolerance=1e-3,
    )  # fmt: skip
    assert alone.viable == 205
    peak = with_filter.dataset["actuator"].values.min(axis=(0, 1))
    assert (peak >= [-5.67 - 1e-2, -5.67 - 1e-2, -0.175]).all()


@pytest.mark.heavy
def test_ferry_passes_the_moored_boat_that_its_law_alone_touches():
    """300 of 300 arrive, by the forces of two azimuth thrusters; of the law alone 81 keep clear."""
    scenario = hf.load_scenario("ferry-quay")
    result = scenario.run()
    assert result.viable == result.outcomes["reached goal"] == 300
    forces = result.dataset["input"].values
    size = np.maximum(np.hypot(*forces[..., :2].T), np.hypot(*forces[..., 2:].T))
    assert size.max() <= 500 * (1 + 1e-12)
    craft = scenario.model
    law = hf.track_velocity(
        craft,
        hf.laws.hold_pose(craft, k1=0.05, k2=0.1, approach_speed=0.6, approach_turn=0.1),
        {"u": 0.5, "v": 0.5, "r": 0.5},
    )
    alone = hf.simulate(
        craft, law, starts=scenario.starts, region=scenario.region, seed=1,
        horizon=300, sample_time=0.1, record_every=1, tolerance=1e-3,
    )  # fmt: skip
    assert alone.viable == 81


@pytest.mark.slow("otter-gains0-19")
@pytest.mark.parametrize(
    ("name", "gains", "arrived"), [("otter", (5.0, 10.0), 19), ("remus_100", (2.0, 6.0), 0)]
)
def test_law_that_can_be_tracked_does_not_arrive_with_every_hull(name, gains, arrived):
    """`inspect_target`, made for the VideoRay's drag, in 200 s: a slender hull slides past.

    Its gain condition foretells which one.
    """
    craft = hf.load_vehicle(name)
    law = hf.track_velocity(
        craft, hf.laws.inspect_target(craft, distance=0.5), dict(zip("ur", gains, strict=True))
    )
    foretold = pytest.warns(hf.GainWarning, match="the sway outpaces the approach")
    with nullcontext() if arrived else foretold:
        result = hf.simulate(
            craft, law, starts=hf.Starts(random=20, box={"x": (-2, -0.3), "y": (-1.2, 1.2), "psi": (-0.5, 0.5)}),
            goal=hf.regions.near_pose(goal_x=-0.5), horizon=200, record_every=1, seed=1,
        )  # fmt: skip
    assert result.outcomes["reached goal"] == arrived
