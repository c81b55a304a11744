"""Plants that others wrote, behind one face, and our models fitted to them.

Each is a package of its own, an optional one of the benchmark:

    pip install MCSimPython commonroad-vehicle-models mujoco auv-sim-bench
    pip install git+https://github.com/cybergalactic/PythonVehicleSimulator

    Otter   T. I. Fossen's Python Vehicle Simulator, MIT: an unmanned surface vehicle in six degrees
            of freedom, with propeller lag, payload off centre, cross-flow drag
    ROV     auv-sim-bench, Apache 2.0: an underwater vehicle in six degrees of freedom
    ship    MCSimPython, GPL 3: C/S Arctic Drillship (1:90), six degrees of freedom with roll, pitch
            and heave; in JONSWAP waves by its force transfer functions, first order and drift
    car     commonroad-vehicle-models, BSD 3: a multi-body car with 29 states, tyres that slip,
            suspension
    wheels  MuJoCo, Apache 2.0: contact with friction; the two-wheeled robot is described here

A boat's state is (x, y, psi, u, v, r), z up, u and v relative to the water. holdfast imports none
of this.
"""

from __future__ import annotations

import contextlib
import io
import math
from typing import Any

import numpy as np


class Boat:
    """A vehicle with a port and a starboard thruster [N]; `scale` sizes the view it works in."""

    package = ""
    scale, arm, ahead, astern = 1.0, 0.1, 1.0, 1.0

    def __init__(self, current: tuple[float, float] = (0.0, 0.0)) -> None:
        self.current = np.array(current)

    def start(self, pose: Any) -> None:
        """At rest over the ground at (x, y, psi)."""
        raise NotImplementedError

    def state(self) -> np.ndarray:
        raise NotImplementedError

    def step(self, thrusts: Any, seconds: float) -> None:
        """One sample with the thrusts (port, starboard) held."""
        raise NotImplementedError

    def published(self) -> dict[str, float]:
        """The numbers of `FITTED` where they are published and need no fit."""
        return {}

    def relative(self, psi: float, u: float, v: float) -> tuple[float, float]:
        """Velocities through the water from those over the ground."""
        (x, y), c, s = self.current, math.cos(psi), math.sin(psi)
        return u - x * c - y * s, v + x * s - y * c


class Otter(Boat):
    package = "python_vehicle_simulator"
    scale, arm = 5.0, 0.395
    ahead, astern = 0.5 * 24.4 * 9.81, 0.5 * 13.6 * 9.81  # published bollard pulls

    def __init__(self, current: tuple[float, float] = (0.0, 0.0)) -> None:
        from python_vehicle_simulator.lib.gnc import attitudeEuler
        from python_vehicle_simulator.vehicles.otter import otter

        super().__init__(current)
        self.vehicle, self.turned = otter(), attitudeEuler
        self.vehicle.V_c = math.hypot(*current)
        self.vehicle.beta_c = math.atan2(-current[1], current[0])
        load = np.array([0.0, 0.0, self.vehicle.mp * self.vehicle.g])
        moment = self.vehicle.S_rp @ load
        self.rest = np.linalg.solve(
            self.vehicle.G[2:5, 2:5], [load[2], *moment[:2]]
        )  # heave, roll and pitch under the payload

    def start(self, pose: Any) -> None:
        x, y, psi = pose
        self.eta = np.array([x, -y, *self.rest, -psi])
        self.nu, self.shafts = np.zeros(6), np.zeros(2)

    def state(self) -> np.ndarray:
        x, y, psi = self.eta[0], -self.eta[1], -self.eta[5]
        u, v = self.relative(psi, self.nu[0], -self.nu[1])
        return np.array([x, y, psi, u, v, -self.nu[5]])

    def step(self, thrusts: Any, seconds: float) -> None:
        wanted = np.asarray(thrusts)
        gain = np.where(wanted > 0, self.vehicle.k_pos, self.vehicle.k_neg)
        asked = np.sign(wanted) * np.sqrt(np.abs(wanted) / gain)
        self.nu, self.shafts = self.vehicle.dynamics(self.eta, self.nu, self.shafts, asked, seconds)
        self.eta = self.turned(self.eta, self.nu, seconds)


class Rov(Boat):
    package = "auv_sim_bench"
    scale, arm, ahead, astern = 2.0, 0.2, 20.0, 20.0

    def __init__(self, current: tuple[float, float] = (0.0, 0.0)) -> None:
        from auv_sim_bench.dynamics import AUVDynamics

        super().__init__(current)
        self.vehicle = AUVDynamics()
        self.vehicle.p.current_world = np.array([*current, 0.0])

    def start(self, pose: Any) -> None:
        x, y, psi = pose
        s = self.vehicle.s
        s.p, s.v, s.w = np.array([x, y, 0.0]), np.zeros(3), np.zeros(3)
        s.q = np.array([math.cos(psi / 2), 0.0, 0.0, math.sin(psi / 2)])

    def state(self) -> np.ndarray:
        s = self.vehicle.s
        psi = math.remainder(2 * math.atan2(s.q[3], s.q[0]), 2 * math.pi)
        u, v = self.relative(psi, s.v[0], s.v[1])
        return np.array([s.p[0], s.p[1], psi, u, v, s.w[2]])

    def step(self, thrusts: Any, seconds: float) -> None:
        port, starboard = thrusts
        for _ in range(2):
            self.vehicle.step(
                seconds / 2, [port + starboard, 0, 0], [0, 0, self.arm * (starboard - port)]
            )


class Ship(Boat):
    """waves: significant height [m] and peak period [s] of a sea from ahead (towards -x).

    The package assumes speeds near zero: without Coriolis forces the hull does not slide in a turn,
    and step responses do not show its sway. The model has the published numbers.
    """

    package = "MCSimPython"
    scale, arm, ahead, astern = 5.0, 0.2, 6.0, 6.0

    def __init__(
        self,
        current: tuple[float, float] = (0.0, 0.0),
        waves: tuple[float, float] | None = None,
        seed: int = 1,
    ) -> None:
        from MCSimPython.simulator.csad import CSAD_DP_6DOF

        super().__init__(current)
        self.vehicle = CSAD_DP_6DOF(0.02, method="RK4")
        self.waves = None if waves is None else self._sea(*waves, seed)

    def _sea(self, height: float, period: float, seed: int) -> Any:
        from MCSimPython.waves.wave_loads import WaveLoad
        from MCSimPython.waves.wave_spectra import JONSWAP

        count = 25
        peak = 2 * math.pi / period
        frequencies = np.linspace(0.5 * peak, 2 * peak, count)
        _, spectrum = JONSWAP(frequencies)(height, period, gamma=3.3)
        amplitudes = np.sqrt(2 * spectrum * (frequencies[1] - frequencies[0]))
        phases = np.random.default_rng(seed).uniform(0, 2 * math.pi, count)
        with contextlib.redirect_stdout(io.StringIO()):
            return WaveLoad(
                amplitudes, frequencies, phases, np.full(count, math.pi), self.vehicle._config_file
            )

    def published(self) -> dict[str, float]:
        mass, drag = self.vehicle._M, self.vehicle._D
        found = {f"m{i}{i}": float(mass[k, k]) for i, k in ((1, 0), (2, 1), (3, 5))}
        found |= {n: -float(drag[k, k]) for n, k in (("Xu", 0), ("Yv", 1), ("Nr", 5))}
        return found | {"Xuu": 0.0, "Yvv": 0.0, "Nrr": 0.0}

    def start(self, pose: Any) -> None:
        x, y, psi = pose
        self.vehicle.reset()
        self.vehicle.set_eta(np.array([x, -y, 0.0, 0.0, 0.0, -psi]))
        self.t = 0.0

    def state(self) -> np.ndarray:
        eta, nu = self.vehicle.get_eta(), self.vehicle.get_nu()
        psi = -eta[5]
        u, v = self.relative(psi, nu[0], -nu[1])
        return np.array([eta[0], -eta[1], psi, u, v, -nu[5]])

    def step(self, thrusts: Any, seconds: float) -> None:
        port, starboard = thrusts
        force = np.zeros(6) if self.waves is None else np.asarray(
            self.waves(self.t, self.vehicle.get_eta())
        )  # fmt: skip
        force = force + np.array([port + starboard, 0, 0, 0, 0, -self.arm * (starboard - port)])
        speed = math.hypot(*self.current)
        self.vehicle.integrate(speed, math.atan2(-self.current[1], self.current[0]), force)
        self.t += seconds


FITTED = ("m11", "m22", "m33", "Xu", "Xuu", "Yv", "Yvv", "Nr", "Nrr")


def fitted(boat: Boat, seconds: float = 60.0, sample_time: float = 0.02) -> dict[str, float]:
    """Parameters of `marine_vehicle` by least squares on step responses of the plant.

    Random steps of both thrusters, 1.5 s each, the first half second left out (actuator lag). The
    equations of motion are linear in the nine numbers; the three rows are weighed by the size of
    what drives them.
    """
    generator, held = np.random.default_rng(0), round(1.5 / sample_time)
    rows, right = [], []
    boat.start((0.0, 0.0, 0.0))
    thrusts = np.zeros(2)
    for k in range(round(seconds / sample_time)):
        if k % held == 0:
            share = generator.choice([0.1, 0.3, 1.0])
            thrusts = share * generator.uniform(-boat.astern, boat.ahead, 2)
        before = boat.state()
        boat.step(thrusts, sample_time)
        after = boat.state()
        if k % held * sample_time < 0.5:
            continue
        (u, v, r), (du, dv, dr) = (
            (before + after)[3:] / 2,
            (after - before)[3:] / sample_time,
        )
        surge, turn = thrusts.sum(), boat.arm * (thrusts[1] - thrusts[0])
        rows += [
            [du, -v * r, 0, -u, -abs(u) * u, 0, 0, 0, 0],
            [u * r, dv, 0, 0, 0, -v, -abs(v) * v, 0, 0],
            [-u * v, u * v, dr, 0, 0, 0, 0, -r, -abs(r) * r],
        ]
        right += [surge, 0.0, turn]
    sizes = np.tile([np.std(right[0::3])] * 2 + [np.std(right[2::3])], len(right) // 3)
    found, *_ = np.linalg.lstsq(
        np.array(rows) / sizes[:, None], np.array(right) / sizes, rcond=None
    )
    return dict(zip(FITTED, map(float, found), strict=True))


def numbers_of(boat: Boat) -> dict[str, float]:
    """The numbers of a boat as arguments of `holdfast.systems.marine_vehicle`."""
    p = boat.published() or fitted(boat)
    drag = {n: min(p[n], 0.0) for n in ("Xu", "Xuu", "Yv", "Yvv", "Nr", "Nrr")}
    return drag | {
        "mass": p["m11"], "Xudot": 0.0, "Yvdot": p["m11"] - p["m22"], "Iz": p["m33"], "Nrdot": 0.0,
        "thrust_limit": boat.ahead, "thrust_astern": boat.astern, "thruster_arm": boat.arm,
    }  # fmt: skip


class Car:
    """A BMW 320i with 29 states; state() is (x, y, theta, v) of the middle of the rear axle.

    step(acceleration [m/s^2], curvature [1/m]): its own servo turns the front wheels towards the
    angle of that curvature, no faster than the package's limit of the steering velocity.
    """

    package = "vehiclemodels"

    def __init__(self) -> None:
        from vehiclemodels.init_mb import init_mb
        from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
        from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

        self.p, self.rates, self.at = parameters_vehicle2(), vehicle_dynamics_mb, init_mb
        self.base = self.p.a + self.p.b

    def start(self, pose: Any) -> None:
        x, y, theta, v = pose
        place = [x + self.p.b * math.cos(theta), y + self.p.b * math.sin(theta)]
        self.x = np.array(self.at([*place, 0.0, v, theta, 0.0, 0.0], self.p), dtype=float)

    def state(self) -> np.ndarray:
        x, y, theta, v = self.x[0], self.x[1], self.x[4], self.x[3]
        b = self.p.b
        return np.array([x - b * math.cos(theta), y - b * math.sin(theta), theta, v])

    def step(self, given: Any, seconds: float, inner: int = 10) -> None:
        acceleration, curvature = given
        wanted, h = math.atan(self.base * curvature), seconds / inner
        for _ in range(inner):
            turn = [np.clip((wanted - self.x[2]) / 0.05, -0.4, 0.4), acceleration]
            k1 = np.array(self.rates(list(self.x), turn, self.p))
            k2 = np.array(self.rates(list(self.x + h / 2 * k1), turn, self.p))
            self.x = self.x + h * k2


ROBOT = """
<mujoco>
  <option timestep="0.002" cone="elliptic" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="20 20 0.1" friction="{friction} 0.01 0.001"/>
    <body name="base" pos="0 0 0.033">
      <freejoint/>
      <geom type="cylinder" size="0.07 0.03" mass="0.9" pos="-0.006 0 0.03" contype="0"
            conaffinity="0"/>
      <geom type="sphere" size="0.015" pos="-0.07 0 -0.018" mass="0.02"
            friction="0.02 0.001 0.001" priority="1"/>
      <geom type="sphere" size="0.015" pos="0.07 0 -0.017" mass="0.02"
            friction="0.02 0.001 0.001" priority="1"/>
      <body name="left" pos="0 0.08 0">
        <joint name="left" type="hinge" axis="0 1 0" damping="0.001"/>
        <geom type="cylinder" size="0.033 0.009" euler="90 0 0" mass="0.03"
              friction="{friction} 0.01 0.001"/>
      </body>
      <body name="right" pos="0 -0.08 0">
        <joint name="right" type="hinge" axis="0 1 0" damping="0.001"/>
        <geom type="cylinder" size="0.033 0.009" euler="90 0 0" mass="0.03"
              friction="{friction} 0.01 0.001"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="left" kv="0.02" forcerange="-0.1 0.1"/>
    <velocity joint="right" kv="0.02" forcerange="-0.1 0.1"/>
  </actuator>
</mujoco>
"""


class Wheels:
    """A two-wheeled robot on a floor with friction; state() is (x, y, psi), step((v, w), seconds).

    radius, track: of the map from (v, w) to wheel speeds, fitted by `fitted_wheels`.
    """

    package = "mujoco"
    radius, track = 0.033, 0.16

    def __init__(self, friction: float = 0.6) -> None:
        import mujoco

        self.engine = mujoco
        self.model = mujoco.MjModel.from_xml_string(ROBOT.format(friction=friction))
        self.data = mujoco.MjData(self.model)

    def start(self, pose: Any) -> None:
        x, y, psi = pose
        self.engine.mj_resetData(self.model, self.data)
        self.data.qpos[:7] = [x, y, 0.033, math.cos(psi / 2), 0, 0, math.sin(psi / 2)]
        for _ in range(250):  # until it stands
            self.engine.mj_step(self.model, self.data)

    def state(self) -> np.ndarray:
        x, y, _, w, i, j, k = self.data.qpos[:7]
        return np.array([x, y, math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))])

    def step(self, given: Any, seconds: float) -> None:
        v, w = given
        half = w * self.track / 2
        self.data.ctrl[:] = [(v - half) / self.radius, (v + half) / self.radius]
        for _ in range(round(seconds / self.model.opt.timestep)):
            self.engine.mj_step(self.model, self.data)


def fitted_wheels(robot: Wheels) -> tuple[float, float]:
    """Radius and track that give the speeds asked for, from straight runs and turns on the spot."""
    robot.start((0.0, 0.0, 0.0))
    for _ in range(150):
        robot.step((0.2, 0.0), 0.02)
        if _ == 49:
            begun = robot.state()
    radius = robot.radius * math.dist(robot.state()[:2], begun[:2]) / (0.2 * 2.0)
    robot.start((0.0, 0.0, 0.0))
    turned, last = 0.0, 0.0
    for _ in range(150):
        robot.step((0.0, 1.0), 0.02)
        now = robot.state()[2]
        turned += math.remainder(now - last, 2 * math.pi) * (_ >= 50)
        last = now
    track = robot.track * (radius / robot.radius) * (1.0 * 2.0) / turned
    return radius, track
